"""The contract between a plan and any robot controller: what a driver can do, and what it says about the arm.

A driver executes synchronous joint-linear moves through via points at a fraction of the controller's speed: all axes
start and stop together, each leg is a straight segment in joint space, and the arm stops exactly at every via point.
The controller owns the timing inside its own limits. That is what the PTP of a real controller does, and all that a
checked plan needs. Axes travel as set-points (`drivers.setpoints`), so every driver executes exactly what was checked.

    with open_driver("sim://", Context(limits)) as driver:
        driver.move(set_points, speed=0.5)      # returns when the arm stands at the last set-point, or raises
        driver.state().q                        # axes as the controller reports them [rad]

This layer is no safety device: see docs/drivers.md.
"""

from contextlib import AbstractContextManager
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import Protocol

import numpy as np

from drivers.codes import Code
from drivers.errors import DriverError
from drivers.setpoints import AXES, Floats, SetPoints, frozen, to_rad


class Mode(IntEnum):
    """The states of a controller; the numbers go over wires."""

    IDLE = 0  # stands, and not at the end of a move: after start, stop or reset
    MOVING = 1  # moves, or brakes after a stop
    IN_POSITION = 2  # stands at the last set-point of its last move
    FAULT = 3  # a fault is latched; only reset helps
    EMERGENCY_STOP = 4  # the emergency stop is or was pressed; release it, then reset


class Fault(Code):
    """The faults of our own controller; a foreign controller may report other numbers with its own sentence."""

    NONE = 0
    WATCHDOG = 4001, "the client's heartbeat was lost, so the arm was stopped on its path"
    PLANT = 4002, "the arm does not follow its set-points"
    NOT_SETTLED = 4003, "the arm did not come to rest at its set-point in time"
    RESTARTED = 4004, "the controller was restarted; what it did before is lost"
    EMERGENCY_STOP = 4010, "the emergency stop was pressed"


class Flag(IntFlag):
    """Bits of the status; the numbers go over wires. STANDS and MOVES are each other's opposite."""

    STANDS = 1
    MOVES = 2  # or brakes
    IN_POSITION = 4
    FAULT = 8
    EMERGENCY_STOP = 16
    HELD = 32  # somebody keeps the arm from moving on: an enabling switch, an operator's hold


WHOLE = 10_000
"""Overrides and path parameters are whole numbers of 1e-4; this is all of it."""


@dataclass(frozen=True, slots=True, eq=False)
class RobotState:
    """What a controller says about itself, all read at one instant.

    Attributes:
        mode: the controller's state.
        axes: (n,) axes as the controller reports them, int32 counts of 1e-4 deg.
        standing: True where the arm is at rest. In a fault it may still be braking.
        ack_sequence: number of the last command that the controller answered; 0: none since it started.
        ack_result: the answer to it (`drivers.commands.Result`).
        done_sequence: number of the last move that ended, however it ended; 0: none since the controller started.
        done_result: how it ended: OK at its last set-point, else STOPPED, FAULTED.
        queue_depth: moves that are accepted and have not ended.
        fault_code: 0, or the latched fault (`Fault`, or a foreign controller's number).
        fault_sentence: the latched fault in words; empty where there is none.
        boot: a number that is another one after each start of the controller; 0: the controller does not tell.
        owner: session that owns the arm; 0: none.
        heartbeat: counts on while the controller lives; None: it has none.
        override: share of the commanded speed that is driven [1e-4].
        path: share of its way that the last move has passed [1e-4]; it never falls during a move.
        flags: as the controller set them (`Flag`, and bits that nobody knows); -1: those that follow from the rest.
    """

    mode: Mode
    axes: SetPoints
    standing: bool
    ack_sequence: int = 0
    ack_result: int = 0
    done_sequence: int = 0
    done_result: int = 0
    queue_depth: int = 0
    fault_code: int = 0
    fault_sentence: str = ""
    boot: int = 0
    owner: int = 0
    heartbeat: int | None = None
    override: int = WHOLE
    path: int = 0
    flags: int = -1

    def __post_init__(self) -> None:
        if len(np.shape(self.axes)) != 1 or len(self.axes) < AXES:
            raise DriverError(f"the reported axes have shape {np.shape(self.axes)}; they must be (n,), n >= {AXES}")
        object.__setattr__(self, "axes", frozen(self.axes, np.int32))
        if self.flags < 0:
            of_mode = {
                Mode.IN_POSITION: Flag.IN_POSITION,
                Mode.FAULT: Flag.FAULT,
                Mode.EMERGENCY_STOP: Flag.EMERGENCY_STOP,
            }
            flags = (Flag.STANDS if self.standing else Flag.MOVES) | of_mode.get(self.mode, Flag(0))
            object.__setattr__(self, "flags", int(flags))

    @property
    def q(self) -> Floats:
        """(n,) reported joint angles [rad], KUKA signs."""
        return to_rad(self.axes)

    @property
    def busy(self) -> bool:
        """Whether the arm moves or is about to: a move may begin a cycle later, or with the enabling switch."""
        return not self.standing or (self.queue_depth > 0 and not self.fault_code)

    @property
    def held(self) -> bool:
        """Whether somebody keeps the arm from moving on."""
        return bool(self.flags & Flag.HELD)


@dataclass(frozen=True, slots=True, eq=False)
class Capabilities:
    """What a driver's controller accepts; the client refuses the same things before it sends them.

    Attributes:
        controller: what stands at the other end, for messages and reports.
        lower: (n,) smallest set-points, int32 counts of 1e-4 deg.
        upper: (n,) largest set-points, int32 counts of 1e-4 deg.
        max_step: (n,) largest change of an axis from one via point to the next, counts of 1e-4 deg.
        max_speed: largest speed fraction, in (0, 1].
        max_via: most via points in one move; None: no bound.
        hardware: True where moves move steel, so that a person has to confirm motion first.
        simulated_time: True where a move takes no real time.
        time_scale: seconds of the controller's clock per real second; 1 of all but emulators.
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

    def __post_init__(self) -> None:
        for name in ("lower", "upper", "max_step"):
            object.__setattr__(self, name, frozen(getattr(self, name), np.int32))


class Driver(AbstractContextManager["Driver"], Protocol):
    """One robot controller, reached over one wire. Several threads may call it; moves are one at a time.

    `with` connects, and closes at its end.
    """

    def connect(self) -> None:
        """Open the wire and learn the controller's state; nothing moves. A second call does nothing.

        Raises:
            LinkError: if nothing answers, or what answers is no controller of this kind.
        """

    def close(self) -> None:
        """Stop an arm that moves, and give the wire back. May be called twice, and after any failure."""

    @property
    def capabilities(self) -> Capabilities:
        """What the controller accepts."""

    def state(self) -> RobotState:
        """The controller's state now; possible in every mode.

        Raises:
            NotConnectedError, LinkError.
        """

    def take(self) -> None:
        """Become the one client whose moves are executed; `move` and `reset` take by themselves, `close` gives back.

        Raises:
            NotOwnerError: if another client owns the arm and is there.
            NotConnectedError, LinkError.
        """

    def ready(self) -> RobotState:
        """The state of an arm that stands without a fault, told by a controller that lives and makes sense.

        Raises:
            FaultError, EmergencyStopError: one is latched, or pressed.
            ContradictionError: fields of the status contradict each other.
            StateUnknownError: the arm moves, or the controller is not as this client left it.
            NotConnectedError, LinkError.
        """

    def move(self, set_points: SetPoints, speed: float) -> RobotState:
        """Drive through via points from where the arm stands, and return when it stands at the last one.

        Args:
            set_points: (N, n) via points, int32 counts of 1e-4 deg; the arm stops exactly at each. A first row equal to
                where the arm stands takes no time.
            speed: fraction of the controller's axis speeds, above 0 up to `capabilities.max_speed`.

        Returns:
            The state in which the move ended: IN_POSITION.

        Raises:
            SetPointError: the set-points are broken; nothing was sent.
            RefusedError: outside limits, speed or step, or in a fault; nothing moved.
            StoppedError: the move ended elsewhere, on its path.
            FaultError, EmergencyStopError: so it did by a fault, or one was latched when it had just been done.
            StateUnknownError: whether the move was executed cannot be told.
            ArrivalError: the arm arrived sooner than it can, or elsewhere.
            OverdueError: it did not arrive in time, and was told to stop.
            NotOwnerError, ContradictionError, NotConnectedError, LinkError.
        """

    def stop(self) -> RobotState:
        """Brake on the path, drop what is queued, and return when the arm stands. Possible in every mode.

        Raises:
            OverdueError: it is not seen standing in time.
            NotConnectedError, LinkError.
        """

    def reset(self) -> RobotState:
        """Clear a latched fault; the arm stays where it is.

        Raises:
            RefusedError: the cause persists (emergency stop still pressed).
            StateUnknownError, NotConnectedError, LinkError.
        """
