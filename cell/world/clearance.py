"""The smallest clearance of every segment of a motion, proven: where, and between which two things.

Branch and bound over each straight joint segment. Between two configurations at which a pair of things is d_0 and d_1
apart and no point moves farther than L along the way between them, the pair is nowhere nearer than

    (d_0 + d_1 - f L) / 2,        f = 1 where one of the two stands still, 2 where both move,

because a distance changes by at most f times what is travelled, from either end. The interval with the smallest bound
is halved until no bound is below the smallest distance seen by more than `TOLERANCE`. So the value returned was
measured at a configuration of the motion, and the true minimum is at most the tolerance below it. Far from everything
few configurations are looked at: most intervals are cleared by their ends.

Base frame, metres, radians.
"""

import heapq
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from cell.session import default_effort
from cell.world.collision import DISTANCE_CAP, MujocoCollisionChecker
from planner.ports import Progress
from planner.values import Floats, Value

TOLERANCE = 2e-4
"""How far the true minimum may be below the one that is said [m], where it is near."""

_MOST = 4_000  # configurations looked at in a segment; what is then left open widens the gap that is said


@dataclass(frozen=True, slots=True, eq=False)
class TightestMoment(Value):
    """The moment of a motion at which two things are nearest.

    Attributes:
        segment: of the motion.
        q: (axes,) joint angles there [rad].
        distance: between the two [m].
        between: what they are, "housing with part".
        points: (2, 3) the nearest points, of the first and of the second [m], base frame.
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
        distance: (n,) smallest distance measured in each segment [m], at most `collision.DISTANCE_CAP`.
        lower_bound: (n,) what is proven: nothing in the segment is nearer than this [m].
        between: the pair that is nearest in each segment, "" where everything is farther than the cap.
        tightest: the nearest of all; None where everything is farther than the cap.
        checks: configurations at which distances were measured.
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
    progress: Progress | None = None,
) -> MotionClearance:
    """Measure a motion.

    Args:
        checker: at the motion's placement.
        via: (N, axes) via points, joined by straight joint moves [rad].
        segment: (N,) segment that ends at or passes each via point; 0 for the first.
        segments: how many there are; one without a move is measured where it stands.
        progress: called with (segments done, segments in all).
    """
    count = segments if len(via) else 0
    distance, lower_bound, between = np.full(count, DISTANCE_CAP), np.full(count, DISTANCE_CAP), [""] * count
    nearest: tuple[float, int, Floats] | None = None
    checks = 0
    for number in range(count):
        search = _Search(checker)
        rows = np.flatnonzero(segment[1:] == number) + 1
        for k in rows:
            search.look_along(via[k - 1], via[k])
        if not len(rows):
            stands = via[max(0, int(np.searchsorted(segment, number)) - 1)]
            search.look_along(stands, stands)
        distance[number], lower_bound[number] = search.best, search.lower_bound
        checks += search.checks
        if search.q is not None:
            between[number] = checker.pair_name(search.pair)
            if nearest is None or search.best < nearest[0]:
                nearest = (search.best, number, search.q)
        if progress is not None:
            progress(number + 1, count)
    tightest = None if nearest is None else tightest_at(checker, nearest[2], nearest[1])
    return MotionClearance(distance, lower_bound, tuple(between), tightest, checks)


def tightest_at(checker: MujocoCollisionChecker, q: Floats, segment: int = 0) -> TightestMoment | None:
    """What is nearest at one configuration (axes,) [rad]; None beyond the cap."""
    pair, distance = checker.nearest(q, DISTANCE_CAP)
    if pair < 0:
        return None
    points = checker.nearest_points(q, pair)
    return TightestMoment(segment, q, distance, checker.pair_name(pair), points)


class _Search:
    """Branch and bound over the straight moves of one segment; what one move found helps to clear the next.

    Attributes:
        best: smallest distance seen [m].
        lower_bound: no configuration looked along is nearer [m].
        pair: number of the guarded pair that is nearest, -1 before one is seen.
        q: (axes,) configuration at which it is.
        checks: configurations measured.
    """

    def __init__(self, checker: MujocoCollisionChecker) -> None:
        self._checker, self._share = checker, default_effort().clearance_share
        self.best, self.lower_bound = DISTANCE_CAP, DISTANCE_CAP
        self.pair = -1
        self.q: Floats | None = None
        self.checks = 0

    def look_along(self, q_from: Floats, q_to: Floats) -> None:
        """Search the straight move between two configurations (axes,) [rad]."""
        whole = float(self._checker.travel(q_from[None], q_to[None])[0])
        ends = (0.0, self._measure(q_from, DISTANCE_CAP)), (1.0, self._measure(q_to, DISTANCE_CAP))
        open_intervals = [(_bound(*ends, whole), *ends)]
        checks = 0
        while open_intervals:
            bound, left, right = heapq.heappop(open_intervals)
            if bound >= self.best - max(TOLERANCE, self._share * self.best) or checks >= _MOST:
                self.lower_bound = min(self.lower_bound, bound)
                break
            checks += 1
            share = (left[0] + right[0]) / 2
            # Beyond this a distance clears both halves, however far it really is.
            reach = min(DISTANCE_CAP, self.best + whole * (right[0] - left[0]))
            middle = share, self._measure(q_from + share * (q_to - q_from), reach)
            for one, two in ((left, middle), (middle, right)):
                heapq.heappush(open_intervals, (_bound(one, two, whole), one, two))
        self.lower_bound = min(self.lower_bound, self.best)

    def _measure(self, q: Floats, reach: float) -> tuple[float, float]:
        """Smallest distance of the pairs with one moving body, and of those with two; `reach` where it is more [m]."""
        self.checks += 1
        standing, both = self._checker.nearest_by_kind(q, reach)
        for pair, distance in (standing, both):
            if pair >= 0 and distance < self.best:
                self.best, self.pair, self.q = distance, pair, q.copy()
        return standing[1], both[1]


_End = tuple[float, tuple[float, float]]


def _bound(left: _End, right: _End, whole: float) -> float:
    """Nothing between two ends of an interval is nearer than this [m]; `whole` is the travel of the whole move."""
    way = whole * (right[0] - left[0])
    standing = (left[1][0] + right[1][0] - way) / 2
    both = (left[1][1] + right[1][1] - 2 * way) / 2
    return min(standing, both)


def time_of_tightest(
    motion_t: Floats, motion_q: Floats, segment_of_sample: NDArray[np.integer], tightest: TightestMoment
) -> float:
    """The time of a timed motion at which it comes nearest to a tightest configuration, in its segment [s]."""
    of = np.flatnonzero(segment_of_sample == tightest.segment)
    a = motion_q[of[:-1]]
    step = motion_q[of[1:]] - a
    squared = np.maximum((step * step).sum(axis=1), 1e-30)
    share = np.clip(((tightest.q - a) * step).sum(axis=1) / squared, 0.0, 1.0)
    k = int(np.argmin(np.linalg.norm(a + share[:, None] * step - tightest.q, axis=1)))
    return float(motion_t[of[k]] + share[k] * (motion_t[of[k + 1]] - motion_t[of[k]]))
