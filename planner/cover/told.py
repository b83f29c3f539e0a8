"""The answer to a request that `planner.cover.solve` does not serve: any choice of columns told as a `Cover`."""

import numpy as np

from planner.cover.budget import Budget
from planner.cover.greedy import by_marginal_area
from planner.cover.canonical import Candidates
from planner.cover.selection import Cover, CoverStatus
from planner.values import Ints


def told(
    found: Candidates, fixed: Ints, columns: Ints, lower_bound: int, *, solver: str, work: Budget, idle_too: bool = True
) -> Cover:
    """A `Cover` of chosen columns: ordered by the area that each adds, with areas, bound and status.

    Args:
        found: the canonical problem (covered once) and what it was made from.
        fixed: pinned columns of the matrix.
        columns: chosen columns of the problem, the useful ones of the pinned among them.
        lower_bound: no choice that meets the request has fewer.
        solver: what the report calls it.
        work: what was spent.
        idle_too: keep columns that add no area to those before them (they may serve another end).
    """
    problem = found.problem
    order, added = by_marginal_area(problem, columns)
    if not idle_too:
        kept = [k for k, rows in enumerate(added) if len(rows) or found.columns[order[k]] in fixed]
        order, added = order[kept], [added[k] for k in kept]
    idle = np.setdiff1d(fixed, found.columns)  # pinned views that measure nothing stay in the plan, last
    views = np.concatenate((found.columns[order], idle))
    areas = found.areas[found.rows]
    if not problem.n_rows:
        status = CoverStatus.NOTHING_COVERABLE
    elif lower_bound >= len(views):
        status = CoverStatus.PROVEN
    elif work.interrupted:
        status = CoverStatus.INTERRUPTED
    else:
        status = CoverStatus.TIME_LIMITED if work.time_limited else CoverStatus.BOUNDED
    return Cover(
        views=views,
        marginal_area=np.array([float(areas[rows].sum()) for rows in added] + [0.0] * len(idle)),
        covered_area=float(areas[problem.counts(columns) > 0].sum()),
        coverable_area=float(areas.sum()),
        total_area=float(found.areas.sum()),
        uncoverable_rows=found.uncoverable_rows,
        pinned=fixed,
        status=status,
        lower_bound=min(lower_bound, len(views)),
        solver=solver,
        work=work.spent,
    )
