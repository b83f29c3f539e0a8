"""Commands to a controller, its answers, and the sequence-number rule that makes them safe to repeat.

Every command carries a sequence number from 1 to 65535; after 65535 comes 1. 0 is what a controller that has answered
nothing since its start reports. A number is *newer* than another where it follows it by less than half the circle
(serial number arithmetic, RFC 1982, on a circle of 65535). A controller

- executes a command once, when its number is newer than the last one that it answered;
- gives the old answer to a repeat of the last command, and does nothing;
- refuses a repeat with other content (REUSED), and an older number (STALE: a late duplicate).

So a client that got no answer may send the same command again: it is executed at most once. A refused command uses its
number up. Stopping is always safe, so a stop is obeyed whatever its number and whatever the answer to it.

The numbers are those of one session, the owner's: what else comes is refused before its number is looked at.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from drivers.codes import Code
from drivers.setpoints import SetPoints, check

LAST_SEQUENCE: Final = 65535


class Result(Code):
    """The answer to a command, and how a move ended; the numbers go over wires."""

    OK = 0, "done"
    UNKNOWN_COMMAND = 1, "the controller does not know this command"
    IN_FAULT = 2, "a fault is latched; reset first"
    LIMIT = 3, "a set-point is outside the axis limits"
    SPEED = 4, "the speed fraction is outside its range"
    STEP = 5, "a step from one via point to the next is larger than the controller allows"
    BUSY = 7, "the controller is braking or its queue is full; wait until the arm stands"
    SEQUENCE = 8, "the sequence number is outside 1 to 65535"
    REUSED = 9, "the sequence number was already used for another command"
    STALE = 10, "the sequence number is older than the last one; another client, or a late duplicate"
    ESTOP_PRESSED = 11, "the emergency stop is still pressed; release it first"
    TOO_MANY_POINTS = 12, "the move has more via points than the controller takes"
    INCOMPLETE = 13, "the via points that were staged are not those of the move; stage them again"
    NOT_OWNER = 14, "another session owns the arm, or none does; take it first"
    WATCHDOG = 15, "the watchdog is outside 100 to 5000 ms"
    STOPPED = 20, "the move was stopped on command"
    FAULTED = 21, "the move was ended by a fault"
    STOPPED_BY_OTHER = 22, "the move was stopped by another client, which ends the session"


@dataclass(frozen=True, slots=True, eq=False)
class Move:
    """Drive through via points.

    Attributes:
        set_points: (N, 6) int32 counts of 1e-4 deg, N at least 1.
        speed: fraction of the axis speeds. Any number may stand here: refusing one is the controller's part.
    """

    set_points: SetPoints
    speed: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "set_points", check(self.set_points))
        object.__setattr__(self, "speed", float(self.speed))


@dataclass(frozen=True, slots=True)
class Stop:
    """Brake on the path and drop what is queued."""


@dataclass(frozen=True, slots=True)
class Reset:
    """Clear a latched fault."""


Command = Move | Stop | Reset


@dataclass(frozen=True, slots=True)
class Answer:
    """A controller's answer to one command.

    Attributes:
        sequence: number of the command that is answered.
        result: OK where it was accepted, else why not. A foreign controller may have other numbers.
        detail: what exactly was refused, in words; may be empty.
    """

    sequence: int
    result: int
    detail: str = ""

    @property
    def sentence(self) -> str:
        """The answer in words."""
        return self.detail or sentence_of(self.result)


def sentence_of(result: int) -> str:
    """A result code in words, a foreign one too."""
    try:
        return Result(result).sentence
    except ValueError:
        return f"the controller gave result code {result}, which this version does not know"


def same(a: Command, b: Command) -> bool:
    """Whether two commands ask for the same thing."""
    if isinstance(a, Move) and isinstance(b, Move):
        # Bytes of the speed, so that a NaN repeats itself too.
        return (
            np.array_equal(a.set_points, b.set_points)
            and np.float64(a.speed).tobytes() == np.float64(b.speed).tobytes()
        )
    return type(a) is type(b)


def next_sequence(sequence: int) -> int:
    """The number after this one: 1 after 0 and after 65535."""
    return sequence % LAST_SEQUENCE + 1


def is_newer(sequence: int, last: int) -> bool:
    """Whether a sequence number (1 to 65535) follows `last` (0: nothing came before, so all are newer)."""
    return last == 0 or 0 < (sequence - last) % LAST_SEQUENCE <= LAST_SEQUENCE // 2
