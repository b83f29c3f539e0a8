"""Remaining motion of a stopped execution from the present position of the arm."""

from typing import Any

import numpy as np
import pytest

from cell.errors import DriverFailureError
from cell.scan.execution import ExecutionPlan, Segment
from cell.scan.resume import RemainingMotion, plan_resume
from drivers.contract import Mode, RobotState
from drivers.setpoints import from_rad, to_rad
from planner.ports import JointLimits
from planner.timing.motion import Motion, retime
from tests.support.arms import KR16

HOME = to_rad(from_rad(np.radians([0.0, -90.0, 90.0, 0.0, 90.0, 0.0])))
LIMITS = JointLimits(to_rad(KR16.lower), to_rad(KR16.upper), KR16.velocity, KR16.acceleration, KR16.jerk)
CHECKER: Any = None  # the tests need no collision check


def at(degrees: float) -> np.ndarray:
    """Return the home configuration with A1 turned."""
    return to_rad(from_rad(HOME + np.radians([degrees, 0, 0, 0, 0, 0])))


# Home, view 1, a via point, view 2, a sweep of three poses, view 4, home.
ENDS = {1: at(10), 2: at(30), 4: at(70)}
PLAN = ExecutionPlan(
    HOME,
    (
        Segment(at(10)[None], 1, 70),
        Segment(np.stack([at(20), at(30)]), 2, 71),
        *(Segment(at(40 + 5 * pose)[None], 3, 72, pose) for pose in range(3)),
        Segment(at(70)[None], 4, 73),
        Segment(np.stack([at(35), HOME]), 0, -1),
    ),
    60.0,
)
MOTION: Motion = retime(np.stack([HOME, at(10)]), np.array([0, 1]), np.array([-1, 70]), LIMITS)


def rest(scanned: set[int], q: np.ndarray) -> RemainingMotion:
    """Return the remaining motion of an arm that is at q."""
    return plan_resume(PLAN, scanned, RobotState(Mode.IDLE, from_rad(q), True), CHECKER, MOTION.limits, 0)


@pytest.mark.parametrize(
    ("scanned", "position", "stops", "segments"),
    [
        (set(), HOME, (1, 2, 3, 4), 7),
        ({1}, at(10), (2, 3, 4), 6),
        ({1, 2}, at(30), (3, 4), 5),
        ({1, 2, 3}, at(50), (4,), 2),
        ({1, 2, 3, 4}, at(70), (), 1),
    ],
    ids=["nothing moved", "view 1", "view 2", "after the sweep", "only the way home"],
)
def test_between_a_scan_and_the_next_move_the_plan_goes_on(
    scanned: set[int], position: np.ndarray, stops: tuple[int, ...], segments: int
) -> None:
    """The remaining segments are those of the plan, and they start at the position of the arm."""
    left = rest(scanned, position)
    assert left.approach_path is None
    assert left.plan.stops == stops
    assert left.plan.segments == PLAN.segments[len(PLAN.segments) - segments :]
    assert (left.plan.start == position).all()


@pytest.mark.parametrize(("scanned", "goal"), [(set(), at(10)), ({1}, at(30)), ({1, 2}, at(40)), ({1, 2, 3, 4}, HOME)])
def test_between_the_end_of_a_move_and_its_scan_nothing_is_driven_again(scanned: set[int], goal: np.ndarray) -> None:
    """An arm at the goal of a move without its scan makes a move of zero length. The same holds for the way home."""
    left = rest(scanned, goal)
    assert left.approach_path is None
    assert (left.plan.segments[0].via == goal[None]).all()
    after = left.plan.segments[1:]
    assert after == PLAN.segments[len(PLAN.segments) - len(after) :]


def test_views_behind_a_damaged_scan_are_driven_through() -> None:
    """View 1 is scanned again. View 2 and the sweep are passed without a scan, along the segments of the plan."""
    left = rest({2, 3, 4}, HOME)
    assert left.plan.stops == (1,)
    assert [segment.stop for segment in left.plan.segments] == [1, 0, 0, 0, 0, 0, 0]
    assert all((a.via == b.via).all() for a, b in zip(left.plan.segments, PLAN.segments, strict=True))


def test_from_outside_the_plan_s_joint_range_no_way_is_driven() -> None:
    """An arm outside the joint range of the plan is refused, because its first move would not be the checked one."""
    with pytest.raises(DriverFailureError, match="outside the joint range of the plan"):
        rest({1}, at(185.5))
