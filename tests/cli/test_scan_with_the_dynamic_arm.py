"""`cell scan --driver sim://?plant=mujoco`: scans from reported poses, and no scan from a diverged arm."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.cli.terminal import Terminal
from cell.robot.arm import kinematics_of
from cell.robot.model import load
from cell.runs.run import open_run
from cell.scan import scan as scan_command
from cell.scan.options import ScanOptions
from cell.session import Session
from tests.support.fixture_types import RunCommand

URL = "sim://?plant=mujoco"


@pytest.fixture(scope="module")
def scanned(planned: Path, tmp_path_factory: pytest.TempPathFactory, run_cell: RunCommand) -> Path:
    """Return a copy of the small run, executed with the dynamic arm (0001, 0002) and with the ideal one (0003)."""
    run = tmp_path_factory.mktemp("dynamic") / "run"
    shutil.copytree(planned, run)
    run_cell("scan", "run", "--driver", URL, "--resolution", "2", "--json", cwd=run.parent, code=0)
    for url in (URL, "sim://"):
        options = ScanOptions(driver=url, resolution_deg=2.0)
        assert scan_command.scan(Session(None, Terminal(quiet_stdout=True)), run, options).exit_code == 0
    return run


def scans(run: Path, execution: str) -> list[dict[str, Any]]:
    """Return the content of the scan files in order."""
    return [dict(np.load(path)) for path in sorted((run / "executions" / execution / "scans").iterdir())]


def test_every_scan_is_taken_from_the_reported_pose(scanned: Path) -> None:
    """The reported axes are near the commanded ones but not equal. The stored poses follow the reported axes."""
    record = open_run(scanned)
    scene = record.scene
    T_base_object, T_flange_scanner = scene.T_base_object, scene.T_flange_scanner
    kinematics = kinematics_of(load())
    ideal = scans(scanned, "0003")
    dynamic = scans(scanned, "0001")
    assert len(dynamic) == len(ideal) > 1
    for scan, without in zip(dynamic, ideal, strict=True):
        assert not (scan["q_reported"] == scan["q_commanded"]).all()
        poses = kinematics.forward(np.stack([scan["q_reported"], scan["q_commanded"]])) @ T_flange_scanner
        assert 1e-7 < np.linalg.norm(poses[0, :3, 3] - poses[1, :3, 3]) < 5.5e-5
        np.testing.assert_allclose(scan["T_object_scanner"], np.linalg.inv(T_base_object) @ poses[0], atol=1e-12)
        np.testing.assert_array_equal(scan["T_object_scanner_true"], scan["T_object_scanner"])
        assert (without["q_reported"] == without["q_commanded"]).all()
        assert abs(len(scan["points"]) - len(without["points"])) < 0.05 * len(without["points"])


def test_equal_executions_are_equal_byte_for_byte(scanned: Path) -> None:
    """Scans and events are equal, except for the wall clock."""
    names = sorted(path.name for path in (scanned / "executions" / "0001" / "scans").iterdir())
    for name in names:
        first, second = (scanned / "executions" / number / "scans" / name for number in ("0001", "0002"))
        assert first.read_bytes() == second.read_bytes()
    events = []
    for number in ("0001", "0002"):
        lines = (scanned / "executions" / number / "events.jsonl").read_text().splitlines()
        events.append([{key: value for key, value in json.loads(line).items() if key != "utc"} for line in lines])
    assert events[0] == events[1]


def test_the_report_has_the_time_of_the_arm(scanned: Path) -> None:
    """The time exceeds that of the ideal arm by at most half a second at each stop."""
    reports = [json.loads((scanned / "executions" / n / "report.json").read_text()) for n in ("0001", "0003")]
    extra = reports[0]["motion"]["executed_s"] - reports[1]["motion"]["executed_s"]
    stops = reports[0]["n_views"] + 1
    assert 0.02 * stops < extra < 0.5 * stops


def test_replay_shows_the_reported_stops(scanned: Path) -> None:
    """The timeline of the execution rests at the reported axes."""
    from cell.runs.run import read_execution
    from cell.runs.timeline import execution_timeline

    record = open_run(scanned)
    motion = record.motion
    recorded = read_execution(record, "0001")
    timeline = execution_timeline(recorded, motion, motion.via_q[0])
    for scan in scans(scanned, "0001"):
        at_rest = np.abs(timeline.q - scan["q_reported"]).max(axis=1) == 0.0
        assert at_rest.any()
