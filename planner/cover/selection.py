"""Select the views: check, reduce, search, bound, and say how far the plan is from the fewest possible."""

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from planner.cover.bound import bound
from planner.cover.budget import DEFAULT_WORK, Budget
from planner.cover.greedy import by_marginal_area, greedy
from planner.cover.problem import Candidates, Floats, Ints, candidates, column_indices
from planner.cover.reductions import reduce, take
from planner.cover.solvers import BOUND_SHARE, SOLVERS
from planner.errors import PlannerError
from planner.readonly import readonly


class CoverStatus(Enum):
    """How a selection ended; the value is the sentence for reports."""

    PROVEN = "proven fewest for these candidates and samples"
    BOUNDED = "within a known number of views of the fewest for these candidates and samples"
    TIME_LIMITED = "the time limit stopped the search; within a known number of views of the fewest"
    NOTHING_COVERABLE = "no allowed view measures any sample"

    @property
    def sentence(self) -> str:
        """The status in words, without numbers; `Cover.sentence` has them."""
        return str(self.value)


@dataclass(frozen=True, slots=True, eq=False)
class Cover:
    """A selection of views and what is proven about it.

    Attributes:
        views: (n,) chosen columns of the matrix, the one that adds the largest area first.
        marginal_area: (n,) area that each view adds to those before it [m^2].
        covered_area: area of the rows that the views cover [m^2].
        coverable_area: area of the rows that some usable column covers [m^2].
        total_area: area of all rows [m^2].
        uncoverable_rows: rows that no usable column covers.
        pinned: views that the user fixed, ascending; they count in `views` and in `lower_bound`.
        status: how the selection ended.
        lower_bound: no selection that meets the target (and contains the pinned views) has fewer views.
        solver: name of the solver.
        work: units of work spent (see `planner.cover.budget`).
    """

    views: Ints
    marginal_area: Floats
    covered_area: float
    coverable_area: float
    total_area: float
    uncoverable_rows: Ints
    pinned: Ints
    status: CoverStatus
    lower_bound: int
    solver: str
    work: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "views", readonly("views", self.views, (None,), np.int64))
        object.__setattr__(self, "marginal_area", readonly("marginal_area", self.marginal_area, (len(self.views),)))
        for name in ("uncoverable_rows", "pinned"):
            object.__setattr__(self, name, readonly(name, getattr(self, name), (None,), np.int64))

    @property
    def excess(self) -> int:
        """The plan has at most this many views more than the fewest."""
        return len(self.views) - self.lower_bound

    @property
    def gap(self) -> float:
        """(views - lower bound) / views; 0 for an empty plan."""
        return self.excess / len(self.views) if len(self.views) else 0.0

    @property
    def curve(self) -> Floats:
        """(n,) area covered by the first 1, 2, ... n views [m^2]."""
        return np.cumsum(self.marginal_area)

    @property
    def uncoverable_area(self) -> float:
        """Area of the rows that no usable column covers [m^2]."""
        return max(self.total_area - self.coverable_area, 0.0)

    @property
    def sentence(self) -> str:
        """The status in words with its numbers."""
        if self.status in (CoverStatus.PROVEN, CoverStatus.NOTHING_COVERABLE):
            return self.status.sentence
        views = "view" if self.excess == 1 else "views"
        within = f"at most {self.excess} {views} more than the fewest for these candidates and samples"
        return f"the time limit stopped the search; {within}" if self.status is CoverStatus.TIME_LIMITED else within


def solve(
    M: Any,
    areas: ArrayLike,
    allowed: ArrayLike | None = None,
    *,
    rng: np.random.Generator,
    coverage: float = 1.0,
    solver: str = "auto",
    budget: int = DEFAULT_WORK,
    time_limit_s: float | None = None,
    pinned: Iterable[int] = (),
    banned: Iterable[int] = (),
    clock: Callable[[], float] = time.perf_counter,
) -> Cover:
    """Choose the fewest columns that cover the required share of what the usable columns can cover.

    The greedy cover and a lower bound are always computed, whatever the solver and the budget.

    Args:
        M: (S, V) measurability matrix, scipy sparse or dense, True where the viewpoint measures the sample.
        areas: (S,) area of each row [m^2].
        allowed: (V,) bool, which columns may be used (the reachable ones); None: all.
        rng: random choices of the solver.
        coverage: share of the coverable area to be covered, 0 to 1; 1 means every coverable row.
        solver: a name in `SOLVERS`.
        budget: units of work for search and bound together; 0 gives the greedy cover and the quickest bound.
        time_limit_s: wall-clock guard [s] for the search; reported in the status when it fires.
        pinned: columns that must be part of the selection; they must be allowed.
        banned: columns that must not.
        clock: seconds, for the guard.

    Raises:
        PlannerError: for input that `candidates` refuses, an unknown solver, or a pinned column that is banned or not
            allowed.
    """
    if solver not in SOLVERS:
        raise PlannerError(f"there is no solver {solver!r}; choose one of {', '.join(SOLVERS)}")
    search = Budget(budget, time_limit_s, clock)
    found = candidates(M, areas, allowed, coverage=coverage, banned=banned)
    fixed, useful_fixed = _pinned(found, M.shape[1], allowed, pinned, banned)

    rest, rest_columns = take(found.problem, useful_fixed)
    reduction = reduce(rest)
    problem = reduction.problem
    if problem.trivial:
        chosen = np.zeros(0, dtype=np.int64)
        search.offer(chosen)
    else:
        chosen = greedy(problem, rng, search)
        with search.portion(BOUND_SHARE):
            search.dual = bound(problem, len(chosen), search)
        chosen = SOLVERS[solver](problem, rng, search)
        if search.best is not None and len(search.best) < len(chosen):
            chosen = search.best
    free = rest_columns[reduction.lift(chosen)]
    lower_bound = len(fixed) + len(reduction.forced) + min(search.lower_bound, len(chosen))
    return _cover(found, fixed, np.concatenate((useful_fixed, free)), lower_bound, solver, search)


def _pinned(
    found: Candidates, n_columns: int, allowed: ArrayLike | None, pinned: Iterable[int], banned: Iterable[int]
) -> tuple[Ints, Ints]:
    """The pinned columns of the matrix, and those of them that cover something as columns of the problem."""
    fixed = column_indices("pinned", pinned, n_columns)
    usable = np.ones(n_columns, dtype=bool) if allowed is None else np.array(allowed)
    usable[column_indices("banned", banned, n_columns)] = False
    refused = fixed[~usable[fixed]]
    if len(refused):
        raise PlannerError(f"pinned names column {refused[0]}, which is banned or not among the allowed columns")
    return fixed, np.flatnonzero(np.isin(found.columns, fixed))


def _cover(found: Candidates, fixed: Ints, columns: Ints, lower_bound: int, solver: str, search: Budget) -> Cover:
    """Assemble the result: order by marginal area, exact check of the target, areas, status."""
    problem = found.problem
    order, added = by_marginal_area(problem, columns)
    covered = np.zeros(problem.n_rows, dtype=bool)
    for rows in added:
        covered[rows] = True
    if not problem.met(covered):
        raise AssertionError(f"the solver {solver!r} returned a selection that misses its target")
    idle = np.setdiff1d(fixed, found.columns)  # pinned views that measure nothing stay in the plan, last
    views = np.concatenate((found.columns[order], idle))
    areas = found.areas[found.rows]
    marginal = [float(areas[rows].sum()) for rows in added] + [0.0] * len(idle)
    if not problem.n_rows:
        status = CoverStatus.NOTHING_COVERABLE
    elif lower_bound == len(views):
        status = CoverStatus.PROVEN
    else:
        status = CoverStatus.TIME_LIMITED if search.time_limited else CoverStatus.BOUNDED
    return Cover(
        views=views,
        marginal_area=np.array(marginal),
        covered_area=float(areas[covered].sum()),
        coverable_area=float(areas.sum()),
        total_area=float(found.areas.sum()),
        uncoverable_rows=found.uncoverable_rows,
        pinned=fixed,
        status=status,
        lower_bound=lower_bound,
        solver=solver,
        work=search.spent,
    )
