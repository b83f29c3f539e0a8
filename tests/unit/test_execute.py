"""Execution with test drivers: moves, order of writes to disk, and the end of an execution."""

import errno
import itertools
import json
import os
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from cell.errors import DriverFailureError, FileError, UsageError
from cell.runs.folder import SCHEMA
from cell.runs.run import Run, read_scan
from cell.runs.schema import Manifest
from cell.scan import execution
from cell.scan.execution import ExecutionPlan, Segment, plan_execution
from cell.scan.execution_folder import ExecutionFolder
from cell.scan.options import ScanOptions
from cell.scan.simulated import Disturbance, Simulated
from cell.scanners.laser_area import LaserArea
from cell.world.travel import TravelBound
from drivers.clock import SimulatedClock
from drivers.contract import RobotState
from drivers.errors import FaultError
from drivers.registry import Context, open_driver
from drivers.setpoints import from_rad, to_rad
from planner.ports import JointLimits, Rejection
from planner.timing.motion import Motion, retime
from tests.support.arms import HOME, KR16
from tests.support.runs import RecordingDriver, ball_cell, new_execution

LIMITS = JointLimits(
    to_rad(KR16.lower), to_rad(KR16.upper), KR16.velocity, KR16.acceleration, KR16.jerk
)  # fmt: skip


def _tour(counts=(1, 2, 1), home_points=2, seed=0) -> Motion:
    """Return a motion from home through views 70, 71, ... and back, with `counts` via points before each view."""
    rng = np.random.default_rng(seed)
    n = sum(counts) + home_points
    via = to_rad(from_rad(HOME + rng.uniform(-0.1, 0.1, (n + 1, 6))))
    via[0] = via[-1] = to_rad(from_rad(HOME))
    view = np.full(n + 1, -1)
    view[np.cumsum(counts)] = 70 + np.arange(len(counts))
    legs = [*counts, home_points]
    return retime(via, np.repeat(np.arange(len(legs) + 1), [1, *legs]), view, LIMITS)


SCANNER = LaserArea(resolution_deg=(3.0, 3.0))


@pytest.fixture
def folder(tmp_path: Path) -> ExecutionFolder:
    """Return a new execution folder of an empty run."""
    return new_execution(tmp_path)


def _run(driver, motion, folder, stop=None, disturbance=None, seed=5):
    plan = plan_execution(motion, stop)
    source = Simulated(ball_cell(SCANNER), disturbance or Disturbance(), seed)
    execution.drive(plan, driver, ball_cell(SCANNER), source, folder, speed=0.5, clock=SimulatedClock())


def _events(folder) -> list[dict]:
    return [json.loads(line) for line in (folder.path / "events.jsonl").read_text().splitlines()]


def test_the_legs_of_a_plan_are_its_via_points_once_each_in_order() -> None:
    """Start and segments together are exactly the plan's via points."""
    motion = _tour()
    plan = plan_execution(motion)
    joined = np.concatenate([plan.start[None], *(segment.via for segment in plan.segments)])
    assert (joined == motion.via_q).all()
    assert [(segment.stop, segment.view) for segment in plan.segments] == [(1, 70), (2, 71), (3, 72), (0, -1)]
    assert plan.planned_seconds == motion.duration
    again = plan.to_motion(motion)
    assert (again.view == motion.view).all()
    assert again.duration == pytest.approx(motion.duration, abs=1e-12)


@pytest.mark.parametrize("stop", [1, 2, 3])
def test_one_view_is_reached_and_left_on_the_plans_own_path(stop: int) -> None:
    """A single view is reached from home and left by steps of the plan, forward or backward, on the shorter side."""
    motion = _tour()
    plan = plan_execution(motion, stop)
    at = int(np.flatnonzero(motion.view >= 0)[stop - 1])
    joined = np.concatenate([plan.start[None], *(segment.via for segment in plan.segments)])
    steps = {(a.tobytes(), b.tobytes()) for a, b in zip(motion.via_q[:-1], motion.via_q[1:], strict=True)}
    for a, b in itertools.pairwise(joined):
        assert (a.tobytes(), b.tobytes()) in steps or (b.tobytes(), a.tobytes()) in steps
    assert (joined[0] == motion.via_q[0]).all()
    assert (joined[-1] == motion.via_q[0]).all()
    assert (plan.segments[0].via[-1] == motion.via_q[at]).all()
    assert [segment.stop for segment in plan.segments] == [stop, 0]
    assert plan.planned_seconds == pytest.approx(2 * min(motion.via_t[at], motion.duration - motion.via_t[at]))


@pytest.mark.parametrize("stop", [0, 4, -1])
def test_a_view_that_the_plan_does_not_have_is_refused(stop: int) -> None:
    """A view that the plan does not have is refused, and the message states the valid numbers."""
    with pytest.raises(UsageError, match="views 1 to 3"):
        plan_execution(_tour(), stop)


def test_the_controller_gets_exactly_the_planned_counts_at_the_planned_speed(folder: ExecutionFolder) -> None:
    """The set-points of all moves are the plan's via points in 1e-4 deg, at the plan's speed fraction."""
    driver, motion = RecordingDriver(), _tour()
    _run(driver, motion, folder)
    sent = np.concatenate([points for points, _ in driver.moves])
    assert sent.dtype == np.int32
    assert (sent == from_rad(motion.via_q[1:])).all()
    assert {speed for _, speed in driver.moves} == {0.5}


def test_a_controller_that_takes_few_via_points_gets_them_in_pieces(folder: ExecutionFolder) -> None:
    """A controller with one via point per move gets the same set-points in the same order; scans are at stops only."""
    driver, motion = RecordingDriver(max_via=1), _tour()
    _run(driver, motion, folder)
    assert [len(points) for points, _ in driver.moves] == [1] * (len(motion.via_q) - 1)
    assert (np.concatenate([points for points, _ in driver.moves]) == from_rad(motion.via_q[1:])).all()
    assert len(list((folder.path / "scans").iterdir())) == 3


def test_each_scan_and_event_is_on_disk_before_the_next_move(folder: ExecutionFolder) -> None:
    """Before move k all earlier scan files are complete on disk, and the last event announces move k."""
    seen = []

    def record(move: int) -> None:
        files = sorted((folder.path / "scans").iterdir())
        assert [path.name for path in files] == [f"{k + 1:04d}.npz" for k in range(min(move, 3))]
        for path in files:
            read_scan(path)
        assert _events(folder)[-1]["event"] == "move"
        assert _events(folder)[-1]["segment"] == move + 1
        seen.append(move)

    _run(RecordingDriver(before=record), _tour(), folder)
    assert seen == [0, 1, 2, 3]
    names = [event["event"] for event in _events(folder)]
    assert names == ["connected", *["move", "arrival", "scan"] * 3, "move", "arrival", "done"]


def test_the_scan_is_taken_from_the_reported_pose(folder: ExecutionFolder) -> None:
    """The recorded scanner pose is that of the reported axes, not of the set-point."""
    scene = ball_cell(SCANNER)
    _run(RecordingDriver(off=7), _tour(), folder)
    scan = read_scan(folder.path / "scans" / "0002.npz")
    assert (from_rad(scan.q_reported) - from_rad(scan.q_commanded) == 7).all()
    T = scan.stored["T_object_scanner"]
    T_base_scanner = scene.kinematics.forward(np.asarray(scan.q_reported)[None])[0]
    np.testing.assert_allclose(scene.scene.T_base_object @ T, T_base_scanner, atol=1e-12)
    assert (scan.stored["T_object_scanner_true"] == T).all()


def test_a_view_has_its_own_disturbance_whatever_else_is_scanned(tmp_path: Path) -> None:
    """View 2 alone has the same bytes as in the whole execution, including noise and pose error."""
    run = Run(tmp_path, Manifest(schema=SCHEMA))
    files = []
    for stop in (None, 2):
        folder = ExecutionFolder.make(run, [], 5, {}, datetime(2024, 1, 2, tzinfo=UTC))
        _run(RecordingDriver(), _tour(), folder, stop, Disturbance(1e-4, 1e-3, 1e-3))
        files.append((folder.path / "scans" / "0002.npz").read_bytes())
    assert files[0] == files[1]
    _run(RecordingDriver(), _tour(), folder, 2, Disturbance(1e-4, 1e-3, 1e-3), seed=6)
    assert (folder.path / "scans" / "0002.npz").read_bytes() != files[0]


def test_a_view_that_sees_nothing_is_a_scan_without_points(folder: ExecutionFolder) -> None:
    """A view away from the part has a complete, readable scan file without points, also with noise."""
    motion = _tour((1,), seed=3)
    away = motion.via_q[:1] + np.array([1.5, 0, 0, 0, 0, 0])
    plan = ExecutionPlan(motion.via_q[0], (Segment(away, 1, 70),), 1.0)
    source = Simulated(ball_cell(SCANNER), Disturbance(range_noise=1e-4), 0)
    execution.drive(plan, RecordingDriver(), ball_cell(SCANNER), source, folder, speed=0.5, clock=SimulatedClock())
    scan = read_scan(folder.path / "scans" / "0001.npz")
    assert scan.points.shape == (0, 3)
    assert scan.stored["counts"][Rejection.NO_HIT] == 400


def test_an_arm_that_stands_elsewhere_is_not_moved(folder: ExecutionFolder) -> None:
    """An arm away from the start is refused before any move, and the message has both positions."""
    driver = RecordingDriver(HOME + np.radians([0, 0.02, 0, 0, 0, 0]))
    with pytest.raises(DriverFailureError, match=r"-89\.9800.*-90\.0000"):
        _run(driver, _tour(), folder)
    assert driver.moves == []
    near = RecordingDriver(HOME + np.radians([0, 0.009, 0, 0, 0, 0]))
    _run(near, _tour(), folder)
    assert len(near.moves) == 4


@pytest.mark.parametrize(
    ("error", "event"), [(FaultError("a drive tripped", 7), "failed"), (KeyboardInterrupt(), "interrupted")]
)
def test_an_execution_that_ends_early_has_its_scans_and_the_reason(
    error: BaseException, event: str, folder: ExecutionFolder
) -> None:
    """If the third move fails, two complete scans remain, and the last event states the reason."""

    def fail(move: int) -> None:
        if move == 2:
            raise error

    with pytest.raises(type(error)):
        _run(RecordingDriver(before=fail), _tour(), folder)
    assert sorted(path.name for path in (folder.path / "scans").iterdir()) == ["0001.npz", "0002.npz"]
    last = _events(folder)[-1]
    assert (last["event"], last["reason"]) == (event, str(error) or "stopped by Ctrl-C")


def test_the_simulated_controller_takes_the_planned_time_on_its_own_clock(folder: ExecutionFolder) -> None:
    """The duration on the controller's clock is that of the plan, to a microsecond per segment."""
    motion, clock = _tour(), SimulatedClock()
    with open_driver("sim://", Context(KR16, clock)) as driver:
        scene = ball_cell(SCANNER)
        source = Simulated(scene, Disturbance(), 0)
        seconds = execution.drive(plan_execution(motion), driver, scene, source, folder, speed=1.0, clock=clock)
    assert seconds == pytest.approx(motion.duration, abs=1e-6 * len(motion.via_q))
    assert _events(folder)[-1]["t_s"] == pytest.approx(motion.duration, abs=1e-4)


def test_the_clock_of_events_is_the_controllers_own() -> None:
    """Events use the controller's clock, with and without a time scale."""
    cell = ball_cell(SCANNER)
    for url in ("sim://?realtime=1&time_scale=50", "sim://"):
        driver, clock = execution.make_driver(ScanOptions(driver=url), _tour(), cell)
        assert clock is driver.clock
        assert clock.simulated == (url == "sim://")


def test_executions_are_numbered_and_never_overwritten(tmp_path: Path) -> None:
    """A new execution has the number after the highest one; other entries of the folder are ignored."""
    run = Run(tmp_path, Manifest(schema=SCHEMA))
    (tmp_path / "executions" / "0041").mkdir(parents=True)
    (tmp_path / "executions" / "notes").mkdir()
    names = [ExecutionFolder.make(run, [], 0, {}, datetime(2024, 1, 2, tzinfo=UTC)).path.name for _ in range(2)]
    assert names == ["0042", "0043"]


@pytest.mark.parametrize("during", [True, False])
def test_an_arm_that_was_moved_by_hand_between_two_moves_is_not_moved_on(folder: ExecutionFolder, during: bool) -> None:
    """No move follows if the arm was moved during or after the scan of view 2."""
    driver, looks = RecordingDriver(), [0]

    def ready() -> RobotState:
        looks[0] += len(driver.moves) == 2
        if looks[0] == (1 if during else 2):
            driver.axes = driver.axes + np.int32([2000, 0, 0, 0, 0, 0])
        return driver.state()

    driver.require_ready = ready  # type: ignore[method-assign]
    with pytest.raises(DriverFailureError, match=r"did not arrive, or was moved since.*--resume"):
        _run(driver, _tour(), folder)
    assert len(driver.moves) == 2
    expected = ["0001.npz"] if during else ["0001.npz", "0002.npz"]
    assert sorted(path.name for path in (folder.path / "scans").iterdir()) == expected


@pytest.mark.parametrize("off", [1000, 300])
def test_an_arm_that_arrived_elsewhere_is_not_scanned_from_there(folder: ExecutionFolder, off: int) -> None:
    """No scan is taken if the arm reports arrival 0.1 or 0.03 deg off its set-point. This is several mm at the tool."""
    driver = RecordingDriver(off=off)
    with pytest.raises(DriverFailureError, match=r"may deviate by \d+\.\d+ mm, and 1 mm are allowed"):
        _run(driver, _tour(), folder)
    assert len(driver.moves) == 1
    assert list((folder.path / "scans").iterdir()) == []
    assert [event["event"] for event in _events(folder)] == ["connected", "move", "arrival", "failed"]


def test_an_unknown_distance_is_no_arrival(folder: ExecutionFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    """NaN is not above the tolerance, and the arm is not driven on."""
    monkeypatch.setattr(TravelBound, "__call__", lambda *_: np.full(1, np.nan))
    with pytest.raises(DriverFailureError, match="it did not arrive"):
        _run(RecordingDriver(off=1), _tour(), folder)


def test_a_full_disk_does_not_hide_why_an_execution_ended(folder: ExecutionFolder, monkeypatch) -> None:
    """Ctrl-C is raised as such, even if its event cannot be written."""

    def interrupt(move: int) -> None:
        def full(*arguments: object, **details: object) -> None:
            raise FileError("the disk is full")

        monkeypatch.setattr(folder, "event", full)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        _run(RecordingDriver(before=interrupt), _tour(), folder)


def test_a_move_that_cannot_be_journaled_is_not_made(folder: ExecutionFolder, monkeypatch) -> None:
    """If the disk is full before the second move, that move is not made. The first scan remains."""
    driver, write = RecordingDriver(), os.fsync

    def full(descriptor: int) -> None:
        if driver.moves and (folder.path / "scans" / "0001.npz").exists():
            raise OSError(errno.ENOSPC, "No space left on device")
        write(descriptor)

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(FileError, match="disk is full"):
        _run(driver, _tour(), folder)
    assert len(driver.moves) == 1
    read_scan(folder.path / "scans" / "0001.npz")


def test_a_torn_event_does_not_spoil_the_next_one(folder: ExecutionFolder) -> None:
    """An incomplete last line of the journal is removed before the next event, so that every line is valid."""
    folder.event(0.0, "connected")
    with (folder.path / "events.jsonl").open("a") as file:
        file.write('{"t_s": 0.1, "ev')
    folder.event(0.2, "move", leg=1)
    assert [event["event"] for event in _events(folder)] == ["connected", "move"]
    (folder.path / "events.jsonl").write_text('{"t_s')
    folder.event(0.3, "done")
    assert [event["event"] for event in _events(folder)] == ["done"]


def test_scans_of_a_killed_execution_are_in_its_manifest(folder: ExecutionFolder) -> None:
    """The manifest lists each scan before the next move, so that a later change of a scan is detected."""
    seen = []

    def record(move: int) -> None:
        seen.append(sorted(json.loads((folder.path / "manifest.json").read_text()).get("artefacts", {})))

    _run(RecordingDriver(before=record), _tour(), folder)
    assert seen == [[], *[[f"scans/{k + 1:04d}.npz" for k in range(n)] for n in (1, 2, 3)]]
