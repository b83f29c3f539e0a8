"""Execution of sweeps: a segment for each pose, lines between the poses, and one complete scan for each view."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from cell.robot.arm import kr16_kinematics
from cell.runs.cell import RunCell
from cell.runs.run import read_scan
from cell.scan import execution
from cell.scan.execution import plan_execution
from cell.scan.simulated import Disturbance, Simulated, line_poses, lines_per_step
from cell.scanners.laser_line import LaserLine
from drivers.clock import SimulatedClock
from drivers.errors import FaultError
from planner.path.sweeps import SweepPath, TimedSweep, find_sweeps
from planner.timing.motion import Motion, retime
from planner.values import Floats
from planner.viewpoints.viewpoints import straight_sweep_poses, turned_sweep_poses
from tests.support.arms import HOME
from tests.support.runs import RecordingDriver, ball_cell, new_execution

KINEMATICS = kr16_kinematics()
SCANNER = LaserLine(sweep_mm=80.0, sweep_steps=4, line_points=50)


@pytest.fixture(scope="module")
def path() -> SweepPath:
    """Return a sweep of four poses around home."""
    T = KINEMATICS.forward(HOME[None])[0]
    return find_sweeps(T @ SCANNER.T_view_scanner, np.eye(4), KINEMATICS, KINEMATICS.limits).paths[0]


@pytest.fixture(scope="module")
def scene() -> RunCell:
    """Return a ball of 60 mm in the middle of the scanner's range below home."""
    return ball_cell(SCANNER)


def _motion(path: SweepPath) -> Motion:
    """Return the motion home, sweep as view 70, backwards as view 71, home."""
    back = path.reversed()
    via = np.concatenate([HOME[None], path.q, back.q, HOME[None]])
    pose = np.concatenate([[-1], path.pose, back.pose, [-1]])
    leg = np.concatenate([[0], np.zeros(len(path.q)), np.ones(len(path.q)), [2]]).astype(np.int64)
    view = np.where(pose >= 0, 70 + leg, -1)
    lines = {k: TimedSweep(p, np.eye(4), KINEMATICS) for k, p in ((1, path), (1 + len(path.q), back))}
    return retime(via, leg, view, KINEMATICS.limits, pose=pose, lines=lines)


def test_legs_end_at_each_pose_and_drive_every_vertex_once(path: SweepPath) -> None:
    """Two views of four poses, the second backwards, give eight scanning segments and the way home."""
    motion = _motion(path)
    plan = plan_execution(motion)
    assert [(segment.stop, segment.view, segment.pose) for segment in plan.segments] == [
        *((1, 70, pose) for pose in range(4)), *((2, 71, pose) for pose in (3, 2, 1, 0)), (0, -1, 0),
    ]  # fmt: skip
    np.testing.assert_array_equal(
        np.concatenate([HOME[None], *(segment.via for segment in plan.segments)]), motion.via_q
    )


@pytest.mark.parametrize("stop", [1, 2])
def test_one_view_alone_is_driven_along_checked_paths_only(path: SweepPath, stop: int) -> None:
    """Every move to the view, through its poses and back is a move of the plan in either direction."""
    motion = _motion(path)
    plan = plan_execution(motion, stop)
    assert [segment.stop for segment in plan.segments] == [stop] * 4 + [0]
    assert sorted(segment.pose for segment in plan.segments[:4]) == [0, 1, 2, 3]
    driven = np.concatenate([plan.start[None], *(segment.via for segment in plan.segments)])
    np.testing.assert_array_equal(driven[[0, -1]], motion.via_q[[0, 0]])
    known = {(a.tobytes(), b.tobytes()) for a, b in pairwise(motion.via_q)}
    for a, b in pairwise(driven):
        assert (a.tobytes(), b.tobytes()) in known or (b.tobytes(), a.tobytes()) in known
    own = plan.to_motion(motion)
    assert own.view[own.stops].tolist() == [70 if stop == 1 else 71]
    assert plan.planned_seconds > 0


def test_a_view_is_one_scan_of_all_lines_whichever_way_it_was_driven(
    path: SweepPath, scene: RunCell, tmp_path: Path
) -> None:
    """Both directions give the same poses in the order of the column, and the same points on the ball."""
    folder = new_execution(tmp_path)
    execution.drive(
        plan_execution(_motion(path)), RecordingDriver(), scene, Simulated(scene, Disturbance(), 5), folder, speed=1.0,
        clock=SimulatedClock(),
    )  # fmt: skip
    first, second = (read_scan(folder.path / "scans" / f"{stop:04d}.npz") for stop in (1, 2))
    np.testing.assert_array_equal(first.stored["sweep_q_reported"], second.stored["sweep_q_reported"])
    np.testing.assert_allclose(first.stored["sweep_q_commanded"], path.measured_q, atol=1e-12)
    np.testing.assert_array_equal(first.q_reported, first.stored["sweep_q_reported"][2])
    assert first.stored["grid_shape"].tolist() == [4 * 20 * 50, 1]  # lines of 50 points, 1 mm apart
    assert len(first.points) > 500
    assert np.abs(np.linalg.norm(first.points, axis=1) - 0.06).max() < 0.001
    ours = first.points[np.lexsort(np.round(first.points, 6).T)]
    theirs = second.points[np.lexsort(np.round(second.points, 6).T)]
    np.testing.assert_allclose(ours, theirs, atol=2e-6)


def test_a_sweep_that_breaks_off_leaves_no_scan(path: SweepPath, scene: RunCell, tmp_path: Path) -> None:
    """If the driver fails at the third pose of the second view, only the scan of the first view is saved."""
    folder = new_execution(tmp_path)

    def fail(move: int) -> None:
        if move == 6:
            raise FaultError("the arm does not follow its set-points", 4002)

    with pytest.raises(FaultError):
        execution.drive(
            plan_execution(_motion(path)), RecordingDriver(before=fail), scene, Simulated(scene, Disturbance(), 5),
            folder, speed=1.0, clock=SimulatedClock(),
        )  # fmt: skip
    assert [file.name for file in (folder.path / "scans").iterdir()] == ["0001.npz"]


@pytest.mark.parametrize(
    "column", [straight_sweep_poses(0.15, 8), turned_sweep_poses(0.4, 5), straight_sweep_poses(0.02, 2)]
)
def test_lines_stand_between_the_poses_and_half_a_step_beyond(column: Floats) -> None:
    """Lines are evenly spaced by at most 1 mm, and the lines of a cell are symmetric about its pose."""
    each = lines_per_step(column)
    lines = line_poses(column, each)
    assert len(lines) == each * len(column)
    steps = np.linalg.norm(np.diff(lines[:, :3, 3], axis=0), axis=1)
    assert steps.max() <= 0.001 + 1e-12
    assert np.ptp(steps) < 1e-12
    for k in range(len(column)):
        cell = lines[k * each : (k + 1) * each]
        np.testing.assert_allclose(cell[:, :3, 3].mean(axis=0), column[k, :3, 3], atol=1e-12)
        between = cell[0, :3, :3].T @ column[k, :3, :3]
        np.testing.assert_allclose(between, column[k, :3, :3].T @ cell[-1, :3, :3], atol=1e-12)


def test_a_single_pose_is_one_line() -> None:
    """A view at rest has one line."""
    assert lines_per_step(np.eye(4)[None]) == 1
