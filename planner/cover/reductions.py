"""Exact reductions of a cover problem: smaller, with the same fewest number of columns, and the way back.

Applied in turn until nothing changes, on large matrices until little changes (see `WORTHWHILE`); Beasley 1987,
doi:10.1016/0377-2217(87)90141-X, and earlier work cited there:

* rows covered by the same columns become one row with their summed area;
* a column whose rows another column covers too is dropped (of identical columns the first in canonical order stays);
* full cover only: a row is dropped when covering another row (whose columns are a subset of its own) covers it too;
* a row that cannot stay uncovered and has one column only forces this column.

Subset tests work on bit-packed sets, and only against the sets that share the rarest member. A test whose work (words
compared) exceeds `SUBSET_WORK` is skipped as a whole; this depends on the problem alone, never on time.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.cover.problem import CoverProblem, Floats, Ints, gather, set_hash

SUBSET_WORK = 400_000_000
"""Largest number of 64-bit words that one pass of subset tests may compare (about half a second)."""

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
    uncovered = problem.counts(columns) == 0
    open_columns, _ = problem.columns_of(np.flatnonzero(uncovered))
    useful = np.bincount(open_columns, minlength=problem.n_columns) > 0
    required = problem.required - int(problem.units[~uncovered].sum())
    return problem.restricted(uncovered, useful, problem.units, required), np.flatnonzero(useful)


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
        keep_columns = ~_dominated(
            problem.column_start, problem.column_rows, problem.row_start, problem.row_columns, larger_wins=True
        )
        dominated += int((~keep_columns).sum())
        problem = _keep(problem, None, keep_columns, problem.units)
        columns = columns[keep_columns]
        if problem.full:
            keep_rows = ~_dominated(
                problem.row_start, problem.row_columns, problem.column_start, problem.column_rows, larger_wins=False
            )
            problem = _keep(problem, keep_rows, None, problem.units)
        merged += before[0] - problem.n_rows
        if problem.shape == before[:2] or before[2] - problem.n_entries < _least_gain(before[2]):
            break
    chosen = np.concatenate(forced) if forced else np.zeros(0, dtype=np.int64)
    return Reduction(problem, chosen, columns, merged, dominated)


def _least_gain(n_entries: int) -> float:
    """Ones that a round must have removed for another one to be made."""
    return WORTHWHILE * n_entries if n_entries > LARGE else 0.0


def _keep(
    problem: CoverProblem, rows: NDArray[np.bool_] | None, columns: NDArray[np.bool_] | None, units: Floats
) -> CoverProblem:
    """The problem on some rows and columns (None: all) with other units; no copy where all are kept."""
    if (rows is None or rows.all()) and (columns is None or columns.all()):
        return problem
    rows = np.ones(problem.n_rows, dtype=bool) if rows is None else rows
    columns = np.ones(problem.n_columns, dtype=bool) if columns is None else columns
    return problem.restricted(rows, columns, units, problem.required)


def _forced_columns(problem: CoverProblem) -> Ints:
    """Columns that are the only one of a row which must not stay uncovered."""
    single = np.diff(problem.row_start) == 1
    needed = single & (problem.units > problem.slack)
    return np.unique(problem.row_columns[problem.row_start[:-1][needed]])


def _merge_identical_rows(problem: CoverProblem, units: Floats) -> tuple[NDArray[np.bool_], Floats]:
    """The first of each group of rows with the same columns, and the units with the group's sum on it."""
    start, members = problem.row_start, problem.row_columns
    hashes = set_hash(start, members)
    lengths = np.diff(start)
    order = np.lexsort((np.arange(problem.n_rows), hashes, lengths))
    previous, current = order[:-1], order[1:]
    alike = (hashes[previous] == hashes[current]) & (lengths[previous] == lengths[current])
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


def _dominated(
    start: Ints, members: Ints, member_start: Ints, member_sets: Ints, *, larger_wins: bool
) -> NDArray[np.bool_]:
    """Which sets are dominated: contained in another (`larger_wins`), or containing another.

    Of equal sets the first is not dominated by the later ones. An empty column (its rows were dominated) is dominated.

    Args:
        start: (N + 1,) where the members of each set begin.
        members: members of each set, one set after the other.
        member_start: (R + 1,) where the sets of each member begin.
        member_sets: sets that contain each member.
        larger_wins: for columns, True; for rows, False.
    """
    n_sets, n_members = len(start) - 1, len(member_start) - 1
    dominated = np.zeros(n_sets, dtype=bool)
    sizes = np.diff(start)
    frequency = np.diff(member_start)
    if not n_sets or not len(members):
        return dominated
    # The rarest member of each set: only the sets that share it can contain the set.
    key = frequency[members] * n_members + members
    filled = sizes > 0
    rarest = np.zeros(n_sets, dtype=members.dtype)
    rarest[filled] = np.minimum.reduceat(key, start[:-1][filled]) % n_members
    words = (n_members + 63) // 64
    if int(frequency[rarest].sum()) * words > SUBSET_WORK:
        return dominated
    bits = _packed(start, members, n_members)
    dominated[~filled] = larger_wins
    for small in np.flatnonzero(filled):
        member = rarest[small]
        others = member_sets[member_start[member] : member_start[member + 1]]
        size = sizes[small]
        if larger_wins:
            # equal sets: the earlier one wins, so only earlier ones count
            others = others[(sizes[others] > size) | ((sizes[others] == size) & (others < small))]
        else:
            if dominated[small]:
                continue  # what it would remove is removed by the set that removed it
            others = others[
                ((sizes[others] > size) | ((sizes[others] == size) & (others > small))) & ~dominated[others]
            ]
        if not len(others):
            continue
        contains = ~(bits[small] & ~bits[others]).any(axis=1)
        if larger_wins:
            dominated[small] = contains.any()
        else:
            dominated[others[contains]] = True
    return dominated


def _packed(start: Ints, members: Ints, n_members: int) -> NDArray[np.uint64]:
    """The sets as (N, words) bit masks."""
    n_sets = len(start) - 1
    words = (n_members + 63) // 64
    packed = np.zeros((n_sets, words * 8), dtype=np.uint8)
    block = max(1, 4_000_000 // (words * 64))  # bounds the unpacked block at 4 MB
    for first in range(0, n_sets, block):
        last = min(first + block, n_sets)
        dense = np.zeros((last - first, words * 64), dtype=bool)
        owner = np.repeat(np.arange(last - first), np.diff(start[first : last + 1]))
        dense[owner, members[start[first] : start[last]]] = True
        packed[first:last] = np.packbits(dense, axis=1)
    return packed.view(np.uint64)
