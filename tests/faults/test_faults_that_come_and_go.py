"""Emergency stops and faults that appear and disappear without a reset, in every phase; owners that change."""

import threading
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cell.scan import execution
from cell.scan.acquisition import Acquired
from drivers.contract import Fault, Flag, Mode, RobotState
from drivers.errors import DriverError, EmergencyStopError, FaultError, NotOwnerError, RefusedError, StateUnknownError
from drivers.setpoints import to_rad
from tests.support.driver_bench import HOME, WIRES, Bench, make_bench, on_one_wire, turned

KINDS: dict[str, tuple[Mode, Flag, int, type[FaultError], str]] = {
    "emergency stop": (Mode.EMERGENCY_STOP, Flag.EMERGENCY_STOP, Fault.EMERGENCY_STOP, EmergencyStopError, "emergency"),
    "fault": (Mode.FAULT, Flag.FAULT, 1234, FaultError, "fault 1234|drive A3"),
}


def show(bench: Bench, kind: str, when: Callable[[RobotState], bool]) -> None:
    """Let the controller report a fault in some states, which it neither latches nor acts on."""
    report, (mode, flag, code, _, _) = bench.endpoint.report, KINDS[kind]

    def changed() -> RobotState:
        state = report()
        if not when(state):
            return state
        rest = Flag.AT_REST if state.at_rest else Flag.MOVING
        message = "drive A3 tripped" if kind == "fault" else "the emergency stop was pressed"
        return replace(state, mode=mode, flags=int(flag | rest), fault_code=code, fault_message=message)

    bench.endpoint.report = changed  # type: ignore[method-assign]


def connected(wire: str) -> Bench:
    """Return a connected bench that owns the arm."""
    bench = make_bench(wire)
    bench.driver.connect()
    bench.driver.take()
    return bench


@pytest.mark.parametrize("span", [(0, 2500), (2000, 6000), (7000, 8000)])
@pytest.mark.parametrize(("kind", "wire"), on_one_wire(KINDS))
def test_during_a_move(kind: str, wire: str, span: tuple[int, int]) -> None:
    """The arm is stopped on its path, the error has the kind and the words, and no move follows before a reset."""
    bench = connected(wire)
    show(bench, kind, lambda state: span[0] <= state.path <= span[1] and state.mode is Mode.MOVING)
    with pytest.raises(KINDS[kind][3], match=KINDS[kind][4]) as error:
        bench.driver.move(turned(40.0), 0.3)
    assert "the arm is at rest at" in str(error.value)
    assert bench.journal.of("stop")
    assert bench.endpoint.controller.state().axes[0] < 400_000
    with pytest.raises(RefusedError, match="was not reset"):
        bench.driver.move(turned(40.0), 0.3)
    assert len(bench.journal.of("move")) == 1
    bench.driver.reset()
    show(bench, kind, lambda state: False)


@pytest.mark.parametrize("phase", ["before", "dwell"])
@pytest.mark.parametrize(("kind", "wire"), on_one_wire(KINDS))
def test_at_rest(kind: str, wire: str, phase: str) -> None:
    """A fault that one reading of the state shows at rest needs a reset, also if no later one does."""
    bench, visible = connected(wire), [False]
    show(bench, kind, lambda state: visible[0])
    if phase == "dwell":
        bench.driver.move(turned(5.0), 1.0)
    visible[0] = True
    bench.driver.state()
    visible[0] = False
    with pytest.raises(RefusedError, match=f"({KINDS[kind][4]}).*no longer reported and was not reset"):
        bench.driver.move(turned(10.0), 1.0)
    bench.driver.reset()
    assert bench.driver.move(turned(10.0), 1.0).mode is Mode.IN_POSITION


@pytest.mark.parametrize("wire", WIRES)
def test_a_fault_between_two_readings(wire: str) -> None:
    """A controller that latched and cleared a fault by itself is idle, no longer in position: it is not driven on."""
    bench = connected(wire)
    bench.driver.move(turned(5.0), 1.0)
    bench.endpoint.controller.latch(Fault.PLANT)
    bench.endpoint.controller._fault = Fault.NONE
    with pytest.raises(RefusedError, match="in position after its move, and the controller now reports mode idle"):
        bench.driver.move(turned(10.0), 1.0)
    bench.driver.reset()
    assert bench.driver.move(turned(10.0), 1.0).mode is Mode.IN_POSITION


def test_while_scanning() -> None:
    """A fault that comes and goes while the scanner measures ends the scan, and nothing is kept."""
    q = to_rad(HOME)
    readings, seen = [0], threading.Event()

    class Arm:
        capabilities = SimpleNamespace(simulated_time=False)

        def require_ready(self) -> RobotState:
            readings[0] += 1
            if readings[0] == 2:
                seen.set()
                raise RefusedError("the emergency stop is or was pressed; reset first", 2)
            return RobotState(Mode.IN_POSITION, HOME, True)

    class Scanner:
        source = "test"

        def take(self, view: Any) -> Acquired:
            assert seen.wait(10.0)
            return Acquired(np.zeros((1, 3)), "scanner")

    kinematics = SimpleNamespace(forward=lambda q: np.tile(np.eye(4), (len(q), 1, 1)))
    scene = SimpleNamespace(T_base_object=np.eye(4))
    cell: Any = SimpleNamespace(
        kinematics=kinematics, scene=scene, in_base=lambda q, T: T, scanner_pose=lambda q: np.eye(4)
    )
    reached, driver = [(execution.Segment(q[None], 1, 0), q)], Arm()
    folder: Any = SimpleNamespace(write_scan=lambda *args, **more: pytest.fail("the scan was kept"))
    with pytest.raises(RefusedError, match="emergency stop"):
        execution.scan_view(reached, cell, Scanner(), folder, "0001.npz", driver)  # type: ignore[arg-type]


@pytest.mark.parametrize("wire", WIRES)
def test_a_controller_that_never_shows_our_session(wire: str) -> None:
    """It is refused within two seconds, and nothing is sent."""
    bench = make_bench(wire)
    bench.driver.connect()
    report = bench.endpoint.report
    bench.endpoint.report = lambda: replace(report(), owner=0)  # type: ignore[method-assign]
    began = bench.clock.now()
    with pytest.raises(NotOwnerError, match=r"still reports 0 as its owner after 1 s"):
        bench.driver.move(turned(10.0), 0.5)
    assert bench.clock.now() - began < 2.0
    assert not bench.journal.of("move")


@pytest.mark.parametrize("wire", WIRES)
def test_an_owner_that_changes_during_a_move(wire: str) -> None:
    """The client stops the arm before it ends."""
    bench = connected(wire)
    report = bench.endpoint.report
    bench.endpoint.report = lambda: (  # type: ignore[method-assign]
        replace(state, owner=7) if (state := report()).path > 3000 and state.mode is Mode.MOVING else state
    )
    with pytest.raises(StateUnknownError, match="session 7 owns the arm now"):
        bench.driver.move(turned(40.0), 0.3)
    assert bench.journal.of("stop")
    state = bench.endpoint.controller.state()
    assert state.at_rest
    assert state.axes[0] < 400_000
    with pytest.raises(DriverError, match="stop"):
        bench.driver.move(turned(10.0), 0.3)
