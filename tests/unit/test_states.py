"""`cell scan --states`: states as JSON lines."""

import json
import shutil
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from cell.errors import FileError, UsageError
from cell.runs.run import open_finished
from cell.scan.states import StateLog, record_states
from drivers.client import ControllerClient
from drivers.clock import RealTimeClock, SimulatedClock
from drivers.contract import Mode, Move, RobotState
from drivers.errors import PathError, RefusedError, StateUnknownError
from drivers.path_watch import PathWatch
from drivers.registry import Context, open_driver
from drivers.setpoints import PER_DEGREE, SetPoints, from_rad
from tests.support.arms import HOME, KR16
from tests.support.fixture_types import RunCommand

FAR = (from_rad(HOME) + PER_DEGREE * np.array([40, 0, 0, 0, 0, 0]))[None].astype(np.int32)


def rows_of(path: Path) -> list[dict]:
    """Return the lines of a file."""
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_states_of_an_execution(planned: Path, tmp_path: Path, run_cell: RunCommand) -> None:
    """Every line is on the planned path in its order, from home over all views to home; the file is appended."""
    run = Path(shutil.copytree(planned, tmp_path / "run"))
    options = ("--driver", "sim://", "--states", "states.jsonl", "--resolution", 3)
    run_cell("scan", run, *options, cwd=tmp_path, code=0)
    rows = rows_of(tmp_path / "states.jsonl")
    plan = open_finished(run)
    q = np.array([row["position"] for row in rows])
    assert {tuple(row["name"]) for row in rows} == {tuple(plan.joint_names())}
    stamps = [row["header"]["stamp"]["sec"] + 1e-9 * row["header"]["stamp"]["nanosec"] for row in rows]
    assert (np.diff(stamps) >= 0.0).all()
    assert stamps[-1] == pytest.approx(plan.motion.duration, rel=0.02)
    via, reached = plan.motion.via_q, 0
    for row, place in zip(rows, q, strict=True):
        if row["at_rest"] and reached + 1 < len(via) and np.abs(place - via[reached + 1 :]).max(axis=1).min() < 1e-6:
            reached += 1 + int(np.abs(place - via[reached + 1 :]).max(axis=1).argmin())
    assert reached == len(via) - 1
    assert {row["mode"] for row in rows} == {"idle", "moving", "in_position"}
    assert {row["fault_code"] for row in rows} == {0}
    assert "states" not in json.loads((run / "executions" / "0001" / "manifest.json").read_text())["options"]
    run_cell("scan", run, *options, cwd=tmp_path, code=0)
    assert len(rows_of(tmp_path / "states.jsonl")) == 2 * len(rows)
    refused = run_cell("scan", run, "--states", "no/states.jsonl", cwd=tmp_path, code=6)
    assert "no/states.jsonl cannot be written" in refused.stderr


def test_a_line_has_units_and_names(tmp_path: Path) -> None:
    """Radians, UTC, mode and fault in words."""
    axes = from_rad(np.radians([10.0, -90.0, 90.0, 0.0, 90.0, -45.5]))
    state = RobotState(Mode.FAULT, axes, True, fault_code=4001, fault_message="the watchdog", path=2500, override=5000)
    log = StateLog(tmp_path / "states.jsonl", [f"joint_{k}" for k in range(6)], RealTimeClock())
    log.record(state)
    (row,) = rows_of(tmp_path / "states.jsonl")
    stamp = row.pop("header")["stamp"]
    assert stamp["sec"] + 1e-9 * stamp["nanosec"] == pytest.approx(time.time(), abs=5.0)
    np.testing.assert_allclose(row.pop("position"), np.radians([10.0, -90.0, 90.0, 0.0, 90.0, -45.5]), atol=1e-9)
    assert row == {
        "name": [f"joint_{k}" for k in range(6)], "mode": "fault", "at_rest": True, "fault_code": 4001,
        "fault_message": "the watchdog", "path": 0.25, "override": 0.5,
    }  # fmt: skip


def test_a_file_that_fails_stops_the_arm(tmp_path: Path) -> None:
    """The move ends with the cause, the arm is at rest on its path, and the driver can be closed."""
    clock, folder = SimulatedClock(), tmp_path / "states"
    folder.mkdir()
    driver = open_driver("sim://", Context(KR16, clock))
    record_states(driver, clock, folder / "states.jsonl", ["A1"])
    with driver:
        record = driver.on_state  # type: ignore[attr-defined]
        seen: list[RobotState] = []

        def remove(state: RobotState) -> None:
            seen.append(state)
            if len(seen) == 8:
                shutil.rmtree(folder)
            record(state)

        driver.on_state = remove  # type: ignore[attr-defined]
        with pytest.raises(FileError, match=r"states\.jsonl cannot be written"):
            driver.move(FAR, 0.3)
        while not (state := driver.state()).at_rest:
            clock.wait(0.01)
        assert from_rad(HOME)[0] < state.axes[0] < FAR[0, 0]


@pytest.mark.parametrize("cause", [KeyboardInterrupt(), PathError("the arm has left its path")])
def test_a_file_that_fails_during_a_stop_does_not_replace_the_cause(
    cause: BaseException, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The arm is at rest, the cause is raised and is not forgotten, and the failure of the file is a note."""
    clock, folder, notes = SimulatedClock(), tmp_path / "states", list[str]()
    folder.mkdir()
    driver = open_driver("sim://", Context(KR16, clock, notify=notes.append))
    assert isinstance(driver, ControllerClient)
    record_states(driver, clock, folder / "states.jsonl", ["A1"])
    seen: list[SetPoints] = []

    def update(watch: PathWatch, axes: SetPoints, now: float) -> None:
        seen.append(axes)
        if len(seen) == 5:
            shutil.rmtree(folder)
            raise cause

    monkeypatch.setattr(PathWatch, "update", update)
    with driver:
        with pytest.raises(type(cause)) as raised:
            driver.move(FAR, 0.3)
        assert raised.value is cause
        assert len(notes) == 1
        assert "states.jsonl cannot be written" in notes[0]
        assert driver.state().at_rest
        if isinstance(cause, PathError):
            with pytest.raises(StateUnknownError, match="the arm has left its path"):
                driver.move(from_rad(HOME)[None], 0.3)


def test_a_file_that_fails_during_a_stop_is_raised_at_rest(tmp_path: Path) -> None:
    """A stop without a cause of its own ends with the failure, after the arm is at rest."""
    clock, folder = SimulatedClock(), tmp_path / "states"
    folder.mkdir()
    driver = open_driver("sim://", Context(KR16, clock))
    assert isinstance(driver, ControllerClient)
    record_states(driver, clock, folder / "states.jsonl", ["A1"])
    with driver:
        driver.take()
        driver._ledger.send(Move(FAR, 0.3))
        clock.wait(0.5)
        shutil.rmtree(folder)
        with pytest.raises(FileError, match=r"states\.jsonl cannot be written"):
            driver.stop()
        state = driver.state()
        assert state.at_rest
        assert from_rad(HOME)[0] < state.axes[0] < FAR[0, 0]


def test_a_fault_is_kept_if_its_state_cannot_be_written() -> None:
    """The reset stays necessary, although the controller reports the fault only once."""
    driver = open_driver("sim://", Context(KR16, SimulatedClock()))
    assert isinstance(driver, ControllerClient)

    def fail(state: RobotState) -> None:
        raise FileError("states.jsonl cannot be written")

    with driver:
        state = driver.state()
        read, driver.on_state = driver._link.state, fail
        driver._link.state = lambda: replace(state, mode=Mode.FAULT, fault_code=4001)  # type: ignore[method-assign]
        with pytest.raises(FileError):
            driver.state()
        driver._link.state, driver.on_state = read, None  # type: ignore[method-assign]
        with pytest.raises(RefusedError, match="no longer reported and was not reset"):
            driver.require_ready()


def test_a_file_without_states_is_not_left_behind(tmp_path: Path) -> None:
    """The file begins with its first line; an earlier file is kept."""
    path = tmp_path / "states.jsonl"
    log = StateLog(path, ["A1"], SimulatedClock())
    assert not path.exists()
    log.record(RobotState(Mode.IDLE, from_rad(HOME), True))
    content = path.read_bytes()
    assert len(rows_of(path)) == 1
    StateLog(path, ["A1"], SimulatedClock())
    assert path.read_bytes() == content


def test_another_driver_is_refused(tmp_path: Path) -> None:
    """Only the project's client knows each state."""
    with pytest.raises(UsageError, match="SimpleNamespace is none"):
        record_states(SimpleNamespace(), SimulatedClock(), tmp_path / "states.jsonl", [])  # type: ignore[arg-type]
