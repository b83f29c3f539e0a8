"""Moves over `ur://` and `rsi://` with faults, and clients killed during moves over `ur://`, `kvp://` and `rsi://`.

Each fault occurs during 1 % of the moves at a random moment: lost connections, pauses of the controller, lost answers,
safety stops, a program ended by a person. The moves are compared with what the emulated controller executed: over
`ur://` with the numbers of its commands, over `rsi://` with the axes of every cycle, which must proceed on the
commanded line. `python -m benchmarks soak` has the moves over `kvp://`, compared with a journal. `ONLINE_SOAK_MOVES` in
the environment changes the 500 moves, `ONLINE_SOAK_KILLS` the 20 kills, `ONLINE_SOAK_WIRES` the wires,
`ONLINE_SOAK_CYCLE_MS` the 4 ms of `rsi://`.
"""

import os
import random
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from benchmarks.soak import KR16
from drivers.clock import RealTimeClock
from drivers.contract import Driver
from drivers.emulated.kvp import KukaController, KvpStation
from drivers.emulated.rsi import RsiController
from drivers.emulated.serve import Server, TcpLine
from drivers.emulated.ur import UrController, UrServer
from drivers.errors import DriverError, StoppedError
from drivers.registry import Context, open_driver
from drivers.setpoints import PER_DEGREE, SetPoints, from_rad, to_rad
from drivers.wires.ur_link import ACK

HOME = from_rad(np.radians([0.0, -90.0, 90.0, 0.0, 90.0, 0.0]))
FAULT_SHARE = 0.01
PATIENCE = "timeout_ms=300&watchdog_ms=1000"

KILLED = """
import sys
import numpy as np
from benchmarks.soak import KR16
from drivers.registry import Context, open_driver
with open_driver(sys.argv[1], Context(KR16)) as driver:
    driver.move(np.array([[int(value) for value in sys.argv[2].split(",")]], dtype=np.int32), 0.2)
"""


@dataclass
class Bench:
    """A served controller.

    Attributes:
        url: of its driver.
        a1_deg: reads axis 1 of the arm.
        faults: actions that begin a fault.
        clear: ends safety stops, as a person does.
        count_wrong: returns the errors in what was executed since the last call, for a move from one position to
            another with its outcome.
    """

    url: str
    a1_deg: Callable[[], float]
    faults: tuple[Callable[[], object], ...] = ()
    clear: Callable[[], object] = lambda: None
    count_wrong: Callable[[SetPoints, SetPoints, str], int] = lambda start, goal, outcome: 0


class _Registers(list[int]):
    """Registers that record the numbers of executed commands."""

    def __init__(self) -> None:
        super().__init__([0] * 48)
        self.executed: list[int] = []

    def __setitem__(self, index: Any, value: Any) -> None:
        if index == ACK:
            self.executed.append(value)
        super().__setitem__(index, value)

    def count_wrong(self, start: SetPoints, goal: SetPoints, outcome: str) -> int:
        """Return the numbers that were executed twice, and 1 if a completed move was not executed once."""
        executed, self.executed = self.executed, []
        return len(executed) - len(set(executed)) + (outcome == "done" and len(executed) != 1)


@contextmanager
def _ur() -> Iterator[Bench]:
    registers = _Registers()
    controller = UrController(to_rad(HOME), RealTimeClock(), outputs=registers)
    server = UrServer(controller)
    with _served(server.serve, server.close):
        yield Bench(
            f"{server.url}&{PATIENCE}",
            lambda: float(np.degrees(controller.values()["actual_q"][0])),
            (
                server.drop_connections,
                controller.protective_stop,
                controller.emergency_stop,
                lambda: controller.run("def person():\nstopj(4.0)\nend"),
            ),
            partial(controller.protective_stop, False),
            registers.count_wrong,
        )


@contextmanager
def _kvp() -> Iterator[Bench]:
    clock, line = RealTimeClock(), TcpLine()
    controller = KukaController(to_rad(HOME), KR16, clock, _Silent())
    with _served(Server(KvpStation(controller), line, clock).serve, line.close):
        yield Bench(f"kvp://{line.name}?{PATIENCE}", lambda: float(controller.variables["$AXIS_ACT"].A1))


@contextmanager
def _rsi() -> Iterator[Bench]:
    cycle_ms = int(os.environ.get("ONLINE_SOAK_CYCLE_MS", "4"))
    controller = RsiController(to_rad(HOME), RealTimeClock(), cycle_ms=cycle_ms)

    def count_wrong(start: SetPoints, goal: SetPoints, outcome: str) -> int:
        rows, controller.driven = np.array(controller.driven).reshape(-1, 6), []
        along = (goal - start) / PER_DEGREE
        s = (rows - start / PER_DEGREE) @ along / max(float(along @ along), 1e-12)
        off = np.abs(rows - start / PER_DEGREE - s[:, None] * along)
        is_off = bool((off > 1e-4).any()) or bool((np.diff(s) < -1e-6).any())
        return int(is_off) + int(outcome == "done" and (not len(s) or abs(s[-1] - 1.0) > 1e-4))

    with _served(controller.serve, controller.close):
        yield Bench(
            f"{controller.url}?{PATIENCE}&wait_s=5",
            lambda: float(controller.axes[0]),
            (
                partial(controller.pause, 0.3),
                partial(controller.pause, 2.0),
                partial(controller.lose_answers, 20),
                partial(controller.lose_answers, 200),
                controller.emergency_stop,
            ),
            partial(controller.emergency_stop, False),
            count_wrong,
        )


class _Silent:
    """Recorder of nothing."""

    def record_event(self, event: dict[str, Any]) -> None:
        """Ignore an event."""

    def record_state(self, state: object) -> None:
        """Ignore a state."""


WIRES = {"ur": _ur, "kvp": _kvp, "rsi": _rsi}


@contextmanager
def _served(serve: Callable[[Callable[[], bool]], None], close: Callable[[], None]) -> Iterator[None]:
    ended = threading.Event()
    thread = threading.Thread(target=serve, args=(ended.is_set,), daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
        close()


def run() -> list[dict[str, Any]]:
    """Return one row of moves and one of kills for each wire."""
    rows = []
    for wire in os.environ.get("ONLINE_SOAK_WIRES", " ".join(WIRES)).split():
        with WIRES[wire]() as bench:
            if bench.faults:
                rows.append({"wire": wire, **_soak(bench, int(os.environ.get("ONLINE_SOAK_MOVES", "500")))})
            rows.append({"wire": wire, **_kill(bench, int(os.environ.get("ONLINE_SOAK_KILLS", "20")))})
    return rows


def _soak(bench: Bench, n_moves: int) -> dict[str, Any]:
    """Command random moves and recover; compare with the executed ones."""
    rng, outcomes, wrong = random.Random(1), Counter[str](), 0
    began = time.perf_counter()
    driver = _connected(bench)
    for _ in range(n_moves):
        goal = np.asarray(HOME + PER_DEGREE * np.array([rng.uniform(-8, 8) for _ in range(6)]), dtype=np.int32)
        start, timer = driver.state().axes, _fault(rng, bench)
        try:
            state = driver.move(goal[None], 1.0)
            outcome = "done"
            wrong += state.axes.tolist() != goal.tolist()
        except StoppedError:
            outcome = "stopped"
        except DriverError as error:
            outcome = type(error).__name__
        if timer is not None:
            timer.join()
        outcomes[outcome] += 1
        wrong += bench.count_wrong(start, goal, outcome)
        if outcome != "done":
            driver = _recovered(driver, bench)
            bench.count_wrong(start, goal, outcome)
    driver.close()
    return {
        "of": f"{n_moves} moves", **outcomes, "lost, twice or elsewhere": wrong, "s": time.perf_counter() - began,
    }  # fmt: skip


def _connected(bench: Bench) -> Driver:
    driver = open_driver(bench.url, Context(KR16))
    driver.connect()
    return driver


def _fault(rng: random.Random, bench: Bench) -> threading.Timer | None:
    """Start the fault of this move, if it has one."""
    for act in bench.faults:
        if rng.random() < FAULT_SHARE:
            timer = threading.Timer(rng.uniform(0.0, 0.6), act)
            timer.start()
            return timer
    return None


def _recovered(driver: Driver, bench: Bench) -> Driver:
    """Clear the fault as a person does, then stop and reset; connect again if the wire needs it."""
    bench.clear()
    for left in reversed(range(20)):
        try:
            driver.stop()
            driver.reset()
            return driver
        except DriverError:
            if not left:
                raise
            time.sleep(0.1)
            if bench.url.startswith("rsi"):  # a session of RSI ends with its controller
                driver.close()
                driver = _connected(bench)
    return driver


def _kill(bench: Bench, n_kills: int) -> dict[str, Any]:
    """Kill clients during moves: the arm stops on its path, and the next client drives on."""
    rng, wrong = random.Random(2), 0
    for _ in range(n_kills):
        with open_driver(bench.url, Context(KR16)) as driver:
            if driver.state().fault_code:  # the watchdog's, of the last kill
                driver.reset()
            driver.move(HOME[None], 1.0)
        goal = (HOME + PER_DEGREE * np.array([120, 0, 0, 0, 0, 0])).astype(np.int32)
        client = subprocess.Popen([sys.executable, "-c", KILLED, bench.url, ",".join(map(str, goal.tolist()))])
        while bench.a1_deg() < 0.5 and client.poll() is None:
            time.sleep(0.01)
        time.sleep(rng.uniform(0.0, 0.8))
        client.kill()
        client.wait()
        time.sleep(1.6)  # the watchdog and the braking
        with open_driver(bench.url, Context(KR16)) as driver:
            state = driver.state()
            wrong += not (
                state.at_rest and 0 < state.axes[0] < goal[0] and state.axes[1:].tolist() == HOME[1:].tolist()
            )
    return {"of": f"{n_kills} kills", "lost, twice or elsewhere": wrong}
