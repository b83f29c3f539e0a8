"""A matrix prepared for questions about area: canonical, with the pinned columns taken out."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from planner.cover.canonical import Candidates, CoverProblem, candidates, column_indices
from planner.cover.reductions import take
from planner.errors import PlannerError
from planner.values import Ints


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """What is searched, and the way back to the columns of the matrix.

    Attributes:
        found: the canonical problem and what it was made from.
        fixed: pinned columns of the matrix, ascending.
        useful_fixed: those of them that cover something, as columns of the canonical problem.
        problem: the rows that the pinned columns leave open, and the columns that cover any of them.
        columns: canonical column of each of its columns, ascending.
    """

    found: Candidates
    fixed: Ints
    useful_fixed: Ints
    problem: CoverProblem
    columns: Ints

    @property
    def base(self) -> int:
        """Units that the pinned columns cover."""
        return int(self.found.problem.units.sum()) - int(self.problem.units.sum())

    def canonical(self, columns: Ints) -> Ints:
        """Columns of the canonical problem: the pinned ones and those that were searched."""
        return np.concatenate((self.useful_fixed, self.columns[columns]))

    def inner(self, views: Ints) -> Ints:
        """Columns of what is searched for columns of the matrix; those that cover nothing more are left out."""
        place = np.full(max(int(self.found.columns.max(initial=-1)), int(views.max(initial=-1))) + 1, -1)
        place[self.found.columns[self.columns]] = np.arange(len(self.columns))
        inside = place[views]
        return np.asarray(inside[inside >= 0])

    def units(self, columns: Ints) -> int:
        """Units that columns of what is searched cover."""
        return int(self.problem.units[self.problem.counts(columns) > 0].sum())

    def fewest_for(self, units: int) -> int:
        """Views that a selection with as many units has at least: the largest columns, overlaps ignored."""
        if units <= self.base:
            return len(self.fixed)
        areas = np.add.reduceat(self.problem.units[self.problem.column_rows], self.problem.column_start[:-1])
        return len(self.fixed) + int(np.searchsorted(np.cumsum(np.sort(areas)[::-1]), units - self.base)) + 1


def prepare(
    M: Any,
    areas: ArrayLike,
    allowed: ArrayLike | None,
    pinned: Iterable[int],
    banned: Iterable[int],
    *,
    coverage: float = 1.0,
) -> Prepared:
    """Check the input and take the pinned columns.

    Raises:
        PlannerError: for input that `planner.cover.canonical.candidates` refuses, or a pinned column that is not allowed.
    """
    found = candidates(M, areas, allowed, coverage=coverage, banned=banned)
    n_columns = np.shape(M)[1]
    fixed = column_indices("pinned", pinned, n_columns)
    usable = np.ones(n_columns, dtype=bool) if allowed is None else np.array(allowed)
    usable[column_indices("banned", banned, n_columns)] = False
    if len(refused := fixed[~usable[fixed]]):
        raise PlannerError(f"pinned names column {refused[0]}, which is banned or not among the allowed columns")
    useful_fixed = np.flatnonzero(np.isin(found.columns, fixed))
    problem, columns = take(found.problem, useful_fixed)
    return Prepared(found, fixed, useful_fixed, problem, columns)
