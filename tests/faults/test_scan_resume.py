"""Resumed executions scan every view exactly once with equal bytes, after any interruption.

The full form, 50 kills of client and emulator each, is `python -m benchmarks kills`.
"""

import json
import os
import re
import shutil
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.errors import UsageError
from cell.runs.run import open_finished
from cell.scan.options import ScanOptions
from cell.scan.scan import resume
from cell.session import Session
from tests.support.fixture_types import Emulate, RunCommand, StartCommand

_FAST = ("--time-scale", "20")


def _scans(execution: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted((execution / "scans").glob("*.npz"))}


def _events(execution: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (execution / "events.jsonl").read_text().splitlines()]


@pytest.fixture
def run_folder(planned: Path, tmp_path: Path) -> Path:
    """Return a new finished plan without executions."""
    return Path(shutil.copytree(planned, tmp_path / "run"))


@pytest.fixture
def executed_folder(executed: Path, tmp_path: Path) -> Path:
    """Return a new plan with a finished execution."""
    return Path(shutil.copytree(executed, tmp_path / "run"))


@pytest.fixture(scope="module")
def undisturbed(executed: Path) -> dict[str, bytes]:
    """Return the scans of an undisturbed execution."""
    scans = _scans(executed / "executions" / "0001")
    assert len(scans) >= 3
    return scans


_SCALE = ("--accept-time-scale", "20")
_BEGIN = ("--resolution", "1", "--speed", "1")


def _word(run: Path) -> tuple[str, str]:
    """Return the confirmation of the plan's motion."""
    return "--confirm-motion", open_finished(run).digest


def _path_confirmation(process: "subprocess.CompletedProcess[str]") -> tuple[str, str]:
    """Return the confirmation of a new path, which the refusal of the plan's digest names. The arm has not moved."""
    assert process.returncode == 2, process.stderr
    match = re.search(r"which is ([0-9a-f]{8})", process.stderr)
    assert match, process.stderr
    return "--confirm-motion", match[1]


def _wait_for_scans(run: Path, count: int, process: "subprocess.Popen[str]") -> None:
    deadline = time.monotonic() + 120
    while len(list((run / "executions").glob("0001/scans/*.npz"))) < count:
        assert process.poll() is None, process.stderr.read() if process.stderr else ""
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.mark.parametrize("protocol", ["modbus", pytest.param("serial", marks=pytest.mark.slow)])
def test_a_killed_client_goes_on_and_scans_every_view_once(
    protocol: str,
    run_folder: Path,
    undisturbed: dict[str, bytes],
    emulate: Emulate,
    run_cell: RunCommand,
    start_cell: StartCommand,
) -> None:
    """After SIGKILL the controller stops by itself; the resumed scans equal those of an undisturbed execution."""
    emulated = emulate(protocol, *_FAST)
    process = start_cell("scan", run_folder, *_BEGIN, *_SCALE, *_word(run_folder), "--driver", emulated.url)
    _wait_for_scans(run_folder, 1, process)
    os.kill(process.pid, signal.SIGKILL)
    process.communicate()
    left = len(_scans(run_folder / "executions" / "0001"))
    assert 1 <= left < len(undisturbed)
    again = ("scan", str(run_folder), "--resume", "latest", "--speed", "1", *_SCALE)
    completed = run_cell(*again, *_word(run_folder), "--reset", cwd=run_folder.parent)
    word = (
        _path_confirmation(completed) if completed.returncode else _word(run_folder)
    )  # depends on the position at which the arm stopped
    if completed.returncode:
        completed = run_cell(*again, *word, "--reset", cwd=run_folder.parent)
    assert completed.returncode == 0, completed.stderr
    assert f"{left} views are scanned already" in completed.stderr
    execution = run_folder / "executions" / "0001"
    assert _scans(execution) == undisturbed
    assert [event["number"] for event in _events(execution) if event["event"] == "scan"] == sorted(
        {event["number"] for event in _events(execution) if event["event"] == "scan"}
    )
    manifest = json.loads((execution / "manifest.json").read_text())
    assert manifest["status"] == "finished"
    assert len(manifest["resumptions"]) == 1
    assert manifest["digest"] == open_finished(run_folder).digest
    assert (manifest["resumptions"][0].get("path_digest", "")[:8] == word[1]) == (word != _word(run_folder))
    completed = run_cell(*again, cwd=run_folder.parent, code=2)
    assert "nothing to resume" in completed.stderr


def test_a_killed_controller_keeps_the_arm_where_it_is_and_the_client_goes_on(
    run_folder: Path, undisturbed: dict[str, bytes], emulate: Emulate, run_cell: RunCommand, start_cell: StartCommand
) -> None:
    """A killed emulator gives exit code 5; after its restart the arm is at the same position."""
    emulated = emulate("modbus", *_FAST)
    process = start_cell("scan", run_folder, *_BEGIN, *_SCALE, *_word(run_folder), "--driver", emulated.url)
    _wait_for_scans(run_folder, 1, process)
    os.kill(emulated.process.pid, signal.SIGKILL)
    _, output = process.communicate(timeout=120)
    assert process.returncode == 5, output
    restarted = emulate("modbus", *_FAST, partner=emulated)
    again = ("scan", run_folder, "--resume", "0001", "--driver", restarted.url, "--speed", "1", "--reset", *_SCALE)
    completed = run_cell(*again, *_word(run_folder), cwd=run_folder.parent)
    if completed.returncode:
        completed = run_cell(*again, *_path_confirmation(completed), cwd=run_folder.parent)
    assert completed.returncode == 0, completed.stderr
    assert _scans(run_folder / "executions" / "0001") == undisturbed


def test_an_arm_that_stands_elsewhere_goes_on_a_new_free_way(
    executed_folder: Path, undisturbed: dict[str, bytes], run_cell: RunCommand
) -> None:
    """After a failure the simulated arm is at home again. A new path to the first missing view is planned."""
    execution = executed_folder / "executions" / "0001"
    manifest = json.loads((execution / "manifest.json").read_text())
    missing = [name for name in sorted(undisturbed) if name != "0001.npz"]
    for name in missing:
        (execution / "scans" / name).unlink()
    (execution / "manifest.json").write_text(json.dumps({**manifest, "status": "failed"}))
    process = run_cell("scan", executed_folder, "--resume", "latest", cwd=executed_folder.parent, code=0)
    assert "a new path to view 2 was planned" in process.stderr
    assert _scans(execution) == undisturbed


@pytest.fixture(scope="module")
def standing(emulate_for_all: Emulate) -> Any:
    """Yield a controller whose arm the tests do not move."""
    return emulate_for_all("modbus", *_FAST)


class _NoteReporter:
    """A reporter that keeps its notes."""

    def __init__(self) -> None:
        self.notes: list[str] = []

    def note(self, sentence: str) -> None:
        self.notes.append(sentence)


def test_the_new_path_is_reported_before_the_confirmation(executed_folder: Path, standing: Any) -> None:
    """The new path is reported before the question. Without a yes, no motion starts and the files are unchanged."""
    execution = executed_folder / "executions" / "0001"
    for name in list(_scans(execution))[1:]:
        (execution / "scans" / name).unlink()
    manifest = json.loads((execution / "manifest.json").read_text())
    (execution / "manifest.json").write_text(json.dumps({**manifest, "status": "failed"}))
    content = (execution / "manifest.json").read_bytes()
    reporter, known = _NoteReporter(), []

    def ask(question: str) -> str:
        known.extend([*reporter.notes, question])
        return "no"

    options = ScanOptions(driver=str(standing.url), speed=0.5, accept_time_scale=20.0)
    with pytest.raises(UsageError, match="nothing was moved"):
        resume(Session(None, reporter, confirm=ask), executed_folder, "latest", options)
    assert "a new path to view 2 was planned" in known[1]
    assert "the path watch stops a deviating arm before contact up to" in known[2]
    assert "Type yes" in known[3]
    assert standing.entries("move") == []
    assert (execution / "manifest.json").read_bytes() == content


@pytest.mark.parametrize(
    ("status", "torn"), [("failed", True), pytest.param("finished", True, marks=pytest.mark.slow), ("finished", False)]
)
def test_a_damaged_or_missing_scan_is_taken_again_and_the_others_are_not(
    status: str, torn: bool, executed_folder: Path, undisturbed: dict[str, bytes], run_cell: RunCommand
) -> None:
    """The arm passes the views with valid scans without scanning them, for every status of the execution."""
    execution = executed_folder / "executions" / "0001"
    (execution / "scans" / "0002.npz").write_bytes(b"torn")
    if not torn:
        (execution / "scans" / "0002.npz").rename(execution / "scans" / "0099.npz")  # the name of no view
    manifest = json.loads((execution / "manifest.json").read_text())
    (execution / "manifest.json").write_text(json.dumps({**manifest, "status": status}))
    before = len(_events(execution))
    process = run_cell("scan", executed_folder, "--resume", "latest", cwd=executed_folder.parent, code=0)
    assert ("0002.npz" if torn else "0099.npz") in process.stderr
    assert "1 remain (2)" in process.stderr
    (execution / "scans" / "0099.npz").unlink(missing_ok=True)
    assert run_cell("scan", executed_folder, "--report", "latest", cwd=executed_folder.parent).returncode == 0
    assert [event["number"] for event in _events(execution)[before:] if event["event"] == "scan"] == [2]
    assert _scans(execution) == undisturbed


@pytest.mark.parametrize(
    "protocol", ["modbus-rtu", *(pytest.param(each, marks=pytest.mark.slow) for each in ("serial", "modbus"))]
)
def test_every_wire_gives_the_same_scans_to_the_bit(
    protocol: str, run_folder: Path, undisturbed: dict[str, bytes], emulate: Emulate, run_cell: RunCommand
) -> None:
    """Set-points are integers on every wire, so the reported poses are the same numbers."""
    emulated = emulate(protocol, "--time-scale", "1000")
    run_cell(
        "scan", str(run_folder), *_BEGIN, *_word(run_folder), "--accept-time-scale", "1000", "--driver", emulated.url,
        cwd=run_folder.parent, code=0,
    )  # fmt: skip
    assert _scans(run_folder / "executions" / "0001") == undisturbed
    moved = [entry for entry in emulated.entries("move")]
    assert len(moved) >= len(undisturbed)


def test_hardware_is_refused_without_confirmation(run_folder: Path, standing: Any, run_cell: RunCommand) -> None:
    """Without a terminal and --confirm-motion the command exits with 2, without execution or move."""
    process = run_cell("scan", str(run_folder), "--driver", standing.url, cwd=run_folder.parent, code=2)
    assert f"--confirm-motion {_word(run_folder)[1][:8]}" in process.stderr
    assert _path_confirmation(
        run_cell("scan", run_folder, "--driver", standing.url, "--confirm-motion", "0" * 8, cwd=run_folder)
    )
    assert not (run_folder / "executions").exists()
    assert standing.entries("move") == []


def test_an_arm_that_does_not_stand_at_the_plan_s_start_is_not_moved(
    run_folder: Path, emulate: Emulate, run_cell: RunCommand
) -> None:
    """The arm is not moved, because no path from its position to the start is checked."""
    emulated = emulate("modbus", *_FAST, "--start", "5,-90,90,0,90,0")
    process = run_cell(
        "scan", str(run_folder), "--driver", emulated.url, *_word(run_folder), *_SCALE, cwd=run_folder.parent, code=5
    )
    assert "the plan begins at" in process.stderr
    assert emulated.entries("move") == []


@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        ({"status": "failed", "digest": "another"}, 6, "does not belong to the current plan"),
        ({"status": "failed", "options": None}, 6, "manifest.json"),
    ],
    ids=["other plan", "damaged"],
)
def test_executions_that_cannot_be_resumed_are_refused_with_the_reason(
    change: dict[str, Any], code: int, words: str, run_folder: Path, run_cell: RunCommand
) -> None:
    """The command reports one sentence and its exit code, and the execution is unchanged."""
    execution = run_folder / "executions" / "0001"
    (execution / "scans").mkdir(parents=True)
    digest = open_finished(run_folder).digest
    manifest = {"schema": "scan-cell/run/1", "status": "failed", "digest": digest, "seed": 3, "options": {}, **change}
    (execution / "manifest.json").write_text(json.dumps(manifest))
    content = (execution / "manifest.json").read_bytes()
    process = run_cell("scan", str(run_folder), "--resume", "latest", cwd=run_folder.parent, code=code)
    assert words in process.stderr
    assert (execution / "manifest.json").read_bytes() == content


def test_options_of_a_new_scan_are_refused_beside_resume(run_folder: Path, run_cell: RunCommand) -> None:
    """Options of a new scan are refused with --resume."""
    process = run_cell(
        "scan", str(run_folder), "--resume", "latest", "--resolution", "1", cwd=run_folder.parent, code=2
    )
    assert "--resume keeps the options" in process.stderr
    assert np.array_equal(list((run_folder).glob("executions")), [])


def test_a_finished_execution_of_one_view_is_taken_up_where_that_view_is_lost(
    run_folder: Path, run_cell: RunCommand
) -> None:
    """With all scans missing the execution is resumed, and results of an earlier report are removed."""
    run_cell("scan", str(run_folder), "--resolution", "2", "--view", "2", cwd=run_folder.parent)
    execution = run_folder / "executions" / "0001"
    (scan,) = _scans(execution).values()
    again = ("scan", str(run_folder), "--resume", "latest")
    assert run_cell(*again, cwd=run_folder.parent).returncode == 2
    (execution / "scans" / "0002.npz").unlink()
    run_cell(*again, "--driver", "modbus://127.0.0.1:1", *_word(run_folder), cwd=run_folder.parent, code=5)
    assert (execution / "report.json").exists()
    run_cell(*again, cwd=run_folder.parent, code=0)
    assert _scans(execution) == {"0002.npz": scan}
    manifest = json.loads((execution / "manifest.json").read_text())
    assert manifest["status"] == "finished"
    assert "reason" not in manifest
    assert all((execution / name).exists() for name in manifest["artefacts"])
