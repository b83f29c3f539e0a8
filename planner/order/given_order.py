"""Visiting orders that are given: only joint solutions are chosen, and the places of views that the order leaves out.

Each view that is left out goes, one after the other, where the tour becomes the fastest with its best joint solutions.
"""

from collections.abc import Sequence as Numbers
from typing import Any

import numpy as np

from planner.order import generalised_tsp as gtsp
from planner.order import orderings as orders
from planner.order.moves import Moves
from planner.order.orderings import Ordering, OrderStatus, Sequence


def in_order(given: Numbers[int]) -> Ordering:
    """An ordering that keeps a given order; without effect where views of it are missing.

    Where a bound is asked for, baseline and bound are those of the free order.

    Args:
        given: views in visiting order, each at most once.
    """

    def ordering(moves: Moves, *arguments: Any, **options: Any) -> Sequence:
        problem = moves.instance()
        n = problem.n_clusters - 1
        if n <= max(given, default=-1):
            return orders.sequence(moves, *arguments, **options)  # the caller says what is missing
        order = np.array(given, dtype=np.int64)
        for view in sorted(set(range(n)) - set(given)):
            trials = [np.insert(order, place, view) for place in range(len(order) + 1)]
            order = min(trials, key=lambda trial: gtsp.best_nodes(problem, trial + 1)[0])
        cost, tour = gtsp.best_nodes(problem, order + 1)
        free = orders.sequence(moves, *arguments, **options) if options.get("bound_work") is not None else None
        drivable = cost < gtsp.BLOCKED
        return Sequence(
            order=order,
            choice=tour[1:] - problem.first[order + 1],
            q=moves.q[tour[1:]],
            duration=cost if drivable else float("inf"),
            baseline_duration=float("inf") if free is None else free.baseline_duration,
            lower_bound=0.0 if free is None else free.lower_bound,
            status=OrderStatus.HEURISTIC if drivable else OrderStatus.NO_TOUR,
        )

    return ordering
