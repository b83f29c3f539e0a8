"""Lost and doubled scans after kill -9 of the client or the emulated controller at random moments, then `--resume`.

A plan of a small part is executed over Modbus. Each trial kills one of the two processes at a random moment between the
start of the execution and its last scan (timed on an undisturbed execution), restarts the killed process, resumes until
the execution is finished, and compares its scans with those of the undisturbed execution, byte by byte. `KILLS` in the
environment changes the 50 trials of each kind.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from cell.runs.run import open_finished

_PLAN = ("plan", "petanque", "--place", "1100,400,100", "--faces", "120", "--samples", "2", "--seed", "3")
_TIME_SCALE = "2"
_SCAN = ("--resolution", "4", "--speed", "1", "--accept-time-scale", _TIME_SCALE)
_PATIENCE_S = 120.0


def run() -> list[dict[str, Any]]:
    """Return one row for each kind of killed process."""
    count = int(os.environ.get("KILLS", "50"))
    with tempfile.TemporaryDirectory() as folder:
        base = Path(folder)
        _cell(base, *_PLAN, "--out", "plan")
        shutil.copytree(base / "plan", base / "calm")
        word = _word(open_finished(base / "plan").digest)
        with _Emulator(base / "calm_arm") as emulator:
            span_s = _span_s(base / "calm", _start(base, "scan", "calm", "--driver", emulator.url, *_SCAN, *word))
        reference = _scans(base / "calm")
        return [_row(base, victim, count, reference, span_s) for victim in ("client", "controller")]


def _row(base: Path, victim: str, count: int, reference: dict[str, bytes], span_s: float) -> dict[str, Any]:
    rng = np.random.default_rng(7)
    same, twice, resumed, after = 0, 0, 0, []
    for trial in range(count):
        name = f"{victim}{trial}"
        shutil.copytree(base / "plan", base / name)
        scans, times = _disturbed(base, name, victim, rng, span_s)
        after.append(scans)
        resumed += times
        same += _scans(base / name) == reference
        events = [json.loads(line) for line in (base / name / "executions/0001/events.jsonl").read_text().splitlines()]
        numbers = [event["number"] for event in events if event["event"] == "scan"]
        twice += len(numbers) - len(set(numbers))
        shutil.rmtree(base / name)
    return {
        "killed": victim,
        "trials": count,
        "scans equal to the calm ones": same,
        "scans recorded twice": twice,
        "resumed": resumed,
        "scans there when killed": f"{min(after)} to {max(after)} of {len(reference)}",
    }


def _disturbed(base: Path, name: str, victim: str, rng: np.random.Generator, span_s: float) -> tuple[int, int]:
    """Execute, kill and resume; return the scans at the moment of the kill, and the number of resumptions."""
    arm = base / f"{name}_arm"
    emulator = _Emulator(arm)
    try:
        word = _word(open_finished(base / name).digest)
        client = _start(base, "scan", name, "--driver", emulator.url, *_SCAN, *word)
        _begun_s(base / name, client)
        time.sleep(float(rng.uniform(0.0, span_s)))
        os.kill((client if victim == "client" else emulator.process).pid, signal.SIGKILL)
        client.wait(_PATIENCE_S)
        there = len(_scans(base / name))
        if victim == "controller":
            emulator.close()
            emulator = _Emulator(arm)
        times = 0
        while json.loads((base / name / "executions/0001/manifest.json").read_text())["status"] != "finished":
            process = subprocess.run(
                [*_COMMAND, "scan", name, "--resume", "latest", "--reset", "--driver", emulator.url,
                 *word, "--speed", "1", "--accept-time-scale", _TIME_SCALE],
                cwd=base, capture_output=True, text=True, timeout=_PATIENCE_S, check=False,
            )  # fmt: skip
            if own := re.search("not the digest of the new path.* which is ([0-9a-f]+)", process.stderr):
                word = _word(own[1])
                continue
            times += 1
            if process.returncode and times >= 3:
                raise RuntimeError(f"{name} could not be resumed: {process.stderr}")
        return there, times
    finally:
        emulator.close()


def _word(digest: str) -> tuple[str, str]:
    """Return the option that confirms the motion with this digest."""
    return "--confirm-motion", digest


def _begun_s(run: Path, client: subprocess.Popen[bytes]) -> float:
    """Return the time at which the journal of the execution began, on the monotonic clock."""
    deadline = time.monotonic() + _PATIENCE_S
    while not (run / "executions/0001/events.jsonl").exists():
        if client.poll() is not None or time.monotonic() > deadline:
            raise RuntimeError("the execution did not begin")
        time.sleep(0.005)
    return time.monotonic()


def _span_s(run: Path, client: subprocess.Popen[bytes]) -> float:
    """Return the time from the beginning of an undisturbed execution to its last scan."""
    begun, last, seen = _begun_s(run, client), 0.0, 0
    while client.poll() is None:
        if (count := len(list((run / "executions/0001/scans").glob("*.npz")))) > seen:
            seen, last = count, time.monotonic()
        time.sleep(0.01)
    if client.returncode or not seen:
        raise RuntimeError(f"the undisturbed execution ended with {client.returncode} and {seen} scans")
    return last - begun


_COMMAND = (sys.executable, "-m", "cell")


class _Emulator:
    """`cell emulate modbus` with the state of its arm in a file."""

    def __init__(self, arm: Path) -> None:
        self.process = subprocess.Popen(
            [*_COMMAND, "emulate", "modbus", "--time-scale", _TIME_SCALE, "--state", str(arm)],
            stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        )  # fmt: skip
        assert self.process.stdout is not None
        self.url = self.process.stdout.readline().strip()

    def close(self) -> None:
        """Kill the process."""
        self.process.kill()
        self.process.wait()
        if self.process.stdout is not None:
            self.process.stdout.close()

    def __enter__(self) -> _Emulator:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _start(base: Path, *arguments: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [*_COMMAND, *arguments], cwd=base, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )  # fmt: skip


def _cell(base: Path, *arguments: str) -> None:
    process = subprocess.run([*_COMMAND, *arguments], cwd=base, capture_output=True, text=True, check=False)
    if process.returncode:
        raise RuntimeError(f"cell {' '.join(arguments)}: {process.stderr}")


def _scans(run: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted((run / "executions/0001/scans").glob("*.npz"))}
