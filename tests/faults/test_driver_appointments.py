"""Faults at a time, and how a controller comes back from them."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from drivers.contract import Fault, Mode
from drivers.errors import EmergencyStopError, RefusedError, StateUnknownError
from drivers.setpoints import SetPoints, from_rad

HOME = from_rad(np.radians([0.0, -90.0, 90.0, 0.0, 90.0, 0.0]))


def turned(degrees: float) -> SetPoints:
    """(1, 6) home with A1 turned."""
    points = HOME[None].copy()
    points[0, 0] = round(degrees * 1e4)
    return points


def test_an_emergency_stop_at_a_time(bench: Callable[..., Any], backend: str) -> None:
    """Pressed at 1 s for 2 s: the move ends on its path, a reset is refused until the release, then all goes on."""
    made = bench(backend, "estop@1:2")
    made.driver.connect()
    with pytest.raises(EmergencyStopError) as pressed:
        made.driver.move(turned(120.0), 0.2)
    assert pressed.value.code == Fault.EMERGENCY_STOP
    assert 1.0 <= made.clock.now() < 2.0
    with pytest.raises(RefusedError, match="still pressed"):
        made.driver.reset()
    made.clock.wait(3.0)
    assert made.driver.state().mode is Mode.EMERGENCY_STOP
    assert made.driver.reset().mode is Mode.IDLE
    assert made.driver.move(turned(0.0), 1.0).mode is Mode.IN_POSITION


def test_a_restart_at_a_time(bench: Callable[..., Any], backend: str) -> None:
    """The arm brakes on its path and keeps its place; the new controller counts from 0 and has latched RESTARTED."""
    made = bench(backend, "reboot@1:0.3")
    made.driver.connect()
    with pytest.raises(StateUnknownError):
        made.driver.move(turned(120.0), 0.2)
    made.clock.wait(1.0)
    state = made.driver.stop()
    assert (state.fault_code, state.boot, state.done_sequence) == (Fault.RESTARTED, 2, 0)
    assert 0 < state.axes[0] < 1_200_000
    assert (state.axes[1:] == HOME[1:]).all()
    (start, again) = made.journal.of("start")
    assert again["axes"] == state.axes.tolist()
    assert start["boot"] == 1
    made.driver.reset()
    assert made.driver.move(turned(0.0), 1.0).mode is Mode.IN_POSITION


def test_a_line_that_is_mute_for_a_while(bench: Callable[..., Any], backend: str) -> None:
    """Shorter than the watchdog: the move goes on as if nothing had been; longer: the arm stops, and says why."""
    short = bench(backend, "half-open@1:0.2")
    short.driver.connect()
    assert short.driver.move(turned(60.0), 0.2).mode is Mode.IN_POSITION
    long = bench(backend, "half-open@1:3")
    long.driver.connect()
    with pytest.raises(StateUnknownError):
        long.driver.move(turned(120.0), 0.2)
    long.clock.wait(3.0)
    state = long.driver.stop()
    assert state.fault_code == Fault.WATCHDOG
    assert 0 < state.axes[0] < 1_200_000
