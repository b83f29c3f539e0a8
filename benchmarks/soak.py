"""Thousands of moves over a disturbed wire, and their comparison with the controller's journal.

An emulated controller runs in a separate process with 1 % of every fault. A client commands random moves and recovers
from failures: it stops if the state is unknown, resets a latched fault, and continues from the arm's position.
Afterwards the commanded moves are compared with the journal:

- no move began twice, out of order, or without a command; a move that returned was completed, a refused one never
  began;
- the arm was on the commanded path whenever it was stopped;
- every latched fault was reported to the client under its own code.

`SOAK_MOVES` and `SOAK_BACKENDS` in the environment change the 2,000 moves and the three back ends; `SOAK_RUN` names a
run folder whose axes are moved, seven if it has a rotary table.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.robot import model as robot
from cell.runs.run import open_run
from drivers.contract import Driver, Fault
from drivers.errors import (
    DriverError,
    FaultError,
    LinkError,
    RefusedError,
    StateUnknownError,
    StoppedError,
)
from drivers.limits import Limits
from drivers.registry import Context, open_driver
from drivers.setpoints import SetPoints

KR16 = Limits.from_rad(robot.limits(robot.load()))

BACKENDS = ("serial", "modbus", "modbus-rtu")
EVERY_FAULT = (
    "drop=0.01,delay=0.01:0.1,duplicate=0.01,reorder=0.01:0.1,corrupt=0.01,truncate=0.01,exception=0.01,"
    "half-open=0.01:0.6,reboot=0.01:0.2,estop=0.01:0.2"
)
STREAM_FAULTS = (
    "drop=0.01,delay=0.01:0.1,duplicate=0.01,exception=0.01,half-open=0.01:0.6,reboot=0.01:0.2,estop=0.01:0.2"
)
"""Faults of a protocol without a checksum of its own: TCP delivers each message whole, or not at all."""

FAULTS = {"kvp": STREAM_FAULTS}
"""Faults of the protocols that do not have every fault. Their emulators run in real time."""

TIME_SCALE = 20.0
PATIENCE = "timeout_ms=80&watchdog_ms=500&poll_ms=10"
MOST_RECOVERIES = 300
"""Attempts, 20 ms apart at least, after which a driver is given up: a failure of the soak."""

Counts = NDArray[np.int64]


@dataclass
class Soak:
    """Commanded moves and reports to the client.

    Attributes:
        commanded: set-points and outcome of each move, in order: "done", "refused", "stopped", "fault", "unknown".
        reported: fault codes reported to the client, once in each recovery, in order.
        outcomes: number of each outcome.
        seconds: wall time [s].
        wait: function that lets seconds pass.
    """

    commanded: list[tuple[SetPoints, str]] = field(default_factory=list)
    reported: list[int] = field(default_factory=list)
    outcomes: Counter[str] = field(default_factory=Counter)
    seconds: float = 0.0
    wait: Callable[[float], None] = time.sleep


def drive(driver: Driver, moves: int, rng: np.random.Generator, wait: Callable[[float], None] = time.sleep) -> Soak:
    """Command random moves, and recover from all failures.

    Args:
        driver: not yet connected.
        moves: number of moves.
        rng: random stream of the moves.
        wait: function that lets seconds pass before another attempt to recover.

    Raises:
        DriverError: if the driver cannot be recovered.
    """
    soak, began = Soak(wait=wait), time.perf_counter()
    _retry(soak, driver.connect)
    try:
        _recover(driver, soak)
        for _ in range(moves):
            points = _random_points(driver, soak, rng)
            outcome, code = _move(driver, points)
            soak.commanded.append((points, outcome))
            soak.outcomes[outcome] += 1
            if outcome != "done":
                _recover(driver, soak, code)
    finally:
        driver.close()
    soak.seconds = time.perf_counter() - began
    return soak


def _move(driver: Driver, points: SetPoints) -> tuple[str, int]:
    """Command one move; return its outcome and the fault that ended it."""
    try:
        state = driver.move(points, 1.0)
    except FaultError as fault:
        return "fault", fault.code
    except StoppedError:
        return "stopped", 0
    except RefusedError:
        return "refused", 0
    except StateUnknownError:
        return "unknown", 0
    except LinkError:
        return "link", 0
    if state.axes.tolist() != points[-1].tolist():
        raise DriverError(f"a move returned at {state.axes.tolist()}, not at {points[-1].tolist()}")
    return "done", 0


def _recover(driver: Driver, soak: Soak, code: int = 0) -> None:
    """Stop, read latched faults and reset, until the controller accepts moves again."""
    reported = {code} - {0}

    def once() -> None:
        reported.update({driver.stop().fault_code} - {0})
        driver.reset()

    _retry(soak, once)
    soak.reported += sorted(reported)


def _retry(soak: Soak, act: Callable[[], object]) -> None:
    for left in reversed(range(MOST_RECOVERIES)):
        try:
            act()
            return
        except (LinkError, RefusedError, StateUnknownError) as error:
            soak.outcomes[f"while recovering: {type(error).__name__}"] += 1
            if not left:
                raise
            soak.wait(0.02)


def _random_points(driver: Driver, soak: Soak, rng: np.random.Generator) -> SetPoints:
    """Return one to three via points near the arm, sometimes forty: more than a frame or a block holds."""
    axes: list[Any] = []
    _retry(soak, lambda: axes.append(driver.state().axes))
    capabilities = driver.capabilities
    n = 40 if rng.random() < 0.05 else int(rng.integers(1, 4))
    steps = rng.integers(-60_000, 60_001, (n, len(capabilities.lower))) // (1 if n < 4 else 20)
    low, high = capabilities.lower.astype(np.int64) // 2, capabilities.upper.astype(np.int64) // 2
    points = axes[0].astype(np.int64) + np.cumsum(steps, axis=0)
    return np.clip(points, np.minimum(low, axes[0]), np.maximum(high, axes[0])).astype(np.int32)


@dataclass
class Verdict:
    """Result of the comparison with the journal.

    Attributes:
        twice: moves that began more than once.
        lost: moves that returned as done but did not end so.
        foreign: moves that began but were refused or never commanded.
        out_of_order: moves that began after a later one.
        off_path: largest distance of a stopped arm from the commanded path, counts of 1e-4 deg.
        unreported: latched faults that were not reported to the client.
    """

    twice: int = 0
    lost: int = 0
    foreign: int = 0
    out_of_order: int = 0
    off_path: float = 0.0
    unreported: int = 0

    @property
    def clean(self) -> bool:
        """Return True if no move is twice, lost, foreign, out of order or off the path, and all faults are reported."""
        return not (self.twice or self.lost or self.foreign or self.out_of_order or self.unreported) and (
            self.off_path <= 2.0
        )


def judge(soak: Soak, journal: list[dict[str, Any]]) -> Verdict:
    """Compare commanded and executed moves.

    Args:
        soak: of the client.
        journal: of the controller.
    """
    verdict = Verdict()
    index: dict[str, int] = {}
    for k, (points, _) in enumerate(soak.commanded):
        index[json.dumps(points.tolist())] = k
    began, ended = Counter[int](), dict[int, int]()
    faulted: set[int] = set()  # completed moves with a fault before the next one
    last, current = -1, (-1, -1, -1)
    path: NDArray[Any] = np.zeros((1, 0))
    for entry in journal:
        if entry["event"] == "move":
            k = index.get(json.dumps(entry["set_points"]), -1)
            verdict.foreign += k < 0 or soak.commanded[k][1] == "refused"
            verdict.out_of_order += 0 <= k < last
            began[k] += 1
            last, current = max(last, k), (entry["boot"], entry["sequence"], k)
            path = np.array([entry["from"], *entry["set_points"]], dtype=np.float64)
        elif entry["event"] == "end" and (entry["boot"], entry["sequence"]) == current[:2]:
            ended[current[2]] = entry["result"]
        elif entry["event"] == "fault":
            faulted.add(current[2])
        elif entry["event"] == "start" and len(path) > 1:
            verdict.off_path = max(verdict.off_path, _distance(np.array(entry["axes"], dtype=np.float64), path))
    verdict.twice = sum(count - 1 for count in began.values())
    for k, (_, outcome) in enumerate(soak.commanded):
        verdict.lost += outcome == "done" and not (began[k] == 1 and ended.get(k) == 0)
        ends = (0, 20, 21) if outcome == "fault" and k in faulted else (20, 21)
        verdict.lost += outcome in ("fault", "stopped") and not (began[k] == 1 and ended.get(k) in ends)
    # The next move begins at the position of a stopped one, which must lie on the commanded path.
    here: NDArray[Any] | None = None
    for entry in journal:
        if entry["event"] != "move":
            continue
        start = np.array(entry["from"], dtype=np.float64)
        if here is not None:
            verdict.off_path = max(verdict.off_path, _distance(start, here))
        here = np.array([entry["from"], *entry["set_points"]], dtype=np.float64)
    verdict.unreported = sum((_reportable_faults(journal) - Counter(soak.reported)).values())
    return verdict


def _reportable_faults(journal: list[dict[str, Any]]) -> Counter[int]:
    """Return the faults that must be reported to a client: those latched until its reset, and restarts.

    The emergency stop outranks earlier faults. A restart erases latched faults, but is reported itself.
    """
    reports = Counter[int]()
    latched = 0
    for entry in journal:
        if entry["event"] == "fault" and entry["code"] != Fault.RESTARTED:
            latched = entry["code"]
        elif entry["event"] == "reset":
            reports[latched] += latched != 0
            latched = 0
        elif entry["event"] == "start":
            latched = 0
            reports[Fault.RESTARTED] += entry["boot"] > 1
    return reports


def _distance(point: NDArray[Any], path: NDArray[Any]) -> float:
    """Return the largest axis distance of a point from the nearest point of a polyline, counts."""
    a, b = path[:-1], path[1:]
    along = b - a
    length = np.maximum((along**2).sum(axis=1), 1e-9)
    s = np.clip(((point - a) * along).sum(axis=1) / length, 0.0, 1.0)
    return float(np.abs(point - (a + s[:, None] * along)).max(axis=1).min())


def soak_backend(
    backend: str, moves: int, faults: str, seed: int, folder: Path | None = None
) -> tuple[Soak, list[dict[str, Any]]]:
    """Start the emulator, drive, and end it.

    Args:
        backend: protocol of `cell emulate`.
        moves: number of moves.
        faults: list of faults.
        seed: seed of faults and moves.
        folder: a run whose axes are moved; None: those of the built-in arm.

    Returns:
        Record of the client, and the controller's journal.
    """
    limits = KR16 if folder is None else Limits.from_rad(open_run(folder).motion.limits)
    with tempfile.TemporaryDirectory() as scratch:
        log = Path(scratch) / "moves.jsonl"
        command = [sys.executable, "-m", "cell", "emulate", backend, "--log", str(log)]
        command += [] if backend in FAULTS else ["--time-scale", str(TIME_SCALE)]
        command += ["--seed", str(seed), *(["--faults", faults] if faults else [])]
        command += [] if folder is None else ["--run", str(folder)]
        errors = Path(scratch) / "errors.txt"
        with (
            errors.open("w", encoding="utf-8") as stream,
            subprocess.Popen(command, stdout=subprocess.PIPE, stderr=stream, text=True) as process,
        ):
            try:
                assert process.stdout is not None
                url = process.stdout.readline().strip()
                url += ("&" if "?" in url else "?") + PATIENCE
                soak = drive(open_driver(url, Context(limits)), moves, np.random.default_rng(seed))
            except DriverError as error:
                if process.poll() is None:
                    raise
                raise RuntimeError(f"the emulator ended by itself: {errors.read_text(encoding='utf-8')}") from error
            finally:
                process.terminate()
                process.wait(30)
        return soak, [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()]


def run() -> list[dict[str, Any]]:
    """Return a row for each wire."""
    rows = []
    for backend in os.environ.get("SOAK_BACKENDS", " ".join(BACKENDS)).split():
        moves = int(os.environ.get("SOAK_MOVES", "2000"))
        folder = Path(os.environ["SOAK_RUN"]) if "SOAK_RUN" in os.environ else None
        soak, journal = soak_backend(backend, moves, FAULTS.get(backend, EVERY_FAULT), seed=1, folder=folder)
        verdict = judge(soak, journal)
        reports = Counter(Fault(code).name.lower() for code in soak.reported)
        rows.append(
            {
                "back end": backend,
                "moves": moves,
                "axes": len(soak.commanded[0][0][0]),
                "seconds": soak.seconds,
                **{name: soak.outcomes[name] for name in ("done", "fault", "stopped", "unknown", "refused", "link")},
                "twice": verdict.twice,
                "lost": verdict.lost,
                "foreign": verdict.foreign,
                "out of order": verdict.out_of_order,
                "off path [1e-4 deg]": verdict.off_path,
                "unreported": verdict.unreported,
                "faults reported": ", ".join(f"{name} {count}" for name, count in sorted(reports.items())),
            }
        )
    return rows
