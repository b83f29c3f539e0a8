"""The limits of another arm, wider and narrower than the KR 16's, at both ends of every wire."""

import struct
from typing import Any

import numpy as np
import pytest

from drivers.emulated.stations import ModbusStation
from drivers.errors import PathError, RefusedError
from drivers.limits import Limits
from drivers.registry import Context, open_driver
from drivers.setpoints import from_rad
from planner.ports import JointLimits
from planner.timing.move_time import move_time
from tests.support.driver_bench import HOME_Q, WIRES, make_bench

LOWER, UPPER = np.array([-200.0, -120, -60, -270, -20, -400]), np.array([190.0, 60, 120.5, 360, 125, 1080])
VELOCITY = np.radians([90.0, 70, 110, 250, 480, 400])
ARM = JointLimits(np.radians(LOWER), np.radians(UPPER), VELOCITY, 3 * VELOCITY, 15 * VELOCITY)
LIMITS = Limits.from_rad(ARM)
COUNTS = {
    "lower": (LOWER * 1e4).tolist(),
    "upper": (UPPER * 1e4).tolist(),
    "max_step": ((UPPER - LOWER) * 1e4).tolist(),
}


def via(**degrees: float) -> np.ndarray:
    """Return a via point (1, 6): home with some axes at other angles."""
    q = HOME_Q.copy()
    for axis, angle in degrees.items():
        q[int(axis[1:]) - 1] = np.radians(angle)
    return from_rad(q[None])


@pytest.mark.parametrize("backend", ["sim", *WIRES])
def test_the_limits_hold_at_both_ends(backend: str) -> None:
    """The driver reports the exact limits, a fast move takes the planned time, and A3 at 121 deg is refused."""
    driver: Any
    if backend == "sim":
        driver = open_driver("sim://", Context(LIMITS))
        clock = driver.clock
    else:
        bench = make_bench(backend, limits=LIMITS)
        driver, clock = bench.driver, bench.clock
    goal = via(A1=187.0, A6=1000.0)
    expected = float(move_time(HOME_Q[None], np.radians(goal / 1e4), ARM)[0])
    with driver:
        assert {name: getattr(driver.capabilities, name).tolist() for name in COUNTS} == COUNTS
        driver.take()
        began = clock.now()
        assert driver.move(goal, 1.0).axes.tolist() == goal[0].tolist()
        assert clock.now() - began == pytest.approx(expected, rel=0.02)
        with pytest.raises(
            RefusedError, match=r"via point 0 has A3 at 121\.0000 deg; it must lie in -60\.0000 to 120\.5"
        ):
            driver.move(via(A3=121.0), 1.0)


def test_the_clients_own_arm_limits_moves_and_progress() -> None:
    """The controller has the KR 16's limits: A5 to -130 deg, A2 at 156 deg/s; the planned arm -20 deg and 70 deg/s."""
    bench = make_bench("serial")
    bench.driver._limits = LIMITS
    with bench.driver as driver:
        with pytest.raises(RefusedError, match=r"A5 at -90\.0000 deg; it must lie in -20\.0000 to 125"):
            driver.move(via(A5=-90.0), 1.0)
        assert bench.journal.of("move") == []
        with pytest.raises(PathError, match=r"A2 is at .* farther on its path than it can be"):
            driver.move(via(A2=-40.0), 1.0)


def test_the_registers_of_the_capabilities() -> None:
    """One FC04 from register 100, decoded by docs/internals/protocol.md: lower from 126, 2 registers each."""
    station = ModbusStation(make_bench("modbus", limits=LIMITS).endpoint)
    telegram = station.answer(struct.pack(">HHHBBHH", 7, 0, 6, 1, 4, 100, 64))
    registers = struct.unpack(">64H", telegram[9:])
    block = struct.pack(">36H", *registers[26:62])
    assert registers[4] == 6
    assert dict(zip(COUNTS, np.array(struct.unpack(">18i", block)).reshape(3, 6).tolist(), strict=True)) == COUNTS
