"""Select the views: check, reduce, search, bound, and say how far the plan is from the fewest possible."""

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from enum import Enum
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from planner.cover.bound import bound
from planner.cover.budget import DEFAULT_WORK, Budget
from planner.cover.greedy import by_marginal_area, greedy
from planner.cover.canonical import Candidates, CoverProblem, candidates, column_indices
from planner.cover.reductions import reduce, take
from planner.cover.solvers import BOUND_SHARE, SOLVERS
from planner.errors import PlannerError
from planner.values import Floats, Ints, Value

PRICE_ROUNDING = 1e-4
"""Costs that are not whole numbers are rounded: "proven cheapest" means that none saves more than this share."""

FLOAT_ERROR = 1e-12
"""Share that is taken off a bound on costs that are not whole numbers: above the float error of their sums."""


class CoverStatus(Enum):
    """How a selection ended; the value is the sentence for reports."""

    PROVEN = "proven fewest for these candidates and samples"
    BOUNDED = "within a known number of views of the fewest for these candidates and samples"
    TIME_LIMITED = "the time limit stopped the search; within a known number of views of the fewest"
    INTERRUPTED = "interrupted; within a known number of views of the fewest"
    NOTHING_COVERABLE = "no allowed view measures any sample"

    @property
    def sentence(self) -> str:
        """The status in words, without numbers; `Cover.sentence` has them."""
        return str(self.value)


@dataclass(frozen=True, slots=True, eq=False)
class Cover(Value):
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
        multiplicity: how many views had to measure a row for it to count as covered.
        short_rows: rows that fewer usable columns cover than the multiplicity; all of them were demanded.
        price: cost of the views together, and what no selection that meets the target undercuts; None without costs.
    """

    views: Annotated[Ints, "n"]
    marginal_area: Annotated[Floats, "n"]
    covered_area: float
    coverable_area: float
    total_area: float
    uncoverable_rows: Annotated[Ints, "_"]
    pinned: Annotated[Ints, "_"]
    status: CoverStatus
    lower_bound: int
    solver: str
    work: int
    multiplicity: int = 1
    short_rows: Annotated[Ints, "_"] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    price: tuple[float, float] | None = None

    @property
    def cost(self) -> float:
        """What the views cost together; their number where no costs were given."""
        return len(self.views) if self.price is None else self.price[0]

    @property
    def cost_bound(self) -> float:
        """No selection that meets the target (and contains the pinned views) costs less."""
        return self.lower_bound if self.price is None else self.price[1]

    @property
    def excess(self) -> int:
        """The plan has at most this many views more than the fewest."""
        return len(self.views) - self.lower_bound

    @property
    def gap(self) -> float:
        """(cost - bound on it) / cost, which without costs is (views - lower bound) / views; 0 for an empty plan."""
        return (self.cost - self.cost_bound) / self.cost if len(self.views) else 0.0

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
        fewest = "fewest" if self.price is None else "cheapest"
        if self.status is CoverStatus.NOTHING_COVERABLE:
            return self.status.sentence
        if self.status is CoverStatus.PROVEN:
            return f"proven {fewest} for these candidates and samples"
        if self.price is not None:
            within = f"costs at most {100 * self.gap / (1 - self.gap):.3g} % more than the {fewest}"
        else:
            within = f"at most {self.excess} {'view' if self.excess == 1 else 'views'} more than the {fewest}"
        return beginning(self.status) + f"{within} for these candidates and samples"


def beginning(status: CoverStatus) -> str:
    """How a sentence begins on a search that was ended from outside; empty where it was not."""
    if status is CoverStatus.TIME_LIMITED:
        return "the time limit stopped the search; "
    return "the search was interrupted; " if status is CoverStatus.INTERRUPTED else ""


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
    multiplicity: int = 1,
    costs: ArrayLike | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> Cover:
    """Choose the fewest or cheapest columns that cover the required share of what the usable columns can cover.

    The greedy cover and a lower bound are always computed, whatever the solver and the budget. Ctrl-C during the search
    ends it: the best cover so far is returned, and its status says so.

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
        multiplicity: how many views must measure a row for it to count as covered; of a row that fewer can, all.
        costs: (V,) cost of each column above zero, in seconds say; the cheapest cover is sought. None: 1 each.
        clock: seconds, for the guard.

    Raises:
        PlannerError: for input that `candidates` refuses, an unknown solver, or a pinned column that is banned or not
            allowed.
    """
    if solver not in SOLVERS:
        raise PlannerError(f"there is no solver {solver!r}; choose one of {', '.join(SOLVERS)}")
    search = Budget(budget, time_limit_s, clock)
    found = candidates(M, areas, allowed, coverage=coverage, banned=banned, multiplicity=multiplicity, costs=costs)
    fixed, useful_fixed = _pinned(found, M.shape[1], allowed, pinned, banned)

    rest, rest_columns = take(found.problem, useful_fixed)
    reduction = reduce(rest)
    chosen = _search(reduction.problem, solver, rng, search)
    free = rest_columns[reduction.lift(chosen)]
    left = rest.cost(reduction.forced) + min(search.lower_bound, reduction.problem.cost(chosen))
    return _cover(
        found,
        fixed,
        np.concatenate((useful_fixed, free)),
        found.problem.cost(useful_fixed) + left,
        costs=None if costs is None else np.asarray(costs, dtype=np.float64),
        multiplicity=multiplicity,
        solver=solver,
        search=search,
    )


def _search(problem: CoverProblem, solver: str, rng: np.random.Generator, search: Budget) -> Ints:
    """Greedy, bound and the chosen solver on a reduced problem; the best cover so far when Ctrl-C ends it."""
    if problem.trivial:
        search.offer(np.zeros(0, dtype=np.int64))
        return np.zeros(0, dtype=np.int64)
    search.prove(int(problem.costs.min()))  # one column at least, should Ctrl-C come before the bound
    try:
        chosen = greedy(problem, rng, search)
        with search.portion(BOUND_SHARE):
            search.dual = bound(problem, problem.cost(chosen), search)
        chosen = SOLVERS[solver](problem, rng, search)
    except KeyboardInterrupt as stop:
        if search.best is None or type(stop) is not KeyboardInterrupt:  # a subclass is a kill, not a wish for a result
            raise
        search.interrupted = True
        chosen = search.best
    if search.best is not None and search.best_cost < problem.cost(chosen):
        chosen = search.best
    return chosen


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


def _cover(
    found: Candidates,
    fixed: Ints,
    columns: Ints,
    bound_units: int,
    *,
    costs: Floats | None,
    multiplicity: int,
    solver: str,
    search: Budget,
) -> Cover:
    """Assemble the result: order by marginal area, exact check of the target, areas, costs, status.

    Args:
        found: the problem and where it came from.
        fixed: pinned columns of the matrix.
        columns: chosen columns of the problem, the useful ones of the pinned among them.
        bound_units: no such choice costs less, in the problem's units.
        costs: (V,) as the user gave them.
        multiplicity: as the user gave it.
        solver: its name.
        search: what was spent.
    """
    problem = found.problem
    order, added = by_marginal_area(problem, columns)
    covered = problem.covered(columns)
    if not problem.met(covered):
        raise AssertionError(f"the solver {solver!r} returned a selection that misses its target")
    idle = np.setdiff1d(fixed, found.columns)  # pinned views that measure nothing stay in the plan, last
    views = np.concatenate((found.columns[order], idle))
    areas = found.areas[found.rows]
    marginal = [float(areas[rows].sum()) for rows in added] + [0.0] * len(idle)
    price = None if costs is None else _price(found, views, idle, bound_units, costs)
    if not problem.n_rows:
        status = CoverStatus.NOTHING_COVERABLE
    elif bound_units == problem.cost(columns) and (price is None or price[0] - price[1] <= PRICE_ROUNDING * price[0]):
        status = CoverStatus.PROVEN
    elif search.interrupted:
        status = CoverStatus.INTERRUPTED
    else:
        status = CoverStatus.TIME_LIMITED if search.time_limited else CoverStatus.BOUNDED
    # with costs: a cover of so many units has at least as many columns as the dearest ones need for them
    fewest = bound_units if costs is None else -(-bound_units // int(problem.costs.max(initial=1)))
    return Cover(
        views=views,
        marginal_area=np.array(marginal),
        covered_area=float(areas[covered].sum()),
        coverable_area=float(areas.sum()),
        total_area=float(found.areas.sum()),
        uncoverable_rows=found.uncoverable_rows,
        pinned=fixed,
        status=status,
        lower_bound=len(idle) + fewest,
        solver=solver,
        work=search.spent,
        multiplicity=multiplicity,
        short_rows=found.short_rows,
        price=price,
    )


def _price(found: Candidates, views: Ints, idle: Ints, bound_units: int, costs: Floats) -> tuple[float, float]:
    """What the views cost as the costs were given, and what no selection undercuts.

    The bound is on rounded costs: what rounding may have added to them is taken off, by the column on which it added
    the largest share, or by what it added to all columns together, whichever takes off less.

    Args:
        found: the problem and where it came from.
        views: chosen columns of the matrix.
        idle: those of them that cover nothing; no selection is without them.
        bound_units: no choice of the problem's columns costs less, in its units.
        costs: (V,) as the user gave them.
    """
    price, unit = float(costs[views].sum()), found.cost_unit
    given, rounded = costs[found.columns], found.problem.costs
    least = bound_units * unit
    if not np.array_equal(given, rounded * unit):
        added = float(np.maximum(rounded - given / unit, 0.0).sum())
        least = max(bound_units * float((given / rounded).min()), (bound_units - added) * unit) * (1 - FLOAT_ERROR)
    return price, min(least + float(costs[idle].sum()), price)
