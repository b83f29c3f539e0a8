"""From a choice of columns to the answer: order, areas, cost and bounds as the caller gave them, status."""

from dataclasses import replace

import numpy as np

from planner.cover.answer import Cover, CoverStatus
from planner.cover.budget import Budget
from planner.cover.canonical import Canonical
from planner.cover.greedy import by_marginal_area
from planner.cover.problem import CoverProblem
from planner.values import Ints

PRICE_ROUNDING = 1e-4
"""Costs that are not whole numbers are rounded: "proven cheapest" means that none saves more than this share."""

FLOAT_ERROR = 1e-12
"""Share that is taken off a bound on costs that are not whole numbers: above the float error of their sums."""


def told(
    found: Canonical, columns: Ints, bound: int, *, solver: str, work: Budget, problem: CoverProblem, fewest: int = 0,
    n_views_without_overlap: int | None = None,
) -> Cover:  # fmt: skip
    """The answer.

    Args:
        found: the problem.
        columns: chosen columns of `found.whole`, the useful ones of the pinned among them.
        bound: no choice has a smaller objective, what the pinned columns cost included.
        solver: its name.
        work: what was spent.
        problem: as the caller told it.
        fewest: with a number of views allowed: no fewer views, pinned ones included, cover as much.
        n_views_without_overlap: with an overlap: views of the cover that need not hang together.
    """
    whole = found.whole
    order, added = by_marginal_area(whole, columns)
    if whole.most >= 0:  # a view that adds nothing to those before it is of no use
        kept = [k for k, rows in enumerate(added) if len(rows) or order[k] in found.fixed]
        order, added = order[kept], [added[k] for k in kept]
    idle = found.idle  # pinned views that measure nothing stay in the plan, last
    views = np.concatenate((found.columns[order], idle))
    areas = found.areas[found.rows]
    covered = whole.covered(order)
    covered_area, coverable = float(areas[covered].sum()), float(areas.sum())
    upper = coverable
    price = None if problem.costs is None and problem.group is None else _price(found, views, bound, problem)
    if whole.most >= 0:
        objective = int(whole.units[~covered].sum())
        proven = objective - whole.tolerance <= bound
        upper = covered_area if proven else max(coverable * (1 - bound / max(whole.total, 1)), covered_area)
        least = max(fewest, len(found.pinned) if not len(whole.fixed) else 0)
    else:
        if not whole.met(order):
            raise AssertionError(f"the solver {solver!r} returned a selection that misses its target")
        proven = bound >= whole.cost(order) and (price is None or price[0] - price[1] <= PRICE_ROUNDING * price[0])
        # with costs: a cover of so many units has at least as many columns as the dearest ones need for them
        dearest = int(whole.costs.max(initial=1)) + int(whole.group_costs.max(initial=0))
        least = len(idle) + (bound if price is None else -(-bound // dearest))
    if not whole.n_rows:
        status = CoverStatus.NOTHING_COVERABLE
    elif proven:
        status = CoverStatus.PROVEN
    elif work.interrupted:
        status = CoverStatus.INTERRUPTED
    else:
        status = CoverStatus.TIME_LIMITED if work.time_limited else CoverStatus.BOUNDED
    return Cover(
        views=views,
        marginal_area=np.array([float(areas[rows].sum()) for rows in added] + [0.0] * len(idle)),
        covered_area=covered_area,
        coverable_area=coverable,
        total_area=float(found.areas.sum()),
        uncoverable_rows=found.uncoverable_rows,
        pinned=found.pinned,
        status=status,
        lower_bound=min(least, len(views)),
        upper_area=upper,
        solver=solver,
        effort=work.spent,
        demand=int(np.min(problem.demand, initial=2**30)),
        unsatisfiable_rows=found.unsatisfiable_rows,
        cost_and_bound=price,
        max_views=problem.max_views,
        n_views_without_overlap=n_views_without_overlap,
    )


def retold(found: Canonical, cover: Cover, views: Ints, problem: CoverProblem) -> Cover:
    """Views told in the areas of another problem, with status, bound, price and work of the cover that they are of."""
    columns = np.flatnonzero(np.isin(found.columns, views))
    other = told(found, columns, 0, solver=cover.solver, work=Budget(0), problem=problem)
    return replace(
        other,
        status=cover.status,
        lower_bound=cover.lower_bound,
        cost_and_bound=cover.cost_and_bound,
        effort=cover.effort,
    )


def _price(found: Canonical, views: Ints, bound: int, problem: CoverProblem) -> tuple[float, float]:
    """What the views cost as the costs were given, and what no selection undercuts.

    The bound is on rounded costs: what rounding may have added to them is taken off, by the column on which it added
    the largest share, or by what it added to all columns together, whichever takes off less.
    """
    whole, unit = found.whole, found.cost_unit
    n_columns = np.shape(problem.matrix)[1]
    costs = np.ones(n_columns) if problem.costs is None else np.asarray(problem.costs, dtype=np.float64)
    group = np.zeros(n_columns, dtype=np.int64) if problem.group is None else np.asarray(problem.group, dtype=np.int64)
    opening = np.zeros(1) if problem.group_costs is None else np.asarray(problem.group_costs, dtype=np.float64)

    def price_of(some: Ints) -> float:
        return float(costs[some].sum()) + float(opening[np.unique(group[some])].sum())

    given, least = costs[found.columns], bound * unit
    if not (np.array_equal(given, whole.costs * unit) and np.array_equal(opening, np.rint(opening / unit) * unit)):
        rounded = np.maximum(np.rint(opening / unit), 1.0)
        added = float(np.maximum(whole.costs - given / unit, 0.0).sum())
        added += float(np.maximum(rounded - opening / unit, 0.0)[opening > 0].sum())
        shares = np.concatenate((given / whole.costs, (opening / rounded)[opening > 0]))
        least = max(bound * float(shares.min(initial=unit)), (bound - added) * unit) * (1 - FLOAT_ERROR)
    return price_of(views), min(least + price_of(found.idle), price_of(views))
