"""Sweeps in a timed motion: each sweep keeps its own timing between joint moves and starts and ends at rest."""

import numpy as np
import pytest

from cell.robot.arm import kr16_kinematics
from planner.errors import PlannerError
from planner.path.sweeps import SweepPath, TimedSweep, find_sweeps
from planner.timing.motion import Motion, jerk_free_duration, retime
from planner.timing.move_time import move_time
from planner.values import Floats
from planner.viewpoints.viewpoints import straight_sweep_poses
from tests.support.arms import HOME

KINEMATICS = kr16_kinematics()
LIMITS = KINEMATICS.limits
MOUNT = np.eye(4)
MOUNT[2, 3] = 0.12


@pytest.fixture(scope="module")
def path() -> SweepPath:
    """Return a sweep along the baseline."""
    T = KINEMATICS.forward(np.radians([[12, -75, 110, 35, -60, 140]]))[0] @ MOUNT
    return find_sweeps(T @ straight_sweep_poses(0.15, 8), MOUNT, KINEMATICS, LIMITS).paths[0]


def _motion(path: SweepPath) -> Motion:
    """Return the motion home, sweep, stop, sweep backwards, home."""
    back = path.reversed()
    m = len(path.q)
    via: Floats = np.concatenate([HOME[None], path.q, path.q[-1:] + 0.1, back.q, HOME[None]])
    none = np.full(m, -1)
    view = np.concatenate([[-1], np.where(path.pose >= 0, 5, none), [7], np.where(back.pose >= 0, 9, none), [-1]])
    pose = np.concatenate([[-1], path.pose, [0], back.pose, [-1]])
    segment = np.concatenate([[0], np.zeros(m), [1], np.full(m, 2), [3]]).astype(np.int64)
    lines = {1: TimedSweep(path, MOUNT, KINEMATICS), m + 2: TimedSweep(back, MOUNT, KINEMATICS)}
    return retime(via, segment, view, LIMITS, pose=pose, lines=lines)


def test_a_sweep_takes_its_own_time_and_the_moves_theirs(path: SweepPath) -> None:
    """The durations add up, via points of lines are numbered, and every via point is a sample."""
    motion, m = _motion(path), len(path.q)
    moves = [(0, 1), (m, m + 1), (m + 1, m + 2), (2 * m + 1, 2 * m + 2)]
    joint = sum(float(move_time(motion.via_q[a], motion.via_q[b], LIMITS)) for a, b in moves)
    assert motion.duration == pytest.approx(joint + 2 * path.duration, abs=1e-9)
    assert np.flatnonzero(motion.line == 0).tolist() == list(range(2, m + 1))
    assert np.flatnonzero(motion.line == 1).tolist() == list(range(m + 3, 2 * m + 2))
    assert np.isin(motion.via_t, motion.t).all()
    at = np.searchsorted(motion.t, motion.via_t)
    assert np.degrees(np.abs(motion.q[at] - motion.via_q)).max() < 1.1e-4
    ends = [0, 1, m, m + 1, m + 2, 2 * m + 1, 2 * m + 2]
    np.testing.assert_allclose(motion.q[at[ends]], motion.via_q[ends], atol=1e-12)
    assert np.abs(motion.qd[at[ends]]).max() < 1e-9
    assert jerk_free_duration(motion) < motion.duration
    assert jerk_free_duration(motion) > 2 * path.duration


def test_no_sample_exceeds_a_limit_and_none_is_far_from_its_neighbour(path: SweepPath) -> None:
    """The limits hold, also between moves and lines, and differences agree with the returned speeds."""
    motion = _motion(path)
    assert (np.diff(motion.t) > 0).all()
    assert np.diff(motion.t).max() <= 0.012 + 1e-9
    assert (np.abs(motion.qd) <= LIMITS.velocity).all()
    assert (np.abs(motion.qdd) <= LIMITS.acceleration).all()
    speed = np.diff(motion.q, axis=0) / np.diff(motion.t)[:, None]
    between = 0.5 * (motion.qd[1:] + motion.qd[:-1])
    assert np.abs(speed - between).max() < 0.02


def test_a_view_stops_once_a_sweep_at_its_middle_pose(path: SweepPath) -> None:
    """`stops` has one row for each view in the order of the motion."""
    motion = _motion(path)
    assert motion.view[motion.stops].tolist() == [5, 7, 9]
    assert motion.pose[motion.stops].tolist() == [4, 0, 4]


def test_a_line_without_room_is_refused(path: SweepPath) -> None:
    """A line with more via points than remain is refused."""
    with pytest.raises(PlannerError, match="there is no room for them"):
        retime(path.q[:-1], [0] * (len(path.q) - 1), [-1] * (len(path.q) - 1), LIMITS,
               lines={0: TimedSweep(path, MOUNT, KINEMATICS)})  # fmt: skip
