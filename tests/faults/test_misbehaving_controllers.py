"""Controllers that misbehave: every field of the status x what is wrong with it x when x wire, and arms that do so.

What drives is the real loop of `cell scan`; its scan is a pause, before and after which the true arm is looked at. What
has to come of every case: no scan that was kept while the arm stood elsewhere or moved, no wait beyond its limit, no
exception but those of drivers and cell, and a sentence that names the cause.
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
from cell.scan import execute
from cell.scan.legs import Leg, Legs
from cell.scan.pose_error import Disturbance
from cell.scan.simulated import Simulated
from cell.world.travel import TravelBound
from drivers.contract import Mode, RobotState
from drivers.errors import DriverError
from drivers.setpoints import from_rad, to_rad

WIRES = ("serial", "modbus", "modbus-rtu")
PHASES = ("connect", "move", "standing", "scan", "stop")
HOME = to_rad(from_rad(np.radians([0.0, -90.0, 90.0, 0.0, 90.0, 0.0])))
GOALS = to_rad(from_rad(HOME + np.radians([[20.0, 0, 0, 0, 0, 0], [20.0, 10.0, -10.0, 0, 5.0, 30.0]])))
LEGS = Legs(HOME, (Leg(GOALS[:1], 1, 7), Leg(GOALS[1:], 2, 8), Leg(HOME[None], 0, -1)), 3.0)
LONGEST = 5.0 + 5.0 + 1.0 + 1.0  # s: no progress, an arm that is not seen standing after the stop, a state, a little
TRAVEL = TravelBound(load())
CELL = SimpleNamespace(arrival=0.001, travel=TRAVEL)

FIELDS = (
    "heartbeat", "boot", "flags", "mode", "owner", "ack_sequence", "ack_result", "done_sequence", "done_result",
    "queue_depth", "fault_code", "override", "path", "axes",
)  # fmt: skip
"""Of the status, as the register map has them; what only Modbus has stands in `MODBUS_FIELDS`."""

MODBUS_FIELDS = ("magic", "version", "word_order", "echo", "answer_sequence", "answer_result", "n_axes")
OF_CAPABILITIES = ("lower", "upper", "max_step", "max_speed", "time_scale")


@dataclass
class Past:
    """What a field said before.

    Attributes:
        told: time [s] and value of all statuses, true ones.
        first: value when the phase began.
    """

    told: list[tuple[float, Any]] = field(default_factory=list)
    first: Any = None


def _late(past: Past, value: Any, now: float) -> Any:
    return next((old for time, old in reversed(past.told) if time < now - 0.8), value)


WRONG: dict[str, Callable[[Past, Any, float], Any]] = {
    "zero": lambda past, value, now: value * 0,
    "one": lambda past, value, now: value * 0 + 1,
    "two": lambda past, value, now: value * 0 + 2,
    "all bits": lambda past, value, now: value * 0 + (65535 if np.ndim(value) == 0 else 2**31 - 1),
    "lying": lambda past, value, now: value ^ 1 if np.ndim(value) == 0 else value + np.int32(300),
    "contradicting": lambda past, value, now: value ^ 4 if np.ndim(value) == 0 else -value,
    "stuck": lambda past, value, now: past.first,
    "stale": lambda past, value, now: past.told[-1][1] if past.told else value,
    "late": _late,
    "flapping": lambda past, value, now: value if len(past.told) % 2 else value ^ 3,
}


@dataclass
class Rig:
    """A bench whose controller misbehaves in one phase, and the record of what the loop did.

    Attributes:
        bench: client, wire and controller.
        phase: what the loop does now.
        kept: true axes at both ends of each scan that was kept, its goal, and whether the arm stood.
        longest: longest call of the driver [s].
        notes: what a person was told.
    """

    bench: Any
    phase: str = "connect"
    kept: list[tuple[np.ndarray, np.ndarray, np.ndarray, bool]] = field(default_factory=list)
    longest: float = 0.0
    notes: list[str] = field(default_factory=list)
    outcome: str = ""

    def truth(self) -> RobotState:
        return self.bench.endpoint.controller.state()

    def call(self, phase: str, act: Callable[[], Any]) -> Any:
        """One call of the driver in its phase, timed; a scan's own look belongs to the scan."""
        before, self.phase = self.phase, "scan" if self.phase == "scan" and phase == "standing" else phase
        began = self.bench.clock.now()
        try:
            return act()
        finally:
            self.longest = max(self.longest, self.bench.clock.now() - began)
            self.phase = before

    def drive(self) -> None:
        """Connect, drive and scan both views, home, stop, close."""
        driver = self.bench.driver
        driver._notify = self.notes.append

        class Phased:
            capabilities = property(lambda _: driver.capabilities)

            def state(_) -> RobotState:  # noqa: N805 # the rig is self
                return self.call("standing", driver.state)

            def require_ready(_) -> RobotState:  # noqa: N805
                return self.call("standing", driver.require_ready)

            def move(_, points: Any, speed: float) -> RobotState:  # noqa: N805
                return self.call("move", lambda: driver.move(points, speed))

        try:
            try:
                self.call("connect", driver.connect)
                self.call("connect", driver.take)
                self.phase = "standing"
                folder: Any = SimpleNamespace(event=lambda *args, **details: None)
                execute.run(
                    LEGS, Phased(), CELL, Simulated(CELL, Disturbance(), 0), folder, speed=1.0, clock=self.bench.clock
                )
                self.call("stop", driver.stop)
            finally:
                self.call("stop", driver.close)
        except (DriverError, CellError) as error:
            self.outcome = str(error)

    def scan(self, looks: Any, *_: Any, still: Callable[[], None], **__: Any) -> tuple[int, dict[str, Any]]:
        """In place of `execute.scan_and_write`: half a second, and what is true at both ends of it."""
        begin, goal = self.truth(), looks[0][0].set_points[-1]
        self.phase = "scan"
        try:
            self.bench.clock.wait(0.5)
            still()
        finally:
            self.phase = "standing"
        end = self.truth()
        self.kept.append((begin.axes, end.axes, goal, begin.at_rest and end.at_rest))
        return 1, {}

    def judge(self, must_fail: bool, words: str) -> None:
        for begin, end, goal, stood in self.kept:
            assert stood, "scanned while the arm moved"
            for axes in (begin, end):
                off = TRAVEL(to_rad(goal)[None], to_rad(axes)[None])[0] if (axes != goal).any() else 0.0
                assert off <= 0.001, f"scanned {1000 * off:.1f} mm off"
        assert self.longest <= LONGEST, f"waited {self.longest:.1f} s: {self.outcome}"
        assert "\n" not in self.outcome
        if must_fail:
            assert self.outcome, "nobody noticed"
        if self.outcome:
            assert re.search(words, self.outcome), self.outcome
        else:
            assert len(self.kept) == 2


@pytest.fixture
def rig(bench: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Rig]:
    """Makes rigs, one at a time."""

    def make(wire: str) -> Rig:
        made = Rig(bench(wire))
        monkeypatch.setattr(execute, "scan_and_write", made.scan)
        return made

    return make


def of_field(rig: Rig, name: str, wrong: str, phase: str) -> None:
    """The controller says something else in one field of its status, in one phase."""
    past, report, clock = Past(), rig.bench.endpoint.report, rig.bench.clock

    def told() -> RobotState:
        state = report()
        value = state.axes.astype(np.int64) if name == "axes" else int(getattr(state, name))
        active = rig.phase == phase
        past.first = past.first if active and past.first is not None else value
        said = WRONG[wrong](past, value, clock.now()) if active else value
        past.told.append((clock.now(), value))
        if name == "axes":
            said = np.clip(said, -(2**31), 2**31 - 1).astype(np.int32)
        if name == "mode":
            said = Mode(said) if said in tuple(Mode) else said
        return replace(state, **{name: said})

    rig.bench.endpoint.report = told


def of_block(rig: Rig, name: str, wrong: str, phase: str) -> None:
    """The same of a field that only the registers have."""
    station, past, clock = rig.bench.server._station, Past(), rig.bench.clock
    tell = station._status

    def told() -> dict[str, Any]:
        values = tell()
        value = values[name]
        past.first = past.first if rig.phase == phase and past.first is not None else value
        if rig.phase == phase and name != "word_order":
            values[name] = WRONG[wrong](past, value, clock.now()) & 65535
        elif rig.phase == phase:
            values[name] = float({"zero": 0.0, "one": 1.0}.get(wrong, 2301.0))
        past.told.append((clock.now(), value))
        return values

    station._status = told


CAUSES = {
    "heartbeat": "heartbeat",
    "boot": "restarted",
    "flags": r"flag|stands|moves|neither|progress|arm|fault|emergency",
    "mode": r"mode|fault|flag|stands|moves|cannot be|in position|emergency|arguments",
    "owner": r"session|owner",
    "ack_sequence": r"command|answered|ended",
    "ack_result": r"refus|result|done|command|controller|number|set-point|speed|queue|emergency|via",
    "done_sequence": r"ended",
    "done_result": r"ended|stopped|result|fault|another client",
    "queue_depth": r"queued|about to|progress|ended last|answered|not in position|early",
    "fault_code": r"fault",
    "override": r"override|driving",
    "path": r"path",
    "axes": r"the arm is at|axes|limit|step|progress|must lie|via point",
}
"""Words of which one stands in the sentence."""

SURELY = {
    ("boot", "all bits"), ("flags", "all bits"), ("mode", "all bits"), ("owner", "zero"), ("owner", "all bits"),
    ("queue_depth", "all bits"), ("fault_code", "one"), ("fault_code", "all bits"), ("override", "all bits"),
    ("path", "all bits"), ("axes", "all bits"), ("axes", "lying"), ("heartbeat", "zero"), ("flags", "contradicting"),
}  # fmt: skip
"""What nobody may overlook, in these phases."""

CASES = list(itertools.product(FIELDS, WRONG, PHASES, WIRES))
REGISTERS = list(itertools.product(MODBUS_FIELDS, ("zero", "one", "all bits", "stuck", "stale"), PHASES, WIRES[1:]))


def _cases(cases: list[Any], sample: int) -> Any:
    """All cases, of which a sample is in the default suite; the others are slow."""
    quick = set(np.random.default_rng(16).permutation(len(cases))[:sample].tolist())
    marked = [pytest.param(*case, marks=() if k in quick else pytest.mark.slow) for k, case in enumerate(cases)]
    return pytest.mark.parametrize(("name", "wrong", "phase", "wire"), marked)


@_cases(CASES, 45)
def test_a_field_that_is_wrong(rig: Callable[[str], Rig], name: str, wrong: str, phase: str, wire: str) -> None:
    """All fields, all that can be wrong, at each phase, on every wire."""
    made = rig(wire)
    of_field(made, name, wrong, phase)
    made.drive()
    surely = (name, wrong) in SURELY and phase in ("move", "scan") and not (name == "heartbeat" and phase == "scan")
    made.judge(surely, CAUSES[name])


@_cases(REGISTERS, 15)
def test_a_register_that_is_wrong(rig: Callable[[str], Rig], name: str, wrong: str, phase: str, wire: str) -> None:
    """What the frames of the serial line do not have."""
    made = rig(wire)
    of_block(made, name, wrong, phase)
    made.drive()
    surely = name in ("magic", "version", "word_order", "n_axes") and wrong == "zero" and phase in ("move", "scan")
    made.judge(
        surely,
        r"register 0|version|word|echo|answers command|axes|result|refus|number|owner|stopped|done|session|not give",
    )


LINES: dict[str, Callable[[bytes], list[bytes]]] = {
    "mute": lambda packet: [],
    "torn": lambda packet: [packet[: len(packet) // 2]],
    "doubled": lambda packet: [packet, packet],
    "noisy": lambda packet: [bytes(byte ^ 0x55 for byte in packet)],
    "chatty": lambda packet: [b"<00001,0003,abc*00000000\r\n" * 20, packet],
}


@pytest.mark.parametrize("wire", WIRES)
@pytest.mark.parametrize(
    "phase", [pytest.param(phase, marks=() if phase in ("move", "scan") else pytest.mark.slow) for phase in PHASES]
)
@pytest.mark.parametrize("kind", [*LINES, "late", "refusing"])
def test_a_controller_whose_answers_are_wrong(rig: Callable[[str], Rig], kind: str, phase: str, wire: str) -> None:
    """From a moment of a phase on, for good: nothing is scanned after it that was not driven, and it ends in time."""
    made = rig(wire)
    send, station, clock = made.bench.line.send, made.bench.server._station, made.bench.clock
    answer, later = station.answer, []

    def sent(peer: int, packet: bytes) -> None:
        if made.phase != phase or kind == "refusing":
            send(peer, packet)
        elif kind == "late":
            later.append((clock.now() + 0.2, peer, packet))
        else:
            for piece in LINES[kind](packet):
                send(peer, piece)

    def turn(before: Callable[[], None] = clock.step) -> None:
        before()
        while later and later[0][0] <= clock.now():
            send(*later.pop(0)[1:])

    made.bench.line.send, clock.step = sent, turn
    station.answer = lambda packet: (station.refuse if kind == "refusing" and made.phase == phase else answer)(packet)
    made.drive()
    made.judge(
        kind in ("mute", "noisy", "refusing", "torn") and phase in ("connect", "move", "standing", "scan"),
        r"answer|frame|refused|gone|telegram|closed|exception|arguments|could not|occupied|echo",
    )
