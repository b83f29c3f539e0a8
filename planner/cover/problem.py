"""The cover problem: as the caller states it, and as the solvers search it.

    select columns C, each at a cost, such that the demand of enough rows is satisfied

    minimise    sum_{j in C} cost_j + sum of the fixed costs of the groups that C touches
    subject to  the rows i with sum_{j in C} load_ij >= demand_i reach the required area
                C contains the pinned columns and none of the banned ones
                the overlap graph of C is connected, if an overlap is required

With `max_views` the problem is maximum coverage: at most `max_views` columns, and the largest area. Set cover, k views
a row, coverage under pose errors (loads are logarithms of probabilities), partial coverage, costs in seconds and
several set-ups of the part (groups) are cases of this one problem, `CoverProblem`. `planner.cover.solve` solves it.

`CoverInstance` is the same problem in integers, stored by rows and by columns. Its two objectives, both minimised, are
the cost of columns that reach the required area, and the uncovered area for a given number of columns.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, DTypeLike, NDArray

from planner.errors import PlannerError
from planner.values import Bools, Ints, Ints32, Value

Graph = NDArray[np.uint8]
"""(V, V) 1 where two columns overlap enough; (0, 0) if no overlap is required."""

NO_GRAPH: Graph = np.zeros((0, 0), dtype=np.uint8)

OBJECTIVE_TOLERANCE = 1e-6
"""Maximum coverage: selections that differ by at most this share of all units count as equal (HiGHS's tolerance)."""

_SLICE_BLOCK = 100_000  # entries that are reduced together: temporary arrays of this size stay in the CPU cache
_GRAPH_BLOCK = 512  # columns whose shared areas are computed together: all pairs at once would take 8 bytes each
_OVERLAP_ROUNDING = 1e-9  # share of an overlap that rounding may have removed


@dataclass(frozen=True, slots=True)
class Overlap:
    """Smallest overlap of two views that counts as an edge of the overlap graph; exactly one of the two is given.

    Scans can be registered to each other if the graph of overlapping views is connected (Scott, Roth, Rivest, "View
    planning with a registration constraint", 3DIM 2001, doi:10.1109/IM.2001.924423).

    Attributes:
        area: shared area [m^2].
        share: shared area as a share of the smaller measured area of the two views, 0 to 1.
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


@dataclass(frozen=True, slots=True, eq=False)
class CoverProblem:
    """A cover problem in the rows and columns of the caller; it is checked when it is solved.

    Attributes:
        matrix: (S, V) scipy sparse or dense. True if column j (a viewpoint) measures row i (a sample); int64 if columns
            contribute different loads.
        areas: (S,) area of each row [m^2], finite, not negative.
        allowed: (V,) bool, usable columns (the reachable ones); None: all.
        coverage: required share of the coverable area, 0 to 1; 1 means every coverable row.
        max_views: largest number of columns, whose area is maximised; None: the cost for the coverage is minimised.
        demand: load that each row demands, 1 or more, or (S,) of them. If all usable columns together do not reach it,
            the row demands all of them.
        costs: (V,) cost of each column, finite, above zero (seconds, for example); None: 1 each.
        pinned: columns that must be selected.
        banned: columns that must not be selected; what they alone cover is not coverable.
        group: (V,) group 0, 1, ... of each column (its set-up, for example); None: no groups.
        group_costs: (G,) fixed cost of each group with a selected column, zero or more.
        overlap: edges of the overlap graph, which must be connected; None: it need not be.
        weights: (S,) weight of each row, in place of its area, in the coverage; None: its area. With `max_views` the
            areas of the answer are these weights.
        region: (S,) region 0, 1, ... of each row, if regions have their own targets.
        region_coverage: in place of `coverage`, the required share of the coverable area (or weight) of each region.
    """

    matrix: Any
    areas: ArrayLike
    allowed: ArrayLike | None = None
    coverage: float = 1.0
    max_views: int | None = None
    demand: int | NDArray[np.int64] = 1
    costs: ArrayLike | None = None
    pinned: Sequence[int] = ()
    banned: Sequence[int] = ()
    group: ArrayLike | None = None
    group_costs: ArrayLike | None = None
    overlap: Overlap | None = None
    weights: ArrayLike | None = None
    region: ArrayLike | None = None
    region_coverage: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class CoverInstance(Value):
    """An integer cover problem in which all columns together satisfy every row.

    Attributes:
        row_start: (S + 1,) begin of the columns of each row in `row_columns`.
        row_columns: (nnz,) columns of each row, ascending within a row.
        row_load: (nnz,) their loads, from 1 to the row's demand; empty if all loads are 1.
        column_start: (V + 1,) begin of the rows of each column in `column_rows`.
        column_rows: (nnz,) rows of each column, ascending within a column.
        column_load: (nnz,) its loads; empty if all loads are 1.
        demand: (S,) load that each row demands, at least 1.
        units: (S,) weight of each row.
        required: required units of satisfied rows; ignored if `full`.
        full: whether every row must be satisfied.
        max_columns: number of columns for maximum coverage; None: the cost is minimised.
        costs: (V,) cost of each column, at least 1.
        group: (V,) group of each column.
        group_costs: (G,) fixed cost of each group with a selected column.
        adjacent: overlap graph of the columns.
        fixed: columns that must stay. Pinned columns are removed beforehand unless there is an overlap graph.
    """

    row_start: Annotated[Ints, "S+1"]
    row_columns: Annotated[Ints32, "nnz"]
    row_load: Annotated[Ints32, "_"]
    column_start: Annotated[Ints, "V+1"]
    column_rows: Annotated[Ints32, "nnz"]
    column_load: Annotated[Ints32, "_"]
    demand: Annotated[Ints, "S"]
    units: Annotated[Ints, "S"]
    required: int
    full: bool
    max_columns: int | None
    costs: Annotated[Ints, "V"]
    group: Annotated[Ints, "V"]
    group_costs: Annotated[Ints, "G"]
    adjacent: Annotated[NDArray[np.uint8], "_ _"]
    fixed: Annotated[Ints, "_"]

    @property
    def n_rows(self) -> int:
        """Number of rows."""
        return len(self.row_start) - 1

    @property
    def n_columns(self) -> int:
        """Number of columns."""
        return len(self.column_start) - 1

    @property
    def n_entries(self) -> int:
        """Number of loads above zero."""
        return len(self.row_columns)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self.n_rows, self.n_columns

    @property
    def total_units(self) -> int:
        """Units of all rows."""
        return int(self.units.sum())

    @property
    def slack(self) -> int:
        """Units that may stay uncovered."""
        return 0 if self.full else self.total_units - self.required

    @property
    def maximises_area(self) -> bool:
        """Whether this is a maximum coverage problem."""
        return self.max_columns is not None

    @property
    def needs_no_column(self) -> bool:
        """Whether the empty selection is optimal."""
        if self.maximises_area:
            return self.max_columns == 0 or self.n_rows == 0
        return self.n_rows == 0 if self.full else self.required <= 0

    @property
    def has_unit_costs(self) -> bool:
        """Whether the cost is the number of columns."""
        return bool((self.costs == 1).all()) and not self.group_costs.any()

    @property
    def has_unit_demand(self) -> bool:
        """Whether one column satisfies each row."""
        return bool((self.demand == 1).all())

    @property
    def has_unit_loads(self) -> bool:
        """Whether every load is 1."""
        return not len(self.row_load)

    @property
    def tolerance(self) -> int:
        """Difference up to which objectives count as equal."""
        return int(OBJECTIVE_TOLERANCE * self.total_units) if self.maximises_area else 0

    def cost(self, columns: ArrayLike) -> int:
        """Return the cost of columns and of their groups."""
        selected = np.asarray(columns, dtype=np.int64)
        return int(self.costs[selected].sum()) + int(self.group_costs[np.unique(self.group[selected])].sum())

    def objective(self, columns: Ints) -> int:
        """Return the cost, or the uncovered units of a maximum coverage problem."""
        return int(self.units[~self.satisfied(columns)].sum()) if self.maximises_area else self.cost(columns)

    def loads(self, columns: ArrayLike) -> Ints:
        """Return the (S,) load of each row by all given columns together."""
        which = np.asarray(columns, dtype=np.int64)
        rows, _ = gather_slices(self.column_start, self.column_rows, which)
        if self.has_unit_loads:
            return np.bincount(rows, minlength=self.n_rows)
        loads = gather_slices(self.column_start, self.column_load, which)[0]
        return np.bincount(rows, weights=loads, minlength=self.n_rows).astype(np.int64)

    def satisfied(self, columns: ArrayLike) -> Bools:
        """Return (S,) whether the demand of each row is satisfied."""
        satisfied: Bools = self.loads(columns) >= self.demand
        return satisfied

    def is_feasible(self, columns: ArrayLike) -> bool:
        """Return whether columns reach the target, exactly; the overlap graph is ignored."""
        if self.max_columns is not None:
            return np.size(columns) <= self.max_columns
        satisfied = self.satisfied(columns)
        return bool(satisfied.all()) if self.full else int(self.units[satisfied].sum()) >= self.required

    def allows_more(self, n_columns: int) -> bool:
        """Return whether another column may be added to this number of columns."""
        return self.max_columns is None or n_columns < self.max_columns

    def columns_of(self, rows: ArrayLike) -> tuple[Ints, Ints]:
        """Return the columns of several rows, one row after the other, and the number of columns of each."""
        return gather_slices(self.row_start, self.row_columns, np.asarray(rows, dtype=np.int64))

    def rows_of(self, column: int) -> Any:
        """Return the (n,) rows of a column."""
        return self.column_rows[self.column_start[column] : self.column_start[column + 1]]

    def load_of(self, column: int) -> Any:
        """Return the load of a column for each of its rows."""
        if self.has_unit_loads:
            return 1
        return self.column_load[self.column_start[column] : self.column_start[column + 1]]

    def matrix(self) -> Any:
        """Return the (S, V) loads as a scipy csr_array of float64."""
        return _sparse(self.row_start, self.row_columns, self.row_load, self.shape, np.float64)

    def transposed(self) -> Any:
        """Return the (V, S) loads as a scipy csr_array of float64."""
        return _sparse(self.column_start, self.column_rows, self.column_load, self.shape[::-1], np.float64)

    def restricted(
        self,
        rows: Bools | None = None,
        columns: Bools | None = None,
        *,
        demand: Ints | None = None,
        units: Ints | None = None,
        required: int | None = None,
    ) -> "CoverInstance":
        """Return the problem on some rows and columns (None: all), in the same order, with other numbers if given."""
        rows = np.ones(self.n_rows, dtype=bool) if rows is None else rows
        columns = np.ones(self.n_columns, dtype=bool) if columns is None else columns
        demand = (self.demand if demand is None else demand)[rows]
        dtype = np.int8 if self.has_unit_loads else np.int32
        M = _sparse(self.row_start, self.row_columns, self.row_load, self.shape, dtype)
        M = M if rows.all() else M[rows]
        M = M if columns.all() else M[:, columns]
        if not self.has_unit_loads:
            M.data = np.minimum(M.data, np.repeat(demand, np.diff(M.indptr)))
        new_index = np.cumsum(columns) - 1
        return CoverInstance(
            *compress(M),
            demand=demand,
            units=(self.units if units is None else units)[rows],
            required=self.required if required is None else max(required, 0),
            full=self.full,
            max_columns=self.max_columns,
            costs=self.costs[columns],
            group=self.group[columns],
            group_costs=self.group_costs,
            adjacent=self.adjacent[np.ix_(columns, columns)] if len(self.adjacent) else self.adjacent,
            fixed=new_index[self.fixed[columns[self.fixed]]],
        )

    def residual(self, selected: Ints) -> tuple["CoverInstance", Ints]:
        """Return the problem that remains once columns are selected, and the (V',) index of its columns."""
        if not len(selected):
            return self, np.arange(self.n_columns)
        loads = self.loads(selected)
        waiting = loads < self.demand
        useful = np.bincount(self.columns_of(np.flatnonzero(waiting))[0], minlength=self.n_columns) > 0
        useful[selected] = False
        residual = self.restricted(
            waiting,
            useful,
            demand=self.demand - np.minimum(loads, self.demand - 1),
            required=self.required - int(self.units[~waiting].sum()),
        )
        group_costs = self.group_costs.copy()
        group_costs[self.group[selected]] = 0
        return replace(residual, group_costs=group_costs), np.flatnonzero(useful)


def _sparse(start: Ints, items: Ints32, load: Ints32, shape: tuple[int, int], dtype: DTypeLike) -> Any:
    """Return a csr_array of the loads (1 each if there are none); its indices are not copied if int32 is enough."""
    data = load.astype(dtype) if len(load) else np.ones(len(items), dtype=dtype)
    start = start.astype(np.int32) if len(items) < 2**31 else start
    return sp.csr_array((data, items, start), shape=shape)


def compress(loads: Any) -> tuple[Ints, Ints32, Ints32, Ints, Ints32, Ints32]:
    """Return the first six attributes of `CoverInstance` for a sparse (S, V) matrix of loads."""
    loads.sort_indices()
    by_row, by_column = loads.tocsr(), loads.tocsc()
    has_loads = by_row.data.max(initial=1) > 1
    row_load, column_load = (m.data[: None if has_loads else 0].astype(np.int32) for m in (by_row, by_column))
    return by_row.indptr, by_row.indices, row_load, by_column.indptr, by_column.indices, column_load


def gather_slices(start: Ints, items: NDArray[Any], which: Ints) -> tuple[NDArray[Any], Ints]:
    """Concatenate several slices of a compressed index array.

    Args:
        start: (N + 1,) begin of each slice.
        items: (nnz,) the slices, one after the other.
        which: (n,) numbers of the slices to return.

    Returns:
        These slices one after the other, and the (n,) length of each.
    """
    begin = start[which]
    lengths = start[which + 1] - begin
    if len(which) <= 12:  # up to this number concatenation is faster than index arithmetic
        parts = [items[a : a + n] for a, n in zip(begin.tolist(), lengths.tolist(), strict=True)]
        return (np.concatenate(parts) if parts else items[:0]), lengths
    ends = np.cumsum(lengths)
    index = np.arange(ends[-1]) + np.repeat(begin - (ends - lengths), lengths)
    return items[index], lengths


def set_hash(start: Ints, items: NDArray[np.integer]) -> NDArray[np.uint64]:
    """Return a 64-bit hash of each slice as a set (independent of order), the same on every machine.

    It is the sum modulo 2^64 of SplitMix64 (Steele, Lea, Flood 2014, doi:10.1145/2660193.2660195) of the members.
    """

    def mixed(members: NDArray[np.integer]) -> NDArray[np.uint64]:
        z = (members.astype(np.uint64) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        return z ^ (z >> np.uint64(31))

    return reduce_slices(np.add, start, items, mixed)


def reduce_slices(
    ufunc: np.ufunc, start: Ints, items: NDArray[Any], value: Callable[[NDArray[Any]], NDArray[Any]]
) -> NDArray[Any]:
    """Return the (N,) values of the members of each slice, reduced by `ufunc`; 0 for an empty slice."""
    reduced = np.zeros(len(start) - 1, dtype=value(items[:0]).dtype)
    filled = np.flatnonzero(start[1:] > start[:-1])
    begin = start[filled]
    for block in slice_blocks(begin):
        entries = slice(begin[block[0]], start[filled[block[-1]] + 1])
        reduced[filled[block]] = ufunc.reduceat(value(items[entries]), begin[block] - begin[block[0]])
    return reduced


def slice_blocks(begin: Ints) -> list[Ints]:
    """Group the numbers of consecutive slices, given their begins, into blocks of about `_SLICE_BLOCK` entries."""
    blocks = np.split(np.arange(len(begin)), np.flatnonzero(np.diff(begin // _SLICE_BLOCK)) + 1)
    return blocks if len(begin) else []


def pack_bits(start: Ints, members: NDArray[np.integer], n_members: int) -> NDArray[np.uint64]:
    """Return (N, words) slices as bit masks: member i is bit i % 64 of word i // 64."""
    n_sets, words = len(start) - 1, -(-n_members // 64)
    bits = np.zeros((n_sets, words * 8), dtype=np.uint8)
    block = max(1, 4_000_000 // (words * 64))  # limits the unpacked block to 4 MB
    for first in range(0, n_sets, block):
        last = min(first + block, n_sets)
        dense = np.zeros((last - first, words * 64), dtype=bool)
        owner = np.repeat(np.arange(last - first), np.diff(start[first : last + 1]))
        dense[owner, members[start[first] : start[last]]] = True
        bits[first:last] = np.packbits(dense, axis=1, bitorder="little")
    return bits.view("<u8")


def overlap_adjacency(M: Any, areas: ArrayLike, overlap: Overlap) -> Graph:
    """Return the (V, V) overlap graph of the columns of a matrix: 1 for an edge, 0 on the diagonal.

    Args:
        M: (S, V) matrix, True if a column measures a row.
        areas: (S,) [m^2].
        overlap: smallest overlap of an edge.
    """
    matrix: Any = sp.csc_array(M, dtype=bool).astype(np.float64)
    weighted: Any = sp.csc_array(sp.diags_array(np.asarray(areas, dtype=np.float64)) @ matrix)
    n = matrix.shape[1]
    column_areas = np.asarray(weighted.sum(axis=0)).ravel()
    adjacent = np.zeros((n, n), dtype=np.uint8)
    for first in range(0, n, _GRAPH_BLOCK):
        block = slice(first, first + _GRAPH_BLOCK)
        shared = (matrix[:, block].T @ weighted).toarray()
        required: Any = overlap.area
        if overlap.share is not None:
            required = overlap.share * np.minimum(column_areas[block, None], column_areas[None, :])
        adjacent[block] = (shared >= required * (1 - _OVERLAP_ROUNDING)) & (shared > 0)
    np.fill_diagonal(adjacent, 0)
    return adjacent


def graph_components(adjacent: Graph, columns: Ints) -> Ints:
    """Return the (n,) connected component of each column, numbered by the first column of each component."""
    from scipy.sparse.csgraph import connected_components  # delays start-up

    if not len(columns):
        return np.zeros(0, dtype=np.int64)
    _, labels = connected_components(adjacent[np.ix_(columns, columns)], directed=False)
    return np.asarray(labels, dtype=np.int64)


def is_connected(adjacent: Graph, columns: Ints) -> bool:
    """Return whether the graph of columns is connected; the graphs of no and of one column are."""
    return len(adjacent) == 0 or len(columns) < 2 or int(graph_components(adjacent, columns).max()) == 0


def connect(adjacent: Graph, columns: Ints) -> Ints:
    """Add columns on shortest paths between components until the graph is connected.

    The largest component grows towards the nearest other one (Takahashi, Matsuyama 1980, for Steiner trees).

    Raises:
        AssertionError: if no path exists; the caller checks before.
    """
    selected = list(dict.fromkeys(columns.tolist()))
    while not is_connected(adjacent, np.array(selected)):
        members = np.array(selected, dtype=np.int64)
        labels = graph_components(adjacent, members)
        home = members[labels == int(np.bincount(labels).argmax())]
        goal = np.zeros(len(adjacent), dtype=bool)
        goal[np.setdiff1d(members, home)] = True
        predecessor = np.full(len(adjacent), -2, dtype=np.int64)  # -2: not visited, -1: of the home component
        predecessor[home] = -1
        front, reached_goal = home, -1
        while reached_goal < 0:
            assert len(front), "the components cannot be connected"
            reached = (adjacent[front] == 1) & (predecessor == -2)[None, :]
            visited = np.flatnonzero(reached.any(axis=0))
            predecessor[visited] = front[reached[:, visited].argmax(axis=0)]
            hits = visited[goal[visited]]
            reached_goal = int(hits[0]) if len(hits) else -1
            front = visited
        column = reached_goal
        while predecessor[column] >= 0:
            column = int(predecessor[column])
            if column not in selected:
                selected.append(column)
    return np.array(selected, dtype=np.int64)
