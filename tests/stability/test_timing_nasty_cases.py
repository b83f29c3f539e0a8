"""Nasty cases of jerk-limited timing, by name: zero and infinite limits, moves of zero length and of two turns."""

from dataclasses import replace

import numpy as np
import pytest

from planner.errors import PlannerError
from planner.timing.motion import jerk_free_duration, retime
from planner.timing.move_time import move_time
from planner.timing.s_curve import Profile
from tests.support.joint_space import RANGE, SPEED, SYMMETRIC_LIMITS

LIMITS = replace(SYMMETRIC_LIMITS, jerk=20 * SPEED)
ENDLESS = np.full(6, np.inf)
REST = np.zeros(6)


def turned(axis: int, angle: float) -> np.ndarray:
    """Return the rest configuration with one axis turned [rad]."""
    q = np.zeros(6)
    q[axis] = angle
    return q


@pytest.mark.parametrize("which", ["velocity", "acceleration", "jerk"])
@pytest.mark.parametrize("value", [0.0, -1.0, -np.inf])
def test_a_limit_that_allows_no_motion_is_refused_by_name(which: str, value: float) -> None:
    """The message names limit, axis, value and valid values."""
    broken = getattr(LIMITS, which).copy()
    broken[3] = value
    with pytest.raises(PlannerError, match=f"{which} limit of A4 is {value} rad/s.*it must be above 0"):
        move_time(REST, turned(0, 1.0), replace(LIMITS, **{which: broken}))


def test_neither_acceleration_nor_jerk_limited_is_refused() -> None:
    """The speed would jump; one of the two limits suffices."""
    with pytest.raises(PlannerError, match=r"acceleration limit of A1 is inf .* jerk limit inf"):
        move_time(REST, turned(0, 1.0), replace(LIMITS, acceleration=ENDLESS, jerk=ENDLESS))


def test_only_jerk_limited() -> None:
    """Without limits of speed and acceleration a move has four phases of (d / 2j)^(1/3) each."""
    limits = replace(LIMITS, velocity=ENDLESS, acceleration=ENDLESS)
    time = 4 * np.cbrt(2.5 / (2 * limits.jerk[1]))
    assert float(move_time(REST, turned(1, 2.5), limits)) == pytest.approx(time, rel=1e-7)
    motion = retime(np.array([REST, turned(1, 2.5)]), [0, 0], [-1, -1], limits, 1e-3)
    assert np.isfinite(motion.qdd).all()
    assert np.abs(motion.qdd[:, 1]).max() == pytest.approx(limits.jerk[1] * time / 4, rel=1e-2)


def test_only_speed_and_jerk_limited() -> None:
    """The acceleration rises until half the speed is reached, then falls."""
    limits = replace(LIMITS, acceleration=ENDLESS)
    ramp = 2 * np.sqrt(SPEED[0] / limits.jerk[0])
    assert float(move_time(REST, turned(0, 3.0), limits)) == pytest.approx(3.0 / SPEED[0] + ramp, rel=1e-7)


def test_some_axes_without_limits() -> None:
    """The limits of the other axes hold; the free axes follow."""
    free = np.array([True, False, True, False, True, False])
    limits = replace(
        LIMITS,
        velocity=np.where(free, np.inf, LIMITS.velocity),
        jerk=np.where(free, np.inf, LIMITS.jerk),
    )
    q = np.full(6, 0.9)
    alone = max(float(move_time(REST, turned(axis, 0.9), limits)) for axis in range(6))
    assert float(move_time(REST, q, limits)) >= alone
    motion = retime(np.array([REST, q]), [0, 0], [-1, -1], limits, 1e-3)
    assert (np.abs(np.diff(motion.qdd, axis=0)) <= limits.jerk * np.diff(motion.t)[:, None] + 1e-12).all()


def test_a_move_of_a_nanoradian_is_limited_by_jerk_alone() -> None:
    """Its time is 4 (d / 2j)^(1/3), a third of a millisecond; samples keep the limits and reach the end exactly."""
    end = turned(2, 1e-9)
    motion = retime(np.array([REST, end]), [0, 0], [-1, -1], LIMITS)
    assert motion.duration == pytest.approx(4 * np.cbrt(1e-9 / (2 * LIMITS.jerk[2])), rel=1e-6)
    np.testing.assert_array_equal(motion.q[-1], end)
    assert (np.abs(motion.qdd) <= LIMITS.acceleration).all()


def test_moves_below_the_rounding_of_angles_take_no_time() -> None:
    """1e-14 rad takes no time and adds no sample, also between other moves."""
    via = np.array([REST, turned(2, 1e-14), turned(2, 1.0), turned(2, 1.0)])
    motion = retime(via, [0, 1, 2, 3], [-1] * 4, LIMITS)
    assert motion.via_t[1] == 0.0
    assert motion.via_t[3] == motion.via_t[2]
    assert (np.diff(motion.t) > 0).all()


def test_no_move_at_all() -> None:
    """A motion of one point or of equal points takes no time, and its bound is 0."""
    for via in ([REST], [REST, REST]):
        motion = retime(np.array(via), [0] * len(via), [-1] * len(via), LIMITS)
        assert motion.duration == jerk_free_duration(motion) == 0.0
        assert len(motion.t) == 1
    assert move_time(np.zeros((0, 6)), np.zeros((0, 6)), LIMITS).shape == (0,)
    assert move_time(np.zeros((3, 1, 6)), np.zeros((0, 6)), LIMITS).shape == (3, 0)


def test_a_turn_of_700_degrees_reaches_every_limit() -> None:
    """A6 from -350 to 350 deg: 700 / 615 s of cruise, 0.5 s of ramp, 0.1 s of ease."""
    via = np.array([turned(5, -RANGE[5]), turned(5, RANGE[5])])
    motion = retime(via, [0, 0], [-1, -1], LIMITS, 1e-3)
    assert motion.duration == pytest.approx(700 / 615 + 0.5 + 0.1, rel=1e-7)
    assert jerk_free_duration(motion) == pytest.approx(700 / 615 + 0.5, rel=1e-7)
    for values, limit in (
        (motion.qd, LIMITS.velocity),
        (motion.qdd, LIMITS.acceleration),
        (np.diff(motion.qdd, axis=0) / np.diff(motion.t)[:, None], LIMITS.jerk),
    ):
        assert 1 - 1e-6 < np.abs(values[:, 5]).max() / limit[5] <= 1


def test_a_profile_without_length_has_no_duration() -> None:
    """All three widths are 0."""
    assert Profile(np.zeros(2), np.zeros(2), np.zeros(2)).duration.tolist() == [0.0, 0.0]
