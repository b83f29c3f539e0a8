"""Visiting orders in which each view overlaps an earlier one, so that scans can be registered as they come in.

The fastest order without this wish is taken first. Where it breaks the wish, orders that keep it are grown: from every
first view, always the view that overlaps an earlier one and comes next in the fastest order; the best of them is then
improved by moving single views to places that keep the wish. Every order is judged with its best joint solutions. This
is a heuristic: the lower bound is that of orders without the wish.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from planner.order import generalised_tsp as gtsp
from planner.order import orderings as orders
from planner.order.moves import Moves
from planner.order.orderings import Ordering, OrderStatus, Sequence
from planner.values import Bools, Ints

Joined = Bools
"""(n, n) which views overlap."""

_STEPS_PER_TRIAL = 30
"""Steps of the free search's budget that one trial of an order costs: judging an order takes about as long."""


def keeps(joined: Joined, order: Ints) -> bool:
    """Whether each view of an order but the first overlaps an earlier one."""
    return all(joined[order[k], order[:k]].any() for k in range(1, len(order)))


def grown(joined: Joined, wanted: Ints, first: int) -> Ints | None:
    """The order from a first view on that keeps the wish and follows another order where it may; None without any.

    Args:
        joined: which views overlap.
        wanted: (n,) the order that is followed, cyclically from the first view on.
        first: view to begin with.
    """
    waiting = np.roll(wanted, -int(np.flatnonzero(wanted == first)[0])).tolist()
    order = [waiting.pop(0)]
    while waiting:
        following = next((view for view in waiting if joined[view, order].any()), None)
        if following is None:
            return None
        waiting.remove(following)
        order.append(following)
    return np.array(order, dtype=np.int64)


def overlapping(joined: Joined) -> Ordering:
    """An ordering of views that overlap; without effect where some of them are missing.

    Args:
        joined: (n, n) which views overlap, in the order in which they are numbered.
    """

    def ordering(moves: Moves, *arguments: Any, **options: Any) -> Sequence:
        free = orders.sequence(moves, *arguments, **options)
        if len(free.order) != len(joined) or keeps(joined, free.order):
            return free
        problem = moves.instance()
        both = (free.order, free.order[::-1])
        starts = [grown(joined, wanted, first) for wanted in both for first in range(len(joined))]
        kept = [order for order in starts if order is not None]
        if not kept:
            return free  # the graph does not hold together; the caller says so
        (cost, tour), best = min(
            ((gtsp.best_nodes(problem, order + 1), order) for order in kept), key=lambda j: j[0][0]
        )
        trials = options.get("budget", gtsp.STEPS) // _STEPS_PER_TRIAL
        for view in range(len(joined)):
            rest = best[best != view]
            for place in range(len(best)):
                trial = np.insert(rest, place, view)
                if trials <= 0 or not keeps(joined, trial):
                    continue
                trials -= 1
                found = gtsp.best_nodes(problem, trial + 1)
                if found[0] < cost * (1 - 1e-12):
                    (cost, tour), best = found, trial
        clusters = problem.clusters_of(tour)[1:]
        choice = tour[1:] - problem.first[clusters]
        return replace(
            free,
            order=clusters - 1,
            choice=choice,
            q=moves.q[tour[1:]],
            duration=cost if cost < gtsp.BLOCKED else float("inf"),
            status=OrderStatus.HEURISTIC if cost < gtsp.BLOCKED else OrderStatus.NO_TOUR,
        )

    return ordering
