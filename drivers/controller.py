"""The simulated controller: one state machine over a plant and a clock, for every wire.

    start --> IDLE --move--> MOVING --stands at the set-point--> IN_POSITION --move--> MOVING
               ^               |
               +--- stop ------+         fault (any state) --> FAULT            --reset--> IDLE
               (brakes first)            e-stop (any state) --> EMERGENCY_STOP  --release, reset--> IDLE

A fault and the emergency stop brake on the path; until a reset every move is refused. Limits are
checked here, whatever the client checked. Commands follow the sequence-number rule of `drivers.commands`. The
controller has no thread: each call first lets the time pass that the clock says has passed. A clock that jumps back is
taken as standing still, one that jumps ahead finishes the motion.
"""

import math

from drivers.clock import Clock
from drivers.commands import LAST_SEQUENCE, Answer, Command, Move, Reset, Result, Stop, is_newer, same
from drivers.contract import WHOLE, Fault, Mode, RobotState
from drivers.errors import DriverError, SetPointError
from drivers.limits import Limits, refuse
from drivers.plant import Plant
from drivers.profile import TICK, interpolate, resting
from drivers.setpoints import from_rad, text, to_rad

CYCLE = 0.004
"""Interpolation cycle [s] in which the controller looks whether the plant has settled."""

SHORTEST_WAIT = 1e-6
"""Least time [s] that a waiter is told: adding it to seconds since 1970 still moves a clock on."""

SETTLE_LIMIT = 4.0
"""Time [s] that a plant may take to settle after its reference ended, before that is a fault; a client waits for 5."""


class Controller:
    """A robot controller in software.

    Not thread-safe: whoever puts it behind a wire serialises the calls.

    Args:
        plant: the arm that it moves.
        limits: what it lets the arm do.
        clock: its time.

    Raises:
        DriverError: if the plant stands outside the limits.
    """

    def __init__(self, plant: Plant, limits: Limits, clock: Clock) -> None:
        self.plant, self.limits = plant, limits
        self._clock, self._now = clock, _finite(clock.now())
        self._axes = from_rad(plant.reported_axes)
        if ((self._axes < limits.lower) | (self._axes > limits.upper)).any():
            raise DriverError(
                f"the arm stands at {text(self._axes)}, outside the controller's limits; it must start inside"
            )
        self._reference, self._elapsed = resting(plant.reported_axes), 0.0
        self._running = 0  # number of the move that is driven; 0: none
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
        """Execute a command if its number is new, and answer.

        Args:
            sequence: 1 to 65535.
            command: what to do.
        """
        self._pass_time()
        if isinstance(command, Stop):
            self._brake(Result.STOPPED)  # whatever the number: stopping is always safe
            self._run(0.0)
        if not 1 <= sequence <= LAST_SEQUENCE:
            return Answer(sequence, Result.SEQUENCE)
        if self._last is not None and sequence == self._answer.sequence:
            return self._answer if same(command, self._last) else Answer(sequence, Result.REUSED)
        if not is_newer(sequence, self._answer.sequence):
            return Answer(sequence, Result.STALE)
        result, detail = self._execute(sequence, command)
        self._run(0.0)  # a move of no length ends at once
        self._last, self._answer = command, Answer(sequence, result, detail)
        return self._answer

    def state(self) -> RobotState:
        """The state now."""
        self._pass_time()
        return RobotState(
            mode=self._mode(),
            axes=self._axes,
            standing=self._standing(),
            ack_sequence=self._answer.sequence,
            ack_result=self._answer.result,
            done_sequence=self._done,
            done_result=self._done_result,
            queue_depth=int(self._running > 0),
            fault_code=self._fault,
            fault_sentence=self._fault_detail or self._fault.sentence,
            path=self._passed(),
        )

    def halt(self) -> None:
        """Brake on the word of another client than the owner: no number is used, and the move's end says who it was."""
        self._pass_time()
        self._brake(Result.STOPPED_BY_OTHER)
        self._run(0.0)

    def latch(self, fault: Fault, detail: str = "") -> None:
        """Latch a fault from outside (a watchdog, a restart), and brake. The first of several is kept.

        Args:
            fault: which one; never NONE.
            detail: what happened, in words; empty: the fault's own sentence.
        """
        self._pass_time()
        self._latch(fault, detail)
        self._run(0.0)

    def emergency_stop(self, pressed: bool = True) -> None:
        """Press or release the emergency stop. It stays latched after its release until a reset."""
        self._pass_time()
        self._estop_pressed = pressed
        if pressed:
            self._fault, self._fault_detail = Fault.NONE, ""  # it outranks whatever fault is latched
            self._latch(Fault.EMERGENCY_STOP)
            self._run(0.0)

    def time_to_wait(self) -> float:
        """Time [s] after which the state can have changed by itself; 0 where the arm stands."""
        self._pass_time()
        if self._standing():
            return 0.0
        left = self._reference.duration - self._elapsed
        return max(left, SHORTEST_WAIT) if left > 0.0 else CYCLE

    def _execute(self, sequence: int, command: Command) -> tuple[Result, str]:
        if isinstance(command, Stop):
            return Result.OK, ""  # obeyed already
        if isinstance(command, Reset):
            return self._reset()
        if self._fault:
            return Result.IN_FAULT, f"{self._fault_detail or self._fault.sentence}; reset first"
        if not self._standing():
            return Result.BUSY, ""
        result, detail = refuse(command, from_rad(self._reference.end), self.limits)
        if result is Result.OK:
            self._start(sequence, command)
        return result, detail

    def _reset(self) -> tuple[Result, str]:
        if self._estop_pressed:
            return Result.ESTOP_PRESSED, ""
        if not self._standing():
            return Result.BUSY, ""
        if self._fault:
            if not self.plant.settled or self._plant_failure():
                self._reference, self._elapsed = resting(to_rad(self._axes)), 0.0
                self.plant.follow(self._reference)
            if failure := self._plant_failure():
                return Result.IN_FAULT, f"{failure}; the reset did not cure it"
            self._fault, self._fault_detail = Fault.NONE, ""
        return Result.OK, ""

    def _pass_time(self) -> None:
        now = _finite(self._clock.now())
        seconds = max(now - self._now, 0.0)
        self._now = now
        self._run(seconds)

    def _run(self, seconds: float) -> None:
        """Let time pass; a move ends on the way. A plant that failed is left as it is."""
        if self._plant_failed():
            return
        while True:
            if self._standing():
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
                    self._braking = False  # waiting longer for this plant leads nowhere
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
        """The arm stands at the end of its reference."""
        if self._running:
            self._done, self._done_result = self._running, Result.OK
            self._in_position, self._path = True, WHOLE
        self._running, self._braking = 0, False

    def _brake(self, result: Result) -> None:
        """End the move on its path, standing as soon as the limits allow."""
        if self._running:
            self._path = self._passed()
            self._done, self._done_result = self._running, result
            self._running, self._braking = 0, True
            self._reference, self._elapsed = self._reference.braked(self._elapsed), 0.0
            self.plant.follow(self._reference)

    def _latch(self, fault: Fault, detail: str = "") -> None:
        if not self._fault:
            self._fault, self._fault_detail = fault, detail
        self._brake(Result.FAULTED)
        self._in_position = False

    def _plant_failed(self) -> bool:
        """Whether the plant no longer follows; latches the fault."""
        if failure := self._plant_failure():
            self._latch(Fault.PLANT, f"{Fault.PLANT.sentence}: {failure}")
            self._braking = False  # nothing can be asked of it any more
            return True
        return False

    def _plant_failure(self) -> str:
        """Why the plant does not follow, if it does not. Remembers where it says it is."""
        try:
            self._axes = from_rad(self.plant.reported_axes)
        except SetPointError:  # axes that are no numbers are nowhere; the last ones stay
            return self.plant.failure or "its axes are no numbers"
        return self.plant.failure

    def _passed(self) -> int:
        """Share of the last move's path that is passed [1e-4]; less than all before it has ended there."""
        if not self._running:
            return self._path
        return min(int(self._reference.share(self._elapsed) * WHOLE), WHOLE - 1)

    def _standing(self) -> bool:
        return not self._running and not self._braking

    def _mode(self) -> Mode:
        if self._fault is Fault.EMERGENCY_STOP:
            return Mode.EMERGENCY_STOP
        if self._fault:
            return Mode.FAULT
        if not self._standing():
            return Mode.MOVING
        return Mode.IN_POSITION if self._in_position else Mode.IDLE


def _finite(now: float) -> float:
    if not math.isfinite(now):
        raise DriverError(f"the controller's clock says {now}; it must say a finite time in seconds")
    return now
