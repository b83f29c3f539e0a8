"""The soak over real processes, in reduced forms; the full one is `python -m benchmarks soak`."""

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.soak import EVERY_FAULT, PATIENCE, Soak, drive, judge
from cell.robot import model as robot
from cell.runs.run import open_run
from drivers.limits import Limits
from drivers.registry import Context, open_driver

KR16 = Limits.from_rad(robot.limits(robot.load()))


@pytest.mark.parametrize("axes", [6, 7])
@pytest.mark.parametrize("moves", [6, pytest.param(60, marks=pytest.mark.slow)])
def test_a_reduced_soak_over_real_processes(
    moves: int, axes: int, emulate: Callable[..., Any], request: pytest.FixtureRequest
) -> None:
    """A few moves with 2 % of every fault over each wire at once; of the arm, and of arm and rotary table."""
    run = () if axes == 6 else ("--run", str(request.getfixturevalue("turned")))
    limits = KR16 if axes == 6 else Limits.from_rad(open_run(Path(run[1])).motion.limits)
    faults = EVERY_FAULT.replace("=0.01", "=0.02")
    running = [emulate(name, "--time-scale", "40", "--faults", faults, "--seed", "3", *run)
               for name in ("serial", "modbus", "modbus-rtu")]  # fmt: skip
    results: dict[int, Soak] = {}

    def soak(k: int) -> None:
        url = running[k].url
        results[k] = drive(
            open_driver(f"{url}{'&' if '?' in url else '?'}{PATIENCE}", Context(limits)),
            moves,
            np.random.default_rng(k),
        )

    threads = [threading.Thread(target=soak, args=(k,)) for k in range(len(running))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for k, emulated in enumerate(running):
        assert emulated.end() == 0
        journal = emulated.entries()
        assert judge(results[k], journal).clean, (judge(results[k], journal), results[k].outcomes)
        assert len(results[k].commanded) == moves
