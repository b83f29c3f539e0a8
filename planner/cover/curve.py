"""Coverage over the number of views: the best selection found for each number, and an upper bound for each.

The selection grows by one view at a time and is improved by search. Multipliers for one number of views bound all
numbers at once (`planner.cover.bounds`), so the linear programme continues from one number to the next. The curve gives
the fewest views for any coverage, from below and above.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from planner.cover.bounds import Relaxation, raise_bound
from planner.cover.budget import Budget
from planner.cover.problem import CoverInstance, CoverProblem
from planner.cover.reductions import canonical_form
from planner.cover.search import LocalSearch, complete
from planner.errors import PlannerError
from planner.values import Floats, Ints, Value, freeze, readonly

CURVE_EFFORT = 2_500_000_000
"""Default budget: some five seconds for a thousand candidates and four thousand samples."""

SEARCH_SHARE = 0.4
"""Share of the budget for the search; the bound gets the rest and the unused part of the search."""

_TOLERANCE = 1e-12  # share of the coverable area that may be missing from a coverage (rounding)


@dataclass(frozen=True, slots=True, eq=False)
class CoverageCurve(Value):
    """The largest area found with each number of views, and an upper bound for each.

    Attributes:
        first_n_views: smallest number of views: the pinned ones.
        covered_area: (n,) area covered by the best `first_n_views`, `first_n_views` + 1, ... views found [m^2], not
            falling.
        upper_area: (n,) upper bound on the area of that number of views [m^2], not falling.
        views: n selections, columns of the matrix in ascending order.
        coverable_area: area that all usable columns cover [m^2].
        total_area: area of all rows [m^2].
        interrupted: whether Ctrl-C stopped the work.
    """

    first_n_views: int
    covered_area: Annotated[Floats, "n"]
    upper_area: Annotated[Floats, "n"]
    views: Annotated[tuple[Ints, ...], "n"]
    coverable_area: float
    total_area: float
    interrupted: bool

    def __post_init__(self) -> None:
        views = tuple(readonly("views", v, (None,), np.int64) for v in self.views)
        object.__setattr__(self, "views", views)
        freeze(self)

    @property
    def n_views(self) -> Ints:
        """(n,) numbers of views."""
        return np.arange(self.first_n_views, self.first_n_views + len(self.views))

    def fewest_views(self, coverage: float) -> tuple[int | None, int | None]:
        """Return upper and lower bound on the fewest views for a share of the coverable area.

        Returns:
            The number of views found, None if the curve ends below; and the smallest number that the bound does not
            exclude, None if it excludes all on the curve.

        Raises:
            PlannerError: if the coverage is not in [0, 1].
        """
        if not 0.0 <= coverage <= 1.0:
            raise PlannerError(f"coverage is {coverage!r}; it is a share of the coverable area and must be from 0 to 1")
        required = (coverage - _TOLERANCE) * self.coverable_area
        reached, possible = (np.flatnonzero(a >= required) for a in (self.covered_area, self.upper_area))
        return (
            int(self.n_views[reached[0]]) if len(reached) else None,
            int(self.n_views[possible[0]]) if len(possible) else None,
        )


def coverage_curve(
    problem: CoverProblem,
    *,
    rng: np.random.Generator,
    known_selections: Sequence[ArrayLike] = (),
    min_views_full_coverage: int = 0,
    effort_budget: int = CURVE_EFFORT,
) -> CoverageCurve:
    """Compute the curve from the pinned views to full coverage, or to `problem.max_views`.

    Args:
        problem: matrix, areas, allowed, pinned and banned columns; its coverage is ignored.
        rng: random draws of the search.
        known_selections: selections (columns of the matrix), for instance the plan; the curve is nowhere below them.
            Columns that are not allowed are ignored.
        min_views_full_coverage: lower bound on the views for full coverage (`Cover.lower_bound` of a full cover).
        effort_budget: units of effort for search and bound together.

    Raises:
        PlannerError: for a problem that `planner.cover.solve` refuses, or a known selection without a pinned view.
    """
    max_views = np.shape(problem.matrix)[1] if problem.max_views is None else problem.max_views
    form = canonical_form(replace(problem, max_views=max_views, coverage=1.0))
    budget = Budget(effort_budget)
    reduced, residual, n_pins = form.reduced, form.residual, len(form.pinned)
    selections = [np.zeros(0, dtype=np.int64)]
    for views in known_selections:
        if len(missing := np.setdiff1d(form.pinned, views)):
            raise PlannerError(f"a known selection leaves out column {missing[0]}, which is pinned")
        columns = np.flatnonzero(np.isin(form.columns[form.residual_columns], views))
        if len(columns) >= len(selections):
            selections += [columns[: k + 1] for k in range(len(selections) - 1, len(columns))]
    with budget.stopped_by_interrupt(), budget.portion(SEARCH_SHARE):
        _improve_selections(residual, selections, rng, budget)
    uncovered = np.array([residual.objective(columns) for columns in selections])
    end = int(np.argmin(uncovered)) if residual.n_rows else 0  # the first that leaves as little as possible
    selections, uncovered = selections[: end + 1], np.minimum.accumulate(uncovered[: end + 1])
    bounds = np.zeros(end + 1)
    if end:
        bounds = _uncovered_bounds(residual, uncovered, budget)
        one_row = int(residual.units.min())  # fewer views than for full coverage lack one row at least
        n_partial = max(min_views_full_coverage - n_pins, 0)
        bounds[:n_partial] = np.maximum(bounds[:n_partial], one_row)
    elif residual.n_rows:
        bounds[0] = residual.total_units
    selected = [np.concatenate((form.pinned_columns, form.residual_columns[columns])) for columns in selections]
    areas = form.areas[form.rows]
    covered = np.maximum.accumulate([float(areas[reduced.satisfied(columns)].sum()) for columns in selected])
    coverable = float(areas.sum())
    upper = np.minimum(1.0 - bounds / max(reduced.total_units, 1), 1.0) * coverable
    return CoverageCurve(
        first_n_views=n_pins,
        covered_area=covered,
        upper_area=np.maximum(upper, covered),
        views=tuple(np.sort(np.concatenate((form.columns[columns], form.idle_pins))) for columns in selected),
        coverable_area=coverable,
        total_area=float(form.areas.sum()),
        interrupted=budget.interrupted,
    )


def _improve_selections(instance: CoverInstance, best: list[Ints], rng: np.random.Generator, budget: Budget) -> None:
    """Find the best 1, 2, ... columns, each from the selection before and its best further column."""
    assert instance.max_columns is not None, "the curve maximises the area"
    for size in range(1, instance.max_columns + 1):
        if instance.objective(best[size - 1]) == 0:
            break
        sized = replace(instance, max_columns=size)
        start = complete(sized, best[size - 1])
        if size < len(best) and sized.objective(best[size]) <= sized.objective(start):
            start = best[size]
        budget.begin(sized.tolerance)
        budget.offer(start, sized.objective(start))
        if len(start) == size < instance.n_columns and budget.spend(0):
            with budget.portion(1 / (2 + instance.max_columns // 4)):
                LocalSearch(sized, start, rng).run(budget)
        incumbent = budget.incumbent
        best[size : size + 1] = [start if incumbent is None or len(incumbent) < size else incumbent]
        if len(start) < size:
            break


def _uncovered_bounds(instance: CoverInstance, uncovered: Ints, budget: Budget) -> Floats:
    """Return lower bounds on the units that 0, 1, 2, ... columns leave uncovered."""
    relaxation, model = Relaxation(instance), None
    with budget.stopped_by_interrupt():
        for size in range(1, len(uncovered)):
            budget.begin(instance.tolerance)
            relaxation.set_size(size)
            with budget.portion(0.3):
                model = raise_bound(relaxation, int(uncovered[size]), budget, model)
    return np.array([min(relaxation.certified_uncovered(k), int(units)) for k, units in enumerate(uncovered)], float)
