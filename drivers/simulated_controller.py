"""The simulated controller: one state machine over a plant and a clock, for every wire.

    start --> IDLE --move--> MOVING --at rest at the set-point--> IN_POSITION --move--> MOVING
               ^               |
               +--- stop ------+         fault (any state) --> FAULT            --reset--> IDLE
               (brakes first)            e-stop (any state) --> EMERGENCY_STOP  --release, reset--> IDLE

A fault and the emergency stop brake on the path; until a reset every move is refused. The controller checks its limits
even if the client has checked them. Commands follow the sequence-number rule of `drivers.contract`.

The controller has no thread: each call first lets the time pass that the clock reports as passed. A clock that jumps
back counts as standing still, a clock that jumps ahead completes the motion. The controller owns the reference
(`drivers.profile`); the plant, an arm with its servos, follows it.
"""

import math
from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from drivers.clock import Clock
from drivers.contract import (
    FULL,
    LAST_SEQUENCE,
    Answer,
    Command,
    Fault,
    Mode,
    Move,
    Reset,
    Result,
    RobotState,
    Stop,
    is_newer,
    is_same_command,
)
from drivers.errors import DriverError, SetPointError
from drivers.limits import Limits, check_move
from drivers.profile import TICK, Reference, interpolate, resting
from drivers.setpoints import AXES, Floats, format_axes, from_rad, to_rad

CYCLE = 0.004
"""Interpolation cycle [s] in which the controller checks whether the plant has settled."""

MIN_WAIT = 1e-6
"""Shortest time [s] that `time_to_wait` returns: added to seconds since 1970, it still advances a clock."""

SETTLE_LIMIT = 4.0
"""Longest time [s] for a plant to settle after the end of its reference, before a fault; a client waits for 5 s."""


class Plant(Protocol):
    """An arm with its servos. It has no clock: time passes only in `advance`."""

    @property
    def reported_axes(self) -> Floats:
        """(n,) axes as the encoders measure them [rad]; another array if they have changed."""

    @property
    def settled(self) -> bool:
        """True if the arm is at rest at the end of its reference, within the plant's tolerance."""

    @property
    def failure(self) -> str:
        """Why the arm no longer follows (diverged simulation, tripped drive), in words; empty while it does."""

    def follow(self, reference: Reference) -> None:
        """Take a new reference whose time 0 is now. It begins at the present position and speed of the old one."""

    def advance(self, seconds: float) -> None:
        """Let time pass, at least 0 s. After its end a reference rests."""


PlantFactory = Callable[[Floats], Plant]
"""Function that makes a plant at rest at (n,) axes [rad]."""


class IdealPlant:
    """An arm exactly at its reference, whatever the time step.

    Args:
        start: (n,) axes of the arm at the start [rad].
    """

    def __init__(self, start: ArrayLike) -> None:
        axes = np.array(start, dtype=np.float64)
        if axes.ndim != 1 or len(axes) < AXES or not np.isfinite(axes).all():
            raise DriverError(f"a plant was started at {axes}; it must be {AXES} or more finite joint angles in rad")
        self._reference, self._elapsed = resting(axes), 0.0
        self._sampled: tuple[Reference, float, Floats] | None = None  # the last reading, with its reference and time

    @property
    def reported_axes(self) -> Floats:
        """(n,) axes of the reference [rad]."""
        if self.settled:
            return self._reference.end
        last = self._sampled
        if last is None or last[0] is not self._reference or last[1] != self._elapsed:
            axes = self._reference.sample(np.array([self._elapsed]))[0][0]
            self._sampled = last = self._reference, self._elapsed, axes
        return last[2]

    @property
    def settled(self) -> bool:
        """True if the reference has ended."""
        return self._elapsed >= self._reference.duration

    @property
    def failure(self) -> str:
        """Always empty."""
        return ""

    def follow(self, reference: Reference) -> None:
        """Take a new reference."""
        self._reference, self._elapsed = reference, 0.0

    def advance(self, seconds: float) -> None:
        """Advance along the reference."""
        if not seconds >= 0:
            raise DriverError(f"a plant was advanced by {seconds} s; the time must be at least 0")
        self._elapsed += seconds
        if self._reference.duration - self._elapsed <= TICK:
            self._elapsed = self._reference.duration


class Controller:
    """A robot controller in software.

    Not thread-safe: the wire in front of it serialises the calls.

    Args:
        plant: the arm.
        limits: limits of the arm's moves.
        clock: the controller's time.

    Raises:
        DriverError: if the plant starts outside the limits.
    """

    def __init__(self, plant: Plant, limits: Limits, clock: Clock) -> None:
        self.plant, self.limits = plant, limits
        self._clock, self._now = clock, _require_finite(clock.now())
        self._reported = plant.reported_axes
        self._axes = from_rad(self._reported)
        if ((self._axes < limits.lower) | (self._axes > limits.upper)).any():
            raise DriverError(
                f"the arm is at {format_axes(self._axes)}, outside the controller's limits; it must start inside"
            )
        self._reference, self._elapsed = resting(plant.reported_axes), 0.0
        self._running = 0  # number of the current move; 0: none
        self._braking = False
        self._in_position = False
        self._fault = Fault.NONE
        self._fault_detail = ""
        self._estop_pressed = False
        self._last: Command | None = None
        self._answer = Answer(0, Result.OK)
        self._done, self._done_result = 0, Result.OK
        self._path = 0

    def command(self, sequence: int, command: Command) -> Answer:
        """Execute a command if its number (1 to 65535) is new, and return the answer."""
        self._pass_time()
        if isinstance(command, Stop):
            self._brake(Result.STOPPED)  # whatever the number: stopping is always safe
            self._run(0.0)
        if not 1 <= sequence <= LAST_SEQUENCE:
            return Answer(sequence, Result.SEQUENCE)
        if self._last is not None and sequence == self._answer.sequence:
            return self._answer if is_same_command(command, self._last) else Answer(sequence, Result.REUSED)
        if not is_newer(sequence, self._answer.sequence):
            return Answer(sequence, Result.STALE)
        result, detail = self._execute(sequence, command)
        self._run(0.0)  # a move of no length ends at once
        self._last, self._answer = command, Answer(sequence, result, detail)
        return self._answer

    def state(self) -> RobotState:
        """Return the current state."""
        self._pass_time()
        return RobotState(
            mode=self._mode(),
            axes=self._axes,
            at_rest=self._at_rest(),
            ack_sequence=self._answer.sequence,
            ack_result=self._answer.result,
            done_sequence=self._done,
            done_result=self._done_result,
            queue_depth=int(self._running > 0),
            fault_code=self._fault,
            fault_message=self._fault_detail or self._fault.message,
            path=self._passed(),
        )

    def halt(self) -> None:
        """Brake on the command of a client that is not the owner. It uses no number; the move's result names it."""
        self._pass_time()
        self._brake(Result.STOPPED_BY_OTHER)
        self._run(0.0)

    def latch(self, fault: Fault, detail: str = "") -> None:
        """Latch an external fault (watchdog, restart) and brake. The first of several faults is kept.

        Args:
            fault: never NONE.
            detail: the fault in words; empty: its own message.
        """
        self._pass_time()
        self._latch(fault, detail)
        self._run(0.0)

    def emergency_stop(self, pressed: bool = True) -> None:
        """Press or release the emergency stop. It stays latched after its release until a reset."""
        self._pass_time()
        self._estop_pressed = pressed
        if pressed:
            self._fault, self._fault_detail = Fault.NONE, ""  # it outranks any other latched fault
            self._latch(Fault.EMERGENCY_STOP)
            self._run(0.0)

    def time_to_wait(self) -> float:
        """Return the time [s] after which the state may change by itself; 0 if the arm is at rest."""
        self._pass_time()
        if self._at_rest():
            return 0.0
        left = self._reference.duration - self._elapsed
        return max(left, MIN_WAIT) if left > 0.0 else CYCLE

    def _execute(self, sequence: int, command: Command) -> tuple[Result, str]:
        if isinstance(command, Stop):
            return Result.OK, ""  # already executed
        if isinstance(command, Reset):
            return self._reset()
        if self._fault:
            return Result.IN_FAULT, f"{self._fault_detail or self._fault.message}; reset first"
        if not self._at_rest():
            return Result.BUSY, ""
        result, detail = check_move(command, from_rad(self._reference.end), self.limits)
        if result is Result.OK:
            self._start(sequence, command)
        return result, detail

    def _reset(self) -> tuple[Result, str]:
        if self._estop_pressed:
            return Result.ESTOP_PRESSED, ""
        if not self._at_rest():
            return Result.BUSY, ""
        if self._fault:
            if not self.plant.settled or self._plant_failure():
                self._reference, self._elapsed = resting(to_rad(self._axes)), 0.0
                self.plant.follow(self._reference)
            if failure := self._plant_failure():
                return Result.IN_FAULT, f"{failure}; the reset did not clear it"
            self._fault, self._fault_detail = Fault.NONE, ""
        return Result.OK, ""

    def _pass_time(self) -> None:
        now = _require_finite(self._clock.now())
        seconds = max(now - self._now, 0.0)
        self._now = now
        self._run(seconds)

    def _run(self, seconds: float) -> None:
        """Let time pass, through the end of a move if it comes. A failed plant is left as it is."""
        if self._plant_failed():
            return
        while True:
            if self._at_rest():
                if seconds > 0.0:
                    self.plant.advance(seconds)
                    self._plant_failed()
                return
            left = self._reference.duration - self._elapsed
            step = min(seconds, left if left > 0.0 else CYCLE)
            self.plant.advance(step)
            if self._plant_failed():
                return
            self._elapsed, seconds = self._elapsed + step, seconds - step
            if 0.0 < self._reference.duration - self._elapsed <= TICK:
                self._elapsed = self._reference.duration
            if self._elapsed >= self._reference.duration:
                if self.plant.settled:
                    self._finish()
                    continue
                if self._elapsed - self._reference.duration > SETTLE_LIMIT:
                    self._latch(Fault.NOT_SETTLED)
                    self._braking = False  # this plant will not settle
            if seconds <= 0.0:
                return

    def _start(self, sequence: int, move: Move) -> None:
        limits = self.limits
        self._reference = interpolate(
            self._reference.end, to_rad(move.set_points), limits.velocity * move.speed, limits.acceleration, limits.jerk
        )
        self._elapsed, self._running, self._in_position, self._path = 0.0, sequence, False, 0
        self.plant.follow(self._reference)

    def _finish(self) -> None:
        """End the motion: the arm is at rest at the end of its reference."""
        if self._running:
            self._done, self._done_result = self._running, Result.OK
            self._in_position, self._path = True, FULL
        self._running, self._braking = 0, False

    def _brake(self, result: Result) -> None:
        """End the move on its path, at rest as soon as the limits allow."""
        if self._running:
            self._path = self._passed()
            self._done, self._done_result = self._running, result
            self._running, self._braking = 0, True
            self._reference, self._elapsed = self._reference.braking_from(self._elapsed), 0.0
            self.plant.follow(self._reference)

    def _latch(self, fault: Fault, detail: str = "") -> None:
        if not self._fault:
            self._fault, self._fault_detail = fault, detail
        self._brake(Result.FAULTED)
        self._in_position = False

    def _plant_failed(self) -> bool:
        """Return whether the plant no longer follows; if so, latch the fault."""
        if failure := self._plant_failure():
            self._latch(Fault.PLANT, f"{Fault.PLANT.message}: {failure}")
            self._braking = False  # a failed plant does not brake
            return True
        return False

    def _plant_failure(self) -> str:
        """Return why the plant does not follow, if so, and store its reported axes."""
        try:
            if (reported := self.plant.reported_axes) is not self._reported:
                self._axes, self._reported = from_rad(reported), reported
        except SetPointError:  # axes that are no numbers: keep the last ones
            return self.plant.failure or "an axis position is not a number"
        return self.plant.failure

    def _passed(self) -> int:
        """Return the passed fraction of the last move's path [1e-4]; below 100 % before its end."""
        if not self._running:
            return self._path
        return min(int(self._reference.progress(self._elapsed) * FULL), FULL - 1)

    def _at_rest(self) -> bool:
        return not self._running and not self._braking

    def _mode(self) -> Mode:
        if self._fault is Fault.EMERGENCY_STOP:
            return Mode.EMERGENCY_STOP
        if self._fault:
            return Mode.FAULT
        if not self._at_rest():
            return Mode.MOVING
        return Mode.IN_POSITION if self._in_position else Mode.IDLE


def _require_finite(now: float) -> float:
    if not math.isfinite(now):
        raise DriverError(f"the controller's clock reports {now}; it must be a finite time in seconds")
    return now
