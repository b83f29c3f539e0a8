"""The controller's end of a wire, the same for every protocol: owner, watchdog, staging, restarts, a journal.

**One session owns the arm.** A client takes it and gives it back; only the owner may move, reset and stage. Every
client may stop: a stop by another client ends the session, so that the owner does not continue unaware of it. If the
arm is at rest and the owner has been silent for longer than its watchdog, another client can take the arm.

**The watchdog is active only while the arm moves.** Any new message of the owner is its heartbeat; a client that waits
for a move reads the state much more often than the watchdog expires. A moving arm without a message for that long
brakes on its path and latches the fault WATCHDOG, which only an explicit reset clears. An arm at rest needs no
heartbeat, since nothing has to be stopped: a scan of ten minutes between two moves is not a fault.

The watchdog runs on the wire's clock, which is real time even if the simulated arm is faster.
"""

from dataclasses import replace
from typing import Any, Protocol

from drivers.clock import Clock
from drivers.contract import (
    LAST_SEQUENCE,
    Answer,
    Capabilities,
    Command,
    Fault,
    Move,
    Result,
    RobotState,
    Stop,
    is_newer,
)
from drivers.limits import Limits
from drivers.simulated_controller import Controller, Plant
from drivers.wire import (
    DEFAULT_WATCHDOG_MS,
    MAX_POINTS,
    REAL_TIME,
    WATCHDOG_RANGE_MS,
    Commit,
    Stage,
    StagingBuffer,
    speed_from_wire,
    speed_to_wire,
)

HEARTBEAT_PERIOD = 0.01
"""Time [s] of the wire's clock between two values of the controller's heartbeat."""

Event = dict[str, Any]
"""One line of the journal: `event` (start, move, end, fault, stop, reset) and its details."""


class Recorder(Protocol):
    """Recorder of events and states; it is called before the client receives them."""

    def record_event(self, event: Event) -> None:
        """Record an event."""

    def record_state(self, state: RobotState) -> None:
        """Record a state that the client receives next."""


class Endpoint:
    """A controller behind a wire. Not thread-safe: one loop serves it.

    Args:
        plant: the arm.
        limits: the controller's.
        clock: the controller's time, which may be faster than real time.
        wire_clock: real time, for watchdog and heartbeat.
        recorder: receives events and states.
        boot: number of this start, 1 to 65535; each restart increments it.
        restarted: latch the fault RESTARTED at once: the last run was killed.
        time_scale: seconds of `clock` per second of `wire_clock`, reported as capability.
    """

    def __init__(
        self,
        plant: Plant,
        limits: Limits,
        clock: Clock,
        wire_clock: Clock,
        recorder: Recorder,
        *,
        boot: int = 1,
        restarted: bool = False,
        time_scale: float = 1.0,
    ) -> None:
        self.limits, self.boot = limits, boot
        self.moves = 0  # number of accepted moves
        self._plant, self._clock, self._wire_clock = plant, clock, wire_clock
        self._recorder, self._time_scale = recorder, time_scale
        self._start(restarted)

    def _start(self, restarted: bool) -> None:
        self.controller = Controller(self._plant, self.limits, self._clock)
        self._staging = StagingBuffer(len(self.limits.lower))
        self.owner = 0  # session; 0: none
        self._watchdog_ms = DEFAULT_WATCHDOG_MS
        self._last_message = self._wire_clock.now()
        self._fault = 0
        self._done = 0
        if restarted:
            self.controller.latch(Fault.RESTARTED)
        state = self.controller.state()
        self._record("start", {"axes": state.axes.tolist()})
        self._recorder.record_state(state)

    @property
    def capabilities(self) -> Capabilities:
        """Capabilities as the wire reports them."""
        return replace(
            self.limits.capabilities("scan-cell controller", hardware=True, simulated_time=False),
            max_speed=speed_from_wire(speed_to_wire(self.limits.max_speed)),
            max_via=min(self.limits.max_via or MAX_POINTS, MAX_POINTS),
            time_scale=max(round(self._time_scale * REAL_TIME), 1) / REAL_TIME,
        )

    def take(self, session: int, watchdog_ms: int) -> Answer:
        """Make a session (1 to 65535) the owner of the arm; the watchdog limits its silence during moves."""
        shortest, longest = WATCHDOG_RANGE_MS
        if not 1 <= session <= LAST_SEQUENCE:
            return Answer(session, Result.NOT_OWNER, f"session {session} is outside 1 to {LAST_SEQUENCE}")
        if not shortest <= watchdog_ms <= longest:
            return Answer(session, Result.WATCHDOG)
        if self.owner not in (0, session) and (self._silence_ms() <= self._watchdog_ms or not self._observe().at_rest):
            return Answer(session, Result.NOT_OWNER, f"session {self.owner} owns the arm")
        if session != self.owner:
            self._staging = StagingBuffer(len(self.limits.lower))
        self.owner, self._watchdog_ms = session, watchdog_ms
        self.note_activity(session)
        return Answer(session, Result.OK)

    def give(self, session: int) -> Answer:
        """Take the arm back from a session."""
        if session != self.owner:
            return Answer(session, Result.NOT_OWNER)
        self.owner = 0
        return Answer(session, Result.OK)

    def note_activity(self, session: int) -> None:
        """Process a new message of a session: the heartbeat, if it is the owner."""
        if session == self.owner:
            self._last_message = self._wire_clock.now()

    def _silence_ms(self) -> float:
        return (self._wire_clock.now() - self._last_message) * 1000.0

    def tick(self) -> RobotState:
        """Check the watchdog and return the state; call it several times within the watchdog's time.

        Read waiting messages first, so that a delay of the controller itself does not count as the client's silence.
        """
        state = self._observe()
        silence = self._silence_ms()
        if not state.at_rest and silence > self._watchdog_ms and not state.fault_code:
            self.controller.latch(
                Fault.WATCHDOG, f"{Fault.WATCHDOG.message} (no message for {silence / 1000:.2f} s while it moved)"
            )
            state = self._observe()
        return state

    def stage(self, session: int, sequence: int, piece: Stage) -> Answer:
        """Write via points of the owner's next move `sequence`."""
        if not self._owned_by(session):
            return Answer(sequence, Result.NOT_OWNER)
        last = self.controller.state().ack_sequence
        if sequence == 0:
            return Answer(sequence, Result.SEQUENCE)
        if not is_newer(sequence, last):
            return Answer(sequence, Result.STALE)
        return Answer(sequence, Result.OK if self._staging.write(sequence, piece) else Result.INCOMPLETE)

    def commit(self, session: int, sequence: int, commit: Commit) -> Answer:
        """Execute a move whose first points are staged. An incomplete one does not use up its number."""
        if not self._owned_by(session):
            return Answer(sequence, Result.NOT_OWNER)
        points = self._staging.assemble(sequence, commit)
        if points is None:
            last = self.controller.state().ack_sequence
            newer = sequence > 0 and is_newer(sequence, last)
            return Answer(sequence, Result.INCOMPLETE if newer else Result.STALE)
        return self.command(session, sequence, Move(points, speed_from_wire(commit.speed)))

    def command(self, session: int, sequence: int, command: Command) -> Answer:
        """Execute a command of the owner by the sequence-number rule, and a stop of any client at once."""
        if not self._owned_by(session):
            if not isinstance(command, Stop):
                return Answer(sequence, Result.NOT_OWNER)
            self.controller.halt()
            self._record("stop", {"session": session, "owner": self.owner})
            self.owner = 0  # so the owner notices: the other client had a reason to stop the arm
            self._observe()
            return Answer(sequence, Result.OK)
        before = self._observe()
        answer = self.controller.command(sequence, command)
        new = answer.result == Result.OK and before.ack_sequence != sequence
        if new and isinstance(command, Move):
            self.moves += 1
            driven = {"from": before.axes.tolist(), "set_points": command.set_points.tolist()}
            self._record("move", {"sequence": sequence, "speed": command.speed, **driven})
        elif new:
            self._record(type(command).__name__.lower(), {"sequence": sequence})
        self._observe()
        return answer

    def emergency_stop(self, pressed: bool = True) -> None:
        """Press or release the emergency stop."""
        self.controller.emergency_stop(pressed)
        self._observe()

    def time_to_wait(self) -> float:
        """Return the time [s] after which the state may change by itself."""
        return self.controller.time_to_wait()

    def brake_for_restart(self) -> None:
        """Brake on the path as in a power failure. Call `restart` once the arm is at rest."""
        self.controller.latch(Fault.RESTARTED)
        self._observe()

    def restart(self) -> None:
        """Restart the controller over the same arm: numbers from 0, empty buffer, fault RESTARTED."""
        self.boot = self.boot % 65535 + 1
        self._start(restarted=True)

    def report(self) -> RobotState:
        """Return the state as the status reports it."""
        heartbeat = int(self._wire_clock.now() / HEARTBEAT_PERIOD) % 65536
        return replace(self._observe(), heartbeat=heartbeat)

    def _owned_by(self, session: int) -> bool:
        return session == self.owner != 0

    def _observe(self) -> RobotState:
        """Return the state with boot number and owner; record its changes."""
        state = replace(self.controller.state(), boot=self.boot, owner=self.owner)
        if state.done_sequence != self._done:
            self._done = state.done_sequence
            end = {"sequence": self._done, "result": int(state.done_result), "axes": state.axes.tolist()}
            self._record("end", end)
        if state.fault_code != self._fault:
            self._fault = state.fault_code
            if self._fault:
                self._record("fault", {"code": int(self._fault)})
        self._recorder.record_state(state)
        return state

    def _record(self, event: str, details: Event) -> None:
        self._recorder.record_event({"event": event, "boot": self.boot, **details})
