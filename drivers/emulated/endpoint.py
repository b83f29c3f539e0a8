"""The controller's end of a wire, the same for every protocol: owner, watchdog, staging, restarts, a journal.

**One session owns the arm.** It is taken and given; moves, resets and staging are the owner's alone. A stop is
everybody's: one that comes from somebody else ends the session, so that the owner cannot go on as if nothing had
happened. An owner that has been silent for longer than its watchdog while the arm stands can be taken over from.

**The watchdog is armed only while the arm moves.** Any new message of the owner is its heartbeat; a client that waits
for a move asks for the state far more often than the watchdog is long. When a moving arm has heard nothing for that
long it brakes on its path and latches the fault WATCHDOG, which only an explicit reset clears. An arm that stands needs
no heartbeat: there is nothing to stop, and a scan of ten minutes between two moves is no fault.

The watchdog runs on the wire's clock, which is real time even where the simulated arm is faster.
"""

from dataclasses import replace
from typing import Any, Protocol

from drivers.clock import Clock
from drivers.commands import LAST_SEQUENCE, Answer, Command, Move, Result, Stop, is_newer
from drivers.contract import Capabilities, Fault, RobotState
from drivers.controller import Controller
from drivers.limits import Limits
from drivers.plant import Plant
from drivers.wire import (
    DEFAULT_WATCHDOG_MS,
    MOST_POINTS,
    SCALES,
    WATCHDOG_RANGE_MS,
    Commit,
    Stage,
    Staging,
    speed_from_wire,
    speed_to_wire,
)

HEARTBEAT_PERIOD = 0.01
"""Time [s] of the wire's clock in which the controller's heartbeat counts on by one."""

Entry = dict[str, Any]
"""One line of the journal: `event` (start, move, end, fault) and what belongs to it."""


class Witness(Protocol):
    """Who is told what happens, before the client is."""

    def entry(self, entry: Entry) -> None:
        """Something happened."""

    def seen(self, state: RobotState) -> None:
        """This is told to the client next."""


class Endpoint:
    """A controller that is reached over a wire. Not thread-safe: one loop serves it.

    Args:
        plant: the arm.
        limits: the controller's.
        clock: the controller's time, which may be faster than real.
        wire_clock: the watchdog's and heartbeat's time: real.
        witness: who is told.
        boot: number of this start, 1 to 65535; each restart counts on.
        restarted: latch the fault RESTARTED at once: the last run did not end in order.
        time_scale: seconds of `clock` per second of `wire_clock`, as a hello tells it.
    """

    def __init__(
        self,
        plant: Plant,
        limits: Limits,
        clock: Clock,
        wire_clock: Clock,
        witness: Witness,
        *,
        boot: int = 1,
        restarted: bool = False,
        time_scale: float = 1.0,
    ) -> None:
        self.limits, self.boot = limits, boot
        self.moves = 0  # accepted so far
        self._plant, self._clock, self._wire_clock = plant, clock, wire_clock
        self._witness, self._time_scale = witness, time_scale
        self._start(restarted)

    def _start(self, restarted: bool) -> None:
        self.controller = Controller(self._plant, self.limits, self._clock)
        self._staging = Staging(len(self.limits.lower))
        self.owner = 0  # session; 0: none
        self._watchdog_ms = DEFAULT_WATCHDOG_MS
        self._heard = self._wire_clock.now()
        self._fault = 0
        self._done = 0
        if restarted:
            self.controller.latch(Fault.RESTARTED)
        state = self.controller.state()
        self._tell("start", {"axes": state.axes.tolist()})
        self._witness.seen(state)

    @property
    def capabilities(self) -> Capabilities:
        """What a hello tells."""
        return replace(
            self.limits.capabilities("scan-cell controller", hardware=True, simulated_time=False),
            max_speed=speed_from_wire(speed_to_wire(self.limits.max_speed)),
            max_via=min(self.limits.max_via or MOST_POINTS, MOST_POINTS),
            time_scale=max(round(self._time_scale * SCALES), 1) / SCALES,
        )

    def take(self, session: int, watchdog_ms: int) -> Answer:
        """Give the arm to a session, 1 to 65535, that may be silent for so long [ms] while it moves."""
        least, most = WATCHDOG_RANGE_MS
        if not 1 <= session <= LAST_SEQUENCE:
            return Answer(session, Result.NOT_OWNER, f"session {session} is outside 1 to {LAST_SEQUENCE}")
        if not least <= watchdog_ms <= most:
            return Answer(session, Result.WATCHDOG)
        if self.owner not in (0, session) and (self._silence_ms() <= self._watchdog_ms or not self._observe().standing):
            return Answer(session, Result.NOT_OWNER, f"session {self.owner} owns the arm")
        if session != self.owner:
            self._staging = Staging(len(self.limits.lower))
        self.owner, self._watchdog_ms = session, watchdog_ms
        self.hear(session)
        return Answer(session, Result.OK)

    def give(self, session: int) -> Answer:
        """Take the arm back from a session."""
        if session != self.owner:
            return Answer(session, Result.NOT_OWNER)
        self.owner = 0
        return Answer(session, Result.OK)

    def hear(self, session: int) -> None:
        """A session sent something new: the owner's heartbeat, if it is the owner."""
        if session == self.owner:
            self._heard = self._wire_clock.now()

    def _silence_ms(self) -> float:
        return (self._wire_clock.now() - self._heard) * 1000.0

    def tick(self) -> RobotState:
        """Look whether the client is still there; call it several times in a watchdog's time, and after reading.

        Messages that wait are read first: a controller that was itself held up does not take that for silence.
        """
        state = self._observe()
        silence = self._silence_ms()
        if not state.standing and silence > self._watchdog_ms and not state.fault_code:
            self.controller.latch(
                Fault.WATCHDOG, f"{Fault.WATCHDOG.sentence} (nothing heard for {silence / 1000:.2f} s while it moved)"
            )
            state = self._observe()
        return state

    def stage(self, session: int, sequence: int, piece: Stage) -> Answer:
        """Write via points of the owner's move `sequence` to come."""
        if not self._owned_by(session):
            return Answer(sequence, Result.NOT_OWNER)
        last = self.controller.state().ack_sequence
        if sequence == 0:
            return Answer(sequence, Result.SEQUENCE)
        if not is_newer(sequence, last):
            return Answer(sequence, Result.STALE)
        return Answer(sequence, Result.OK if self._staging.put(sequence, piece) else Result.INCOMPLETE)

    def commit(self, session: int, sequence: int, commit: Commit) -> Answer:
        """Execute a move whose first points are staged. An incomplete one does not use the number up."""
        if not self._owned_by(session):
            return Answer(sequence, Result.NOT_OWNER)
        points = self._staging.take(sequence, commit)
        if points is None:
            last = self.controller.state().ack_sequence
            newer = sequence > 0 and is_newer(sequence, last)
            return Answer(sequence, Result.INCOMPLETE if newer else Result.STALE)
        return self.command(session, sequence, Move(points, speed_from_wire(commit.speed)))

    def command(self, session: int, sequence: int, command: Command) -> Answer:
        """Execute a command of the owner by the rule of the sequence numbers, and anybody's stop at once."""
        if not self._owned_by(session):
            if not isinstance(command, Stop):
                return Answer(sequence, Result.NOT_OWNER)
            self.controller.halt()
            self._tell("stop", {"session": session, "owner": self.owner})
            self.owner = 0  # who owned it is told by that: whoever stopped the arm had a reason
            self._observe()
            return Answer(sequence, Result.OK)
        before = self._observe()
        answer = self.controller.command(sequence, command)
        new = answer.result == Result.OK and before.ack_sequence != sequence
        if new and isinstance(command, Move):
            self.moves += 1
            driven = {"from": before.axes.tolist(), "set_points": command.set_points.tolist()}
            self._tell("move", {"sequence": sequence, "speed": command.speed, **driven})
        elif new:
            self._tell(type(command).__name__.lower(), {"sequence": sequence})
        self._observe()
        return answer

    def emergency_stop(self, pressed: bool = True) -> None:
        """Press or release the emergency stop."""
        self.controller.emergency_stop(pressed)
        self._observe()

    def brake_for_restart(self) -> None:
        """The power goes: the drives brake on the path. Call `restart` once the arm stands."""
        self.controller.latch(Fault.RESTARTED)
        self._observe()

    def restart(self) -> None:
        """The controller starts anew over the same arm: numbers from 0, nothing staged, the fault RESTARTED."""
        self.boot = self.boot % 65535 + 1
        self._start(restarted=True)

    def report(self) -> RobotState:
        """The state as a status tells it."""
        beat = int(self._wire_clock.now() / HEARTBEAT_PERIOD) % 65536
        return replace(self._observe(), heartbeat=beat)

    def _owned_by(self, session: int) -> bool:
        return session == self.owner != 0

    def _observe(self) -> RobotState:
        """The state with the boot number; tells the witness what has changed."""
        state = replace(self.controller.state(), boot=self.boot, owner=self.owner)
        if state.done_sequence != self._done:
            self._done = state.done_sequence
            end = {"sequence": self._done, "result": int(state.done_result), "axes": state.axes.tolist()}
            self._tell("end", end)
        if state.fault_code != self._fault:
            self._fault = state.fault_code
            if self._fault:
                self._tell("fault", {"code": int(self._fault)})
        self._witness.seen(state)
        return state

    def _tell(self, event: str, more: Entry) -> None:
        self._witness.entry({"event": event, "boot": self.boot, **more})
