"""What every wire has in common: a move cut into what a frame can hold, speeds as whole numbers, patience, a pulse.

A frame is short and a move may have 100,000 via points. So a move is *staged*: its via points go into a buffer of the
controller, piece by piece, under the sequence number that the move will have. Staging moves nothing, and writing the
same piece twice is writing it once. The move command itself, the *commit*, carries the speed, how many points there
are, the CRC-32 of all of them, and the last of them (all, where they fit: then nothing is staged). The controller
accepts the commit only when what it holds is exactly what was counted and summed.

So a move stays one command with one number: it is checked as a whole before the arm moves, it is executed once or not
at all, and a wire that fails while it is sent leaves an arm that stands. Splitting it into several queued moves would
need none of the buffer, but a fault in the middle would then leave part of it executed, and a refusal of point 70,000
would come after 69,999 have been driven.

The CRC-32 is the one of zlib, Ethernet and PKZIP (polynomial 0x04C11DB7 reflected, start and final XOR 0xFFFFFFFF),
taken over the points as big-endian int32, point by point, A1 on.
"""

import zlib
from dataclasses import dataclass

import numpy as np

from drivers.clock import Clock
from drivers.commands import Move
from drivers.errors import DriverUrlError, LinkLostError
from drivers.setpoints import AXES, SetPoints, frozen
from drivers.url import DriverUrl

SPEEDS = 10_000
"""Speed fractions travel as whole numbers of 1e-4: 10,000 is full speed."""

DEFAULT_WATCHDOG_MS = 1000
"""Silence of the client [ms] after which a moving arm is stopped, where the client says nothing else."""

WATCHDOG_RANGE_MS = (100, 5000)
"""Shortest and longest silence [ms] that a client may ask for; what is beyond is refused."""

MOST_POINTS = 200_000
"""Via points of one move that the controller's buffer holds (4.8 MB)."""

MOST_AXES = 12
"""Axes of an arm that frames and register blocks have room for."""

SCALES = 1000
"""Time scales travel as whole numbers of 1e-3: 1,000 is real time."""


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """A piece of the via points of the move to come.

    Attributes:
        offset: index of its first point in the move.
        points: (k, n) int32 counts of 1e-4 deg, k at least 1.
    """

    offset: int
    points: SetPoints


@dataclass(frozen=True, slots=True, eq=False)
class Commit:
    """The command to execute a move whose first points are staged.

    Attributes:
        speed: speed fraction in 1e-4.
        count: via points of the whole move.
        crc: CRC-32 of all of them.
        tail: (k, n) the last of them, int32 counts; all of them where count is k.
    """

    speed: int
    count: int
    crc: int
    tail: SetPoints


def pieces(move: Move, size: int) -> tuple[list[Stage], Commit]:
    """Cut a move into what is staged and what commits it, `size` points at most in each."""
    points = move.set_points
    n = len(points)
    n_tail = min(n, size)
    stages = [Stage(k, points[k : min(k + size, n - n_tail)]) for k in range(0, n - n_tail, size)]
    return stages, Commit(speed_to_wire(move.speed), n, points_crc(points), points[n - n_tail :])


def points_crc(points: SetPoints) -> int:
    """CRC-32 of set-points."""
    return zlib.crc32(np.ascontiguousarray(points, dtype=">i4").tobytes())


def speed_to_wire(speed: float) -> int:
    """A speed fraction in 1e-4, never faster than asked; 0, which every controller refuses, for what is no fraction."""
    return int(speed * SPEEDS + 1e-6) if 0.0 < speed <= 1.0 else 0


def speed_from_wire(speed: int) -> float:
    """The speed fraction."""
    return speed / SPEEDS


@dataclass(frozen=True)
class Patience:
    """How long a client waits for what.

    Attributes:
        answer: longest time from a question to its answer [s], without the time of the bytes on the wire.
        tries: how often the state is asked for, at least, before it counts as unreadable.
        watchdog: silence [s] after which either side takes the other for gone.
        poll: time [s] between two questions for the state of a moving arm.
    """

    answer: float = 0.25
    tries: int = 3
    watchdog: float = DEFAULT_WATCHDOG_MS / 1000.0
    poll: float = 0.02

    @property
    def watchdog_ms(self) -> int:
        """The watchdog [ms]."""
        return round(self.watchdog * 1000.0)

    @classmethod
    def from_url(cls, url: DriverUrl) -> "Patience":
        """Take the options timeout_ms, watchdog_ms and poll_ms.

        Raises:
            DriverUrlError: if one cannot be, or the watchdog would bite while the client still asks again.
        """
        least, most = WATCHDOG_RANGE_MS
        answer = url.number("timeout_ms", 1000.0 * cls.answer, above=0.0, at_most=60_000.0)
        watchdog = url.number("watchdog_ms", 1000.0 * cls.watchdog, above=least - 1.0, at_most=most)
        poll = url.number("poll_ms", 1000.0 * cls.poll, above=0.0, at_most=most)
        if cls.tries * answer > watchdog or poll > watchdog / 2.0:
            raise DriverUrlError(
                f"'{url.text}' has timeout_ms={answer:g}, poll_ms={poll:g} and watchdog_ms={watchdog:g}; the watchdog "
                f"must be at least {cls.tries} times the timeout and twice the poll, or one lost answer stops the arm"
            )
        return cls(answer / 1000.0, cls.tries, watchdog / 1000.0, poll / 1000.0)


class Pulse:
    """The client's watchdog: a controller whose heartbeat stands still is gone, even where something answers for it.

    Args:
        clock: the client's.
        limit: time [s] for which the heartbeat may stand still.
    """

    def __init__(self, clock: Clock, limit: float) -> None:
        self._clock, self._limit = clock, limit
        self._last: int | None = None
        self._since: float | None = None

    def see(self, heartbeat: int) -> None:
        """Take the heartbeat of an answer.

        Raises:
            LinkLostError: if it has stood still for too long, seen three times at least.
        """
        now = self._clock.now()
        if heartbeat != self._last:
            self._last, self._since = heartbeat, None
        elif self._since is None:
            self._since = now  # from here on: a long pause of ours before is no standstill of theirs
        elif now - self._since > self._limit:
            raise LinkLostError(
                f"the controller's heartbeat has stood still for {now - self._since:.2f} s; what answers is not the "
                "controller itself"
            )

    def forget(self) -> None:
        """The line was opened anew."""
        self._last = None


class Staging:
    """The controller's buffer of via points.

    It belongs to one sequence number at a time; a piece under another number empties it first.

    Args:
        axes: of a point.
    """

    def __init__(self, axes: int = AXES) -> None:
        self.sequence, self._axes = 0, axes
        self._bytes = bytearray()

    def __len__(self) -> int:
        """Points that it holds."""
        return len(self._bytes) // (4 * self._axes)

    def put(self, sequence: int, piece: Stage) -> bool:
        """Write a piece; False where it would leave a gap or not fit."""
        if sequence != self.sequence:
            self.sequence, self._bytes = sequence, bytearray()
        if piece.offset > len(self) or piece.offset + len(piece.points) > MOST_POINTS:
            return False
        begin = piece.offset * 4 * self._axes
        data = np.ascontiguousarray(piece.points, dtype=">i4").tobytes()
        self._bytes[begin : begin + len(data)] = data
        return True

    def take(self, sequence: int, commit: Commit) -> SetPoints | None:
        """The whole move's points, or None where what is held is not what the commit counts and sums.

        The buffer stays as it is, so that a repeated commit gives the same points.
        """
        before = commit.count - len(commit.tail)
        if not (before >= 0 and len(commit.tail) and commit.count <= MOST_POINTS):
            return None
        if before and (sequence != self.sequence or before > len(self)):
            return None
        staged = bytes(self._bytes[: before * 4 * self._axes]) if before else b""
        points = np.concatenate([np.frombuffer(staged, dtype=">i4").reshape(-1, self._axes), commit.tail])
        whole = frozen(points, np.int32)
        return whole if points_crc(whole) == commit.crc else None
