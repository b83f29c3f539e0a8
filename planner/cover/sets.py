"""The cover problem that is searched: whole numbers, rows and columns compressed both ways.

Rows demand a load, columns bring one to each of their rows. Two objectives, both whole numbers to be made small: the
cost of the columns that reach the required units, or, with a number of columns allowed, the units that stay open.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, DTypeLike, NDArray

from planner.values import Bools, Ints, Ints32, Value

Graph = NDArray[np.uint8]
"""(V, V) 1 where two columns are joined; (0, 0) where nothing has to hold together."""

_BLOCK = 100_000  # entries that are looked at at a time where nothing of them is kept: they stay in a near cache

SAME = 1e-6
"""Most area: selections that differ by no more than this share of all units count as equal (HiGHS's tolerance)."""


@dataclass(frozen=True, slots=True, eq=False)
class Sets(Value):
    """A cover problem; every row can be satisfied by all columns together.

    Attributes:
        row_start: (S + 1,) where the columns of each row begin in `row_columns`.
        row_columns: (nnz,) columns of each row, ascending within a row.
        row_load: (nnz,) what they bring, 1 to the row's demand; empty where everything brings 1.
        column_start: (V + 1,) where the rows of each column begin in `column_rows`.
        column_rows: (nnz,) rows of each column, ascending within a column.
        column_load: (nnz,) what it brings to them; empty where everything brings 1.
        demand: (S,) load that each row asks for, at least 1.
        units: (S,) weight of each row.
        required: units of satisfied rows that are asked for; ignored where `full`.
        full: whether every row must be satisfied.
        most: columns allowed for the most units; -1 where cost is what counts.
        costs: (V,) cost of each column, at least 1.
        group: (V,) group of each column.
        group_costs: (G,) what the first column of each group costs on top.
        adjacent: (V, V) joined columns; (0, 0) where none need to be.
        fixed: columns that must stay (pinned columns are taken out beforehand except where there is a graph).
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
    most: int
    costs: Annotated[Ints, "V"]
    group: Annotated[Ints, "V"]
    group_costs: Annotated[Ints, "G"]
    adjacent: Annotated[NDArray[np.uint8], "_ _"]
    fixed: Annotated[Ints, "_"]

    @property
    def n_rows(self) -> int:
        """Rows to be satisfied."""
        return len(self.row_start) - 1

    @property
    def n_columns(self) -> int:
        """Columns to choose from."""
        return len(self.column_start) - 1

    @property
    def n_entries(self) -> int:
        """Loads above zero."""
        return len(self.row_columns)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self.n_rows, self.n_columns

    @property
    def total(self) -> int:
        """Units of all rows."""
        return int(self.units.sum())

    @property
    def slack(self) -> int:
        """Units that may stay open."""
        return 0 if self.full else self.total - self.required

    @property
    def trivial(self) -> bool:
        """Whether no column is asked for."""
        if self.most >= 0:
            return self.most == 0 or self.n_rows == 0
        return self.n_rows == 0 if self.full else self.required <= 0

    @property
    def unit_cost(self) -> bool:
        """Whether cost is the number of columns."""
        return bool((self.costs == 1).all()) and not self.group_costs.any()

    @property
    def once(self) -> bool:
        """Whether one column is enough for every row."""
        return bool((self.demand == 1).all())

    @property
    def plain(self) -> bool:
        """Whether every column brings 1."""
        return not len(self.row_load)

    @property
    def tolerance(self) -> int:
        """Objectives that differ by no more than this count as equal."""
        return int(SAME * self.total) if self.most >= 0 else 0

    def cost(self, columns: ArrayLike) -> int:
        """What several columns cost together, with their groups."""
        chosen = np.asarray(columns, dtype=np.int64)
        return int(self.costs[chosen].sum()) + int(self.group_costs[np.unique(self.group[chosen])].sum())

    def objective(self, columns: Ints) -> int:
        """Cost, or open units where the number of columns is given; the smaller the better."""
        if self.most < 0:
            return self.cost(columns)
        return int(self.units[~self.covered(columns)].sum())

    def loads(self, columns: ArrayLike) -> Ints:
        """(S,) what the given columns bring to each row together."""
        which = np.asarray(columns, dtype=np.int64)
        rows, _ = gather(self.column_start, self.column_rows, which)
        if self.plain:
            return np.bincount(rows, minlength=self.n_rows)
        brought = gather(self.column_start, self.column_load, which)[0]
        return np.bincount(rows, weights=brought, minlength=self.n_rows).astype(np.int64)

    def covered(self, columns: ArrayLike) -> Bools:
        """(S,) which rows have what they demand."""
        satisfied: Bools = self.loads(columns) >= self.demand
        return satisfied

    def met(self, columns: ArrayLike) -> bool:
        """Whether columns reach what is asked for; exact. The graph is not looked at."""
        covered = self.covered(columns)
        if self.most >= 0:
            return np.size(columns) <= self.most
        return bool(covered.all()) if self.full else int(self.units[covered].sum()) >= self.required

    def columns_of(self, rows: ArrayLike) -> tuple[Ints, Ints]:
        """The columns of several rows, one row after the other, and how many each row has."""
        return gather(self.row_start, self.row_columns, np.asarray(rows, dtype=np.int64))

    def rows_of(self, column: int) -> Any:
        """(n,) the rows of a column."""
        return self.column_rows[self.column_start[column] : self.column_start[column + 1]]

    def load_of(self, column: int) -> Any:
        """What a column brings to each of its rows."""
        return 1 if self.plain else self.column_load[self.column_start[column] : self.column_start[column + 1]]

    def matrix(self) -> Any:
        """The (S, V) loads as a scipy csr_array of float64."""
        return _sparse(self.row_start, self.row_columns, self.row_load, self.shape, np.float64)

    def transposed(self) -> Any:
        """The same the other way round, (V, S)."""
        return _sparse(self.column_start, self.column_rows, self.column_load, self.shape[::-1], np.float64)

    def restricted(
        self, rows: Bools | None = None, columns: Bools | None = None, *, demand: Ints | None = None,
        units: Ints | None = None, required: int | None = None,
    ) -> "Sets":  # fmt: skip
        """The problem on some rows and columns (None: all), in the same order, with other numbers where given."""
        rows = np.ones(self.n_rows, dtype=bool) if rows is None else rows
        columns = np.ones(self.n_columns, dtype=bool) if columns is None else columns
        demand = (self.demand if demand is None else demand)[rows]
        M = _sparse(self.row_start, self.row_columns, self.row_load, self.shape, np.int8 if self.plain else np.int32)
        M = M if rows.all() else M[rows]
        M = M if columns.all() else M[:, columns]
        if not self.plain:
            M.data = np.minimum(M.data, np.repeat(demand, np.diff(M.indptr)))
        place = np.cumsum(columns) - 1
        return Sets(
            *both_ways(M), demand, (self.units if units is None else units)[rows],
            required=self.required if required is None else max(required, 0), full=self.full, most=self.most,
            costs=self.costs[columns], group=self.group[columns], group_costs=self.group_costs,
            adjacent=self.adjacent[np.ix_(columns, columns)] if len(self.adjacent) else self.adjacent,
            fixed=place[self.fixed[columns[self.fixed]]],
        )  # fmt: skip

    def without(self, chosen: Ints) -> tuple["Sets", Ints]:
        """What is left once some columns are chosen: the rest, and the (V',) index of its columns."""
        if not len(chosen):
            return self, np.arange(self.n_columns)
        loads = self.loads(chosen)
        waiting = loads < self.demand
        useful = np.bincount(self.columns_of(np.flatnonzero(waiting))[0], minlength=self.n_columns) > 0
        useful[chosen] = False
        rest = self.restricted(
            waiting, useful, demand=self.demand - np.minimum(loads, self.demand - 1),
            required=self.required - int(self.units[~waiting].sum()),
        )  # fmt: skip
        paid = self.group_costs.copy()
        paid[self.group[chosen]] = 0
        return replace(rest, group_costs=paid), np.flatnonzero(useful)


def _sparse(start: Ints, items: Ints32, load: Ints32, shape: tuple[int, int], dtype: DTypeLike) -> Any:
    """A scipy csr_array of the loads, 1 each where there are none; its indices are not copied where int32 will do."""
    data = load.astype(dtype) if len(load) else np.ones(len(items), dtype=dtype)
    start = start.astype(np.int32) if len(items) < 2**31 else start
    return sp.csr_array((data, items, start), shape=shape)


def both_ways(loads: Any) -> tuple[Ints, Ints32, Ints32, Ints, Ints32, Ints32]:
    """A sparse (S, V) matrix of loads by rows and by columns: the first six attributes of `Sets`."""
    loads.sort_indices()
    by_row, by_column = loads.tocsr(), loads.tocsc()
    some = by_row.data.max(initial=1) > 1
    row_load, column_load = (m.data[: None if some else 0].astype(np.int32) for m in (by_row, by_column))
    return by_row.indptr, by_row.indices, row_load, by_column.indptr, by_column.indices, column_load


def gather(start: Ints, items: NDArray[Any], which: Ints) -> tuple[NDArray[Any], Ints]:
    """Concatenate several slices of a compressed index array.

    Args:
        start: (N + 1,) where each slice begins.
        items: (nnz,) the slices, one after the other.
        which: (n,) the slices wanted.

    Returns:
        The wanted slices one after the other, and the (n,) length of each.
    """
    begin = start[which]
    lengths = start[which + 1] - begin
    if len(which) <= 12:  # below this a plain concatenation is faster than the index arithmetic
        parts = [items[a : a + n] for a, n in zip(begin.tolist(), lengths.tolist(), strict=True)]
        return (np.concatenate(parts) if parts else items[:0]), lengths
    ends = np.cumsum(lengths)
    index = np.arange(ends[-1]) + np.repeat(begin - (ends - lengths), lengths)
    return items[index], lengths


def set_hash(start: Ints, items: NDArray[np.integer]) -> NDArray[np.uint64]:
    """A 64-bit hash of each slice as a set (order does not matter), the same on every machine.

    The sum modulo 2^64 of SplitMix64 (Steele, Lea, Flood 2014, doi:10.1145/2660193.2660195) of the members.
    """

    def mixed(members: NDArray[np.integer]) -> NDArray[np.uint64]:
        z = (members.astype(np.uint64) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        return z ^ (z >> np.uint64(31))

    return of_slices(np.add, start, items, mixed)


def of_slices(
    ufunc: np.ufunc, start: Ints, items: NDArray[Any], worth: Callable[[NDArray[Any]], NDArray[Any]]
) -> NDArray[Any]:
    """(N,) what the members of each slice are worth, reduced by `ufunc`; 0 for an empty one."""
    found = np.zeros(len(start) - 1, dtype=worth(items[:0]).dtype)
    filled = np.flatnonzero(start[1:] > start[:-1])
    begin = start[filled]
    for some in blocks(begin):
        entries = slice(begin[some[0]], start[filled[some[-1]] + 1])
        found[filled[some]] = ufunc.reduceat(worth(items[entries]), begin[some] - begin[some[0]])
    return found


def blocks(begin: Ints) -> list[Ints]:
    """Numbers of consecutive slices, which begin there, of about `_BLOCK` entries together."""
    parts = np.split(np.arange(len(begin)), np.flatnonzero(np.diff(begin // _BLOCK)) + 1)
    return parts if len(begin) else []


def packed(start: Ints, members: NDArray[np.integer], n_members: int) -> NDArray[np.uint64]:
    """(N, words) slices as bit masks: member i is bit i % 64 of word i // 64."""
    n_sets, words = len(start) - 1, -(-n_members // 64)
    bits = np.zeros((n_sets, words * 8), dtype=np.uint8)
    block = max(1, 4_000_000 // (words * 64))  # bounds the unpacked block at 4 MB
    for first in range(0, n_sets, block):
        last = min(first + block, n_sets)
        dense = np.zeros((last - first, words * 64), dtype=bool)
        owner = np.repeat(np.arange(last - first), np.diff(start[first : last + 1]))
        dense[owner, members[start[first] : start[last]]] = True
        bits[first:last] = np.packbits(dense, axis=1, bitorder="little")
    return bits.view("<u8")
