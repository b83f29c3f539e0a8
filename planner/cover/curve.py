"""Coverage over the number of views: for every number the best views found, and what no views of that number exceed.

The selection grows by one view at a time and is improved by tabu search, then shrinks again the same way; a better
selection on the way replaces an earlier one. One Lagrangian dual bounds all numbers at once
(`planner.cover.area_bound`), so the curve costs little more than one plan. From it follow the fewest views for any
coverage, from below and above.
"""

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from planner.cover.area_bound import area_bounds
from planner.cover.area_search import AreaSearch
from planner.cover.budget import Budget
from planner.cover.prepared import Prepared, prepare
from planner.errors import PlannerError
from planner.values import Floats, Ints, Value, freeze, readonly

CURVE_WORK = 2_500_000_000
"""Default budget: some five seconds for a thousand candidates and four thousand samples."""

SEARCH_SHARE = 0.4
"""Of the budget, for the search; the bound gets the rest, and what the search leaves."""

_STEPS, _PASSES = 100, 3  # swaps for each number of views, growing and shrinking, and how often
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
        time_limited: whether the clock, or Ctrl-C, stopped the work.
    """

    first: int
    covered_area: Annotated[Floats, "n"]
    upper_area: Annotated[Floats, "n"]
    views: Annotated[tuple[Ints, ...], "n"]
    coverable_area: float
    total_area: float
    time_limited: bool

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

        Args:
            coverage: 0 to 1.

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
    M: Any,
    areas: ArrayLike,
    allowed: ArrayLike | None = None,
    *,
    rng: np.random.Generator,
    most_views: int | None = None,
    known: Sequence[ArrayLike] = (),
    fewest_for_all: int = 0,
    pinned: Iterable[int] = (),
    banned: Iterable[int] = (),
    budget: int = CURVE_WORK,
    time_limit_s: float | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> CoverageCurve:
    """The curve from the pinned views on to everything, or to a number of views.

    Args:
        M: (S, V) measurability matrix, scipy sparse or dense.
        areas: (S,) area of each row [m^2].
        allowed: (V,) bool, which columns may be used; None: all.
        rng: random choices of the search.
        most_views: where the curve ends at the latest; None: where everything is covered.
        known: selections that are known (columns of the matrix), for instance the plan: the curve is nowhere below.
        fewest_for_all: no fewer views cover everything (`Cover.lower_bound` of a full cover).
        pinned: columns that are part of every selection; the curve begins with them.
        banned: columns that are part of none.
        budget: units of work for search and bound together.
        time_limit_s: wall-clock guard [s].
        clock: seconds, for the guard.

    Raises:
        PlannerError: for input that `prepare` refuses, fewer views than are pinned, or a known selection that leaves
            out a pinned view. Columns of it that are not allowed are left out.
    """
    ready = prepare(M, areas, allowed, pinned, banned)
    if most_views is not None and most_views < len(ready.fixed):
        raise PlannerError(f"most_views is {most_views}; it must be at least the {len(ready.fixed)} pinned views")
    work = Budget(budget, time_limit_s, clock)
    selections = [np.unique(np.asarray(views, dtype=np.int64)) for views in known]
    for views in selections:
        if len(missing := np.setdiff1d(ready.fixed, views)):
            raise PlannerError(f"a known selection leaves out column {missing[0]}, which is pinned")
    limit = None if most_views is None else most_views - len(ready.fixed)
    chosen = _selections(ready, rng, work, limit, [ready.inner(views) for views in selections])
    covered = np.array([ready.units(columns) for columns in chosen], dtype=np.int64)
    bounds = area_bounds(ready.problem, covered, work) if len(chosen) > 1 else None
    upper = covered if bounds is None else np.maximum(bounds.units, covered)
    if ready.problem.n_rows:  # what is not everything lacks a row at least
        most = int(ready.problem.units.sum() - ready.problem.units.min())
        upper[: max(fewest_for_all - len(ready.fixed), 0)] = np.minimum(
            upper[: max(fewest_for_all - len(ready.fixed), 0)], most
        )
    problem, row_areas = ready.found.problem, ready.found.areas[ready.found.rows]
    canonical = [ready.canonical(columns) for columns in chosen]
    covered_area = np.array([float(row_areas[problem.counts(c) > 0].sum()) for c in canonical])
    coverable = float(row_areas.sum())
    share = (upper + ready.base) / max(int(problem.units.sum()), 1)
    idle = np.setdiff1d(ready.fixed, ready.found.columns)
    return CoverageCurve(
        first=len(ready.fixed),
        covered_area=covered_area,
        upper_area=np.maximum(np.minimum(share, 1.0) * coverable, covered_area),
        views=tuple(np.sort(np.concatenate((ready.found.columns[c], idle))) for c in canonical),
        coverable_area=coverable,
        total_area=float(ready.found.areas.sum()),
        time_limited=work.time_limited or work.interrupted,
    )


def _selections(
    ready: Prepared, rng: np.random.Generator, work: Budget, limit: int | None, known: list[Ints]
) -> list[Ints]:
    """The best columns found for 0, 1, 2, ... of them."""
    problem = ready.problem
    most = problem.n_columns if limit is None else min(limit, problem.n_columns)
    total = int(problem.units.sum())
    best, areas = [np.zeros(0, dtype=np.int64)], [0]
    if most == 0 or total == 0:
        return best
    for columns in known:
        for size in range(1, len(columns) + 1):  # each beginning of a known selection is one too
            _keep(best, areas, columns[:size], ready.units(columns[:size]), most)
    search = AreaSearch(problem, rng)
    with work.portion(SEARCH_SHARE):
        for _ in range(_PASSES):
            for size in range(1, most + 1):
                if areas[size - 1] >= total:
                    break
                search.set(best[size - 1])
                if not search.grow():
                    break
                search.improve(work, _STEPS, total)
                _keep(best, areas, search.chosen, search.area, most)
            for size in range(len(best) - 1, 1, -1):
                search.set(best[size])
                search.shrink()
                search.improve(work, _STEPS, total)
                _keep(best, areas, search.chosen, search.area, most)
    end = next((size for size, area in enumerate(areas) if area >= total), len(best) - 1)
    return best[: end + 1]


def _keep(best: list[Ints], areas: list[int], columns: Ints, area: int, most: int) -> None:
    """Note a selection where it beats what is known of its size; it comes with sizes up to one more than known."""
    size = len(columns)
    if size > most:
        return
    if size == len(best):
        best.append(columns.copy())
        areas.append(area)
    elif area > areas[size]:
        best[size], areas[size] = columns.copy(), area
