"""Local search with row weights: keep one column too few, swap until the target is met, repeat.

For full cover this follows RWLS (Gao, Weise, Li 2015, doi:10.1016/j.ejor.2015.05.038): whenever the target is met the
cover is kept and the column with the smallest loss is removed; otherwise one column leaves (smallest weighted loss, not
the one that came last), one that covers a randomly drawn uncovered row enters (largest weighted gain, not one that has
just left), ties to the one that moved longest ago, and every row that is still uncovered gains weight 1. The paper's
configuration checking is kept in its plainest form: what left in this step does not return in it.

Partial cover needs two changes. A row may stay uncovered for good, so the entering column is the best of all columns
rather than of one row's; and only a few random uncovered rows gain weight per step (their area once more), with all
weights drawn back towards the areas when they have grown, so that rows best left out do not come to dominate.

Weights are whole numbers in float64, so gains are exact and a run is the same on every machine.
"""

import numpy as np

from planner.cover.budget import STEP_WORK, Budget
from planner.cover.greedy import column_sums, greedy, prune
from planner.cover.problem import CoverProblem, Floats, Ints

AREA_WEIGHT = 1000
"""Partial cover: initial weight of a row of mean area (a resolution of 0.1 % of it)."""

BUMPED_ROWS = 4
"""Partial cover: rows that gain weight per step."""

FORGET_ABOVE, FORGET_TO = 3.0, 0.3
"""Partial cover: when the weights sum to this multiple of their start, their growth is scaled by the second number."""

_BLOCK = 4096  # random numbers drawn at a time
_NEVER = np.iinfo(np.int64).max


class _MovingCover:
    """A set of columns that changes one at a time, with the loss of removing each.

    Attributes:
        columns: the set, in no particular order.
        counts: (S,) how many of its columns cover each row.
        weights: (S,) weight of each row.
        loss: (V,) weight of the rows that only this column covers; meaningful for columns of the set.
        stamps: (V,) step in which each column last moved.
    """

    def __init__(self, problem: CoverProblem, columns: Ints, weights: Floats) -> None:
        self._starts = problem.column_start.tolist()
        self._rows = problem.column_rows
        self.columns: list[int] = []
        self.counts = np.zeros(problem.n_rows, dtype=np.int64)
        self._owner = np.zeros(problem.n_rows, dtype=np.int64)  # sum of the columns that cover a row
        self.weights = weights
        self.loss = np.zeros(problem.n_columns)
        self.stamps = np.zeros(problem.n_columns, dtype=np.int64)
        for column in columns.tolist():
            self.add(column, 0)

    def rows(self, column: int) -> Ints:
        """Rows that a column covers."""
        rows: Ints = self._rows[self._starts[column] : self._starts[column + 1]]
        return rows

    def add(self, column: int, step: int) -> Ints:
        """Add a column; returns the rows that it newly covers."""
        rows = self.rows(column)
        counts = self.counts[rows] + 1
        self.counts[rows] = counts
        fresh: Ints = rows[counts == 1]
        shared = rows[counts == 2]
        if len(shared):
            np.subtract.at(self.loss, self._owner[shared], self.weights[shared])
        self._owner[rows] += column
        self.loss[column] = self.weights[fresh].sum()
        self.columns.append(column)
        self.stamps[column] = step
        return fresh

    def remove(self, position: int, step: int) -> Ints:
        """Remove the column at a position of `columns`; returns the rows that it uncovers."""
        column = self.columns[position]
        self.columns[position] = self.columns[-1]
        self.columns.pop()
        rows = self.rows(column)
        counts = self.counts[rows] - 1
        self.counts[rows] = counts
        self._owner[rows] -= column
        alone = rows[counts == 1]
        if len(alone):
            np.add.at(self.loss, self._owner[alone], self.weights[alone])
        self.stamps[column] = step
        uncovered: Ints = rows[counts == 0]
        return uncovered

    def cheapest(self, tabu: int) -> int:
        """Position of the column with the smallest loss, oldest first; the tabu column only if there is no other."""
        columns = np.array(self.columns)
        key = _key(self.loss[columns], self.stamps[columns])
        if len(columns) > 1:
            key[columns == tabu] = _NEVER
        return int(key.argmin())

    def reweigh(self, weights: Floats) -> None:
        """Replace all weights and recompute the losses."""
        self.weights = weights
        alone = self.counts == 1
        self.loss[:] = np.bincount(self._owner[alone], weights=weights[alone], minlength=len(self.loss))


def _key(values: Floats, stamps: Ints) -> Ints:
    """Whole values with the stamp as tie-break, in one integer: the smallest value first, then the oldest."""
    key: Ints = (values.astype(np.int64) << 31) + stamps
    return key


def local_search(problem: CoverProblem, rng: np.random.Generator, budget: Budget) -> Ints:
    """Improve the budget's best cover (the greedy one if there is none) while work is left.

    Args:
        problem: what to cover.
        rng: draws the uncovered rows.
        budget: one step costs `STEP_WORK` and the entries that it touches.

    Returns:
        Columns of the best cover.
    """
    best = greedy(problem, rng, budget) if budget.best is None else budget.best
    if problem.trivial or problem.n_columns == 0:
        return best
    return _full(problem, best, rng, budget) if problem.full else _partial(problem, best, rng, budget)


def _full(problem: CoverProblem, best: Ints, rng: np.random.Generator, budget: Budget) -> Ints:
    """RWLS."""
    moving = _MovingCover(problem, best, np.ones(problem.n_rows))
    row_start, row_columns = problem.row_start.tolist(), problem.row_columns
    uncovered = np.zeros(0, dtype=np.int64)
    draws: list[float] = []
    tabu = -1
    step = 0
    work = STEP_WORK
    while budget.spend(work):
        step += 1
        while not len(uncovered):
            best = np.array(moving.columns, dtype=np.int64)
            budget.offer(best)
            if budget.proven or len(best) == 1:
                return best
            uncovered = moving.remove(moving.cheapest(-1), step)
        position = moving.cheapest(tabu)
        left = moving.columns[position]
        uncovered = np.concatenate((uncovered, moving.remove(position, step)))
        if not draws:
            draws = rng.random(_BLOCK).tolist()
        row = int(uncovered[int(draws.pop() * len(uncovered))])
        entering = row_columns[row_start[row] : row_start[row + 1]]
        columns, lengths = problem.columns_of(uncovered)
        weighted = column_sums(problem, columns, np.repeat(moving.weights[uncovered], lengths))
        key = _key(-weighted[entering], moving.stamps[entering])
        if len(entering) > 1:
            key[entering == left] = _NEVER
        tabu = int(entering[key.argmin()])
        moving.add(tabu, step)
        uncovered = uncovered[moving.counts[uncovered] == 0]
        moving.weights[uncovered] += 1.0
        work = STEP_WORK + 2 * len(columns) + 4 * (len(moving.rows(tabu)) + len(moving.rows(left)))
    return best


def _partial(problem: CoverProblem, best: Ints, rng: np.random.Generator, budget: Budget) -> Ints:
    """The variant for a target below full cover."""
    areas = np.maximum(np.rint(problem.units * (AREA_WEIGHT / problem.units.mean())), 1.0)
    moving = _MovingCover(problem, best, areas.copy())
    chosen = np.zeros(problem.n_columns, dtype=bool)
    chosen[best] = True
    uncovered = moving.counts == 0
    missing = int(problem.units[uncovered].sum()) - problem.slack
    gains = _weighted(problem, np.flatnonzero(uncovered), moving.weights)
    grown, start = float(areas.sum()), float(areas.sum())
    tabu = -1
    step = 0
    work = STEP_WORK
    while budget.spend(work):
        step += 1
        work = STEP_WORK + 2 * problem.n_columns
        while missing <= 0:
            best = prune(problem, np.array(moving.columns, dtype=np.int64))
            budget.offer(best)
            if budget.proven or len(best) == 1:
                return best
            position = moving.cheapest(-1)
            chosen[moving.columns[position]] = False
            lost = moving.remove(position, step)
            missing += int(problem.units[lost].sum())
            gains += _weighted(problem, lost, moving.weights)
        position = moving.cheapest(tabu)
        left = moving.columns[position]
        lost = moving.remove(position, step)
        chosen[left] = False
        gains += _weighted(problem, lost, moving.weights)
        key = _key(-gains, moving.stamps)
        key[chosen] = _NEVER
        key[left] = _NEVER if problem.n_columns > len(moving.columns) + 1 else key[left]
        tabu = int(key.argmin())
        chosen[tabu] = True
        fresh = moving.add(tabu, step)
        gains -= _weighted(problem, fresh, moving.weights)
        missing += int(problem.units[lost].sum()) - int(problem.units[fresh].sum())
        if missing > 0:
            open_rows = np.flatnonzero(moving.counts == 0)
            bumped = np.unique(open_rows[(rng.random(BUMPED_ROWS) * len(open_rows)).astype(np.int64)])
            moving.weights[bumped] += areas[bumped]
            gains += _weighted(problem, bumped, areas)
            grown += float(areas[bumped].sum())
            if grown > FORGET_ABOVE * start:
                moving.reweigh(areas + np.floor(FORGET_TO * (moving.weights - areas)))
                gains = _weighted(problem, open_rows, moving.weights)
                grown = float(moving.weights.sum())
                work += 10 * problem.n_rows
        touched = len(lost) + len(fresh)
        work += 2 * touched * (problem.n_entries // problem.n_rows) + 4 * len(moving.rows(tabu)) + problem.n_rows
    return best


def _weighted(problem: CoverProblem, rows: Ints, weights: Floats) -> Floats:
    """(V,) weight of the given rows that each column covers."""
    columns, lengths = problem.columns_of(rows)
    return column_sums(problem, columns, np.repeat(weights[rows], lengths))
