"""Branch and bound over numbers of columns: can so many leave as little open as is allowed?

All questions without costs are this one: a full cover allows nothing to stay open, an area target so much, and with a
number of views allowed it is asked for less than the best choice leaves. Whatever k columns leave open is at least

    sum_i u_i - the k largest of sum_i a_ij u_i       for u_i >= 0, and u_i <= units_i where row i may stay open

(`planner.cover.bound`). At every node a few steps of the subgradient move u from where the node before left it
(Polyak's length towards what is allowed; Held, Wolfe, Crowder 1974, doi:10.1007/BF01580223): a step costs one pass over
what the node still holds, where a linear programme costs a thousand. Columns with which the bound would exceed what is
allowed are out. Then a column is put in, and out: of the row that must be covered and has the fewest, else of all, the
one of the largest sum.

Only rows that matter are asked about, those with a multiplier; that is a relaxation, so "none" is proven, and a choice
that fails on the others brings the rows that it leaves open. On few rows most columns are dominated by others, so that
the question is reduced before it is asked.
"""

from typing import TYPE_CHECKING

import numpy as np

from planner.cover.budget import Budget
from planner.cover.greedy import complete, prune
from planner.cover.reductions import reduce
from planner.cover.sets import Sets
from planner.values import Bools, Ints

if TYPE_CHECKING:
    from planner.cover.tree_kernels import Tree

CHUNK_WORK = 5_000_000
"""Work between two looks at the clock: about 10 ms."""

TOUCH_WORK = 0.4
"""Charge of what a tree counts as work: sums in a near cache."""

MORE_ROWS, LEAST_ROWS = 0.2, 20
"""Rows added when a choice fails on them: as a share of those there, and at least."""


def can_tell(sets: Sets) -> bool:
    """Whether a problem is such a question: no costs, and one column is enough for every row."""
    return sets.unit_cost and sets.plain and sets.once


def search(sets: Sets, rows: Bools, columns: Bools, aim: int, budget: Budget) -> tuple[Ints | None, bool]:
    """A choice whose objective is at most the aim, or None; and whether there certainly is none.

    With a number of columns allowed better choices go to the budget, and the tree goes on for still better ones.

    Args:
        sets: the problem.
        rows: (S,) rows to begin with.
        columns: (V,) columns that such a choice may contain.
        aim: objective that is asked for.
        budget: charged.
    """
    most, allowed = (sets.most, aim) if sets.most >= 0 else (aim, sets.slack)
    rows, names = rows.copy(), np.flatnonzero(columns)
    while budget.spend(12 * sets.n_entries):
        question = _Question(sets, rows, columns, most, allowed, budget)
        while (picked := question.answer(budget)) is not None:
            found = names[picked]
            better = prune(sets, complete(sets, found))
            if sets.objective(better) > aim:
                break
            if sets.most < 0 or not budget.offer(better, sets.objective(better)):
                return better, False
            aim = allowed = budget.objective - budget.tolerance - 1
            question.ask_for(allowed)
        if picked is None:
            return None, question.ended
        fresh = np.flatnonzero(~sets.covered(found) & ~rows)
        first = np.diff(sets.row_start)[fresh] if sets.full else -sets.units[fresh]
        rows[fresh[np.argsort(first, kind="stable")[: max(LEAST_ROWS, int(MORE_ROWS * rows.sum()))]]] = True
    return None, False


class _Question:
    """Whether so many columns leave little enough of some rows open: a tree that is grown until it ends.

    Attributes:
        ended: whether no choice does, or no other.
    """

    def __init__(self, sets: Sets, rows: Bools, columns: Bools, most: int, allowed: int, budget: Budget) -> None:
        from planner.cover import tree_kernels  # importing numba costs 0.3 s

        self._kernels = tree_kernels
        units = np.ones_like(sets.units) if sets.full else sets.units  # a full cover does not look at areas
        reached = sets.covered(np.flatnonzero(columns))
        self._bare = int(units[rows & ~reached].sum())  # stays open whatever is chosen
        rows = rows & reached
        required = int(units[rows].sum()) + self._bare - allowed
        inside = sets.restricted(rows, columns, units=units, required=required)
        self._reduction = reduce(inside, budget)
        left = most - len(self._reduction.forced)
        self.ended = left < 0 or allowed < self._bare
        self._tree = self._planted(self._reduction.sets, max(left, 0))
        self.ask_for(allowed)

    def _planted(self, sets: Sets, left: int) -> "Tree":
        """The root: everything is open, a row's multiplier is what it counts, which is best for one column."""
        k = self._kernels
        levels = np.zeros((k.TAKEN + 1, left + 2), dtype=np.int64)
        levels[[k.ROWS, k.COLUMNS, k.LEFT], 0] = sets.n_rows, sets.n_columns, left
        levels[[k.FIRST_ROW, k.FIRST_COLUMN, k.FIRST_ENTRY], 1] = sets.n_rows, sets.n_columns, sets.n_entries
        rows = np.stack((sets.units, sets.units)).astype(np.float64)
        columns = np.stack((np.arange(sets.n_columns), sets.column_start[:-1], sets.column_start[1:]))
        tree: Tree = k.Tree(
            np.zeros(4, dtype=np.int64), levels, rows, columns.astype(np.int64), sets.column_rows.astype(np.uint32),
            np.zeros(sets.n_columns), np.zeros(sets.n_rows), np.zeros(sets.n_rows, dtype=np.int64),
            np.zeros(left + 1, dtype=np.int64),
        )  # fmt: skip
        return tree

    def ask_for(self, allowed: int) -> None:
        """So much may stay open, from here on; no more than before."""
        self._tree.numbers[self._kernels.ALLOWED] = allowed - self._bare

    def answer(self, budget: Budget) -> Ints | None:
        """The next choice that is good enough; None where there is none, or no work is left."""
        k = self._kernels
        while not self.ended and budget.spend(0):
            tree = self._tree
            found = k.grow(tree, int(min(CHUNK_WORK, budget.left) / TOUCH_WORK))
            budget.spend(int(tree.numbers[k.WORK] * TOUCH_WORK))
            if found == k.FOUND:
                level, n_top = tree.numbers[[k.LEVEL, k.CHOSEN]]
                largest = tree.columns[k.ID, tree.levels[k.FIRST_COLUMN, level] + tree.top[:n_top]]
                return self._reduction.lift(np.concatenate((tree.levels[k.TAKEN, :level], largest)))
            if found == k.FULL:
                larger = (
                    np.concatenate((a, np.zeros_like(a)), axis=-1) for a in (tree.rows, tree.columns, tree.entries)
                )
                self._tree = tree._replace(**dict(zip(("rows", "columns", "entries"), larger, strict=True)))
            self.ended = found == k.NONE
        return None
