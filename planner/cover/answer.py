"""The answer to a cover problem: selected views, their area and cost, and the proven bounds on both."""

from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Annotated

import numpy as np

from planner.cover.budget import Budget
from planner.cover.problem import CoverProblem
from planner.cover.reductions import CanonicalForm
from planner.cover.search import order_by_marginal_area
from planner.values import Floats, Ints, Value

COST_TOLERANCE = 1e-4
"""Costs that are not whole numbers are rounded: "proven cheapest" means that none saves more than this share."""

FLOAT_ERROR = 1e-12
"""Share subtracted from a bound on costs that are not whole numbers: above the float error of their sums."""


class CoverStatus(Enum):
    """Result of a selection; the value is its sentence for reports, without numbers (`Cover.sentence` has them)."""

    PROVEN = "optimal for these candidates and samples"
    BOUNDED = "within a known distance of the optimum for these candidates and samples"
    INTERRUPTED = "the search was interrupted; within a known distance of the optimum"
    NOTHING_COVERABLE = "no allowed candidate measures any sample"

    @property
    def sentence(self) -> str:
        """The status in words."""
        return str(self.value)


@dataclass(frozen=True, slots=True, eq=False)
class Cover(Value):
    """A selection of views and its proven bounds.

    Attributes:
        views: (n,) selected columns of the matrix, in the order of their marginal coverage, largest first.
        marginal_area: (n,) area of the rows whose demand each view is the first to satisfy [m^2].
        covered_area: area of the satisfied rows [m^2].
        coverable_area: area of the rows that some usable column covers [m^2].
        total_area: area of all rows [m^2].
        uncoverable_rows: rows that no usable column covers.
        pinned: pinned views, ascending; they count in `views` and in `lower_bound`.
        status: how the selection ended.
        lower_bound: smallest possible number of views of a selection that meets the target (with `max_views`: that
            covers as much).
        upper_area: upper bound on the area of any selection of `max_views` views [m^2]; without `max_views` it is the
            coverable area.
        solver: name of the solver.
        effort: units of effort spent (see `planner.cover.budget`).
        demand: demanded load of each row; the smallest if demands differ.
        unsatisfiable_rows: rows that some columns cover, but all of them together less often than demanded.
        cost_and_bound: cost of the views and a lower bound on it; None without costs.
        max_views: largest number of views; None: not limited.
        n_views_without_overlap: views of the best selection without the overlap constraint; None without one.
        n_candidates: usable columns that measure something, to which the bounds refer.
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
    upper_area: float
    solver: str
    effort: int
    demand: int = 1
    unsatisfiable_rows: Annotated[Ints, "_"] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    cost_and_bound: tuple[float, float] | None = None
    max_views: int | None = None
    n_views_without_overlap: int | None = None
    n_candidates: int = 0

    @property
    def cost(self) -> float:
        """Cost of the views; their number without costs."""
        return len(self.views) if self.cost_and_bound is None else self.cost_and_bound[0]

    @property
    def cost_bound(self) -> float:
        """Lower bound on the cost of a selection that meets the target and contains the pinned views."""
        return self.lower_bound if self.cost_and_bound is None else self.cost_and_bound[1]

    @property
    def excess_views(self) -> int:
        """Number of views above the lower bound."""
        return len(self.views) - self.lower_bound

    @property
    def gap(self) -> float:
        """(cost - lower bound) / cost; 0 for an empty selection."""
        return (self.cost - self.cost_bound) / self.cost if len(self.views) else 0.0

    @property
    def gap_percent(self) -> float:
        """With `max_views`: largest possible increase of the area by other views [% of the coverable area]."""
        coverable = self.coverable_area
        return 100.0 * max(self.upper_area - self.covered_area, 0.0) / coverable if coverable > 0 else 0.0

    @property
    def sentence(self) -> str:
        """The status in words with its numbers."""
        if self.status is CoverStatus.NOTHING_COVERABLE:
            return self.status.sentence
        if self.max_views is not None:
            return self._sentence_of_area()
        best = "fewest" if self.cost_and_bound is None else "cheapest"
        best += " connected views" if self.n_views_without_overlap is not None else " views"
        candidates = f"the {self.n_candidates:,} candidate poses"
        bound = "" if self.cost_and_bound is not None else f" (bound {self.lower_bound})"
        if self.status is CoverStatus.PROVEN:
            is_plain = best == "fewest views"
            return f"{'optimal for' if is_plain else f'proven {best} of'} {candidates}{bound}"
        if self.cost_and_bound is not None:
            within = f"costs at most {100 * self.gap / (1 - self.gap):.3g} % more than the {best}"
        else:
            within = f"at most {self.excess_views} {'view' if self.excess_views == 1 else 'views'} more than the {best}"
        return f"{self.termination}{within} of {candidates}{bound}"

    def _sentence_of_area(self) -> str:
        if self.covered_area >= self.coverable_area:
            return "these views measure the complete coverable surface"
        views = "1 view" if self.max_views == 1 else f"{self.max_views} views"
        most = f"maximum coverage with {views} of the {self.n_candidates:,} candidate poses"
        if self.status is CoverStatus.PROVEN:
            return f"proven {most}"
        return f"{self.termination}at most {max(self.gap_percent, 0.01):.2f} percentage points below the {most}"

    @property
    def termination(self) -> str:
        """Beginning of a sentence about a search that Ctrl-C ended; empty otherwise."""
        return "the search was interrupted; " if self.status is CoverStatus.INTERRUPTED else ""


def make_cover(
    problem: CoverProblem,
    form: CanonicalForm,
    columns: Ints,
    bound: int,
    *,
    solver: str,
    budget: Budget,
    min_views: int = 0,
    n_views_without_overlap: int | None = None,
) -> Cover:
    """Convert selected columns and a bound to the answer, in the numbers of the caller.

    Args:
        problem: as the caller states it.
        form: the same in canonical form.
        columns: selected columns of `form.reduced`, including the pinned ones that cover something.
        bound: lower bound on the objective, including the cost of pinned columns.
        solver: name of the solver.
        budget: effort spent, and the reason of an early end.
        min_views: with `max_views`, smallest number of views, including pinned ones, that may cover as much.
        n_views_without_overlap: with an overlap, number of views of the cover without it.
    """
    instance = form.reduced
    order, added = _needed_in_order(form, columns)
    idle = form.idle_pins  # pinned views that measure nothing stay, at the end
    views = np.concatenate((form.columns[order], idle))
    areas = form.areas[form.rows]
    satisfied = instance.satisfied(order)
    covered_area, coverable = float(areas[satisfied].sum()), float(areas.sum())
    upper = coverable
    has_costs = problem.costs is not None or problem.group is not None
    cost_and_bound = _cost_and_bound(problem, form, views, bound) if has_costs else None
    if instance.maximises_area:
        objective = int(instance.units[~satisfied].sum())
        is_proven = objective - instance.tolerance <= bound
        share = 1 - bound / max(instance.total_units, 1)
        upper = covered_area if is_proven else max(coverable * share, covered_area)
        lower_bound = min_views
    else:
        if not instance.is_feasible(order):
            raise AssertionError(f"the solver {solver!r} returned a selection that misses its target")
        is_proven = bound >= instance.cost(order)
        if cost_and_bound is not None:
            cost, cost_bound = cost_and_bound
            is_proven = is_proven and cost - cost_bound <= COST_TOLERANCE * cost
            bound = _fewest_columns(form, bound)
        lower_bound = len(idle) + bound
    if not instance.n_rows:
        status = CoverStatus.NOTHING_COVERABLE
    elif is_proven:
        status = CoverStatus.PROVEN
    else:
        status = CoverStatus.INTERRUPTED if budget.interrupted else CoverStatus.BOUNDED
    return Cover(
        views=views,
        marginal_area=np.array([float(areas[rows].sum()) for rows in added] + [0.0] * len(idle)),
        covered_area=covered_area,
        coverable_area=coverable,
        total_area=float(form.areas.sum()),
        uncoverable_rows=form.uncoverable_rows,
        pinned=form.pinned,
        status=status,
        lower_bound=min(lower_bound, len(views)),
        upper_area=upper,
        solver=solver,
        effort=budget.spent,
        demand=int(np.min(problem.demand, initial=2**30)),
        unsatisfiable_rows=form.unsatisfiable_rows,
        cost_and_bound=cost_and_bound,
        max_views=problem.max_views,
        n_views_without_overlap=n_views_without_overlap,
        n_candidates=len(form.columns),
    )


def _needed_in_order(form: CanonicalForm, columns: Ints) -> tuple[Ints, list[Ints]]:
    """Order columns by marginal coverage; return them with the rows that each is the first to satisfy.

    For maximum coverage columns that are not needed are left out, except pinned ones.
    """
    instance = form.reduced
    order, added = order_by_marginal_area(instance, columns)
    if not instance.maximises_area:
        return order, added
    if instance.has_unit_demand:  # leave out columns that add nothing to those before
        positions = [k for k, rows in enumerate(added) if len(rows) or order[k] in form.pinned_columns]
        return order[positions], [added[k] for k in positions]
    for column in order[::-1]:  # a column that is the first to satisfy no row may still be needed
        others = order[order != column]
        is_lost = instance.satisfied(others) != instance.satisfied(order)
        if column not in form.pinned_columns and not is_lost.any():
            order = others
    return order_by_marginal_area(instance, order)


def _fewest_columns(form: CanonicalForm, cost_bound: int) -> int:
    """Return the smallest number of columns that may cost as much as a bound, with the forced columns.

    Besides these it is the number of the most expensive columns, each with a group, that the rest of the bound takes.
    """
    instance, forced = form.reduced, form.forced_columns
    per_group = int(instance.group_costs.max(initial=0))
    highest = int(np.delete(instance.costs, forced).max(initial=1)) + per_group
    remaining_cost = cost_bound - int(instance.costs[forced].sum()) - len(forced) * per_group
    return len(forced) + max(-(-remaining_cost // highest), 0)


def reweighted(problem: CoverProblem, form: CanonicalForm, cover: Cover, views: Ints) -> Cover:
    """Evaluate views with the areas of another problem; keep status, bounds, cost and effort of the cover."""
    columns = np.flatnonzero(np.isin(form.columns, views))
    other = make_cover(problem, form, columns, 0, solver=cover.solver, budget=Budget(0))
    return replace(
        other,
        status=cover.status,
        lower_bound=cover.lower_bound,
        cost_and_bound=cover.cost_and_bound,
        effort=cover.effort,
    )


def _cost_and_bound(problem: CoverProblem, form: CanonicalForm, views: Ints, bound: int) -> tuple[float, float]:
    """Return the cost of the views in the caller's unit, and a lower bound on the cost of any selection.

    The bound is on rounded costs. What rounding may have added is subtracted: by the column on which it added the
    largest share, or by the sum of what it added to all columns, whichever subtracts less.
    """
    instance, unit = form.reduced, form.cost_unit
    n_columns = np.shape(problem.matrix)[1]
    costs = np.ones(n_columns) if problem.costs is None else np.asarray(problem.costs, dtype=np.float64)
    group = np.zeros(n_columns, dtype=np.int64) if problem.group is None else np.asarray(problem.group, dtype=np.int64)
    group_costs = np.zeros(1) if problem.group_costs is None else np.asarray(problem.group_costs, dtype=np.float64)

    def cost_of(columns: Ints) -> float:
        return float(costs[columns].sum()) + float(group_costs[np.unique(group[columns])].sum())

    forced = form.forced_columns  # they are in every selection, so that their costs are exact
    forced_cost = float(costs[form.columns[forced]].sum())
    left = np.delete(np.arange(instance.n_columns), forced)
    caller_costs, units = costs[form.columns[left]], instance.costs[left]
    bound -= int(instance.costs[forced].sum())
    lower = bound * unit
    rounded_groups = np.rint(group_costs / unit)
    if not (np.array_equal(caller_costs, units * unit) and np.array_equal(group_costs, rounded_groups * unit)):
        rounded = np.maximum(rounded_groups, 1.0)
        added = float(np.maximum(units - caller_costs / unit, 0.0).sum())
        added += float(np.maximum(rounded - group_costs / unit, 0.0)[group_costs > 0].sum())
        shares = np.concatenate((caller_costs / units, (group_costs / rounded)[group_costs > 0]))
        lower = max(bound * float(shares.min(initial=unit)), (bound - added) * unit) * (1 - FLOAT_ERROR)
    lower = max(lower, 0.0) + forced_cost
    return cost_of(views), min(lower + cost_of(form.idle_pins), cost_of(views))
