"""The limits of an arm that does not exist, wider and narrower than the KR 16's, on both ends of every wire."""

import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from drivers.emulated.stations import ModbusStation
from drivers.errors import ArrivalError, RefusedError
from drivers.limits import Limits
from drivers.registry import Context, open_driver
from drivers.setpoints import from_rad
from drivers.sim import SimDriver
from planner.ports import JointLimits
from planner.timing.move_time import move_time

LOWER, UPPER = np.array([-200.0, -120, -60, -270, -20, -400]), np.array([190.0, 60, 120.5, 360, 125, 1080])
VELOCITY = np.radians([90.0, 70, 110, 250, 480, 400])
ARM = JointLimits(np.radians(LOWER), np.radians(UPPER), VELOCITY, 3 * VELOCITY, 15 * VELOCITY)
LIMITS = Limits.from_rad(ARM)
HOME = np.array([0.0, -90, 90, 0, 90, 0])
COUNTS = {
    "lower": (LOWER * 1e4).tolist(),
    "upper": (UPPER * 1e4).tolist(),
    "max_step": ((UPPER - LOWER) * 1e4).tolist(),
}


def via(**degrees: float) -> np.ndarray:
    """(1, 6) set-points: home with some axes turned."""
    q = HOME.copy()
    for axis, angle in degrees.items():
        q[int(axis[1:]) - 1] = angle
    return from_rad(np.radians(q)[None])


@pytest.fixture(params=["sim", "serial", "modbus", "modbus-rtu"])
def arm(request: pytest.FixtureRequest, bench: Callable[..., Any]) -> tuple[Any, Any]:
    """A driver of that arm, not yet connected, and its clock; the controller is `endpoint` or `controller`."""
    if request.param == "sim":
        driver = open_driver("sim://", Context(LIMITS))
        assert isinstance(driver, SimDriver)
        return driver, driver.clock
    made = bench(request.param, limits=LIMITS)
    return made.driver, made.clock


def test_every_driver_tells_the_arms_limits(arm: tuple[Any, Any]) -> None:
    """To the count, whatever the wire made of them."""
    with arm[0] as driver:
        assert {name: getattr(driver.capabilities, name).tolist() for name in COUNTS} == COUNTS


def test_what_this_arm_can_is_driven_in_its_time_and_what_it_cannot_is_refused(arm: tuple[Any, Any]) -> None:
    """A1 at 187 and A6 at 1,000 deg, which no KR 16 reaches, take the planner's time; A3 at 121 is not even sent."""
    goal = via(A1=187.0, A6=1000.0)
    due = float(move_time(np.radians(HOME)[None], np.radians(goal / 1e4), ARM)[0])
    driver, clock = arm
    with driver:
        driver.take()
        began = clock.now()
        assert driver.move(goal, 1.0).axes.tolist() == goal[0].tolist()
        assert clock.now() - began == pytest.approx(due, rel=0.02)
        with pytest.raises(
            RefusedError, match=r"via point 0 has A3 at 121\.0000 deg; it must lie in -60\.0000 to 120\.5"
        ):
            driver.move(via(A3=121.0), 1.0)


def test_a_client_drives_no_farther_than_its_arm_whatever_the_controller_takes(bench: Callable[..., Any]) -> None:
    """The controller is of a KR 16, whose A5 reaches -130 deg; the arm that was planned with ends at -20."""
    made = bench("serial")
    made.driver._limits = LIMITS
    with (
        made.driver as driver,
        pytest.raises(RefusedError, match=r"A5 at -90\.0000 deg; it must lie in -20\.0000 to 125"),
    ):
        driver.move(via(A5=-90.0), 1.0)
    assert made.journal.of("move") == []


def test_an_arrival_is_judged_by_the_arm_that_was_handed_down(bench: Callable[..., Any]) -> None:
    """A controller with the KR 16's A2, 156 deg/s, is there sooner than an arm with 70 deg/s can be."""
    made = bench("serial")
    made.driver._limits = LIMITS
    with made.driver as driver, pytest.raises(ArrivalError, match="an arm with these limits needs at least"):
        driver.move(via(A2=-40.0), 1.0)


def test_the_registers_of_its_capabilities_are_where_the_page_has_them(bench: Callable[..., Any]) -> None:
    """One FC04 from register 100, taken apart as docs/internals/protocol.md says: lower from 126, 2 registers each."""
    station = ModbusStation(bench("modbus", limits=LIMITS).endpoint)
    telegram = station.answer(struct.pack(">HHHBBHH", 7, 0, 6, 1, 4, 100, 64))
    registers = struct.unpack(">64H", telegram[9:])
    block = struct.pack(">36H", *registers[26:62])
    assert registers[4] == 6
    assert dict(zip(COUNTS, np.array(struct.unpack(">18i", block)).reshape(3, 6).tolist(), strict=True)) == COUNTS
