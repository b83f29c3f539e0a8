"""Whole turns of an endless table that are counted by a controller and not by a plan."""

import numpy as np
import pytest

from cell.scan.table_turns import whole_turns
from drivers.contract import Capabilities, Mode, RobotState
from drivers.limits import ENDLESS_RANGE, Limits
from planner.ports import JointLimits


def _limits(lower_deg: float, upper_deg: float) -> JointLimits:
    one = np.ones(7)
    return JointLimits(np.radians([*[-180] * 6, lower_deg]), np.radians([*[180] * 6, upper_deg]), one, one, one)


def _turns(angle_deg: float, lower_deg: float, upper_deg: float, able: Capabilities | None = None) -> int:
    limits = _limits(lower_deg, upper_deg)
    if able is None:
        able = Limits.from_rad(limits).with_endless_axis().capabilities("endless", hardware=False, simulated_time=True)
    axes = np.array([0] * 6 + [round(1e4 * angle_deg)], dtype=np.int32)
    return whole_turns(RobotState(Mode.IDLE, axes, True), able, limits)


@pytest.mark.parametrize(("lower", "upper"), [(-180, 180), (-300, 60), (-20, 340), (-90, 45)])
def test_it_is_the_fewest_turns_that_bring_the_table_within_the_plans_limits(lower: float, upper: float) -> None:
    """The result agrees with a search through all turns, and is 0 if no number of turns fits."""
    for angle in np.random.default_rng(1).uniform(-4000, 4000, 300).round(4):
        fits = [turns for turns in range(-12, 13) if lower <= angle - 360 * turns <= upper]
        assert _turns(angle, lower, upper) == min(fits, key=abs, default=0), angle


@pytest.mark.parametrize("angle", [180.005, -180.005, 180.0, 0.0])
def test_a_count_beyond_a_limit_is_no_turn(angle: float) -> None:
    """An angle slightly beyond a limit, as reported at the end of half a turn, is no whole turn."""
    assert _turns(angle, -180, 180) == 0


def test_a_controller_that_ends_is_left_where_it_is() -> None:
    """A controller with limited turns stays at its angle, because it refuses angles with a turn added."""
    ends = Limits.from_rad(_limits(-190, 190)).capabilities("ends", hardware=False, simulated_time=True)
    assert _turns(185, -180, 180, ends) == 0
    assert _turns(185, -180, 180) == 1


def test_an_endless_axis_has_a_hundred_turns_and_the_step_that_it_had() -> None:
    """Only the limits of the last axis change."""
    before = Limits.from_rad(_limits(-180, 180))
    after = before.with_endless_axis()
    np.testing.assert_array_equal(after.lower[:6], before.lower[:6])
    assert (after.lower[6], after.upper[6]) == (-ENDLESS_RANGE, ENDLESS_RANGE)
    np.testing.assert_array_equal(after.max_step, before.max_step)
