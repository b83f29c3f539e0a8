"""The driver contract: states, commands and answers of a robot controller, and the `Driver` that executes moves.

A driver executes synchronous, joint-linear moves through via points at a fraction of the controller's speed. All axes
start and stop together, each path segment is straight in joint space, and the arm stops exactly at every via point.
The controller owns the timing inside its own limits. The PTP motion of a real controller does exactly that, and a
checked plan needs no more. Axes are set-points (`drivers.setpoints`), so every driver executes the checked motion.

    with open_driver("sim://", Context(limits)) as driver:
        driver.move(set_points, speed=0.5)      # returns when the arm is at rest at the last set-point, or raises
        driver.state().q                        # reported axes [rad]

A driver is no safety device: see docs/drivers.md.

**Sequence numbers** make commands safe to repeat. Every command has a number from 1 to 65535; 1 follows 65535. A
controller that has answered no command since its start reports 0. A number is *newer* than another if it follows by
less than half the circle (serial number arithmetic, RFC 1982, on a circle of 65535). A controller

- executes a command once, if its number is newer than the last answered number;
- repeats the old answer to a repetition of the last command, and does nothing;
- refuses the last number with other content (REUSED) and an older number (STALE: a late duplicate).

A client without an answer can therefore send the command again: the controller executes it at most once. A refused
command uses up its number. Stopping is always safe: a controller obeys every stop, whatever its number and answer.
Numbers belong to one session, the owner's; commands of other sessions are refused before their number is checked.
"""

from contextlib import AbstractContextManager
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import Final, Protocol, Self

import numpy as np

from drivers.errors import DriverError
from drivers.setpoints import AXES, Floats, SetPoints, frozen, require_set_points, to_rad

FULL: Final = 10_000
"""100 % of a speed on a wire, an override or a path parameter, which are integers in units of 1e-4."""

LAST_SEQUENCE: Final = 65535


class Code(IntEnum):
    """A number with a message; members are written `NAME = number, "message"`.

    Attributes:
        message: explanation of the number; may be empty.
    """

    message: str

    def __new__(cls, number: int, message: str = "") -> Self:
        """Return the member with this number."""
        code = int.__new__(cls, number)
        code._value_ = number
        code.message = message
        return code


class Mode(IntEnum):
    """States of a controller; the numbers are part of the protocols."""

    IDLE = 0  # at rest, but not at the end of a move: after start, stop or reset
    MOVING = 1  # moves, or brakes after a stop
    IN_POSITION = 2  # at rest at the last set-point of the last move
    FAULT = 3  # a fault is latched; only a reset clears it
    EMERGENCY_STOP = 4  # the emergency stop is or was pressed; release it, then reset


class Fault(Code):
    """Faults of the simulated controller; other controllers may report other numbers with their own message."""

    NONE = 0
    WATCHDOG = 4001, "the heartbeat of the client was lost; the arm was stopped on its path"
    PLANT = 4002, "the arm does not follow its set-points"
    NOT_SETTLED = 4003, "the arm did not come to rest at its set-point in time"
    RESTARTED = 4004, "the controller was restarted; its earlier commands are lost"
    EMERGENCY_STOP = 4010, "the emergency stop was pressed"


class Flag(IntFlag):
    """Bits of the status; the numbers are part of the protocols. AT_REST and MOVING are opposites."""

    AT_REST = 1
    MOVING = 2  # or braking
    IN_POSITION = 4
    FAULT = 8
    EMERGENCY_STOP = 16
    HELD = 32  # an enabling switch or an operator's hold keeps the arm from moving on


class Result(Code):
    """Answers to commands, and ends of moves; the numbers are part of the protocols."""

    OK = 0, "done"
    UNKNOWN_COMMAND = 1, "the controller does not know this command"
    IN_FAULT = 2, "a fault is latched; reset first"
    LIMIT = 3, "a set-point is outside the axis limits"
    SPEED = 4, "the speed fraction is outside its range"
    STEP = 5, "a step between two via points is larger than the controller allows"
    BUSY = 7, "the controller is braking or its queue is full; wait until the arm is at rest"
    SEQUENCE = 8, "the sequence number is outside 1 to 65535"
    REUSED = 9, "the sequence number was already used for another command"
    STALE = 10, "the sequence number is older than the last one: another client, or a late duplicate"
    ESTOP_PRESSED = 11, "the emergency stop is still pressed; release it first"
    TOO_MANY_POINTS = 12, "the move has more via points than the controller accepts"
    INCOMPLETE = 13, "the staged via points are not those of the move; stage them again"
    NOT_OWNER = 14, "this session does not own the arm; take it first"
    WATCHDOG = 15, "the watchdog is outside 100 to 5000 ms"
    STOPPED = 20, "the move was stopped on command"
    FAULTED = 21, "a fault ended the move"
    STOPPED_BY_OTHER = 22, "another client stopped the move, which ends the session"


@dataclass(frozen=True, slots=True, eq=False)
class Move:
    """Command: drive through via points.

    Attributes:
        set_points: (N, n) int32 counts of 1e-4 deg, N at least 1.
        speed: fraction of the axis speeds. Any number is allowed here: the controller refuses invalid ones.
    """

    set_points: SetPoints
    speed: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "set_points", require_set_points(self.set_points))
        object.__setattr__(self, "speed", float(self.speed))


@dataclass(frozen=True, slots=True)
class Stop:
    """Command: brake on the path and clear the queue."""


@dataclass(frozen=True, slots=True)
class Reset:
    """Command: clear a latched fault."""


Command = Move | Stop | Reset


@dataclass(frozen=True, slots=True)
class Answer:
    """Answer of a controller to one command.

    Attributes:
        sequence: number of the answered command.
        result: OK if accepted, else the reason. Other controllers may have other numbers.
        detail: details of a refusal; may be empty.
    """

    sequence: int
    result: int
    detail: str = ""

    @property
    def message(self) -> str:
        """The answer in words."""
        return self.detail or describe_result(self.result)


def describe_result(result: int) -> str:
    """Return the message of a result code, also of an unknown one."""
    try:
        return Result(result).message
    except ValueError:
        return f"the controller gave result code {result}, which this version does not know"


def is_same_command(a: Command, b: Command) -> bool:
    """Return whether two commands have the same content."""
    if isinstance(a, Move) and isinstance(b, Move):
        # Compare the bytes of the speed: a repeated NaN is equal to itself.
        return (
            np.array_equal(a.set_points, b.set_points)
            and np.float64(a.speed).tobytes() == np.float64(b.speed).tobytes()
        )
    return type(a) is type(b)


def next_sequence(sequence: int) -> int:
    """Return the following number: 1 after 0 and after 65535."""
    return sequence % LAST_SEQUENCE + 1


def is_newer(sequence: int, last: int) -> bool:
    """Return whether a sequence number (1 to 65535) follows `last` (0: none yet, so every number is newer)."""
    return last == 0 or 0 < (sequence - last) % LAST_SEQUENCE <= LAST_SEQUENCE // 2


@dataclass(frozen=True, slots=True, eq=False)
class RobotState:
    """Status of a controller, all fields read at one instant.

    Attributes:
        mode: state of the controller.
        axes: (n,) axes as the controller reports them, int32 counts of 1e-4 deg.
        at_rest: True if the arm is at rest. In a fault it may still be braking.
        ack_sequence: number of the last answered command; 0: none since the controller started.
        ack_result: the answer to it (`Result`).
        done_sequence: number of the last ended move; 0: none since the controller started.
        done_result: end of this move: OK at its last set-point, else STOPPED, FAULTED or STOPPED_BY_OTHER.
        queue_depth: accepted moves that have not ended.
        fault_code: 0, or the latched fault (`Fault`, or another controller's number).
        fault_message: the latched fault in words; empty if there is none.
        boot: a number that changes with each start of the controller; 0: not reported.
        owner: session that owns the arm; 0: none.
        heartbeat: counter that advances while the controller lives; None: it has none.
        override: fraction of the commanded speed in effect [1e-4].
        path: passed fraction of the path of the last move [1e-4]; it never falls during a move.
        flags: `Flag` bits as reported, unknown bits included; -1: derived from the other fields.
    """

    mode: Mode
    axes: SetPoints
    at_rest: bool
    ack_sequence: int = 0
    ack_result: int = 0
    done_sequence: int = 0
    done_result: int = 0
    queue_depth: int = 0
    fault_code: int = 0
    fault_message: str = ""
    boot: int = 0
    owner: int = 0
    heartbeat: int | None = None
    override: int = FULL
    path: int = 0
    flags: int = -1

    def __post_init__(self) -> None:
        if len(np.shape(self.axes)) != 1 or len(self.axes) < AXES:
            raise DriverError(f"the reported axes have shape {np.shape(self.axes)}; they must be (n,), n >= {AXES}")
        object.__setattr__(self, "axes", frozen(self.axes, np.int32))
        if self.flags < 0:
            flag_of_mode = {
                Mode.IN_POSITION: Flag.IN_POSITION,
                Mode.FAULT: Flag.FAULT,
                Mode.EMERGENCY_STOP: Flag.EMERGENCY_STOP,
            }
            flags = (Flag.AT_REST if self.at_rest else Flag.MOVING) | flag_of_mode.get(self.mode, Flag(0))
            object.__setattr__(self, "flags", int(flags))

    @property
    def q(self) -> Floats:
        """(n,) reported joint angles [rad], KUKA signs."""
        return to_rad(self.axes)

    @property
    def is_busy(self) -> bool:
        """Whether the arm moves or will move: a move may begin a cycle later, or with the enabling switch."""
        return not self.at_rest or (self.queue_depth > 0 and not self.fault_code)

    @property
    def is_held(self) -> bool:
        """Whether an enabling switch or an operator keeps the arm from moving on."""
        return bool(self.flags & Flag.HELD)


@dataclass(frozen=True, slots=True, eq=False)
class Capabilities:
    """Limits of a driver's controller; the client refuses a violation before it sends anything.

    Attributes:
        controller: name of the controller, for messages and reports.
        lower: (n,) smallest set-points, int32 counts of 1e-4 deg.
        upper: (n,) largest set-points, int32 counts of 1e-4 deg.
        max_step: (n,) largest change of an axis between two via points, counts of 1e-4 deg.
        max_speed: largest speed fraction, in (0, 1].
        max_via: largest number of via points of a move; None: no bound.
        hardware: True if moves move a real robot, so that a person must confirm them.
        simulated_time: True if a move takes no real time.
        time_scale: seconds of the controller's clock per real second; 1 except for emulators.
        not_reported: facts that the wire does not report, in words after "it does not report"; empty: none.
    """

    controller: str
    lower: SetPoints
    upper: SetPoints
    max_step: SetPoints
    max_speed: float
    max_via: int | None
    hardware: bool
    simulated_time: bool
    time_scale: float = 1.0
    not_reported: str = ""

    def __post_init__(self) -> None:
        for name in ("lower", "upper", "max_step"):
            object.__setattr__(self, name, frozen(getattr(self, name), np.int32))


class Driver(AbstractContextManager["Driver"], Protocol):
    """One robot controller behind one wire. Several threads may call it; only one move runs at a time.

    `with` connects at its beginning and closes at its end.
    """

    def connect(self) -> None:
        """Open the wire and read the controller's state; nothing moves. A second call has no effect.

        Raises:
            LinkError: if nothing answers, or the answer is not that of a controller of this kind.
        """

    def close(self) -> None:
        """Stop a moving arm and release the wire. Allowed twice, and after any failure."""

    @property
    def capabilities(self) -> Capabilities:
        """Limits of the controller."""

    def state(self) -> RobotState:
        """Return the current state of the controller; allowed in every mode.

        Raises:
            NotConnectedError, LinkError.
        """

    def take(self) -> None:
        """Become the owner, the only client whose moves are executed. `move` and `reset` do this, `close` undoes it.

        Raises:
            NotOwnerError: if another client owns the arm and is active.
            NotConnectedError, LinkError.
        """

    def require_ready(self) -> RobotState:
        """Return the state if the arm is at rest without a fault and the controller is alive and consistent.

        Raises:
            RefusedError: if a fault is latched or was not reset, the arm moves, or it was in position and is not now.
            ContradictionError: if fields of the status contradict each other.
            StateUnknownError: if the controller is not as this client left it.
            NotConnectedError, LinkError.
        """

    def move(self, set_points: SetPoints, speed: float) -> RobotState:
        """Drive through via points from the present position, and return when the arm is at rest at the last one.

        Args:
            set_points: (N, n) via points, int32 counts of 1e-4 deg; the arm stops exactly at each. A first row equal to
                the present position takes no time.
            speed: fraction of the controller's axis speeds, above 0 up to `capabilities.max_speed`.

        Returns:
            The state at the end of the move: IN_POSITION.

        Raises:
            SetPointError: if the set-points are invalid; nothing was sent.
            RefusedError: outside limits, speed or step, or in a fault; nothing moved.
            StoppedError: if the move ended before its last set-point.
            FaultError, EmergencyStopError: if a fault ended the move, or was latched just after its end.
            StateUnknownError: if the execution of the move is unknown.
            ArrivalError: if the arm arrived elsewhere, or sooner than possible.
            OverdueError: if it did not arrive in time; it was stopped.
            NotOwnerError, ContradictionError, NotConnectedError, LinkError.
        """

    def stop(self) -> RobotState:
        """Brake on the path, clear the queue, and return when the arm is at rest. Allowed in every mode.

        Raises:
            OverdueError: if the arm is not reported at rest in time.
            NotConnectedError, LinkError.
        """

    def reset(self) -> RobotState:
        """Clear a latched fault; the arm does not move.

        Raises:
            RefusedError: if the cause persists (emergency stop still pressed).
            StateUnknownError, NotConnectedError, LinkError.
        """
