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

from dataclasses import dataclass

import numpy as np

from planner.cover.budget import Budget
from planner.cover.sets import Sets, blocks, gather, of_slices, packed, set_hash
from planner.values import Bools, Ints, Ints32

SHARE = 0.2
"""Share of the work left that one pass of subset tests may cost."""

PAIR_WORK, MEMBER_WORK = 3, 6
"""Charge of a subset test, and of packing a member."""

LARGE, WORTHWHILE = 200_000, 0.1
"""A matrix with more ones than this gets another round only when the last one removed at least this share of them."""


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


def reduce(sets: Sets, budget: Budget, *, only_forced: bool = False) -> Reduction:
    """Apply all reductions until nothing changes or no work is left.

    Args:
        sets: the problem.
        budget: charged.
        only_forced: take the forced columns and no more, which costs next to nothing.
    """
    found = Reduction(sets, np.zeros(0, dtype=np.int64), np.arange(sets.n_columns))
    with budget.ended_by_ctrl_c():
        again = not len(sets.adjacent)
        while again and not found.sets.trivial and (only_forced or budget.left):
            found, again = _round(found, budget, only_forced)
    return found


def _round(found: Reduction, budget: Budget, only_forced: bool) -> tuple[Reduction, bool]:
    """Every reduction once, and whether another round is worth it."""
    sets, forced, columns = found.sets, found.forced, found.columns
    shape, entries = sets.shape, sets.n_entries
    budget.spend((2 if only_forced else 15) * entries)
    must = _forced_columns(sets)
    if len(must):
        rest, left = sets.without(must)
        return Reduction(rest, np.concatenate((forced, columns[must])), columns[left]), True
    if only_forced or not sets.plain:
        return found, False
    sets = _merged(sets)
    stay = ~_dominated_columns(sets, budget)
    needed = ~_dominated_rows(sets, budget) if sets.full else np.ones(sets.n_rows, dtype=bool)
    if not (stay.all() and needed.all()):
        sets, columns = sets.restricted(needed, stay), columns[stay]
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
    ends = np.cumsum(lengths[previous[pairs]])
    for block in blocks(ends - lengths[previous[pairs]]):
        some = pairs[block]
        first, count = gather(start, members, previous[some])
        second, _ = gather(start, members, current[some])
        alike[some] = np.logical_and.reduceat(first == second, np.cumsum(count) - count)
    group = np.concatenate(([0], np.cumsum(~alike)))
    leader = order[np.concatenate(([True], ~alike))]
    summed = np.zeros(sets.n_rows, dtype=np.int64)
    np.add.at(summed, leader[group], sets.units[order])
    keep = np.zeros(sets.n_rows, dtype=bool)
    keep[leader] = True
    return sets.restricted(rows=keep, units=summed)


def _dominated_columns(sets: Sets, budget: Budget) -> Bools:
    """Columns whose rows enough others cover that cost no more; and columns without a row (theirs were dominated)."""
    sizes = np.diff(sets.column_start)
    most = of_slices(np.maximum, sets.column_start, sets.column_rows, sets.demand.__getitem__)
    group = np.where(sets.group_costs[sets.group] == 0, -1, sets.group)
    by_column = sets.column_start, sets.column_rows, sets.row_start, sets.row_columns
    gone: Bools = (sizes == 0) | _dominated(*by_column, sets.costs, group, most, budget)
    return gone


def _dominated_rows(sets: Sets, budget: Budget) -> Bools:
    """Rows that are covered whenever another row is, in a problem where every row must be covered."""
    by_row = sets.row_start, sets.row_columns, sets.column_start, sets.column_rows
    return _dominated(*by_row, sets.demand, np.full(sets.n_rows, -1), None, budget)


def _dominated(
    start: Ints, members: Ints32, of_start: Ints, of_member: Ints32, price: Ints, group: Ints, need: Ints | None,
    budget: Budget,
) -> Bools:  # fmt: skip
    """(N,) sets, as `members` from `start` on, that others make superfluous; none where the tests would cost too much.

    The sets of each member are told by `of_start` and `of_member`, the rest by `reduction_kernels.dominated`; without
    `need` it is the containing set that goes.
    """
    from planner.cover.reduction_kernels import dominated  # importing numba costs 0.3 s

    frequency, sizes, n_sets = np.diff(of_start), np.diff(start), len(start) - 1
    key = frequency.astype(np.int64) * len(frequency) + np.arange(len(frequency))
    rarest = of_slices(np.minimum, start, members, key.__getitem__) % max(len(frequency), 1)
    work = PAIR_WORK * int(frequency[rarest[sizes > 0]].sum()) + MEMBER_WORK * len(members)
    if not len(members) or work > SHARE * budget.left:
        return np.zeros(n_sets, dtype=bool)
    budget.spend(work)
    bits = packed(start, members, len(frequency))
    least = np.zeros(n_sets, dtype=np.int64) if need is None else need.astype(np.int64)
    sizes, of_start = sizes.astype(np.int64), of_start.astype(np.int64)
    gone: Bools = dominated(bits, sizes, rarest, of_start, of_member, price, group, least, need is None)
    return gone
