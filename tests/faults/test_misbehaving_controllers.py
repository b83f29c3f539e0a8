"""Controllers that misbehave: every status field x every fault x every phase x every wire.

The execution loop of `cell scan` is tested with a pause as its scan. The true arm is checked before and after it.
Every case must satisfy: no scan is kept from another position or a moving arm, no wait exceeds its limit, no exception
other than those of drivers and cell, and a message that names the cause.
"""

import itertools
import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cell.errors import CellError
from cell.robot.model import load
from cell.scan import execution
from cell.scan.execution import ExecutionPlan, Segment
from cell.scan.simulated import Disturbance, Simulated
from cell.world.travel import TravelBound
from drivers.contract import Mode, RobotState
from drivers.errors import DriverError
from drivers.setpoints import from_rad, to_rad
from tests.support.driver_bench import HOME as HOME_COUNTS
from tests.support.driver_bench import WIRES, Bench, make_bench

PHASES = ("connect", "move", "standing", "scan", "stop")
HOME = to_rad(HOME_COUNTS)
GOALS = to_rad(from_rad(HOME + np.radians([[20.0, 0, 0, 0, 0, 0], [20.0, 10.0, -10.0, 0, 5.0, 30.0]])))
PLAN = ExecutionPlan(HOME, (Segment(GOALS[:1], 1, 7), Segment(GOALS[1:], 2, 8), Segment(HOME[None], 0, -1)), 3.0)
MAX_WAIT = 5.0 + 5.0 + 1.0 + 1.0  # s: no progress, an arm not seen at rest after the stop, a state, a margin
TRAVEL = TravelBound(load())
CELL = SimpleNamespace(arrival=0.001, travel=TRAVEL)

FIELDS = (
    *("heartbeat", "boot", "flags", "mode", "owner", "ack_sequence", "ack_result", "done_sequence", "done_result"),
    *("queue_depth", "fault_code", "override", "path", "axes"),
)
"""Fields of the status on every wire; `MODBUS_FIELDS` are those of Modbus only."""

MODBUS_FIELDS = ("magic", "version", "word_order", "echo", "answer_sequence", "answer_result", "n_axes")


@dataclass
class Past:
    """Earlier true values of a field.

    Attributes:
        reported: time [s] and value of each status.
        first: value at the beginning of the phase.
    """

    reported: list[tuple[float, Any]] = field(default_factory=list)
    first: Any = None

    def update(self, value: Any, now: float, active: bool) -> None:
        """Add a value; `first` stays during the active phase."""
        self.first = self.first if active and self.first is not None else value
        self.reported.append((now, value))


def _late(past: Past, value: Any, now: float) -> Any:
    return next((old for time, old in reversed(past.reported) if time < now - 0.8), value)


FAULTS: dict[str, Callable[[Past, Any, float], Any]] = {
    "zero": lambda past, value, now: value * 0,
    "one": lambda past, value, now: value * 0 + 1,
    "two": lambda past, value, now: value * 0 + 2,
    "all bits": lambda past, value, now: value * 0 + (65535 if np.ndim(value) == 0 else 2**31 - 1),
    "lying": lambda past, value, now: value ^ 1 if np.ndim(value) == 0 else value + np.int32(300),
    "contradicting": lambda past, value, now: value ^ 4 if np.ndim(value) == 0 else -value,
    "stuck": lambda past, value, now: past.first,
    "stale": lambda past, value, now: past.reported[-2][1] if len(past.reported) > 1 else value,
    "late": _late,
    "flapping": lambda past, value, now: value if len(past.reported) % 2 == 0 else value ^ 3,
}


@dataclass
class Rig:
    """A bench whose controller misbehaves in one phase, and the record of the loop's actions.

    Attributes:
        bench: client, wire and controller.
        phase: current phase of the loop.
        scans: of each scan the true axes at its beginning and end, its goal, and whether the arm was at rest.
        longest: longest call of the driver [s].
        outcome: message of the error; empty: none.
    """

    bench: Bench
    phase: str = "connect"
    scans: list[tuple[np.ndarray, np.ndarray, np.ndarray, bool]] = field(default_factory=list)
    longest: float = 0.0
    outcome: str = ""

    def true_state(self) -> RobotState:
        return self.bench.endpoint.controller.state()

    def call(self, phase: str, act: Callable[[], Any]) -> Any:
        """Call the driver in a phase and measure the time; checks during a scan belong to the scan."""
        before, self.phase = self.phase, "scan" if self.phase == "scan" and phase == "standing" else phase
        began = self.bench.clock.now()
        try:
            return act()
        finally:
            self.longest = max(self.longest, self.bench.clock.now() - began)
            self.phase = before

    def drive(self) -> None:
        """Connect, drive and scan both views, drive home, stop, close."""
        driver = self.bench.driver

        class Phased:
            capabilities = property(lambda _: driver.capabilities)

            def state(_) -> RobotState:  # noqa: N805 # the rig is self
                return self.call("standing", driver.state)

            def require_ready(_) -> RobotState:  # noqa: N805
                return self.call("standing", driver.require_ready)

            def move(_, points: Any, speed: float) -> RobotState:  # noqa: N805
                return self.call("move", lambda: driver.move(points, speed))

        folder: Any = SimpleNamespace(event=lambda *args, **details: None)
        simulated = Simulated(CELL, Disturbance(), 0)
        try:
            try:
                self.call("connect", driver.connect)
                self.call("connect", driver.take)
                self.phase = "standing"
                execution.drive(PLAN, Phased(), CELL, simulated, folder, speed=1.0, clock=self.bench.clock)
                self.call("stop", driver.stop)
            finally:
                self.call("stop", driver.close)
        except (DriverError, CellError) as error:
            self.outcome = str(error)

    def scan(self, reached: Any, cell: Any, *arguments: Any) -> tuple[int, dict[str, Any]]:
        """Replace `execution.scan_view`: wait half a second and record the true state at both ends."""
        begin, goal, driver = self.true_state(), reached[0][0].set_points[-1], arguments[-1]
        self.phase = "scan"
        try:
            self.bench.clock.wait(0.5)
            execution._require_arrived(reached[-1][0], driver.require_ready(), cell)
        finally:
            self.phase = "standing"
        end = self.true_state()
        self.scans.append((begin.axes, end.axes, goal, begin.at_rest and end.at_rest))
        return 1, {}

    def judge(self, must_fail: bool, causes: str) -> None:
        for begin, end, goal, at_rest in self.scans:
            assert at_rest, "scanned while the arm moved"
            for axes in (begin, end):
                error = TRAVEL(to_rad(goal)[None], to_rad(axes)[None])[0] if (axes != goal).any() else 0.0
                assert error <= 0.001, f"scanned {1000 * error:.1f} mm from the goal"
        assert self.longest <= MAX_WAIT, f"waited {self.longest:.1f} s: {self.outcome}"
        assert "\n" not in self.outcome
        assert self.outcome or not must_fail, "not detected"
        if self.outcome:
            assert re.search(causes, self.outcome), self.outcome
        else:
            assert len(self.scans) == 2


@pytest.fixture
def rig(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Rig]:
    """Return a function that makes a rig."""

    def make(wire: str) -> Rig:
        new_rig = Rig(make_bench(wire))
        monkeypatch.setattr(execution, "scan_view", new_rig.scan)
        return new_rig

    return make


def disturb_field(rig: Rig, name: str, fault: str, phase: str) -> None:
    """Let the controller report a wrong value in one field of its status during one phase."""
    past, report, clock = Past(), rig.bench.endpoint.report, rig.bench.clock

    def disturbed() -> RobotState:
        state, active = report(), rig.phase == phase
        value: Any = state.axes.astype(np.int64) if name == "axes" else int(getattr(state, name))
        past.update(value, clock.now(), active)
        if active:
            value = FAULTS[fault](past, value, clock.now())
        if name == "axes":
            value = np.clip(value, -(2**31), 2**31 - 1).astype(np.int32)
        if name == "mode" and value in tuple(Mode):
            value = Mode(value)
        return replace(state, **{name: value})

    rig.bench.endpoint.report = disturbed  # type: ignore[method-assign]


def disturb_register(rig: Rig, name: str, fault: str, phase: str) -> None:
    """Do the same with a field that only the registers have."""
    station: Any = rig.bench.server._station
    past, clock, status = Past(), rig.bench.clock, station._status

    def disturbed() -> dict[str, Any]:
        values, active = status(), rig.phase == phase
        past.update(values[name], clock.now(), active)
        if active and name == "word_order":
            values[name] = float({"zero": 0.0, "one": 1.0}.get(fault, 2301.0))
        elif active:
            values[name] = FAULTS[fault](past, values[name], clock.now()) & 65535
        return values

    station._status = disturbed


CAUSES = {
    "heartbeat": "heartbeat",
    "boot": "restarted",
    "flags": r"flag|at rest|moves|neither|progress|arm|fault|emergency",
    "mode": r"mode|fault|flag|at rest|moves|impossible|in position|emergency|arguments",
    "owner": r"session|owner",
    "ack_sequence": r"command|answered|ended",
    "ack_result": r"refus|result|done|command|controller|number|set-point|speed|queue|emergency|via",
    "done_sequence": r"ended",
    "done_result": r"ended|stopped|result|fault|another client",
    "queue_depth": r"queued|will move|progress|last ended|answered|not in position|early",
    "fault_code": r"fault",
    "override": r"override|motion",
    "path": r"path",
    "axes": r"the arm is at|axes|limit|step|progress|must lie|via point",
}
"""Patterns of which the message must contain one."""

CERTAIN = {
    *(("boot", "all bits"), ("flags", "all bits"), ("mode", "all bits"), ("owner", "zero"), ("owner", "all bits")),
    *(("queue_depth", "all bits"), ("fault_code", "one"), ("fault_code", "all bits"), ("override", "all bits")),
    *(("path", "all bits"), ("axes", "all bits"), ("axes", "lying"), ("flags", "contradicting")),
}
"""Faults that must be detected during a move or scan, and a frozen heartbeat during a move."""


def _cases(cases: list[Any], sample: int) -> Any:
    """Parametrise with all cases; a random sample is in the default suite, the others are slow."""
    quick = set(np.random.default_rng(16).permutation(len(cases))[:sample].tolist())
    marked = [pytest.param(*case, marks=() if k in quick else pytest.mark.slow) for k, case in enumerate(cases)]
    return pytest.mark.parametrize(("name", "fault", "phase", "wire"), marked)


@_cases(list(itertools.product(FIELDS, FAULTS, PHASES, WIRES)), 45)
def test_a_wrong_field(rig: Callable[[str], Rig], name: str, fault: str, phase: str, wire: str) -> None:
    """Every field, fault and phase is tested on every wire."""
    bench_rig = rig(wire)
    disturb_field(bench_rig, name, fault, phase)
    bench_rig.drive()
    is_certain = (name, fault) in CERTAIN and phase in ("move", "scan")
    bench_rig.judge(is_certain or (name, fault, phase) == ("heartbeat", "zero", "move"), CAUSES[name])


@_cases(list(itertools.product(MODBUS_FIELDS, ("zero", "one", "all bits", "stuck", "stale"), PHASES, WIRES[1:])), 15)
def test_a_wrong_register(rig: Callable[[str], Rig], name: str, fault: str, phase: str, wire: str) -> None:
    """Fields that only the registers have are tested with every fault and phase."""
    bench_rig = rig(wire)
    disturb_register(bench_rig, name, fault, phase)
    bench_rig.drive()
    bench_rig.judge(
        name in ("magic", "version", "word_order", "n_axes") and fault == "zero" and phase in ("move", "scan"),
        r"register 0|version|word|echo|answers command|axes|result|refus|number|owner|stopped|done|session|not give",
    )


LINES: dict[str, Callable[[bytes], list[bytes]]] = {
    "mute": lambda packet: [],
    "torn": lambda packet: [packet[: len(packet) // 2]],
    "doubled": lambda packet: [packet, packet],
    "noisy": lambda packet: [bytes(byte ^ 0x55 for byte in packet)],
    "chatty": lambda packet: [b"<00001,0003,abc*00000000\r\n" * 20, packet],
}


@_cases(list(itertools.product([*LINES, "late", "refusing"], ["answers"], PHASES, WIRES)), 21)
def test_wrong_answers(rig: Callable[[str], Rig], name: str, fault: str, phase: str, wire: str) -> None:
    """All answers from the beginning of a phase on are disturbed."""
    bench_rig = rig(wire)
    station: Any = bench_rig.bench.server._station
    send, clock, answer, later = bench_rig.bench.line.send, bench_rig.bench.clock, station.answer, []

    def disturbed_send(peer: int, packet: bytes) -> None:
        if bench_rig.phase != phase or name == "refusing":
            send(peer, packet)
        elif name == "late":
            later.append((clock.now() + 0.2, peer, packet))
        else:
            for piece in LINES[name](packet):
                send(peer, piece)

    def step(before: Callable[[], None] = clock.step) -> None:
        before()
        while later and later[0][0] <= clock.now():
            send(*later.pop(0)[1:])

    bench_rig.bench.line.send, clock.step = disturbed_send, step  # type: ignore[method-assign]
    station.answer = lambda packet: (station.refuse if name == "refusing" and bench_rig.phase == phase else answer)(
        packet
    )
    bench_rig.drive()
    bench_rig.judge(
        name in ("mute", "noisy", "refusing", "torn") and phase != "stop",
        r"answer|frame|refused|gone|telegram|closed|exception|arguments|could not|occupied|echo",
    )
