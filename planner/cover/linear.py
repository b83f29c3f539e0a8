"""The linear and the integer programme of a cover problem in HiGHS, with the rows that matter and no others.

A matrix of thousands of samples has a few hundred rows that decide. The model begins with the rows of fewest columns;
its solution is held against all rows, those that it violates most are added, and the dual simplex goes on from where it
stood, until no row is violated. The multipliers of every stage bound the whole problem (`planner.cover.bound`). Where
rows may stay open, each row of the model has a variable for the share that does.

HiGHS runs on one thread and stops by iterations and nodes, so that runs repeat; Ctrl-C is heard.
"""

from typing import Any

import highspy
import numpy as np
from highspy import HighsModelStatus, HighsVarType, kHighsInf

from planner.cover.bound import Relaxation, climb
from planner.cover.budget import Budget, interruptible
from planner.values import Floats, Ints

PIVOT_WORK, PIVOT_WORK_PER_ENTRY, PIVOT_WORK_PER_ENTRY_WIDE, WIDE = 18_000, 0.5, 2.3, 4
"""Charge of a simplex iteration, and of each row, column and entry of the model that it touches on average;
of matrices with more columns than so many times their rows it touches more. Fitted to processor time."""

WHOLE_NUMBERS = 1.2
"""An iteration within the integer programme costs so many times that of the linear one: cuts and nodes come on top."""

NODE_PIVOTS, ROOT_PIVOTS, ROOT_PIVOTS_OF_AREA = 150, 3000, 30_000
"""Iterations that a node, and the root with its cuts and first branchings, take: what the limit of nodes is derived
from. Where rows may stay open the root takes most of all."""

ROOT_PIVOTS_OF_SMALL = 8
"""Of a small model the root takes so many iterations for each row and column."""

FIRST_ROWS, MORE_ROWS, LEAST_ROWS = 0.25, 0.2, 20
"""Rows at the beginning as a share of the columns, rows added at a time as a share of those there, and at least."""

CLIMB_SHARE = 0.6
"""Most area: of the work for the bound, what subgradient steps get before the linear programme."""

VIOLATED = 1e-6
"""A row is violated where this share of its demand is missing."""

_NONE = np.zeros(0, dtype=np.int64)

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
        self._heads = 0
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

    @property
    def root_pivots(self) -> int:
        """Iterations that the root may take."""
        size: int = self.highs.getNumCol() + self.highs.getNumRow()
        most = ROOT_PIVOTS if self.sets.full else ROOT_PIVOTS_OF_AREA
        return min(most, ROOT_PIVOTS_OF_SMALL * size)

    @property
    def work(self) -> int:
        """Charge of one simplex iteration."""
        highs = self.highs
        size: int = highs.getNumCol() + highs.getNumRow()
        wide = self.sets.n_columns > WIDE * self.sets.n_rows
        entries = (
            PIVOT_WORK_PER_ENTRY_WIDE * highs.getNumNz()
            if wide
            else PIVOT_WORK_PER_ENTRY * min(highs.getNumNz(), 40 * size)
        )
        pivot = PIVOT_WORK + 8 * size + entries
        return int(WHOLE_NUMBERS * pivot if self.integer else pivot)

    def run(self, budget: Budget) -> int:
        """Solve within the budget; simplex iterations."""
        highs, per = self.highs, self.work
        affordable = min(max(budget.left // per, 1), 2**31 - 1)
        if self.integer:
            nodes = max(affordable - self.root_pivots, 0) // NODE_PIVOTS
            highs.setOptionValue("mip_max_nodes", int(nodes) + 1)
        else:
            highs.setOptionValue("simplex_iteration_limit", int(affordable))
        if budget.seconds_left is not None:
            highs.setOptionValue("time_limit", highs.getRunTime() + budget.seconds_left)
        interruptible(highs.run)
        iterations: int = max(int(highs.getInfo().simplex_iteration_count), 0)
        budget.spend(iterations * per + 2 * self.A.nnz)
        return iterations

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


def raise_bound(relaxation: Relaxation, upper: int, budget: Budget, model: Model | None = None) -> Model:
    """Improve the bound by the linear programme, row by row, until it is solved, meets the upper one or work ends.

    Args:
        relaxation: receives the multipliers.
        upper: objective of a known choice.
        budget: charged for iterations; also receives the bound.
        model: rows of an earlier call; None: a new one.

    Returns:
        The model, to go on from.
    """
    sets = relaxation.sets
    if sets.most >= 0 and sets.plain:
        with budget.portion(CLIMB_SHARE):
            climb(relaxation, upper - sets.tolerance, budget)
        budget.prove(relaxation.value)
    if model is None:
        model = Model(relaxation, np.arange(sets.n_columns))
        few = np.argsort(np.diff(relaxation.A.indptr), kind="stable")
        model.add(few[: max(LEAST_ROWS, int(FIRST_ROWS * sets.n_columns))])
    if sets.most >= 0:
        model.limit_columns(relaxation.size)
    while relaxation.value < upper - sets.tolerance and budget.spend(0):
        model.run(budget)
        relaxation.evaluate(model.multipliers())
        budget.prove(relaxation.value)
        rows = model.violated(*model.solution()) if model.status == HighsModelStatus.kOptimal else _NONE
        if not len(rows):
            break
        model.add(rows[: max(LEAST_ROWS, int(MORE_ROWS * model.inside.sum()))])
    return model


def _highs(integer: bool) -> Any:
    """A silent solver of one thread."""
    highs = highspy.Highs()  # type: ignore[no-untyped-call] # highspy types this call not
    highs.silent()
    options: dict[str, Any] = {"threads": 1, "random_seed": 0}
    if integer:
        options |= {"mip_rel_gap": 0.0, "mip_abs_gap": 1e-9, "mip_heuristic_effort": 0.0, "mip_pscost_minreliable": 1}
    else:
        options |= {"presolve": "off", "solver": "simplex", "simplex_strategy": 1}
    for name, value in options.items():
        highs.setOptionValue(name, value)
    return highs
