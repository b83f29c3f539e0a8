"""Lower bounds on the objective of a cover problem: Lagrangian dual, certified by one evaluation in float64.

For multipliers u >= 0 of the rows (Beasley 1990, doi:10.1002/1520-6750(199002)37:1<151::AID-NAV3220370110>3.0.CO;2-2),
with A the loads as shares of their row's demand (cut at 1, which no choice can use more of) and z the groups' costs

    L(u) = min { sum_i u_i y_i } + sum_groups min(0, z_g + sum_{j in g} min(0, c_j - sum_i A_ij u_i))

is at most the least cost. y says which rows are covered: all of them for a full cover; otherwise the cheapest
fractional choice that reaches the required area, and holds every row that is larger than what may stay open (a knapsack
solved by sorting u_i / area_i). With k columns allowed, the units that any k columns leave open are at least

    L_k(u) = sum_i u_i - the k largest of sum_i A_ij u_i          for 0 <= u_i <= units_i

(Galvao, ReVelle 1996, doi:10.1016/0377-2217(94)00159-6), for every k at once. max_u L(u) is the bound of the linear
relaxation (`planner.cover.linear` proposes u). Whatever proposes u, the bound is L(u) evaluated here and rounded up to
a whole number after taking off more than float64 can have added: a tolerance inside a solver can weaken it but never
make it wrong.

Where no column satisfies a row alone and loads differ, sums of shares are a weak description: two columns of 0.9 each
are needed, and their sum asks for 1.1. Such a row gets a second one: at least r columns, r being how many of its
largest shares it takes (a Chvatal-Gomory cut). Both share y_i.
"""

from math import ceil
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from planner.cover.budget import Budget
from planner.cover.sets import Sets, of_slices
from planner.values import Bools, Floats, Ints

ROUNDING = 1e-6
"""Taken off a cost before rounding up (above a bound of 1000 in proportion): far above the float error of L(u)."""

AREA_ROUNDING = 1e-9
"""Taken off a bound on open units, as a share of all units: far above the float error of L_k(u)."""

FIRST_STEP, LAST_STEP, SHRINK, PATIENCE, DEFLECTION = 0.5, 1e-3, 0.7, 10, 0.9
"""Constants of the subgradient steps, tuned on visibility matrices."""

STEP_WORK, STEP_WORK_PER_ENTRY = 60_000, 1.5
"""Charge of a step, and of each entry of the matrix."""


class Relaxation:
    """The best bound so far, and what its multipliers say of each column.

    Attributes:
        A: (R, V) shares, the second rows last.
        At: (V, R) the same, transposed.
        owner: (R,) row of the problem that each row of A belongs to.
        dual: L(u) of the best multipliers.
        multipliers: (R,) u.
        penalty: (V,) what L(u) rises by at least when a column is used; for the area: when it is used though it is not
            among the largest.
        value_of: (V,) sum of the last multipliers over each column's rows (most area).
        size: number of columns that dual and penalty are about; -1 where cost counts.
        state: (V,) 1 for columns that are in, -1 for those that are out, 0 for the others; dual and penalty are about
            choices like that, everything else about all.
        open_units: (k + 1,) lower bounds on the units that 0, 1, ... k columns leave open; empty where cost counts.
    """

    def __init__(self, sets: Sets) -> None:
        """Evaluate the first multipliers."""
        self.sets, self.size = sets, sets.most
        self.A, self.owner = _shares(sets)
        self.At = sets.transposed() if sets.once else sp.csr_array(self.A.T)
        self.units = sets.units.astype(np.float64)
        self.open_units = np.zeros(sets.most + 1)
        self._must = sets.units > sets.slack
        self.dual, self.penalty = -np.inf, np.zeros(sets.n_columns)
        self.state = np.zeros(sets.n_columns, dtype=np.int8)
        self.multipliers = self.value_of = np.zeros(len(self.owner))
        first = np.zeros(len(self.owner))
        if sets.most >= 0:
            first[: sets.n_rows] = self.units
        else:
            # Feasible: each row's share of the best of its columns, so that no reduced cost is negative.
            weights = np.ones(sets.n_rows) if sets.full else self.units
            own = self.At if len(self.owner) == sets.n_rows else self.At[:, : sets.n_rows]
            worth = (own @ weights) / sets.costs
            largest = of_slices(np.maximum, sets.row_start, sets.row_columns, worth.__getitem__)
            np.divide(weights, largest, out=first[: sets.n_rows], where=largest > 0)
        self.evaluate(first)

    @property
    def value(self) -> int:
        """No choice has a smaller objective."""
        if self.sets.most >= 0:
            return self.certified_units(self.size)
        return max(ceil(self.dual - _rounding(self.dual)), 0)

    def aim_at(self, size: int) -> None:
        """Bound the units that so many columns leave open: up to the number allowed."""
        self.size, self.dual = size, -np.inf
        self.evaluate(self.multipliers)

    def reachable(self, state: NDArray[np.int8]) -> bool:
        """Whether a choice with these columns in and out may meet what is asked for."""
        if self.size >= 0:
            return int((state > 0).sum()) <= self.size
        enough = (self.A @ (state >= 0))[: self.sets.n_rows] >= 1.0 - ROUNDING  # shares are rounded
        return bool(enough.all()) if self.sets.full else int(self.sets.units[enough].sum()) >= self.sets.required

    def fix(self, state: NDArray[np.int8]) -> None:
        """Bound choices with these columns in and out (`state`)."""
        self.state, self.dual = state, -np.inf
        self.evaluate(self.multipliers)

    def excludes(self, objective: int) -> bool:
        """Whether no choice like `state` has an objective of at most this."""
        return self.dual > objective + self._margin(objective)

    def certified_units(self, size: int) -> int:
        """Units that so many columns certainly leave open."""
        total = self.sets.total
        grain = int(np.gcd.reduce(self.sets.units)) if self.sets.n_rows else 1  # all sums of units are multiples of it
        return max(ceil((float(self.open_units[size]) - AREA_ROUNDING * total) / grain) * grain, 0)

    def useful(self, objective: int) -> Bools:
        """(V,) columns that some choice may contain whose objective is at most this (reduced-cost fixing)."""
        fit: Bools = self.dual + self.penalty <= objective + self._margin(objective)
        return fit

    def _margin(self, objective: int) -> float:
        return AREA_ROUNDING * self.sets.total if self.sets.most >= 0 else _rounding(objective)

    def evaluate(self, u: Floats) -> float:
        """L(u); kept where it is the best."""
        of_row: Floats = np.bincount(self.owner, u, self.sets.n_rows).astype(np.float64, copy=False)
        if self.sets.most >= 0:
            over = self.units / np.maximum(of_row, self.units)
            u, of_row = u * over[self.owner], of_row * over
            return self._evaluate_area(u, of_row)
        reduced = self.sets.costs - self.At @ u
        chosen = self.state > 0
        below = np.where(chosen, reduced, np.minimum(reduced, 0.0) * (self.state == 0))
        rest = self.sets.group_costs + np.bincount(self.sets.group, below, len(self.sets.group_costs))
        opened = np.isin(np.arange(len(rest)), self.sets.group[chosen])
        dual = self._cheapest_rows(of_row) + float(np.where(opened, rest, np.minimum(rest, 0.0)).sum())
        if dual > self.dual:
            self.dual, self.multipliers = dual, u
            self.penalty = np.maximum(reduced, 0.0) + (np.maximum(rest, 0.0) * ~opened)[self.sets.group]
        return dual

    def _cheapest_rows(self, of_row: Floats) -> float:
        """The least of u y over choices of rows that reach the required area."""
        sets = self.sets
        if sets.full:
            return float(of_row.sum())
        free = np.flatnonzero(~self._must)
        missing = float(sets.required - int(sets.units[self._must].sum()))
        order = free[np.argsort(of_row[free] / self.units[free], kind="stable")]
        before = np.concatenate(([0.0], np.cumsum(self.units[order])))
        share = np.clip((missing - before[:-1]) / self.units[order], 0.0, 1.0)
        return float(of_row[self._must].sum() + share @ of_row[order])

    def _evaluate_area(self, u: Floats, of_row: Floats) -> float:
        value = self.value_of = np.asarray(self.At @ u)
        chosen, free = self.state > 0, self.state == 0
        n_chosen = int(chosen.sum())
        largest = np.sort(value[free])[::-1][: len(self.open_units) - 1 - n_chosen]
        open_units = np.full(len(self.open_units) - n_chosen, float(of_row.sum() - value[chosen].sum()))
        open_units[1:] -= np.pad(np.cumsum(largest), (0, len(open_units) - 1 - len(largest)), mode="edge")
        if free.all():
            self.open_units = np.maximum(self.open_units, open_units)
        size = min(self.size - n_chosen, len(largest))
        dual = float(open_units[self.size - n_chosen])
        if dual > self.dual:
            self.dual, self.multipliers = dual, u
            # where no more may enter, none that is free will
            self.penalty = np.maximum(largest[size - 1] - value, 0.0) if size else value * 0.0 + self.sets.total
        return dual


def climb(relaxation: Relaxation, known: int, budget: Budget) -> None:
    """Most area: deflected subgradient steps of Polyak's length (Camerini, Fratta, Maffioli 1975).

    With few columns nearly every row stays open in part, and the linear programme has too many rows to begin with; the
    steps come near it at two products with the matrix each (doi:10.1007/BFb0120697). They move in shares of each row's
    units, so that rows of 1e-12 and of 1e6 move alike.

    Args:
        relaxation: receives the multipliers.
        known: units that a known choice leaves open.
        budget: charged for each step.
    """
    units, work = relaxation.units, STEP_WORK_PER_ENTRY * relaxation.A.nnz + STEP_WORK
    u = kept = relaxation.multipliers
    direction = np.zeros(len(units))
    step, stalled, highest = FIRST_STEP, 0, -np.inf
    while step > LAST_STEP and relaxation.value < known and budget.spend(work):
        dual = relaxation.evaluate(u)
        stalled = stalled + 1 if dual <= highest + 1e-7 * abs(highest) else 0
        if dual > highest:
            highest, kept = dual, u
        if stalled >= PATIENCE:
            step, stalled, u = step * SHRINK, 0, kept
            dual = relaxation.evaluate(u)
        chosen = np.zeros(relaxation.sets.n_columns)
        chosen[np.argsort(-relaxation.value_of, kind="stable")[: relaxation.size]] = 1.0
        direction = (1.0 - DEFLECTION) * (1.0 - relaxation.A @ chosen) + DEFLECTION * direction
        stuck = ((u <= 0) & (direction < 0)) | ((u >= units) & (direction > 0))
        move = np.where(stuck, 0.0, direction)
        length = float((units * move) @ (units * move))
        if length == 0.0:
            break
        u = np.clip(u + step * max(known - dual, 0.0) / length * units * units * move, 0.0, units)


def _shares(sets: Sets) -> tuple[Any, Ints]:
    """The loads as shares of their row's demand with the second rows, and the row that each belongs to."""
    A = sets.matrix()
    rows = np.arange(sets.n_rows)
    if sets.once:
        return A, rows
    A.data /= np.repeat(sets.demand, np.diff(sets.row_start))
    if sets.plain:
        return A, rows
    need = np.ones(sets.n_rows, dtype=np.int64)
    for row in rows:
        brings = np.sort(sets.row_load[sets.row_start[row] : sets.row_start[row + 1]])[::-1]
        if brings[:1].sum() < sets.demand[row]:
            need[row] = int(np.searchsorted(np.cumsum(brings), sets.demand[row])) + 1
    twice = np.flatnonzero(need > 1)
    counted = sp.csr_array(A[twice])
    counted.data = 1.0 / np.repeat(need[twice], np.diff(counted.indptr))
    return sp.csr_array(sp.vstack((A, counted))), np.concatenate((rows, twice))


def _rounding(value: float) -> float:
    """What float error may have added to a bound of this size, generously."""
    return ROUNDING * max(1.0, value * 1e-3)
