"""The controller's end of a wire, the same for every protocol: staging, the client's watchdog, restarts, a journal.

**The watchdog is armed only while the arm moves.** Any new message of the client is its heartbeat; a client that waits
for a move asks for the state far more often than the watchdog is long. When a moving arm has heard nothing for that
long it brakes on its path and latches the fault WATCHDOG, which only an explicit reset clears. An arm that stands needs
no heartbeat: there is nothing to stop, and a scan of ten minutes between two moves is no fault. The other way, armed
always, needs a thread in the client that beats while the program is elsewhere. That is neither simpler nor safer: such
a thread says that the process lives, not that anybody watches the arm, and it goes on beating when the program hangs.

The watchdog runs on the wire's clock, which is real time even where the simulated arm is faster.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from drivers.clock import Clock
from drivers.commands import Answer, Command, Move, Result, is_newer
from drivers.contract import Capabilities, Fault, RobotState
from drivers.controller import Controller
from drivers.limits import Limits
from drivers.plant import Plant
from drivers.setpoints import Floats
from drivers.wire import (
    DEFAULT_WATCHDOG_MS,
    MOST_POINTS,
    WATCHDOG_RANGE_MS,
    Commit,
    Stage,
    Staging,
    speed_from_wire,
    speed_to_wire,
)

HEARTBEAT_PERIOD = 0.01
"""Time [s] of the wire's clock in which the controller's heartbeat counts on by one."""

PoseOf = Callable[[Floats], Floats]
"""Flange pose for monitors: (6,) reported axes [rad] -> X, Y, Z [m], A, B, C [rad] in the robot's base."""

Entry = dict[str, Any]
"""One line of the journal: `event` (start, move, end, fault) and what belongs to it."""


class Witness(Protocol):
    """Who is told what happens, before the client is."""

    def entry(self, entry: Entry) -> None:
        """Something happened."""

    def seen(self, state: RobotState) -> None:
        """This is told to the client next."""


@dataclass(frozen=True, slots=True)
class Report:
    """What the status of a wire says beside the state.

    Attributes:
        state: the state.
        heartbeat: counts on while the controller lives, 0 to 65535.
        fault_count: faults since the start.
        pose: X, Y, Z [m], A, B, C [rad] of the flange, or None where the controller does not know it.
    """

    state: RobotState
    heartbeat: int
    fault_count: int
    pose: Floats | None


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
        pose_of: for monitors.
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
        pose_of: PoseOf | None = None,
    ) -> None:
        self.limits, self.boot = limits, boot
        self.moves = 0  # accepted so far
        self._plant, self._clock, self._wire_clock = plant, clock, wire_clock
        self._witness, self._pose_of = witness, pose_of
        self._start(restarted)

    def _start(self, restarted: bool) -> None:
        self.controller = Controller(self._plant, self.limits, self._clock)
        self._staging = Staging()
        self._watchdog_ms = DEFAULT_WATCHDOG_MS
        self._heard = self._wire_clock.now()
        self._faults, self._fault = 0, 0
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
        )

    def hear(self, watchdog_ms: int | None = None) -> None:
        """The client sent something new: its heartbeat.

        Args:
            watchdog_ms: silence that it asks for [ms]; None: as before.
        """
        self._heard = self._wire_clock.now()
        if watchdog_ms is not None:
            least, most = WATCHDOG_RANGE_MS
            self._watchdog_ms = min(max(watchdog_ms, least), most)

    def tick(self) -> RobotState:
        """Look whether the client is still there; call it several times in a watchdog's time, and after reading.

        Messages that wait are read first: a controller that was itself held up does not take that for silence.
        """
        state = self._observe()
        silence = self._wire_clock.now() - self._heard
        if not state.standing and silence * 1000.0 > self._watchdog_ms and not state.fault_code:
            self.controller.latch(
                Fault.WATCHDOG, f"{Fault.WATCHDOG.sentence} (nothing heard for {silence:.2f} s while it moved)"
            )
            state = self._observe()
        return state

    def stage(self, sequence: int, piece: Stage) -> Answer:
        """Write via points of the move `sequence` to come."""
        last = self.controller.state().ack_sequence
        if sequence == 0:
            return Answer(sequence, Result.SEQUENCE)
        if not is_newer(sequence, last):
            return Answer(sequence, Result.STALE)
        return Answer(sequence, Result.OK if self._staging.put(sequence, piece) else Result.INCOMPLETE)

    def commit(self, sequence: int, commit: Commit) -> Answer:
        """Execute a move whose first points are staged. An incomplete one does not use the number up."""
        points = self._staging.take(sequence, commit)
        if points is None:
            last = self.controller.state().ack_sequence
            newer = sequence > 0 and is_newer(sequence, last)
            return Answer(sequence, Result.INCOMPLETE if newer else Result.STALE)
        return self.command(sequence, Move(points, speed_from_wire(commit.speed)))

    def command(self, sequence: int, command: Command) -> Answer:
        """Execute a command by the rule of the sequence numbers."""
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

    def report(self) -> Report:
        """All that a status says."""
        state = self._observe()
        beat = int(self._wire_clock.now() / HEARTBEAT_PERIOD) % 65536
        pose = self._pose_of(state.q) if self._pose_of else None
        return Report(state, beat, self._faults % 65536, pose)

    def _observe(self) -> RobotState:
        """The state with the boot number; tells the witness what has changed."""
        state = replace(self.controller.state(), boot=self.boot)
        if state.done_sequence != self._done:
            self._done = state.done_sequence
            end = {"sequence": self._done, "result": int(state.done_result), "axes": state.axes.tolist()}
            self._tell("end", end)
        if state.fault_code != self._fault:
            self._fault = state.fault_code
            if self._fault:
                self._faults += 1
                self._tell("fault", {"code": int(self._fault)})
        self._witness.seen(state)
        return state

    def _tell(self, event: str, more: Entry) -> None:
        self._witness.entry({"event": event, "boot": self.boot, **more})


def counts_of_pose(pose: Floats) -> tuple[int, ...]:
    """A pose as counts of 1e-3 mm and 1e-4 deg."""
    lengths, angles = np.rint(pose[:3] * 1e6), np.rint(np.degrees(pose[3:]) * 1e4)
    return tuple(int(value) for value in (*lengths, *angles))
