"""Coverage over the number of views: for every number the best views found, and what no views of that number exceed.

The selection grows by one view at a time and is searched. Multipliers found for one number of views bound all numbers
at once (`planner.cover.bound`), so that the linear programme goes on from one number to the next. From the curve follow
the fewest views for any coverage, from below and above.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from planner.cover.bound import Relaxation
from planner.cover.budget import Budget
from planner.cover.canonical import canonical
from planner.cover.greedy import complete
from planner.cover.problem import CoverProblem
from planner.cover.search import Search
from planner.cover.sets import Sets
from planner.errors import PlannerError
from planner.values import Floats, Ints, Value, freeze, readonly

CURVE_EFFORT = 2_500_000_000
"""Default budget: some five seconds for a thousand candidates and four thousand samples."""

SEARCH_SHARE = 0.4
"""Of the budget, for the search; the bound gets the rest, and what the search leaves."""

_MET = 1e-12  # share of the coverable area: a coverage counts as reached when no more is missing (rounding)


@dataclass(frozen=True, slots=True, eq=False)
class CoverageCurve(Value):
    """The most area found with each number of views, and the bound that no views of that number exceed.

    Attributes:
        first: smallest number of views: the pinned ones.
        covered_area: (n,) area covered by the best `first`, `first` + 1, ... views found [m^2], not falling.
        upper_area: (n,) no such number of views covers more [m^2], not falling.
        views: n selections, columns of the matrix in ascending order.
        coverable_area: area that all usable columns cover [m^2].
        total_area: area of all rows [m^2].
        interrupted: whether Ctrl-C stopped the work.
    """

    first: int
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
        return np.arange(self.first, self.first + len(self.views))

    def fewest(self, coverage: float) -> tuple[int | None, int | None]:
        """The fewest views for a share of the coverable area: a number that certainly suffices, and one that may.

        Returns:
            The number of views found, None where the curve ends below; and the smallest number that the bound does not
            exclude, None where it excludes all on the curve.

        Raises:
            PlannerError: if the coverage is not in [0, 1].
        """
        if not 0.0 <= coverage <= 1.0:
            raise PlannerError(f"coverage is {coverage!r}; it is a share of the coverable area and must be from 0 to 1")
        wanted = (coverage - _MET) * self.coverable_area
        found, possible = (np.flatnonzero(a >= wanted) for a in (self.covered_area, self.upper_area))
        return (
            int(self.n_views[found[0]]) if len(found) else None,
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
    """The curve from the pinned views on to everything, or to a number of views.

    Args:
        problem: matrix, areas, allowed, pinned and banned columns; where it has `max_views` the curve ends there at the
            latest. Its coverage is not looked at.
        rng: random choices of the search.
        known_selections: selections (columns of the matrix), for instance the plan: the curve is nowhere below.
        min_views_full_coverage: no fewer views cover everything (`Cover.lower_bound` of a full cover).
        effort_budget: units of work for search and bound together.

    Raises:
        PlannerError: for a problem that `planner.cover.solve` refuses, or a known selection that leaves out a pinned
            view. Columns of it that are not allowed are left out.
    """
    most = np.shape(problem.matrix)[1] if problem.max_views is None else problem.max_views
    found = canonical(replace(problem, max_views=most, coverage=1.0))
    work = Budget(effort_budget)
    whole, sets, pins = found.whole, found.rest, len(found.pinned)
    selections = [np.zeros(0, dtype=np.int64)]
    for views in known_selections:
        if len(missing := np.setdiff1d(found.pinned, views)):
            raise PlannerError(f"a known selection leaves out column {missing[0]}, which is pinned")
        columns = np.flatnonzero(np.isin(found.columns[found.rest_columns], views))
        if not len(selections) > len(columns):
            selections += [columns[: k + 1] for k in range(len(selections) - 1, len(columns))]
    with work.ended_by_ctrl_c(), work.portion(SEARCH_SHARE):
        _search(sets, selections, rng, work)
    open_units = np.array([sets.objective(columns) for columns in selections])
    ends = int(np.argmin(open_units)) if sets.n_rows else 0  # the first that leaves as little as possible
    selections, open_units = selections[: ends + 1], np.minimum.accumulate(open_units[: ends + 1])
    bounds = np.zeros(ends + 1)
    if ends:
        bounds = _bounds(sets, open_units, work)
        some = int(sets.units.min())  # what is not everything lacks a row at least
        bounds[: max(min_views_full_coverage - pins, 0)] = np.maximum(
            bounds[: max(min_views_full_coverage - pins, 0)], some
        )
    elif sets.n_rows:
        bounds[0] = sets.total
    chosen = [np.concatenate((found.fixed, found.rest_columns[columns])) for columns in selections]
    areas = found.areas[found.rows]
    covered = np.maximum.accumulate([float(areas[whole.covered(columns)].sum()) for columns in chosen])
    coverable = float(areas.sum())
    upper = np.minimum(1.0 - bounds / max(whole.total, 1), 1.0) * coverable
    return CoverageCurve(
        first=pins,
        covered_area=covered,
        upper_area=np.maximum(upper, covered),
        views=tuple(np.sort(np.concatenate((found.columns[columns], found.idle))) for columns in chosen),
        coverable_area=coverable,
        total_area=float(found.areas.sum()),
        interrupted=work.interrupted,
    )


def _search(sets: Sets, best: list[Ints], rng: np.random.Generator, work: Budget) -> None:
    """The best columns found for 1, 2, ... of them, each from the one before and the one that adds most."""
    for size in range(1, sets.most + 1):
        if sets.objective(best[size - 1]) == 0:
            break
        here = replace(sets, most=size)
        start = complete(here, best[size - 1])
        if size < len(best) and here.objective(best[size]) <= here.objective(start):
            start = best[size]
        work.begin(here.tolerance)
        work.offer(start, here.objective(start))
        if len(start) == size < sets.n_columns and work.spend(0):
            with work.portion(1 / (2 + sets.most // 4)):
                Search(here, start, rng).run(work)
        found = start if work.best is None or len(work.best) < size else work.best
        best[size : size + 1] = [found]
        if len(start) < size:
            break


def _bounds(sets: Sets, open_units: Ints, work: Budget) -> Floats:
    """Units that 0, 1, 2, ... columns leave open at least."""
    from planner.cover.row_generation import raise_bound  # importing highspy costs start-up

    relaxation, model = Relaxation(sets), None
    with work.ended_by_ctrl_c():
        for size in range(1, len(open_units)):
            work.begin(sets.tolerance)
            relaxation.aim_at(size)
            with work.portion(0.3):
                model = raise_bound(relaxation, int(open_units[size]), work, model)
    return np.array([min(relaxation.certified_units(k), int(units)) for k, units in enumerate(open_units)], float)
