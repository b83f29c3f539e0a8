"""The most area with a given number of columns: greedy (Nemhauser, Wolsey, Fisher 1978), then tabu search over swaps.

Greedy covers at least 1 - 1/e of the most possible (doi:10.1007/BF01588971). The search looks at every swap of one
chosen column for another in each step. Work is counted in entries touched, so that equal seeds give equal selections.
"""

import numpy as np

from planner.cover.budget import Budget
from planner.cover.interrupts import ends_search
from planner.cover.canonical import CoverProblem
from planner.values import Ints

TENURES = 61
"""Drawn tenures; a prime, so that they do not fall into step with cycles of swaps."""

_CHUNK = 20_000_000  # work between two looks at the clock
_STEPS, _STEPS_BETWEEN = 20_000, 20  # swaps at the number of columns that is wanted, and at those on the way
_PAST = 3  # columns beyond the number wanted; coming back from there finds what growing alone does not


class AreaSearch:
    """A selection of columns of one size, which grows and shrinks by one and is improved in between."""

    def __init__(self, problem: CoverProblem, rng: np.random.Generator) -> None:
        from planner.cover import area_kernels  # importing numba costs 0.3 s

        self._kernels = area_kernels
        self.problem = problem
        self._sets = (problem.column_start, problem.column_rows, problem.row_start, problem.row_columns)
        self._units = problem.units.astype(np.int64)
        self._rng = rng
        self.set(np.zeros(0, dtype=np.int64))

    def set(self, columns: Ints) -> None:
        """Replace the selection."""
        problem = self.problem
        self.chosen = np.zeros(0, dtype=np.int64)
        self.area = 0
        self._counts = np.zeros(problem.n_rows, dtype=np.int64)
        owners = np.repeat(np.arange(problem.n_columns), np.diff(problem.column_start))
        self._gains = np.zeros(problem.n_columns, dtype=np.int64)
        np.add.at(self._gains, owners, self._units[problem.column_rows])
        for column in columns.tolist():
            self._add(column)

    def _add(self, column: int) -> None:
        self.area += int(self._kernels.add(*self._sets, self._units, self._counts, self._gains, column))
        self.chosen = np.append(self.chosen, column)

    def grow(self) -> bool:
        """Add the column that adds most, the first of equals; False where none adds anything."""
        if not len(self._gains) or self._gains.max() <= 0:
            return False
        self._add(int(np.argmax(self._gains)))
        return True

    def shrink(self) -> None:
        """Remove the column that loses least, the last of equals."""
        alone = self._counts == 1
        rows = self.problem
        losses = [
            int(self._units[own[alone[own]]].sum())
            for own in (rows.column_rows[rows.column_start[j] : rows.column_start[j + 1]] for j in self.chosen)
        ]
        position = len(losses) - 1 - int(np.argmin(losses[::-1]))
        column = int(self.chosen[position])
        self.area -= int(self._kernels.remove(*self._sets, self._units, self._counts, self._gains, column))
        self.chosen = np.delete(self.chosen, position)

    def improve(self, budget: Budget, steps: int, most: int | None = None) -> None:
        """Search from the selection and keep the best one found.

        Args:
            budget: work and clock.
            steps: steps at most.
            most: units that no selection of this size can exceed; the search ends where they are met.
        """
        if not len(self.chosen) or len(self.chosen) == self.problem.n_columns:
            return
        ceiling = int(self._units.sum()) if most is None else most
        tenures = self._rng.integers(1, 4 + min(len(self.chosen), 12), TENURES)
        tabu = np.zeros(self.problem.n_columns, dtype=np.int64)
        moving, best = self.chosen.copy(), self.chosen.copy()
        area = best_area = self.area
        step, work = 0, 0
        with ends_search(budget):
            while budget.spend(work) and step < steps and best_area < ceiling:
                # The kernel runs on past the ceiling until its chunk ends: short chunks where it is near.
                area, best_area, step, work = self._kernels.swap_search(
                    *self._sets, self._units, moving, self._counts, self._gains, tabu, best, tenures, area, best_area,
                    step, min(steps, step + 50), min(_CHUNK, max(budget.left, 1)),
                )  # fmt: skip
        self.set(best)


def search_most(
    problem: CoverProblem, size: int, rng: np.random.Generator, work: Budget, enough: int | None = None
) -> tuple[Ints, int]:
    """Columns with much area: grown one by one and improved in between, past the number wanted and back, then searched.

    Args:
        problem: rows with their units, and columns.
        size: how many columns.
        rng: random choices.
        work: work and clock.
        enough: units at which the search ends; None: all.

    Returns:
        At most `size` columns, and the units that they cover.
    """
    search = AreaSearch(problem, rng)
    best, area = search.chosen, 0
    while len(search.chosen) < min(size + _PAST, problem.n_columns) and search.grow():
        search.improve(work, _STEPS_BETWEEN)
        if len(search.chosen) <= size:
            best, area = search.chosen, search.area
    while len(search.chosen) > size:
        search.shrink()
        search.improve(work, _STEPS_BETWEEN)
    if search.area < area:
        search.set(best)
    search.improve(work, _STEPS, enough)
    return search.chosen, search.area
