"""Time that a view costs in a tour: a lower bound for any tour, and the time in a given tour.

The time of a tour through home and the views C is half the sum, over its stops, of the two moves at each. So no tour is
shorter than `least_home_time` plus, for every view, half of the two shortest moves from any of its configurations to
two other candidates or home (`least_move_times`). As costs of columns, these turn a bound on the cheapest cover into
one on the sum of dwell and motion times.
"""

from collections.abc import Iterable
from itertools import pairwise

import numpy as np

from planner.ports import JointLimits
from planner.timing.move_time import move_time
from planner.values import Floats, Ints

_TIMED = 24  # nearest configurations whose moves are timed; for the others a bound applies


def least_move_times(q: Floats, offsets: Ints, home: Floats, limits: JointLimits) -> Floats:
    """Return (V,) half of the two shortest moves at each candidate in any tour from home and back [s].

    Args:
        q: (N, axes) configurations [rad], candidate by candidate.
        offsets: (V + 1,) candidate v owns the rows offsets[v] to offsets[v + 1]; 0 s for a candidate without rows.
        home: (axes,) joint angles [rad]; both moves may lead there, as in a tour of one view.
        limits: of the axes.
    """
    from scipy.spatial import KDTree  # half of the start-up time of a plan

    least = np.zeros(len(offsets) - 1)
    if not len(q):
        return least
    owner = np.repeat(np.arange(len(least)), np.diff(offsets))
    scaled = q / limits.velocity
    others = min(_TIMED + int(np.diff(offsets).max()), len(q))
    near, at = map(np.asarray, KDTree(scaled).query(scaled, np.arange(1, others + 1), p=np.inf))
    bound = _time_bound(near[:, -1], limits) if others < len(q) else np.full(len(q), np.inf)
    times = np.where(owner[at] == owner[:, None], np.inf, move_time(q[:, None], q[at], limits))
    first = times.argmin(axis=1)
    one = times.min(axis=1)
    times[owner[at] == owner[at[np.arange(len(q)), first]][:, None]] = np.inf  # two moves lead to two candidates
    to_home = move_time(home, q, limits)
    moves = np.stack([one, times.min(axis=1), bound, bound, to_home, to_home], axis=1)
    two = np.sort(moves, axis=1)[:, :2].sum(axis=1)
    rows = np.flatnonzero(np.diff(offsets))
    least[rows] = 0.5 * np.minimum.reduceat(two, offsets[rows])
    return least


def least_home_time(q: Floats, home: Floats, limits: JointLimits) -> float:
    """Return half of the two shortest moves at home in any tour over one or more of (N, axes) configurations [s].

    Both may lead to the same configuration, so it is the shortest move.
    """
    return float(move_time(home, q, limits).min()) if len(q) else 0.0


def insertion_times(stops: Floats, views: Iterable[int], q: Floats, offsets: Ints, limits: JointLimits) -> Floats:
    """Return (V,) the time that each candidate adds to a tour [s]; for a view of the tour, the time without it less.

    Args:
        stops: (n + 2, axes) joint angles of the tour, home at both ends [rad].
        views: n candidates in visiting order.
        q: (N, axes) configurations [rad], candidate by candidate.
        offsets: (V + 1,) as in `least_move_times`; inf for a candidate without configurations.
        limits: of the axes.
    """
    more = np.full(len(q), np.inf)
    to = move_time(stops[0], q, limits)
    for before, after in pairwise(stops):
        onward = move_time(after, q, limits)
        np.minimum(more, to + onward - move_time(before, after, limits), out=more)
        to = onward
    added = np.full(len(offsets) - 1, np.inf)
    rows = np.flatnonzero(np.diff(offsets))
    added[rows] = np.maximum(np.minimum.reduceat(more, offsets[rows]), 0.0)
    around = move_time(stops[:-2], stops[2:], limits)
    there = move_time(stops[:-1], stops[1:], limits)
    added[np.fromiter(views, dtype=np.int64)] = np.maximum(there[:-1] + there[1:] - around, 0.0)
    return added


def _time_bound(scaled: Floats, limits: JointLimits) -> Floats:
    """Return a lower bound on the time of a move from its largest angle over velocity [s], without jerk limits."""
    ramp = float((limits.velocity / limits.acceleration).min())
    return np.where(scaled >= ramp, scaled + ramp, 2.0 * np.sqrt(scaled * ramp))
