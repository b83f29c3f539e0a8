"""Checks of the client: consistency of a status, progress of a move, its end and its arrival; all time limits.

A faulty controller is seldom silent: it reports impossible states. The client therefore checks all fields before each
move and each scan and while it waits, and uses the worse of two fields that disagree. None of the limits is an option.
"""

import math
from collections.abc import Callable
from typing import Final

import numpy as np

from drivers.clock import Clock
from drivers.contract import FULL, Capabilities, Flag, Mode, Move, Result, RobotState, describe_result, is_newer
from drivers.errors import (
    ArrivalError,
    ContradictionError,
    EmergencyStopError,
    FaultError,
    OverdueError,
    ProtocolError,
    StoppedError,
)
from drivers.limits import Limits
from drivers.profile import interpolate
from drivers.setpoints import format_axes, to_rad

STALL_LIMIT: Final = 5.0
"""Longest time [s] without progress of axes or path parameter, unless a hold is reported. If the controller's clock is
faster than real time, in real seconds; if it is slower, in its own."""

MAX_TIME_FACTOR: Final = 3.0
"""Longest duration of a move, as a multiple of its profile's time at the reported override; at least `STALL_LIMIT`."""

MIN_TIME_FACTOR: Final = 0.95
"""Shortest duration of a move, as a fraction of the fastest profile's time; the margin covers differing clocks."""

STOP_LIMIT: Final = 5.0
"""Longest time [s] from a stop until the arm is at rest."""

HALT_LIMIT: Final = 1.0
"""Time [s] for the stop of a client that has to end."""

OWNER_LIMIT: Final = 1.0
"""Longest time [s] from a granted session until the status shows it as the owner."""

TAKE_LIMIT: Final = 5.5
"""Longest time [s] to wait for a silent owner: the longest watchdog, with a margin."""

NOTIFY_AFTER: Final = 2.0
"""Time [s] without progress after which a person is notified of the wait."""

MAX_ARRIVAL_ERROR: Final = 1000
"""Largest distance of an axis from its last set-point at the end of a move, counts: 0.1 deg. `cell` has a
narrower limit in mm."""

MAX_QUEUE: Final = 1
"""Moves that a controller holds: only the current one. Any other is another client's."""

_NOISE = 10  # counts: an axis that turns less than 0.001 deg does not move
_MIN_OVERRIDE = 100  # 1e-4: a smaller override counts as this one, so that every limit is finite

_MODES = {mode: f"mode {int(mode)} ({mode.name.lower().replace('_', ' ')})" for mode in Mode}
_FLAG_MODES = (
    (Flag.IN_POSITION, Mode.IN_POSITION),
    (Flag.FAULT, Mode.FAULT),
    (Flag.EMERGENCY_STOP, Mode.EMERGENCY_STOP),
)


def find_contradiction(state: RobotState, capabilities: Capabilities) -> str:
    """Return the first impossible combination of fields in words; empty if there is none."""
    rests, moves = bool(state.flags & Flag.AT_REST), bool(state.flags & Flag.MOVING)
    latched, mode = state.mode in (Mode.FAULT, Mode.EMERGENCY_STOP), _MODES[state.mode]
    has_arrived = state.mode is Mode.IN_POSITION and state.queue_depth == 0
    wrong_flags = [
        flag.name.lower()
        for flag, flag_mode in _FLAG_MODES
        if bool(state.flags & flag) is not (state.mode is flag_mode) and flag.name
    ]
    done_sequence, ack, n_axes = state.done_sequence, state.ack_sequence, len(capabilities.lower)
    checks = (
        (state.flags >= 2 * Flag.HELD, f"its flags 0x{state.flags:04X} have undefined bits"),
        (rests and moves, "the arm is at rest and moves"),
        (not rests and not moves, "the arm is neither at rest nor moving"),
        (state.at_rest is not rests, "the arm is at rest, but its flags say that it moves"),
        (state.mode is Mode.MOVING and rests, f"the arm is at rest in {mode}"),
        (state.mode in (Mode.IDLE, Mode.IN_POSITION) and moves, f"the arm moves in {mode}"),
        (bool(wrong_flags), f"{', '.join(wrong_flags)} flag and {mode} do not agree"),
        (bool(state.fault_code) is not latched, f"fault code {state.fault_code} and {mode} do not agree"),
        (state.override > FULL, f"its override is {state.override / 100:g} %"),
        (state.path > FULL, f"it has passed {state.path / 100:g} % of the path"),
        (state.queue_depth > MAX_QUEUE, f"{state.queue_depth} moves are queued; a controller accepts {MAX_QUEUE}"),
        (has_arrived and state.done_result != Result.OK, f"{mode} after a move that ended with {state.done_result}"),
        (has_arrived and state.path != FULL, f"{mode} after {state.path / 100:g} % of the path"),
        (
            done_sequence not in (0, ack) and is_newer(done_sequence, ack),
            f"move {done_sequence} ended, but {ack} is the last answered command",
        ),
        (len(state.axes) != n_axes, f"it reports {len(state.axes)} axes instead of {n_axes}"),
    )
    return next((message for is_wrong, message in checks if is_wrong), "")


def require_consistent(state: RobotState, capabilities: Capabilities) -> None:
    """Raise ContradictionError if the status cannot be true."""
    if wrong := find_contradiction(state, capabilities):
        raise ContradictionError(
            f"the status of the controller contradicts itself: {wrong}; the arm is not driven any more, correct the "
            "controller's program"
        )


def latched_fault(state: RobotState) -> str:
    """Return the fault or emergency stop that any field reports, in words; empty if there is none."""
    if state.mode is Mode.EMERGENCY_STOP or state.flags & Flag.EMERGENCY_STOP:
        return state.fault_message or "the emergency stop is or was pressed"
    if state.mode is Mode.FAULT or state.flags & Flag.FAULT or state.fault_code:
        return state.fault_message or f"fault {state.fault_code} of this controller"
    return ""


def fault_error(state: RobotState) -> FaultError:
    """Return the error of the fault or emergency stop that a status reports."""
    is_emergency = state.mode is Mode.EMERGENCY_STOP or state.flags & Flag.EMERGENCY_STOP
    return (EmergencyStopError if is_emergency else FaultError)(latched_fault(state), state.fault_code)


def is_at_rest(state: RobotState) -> bool:
    """Return whether no field of the status reports motion."""
    return state.at_rest and not state.flags & Flag.MOVING and state.mode is not Mode.MOVING


def require_valid_capabilities(capabilities: Capabilities, axes: int) -> None:
    """Raise ProtocolError if capabilities are impossible or the number of axes differs from the client's `axes`."""
    if len(capabilities.lower) != axes:
        raise ProtocolError(f"the controller has {len(capabilities.lower)} axes; this client drives {axes}")
    speed, scale = capabilities.max_speed, capabilities.time_scale
    checks = {
        "the lower limit of an axis is above its upper limit": (capabilities.lower > capabilities.upper).any(),
        "the largest step of an axis is not above 0": (capabilities.max_step <= 0).any(),
        f"the largest speed fraction is {speed:g}, not above 0 and at most 1": not 0 < speed <= 1,
        f"its clock is {scale:g} times as fast as real time": not 0 < scale < math.inf,
    }
    for message, is_wrong in checks.items():
        if is_wrong:
            raise ProtocolError(f"the capabilities of the controller are impossible: {message}")


def fastest_duration(move: Move, state: RobotState, limits: Limits) -> float:
    """Return the time [s] that an arm with these limits needs for a move, at its speed and full override."""
    velocity = limits.velocity * move.speed
    start = to_rad(state.axes)
    return interpolate(start, to_rad(move.set_points), velocity, limits.acceleration, limits.jerk).duration


def require_completed(state: RobotState) -> None:
    """Raise the error of a move that did not end at its last set-point.

    Raises:
        StoppedError: if it was stopped on its path.
        FaultError, EmergencyStopError: if a fault ended it, or was latched just after its end.
    """
    position = f"the arm is at rest at {format_axes(state.axes)}"
    if state.done_result in (Result.STOPPED, Result.STOPPED_BY_OTHER):
        raise StoppedError(f"{Result(state.done_result).message}; {position}")
    fault = latched_fault(state)
    if state.done_result != Result.OK or fault:
        kind = EmergencyStopError if state.mode is Mode.EMERGENCY_STOP else FaultError
        note = "the move had just ended; " if state.done_result == Result.OK else ""
        raise kind(f"{fault or describe_result(state.done_result)}; {note}{position}", state.fault_code)


def require_arrived(move: Move, state: RobotState, elapsed: float, fastest: float) -> None:
    """Raise ArrivalError if the arm is elsewhere at the end of a move, or arrived sooner than possible.

    Args:
        move: the commanded move.
        state: the state at its end.
        elapsed: time from the command to its end [s], controller's clock.
        fastest: duration of the fastest profile [s].
    """
    goal, report = move.set_points[-1], "the controller reports the end of the move"
    if state.mode is not Mode.IN_POSITION:
        raise ArrivalError(f"{report}, but its mode is {state.mode.name.lower()}, not in position")
    if np.abs(state.axes.astype(np.int64) - goal).max() > MAX_ARRIVAL_ERROR:
        raise ArrivalError(f"{report}, but the arm is at {format_axes(state.axes)}, not {format_axes(goal)}")
    if elapsed < MIN_TIME_FACTOR * fastest:
        raise ArrivalError(
            f"{report} after {elapsed:.3f} s; an arm with these limits needs at least {fastest:.3f} s: the controller "
            "did not drive it, or is faster than real time and does not report its time scale"
        )


class MotionMonitor:
    """Monitor of the progress of one move.

    Args:
        clock: the client's.
        goal: description of the awaited event.
        began: time of the clock at which the move was sent [s].
        fastest: time [s] of the controller's clock for the move at its speed and full override.
        time_scale: seconds of the controller's clock per second of the client's.
        notify: receives a message after `NOTIFY_AFTER` without progress.
    """

    def __init__(
        self,
        clock: Clock,
        goal: str,
        began: float,
        fastest: float,
        time_scale: float,
        notify: Callable[[str], None] | None,
    ) -> None:
        self._clock, self._goal, self._fastest, self._notify = clock, goal, fastest, notify
        self._time_scale = time_scale
        self._stall_limit = STALL_LIMIT / min(time_scale, 1.0)
        self._began = self._updated = began
        self._driven = 0.0  # controller's clock, at full override
        # Client's clock: without holds the total time and the time without progress; the latter with holds.
        self._spent = self._stalled = self._quiet = 0.0
        self._has_notified = False
        self._last: RobotState | None = None

    @property
    def elapsed(self) -> float:
        """Time since the move was sent [s], controller's clock."""
        return (self._clock.now() - self._began) * self._time_scale

    def update(self, state: RobotState) -> None:
        """Process the status of an arm that has not arrived; raise OverdueError if it should have arrived."""
        now = self._clock.now()
        passed, self._updated = max(now - self._updated, 0.0), now
        if self._last is None or _has_moved(self._last, state):
            self._last, self._stalled, self._quiet, self._has_notified = state, 0.0, 0.0, False
            is_waiting = False
        else:
            is_waiting = state.is_held
            self._quiet += passed
        if not is_waiting:
            self._stalled += passed
            self._spent += passed
            self._driven += passed * self._time_scale * max(state.override, _MIN_OVERRIDE) / FULL
        status = (
            f"{self._goal}: the arm is at {format_axes(state.axes)}, {state.path / 100:.0f} % of the path, override "
            f"{state.override / 100:.0f} %" + ", held" * state.is_held
        )
        if self._stalled > self._stall_limit:
            raise OverdueError(f"{self._stalled:.1f} s without progress while waiting for {status}")
        if self._spent > self._stall_limit and self._driven > MAX_TIME_FACTOR * self._fastest:
            raise OverdueError(
                f"{self._driven:.1f} s of motion instead of {self._fastest:.1f} s, while waiting for {status}"
            )
        if self._notify and self._quiet > NOTIFY_AFTER and not self._has_notified:
            self._has_notified = True
            self._notify(f"waiting for {status}")


def _has_moved(before: RobotState, now: RobotState) -> bool:
    same_axes = len(before.axes) == len(now.axes)
    change = np.abs(now.axes.astype(np.int64) - before.axes).max() if same_axes else 0
    return bool(change > _NOISE or now.path > before.path)
