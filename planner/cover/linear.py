"""The linear and the integer programme of a cover problem in HiGHS, with the rows that matter and no others.

A matrix of thousands of samples has a few hundred rows that decide. The model begins with the rows of fewest columns;
its solution is held against all rows, those that it violates most are added, and the dual simplex goes on from where it
stood, until no row is violated. The multipliers of every stage bound the whole problem (`planner.cover.bound`). Where
rows may stay open, each row of the model has a variable for the share that does.

HiGHS runs on one thread and is stopped by iterations, and in whole numbers by how often it calls back, so that runs
repeat; Ctrl-C is heard.
"""

from typing import Any

import highspy
import numpy as np
from highspy import HighsBasisStatus, HighsVarType, kHighsInf

from planner.cover.bound import Relaxation
from planner.cover.budget import Budget, interruptible
from planner.values import Floats, Ints

PIVOT_WORK, SIZE_WORK, PRICE_WORK, FACTOR_WORK, ENTRY_WORK = 12_500, 3.5, 1.5, 2.5, 25
"""Charge of a simplex iteration, of each row and column of the model, of each entry that pricing touches, of each entry
of the factors of the basis; and of handing over each entry at every call. Fitted to processor time (`Model.work`)."""

FILLED = 20
"""With so many entries in each column of the basis its factors have no zeros left."""

PIVOTS = 300
"""Iterations of the linear programme between two looks at the basis."""

INTEGER_PIVOT_WORK = 27_500
"""Charge of an iteration of the integer programme, fitted to processor time."""

ROOT_WORK, NODE_WORK, PER_ENTRY, LARGE = 7_000_000, 450_000, (450, 30), 360
"""Charge of what lies between two calls back of the integer programme at its root and in its tree, and of each entry;
below so many rows and columns in proportion, above at the root with the power of 3/4. By these it is ended: HiGHS tells
no iterations while it runs."""

PRESOLVE_WORK = 1500
"""Charge of each entry when the integer programme begins."""

ROOT_CALLS = 20
"""The integer programme begins where the budget pays for so many of them."""

VIOLATED = 1e-6
"""A row is violated where this share of its demand is missing."""

SLACKER = 1e-7
"""Share of all units by which the area asked of HiGHS is eased, so that its tolerance excludes nothing."""


class Model:
    """Columns of a problem, some of its rows, and what is asked for, in HiGHS.

    Attributes:
        inside: (R,) which rows of the relaxation are in the model.
        columns: (n,) columns of the problem that are in the model.
    """

    def __init__(self, relaxation: Relaxation, columns: Ints, *, at_most: int | None = None) -> None:
        """The model without rows.

        Args:
            relaxation: the problem.
            columns: those that may be used.
            at_most: objective that is asked for, in whole numbers; None: the linear relaxation.
        """
        sets = relaxation.sets
        self.relaxation, self.sets, self.columns = relaxation, sets, columns
        self.integer = at_most is not None
        self.A = relaxation.A if len(columns) == sets.n_columns else relaxation.A[:, columns]
        self.inside = np.zeros(self.A.shape[0], dtype=bool)
        self._order: list[Ints] = []
        self._slack_of = np.full(sets.n_rows, -1)
        self._weights = sets.units / max(float(sets.units.mean()), 1e-300) if sets.n_rows else relaxation.units
        self._scale = float(sets.costs.mean())
        self._heads = self._basic = 0
        self.highs = _highs(self.integer)
        if not sets.full:  # many rows with open shares: trying each branch at the root would take minutes
            self.highs.setOptionValue("mip_pscost_minreliable", 0)
        once = sets.full and sets.plain and sets.once and not self.integer
        self._variables(len(columns), np.inf if once else 1.0, sets.costs[columns] / self._scale, self.integer)
        if sets.most >= 0:
            self.highs.changeColsCost(len(columns), np.arange(len(columns), dtype=np.int32), np.zeros(len(columns)))
            self._head(-kHighsInf, float(sets.most), np.arange(len(columns)), np.ones(len(columns)))
        elif not sets.full:
            self._head(
                -kHighsInf, (sets.slack + SLACKER * sets.total) / float(sets.units.mean()), np.zeros(0), np.zeros(0)
            )
        self._groups()
        if at_most is not None:
            self._ask_for(at_most)

    def _variables(self, count: int, upper: float, costs: Any, whole: bool) -> Ints:
        """Add variables from 0 to a limit; their numbers."""
        first = self.highs.getNumCol()
        self.highs.addVars(count, np.zeros(count), np.full(count, upper))
        index = np.arange(first, first + count, dtype=np.int32)
        self.highs.changeColsCost(count, index, np.broadcast_to(np.asarray(costs, dtype=np.float64), count).copy())
        if whole:
            self.highs.changeColsIntegrality(count, index, [HighsVarType.kInteger] * count)
        return index.astype(np.int64)

    def _head(self, lower: float, upper: float, index: Any, values: Any) -> None:
        """A row that is not one of the problem's."""
        self.highs.addRow(lower, upper, len(index), np.asarray(index, np.int32), np.asarray(values, np.float64))
        self._heads += 1

    def _groups(self) -> None:
        """A variable for each group with a cost, at least as large as each of its columns."""
        for g in np.flatnonzero(self.sets.group_costs).tolist():
            opened = int(self._variables(1, 1.0, self.sets.group_costs[g] / self._scale, self.integer)[0])
            for j in np.flatnonzero(self.sets.group[self.columns] == g).tolist():
                self._head(0.0, kHighsInf, np.array([opened, j]), np.array([1.0, -1.0]))

    def _ask_for(self, at_most: int) -> None:
        """Only solutions with at most this objective; for the area the variables of open rows enter as they come."""
        if self.sets.most >= 0:
            self._head(-kHighsInf, (at_most + SLACKER * self.sets.total) / float(self.sets.units.mean()), [], [])
            return
        costs = np.array(self.highs.getLp().col_cost_)
        self._head(-kHighsInf, (at_most + 0.25) / self._scale, np.arange(len(costs)), costs)

    def add(self, rows: Ints) -> None:
        """Put rows of the relaxation into the model."""
        sets, owner = self.sets, self.relaxation.owner[rows]
        if not sets.full:
            fresh = np.unique(owner[self._slack_of[owner] < 0])
            whole = self.integer and not sets.once
            # A row that is larger than what may stay open must be covered.
            limit = np.where(sets.units[fresh] > sets.slack, 0.0, 1.0) if sets.most < 0 else np.ones(len(fresh))
            costs = self._weights[fresh] if sets.most >= 0 else 0.0
            index = self._variables(len(fresh), 1.0, costs, whole)
            self.highs.changeColsBounds(len(index), index.astype(np.int32), np.zeros(len(index)), limit)
            self._slack_of[fresh] = index
            head = self._heads - 1 if sets.most >= 0 else 0
            if sets.most < 0 or self.integer:
                for k, i in zip(index.tolist(), fresh.tolist(), strict=True):
                    self.highs.changeCoeff(head, k, float(self._weights[i]))
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
        """Solve as far as the budget goes; the linear programme as far as `PIVOTS` go too."""
        if budget.seconds_left is not None:
            self.highs.setOptionValue("time_limit", self.highs.getRunTime() + budget.seconds_left)
        budget.spend(ENTRY_WORK * self.highs.getNumNz() + 2 * self.A.nnz)
        if self.integer:
            self._run_integer(budget)
            return
        dear = self.work(min(self._basic + PIVOTS / 2, self.highs.getNumRow()))
        self.highs.setOptionValue("simplex_iteration_limit", min(max(budget.left // dear, 1), PIVOTS))
        interruptible(self.highs.run)
        basic = self.highs.getBasis().col_status[: len(self.columns)].count(HighsBasisStatus.kBasic)
        budget.spend(self.iterations * self.work((basic + self._basic) / 2))
        self._basic = basic

    @property
    def call_work(self) -> tuple[int, int]:
        """Charge of what lies between two calls back of the integer programme: at the root, in the tree."""
        highs = self.highs
        size, entries = highs.getNumCol() + highs.getNumRow(), highs.getNumNz()
        share = size / LARGE
        root = int(ROOT_WORK * min(share, share**0.75)) + PER_ENTRY[0] * entries
        return root, int(NODE_WORK * min(share, 1.0)) + PER_ENTRY[1] * entries

    def _run_integer(self, budget: Budget) -> None:
        estimate, (root, node) = 0, self.call_work
        affordable = max(budget.left, ROOT_CALLS * root)

        def ended(event: Any) -> None:
            nonlocal estimate
            estimate += root if event.data_out.mip_node_count <= 0 else node
            if estimate > affordable:
                event.interrupt()

        self.highs.cbMipInterrupt.subscribe(ended)
        interruptible(self.highs.run)
        self.highs.cbMipInterrupt.unsubscribe(ended)
        budget.spend(max(INTEGER_PIVOT_WORK * self.iterations, estimate) + PRESOLVE_WORK * self.highs.getNumNz())

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
        return values[: len(self.columns)], slack

    def multipliers(self) -> Floats:
        """(R,) duals of the problem's rows, in its units."""
        u = np.zeros(len(self.inside))
        order = np.concatenate(self._order)
        duals = np.array(self.highs.getSolution().row_dual)[self._heads :]
        if len(duals) == len(order):
            unit = float(self.sets.units.mean()) if self.sets.most >= 0 else self._scale
            u[order] = np.maximum(duals, 0.0) * unit
        return u

    def certified(self, dual: float) -> int:
        """A bound of the integer programme as a whole objective that certainly holds."""
        if not np.isfinite(dual):
            return 0
        if self.sets.most >= 0:
            return max(int((dual - VIOLATED) * float(self.sets.units.mean())) - self.sets.tolerance, 0)
        return max(int(np.ceil((dual - VIOLATED) * self._scale)), 0)

    def violated(self, x: Floats, slack: Floats) -> Ints:
        """Rows outside the model that a solution leaves short, the ones that weigh most first."""
        short = 1.0 - self.A @ x - slack[self.relaxation.owner]
        rows = np.flatnonzero((short > VIOLATED) & ~self.inside)
        weights = 1.0 if self.sets.full else self._weights[self.relaxation.owner[rows]]
        return rows[np.argsort(-short[rows] * weights, kind="stable")]


def _highs(integer: bool) -> Any:
    """A silent solver of one thread."""
    highs = highspy.Highs()  # type: ignore[no-untyped-call] # highspy types this call not
    highs.silent()
    options: dict[str, float | str] = {"threads": 1, "random_seed": 0}
    if integer:
        options |= {
            "mip_rel_gap": 0.0, "mip_abs_gap": 1e-9, "mip_heuristic_effort": 0.0, "mip_pscost_minreliable": 1,
            "mip_heuristic_run_feasibility_jump": False, "mip_allow_restart": False,
        }  # fmt: skip
    else:
        options |= {"presolve": "off", "solver": "simplex", "simplex_strategy": 1}
    for name, value in options.items():
        highs.setOptionValue(name, value)
    return highs
