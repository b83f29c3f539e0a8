"""The smallest clearance of every segment of a motion with a proven lower bound, and the nearest pair of shapes.

Branch and bound over each straight joint segment. Between two configurations at which a pair of shapes is d_0 and d_1
apart and no point moves farther than L between them, the distance of the pair is at least

    (d_0 + d_1 - f L) / 2,        f = 1 if one of the two is stationary, 2 if both move,

because a distance changes by at most f times the travel, from either end. The interval with the smallest bound is
halved until no bound is below the smallest measured distance by more than the tolerance. So the returned distance was
measured at a configuration of the motion, and the true minimum is at most the tolerance below it. Far from everything
few configurations are measured: the ends of most intervals are enough.

Base frame, metres, radians.
"""

import heapq
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from cell.world.collision import DISTANCE_CAP, MujocoCollisionChecker
from planner.ports import Progress, no_progress
from planner.values import Floats, Value

TOLERANCE = 2e-4
"""Largest gap between a measured minimum and its lower bound [m], for small distances."""

SHARE = 0.05
"""Tolerance of large distances, relative to the distance."""

_MOST = 4_000  # configurations measured in a segment; beyond, the gap between distance and bound stays wider


@dataclass(frozen=True, slots=True, eq=False)
class TightestMoment(Value):
    """The configuration of a motion at which two shapes are nearest.

    Attributes:
        segment: number of the motion's segment.
        q: joint angles [rad].
        distance: between the two shapes [m].
        between: their names, "housing with part".
        points: the nearest points, of the first and of the second shape [m], base frame.
    """

    segment: int
    q: Annotated[Floats, "axes"]
    distance: float
    between: str
    points: Annotated[Floats, "2 3"]


@dataclass(frozen=True, slots=True, eq=False)
class MotionClearance(Value):
    """Smallest distances of a motion.

    Attributes:
        distance: smallest measured distance of each segment [m], at most `collision.DISTANCE_CAP`.
        lower_bound: proven lower bound on the distance of each segment [m].
        between: the nearest pair of each segment, "" where everything is farther than the cap.
        tightest: the nearest of all; None where everything is farther than the cap.
        checks: number of measured configurations.
    """

    distance: Annotated[Floats, "n"]
    lower_bound: Annotated[Floats, "n"]
    between: Annotated[tuple[str, ...], "n"]
    tightest: TightestMoment | None
    checks: int


def motion_clearance(
    checker: MujocoCollisionChecker,
    via: Floats,
    segment: NDArray[np.integer],
    segments: int,
    progress: Progress = no_progress,
    share: float = SHARE,
) -> MotionClearance:
    """Measure the clearance of a motion.

    Args:
        checker: at the motion's placement.
        via: (N, axes) via points of straight joint moves [rad].
        segment: (N,) segment that ends at or passes each via point; 0 for the first.
        segments: number of segments; one without a move is measured at its configuration.
        progress: called with (measured segments, all segments).
        share: tolerance of large distances, relative to the distance.
    """
    count = segments if len(via) else 0
    distance, lower_bound, between = np.full(count, DISTANCE_CAP), np.full(count, DISTANCE_CAP), [""] * count
    nearest: tuple[float, int, Floats] | None = None
    checks = 0
    for number in range(count):
        search = _SegmentSearch(checker, share)
        rows = np.flatnonzero(segment[1:] == number) + 1
        for k in rows:
            search.add_move(via[k - 1], via[k])
        if not len(rows):
            at = via[max(0, int(np.searchsorted(segment, number)) - 1)]
            search.add_move(at, at)
        distance[number], lower_bound[number] = search.best, search.lower_bound
        checks += search.checks
        if search.q is not None:
            between[number] = checker.pair_name(search.pair)
            if nearest is None or search.best < nearest[0]:
                nearest = (search.best, number, search.q)
        progress(number + 1, count)
    tightest = None if nearest is None else tightest_at(checker, nearest[2], nearest[1])
    return MotionClearance(distance, lower_bound, tuple(between), tightest, checks)


def tightest_at(checker: MujocoCollisionChecker, q: Floats, segment: int = 0) -> TightestMoment | None:
    """Return the nearest pair at one configuration (axes,) [rad]; None beyond the cap."""
    pair, distance = checker.nearest(q, DISTANCE_CAP)
    if pair < 0:
        return None
    return TightestMoment(segment, q, distance, checker.pair_name(pair), checker.nearest_points(q, pair))


class _SegmentSearch:
    """Branch and bound over the straight moves of one segment; the best distance of one move prunes the next.

    Attributes:
        best: smallest measured distance [m].
        lower_bound: proven lower bound on the distance [m].
        pair: number of the nearest pair, -1 before one is measured.
        q: (axes,) configuration of `best`.
        checks: number of measured configurations.
    """

    def __init__(self, checker: MujocoCollisionChecker, share: float) -> None:
        self._checker, self._share = checker, share
        self.best, self.lower_bound = DISTANCE_CAP, DISTANCE_CAP
        self.pair = -1
        self.q: Floats | None = None
        self.checks = 0

    def add_move(self, q_from: Floats, q_to: Floats) -> None:
        """Search the straight move between two configurations (axes,) [rad]."""
        travel = float(self._checker.travel(q_from[None], q_to[None])[0])
        ends = (0.0, self._measure(q_from, DISTANCE_CAP)), (1.0, self._measure(q_to, DISTANCE_CAP))
        intervals = [(_bound(*ends, travel), *ends)]
        checks = 0
        while intervals:
            bound, left, right = heapq.heappop(intervals)
            if bound >= self.best - max(TOLERANCE, self._share * self.best) or checks >= _MOST:
                self.lower_bound = min(self.lower_bound, bound)
                break
            checks += 1
            share = (left[0] + right[0]) / 2
            # A distance of `reach` or more clears both halves.
            reach = min(DISTANCE_CAP, self.best + travel * (right[0] - left[0]))
            middle = share, self._measure(q_from + share * (q_to - q_from), reach)
            for one, two in ((left, middle), (middle, right)):
                heapq.heappush(intervals, (_bound(one, two, travel), one, two))
        self.lower_bound = min(self.lower_bound, self.best)

    def _measure(self, q: Floats, reach: float) -> tuple[float, float]:
        """Return the smallest distances of pairs with one and with two moving bodies, at most `reach` [m]."""
        self.checks += 1
        one_moves, both_move = self._checker.nearest_by_kind(q, reach)
        for pair, distance in (one_moves, both_move):
            if pair >= 0 and distance < self.best:
                self.best, self.pair, self.q = distance, pair, q.copy()
        return one_moves[1], both_move[1]


_End = tuple[float, tuple[float, float]]


def _bound(left: _End, right: _End, travel: float) -> float:
    """Return a lower bound on the distance [m] within an interval of a move with a total `travel` [m]."""
    part = travel * (right[0] - left[0])
    one_moves = (left[1][0] + right[1][0] - part) / 2
    both_move = (left[1][1] + right[1][1] - 2 * part) / 2
    return min(one_moves, both_move)


def time_of_tightest(
    motion_t: Floats, motion_q: Floats, segment_of_sample: NDArray[np.integer], tightest: TightestMoment
) -> float:
    """Return the time [s] at which a timed motion is nearest to the tightest configuration, within its segment.

    Args:
        motion_t: (M,) times of the samples [s].
        motion_q: (M, axes) joint angles [rad].
        segment_of_sample: (M,) segment that each sample belongs to, not decreasing. A segment begins at the last sample
            of the segment before it; one without a move has no samples of its own.
        tightest: the configuration.
    """
    first, end = np.searchsorted(segment_of_sample, [tightest.segment, tightest.segment + 1])
    samples = np.arange(max(first - 1, 0), end)
    if len(samples) == 1:
        return float(motion_t[samples[0]])
    a = motion_q[samples[:-1]]
    step = motion_q[samples[1:]] - a
    squared = np.maximum((step * step).sum(axis=1), 1e-30)
    share = np.clip(((tightest.q - a) * step).sum(axis=1) / squared, 0.0, 1.0)
    k = int(np.argmin(np.linalg.norm(a + share[:, None] * step - tightest.q, axis=1)))
    return float(motion_t[samples[k]] + share[k] * (motion_t[samples[k + 1]] - motion_t[samples[k]]))
