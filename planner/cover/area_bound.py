"""Upper bounds on the area that k columns can cover, for every k at once: Lagrangian dual of maximal covering.

For multipliers 0 <= u_i <= w_i of the rows (Galvao, ReVelle 1996, doi:10.1016/0377-2217(94)00159-6; w: units)

    B_u(k) = sum_i (w_i - u_i) + the k largest of c_j(u) = sum_{i in j} u_i

is at least the units that any k columns cover: a row counts at most w_i - u_i by itself and u_i through its columns.
So one u bounds all k, and B_u is concave in k. min_u B_u(k) is the value of the linear relaxation, concave in k as
well, so that multipliers found for a few k bound those between almost as well. Whatever proposes u, the bound is B_u
evaluated here, and it holds.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from planner.cover.budget import STEP_WORK, Budget
from planner.cover.interrupts import ends_search
from planner.cover.canonical import CoverProblem
from planner.values import Floats, Ints, Value

ROUNDING = 1e-9
"""Added to every bound as a share of all units: far above the float error of B_u, far below what is reported."""

FIRST_STEP, LAST_STEP, SHRINK, PATIENCE, DEFLECTION = 0.5, 1e-3, 0.7, 10, 0.9
"""Constants of the subgradient steps (as in `planner.cover.bound`), tuned on visibility matrices."""

BOUT = 400
"""Steps for one number of columns before the one with the largest gap is chosen anew."""

FRESH_STEP = 0.1
"""Where a number of columns had its steps, this is where it begins again, once."""


@dataclass(frozen=True, slots=True, eq=False)
class AreaBounds(Value):
    """Upper bounds on the units that 0, 1, 2, ... columns cover.

    Attributes:
        units: (K + 1,) bound for each number of columns, not falling.
        multipliers: (S,) those that bound the last number best.
        column_value: (V,) c_j of these multipliers.
    """

    units: Annotated[Floats, "k"]
    multipliers: Annotated[Floats, "S"]
    column_value: Annotated[Floats, "V"]


def area_bounds(problem: CoverProblem, covered: Ints, budget: Budget, sizes: Iterable[int] | None = None) -> AreaBounds:
    """Bounds for 0 to K columns, as good as the budget allows; at budget 0 those of two evaluations.

    Args:
        problem: rows with their units, and columns; its target is not looked at.
        covered: (K + 1,) units that known selections of 0 to K columns cover; where a bound meets them, work ends.
        budget: work, charged as a whole.
        sizes: numbers of columns that are worked at; None: all of them.
    """
    everything = budget.spent + budget.left
    search = _Dual(problem, np.asarray(covered, dtype=np.int64))
    if sizes is not None:
        search.steps[~np.isin(np.arange(len(covered)), list(sizes))] = 0.0
    search.evaluate(problem.units)  # the k largest columns, overlaps counted twice
    try:
        with ends_search(budget):
            while (size := search.widest()) and budget.spend(0):
                search.lower(size, budget)
    finally:
        # The number of steps hangs on float rounding, which differs between machines; what is left must not.
        budget.spent = max(budget.spent, everything)
    return search.result()


class _Dual:
    """The best bounds so far, and for each number of columns the multipliers that gave its bound."""

    def __init__(self, problem: CoverProblem, covered: Ints) -> None:
        self.problem, self.covered = problem, covered
        self.rows_by_columns = problem.matrix()
        self.columns_by_rows = self.rows_by_columns.T.tocsr()
        self.total = int(problem.units.sum())
        # Areas are whole numbers of units: where all rows weigh the same, the covered area is a multiple of that.
        self.grain = int(np.gcd.reduce(problem.units.astype(np.int64))) if problem.n_rows else 1
        self.best: Floats = np.full(len(covered), float(self.total))
        self.best[0] = 0.0
        self.multipliers: list[Floats] = [problem.units] * len(covered)
        self.steps = np.full(len(covered), FIRST_STEP)
        self.steps[0] = 0.0

    def evaluate(self, u: Floats) -> tuple[Floats, Floats]:
        """B_u(k) for all k, and c; what they improve is kept."""
        value: Floats = np.asarray(self.columns_by_rows @ u)
        bound = np.full(len(self.best), float((self.problem.units - u).sum()))
        if len(value) and len(bound) > 1:
            largest = np.cumsum(np.sort(value)[::-1][: len(bound) - 1])
            bound[1:] += np.pad(largest, (0, len(bound) - 1 - len(largest)), mode="edge")
        for size in np.flatnonzero(bound < self.best):
            self.multipliers[size] = u
        self.best = np.minimum(self.best, bound)
        return bound, value

    def widest(self) -> int:
        """The number of columns with the largest gap of those that steps may still help; 0 where there is none."""
        gaps = np.array([self.certified(float(b)) for b in self.best], dtype=np.int64) - self.covered
        gaps[self.steps <= LAST_STEP] = 0
        return int(np.argmax(gaps)) if gaps.max() > 0 else 0

    def lower(self, size: int, budget: Budget) -> None:
        """A bout of deflected subgradient steps of Polyak's length on B_u(size), from the best multipliers of it."""
        problem, units = self.problem, self.problem.units
        work = 2 * problem.n_entries + STEP_WORK
        u = self.multipliers[size]
        direction = np.zeros(problem.n_rows)
        step, stalled, lowest, kept = float(self.steps[size]), 0, float("inf"), u
        for _ in range(BOUT):
            if self.certified(float(self.best[size])) <= int(self.covered[size]) or not budget.spend(work):
                break
            bound, value = self.evaluate(u)
            if bound[size] < lowest * (1 - 1e-6):
                lowest, stalled, kept = float(bound[size]), 0, u
            else:
                stalled += 1
            if stalled >= PATIENCE:
                step, stalled, u = step * SHRINK, 0, kept
                if step <= LAST_STEP:
                    break
                bound, value = self.evaluate(u)
            largest = np.zeros(problem.n_columns)
            largest[np.argsort(-value, kind="stable")[:size]] = 1.0
            gradient = self.rows_by_columns @ largest - 1.0
            direction = (1.0 - DEFLECTION) * gradient + DEFLECTION * direction
            # Rows at the edge of their range are not pushed beyond it.
            move = np.where(((u <= 0) & (direction > 0)) | ((u >= units) & (direction < 0)), 0.0, direction)
            length = float((units * move) @ (units * move))
            if length == 0.0:
                break
            # In shares of each row's units: rows of 1e-12 and of 1e6 then move alike.
            excess = max(float(bound[size]) - float(self.covered[size]), 0.0)
            u = np.clip(u - (step * excess / length) * (units * units) * move, 0.0, units)
        self.steps[size] = FRESH_STEP if self.steps[size] == FIRST_STEP else 0.0

    def certified(self, bound: float) -> int:
        """A bound as a whole number of units that certainly holds."""
        return min(int(bound + ROUNDING * self.total) // self.grain * self.grain, self.total)

    def result(self) -> AreaBounds:
        """The bounds, rounded safely, and the multipliers of the last number of columns."""
        units = np.array([self.certified(float(b)) for b in self.best], dtype=np.float64)
        last = self.multipliers[-1]
        # fewer columns cover no more: a bound for more columns is one for fewer
        return AreaBounds(np.minimum.accumulate(units[::-1])[::-1], last, np.asarray(self.columns_by_rows @ last))
