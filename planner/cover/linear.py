"""The linear programme of a cover problem in HiGHS, with the rows that matter and no others.

A matrix of thousands of samples has a few hundred rows that decide. The model begins with the rows of fewest columns;
its solution is held against all rows, those that it violates most are added, and the dual simplex goes on from where it
stood, until no row is violated. The multipliers of every stage bound the whole problem (`planner.cover.bound`). Where
rows may stay open, each row of the model has a variable for the share that does.

HiGHS runs on one thread and is stopped by iterations, so that runs repeat; Ctrl-C is heard.
"""

from typing import Any

import highspy
import numpy as np
from highspy import HighsBasisStatus, kHighsInf
from numpy.typing import NDArray

from planner.cover.bound import Relaxation
from planner.cover.budget import Budget, interruptible
from planner.values import Floats, Ints

CALL_WORK, ENTRY_WORK = 500_000, 25
"""Charge of every call of HiGHS, and of handing over each entry."""

PIVOT_WORK, SIZE_WORK, PRICE_WORK, FACTOR_WORK = 3000, 7, 1.0, 2.0
"""Charge of a simplex iteration, of each row and column of the model, of each entry that pricing touches, of each entry
of the factors of the basis: fitted to processor time on measurability matrices, roots and trees (`Model.work`)."""

FILLED = 20
"""With so many entries in each column of the basis its factors have no zeros left."""

PIVOTS = 300
"""Iterations of the linear programme between two looks at the basis."""

MORE_ROWS, LEAST_ROWS = 0.2, 20
"""Violated rows added at a time: as a share of those there, and at least."""

VIOLATED = 1e-6
"""A row is violated where this share of its demand is missing."""

SLACKER = 1e-7
"""Share of all units by which the area asked of HiGHS is eased, so that its tolerance excludes nothing."""


class Model:
    """Some rows of a problem in HiGHS, and what is asked for.

    Attributes:
        inside: (R,) which rows of the relaxation are in the model.
    """

    def __init__(self, relaxation: Relaxation, rows: Ints) -> None:
        """The linear relaxation with some rows."""
        sets = relaxation.sets
        self.relaxation, self.sets, self.A = relaxation, sets, relaxation.A
        self.inside = np.zeros(self.A.shape[0], dtype=bool)
        self._order: list[Ints] = []
        self._slack_of = np.full(sets.n_rows, -1)
        self._weights = sets.units / max(float(sets.units.mean()), 1e-300) if sets.n_rows else relaxation.units
        self._scale = float(sets.costs.mean())
        self._heads = self._basic = 0
        self.highs = _highs()
        self._state = np.zeros(sets.n_columns, dtype=np.int8)
        self._limit = np.inf if sets.full and sets.plain and sets.once else 1.0
        every = self._variables(sets.n_columns, self._limit, 0.0 if sets.most >= 0 else sets.costs / self._scale)
        if sets.most >= 0:
            self._head(-kHighsInf, float(sets.most), every, np.ones(len(every)))
        elif not sets.full:
            self._head(-kHighsInf, (sets.slack + SLACKER * sets.total) / float(sets.units.mean()), [], [])
        self._groups()
        self.add(rows)

    def _variables(self, count: int, upper: float, costs: Any) -> Ints:
        """Add variables from 0 to a limit; their numbers."""
        first = self.highs.getNumCol()
        self.highs.addVars(count, np.zeros(count), np.full(count, upper))
        index = np.arange(first, first + count, dtype=np.int32)
        self.highs.changeColsCost(count, index, np.broadcast_to(np.asarray(costs, dtype=np.float64), count).copy())
        return index.astype(np.int64)

    def _head(self, lower: float, upper: float, index: Any, values: Any) -> None:
        """A row that is not one of the problem's."""
        self.highs.addRow(lower, upper, len(index), np.asarray(index, np.int32), np.asarray(values, np.float64))
        self._heads += 1

    def _groups(self) -> None:
        """A variable for each group with a cost, at least as large as each of its columns."""
        for g in np.flatnonzero(self.sets.group_costs).tolist():
            opened = int(self._variables(1, 1.0, self.sets.group_costs[g] / self._scale)[0])
            for j in np.flatnonzero(self.sets.group == g).tolist():
                self._head(0.0, kHighsInf, np.array([opened, j]), np.array([1.0, -1.0]))

    def add(self, rows: Ints) -> None:
        """Put rows of the relaxation into the model."""
        sets, owner = self.sets, self.relaxation.owner[rows]
        if not sets.full:
            fresh = np.unique(owner[self._slack_of[owner] < 0])
            # A row that is larger than what may stay open must be covered.
            limit = np.where(sets.units[fresh] > sets.slack, 0.0, 1.0) if sets.most < 0 else np.ones(len(fresh))
            costs = self._weights[fresh] if sets.most >= 0 else 0.0
            index = self._variables(len(fresh), 1.0, costs)
            self.highs.changeColsBounds(len(index), index.astype(np.int32), np.zeros(len(index)), limit)
            self._slack_of[fresh] = index
            for k, i in zip(index.tolist(), fresh.tolist(), strict=True) if sets.most < 0 else ():
                self.highs.changeCoeff(0, k, float(self._weights[i]))
        part = self.A[rows]
        part.sort_indices()
        starts, entries, values = part.indptr[:-1], part.indices, part.data
        if not sets.full:
            starts = starts + np.arange(len(rows))
            entries = np.insert(entries, part.indptr[1:], self._slack_of[owner])
            values = np.insert(values, part.indptr[1:], 1.0)
        least = 1.0 if sets.plain and sets.once else 1.0 - VIOLATED  # shares are rounded
        self.highs.addRows(
            len(rows), np.full(len(rows), least), np.full(len(rows), kHighsInf), len(entries),
            starts.astype(np.int32), entries.astype(np.int32), values,
        )  # fmt: skip
        self.inside[rows] = True
        self._order.append(rows)

    def add_violated(self, x: Floats, slack: Floats) -> bool:
        """Put the rows into the model that a solution leaves short, those that weigh most; whether there are any."""
        short = 1.0 - self.A @ x - slack[self.relaxation.owner]
        rows = np.flatnonzero((short > VIOLATED) & ~self.inside)
        if not len(rows):
            return False
        weights = 1.0 if self.sets.full else self._weights[self.relaxation.owner[rows]]
        worst = np.argsort(-short[rows] * weights, kind="stable")
        self.add(rows[worst[: max(LEAST_ROWS, int(MORE_ROWS * self.inside.sum()))]])
        return True

    def fix(self, state: NDArray[np.int8]) -> None:
        """Columns that are in (1), out (-1) and free (0)."""
        index = np.flatnonzero(state != self._state)
        upper = np.choose(state[index] + 1, (0.0, self._limit, 1.0))
        self.highs.changeColsBounds(len(index), index.astype(np.int32), (state[index] > 0).astype(np.float64), upper)
        self._state = state

    def limit_columns(self, count: int) -> None:
        """Allow so many columns (most area)."""
        self.highs.changeRowBounds(0, -kHighsInf, float(count))

    def work(self, k: float) -> int:
        """Charge of a simplex iteration of the linear programme with k of the problem's columns in the basis.

        Pricing touches the entries of as many rows, and the factors of the basis fill up with it.
        """
        highs = self.highs
        n_rows, n_columns, entries = highs.getNumRow(), highs.getNumCol(), highs.getNumNz()
        filled = min(entries / n_rows / n_columns * k / FILLED, 1.0)
        return int(
            PIVOT_WORK + SIZE_WORK * (n_rows + n_columns) + PRICE_WORK * entries * k / n_rows
            + FACTOR_WORK * k * k * filled
        )  # fmt: skip

    def run(self, budget: Budget) -> None:
        """Solve as far as the budget and `PIVOTS` go."""
        if budget.seconds_left is not None:
            self.highs.setOptionValue("time_limit", self.highs.getRunTime() + budget.seconds_left)
        budget.spend(CALL_WORK + ENTRY_WORK * self.highs.getNumNz() + 2 * self.A.nnz)
        dear = self.work(min(self._basic + PIVOTS / 2, self.highs.getNumRow()))
        self.highs.setOptionValue("simplex_iteration_limit", min(max(budget.left // dear, 1), PIVOTS))
        interruptible(self.highs.run)
        basic = self.highs.getBasis().col_status[: self.sets.n_columns].count(HighsBasisStatus.kBasic)
        budget.spend(self.iterations * self.work((basic + self._basic) / 2))
        self._basic = basic

    @property
    def iterations(self) -> int:
        """Simplex iterations of the last call."""
        return max(int(self.highs.getInfo().simplex_iteration_count), 0)

    @property
    def status(self) -> Any:
        """How HiGHS ended."""
        return self.highs.getModelStatus()

    def solution(self) -> tuple[Floats, Floats]:
        """(n,) x and (S,) what the model says stays open of each row."""
        values = np.array(self.highs.getSolution().col_value)
        slack = np.zeros(self.sets.n_rows)
        has = self._slack_of >= 0
        slack[has] = values[self._slack_of[has]]
        return values[: self.sets.n_columns], slack

    def multipliers(self) -> Floats:
        """(R,) duals of the problem's rows, in its units."""
        u = np.zeros(len(self.inside))
        order = np.concatenate(self._order)
        duals = np.array(self.highs.getSolution().row_dual)[self._heads :]
        if len(duals) == len(order):
            unit = float(self.sets.units.mean()) if self.sets.most >= 0 else self._scale
            u[order] = np.maximum(duals, 0.0) * unit
        return u


def _highs() -> Any:
    """A silent solver of one thread."""
    highs = highspy.Highs()  # type: ignore[no-untyped-call] # highspy types this call not
    highs.silent()
    options: dict[str, float | str] = {
        "threads": 1, "random_seed": 0, "presolve": "off", "solver": "simplex", "simplex_strategy": 1,
    }  # fmt: skip
    for name, value in options.items():
        highs.setOptionValue(name, value)
    return highs
