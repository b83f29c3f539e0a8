"""SIGINT, SIGTERM and SIGHUP at random moments of an execution: the signal is named, and a resume completes it."""

import os
import re
import shutil
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from cell.runs.run import open_finished
from cell.scan import safety
from tests.support.fixture_types import Emulate, RunCommand, StartCommand

SIGNALS = {"SIGINT": "Ctrl-C", "SIGTERM": "SIGTERM", "SIGHUP": "SIGHUP"}
MOMENTS = [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 34))]
_FAST = ("--speed", "1", "--accept-time-scale", "20")


@pytest.fixture
def run_folder(planned: Path, tmp_path: Path) -> Path:
    """Return a new finished plan without executions."""
    return Path(shutil.copytree(planned, tmp_path / "run"))


def _scans(run: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted((run / "executions" / "0001" / "scans").glob("*.npz"))}


@pytest.mark.parametrize("moment", MOMENTS)
@pytest.mark.parametrize(
    ("protocol", "name"),
    [
        ("modbus", "SIGTERM"),
        pytest.param("serial", "SIGINT", marks=pytest.mark.slow),
        pytest.param("modbus-rtu", "SIGHUP", marks=pytest.mark.slow),
    ],
)
def test_a_signal_ends_an_execution_that_goes_on_later(
    protocol: str,
    name: str,
    moment: int,
    run_folder: Path,
    executed: Path,
    emulate: Emulate,
    start_cell: StartCommand,
    run_cell: RunCommand,
) -> None:
    """The arm stops, the process exits with the code of its signal, and the resumed scans have equal bytes."""
    rng = np.random.default_rng([moment, list(SIGNALS).index(name)])
    emulated = emulate(protocol, "--time-scale", "20")
    word = ("--confirm-motion", open_finished(run_folder).digest)
    process = start_cell("scan", run_folder, "--resolution", "1", *_FAST, *word, "--driver", emulated.url)
    deadline = time.monotonic() + 120
    while not emulated.entries("move"):
        assert time.monotonic() < deadline
        assert process.poll() is None, process.stderr.read() if process.stderr else ""
        time.sleep(0.005)
    time.sleep(float(rng.uniform(0.0, 0.5)))
    os.kill(process.pid, getattr(signal, name))
    sent = time.monotonic()
    _, output = process.communicate(timeout=60)
    if process.returncode == 130:  # otherwise the process ended before the signal
        assert time.monotonic() - sent < 4.0  # 2 s, and a machine with other work
        assert f"stopped by {SIGNALS[name]}" in output
    again = ("scan", str(run_folder), "--resume", "latest", *_FAST, "--reset")
    completed = run_cell(*again, *word, cwd=run_folder.parent)
    if own := re.search("not the digest of the new path.* which is ([0-9a-f]+)", completed.stderr):
        completed = run_cell(*again, "--confirm-motion", own[1], cwd=run_folder.parent)
    assert completed.returncode == (0 if process.returncode == 130 else 2), completed.stderr
    assert _scans(run_folder) == {
        path.name: path.read_bytes() for path in sorted((executed / "executions" / "0001" / "scans").glob("*.npz"))
    }


def test_two_processes_cannot_work_on_one_execution(executed: Path, tmp_path: Path, run_cell: RunCommand) -> None:
    """An execution that another process holds is refused at once."""
    run_folder = Path(shutil.copytree(executed, tmp_path / "run"))
    (run_folder / "executions" / "0001" / "scans" / "0002.npz").unlink()
    with safety.exclusive(run_folder / "executions" / "0001"):
        process = run_cell("scan", str(run_folder), "--resume", "latest", cwd=run_folder.parent)
    assert process.returncode == 6, process.stderr
    assert "another process uses execution 0001" in process.stderr


@pytest.mark.parametrize("resolution", ["1e-9", "1e-3"])
def test_rays_beyond_memory_are_refused_before_the_first_move(
    resolution: str, run_folder: Path, run_cell: RunCommand, emulate: Emulate
) -> None:
    """A resolution with more rays than memory ends with exit code 2 before the first move."""
    emulated = emulate("modbus", "--time-scale", "20")
    process = run_cell(
        "scan",
        str(run_folder),
        "--resolution",
        resolution,
        *_FAST,
        "--driver",
        emulated.url,
        cwd=run_folder.parent,
        code=2,
    )
    assert "nothing was moved" in process.stderr
    assert emulated.entries("move") == []
    assert not (run_folder / "executions").exists()
