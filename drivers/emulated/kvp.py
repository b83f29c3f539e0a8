"""An emulated KUKA controller: it runs the KRL program of `drivers.wires.kvp_program` and offers its variables.

The program is executed by an interpreter (`drivers.emulated.krl`), not imitated. The proxy answers readings and writes
of any variable between two statements. After an emergency stop or a restart the emulated person selects and starts the
program again.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from drivers.clock import Clock
from drivers.contract import Fault
from drivers.emulated import krl
from drivers.emulated.endpoint import Recorder
from drivers.limits import Limits
from drivers.profile import Reference, interpolate, resting
from drivers.setpoints import PER_DEGREE, Floats, axis_name, from_rad
from drivers.wires import kvp, kvp_program

_STATEMENTS = 40  # that the program executes between two looks at the wire
_WRITABLE: Final = ("$TIMER", "$OV_PRO")


@dataclass
class Rest:
    """Whether the arm is at rest."""

    at_rest: bool


class _TimerFlags:
    """Flags of timers [ms]: True above 0."""

    def __init__(self, timers: dict[int, float]) -> None:
        self._timers = timers

    def __getitem__(self, number: int) -> bool:
        return self._timers[number] > 0


class KukaController:
    """State of the emulated controller.

    Args:
        q: (n,) axes [rad].
        limits: limits of the axes.
        clock: real time.
        recorder: receives the events of the journal.

    Attributes:
        moves: number of accepted moves.
        variables: of the controller and of its program.
        is_running: whether the program runs; a person stops and starts it.
    """

    def __init__(self, q: Floats, limits: Limits, clock: Clock, recorder: Recorder) -> None:
        self.moves, self.is_running = 0, True
        self._limits, self._clock, self._recorder = limits, clock, recorder
        self._now = clock.now()
        self._reference: Reference = resting(q)
        self._elapsed, self._speed = 0.0, 1.0
        self._axes = [axis_name(axis) for axis in range(len(q))]
        timers = dict.fromkeys(range(1, kvp_program.MAX_TIMER + 1), 0.0)
        low, high = (
            {number: float(each) for number, each in enumerate(limit / PER_DEGREE, start=1)}
            for limit in (limits.lower, limits.upper)
        )
        self.variables: dict[str, Any] = {
            "$ALARM_STOP": True, "$OV_PRO": 100, "$TIMER": timers, "$TIMER_FLAG": _TimerFlags(timers),
            "$TIMER_STOP": dict.fromkeys(timers, True), "$SOFTN_END": low, "$SOFTP_END": high, "$ADVANCE": 3,
            "$ROBNAME[]": '"EMULATED"',
        }  # fmt: skip
        program = {name.rpartition(".")[2]: content.decode("ascii") for name, content in kvp_program.files().items()}
        self._program = krl.Interpreter(program["src"], program["dat"], self.variables, self)
        self._seen = dict(self.variables["SC_STATE"])
        self._steps: krl.Steps = self._program.start()
        self._update()

    def tick(self) -> Rest:
        """Let time pass, and the program run until it waits."""
        now = self._clock.now()
        passed, self._now = now - self._now, now
        self._elapsed += passed
        for number, is_stopped in self.variables["$TIMER_STOP"].items():
            self.variables["$TIMER"][number] += 0.0 if is_stopped else passed * 1000.0
        self._update()
        if self._is_free:
            for _ in range(_STATEMENTS):
                is_computing = next(self._steps)
                self._update()
                self._observe()
                if not is_computing:
                    break
        else:
            self._program.note_edges()
        return Rest(bool(self.variables["$ROB_STOPPED"]))

    def read(self, name: str) -> str | None:
        """Return the value of a variable; None if there is none."""
        try:
            return krl.render(krl.read(self.variables, name))
        except (KeyError, TypeError):
            return None

    def write(self, name: str, text: str) -> bool:
        """Write a variable; return False if it is none that a client writes, or the value does not fit."""
        if name.startswith("$") and not name.startswith(_WRITABLE):
            return False
        try:
            krl.write(self.variables, name, krl.parse(text))
        except (KeyError, ValueError, TypeError):
            return False
        return True

    def emergency_stop(self, pressed: bool = True) -> None:
        """Press or release the emergency stop; after its release a person starts the program again."""
        self.variables["$ALARM_STOP"] = not pressed
        self._program.note_edges()
        if pressed:
            self._recorder.record_event({"event": "fault", "boot": self._boot, "code": int(Fault.EMERGENCY_STOP)})
            self.brake()

    def stop_program(self, stopped: bool = True) -> None:
        """Press the stop key, or start the program again; it continues its motion."""
        self.is_running = not stopped
        if stopped:
            self.brake()

    def brake_for_restart(self) -> None:
        """Brake on the path as in a power failure. Call `restart` once the arm is at rest."""
        self.stop_program()

    def restart(self) -> None:
        """Start the program from its beginning; its variables persist."""
        self.is_running, self.variables["$TIMER_STOP"] = True, dict.fromkeys(self.variables["$TIMER"], True)
        self._steps = self._program.start()

    def time_to_wait(self) -> float:
        """Return the rest of the current motion [s]."""
        return max(self._reference.duration - self._elapsed, 0.0)

    def ptp(self, target: krl.Struct) -> Iterator[bool]:
        """Drive to a target; a motion that was braked goes on."""
        goal = np.array(self._reference.end)
        for axis, name in enumerate(self._axes):
            goal[axis] = np.radians(float(np.float32(target.get(name, 0.0))))
        while (from_rad(goal) != from_rad(self._reference.end)).any():
            limits = self._limits
            velocity = limits.velocity * self._speed * self.variables["$OV_PRO"] / 100.0
            self._reference = interpolate(self._reference.end, goal[None], velocity, limits.acceleration, limits.jerk)
            self._elapsed = 0.0
            while self._elapsed < self._reference.duration:
                yield False
        yield True

    def wait(self, seconds: float) -> Iterator[bool]:
        """Wait."""
        end = self._clock.now() + seconds
        while self._clock.now() < end:
            yield False

    def brake(self) -> None:
        """Brake on the path."""
        if self._elapsed < self._reference.duration:
            self._reference = self._reference.braking_from(self._elapsed)
            self._elapsed = 0.0

    def bas(self, command: str, value: float) -> None:
        """Set the speed of motions [%]."""
        if command == "VEL_PTP":
            self._speed = value / 100.0

    @property
    def _boot(self) -> int:
        return int(self.variables["SC_STATE"].BOOT)

    @property
    def _is_free(self) -> bool:
        return self.is_running and bool(self.variables["$ALARM_STOP"])

    def _update(self) -> None:
        """Update the system variables."""
        is_moving = self._elapsed < self._reference.duration
        q = self._reference.sample(np.array([self._elapsed]))[0][0] if is_moving else self._reference.end
        degrees = np.degrees(q).astype(np.float32)
        self.variables.update({
            "$AXIS_ACT": krl.Struct(zip(self._axes, map(float, degrees), strict=True)),
            "$ROB_STOPPED": not is_moving, "$ROB_TIMER": int(self._now * 1000.0),
            "$PRO_STATE1": "#P_ACTIVE" if self._is_free else "#P_STOP",
        })  # fmt: skip

    def _observe(self) -> None:
        """Record the events that the state of the program shows."""
        state, seen = self.variables["SC_STATE"], self._seen
        if state == seen:
            return
        axes = from_rad(self._reference.sample(np.array([self._elapsed]))[0][0]).tolist()
        if seen["BOOT"] != state.BOOT:
            self._record("start", axes=axes)
        if state.RUNNING not in (0, seen["RUNNING"]):
            self.moves += 1
            points = [self.variables["SC_POINT"][n + 1].AXES for n in range(self.variables["SC_ORDER"].COUNT)]
            counts = [[round(float(point[name]) * PER_DEGREE) for name in self._axes] for point in points]
            self._record("move", sequence=state.RUNNING, set_points=counts, **{"from": axes})
        if state.DONE not in (0, seen["DONE"]):
            self._record("end", sequence=state.DONE, result=state.ENDING, axes=axes)
        if state.FAULT not in (0, seen["FAULT"], Fault.EMERGENCY_STOP, Fault.RESTARTED):
            self._record("fault", code=state.FAULT)
        if seen["FAULT"] and not state.FAULT:
            self._record("reset", sequence=state.ACK)
        self._seen = dict(state)

    def _record(self, event: str, **details: Any) -> None:
        self._recorder.record_event({"event": event, "boot": self._boot, **details})


class KvpStation:
    """The proxy on the controller (`drivers.emulated.stations.Station`)."""

    silence = 5.0

    def __init__(self, endpoint: KukaController) -> None:
        self.endpoint = endpoint

    def split(self, received: bytes) -> tuple[list[bytes], bytes]:
        """Cut a stream into requests, with their headers, and the rest."""
        messages, rest = kvp.split(received)
        packets, at = [], 0
        for _, body in messages:
            packets.append(received[at : at + 4 + len(body)])
            at += 4 + len(body)
        return packets, rest

    def answer(self, packet: bytes) -> bytes:
        """Return the answer to a request."""
        self.endpoint.tick()
        ((number, body),), _ = kvp.split(packet)
        try:
            mode, name, value = kvp.parse_request(body)
        except (ValueError, IndexError):
            return b""
        if mode == kvp.WRITE:
            return kvp.answer(number, mode, value, success=self.endpoint.write(name, value))
        text = self.endpoint.read(name)
        return kvp.answer(number, mode, text or "", success=text is not None)

    def refuse(self, packet: bytes) -> bytes:
        """Return a failure."""
        ((number, body),), _ = kvp.split(packet)
        return kvp.answer(number, body[0], "", success=False)

    def restart(self) -> None:
        """Do nothing: the proxy has no state."""
