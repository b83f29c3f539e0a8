"""Moves over `ur://` with faults, and clients killed during moves, compared with what the controller executed.

The emulated controller loses its connections, stops for safety, or has its program ended by a person, each during 1 %
of the moves at a random moment. `UR_SOAK_MOVES` in the environment changes the 500 moves, `UR_SOAK_KILLS` the 20 kills.
"""

import os
import random
import subprocess
import sys
import threading
import time
from collections import Counter
from typing import Any

import numpy as np

from benchmarks.soak import KR16
from drivers.clock import RealTimeClock
from drivers.contract import Driver
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


class _Registers(list[int]):
    """Registers that record the numbers of executed commands."""

    def __init__(self) -> None:
        super().__init__([0] * 48)
        self.executed: list[int] = []

    def __setitem__(self, index: Any, value: Any) -> None:
        if index == ACK:
            self.executed.append(value)
        super().__setitem__(index, value)


def run() -> list[dict[str, Any]]:
    """Return one row of moves and one of kills."""
    registers = _Registers()
    controller = UrController(to_rad(HOME), RealTimeClock(), outputs=registers)
    server, ended = UrServer(controller), threading.Event()
    thread = threading.Thread(target=server.serve, args=(ended.is_set,), daemon=True)
    thread.start()
    try:
        url = f"{server.url}&{PATIENCE}"
        return [
            _soak(url, controller, server, registers, int(os.environ.get("UR_SOAK_MOVES", "500"))),
            _kill(url, controller, int(os.environ.get("UR_SOAK_KILLS", "20"))),
        ]
    finally:
        ended.set()
        thread.join()
        server.close()


def _soak(url: str, controller: UrController, server: UrServer, registers: _Registers, n_moves: int) -> dict[str, Any]:
    """Command random moves and recover; compare with the executed commands."""
    rng, outcomes, wrong = random.Random(1), Counter[str](), 0
    began = time.perf_counter()
    with open_driver(url, Context(KR16)) as driver:
        for _ in range(n_moves):
            goal = _random_goal(rng)
            before = len(registers.executed)
            timer = _fault(rng, controller, server)
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
            executed = registers.executed[before:]
            wrong += len(set(executed)) != len(executed)  # no number twice
            wrong += outcome == "done" and len(executed) != 1
            if outcome != "done":
                _recover(driver, controller)
    return {
        "of": f"{n_moves} moves", **outcomes, "lost, twice or elsewhere": wrong, "s": time.perf_counter() - began,
    }  # fmt: skip


def _random_goal(rng: random.Random) -> SetPoints:
    return np.asarray(HOME + PER_DEGREE * np.array([rng.uniform(-8, 8) for _ in range(6)]), dtype=np.int32)


def _fault(rng: random.Random, controller: UrController, server: UrServer) -> threading.Timer | None:
    """Start the fault of this move, if it has one."""
    faults = (
        server.drop_connections,
        controller.protective_stop,
        controller.emergency_stop,
        lambda: controller.run("def person():\nstopj(4.0)\nend"),
    )
    for act in faults:
        if rng.random() < FAULT_SHARE:
            timer = threading.Timer(rng.uniform(0.0, 0.6), act)
            timer.start()
            return timer
    return None


def _recover(driver: Driver, controller: UrController) -> None:
    """Clear the fault as a person does, then stop and reset."""
    controller.protective_stop(False)
    for left in reversed(range(20)):
        try:
            driver.stop()
            driver.reset()
            return
        except DriverError:
            if not left:
                raise
            time.sleep(0.1)


def _kill(url: str, controller: UrController, n_kills: int) -> dict[str, Any]:
    """Kill clients during moves: the arm stops on its path, and the next client drives on."""
    rng, wrong = random.Random(2), 0
    for _ in range(n_kills):
        with open_driver(url, Context(KR16)) as driver:
            driver.move(HOME[None], 1.0)
        goal = (HOME + PER_DEGREE * np.array([60, 0, 0, 0, 0, 0])).astype(np.int32)
        client = subprocess.Popen([sys.executable, "-c", KILLED, url, ",".join(map(str, goal.tolist()))])
        while controller.values()["actual_q"][0] < np.radians(0.5) and client.poll() is None:
            time.sleep(0.01)
        time.sleep(rng.uniform(0.0, 0.8))
        client.kill()
        client.wait()
        time.sleep(1.6)  # the watchdog and the braking
        with open_driver(url, Context(KR16)) as driver:
            state = driver.state()
            wrong += not (
                state.at_rest and 0 < state.axes[0] < goal[0] and state.axes[1:].tolist() == HOME[1:].tolist()
            )
    return {"of": f"{n_kills} kills", "lost, twice or elsewhere": wrong}
