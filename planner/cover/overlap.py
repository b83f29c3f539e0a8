"""Views whose data can be registered: the graph of chosen views is connected (Scott, Roth, Rivest 2001).

Two views are joined where they share at least a given area: the samples that both measure weigh that much, or at least
a share of what the smaller view measures. Scans can be brought into one frame by matching where this graph holds
together (Scott, Roth, Rivest, "View planning with a registration constraint", 3DIM 2001, doi:10.1109/IM.2001.924423).

The fewest views of the cover without this constraint bound the number from below; the difference is its price.
"""

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import Enum
from typing import Annotated, Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from planner.cover import demand_search
from planner.cover.told import told
from planner.cover.budget import Budget
from planner.cover.demand_search import Graph, connected, parts_of
from planner.cover.demands import DemandProblem
from planner.cover.prepared import Prepared, prepare
from planner.cover.selection import Cover, CoverStatus, beginning, solve
from planner.errors import PlannerError
from planner.values import Bools, Floats, Ints, Value, freeze

OVERLAP_WORK = 1_000_000_000
"""Default budget: two to five seconds."""

UNCONNECTED_SHARE = 0.4
"""Of the budget, for the cover without the constraint: it is the start and the bound."""

_BLOCK = 512  # columns whose shared areas are looked at at a time
_ROUNDING = 1e-9  # share of an overlap that rounding may have taken from it


@dataclass(frozen=True, slots=True)
class Overlap:
    """When two views count as joined; exactly one of the two is given.

    Attributes:
        area: they share at least this [m^2].
        share: they share at least this share of what the smaller of them measures, 0 to 1.
    """

    area: float | None = None
    share: float | None = None

    def __post_init__(self) -> None:
        if (self.area is None) == (self.share is None):
            raise PlannerError("an overlap is either an area or a share of the smaller view; give one of them")
        if self.area is not None and not (0 < self.area < np.inf):
            raise PlannerError(f"the overlap is {self.area} m^2; it must be a finite area above 0")
        if self.share is not None and not 0 < self.share <= 1:
            raise PlannerError(f"the overlap is a share of {self.share}; it must be above 0 and at most 1")


class OverlapStatus(Enum):
    """What became of the constraint; the value is the sentence for reports."""

    CONNECTED = "every view overlaps others so far that all scans hang together"
    CANNOT_CONNECT = "no choice of these candidates both covers what is asked for and hangs together"
    NOTHING_COVERABLE = "no allowed view measures any sample"


@dataclass(frozen=True, slots=True, eq=False)
class OverlapCover(Value):
    """Views that hang together, and what that costs.

    Attributes:
        cover: the views; its lower bound is that of the cover without the constraint, so it holds with it.
        status: whether they hang together.
        unconnected_views: number of views of the cover without the constraint.
        part: (n,) number of the connected part that each view belongs to; 0 is the one that measures most.
        part_area: (p,) area that each part measures [m^2].
        shared_area: (n, n) area that two views share [m^2], in the order of `cover.views`; the diagonal is their own.
        joined: (n, n) which of them are joined.
    """

    cover: Cover
    status: OverlapStatus
    unconnected_views: int
    part: Annotated[Ints, "n"]
    part_area: Annotated[Floats, "p"]
    shared_area: Annotated[Floats, "n n"]
    joined: Annotated[Bools, "n n"]

    def __post_init__(self) -> None:
        freeze(self, n=len(self.cover.views))

    @property
    def extra_views(self) -> int:
        """Price of the constraint: views more than the cover without it that was found."""
        return len(self.cover.views) - self.unconnected_views

    @property
    def sentence(self) -> str:
        """The status in words with its numbers."""
        n = len(self.cover.views)
        if self.status is OverlapStatus.NOTHING_COVERABLE:
            return OverlapStatus.NOTHING_COVERABLE.value
        if self.status is OverlapStatus.CANNOT_CONNECT:
            largest = int((self.part == 0).sum())
            share = 100 * self.part_area[0] / self.cover.coverable_area if self.cover.coverable_area else 0.0
            return (
                f"{self.status.value}: they fall into {len(self.part_area)} parts, and the largest, of {largest} of "
                f"{n} views, measures {share:.2f} % of what can be measured"
            )
        excess = self.cover.excess
        if excess <= 0:
            return "proven fewest for these candidates and samples that hang together"
        return beginning(self.cover.status) + (
            f"at most {excess} {'view' if excess == 1 else 'views'} more than the fewest that hang together, for these "
            "candidates and samples"
        )


def joined_columns(M: Any, areas: ArrayLike, overlap: Overlap) -> Graph:
    """Which columns of a matrix are joined.

    Args:
        M: (S, V) matrix, True where a column measures a row.
        areas: (S,) [m^2].
        overlap: when two count as joined.

    Returns:
        (V, V) 1 where joined, 0 on the diagonal.
    """
    matrix, weighted, own = _weighted(M, areas)
    n = matrix.shape[1]
    adjacent = np.zeros((n, n), dtype=np.uint8)
    for first in range(0, n, _BLOCK):  # shared areas of all pairs at once would be 8 bytes each
        some = slice(first, first + _BLOCK)
        shared = (matrix[:, some].T @ weighted).toarray()
        if overlap.area is not None:
            least: Any = overlap.area
        else:
            assert overlap.share is not None, "Overlap holds one of the two"
            least = overlap.share * np.minimum(own[some, None], own[None, :])
        adjacent[some] = (shared >= least * (1 - _ROUNDING)) & (shared > 0)
    np.fill_diagonal(adjacent, 0)
    return adjacent


def shared_areas(M: Any, areas: ArrayLike) -> Floats:
    """(V, V) area that each two columns share [m^2]; the diagonal is their own. Arguments as in `joined_columns`."""
    matrix, weighted, _ = _weighted(M, areas)
    return np.asarray((matrix.T @ weighted).toarray())


def _weighted(M: Any, areas: ArrayLike) -> tuple[Any, Any, Floats]:
    """The matrix, the matrix times areas, and the area of each column."""
    weights = np.asarray(areas, dtype=np.float64)
    matrix: Any = sp.csc_array(M, dtype=bool).astype(np.float64)
    weighted: Any = sp.csc_array(sp.diags_array(weights) @ matrix)
    return matrix, weighted, np.asarray(matrix.T @ weights)


def overlap_cover(
    M: Any,
    areas: ArrayLike,
    allowed: ArrayLike | None = None,
    *,
    overlap: Overlap,
    rng: np.random.Generator,
    coverage: float = 1.0,
    pinned: Iterable[int] = (),
    banned: Iterable[int] = (),
    budget: int = OVERLAP_WORK,
    time_limit_s: float | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> OverlapCover:
    """Choose few columns that cover the required share and hang together.

    Where no choice does both, the parts of the candidates' graph are covered one after the other, the one that measures
    most first, each by columns that hang together.

    Args:
        M: (S, V) measurability matrix.
        areas: (S,) area of each row [m^2].
        allowed: (V,) bool, which columns may be used; None: all.
        overlap: when two columns count as joined.
        rng: random choices of the search.
        coverage: share of the coverable area to be covered, 0 to 1.
        pinned: columns that must be part of the selection.
        banned: columns that must not.
        budget: units of work.
        time_limit_s: wall-clock guard [s].
        clock: seconds, for the guard.

    Raises:
        PlannerError: for input that `planner.cover.solve` refuses.
    """
    pinned, banned = list(pinned), list(banned)
    work = Budget(budget, time_limit_s, clock)
    free = solve(
        M, areas, allowed, rng=rng, coverage=coverage, pinned=pinned, banned=banned,
        budget=int(UNCONNECTED_SHARE * budget), clock=clock,
        time_limit_s=None if time_limit_s is None else UNCONNECTED_SHARE * time_limit_s,
    )  # fmt: skip
    work.spent = free.work
    work.time_limited = free.status is CoverStatus.TIME_LIMITED
    work.interrupted = free.status is CoverStatus.INTERRUPTED
    ready = prepare(M, areas, allowed, pinned, banned, coverage=coverage)
    problem = DemandProblem.of_cover(ready.found.problem)
    adjacent = joined_columns(ready.found.problem.matrix(), ready.found.areas[ready.found.rows], overlap)
    start = np.flatnonzero(np.isin(ready.found.columns, free.views))
    if problem.trivial and not len(start):
        chosen = start
    else:
        idle = len(ready.fixed) - len(ready.useful_fixed)  # counted in the bound, but not among the columns searched
        chosen = _connected_choice(problem, adjacent, start, ready.useful_fixed, rng, work, free.lower_bound - idle)
    cover = told(ready.found, ready.fixed, chosen, free.lower_bound, solver="overlap", work=work)
    return _result(ready, cover, overlap, len(free.views))


def _connected_choice(
    problem: DemandProblem,
    adjacent: Graph,
    start: Ints,
    fixed: Ints,
    rng: np.random.Generator,
    work: Budget,
    least: int,
) -> Ints:
    """Columns that meet the target and hang together; part after part of the graph where none do."""
    everything = parts_of(adjacent, np.arange(problem.n_columns))
    units = [_units(problem, np.flatnonzero(everything == k)) for k in range(int(everything.max(initial=-1)) + 1)]
    for k in sorted(range(len(units)), key=lambda part: -units[part]):
        columns = np.flatnonzero(everything == k)
        if not np.isin(fixed, columns).all() or not problem.met(columns):
            continue
        inside = problem.on_columns(columns)
        near = adjacent[np.ix_(columns, columns)]
        keep = np.searchsorted(columns, start[np.isin(start, columns)])
        held = np.searchsorted(columns, fixed)
        first = demand_search.join(near, demand_search.greedy(inside, np.union1d(keep, held)))
        return columns[demand_search.improve(inside, first, rng, work, adjacent=near, fixed=held, enough=least)]
    return _part_by_part(problem, adjacent, everything, units, fixed, rng, work)


def _part_by_part(
    problem: DemandProblem, adjacent: Graph, part: Ints, units: list[int], fixed: Ints, rng: np.random.Generator,
    work: Budget,
) -> Ints:  # fmt: skip
    """Every part of the graph covers what it can of what is still open, by columns that hang together."""
    chosen = np.zeros(0, dtype=np.int64)
    for k in sorted(range(len(units)), key=lambda number: -units[number]):
        columns = np.flatnonzero(part == k)
        held = np.searchsorted(columns, fixed[np.isin(fixed, columns)])
        if problem.met(chosen) and not len(held):
            continue
        open_rows = ~problem.satisfied(chosen) & problem.satisfied(np.union1d(chosen, columns))
        goal = sp.csr_array((problem.row_load, problem.row_columns, problem.row_start),
                            (problem.n_rows, problem.n_columns))[open_rows][:, columns]  # fmt: skip
        inside = DemandProblem.of(
            goal, problem.demand[open_rows], problem.units[open_rows].astype(np.float64), 0, full=True
        )
        near = adjacent[np.ix_(columns, columns)]
        first = demand_search.join(near, demand_search.greedy(inside, held))
        with work.portion(0.5):
            found = demand_search.improve(inside, first, rng, work, adjacent=near, fixed=held)
        chosen = np.union1d(chosen, columns[found])
    return chosen


def _units(problem: DemandProblem, columns: Ints) -> int:
    return int(problem.units[problem.satisfied(columns)].sum())


def _result(ready: Prepared, cover: Cover, overlap: Overlap, unconnected: int) -> OverlapCover:
    """The graph of the chosen views and its parts, the one that measures most first."""
    place = {int(column): k for k, column in enumerate(ready.found.columns)}
    problem, areas = ready.found.problem, ready.found.areas[ready.found.rows]
    n = len(cover.views)
    measured = np.zeros((problem.n_rows, n), dtype=bool)
    for k, view in enumerate(cover.views.tolist()):
        if view in place:
            measured[problem.rows_of([place[view]]), k] = True
    joined = joined_columns(measured, areas, overlap)
    labels = parts_of(joined, np.arange(n))
    by_part = [float(areas[measured[:, labels == k].any(axis=1)].sum()) for k in range(int(labels.max(initial=-1)) + 1)]
    order = sorted(range(len(by_part)), key=lambda k: (-by_part[k], k))
    rank = np.argsort(np.array(order, dtype=np.int64), kind="stable")
    if not problem.n_rows:
        status = OverlapStatus.NOTHING_COVERABLE
    else:
        whole = connected(joined, np.arange(n))
        status = OverlapStatus.CONNECTED if whole else OverlapStatus.CANNOT_CONNECT
    return OverlapCover(
        cover=cover,
        status=status,
        unconnected_views=unconnected,
        part=rank[labels] if n else labels,
        part_area=np.array([by_part[k] for k in order]),
        shared_area=shared_areas(measured, areas),
        joined=joined.astype(bool),
    )
