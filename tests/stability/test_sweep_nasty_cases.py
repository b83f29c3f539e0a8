"""Nasty cases of sweeps, by name: singularities on the line, no length, out of reach, no branch that passes."""

from dataclasses import replace

import numpy as np
import pytest

from planner.path.sweep_line import SweepRefusal
from planner.path.sweeps import find_sweeps
from planner.ports import JointLimits
from planner.values import Floats
from planner.viewpoints.viewpoints import straight_sweep_poses, turned_sweep_poses
from tests.support.arms import KINEMATICS, LIMITS, MOUNT


def _pose(*angles_deg: float) -> Floats:
    """Return T_base_scanner (4, 4)."""
    T: Floats = KINEMATICS.forward(np.radians([angles_deg]))[0] @ MOUNT
    return T


def _reasons(column: Floats, limits: JointLimits = LIMITS) -> tuple[int, dict[int, SweepRefusal]]:
    found = find_sweeps(column, MOUNT, KINEMATICS, limits)
    return len(found.paths), {refused.branch: refused.reason for refused in found.refused}


@pytest.mark.parametrize("off_deg", [0.0, 1e-7, 1e-3, 0.1])
def test_through_the_wrist_singularity(off_deg: float) -> None:
    """A5 passes 0 in the middle of the line, exactly or nearly: both wrist branches of this arm posture are refused."""
    column = _pose(10, -60, 80, 40, off_deg, 30) @ straight_sweep_poses(0.1, 5, (0, 1, 0))
    refused = {each.branch: each for each in find_sweeps(column, MOUNT, KINEMATICS, LIMITS).refused}
    for branch in (0, 1):
        assert refused[branch].reason in (SweepRefusal.SINGULAR, SweepRefusal.TOO_FAST)
        assert off_deg or "A4" in refused[branch].detail
        assert refused[branch].detail in refused[branch].sentence


@pytest.mark.parametrize(
    "pose", [(50.7, -103.7, -118.4, -338.4, 81.5, 288.9), (42.7, -82.1, 153.2, 336.6, 48.2, 105.3)]
)
def test_axes_without_a_jerk_limit_are_those_of_an_enormous_one(pose: tuple[float, ...]) -> None:
    """A line through singularities has infinite bounds; without a jerk limit they must not give NaN."""
    column = _pose(*pose) @ turned_sweep_poses(np.radians(24.0), 5)
    free, enormous = (replace(LIMITS, jerk=np.full(6, jerk)) for jerk in (np.inf, 1e15))
    assert _reasons(column, free) == _reasons(column, enormous)


@pytest.mark.parametrize("elbow", [-2.990345, -2.990345 + 1e-7])
def test_through_the_stretched_elbow(elbow: float) -> None:
    """The line crosses the boundary of the reach, and no branch follows it."""
    paths, reasons = _reasons(_pose(0, -45, elbow, 0, 40, 0) @ straight_sweep_poses(0.1, 5, (0, 0, 1)))
    assert paths == 0
    assert set(reasons.values()) == {SweepRefusal.OUT_OF_REACH}


def test_through_the_shoulder_singularity() -> None:
    """The wrist centre crosses the axis of A1, which would need a half turn in no time."""
    column = _pose(0, -120, 33.857864, 0, 60, 0) @ straight_sweep_poses(0.1, 4, (1, 0, 0))
    found = find_sweeps(column, MOUNT, KINEMATICS, LIMITS)
    assert not found.paths
    assert any(r.reason is SweepRefusal.SINGULAR and "A1" in r.detail for r in found.refused)


@pytest.mark.parametrize("count", [2, 7])
def test_a_sweep_of_zero_length_is_a_stop(count: int) -> None:
    """A sweep of equal poses has one path per free branch, without duration."""
    column = np.tile(_pose(12, -75, 110, 35, -60, 140), (count, 1, 1))
    found = find_sweeps(column, MOUNT, KINEMATICS, LIMITS)
    assert found.paths
    for path in found.paths:
        assert path.duration == 0.0
        assert (path.q == path.q[0]).all()
        assert path.pose.tolist() == list(range(count))
        T = KINEMATICS.forward(path.q[:1])[0] @ MOUNT
        assert np.linalg.norm(T[:3, 3] - column[0, :3, 3]) < 2e-5
    assert len({tuple(path.q[0]) for path in found.paths}) == len(found.paths)


def test_a_sweep_with_a_jump_on_every_branch() -> None:
    """Past the axis of A1 at 2 mm: every branch needs half a turn of A1 within a few millimetres."""
    column = _pose(0, -120, 33.857864, 0, 60, 0)
    column[1, 3] += 0.002
    paths, reasons = _reasons(column @ straight_sweep_poses(0.3, 6, (1, 0, 0)))
    assert paths == 0
    assert reasons
    assert set(reasons.values()) <= {SweepRefusal.SINGULAR, SweepRefusal.TOO_FAST, SweepRefusal.OUT_OF_REACH}


def test_a_sweep_that_only_just_keeps_a_joint_limit() -> None:
    """With limits equal to the sweep's range it is feasible. A hundredth of a degree tighter, the axis is named."""
    column = _pose(12, -75, 110, 35, -60, 140) @ straight_sweep_poses(0.15, 8)
    path = next(path for path in find_sweeps(column, MOUNT, KINEMATICS, LIMITS).paths if path.branch == 1)
    low, high = path.q.min(axis=0), path.q.max(axis=0)
    room = np.radians(0.3)  # what the bounds between two samples need
    wide = JointLimits(low - room, high + room, LIMITS.velocity, LIMITS.acceleration, LIMITS.jerk)
    assert any(found.branch == 1 for found in find_sweeps(column, MOUNT, KINEMATICS, wide).paths)
    upper = high + room
    upper[0] = high[0] - np.radians(0.01)
    narrow = JointLimits(low - room, upper, LIMITS.velocity, LIMITS.acceleration, LIMITS.jerk)
    refused = {r.branch: r for r in find_sweeps(column, MOUNT, KINEMATICS, narrow).refused}
    assert refused[1].reason is SweepRefusal.JOINT_LIMIT
    assert refused[1].detail == "A1"


def test_slow_axes_slow_the_sweep_down_and_then_refuse_it() -> None:
    """Slow axes make the sweep up to four times slower; beyond, it is refused."""
    column = _pose(12, -75, 110, 35, -60, 140) @ straight_sweep_poses(0.15, 8)
    durations = []
    for factor in (1.0, 0.012, 0.008):
        slow = JointLimits(LIMITS.lower, LIMITS.upper, LIMITS.velocity * factor, LIMITS.acceleration, LIMITS.jerk)
        paths = [path for path in find_sweeps(column, MOUNT, KINEMATICS, slow).paths if path.branch == 1]
        durations.append(paths[0].duration)
    assert durations[0] < durations[1] < durations[2]
    crawl = JointLimits(LIMITS.lower, LIMITS.upper, LIMITS.velocity * 1e-3, LIMITS.acceleration, LIMITS.jerk)
    paths_left, reasons = _reasons(column, crawl)
    assert paths_left == 0
    assert SweepRefusal.TOO_FAST in reasons.values()


def test_poses_that_are_no_line() -> None:
    """An arc is refused once, because it is no line."""
    bent = straight_sweep_poses(0.1, 5) @ turned_sweep_poses(0.2, 5)
    bent[2, 1, 3] += 0.001
    found = find_sweeps(_pose(12, -75, 110, 35, -60, 140) @ bent, MOUNT, KINEMATICS, LIMITS)
    assert [refused.reason for refused in found.refused] == [SweepRefusal.NO_LINE]


class _Wall:
    """A checker in which a configuration with A1 above an angle is not free."""

    clearance = 0.01

    def __init__(self, limit: float) -> None:
        self.limit = limit

    def free(self, q: Floats) -> np.ndarray:
        return np.asarray(q[:, 0] < self.limit)

    def contacts(self, q: Floats) -> tuple[str, ...]:
        return ("housing with wall",) if q[0] >= self.limit else ()

    def distance(self, q: Floats) -> tuple[Floats, tuple[str, ...]]:
        return self.limit - q[:, 0], ("housing with wall",) * len(q)

    def travel(self, q_from: Floats, q_to: Floats) -> Floats:
        return np.abs(q_to - q_from).sum(axis=1) * 2.0


def test_a_colliding_line_is_refused_with_the_blocker() -> None:
    """A single vertex too close to the wall refuses the line."""
    column = _pose(12, -75, 110, 35, -60, 140) @ straight_sweep_poses(0.15, 8)
    free = find_sweeps(column, MOUNT, KINEMATICS, LIMITS, checker=_Wall(10.0))
    assert free.paths
    highest = max(float(path.q[:, 0].max()) for path in free.paths if path.branch == 1)
    found = find_sweeps(column, MOUNT, KINEMATICS, LIMITS, checker=_Wall(highest))
    refused = {r.branch: r for r in found.refused}
    assert refused[1].sentence == "the line comes nearer to an object than the clearance (housing with wall)"
