"""The most area with at most k views: maximal covering (Church, ReVelle 1974, doi:10.1007/BF01942293), with its gap.

Greedy and tabu search over swaps give the views (`planner.cover.area_search`), a Lagrangian dual says how much more
any k views could cover (`planner.cover.area_bound`), and where work is left HiGHS tries to close the gap on the columns
that the dual does not rule out. The answer is a `Cover` like that of `planner.cover.solve`; its lower bound is on the
number of views that cover as much.
"""

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from planner.cover.told import told
from planner.cover.area_bound import AreaBounds, area_bounds
from planner.cover.area_search import search_most
from planner.cover.budget import Budget
from planner.cover.interrupts import ends_search, interruptible
from planner.cover.prepared import Prepared, prepare
from planner.cover.canonical import CoverProblem
from planner.cover.selection import Cover
from planner.errors import PlannerError
from planner.values import Ints

SEARCH_SHARE, BOUND_SHARE = 0.3, 0.5
"""Of the budget: for the search, and of what is left then for the bound; the rest is for HiGHS."""

SAME = 1e-6
"""HiGHS is asked for this share of the coverable area more (0.0001 points): its tolerance cannot do with less."""

MOST_WORK = 1_500_000_000
"""Default budget: two to three seconds."""

NODE_WORK, ROOT_NODES = 1000, 100
"""Charge of a node of HiGHS for each one of the matrix; the root with its cuts and heuristics counts as many."""


class MostStatus(Enum):
    """How a selection of the most area ended; the value is the sentence for reports."""

    EVERYTHING = "these views measure everything that the candidates can"
    PROVEN = "proven most that so many of these candidates measure of these samples"
    BOUNDED = "within known points of coverage of the most that so many of these candidates measure"
    TIME_LIMITED = "the time limit stopped the search; within known points of coverage of the most"
    INTERRUPTED = "interrupted; within known points of coverage of the most"
    NOTHING_COVERABLE = "no allowed view measures any sample"


@dataclass(frozen=True, slots=True, eq=False)
class MostCoverage:
    """At most k views with the most area, and what is proven about them.

    Attributes:
        cover: the views; `cover.lower_bound` is the fewest views that could cover as much.
        max_views: k.
        upper_area: no k views (with the pinned ones) cover more [m^2].
        status: how the selection ended.
    """

    cover: Cover
    max_views: int
    upper_area: float
    status: MostStatus

    @property
    def gap_points(self) -> float:
        """Points of coverage (percent of the coverable area) that k other views could add at most."""
        coverable = self.cover.coverable_area
        return 100.0 * max(self.upper_area - self.cover.covered_area, 0.0) / coverable if coverable > 0 else 0.0

    @property
    def sentence(self) -> str:
        """The status in words with its numbers."""
        if self.status not in _OPEN:
            return str(self.status.value)
        views = "1 view" if self.max_views == 1 else f"{self.max_views} views"
        within = f"at most {max(self.gap_points, 0.01):.2f} points of coverage below the most that {views} can measure"
        return _OPEN[self.status] + within


_OPEN = {
    MostStatus.BOUNDED: "",
    MostStatus.TIME_LIMITED: "the time limit stopped the search; ",
    MostStatus.INTERRUPTED: "the search was interrupted; ",
}


def most_coverage(
    M: Any,
    areas: ArrayLike,
    allowed: ArrayLike | None = None,
    *,
    rng: np.random.Generator,
    max_views: int,
    pinned: Iterable[int] = (),
    banned: Iterable[int] = (),
    budget: int = MOST_WORK,
    time_limit_s: float | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> MostCoverage:
    """Choose at most k columns that cover the most area.

    Args:
        M: (S, V) measurability matrix, scipy sparse or dense.
        areas: (S,) area of each row [m^2].
        allowed: (V,) bool, which columns may be used; None: all.
        rng: random choices of the search.
        max_views: k, 0 or more; pinned columns count.
        pinned: columns that must be part of the selection.
        banned: columns that must not.
        budget: units of work for search, bound and HiGHS together.
        time_limit_s: wall-clock guard [s]; reported in the status when it fires.
        clock: seconds, for the guard.

    Raises:
        PlannerError: for input that `prepare` refuses, or fewer views than are pinned.
    """
    ready = prepare(M, areas, allowed, pinned, banned)
    if max_views < len(ready.fixed) or max_views < 0:
        raise PlannerError(
            f"max_views is {max_views}; it must be 0 or more"
            + (f", and {len(ready.fixed)} views are pinned" if len(ready.fixed) else "")
        )
    work = Budget(budget, time_limit_s, clock)
    problem = ready.problem
    size = min(max_views - len(ready.fixed), problem.n_columns)
    if problem.n_columns == 0 or size == 0:
        columns, upper, fewest = ready.useful_fixed, ready.base, 0
    else:
        with work.portion(SEARCH_SHARE):
            best, area = search_most(problem, size, rng, work)
        covered = np.zeros(size + 1, dtype=np.int64)
        covered[-1] = area
        with work.portion(BOUND_SHARE):
            bounds = area_bounds(problem, covered, work, sizes=(size,))
        chosen, inner = close_gap(problem, best, area, size, bounds, work)
        columns, upper = ready.canonical(chosen), ready.base + inner
        fewest = int(np.flatnonzero(np.append(bounds.units[:-1], np.inf) >= ready.units(chosen))[0])
    return _result(ready, columns, upper, len(ready.fixed) + fewest, max_views, work)


def close_gap(
    problem: CoverProblem, chosen: Ints, area: int, size: int, bounds: AreaBounds, budget: Budget
) -> tuple[Ints, int]:
    """HiGHS on the columns that the dual leaves open, asked only for more area than is known.

    Returns:
        The best columns and an upper bound [units].
    """
    import scipy.sparse as sp
    from scipy.optimize import Bounds, LinearConstraint, milp

    upper = int(bounds.units[size])
    total = int(problem.units.sum())
    if upper - area <= SAME * total or size >= problem.n_columns:
        return chosen, max(upper if size < problem.n_columns else area, area)
    order = np.argsort(-bounds.column_value, kind="stable")
    inside, outside = order[:size], order[size:]
    worst, next_best = bounds.column_value[inside[-1]], bounds.column_value[outside[0]]
    better = area + 0.5 * SAME * total
    keep = np.ones(problem.n_columns, dtype=bool)
    keep[outside[upper - worst + bounds.column_value[outside] < better]] = False
    must = inside[upper - bounds.column_value[inside] + next_best < better]
    open_rows = problem.counts(must) == 0
    keep[must] = False
    free = np.flatnonzero(keep)
    M = problem.matrix()[open_rows][:, free]
    nodes = budget.left // max(NODE_WORK * max(M.nnz, 1), 1) - ROOT_NODES + 1
    if nodes <= 0 or not len(free):
        return chosen, upper
    n_rows, n_columns = M.shape
    weights = problem.units[open_rows] / total
    gained = float(problem.units[~open_rows].sum()) / total
    costs = np.concatenate((np.zeros(n_columns), -weights))
    constraints = [
        LinearConstraint(sp.hstack((M, -sp.eye_array(n_rows))).tocsr(), lb=0.0),
        LinearConstraint(np.repeat((1.0, 0.0), (n_columns, n_rows))[None, :], ub=float(size - len(must))),
        LinearConstraint(-costs[None, :], lb=area / total - gained + SAME),
    ]
    options: Any = {"node_limit": int(min(nodes, 2**31 - 1)), "mip_rel_gap": 0.0}
    if budget.seconds_left is not None:
        options["time_limit"] = budget.seconds_left
    integrality = np.repeat((1, 0), (n_columns, n_rows))
    with ends_search(budget):
        result = interruptible(
            lambda: milp(costs, integrality=integrality, bounds=Bounds(0, 1), constraints=constraints, options=options)
        )
    if budget.interrupted:
        return chosen, upper
    budget.spend(NODE_WORK * M.nnz * (ROOT_NODES + int(getattr(result, "mip_node_count", None) or 0)))
    if result.status == 2:  # nothing better by more than what counts as equal
        return chosen, min(upper, area + int(2 * SAME * total))
    dual = getattr(result, "mip_dual_bound", None)
    if dual is not None and np.isfinite(dual):
        upper = min(upper, max(int((gained - dual + SAME) * total), area + int(2 * SAME * total)))
    if result.x is not None:
        found = np.concatenate((must, free[result.x[:n_columns] > 0.5]))
        units = int(problem.units[problem.counts(found) > 0].sum())
        if units > area and len(found) <= size:
            return found, max(upper, units)
    return chosen, upper


def _result(ready: Prepared, columns: Ints, upper: int, fewest: int, max_views: int, work: Budget) -> MostCoverage:
    """Areas and status."""
    problem = ready.found.problem
    total = int(problem.units.sum())
    covered = problem.counts(columns) > 0
    units = int(problem.units[covered].sum())
    if not problem.n_rows:
        status = MostStatus.NOTHING_COVERABLE
    elif covered.all():
        status = MostStatus.EVERYTHING
    elif upper - units <= 3 * SAME * total:  # what HiGHS was asked for, the slack of its bound, and rounding
        status = MostStatus.PROVEN
    elif work.interrupted:
        status = MostStatus.INTERRUPTED
    else:
        status = MostStatus.TIME_LIMITED if work.time_limited else MostStatus.BOUNDED
    fewest = max(fewest, ready.fewest_for(units))
    cover = told(ready.found, ready.fixed, columns, fewest, solver="most-coverage", work=work, idle_too=False)
    proven = status not in _OPEN
    upper_area = cover.covered_area if proven else cover.coverable_area * min(upper / total, 1.0)
    return MostCoverage(cover, max_views, upper_area, status)
