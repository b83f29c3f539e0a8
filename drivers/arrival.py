"""Whether a move has ended as it was commanded: where, how, and not sooner than the arm can."""

from collections.abc import Callable

import numpy as np

from drivers import status
from drivers.clock import Clock
from drivers.commands import Move, Result, sentence_of
from drivers.contract import Mode, RobotState
from drivers.errors import ArrivalError, EmergencyStopError, FaultError, StoppedError
from drivers.limits import Limits
from drivers.profile import interpolate
from drivers.setpoints import text, to_rad


def profile_of(move: Move, state: RobotState, limits: Limits) -> float:
    """Time [s] that an arm with these limits needs for a move from where it stands, at its speed and full override."""
    velocity = limits.velocity * move.speed
    at = to_rad(state.axes)
    return interpolate(at, to_rad(move.set_points), velocity, limits.acceleration, limits.jerk).duration


def watch_of(
    move: Move, profile: float, clock: Clock, time_scale: float, say: Callable[[str], None] | None
) -> status.Watch:
    """The limits of the wait for the end of a move that begins now."""
    return status.Watch(clock, f"the end of a move to {text(move.set_points[-1])}", profile, time_scale, say)


def require_ended_well(state: RobotState) -> None:
    """Look at how the last move ended.

    Raises:
        StoppedError: if it was stopped on its path.
        FaultError, EmergencyStopError: if a fault ended it, or was latched when it had just been done.
    """
    where = f"the arm stands at {text(state.axes)}"
    if state.done_result in (Result.STOPPED, Result.STOPPED_BY_OTHER):
        raise StoppedError(f"{Result(state.done_result).sentence}; {where}")
    fault = status.latched(state)
    if state.done_result != Result.OK or fault:
        kind = EmergencyStopError if state.mode is Mode.EMERGENCY_STOP else FaultError
        done = "the move was done just before; " if state.done_result == Result.OK else ""
        raise kind(f"{fault or sentence_of(state.done_result)}; {done}{where}", state.fault_code)


def require_arrived(move: Move, state: RobotState, took: float, profile: float) -> None:
    """Look at where and when a move ended that is said to be done.

    Args:
        move: what was commanded.
        state: at its end.
        took: time from its command until then [s], controller's clock.
        profile: time that the fastest way takes [s].

    Raises:
        ArrivalError: if the arm stands elsewhere, or came there sooner than it can.
    """
    goal, said = move.set_points[-1], "the move is said to be done"
    if state.mode is not Mode.IN_POSITION:
        raise ArrivalError(f"{said}, and the controller is {state.mode.name.lower()}, not in position")
    if np.abs(state.axes.astype(np.int64) - goal).max() > status.MOST_OFF:
        raise ArrivalError(f"{said}, and the arm stands at {text(state.axes)}, not {text(goal)}")
    if took < status.SOONEST * profile:
        raise ArrivalError(
            f"{said} after {took:.3f} s, and no arm with these limits needs less than {profile:.3f} s: the controller "
            "did not drive it, or is faster than real time and does not say so"
        )
