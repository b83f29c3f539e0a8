"""Exact reductions of a cover problem: smaller, with the same best value, and the way back.

Applied in turn until nothing changes, on large matrices until little changes (see `WORTHWHILE`); Beasley 1987,
doi:10.1016/0377-2217(87)90141-X, and earlier work cited there:

* rows covered by the same columns, and as often, become one row with their summed area;
* a column is dropped when others of its group that cover all its rows cost no more, as many of them as the most
  demanding of its rows demands: a cover with the column but without one of them may exchange it, and a cover with all
  of them does not need it (of identical columns the first in canonical order stays);
* full cover only: a row is dropped when covering another row (whose columns are a subset of its own) as often as that
  one demands covers it often enough too;
* a row that cannot stay open and whose columns bring no more than it demands forces these columns.

Subset tests work on bit-packed sets, and only against the sets that share the rarest member. A pass of tests that would
cost more than `SHARE` of the work left is skipped as a whole. Where columns bring different loads only columns are
forced; where a graph must hold together nothing is reduced, since a column that covers nothing new may still join.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.cover.budget import Budget
from planner.cover.sets import Sets, gather, set_hash
from planner.values import Bools, Ints, Ints32

MOST_WORK, SHARE = 400_000_000, 0.2
"""Work that one pass of subset tests may cost, and share of what is left of the budget."""

SET_WORK, WORD_WORK = 9000, 2.0
"""Charge of the NumPy calls for one set, and of each 64-bit word that is compared."""

LARGE, WORTHWHILE = 200_000, 0.02
"""A matrix with more ones than this gets another round only when the last one removed at least this share of them."""

Admissible = Callable[[int, Ints32], Bools]


@dataclass(frozen=True, slots=True, eq=False)
class Reduction:
    """A smaller problem and how its covers become covers of the problem it was made from.

    Attributes:
        sets: what is left.
        forced: columns of the original problem that every best cover may be taken to contain.
        columns: (V',) original index of each column that is left, ascending.
    """

    sets: Sets
    forced: Ints
    columns: Ints

    def lift(self, columns: Ints) -> Ints:
        """A cover of the reduced problem as a cover of the original."""
        return np.concatenate((self.forced, self.columns[columns]))

    def left_of(self, columns: Ints) -> Ints:
        """Those columns of a cover of the original that are left, as columns of the reduced problem."""
        return np.searchsorted(self.columns, columns[np.isin(columns, self.columns)])


def reduce(sets: Sets, budget: Budget) -> Reduction:
    """Apply all reductions until nothing changes.

    Args:
        sets: the problem.
        budget: charged.
    """
    found = Reduction(sets, np.zeros(0, dtype=np.int64), np.arange(sets.n_columns))
    with budget.ended_by_ctrl_c():
        again = not len(sets.adjacent)
        while again and not found.sets.trivial:
            found, again = _round(found, budget)
    return found


def _round(found: Reduction, budget: Budget) -> tuple[Reduction, bool]:
    """Every reduction once, and whether another round is worth it."""
    sets, forced, columns = found.sets, found.forced, found.columns
    shape, entries = sets.shape, sets.n_entries
    budget.spend(20 * entries)
    must = _forced_columns(sets)
    if len(must):
        rest, left = sets.without(must)
        return Reduction(rest, np.concatenate((forced, columns[must])), columns[left]), True
    if not sets.plain:
        return found, False
    sets = _merged(sets)
    keep = ~_dominated_columns(sets, budget)
    if not keep.all():
        sets, columns = sets.restricted(columns=keep), columns[keep]
    if sets.full:
        keep = ~_dominated_rows(sets, budget)
        sets = sets if keep.all() else sets.restricted(rows=keep)
    least = WORTHWHILE * entries if entries > LARGE else 0.0
    again = sets.shape != shape and entries - sets.n_entries >= least
    return Reduction(sets, forced, columns), again


def _forced_columns(sets: Sets) -> Ints:
    """Columns without which a row that must not stay open cannot have what it demands."""
    if sets.most >= 0:
        return np.zeros(0, dtype=np.int64)
    must = np.flatnonzero(sets.units > sets.slack)
    columns, lengths = sets.columns_of(must)
    if sets.plain:
        return np.unique(columns[np.repeat(lengths <= sets.demand[must], lengths)]).astype(np.int64)
    loads, _ = gather(sets.row_start, sets.row_load, must)
    spare = np.add.reduceat(np.append(loads, 0), np.cumsum(lengths) - lengths) - sets.demand[must]
    return np.unique(columns[loads > np.repeat(spare, lengths)]).astype(np.int64)


def _merged(sets: Sets) -> Sets:
    """The first of each group of rows with the same columns and demand, with the group's units."""
    start, members = sets.row_start, sets.row_columns
    hashes, lengths = set_hash(start, members), np.diff(start)
    order = np.lexsort((np.arange(sets.n_rows), hashes, sets.demand, lengths))
    previous, current = order[:-1], order[1:]
    alike = (hashes[previous] == hashes[current]) & (lengths[previous] == lengths[current])
    alike &= sets.demand[previous] == sets.demand[current]
    pairs = np.flatnonzero(alike)
    if not len(pairs):
        return sets
    # Equal hashes are only a hint: the members are compared.
    first, count = gather(start, members, previous[pairs])
    second, _ = gather(start, members, current[pairs])
    alike[pairs] = np.logical_and.reduceat(first == second, np.cumsum(count) - count)
    group = np.concatenate(([0], np.cumsum(~alike)))
    leader = order[np.concatenate(([True], ~alike))]
    summed = np.zeros(sets.n_rows, dtype=np.int64)
    np.add.at(summed, leader[group], sets.units[order])
    keep = np.zeros(sets.n_rows, dtype=bool)
    keep[leader] = True
    return sets.restricted(rows=keep, units=summed)


def _dominated_columns(sets: Sets, budget: Budget) -> Bools:
    """Columns whose rows enough others cover that cost no more; and columns without a row (theirs were dominated)."""
    sizes, costs, group = np.diff(sets.column_start), sets.costs, sets.group
    free = sets.group_costs == 0
    dominated: Bools = sizes == 0

    def cheaper(j: int, others: Ints32) -> Bools:
        first = (sizes[others] > sizes[j]) | (costs[others] < costs[j]) | (others < j)
        same = (group[others] == group[j]) | free[group[others]]
        fit: Bools = (costs[others] <= costs[j]) & first & same
        return fit

    by_column = sets.column_start, sets.column_rows, sets.row_start, sets.row_columns
    for j, others in _supersets(*by_column, cheaper, budget):
        dominated[j] = len(others) >= int(sets.demand[sets.rows_of(j)].max())
    return dominated


def _dominated_rows(sets: Sets, budget: Budget) -> Bools:
    """Rows that are covered whenever another row is, in a problem where every row must be covered."""
    sizes, demand = np.diff(sets.row_start), sets.demand
    dominated = np.zeros(sets.n_rows, dtype=bool)

    def weaker(i: int, others: Ints32) -> Bools:
        if dominated[i]:
            return np.zeros(len(others), dtype=bool)  # what it would remove is removed by the row that removed it
        later = (sizes[others] > sizes[i]) | (demand[others] < demand[i]) | (others > i)
        fit: Bools = (demand[others] <= demand[i]) & later & ~dominated[others]
        return fit

    by_row = sets.row_start, sets.row_columns, sets.column_start, sets.column_rows
    for _, others in _supersets(*by_row, weaker, budget):
        dominated[others] = True
    return dominated


def _supersets(
    start: Ints, members: Ints32, of_start: Ints, of_member: Ints32, admissible: Admissible, budget: Budget
) -> Iterator[tuple[int, Ints32]]:
    """Each set with the admissible others that contain it, where there are any.

    Args:
        start: with `members` the sets.
        members: see there.
        of_start: with `of_member` the sets of each member.
        of_member: see there.
        admissible: which of some others count for a set.
        budget: charged; where the tests would cost too much there are none.
    """
    frequency, sizes = np.diff(of_start), np.diff(start)
    n_sets, words = len(start) - 1, (len(of_start) + 62) // 64
    filled = np.flatnonzero(sizes > 0)
    if not len(filled):
        return
    key = frequency[members] * len(frequency) + members
    rarest = np.zeros(n_sets, dtype=np.int64)
    rarest[filled] = np.minimum.reduceat(key, start[:-1][filled]) % len(frequency)
    work = int(WORD_WORK * words * float(frequency[rarest[filled]].sum())) + n_sets * SET_WORK
    if work > min(MOST_WORK, SHARE * budget.left):
        return
    budget.spend(work)
    bits = _packed(start, members, words)
    for j in filled.tolist():
        # Only sets that share its rarest member can contain it.
        others = of_member[of_start[rarest[j]] : of_start[rarest[j] + 1]]
        others = others[(sizes[others] >= sizes[j]) & (others != j)]
        others = others[admissible(j, others)]
        if len(others):
            others = others[~(bits[j] & ~bits[others]).any(axis=1)]
        if len(others):
            yield j, others


def _packed(start: Ints, members: Ints32, words: int) -> NDArray[np.uint64]:
    """The sets as (N, words) bit masks."""
    n_sets = len(start) - 1
    packed = np.zeros((n_sets, words * 8), dtype=np.uint8)
    block = max(1, 4_000_000 // (words * 64))  # bounds the unpacked block at 4 MB
    for first in range(0, n_sets, block):
        last = min(first + block, n_sets)
        dense = np.zeros((last - first, words * 64), dtype=bool)
        owner = np.repeat(np.arange(last - first), np.diff(start[first : last + 1]))
        dense[owner, members[start[first] : start[last]]] = True
        packed[first:last] = np.packbits(dense, axis=1)
    return packed.view(np.uint64)
