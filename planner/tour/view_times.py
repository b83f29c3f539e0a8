"""What a view takes of a tour: seconds that it takes in any tour, and seconds that it takes in a given one.

A tour through home and the views C takes half the sum, over its stops, of the two moves at each. So no tour is shorter
than `home_share` and, for every view, half of the two shortest moves that any of its joint solutions has to two other
candidates or home (`least_moves`): as costs of columns, these turn a bound on the cheapest cover into one on standing
and moving together.
"""

from collections.abc import Iterable
from itertools import pairwise

import numpy as np

from planner.ports import JointLimits
from planner.timing.move_time import move_time
from planner.values import Floats, Ints

_LOOKED_AT = 24  # nearest joint solutions whose moves are timed; of those beyond, a bound is taken


def least_move_times(q: Floats, offsets: Ints, home: Floats, limits: JointLimits) -> Floats:
    """(V,) half of the two shortest moves at each candidate in any tour from home and back [s].

    Args:
        q: (N, axes) joint solutions [rad], candidate by candidate.
        offsets: (V + 1,) candidate v owns the rows offsets[v] to offsets[v + 1]; it gets 0 where it has none.
        home: (axes,) joint angles [rad]; both moves may lead there, as in a tour of one view.
        limits: of the axes.
    """
    from scipy.spatial import KDTree  # half of what the start-up of a plan would take

    least = np.zeros(len(offsets) - 1)
    if not len(q):
        return least
    owner = np.repeat(np.arange(len(least)), np.diff(offsets))
    scaled = q / limits.velocity
    others = min(_LOOKED_AT + int(np.diff(offsets).max()), len(q))
    near, at = map(np.asarray, KDTree(scaled).query(scaled, np.arange(1, others + 1), p=np.inf))
    beyond = _at_least(near[:, -1], limits) if others < len(q) else np.full(len(q), np.inf)
    times = np.where(owner[at] == owner[:, None], np.inf, move_time(q[:, None], q[at], limits))
    first = times.argmin(axis=1)
    one = times.min(axis=1)
    times[owner[at] == owner[at[np.arange(len(q)), first]][:, None]] = np.inf  # two moves lead to two candidates
    to_home = move_time(home, q, limits)
    moves = np.stack([one, times.min(axis=1), beyond, beyond, to_home, to_home], axis=1)
    two = np.sort(moves, axis=1)[:, :2].sum(axis=1)
    rows = np.flatnonzero(np.diff(offsets))
    least[rows] = 0.5 * np.minimum.reduceat(two, offsets[rows])
    return least


def least_home_time(q: Floats, home: Floats, limits: JointLimits) -> float:
    """Half of the two shortest moves at home in any tour over one or more of (N, axes) joint solutions [s].

    Both may lead to the same one, so it is the shortest move.
    """
    return float(move_time(home, q, limits).min()) if len(q) else 0.0


def insertion_times(stops: Floats, views: Iterable[int], q: Floats, offsets: Ints, limits: JointLimits) -> Floats:
    """(V,) how much longer a tour is for each candidate [s]: it would be added to it, or is left out.

    Args:
        stops: (n + 2, axes) joint angles of the tour, home at both ends [rad].
        views: n candidates in visiting order.
        q: (N, axes) joint solutions [rad], candidate by candidate.
        offsets: (V + 1,) as in `least_moves`; a candidate without joint solutions gets inf.
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


def _at_least(scaled: Floats, limits: JointLimits) -> Floats:
    """Time that a move takes at least when the largest of its angles over velocities is this [s]; without jerk."""
    ramp = float((limits.velocity / limits.acceleration).min())
    return np.where(scaled >= ramp, scaled + ramp, 2.0 * np.sqrt(scaled * ramp))
