"""What a client believes of a status, and how long it waits: one table of what is refused, one set of limits.

A controller that misbehaves is seldom silent: it says what cannot be. So a client looks at all fields before each move,
each scan and while it waits, and takes the worse of two that disagree. None of the limits is a setting.
"""

import math
from collections.abc import Callable
from typing import Final

import numpy as np

from drivers.clock import Clock
from drivers.commands import Result, is_newer
from drivers.contract import WHOLE, Capabilities, Flag, Mode, RobotState
from drivers.errors import ContradictionError, OverdueError, ProtocolError
from drivers.setpoints import text

STALL: Final = 5.0
"""Longest time [s] without progress of axes or path parameter, unless a hold is reported; of a faster than real clock
in real seconds, of a slower one in its own."""

LATEST: Final = 3.0
"""A move may take so many times its profile's time at the reported override, `STALL` at least."""

SOONEST: Final = 0.95
"""Share of the fastest profile's time below which nobody arrives; the rest is for clocks that differ."""

STANDS_AFTER: Final = 5.0
"""Longest time [s] from a stop to an arm that stands."""

HALT: Final = 1.0
"""Time [s] that a client which is told to end has for its stop."""

TAKE: Final = 5.5
"""Longest time [s] for which a silent owner is waited for: the longest watchdog, and a little."""

SAID_AFTER: Final = 2.0
"""Standstill [s] after which a person is told what is waited for."""

MOST_OFF: Final = 1000
"""Farthest from its last set-point that an arm ends a move, counts: 0.1 deg. `cell` asks for far less, in mm."""

QUEUE: Final = 1
"""Moves that a controller holds: the one that is driven. More are another client's."""

_NOISE = 10  # counts: an axis that turns less than 0.001 deg stands
_SLOWEST = 100  # 1e-4: a smaller override is taken as this one, so that no limit is endless

_MODES = {mode: f"mode {int(mode)} ({mode.name.lower().replace('_', ' ')})" for mode in Mode}
_OF_MODE = ((Flag.IN_POSITION, Mode.IN_POSITION), (Flag.FAULT, Mode.FAULT), (Flag.EMERGENCY_STOP, Mode.EMERGENCY_STOP))


def contradiction(state: RobotState, able: Capabilities) -> str:
    """The first thing in a status that cannot be true, in words; empty where there is none."""
    stands, moves = bool(state.flags & Flag.STANDS), bool(state.flags & Flag.MOVES)
    latched, mode = state.mode in (Mode.FAULT, Mode.EMERGENCY_STOP), _MODES[state.mode]
    at_rest = state.mode is Mode.IN_POSITION and state.queue_depth == 0
    wrong_flags = [flag for flag, of in _OF_MODE if bool(state.flags & flag) is not (state.mode is of)]
    table = (
        (state.flags >= 2 * Flag.HELD, f"its flags 0x{state.flags:04X} have bits that do not exist"),
        (stands and moves, "the arm stands and moves at once"),
        (not stands and not moves, "the arm neither stands nor moves"),
        (state.standing is not stands, "the arm stands, and its flags say that it moves"),
        (state.mode is Mode.MOVING and stands, f"the arm stands in {mode}"),
        (state.mode in (Mode.IDLE, Mode.IN_POSITION) and moves, f"the arm moves in {mode}"),
        (bool(wrong_flags), f"{', '.join(f.name.lower() for f in wrong_flags if f.name)} flag and {mode} do not agree"),
        (bool(state.fault_code) is not latched, f"fault code {state.fault_code} and {mode} do not agree"),
        (state.override > WHOLE, f"its override is {state.override / 100:g} %"),
        (state.path > WHOLE, f"{state.path / 100:g} % of the path are passed"),
        (state.queue_depth > QUEUE, f"{state.queue_depth} moves are queued, and a controller takes {QUEUE} at a time"),
        (at_rest and state.done_result != Result.OK, f"{mode} after a move that ended with {state.done_result}"),
        (at_rest and state.path != WHOLE, f"{mode} when {state.path / 100:g} % of the path are passed"),
        (
            state.done_sequence != state.ack_sequence and bool(state.done_sequence)
            and is_newer(state.done_sequence, state.ack_sequence),
            f"move {state.done_sequence} ended, and command {state.ack_sequence} is the last that was answered",
        ),
        (
            len(state.axes) != len(able.lower),
            f"it tells {len(state.axes)} axes and said at the start that there are {len(able.lower)}",
        ),
    )  # fmt: skip
    return next((sentence for is_so, sentence in table if is_so), "")


def believe(state: RobotState, able: Capabilities) -> None:
    """Take a status for true.

    Raises:
        ContradictionError: if it cannot be.
    """
    if wrong := contradiction(state, able):
        raise ContradictionError(
            f"the controller's status contradicts itself: {wrong}; the arm is not driven until its program is repaired"
        )


def latched(state: RobotState) -> str:
    """The fault or emergency stop that any field tells of, in words; empty where none does."""
    if state.mode is Mode.EMERGENCY_STOP or state.flags & Flag.EMERGENCY_STOP:
        return state.fault_sentence or "the emergency stop is or was pressed"
    if state.mode is Mode.FAULT or state.flags & Flag.FAULT or state.fault_code:
        return state.fault_sentence or f"fault {state.fault_code} of this controller"
    return ""


def stands(state: RobotState) -> bool:
    """Whether no field of the status says that the arm moves."""
    return state.standing and not state.flags & Flag.MOVES and state.mode is not Mode.MOVING


def require_possible(able: Capabilities, axes: int) -> None:
    """Look at what a controller says that it accepts.

    Raises:
        ProtocolError: if it cannot be, or the controller has other axes than the client.
    """
    if len(able.lower) != axes:
        raise ProtocolError(f"the controller has {len(able.lower)} axes and this client drives {axes}")
    wrong = {
        "an axis' lower limit is above its upper one": bool((able.lower > able.upper).any()),
        "the largest step of an axis is not above 0": bool((able.max_step <= 0).any()),
        f"the largest speed fraction is {able.max_speed:g}, not above 0 and at most 1": not 0 < able.max_speed <= 1,
        f"its clock is {able.time_scale:g} times as fast as real time": not 0 < able.time_scale < math.inf,
    }
    for sentence, is_so in wrong.items():
        if is_so:
            raise ProtocolError(f"the controller's capabilities cannot be: {sentence}")


class Watch:
    """One wait for an arm to arrive.

    Args:
        clock: the client's.
        what: what is waited for, in words.
        profile: time [s] of the controller's clock that the move takes at its speed and full override.
        time_scale: seconds of the controller's clock per second of the client's.
        say: told what is waited for, when nothing has happened for `SAID_AFTER`.
    """

    def __init__(
        self, clock: Clock, what: str, profile: float, time_scale: float, say: Callable[[str], None] | None
    ) -> None:
        self._clock, self._what, self._profile, self._say = clock, what, profile, say
        self._time_scale = time_scale
        self._stall = STALL / min(time_scale, 1.0)
        self._began = self._seen = clock.now()
        self._driven = 0.0  # of the controller's clock, at full override
        self._spent = self._still = self._quiet = 0.0  # of the client's clock; the first two do not count a hold
        self._said = False
        self._last: RobotState | None = None

    @property
    def elapsed(self) -> float:
        """Time since the wait began [s], controller's clock."""
        return (self._clock.now() - self._began) * self._time_scale

    def see(self, state: RobotState) -> None:
        """Take a status of an arm that has not arrived.

        Raises:
            OverdueError: if it should have.
        """
        now = self._clock.now()
        passed, self._seen = max(now - self._seen, 0.0), now
        if self._last is None or self._moved(self._last, state):
            self._last, self._still, self._quiet, self._said = state, 0.0, 0.0, False
            waiting = False
        else:
            waiting = state.held
            self._quiet += passed
        if not waiting:
            self._still += passed
            self._spent += passed
            self._driven += passed * self._time_scale * max(state.override, _SLOWEST) / WHOLE
        told = (
            f"{self._what}: the arm stands at {text(state.axes)}, {state.path / 100:.0f} % of the path, override "
            f"{state.override / 100:.0f} %" + ", held" * state.held
        )
        if self._still > self._stall:
            raise OverdueError(f"{self._still:.1f} s without progress while waiting for {told}")
        if self._spent > self._stall and self._driven > LATEST * self._profile:
            raise OverdueError(
                f"{self._driven:.1f} s of driving, where {self._profile:.1f} s are enough, while waiting for {told}"
            )
        if self._say and self._quiet > SAID_AFTER and not self._said:
            self._said = True
            self._say(f"waiting for {told}")

    @staticmethod
    def _moved(before: RobotState, now: RobotState) -> bool:
        same_axes = len(before.axes) == len(now.axes)
        off = np.abs(now.axes.astype(np.int64) - before.axes).max() if same_axes else 0
        return bool(off > _NOISE or now.path > before.path)
