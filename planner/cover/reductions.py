"""Exact reductions of a cover problem: smaller, with the same least cost, and the way back.

Applied in turn until nothing changes, on large matrices until little changes (see `WORTHWHILE`); Beasley 1987,
doi:10.1016/0377-2217(87)90141-X, and earlier work cited there:

* rows covered by the same columns, and as often, become one row with their summed area;
* a column is dropped when others that cover all its rows cost no more, as many of them as the most demanding of its
  rows demands (one, where covering once is enough): a cover with the column but without one of them may exchange it,
  and a cover with all of them does not need it (of identical columns the first in canonical order stays);
* full cover only: a row is dropped when covering another row (whose columns are a subset of its own) as often as that
  one demands covers it often enough too;
* a row that cannot stay uncovered and has no more columns than it demands forces these columns.

Subset tests work on bit-packed sets, and only against the sets that share the rarest member. A test whose work (words
compared) exceeds `SUBSET_WORK` is skipped as a whole; this depends on the problem alone, never on time.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.cover.canonical import CoverProblem, gather, set_hash
from planner.values import Bools, Floats, Ints

SUBSET_WORK = 400_000_000
"""Largest number of 64-bit words that one pass of subset tests may compare (about half a second)."""

SET_WORK = 8000
"""What the NumPy calls for one set cost beyond the words they compare, in words."""

LARGE, WORTHWHILE = 200_000, 0.02
"""A matrix with more ones than this gets another round only when the last one removed at least this share of them."""


@dataclass(frozen=True, slots=True, eq=False)
class Reduction:
    """A smaller problem and how its covers become covers of the problem it was made from.

    Attributes:
        problem: what is left.
        forced: columns of the original problem that every fewest cover may be taken to contain.
        columns: (V',) original index of each column that is left, ascending.
        rows_merged: rows that vanished because others stand for them.
        columns_dominated: columns that vanished because others cover at least the same.
    """

    problem: CoverProblem
    forced: Ints
    columns: Ints
    rows_merged: int
    columns_dominated: int

    def lift(self, columns: Ints) -> Ints:
        """A cover of the reduced problem as a cover of the original."""
        return np.concatenate((self.forced, self.columns[columns]))


def take(problem: CoverProblem, columns: Ints) -> tuple[CoverProblem, Ints]:
    """What is left of a problem once some columns are chosen.

    Args:
        problem: the whole problem.
        columns: the chosen columns.

    Returns:
        The rest (their rows, and the columns that now cover nothing, are gone), and the (V',) index of its columns.
    """
    if not len(columns):
        return problem, np.arange(problem.n_columns)
    counts = problem.counts(columns)
    uncovered = counts < problem.demand
    open_columns, _ = problem.columns_of(np.flatnonzero(uncovered))
    useful = np.bincount(open_columns, minlength=problem.n_columns) > 0
    useful[columns] = False
    required = problem.required - int(problem.units[~uncovered].sum())
    rest = problem.restricted(uncovered, useful, problem.units, required, problem.demand - counts)
    return rest, np.flatnonzero(useful)


def reduce(problem: CoverProblem) -> Reduction:
    """Apply all reductions until nothing changes."""
    columns = np.arange(problem.n_columns)
    forced: list[Ints] = []
    merged = dominated = 0
    while not problem.trivial:
        before = problem.n_rows, problem.n_columns, problem.n_entries
        must = _forced_columns(problem)
        if len(must):
            forced.append(columns[must])
            problem, left = take(problem, must)
            columns = columns[left]
            continue
        units = problem.units
        keep_rows, units = _merge_identical_rows(problem, units)
        problem = _keep(problem, keep_rows, None, units)
        keep_columns = ~_dominated_columns(problem)
        dominated += int((~keep_columns).sum())
        problem = _keep(problem, None, keep_columns, problem.units)
        columns = columns[keep_columns]
        if problem.full:
            problem = _keep(problem, ~_dominated_rows(problem), None, problem.units)
        merged += before[0] - problem.n_rows
        if problem.shape == before[:2] or before[2] - problem.n_entries < _least_gain(before[2]):
            break
    chosen = np.concatenate(forced) if forced else np.zeros(0, dtype=np.int64)
    return Reduction(problem, chosen, columns, merged, dominated)


def _least_gain(n_entries: int) -> float:
    """Ones that a round must have removed for another one to be made."""
    return WORTHWHILE * n_entries if n_entries > LARGE else 0.0


def _keep(problem: CoverProblem, rows: Bools | None, columns: Bools | None, units: Floats) -> CoverProblem:
    """The problem on some rows and columns (None: all) with other units; no copy where all are kept."""
    if (rows is None or rows.all()) and (columns is None or columns.all()):
        return problem
    rows = np.ones(problem.n_rows, dtype=bool) if rows is None else rows
    columns = np.ones(problem.n_columns, dtype=bool) if columns is None else columns
    return problem.restricted(rows, columns, units, problem.required)


def _forced_columns(problem: CoverProblem) -> Ints:
    """All columns of the rows that must not stay uncovered and have no column to spare."""
    tight = np.diff(problem.row_start) <= problem.demand
    needed = np.flatnonzero(tight & (problem.units > problem.slack))
    return np.unique(problem.columns_of(needed)[0])


def _merge_identical_rows(problem: CoverProblem, units: Floats) -> tuple[Bools, Floats]:
    """The first of each group of rows with the same columns and demand, and the units with the group's sum on it."""
    start, members = problem.row_start, problem.row_columns
    hashes = set_hash(start, members)
    lengths = np.diff(start)
    order = np.lexsort((np.arange(problem.n_rows), hashes, problem.demand, lengths))
    previous, current = order[:-1], order[1:]
    alike = (hashes[previous] == hashes[current]) & (lengths[previous] == lengths[current])
    alike &= problem.demand[previous] == problem.demand[current]
    pairs = np.flatnonzero(alike)
    if not len(pairs):
        return np.ones(problem.n_rows, dtype=bool), units
    # Equal hashes are only a hint: the members are compared.
    first, count = gather(start, members, previous[pairs])
    second, _ = gather(start, members, current[pairs])
    alike[pairs] = np.logical_and.reduceat(first == second, np.cumsum(count) - count)
    group = np.concatenate(([0], np.cumsum(~alike)))
    leader = order[np.concatenate(([True], ~alike))]
    summed = np.zeros(problem.n_rows)
    np.add.at(summed, leader[group], units[order])
    keep = np.zeros(problem.n_rows, dtype=bool)
    keep[leader] = True
    return keep, summed


def _dominated_columns(problem: CoverProblem) -> Bools:
    """Columns whose rows enough others cover that cost no more; and columns without a row (theirs were dominated)."""
    start, members = problem.column_start, problem.column_rows
    sizes, costs = np.diff(start), problem.costs
    dominated: Bools = sizes == 0
    rarest = _rarest_members(start, members, np.diff(problem.row_start))
    bits = _packed(start, members, problem.n_rows, np.diff(problem.row_start)[rarest[sizes > 0]])
    if bits is None:
        return dominated
    for j in np.flatnonzero(~dominated):
        # Only columns that share its rarest row can contain it.
        others = problem.row_columns[problem.row_start[rarest[j]] : problem.row_start[rarest[j] + 1]]
        size, cost = sizes[j], costs[j]
        cheaper = (sizes[others] > size) | (costs[others] < cost) | (others < j)
        others = others[(sizes[others] >= size) & (costs[others] <= cost) & cheaper]
        if len(others):
            dominators = int((~(bits[j] & ~bits[others]).any(axis=1)).sum())
            demand = 1 if dominators == 0 else int(problem.demand[members[start[j] : start[j + 1]]].max())
            dominated[j] = dominators >= demand
    return dominated


def _dominated_rows(problem: CoverProblem) -> Bools:
    """Rows that are covered whenever another row is, in a problem where every row must be covered."""
    start, members = problem.row_start, problem.row_columns
    sizes, demand = np.diff(start), problem.demand
    dominated = np.zeros(problem.n_rows, dtype=bool)
    rarest = _rarest_members(start, members, np.diff(problem.column_start))
    bits = _packed(start, members, problem.n_columns, np.diff(problem.column_start)[rarest])
    if bits is None:
        return dominated
    for i in range(problem.n_rows):
        if dominated[i]:
            continue  # what it would remove is removed by the row that removed it
        others = problem.column_rows[problem.column_start[rarest[i]] : problem.column_start[rarest[i] + 1]]
        size = sizes[i]
        larger = (sizes[others] > size) | (demand[others] < demand[i]) | (others > i)
        others = others[(sizes[others] >= size) & (demand[others] <= demand[i]) & larger & ~dominated[others]]
        if len(others):
            dominated[others[~(bits[i] & ~bits[others]).any(axis=1)]] = True
    return dominated


def _rarest_members(start: Ints, members: Ints, frequency: Ints) -> Ints:
    """(N,) the member of each set that the fewest sets have; 0 for an empty set."""
    filled = np.diff(start) > 0
    rarest = np.zeros(len(start) - 1, dtype=np.int64)
    if filled.any():
        key = frequency[members] * len(frequency) + members
        rarest[filled] = np.minimum.reduceat(key, start[:-1][filled]) % len(frequency)
    return rarest


def _packed(start: Ints, members: Ints, n_members: int, comparisons: Ints) -> NDArray[np.uint64] | None:
    """The sets as (N, words) bit masks; None where that many comparisons of two sets would exceed `SUBSET_WORK`."""
    n_sets = len(start) - 1
    words = (n_members + 63) // 64
    if int(comparisons.sum()) * words + n_sets * SET_WORK > SUBSET_WORK:
        return None
    packed = np.zeros((n_sets, words * 8), dtype=np.uint8)
    block = max(1, 4_000_000 // (words * 64))  # bounds the unpacked block at 4 MB
    for first in range(0, n_sets, block):
        last = min(first + block, n_sets)
        dense = np.zeros((last - first, words * 64), dtype=bool)
        owner = np.repeat(np.arange(last - first), np.diff(start[first : last + 1]))
        dense[owner, members[start[first] : start[last]]] = True
        packed[first:last] = np.packbits(dense, axis=1)
    return packed.view(np.uint64)
