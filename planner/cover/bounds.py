"""Lower bounds on the objective of a cover problem: Lagrangian dual, linear programme, certified in float64.

For multipliers u >= 0 of the rows (Beasley 1990, doi:10.1002/1520-6750(199002)37:1<151::AID-NAV3220370110>3.0.CO;2-2),
with A the loads as shares of their row's demand (limited to 1, since no selection can use more) and z the groups' costs

    L(u) = min { sum_i u_i y_i } + sum_groups min(0, z_g + sum_{j in g} min(0, c_j - sum_i A_ij u_i))

is at most the minimum cost. y says which rows are covered: all of them for a full cover; otherwise the cheapest
fractional choice that reaches the required area and covers each row that is larger than the slack (a knapsack solved by
sorting u_i / area_i). With k columns, the units that any k columns leave uncovered are at least

    L_k(u) = sum_i u_i - the k largest of sum_i A_ij u_i          for 0 <= u_i <= units_i

(Galvao, ReVelle 1996, doi:10.1016/0377-2217(94)00159-6), for every k at once. max_u L(u) is the bound of the linear
relaxation. It proposes u, but the bound is L(u) evaluated here and rounded up to a whole number after subtracting more
than the float64 error: a tolerance inside a solver can weaken the bound but never make it wrong.

If no column satisfies a row alone and loads differ, sums of shares are a weak description: two columns of 0.9 each are
needed, and their sum requires 1.1. Such a row gets a second one: at least r columns, r being the number of its largest
shares that reach 1 (a Chvatal-Gomory cut). Both rows share y_i.

**Row generation.** A few hundred of thousands of samples decide the linear programme. The model begins with the rows of
fewest columns. Its solution is compared with all rows, the most violated ones are added, and the dual simplex continues
from the last basis, until no row is violated. The multipliers of each stage bound the whole problem. If rows may stay
uncovered, each row of the model has a variable for the uncovered share. HiGHS runs on one thread and is stopped by
iterations, so that runs repeat; Ctrl-C interrupts it.
"""

from math import ceil
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from planner.cover.budget import Budget, interruptible
from planner.cover.problem import CoverInstance, reduce_slices
from planner.values import Bools, Floats, Ints

ROUNDING = 1e-6
"""Subtracted from a cost before rounding up (above a bound of 1000 in proportion): far above the float error of
L(u)."""

AREA_ROUNDING = 1e-9
"""Subtracted from a bound on uncovered units, as a share of all units: far above the float error of L_k(u)."""

FIRST_STEP, LAST_STEP, SHRINK, PATIENCE, DEFLECTION = 0.5, 1e-3, 0.7, 10, 0.9
"""Constants of the subgradient steps, tuned on visibility matrices."""

STEP_EFFORT, STEP_EFFORT_PER_ENTRY = 60_000, 1.5
"""Charge of a subgradient step, and of each entry of the matrix."""

FIRST_ROWS = 0.25
"""Rows of the first model as a share of the columns."""

SUBGRADIENT_SHARE = 0.6
"""Maximum coverage: share of the effort for the bound that subgradient steps get before the linear programme."""

CALL_EFFORT, ENTRY_EFFORT = 500_000, 25
"""Charge of each call of HiGHS, and of passing each entry."""

PIVOT_EFFORT, SIZE_EFFORT, PRICE_EFFORT, FACTOR_EFFORT = 3000, 7, 1.0, 2.0
"""Charge of a simplex iteration, of each row and column of the model, of each entry touched by pricing, and of each
entry of the factors of the basis: fitted to processor time on measurability matrices, roots and trees."""

FULL_FACTOR_ENTRIES = 20
"""Entries in each column of the basis from which its factors are dense."""

PIVOTS = 300
"""Iterations of the linear programme between two evaluations of the bound."""

MORE_ROWS, MIN_ROWS = 0.2, 20
"""Violated rows that are added at a time: as a share of the rows of the model, and at least."""

VIOLATED = 1e-6
"""Missing share of a row's demand from which the row is violated."""

AREA_RELAXATION = 1e-7
"""Share of all units by which HiGHS's area constraint is relaxed, so that its tolerance excludes nothing."""


class Relaxation:
    """The best bound so far, and the information of its multipliers about each column.

    Attributes:
        A: (R, V) shares, the second rows last.
        At: (V, R) the same, transposed.
        row_of: (R,) row of the problem of each row of A.
        dual: L(u) of the best multipliers.
        multipliers: (R,) u.
        penalty: (V,) increase of L(u) if a column is selected, at least; for maximum coverage: if it is selected though
            it is not among the largest.
        column_value: (V,) sum of the last multipliers over each column's rows (maximum coverage).
        size: number of columns of dual and penalty; -1 if the cost is minimised.
        fixing: (V,) 1 for columns that are fixed in, -1 for those fixed out, 0 for free ones. Dual and penalty hold
            for such selections, all other attributes for all.
        uncovered_bounds: (k + 1,) lower bounds on the units that 0, 1, ... k columns leave uncovered; empty if the cost
            is minimised.
    """

    def __init__(self, instance: CoverInstance) -> None:
        """Evaluate the first multipliers."""
        self.instance = instance
        self.size = -1 if instance.max_columns is None else instance.max_columns
        self.A, self.row_of = _shares(instance)
        self.At = instance.transposed() if instance.has_unit_demand else sp.csr_array(self.A.T)
        self.units = instance.units.astype(np.float64)
        self.uncovered_bounds = np.zeros(self.size + 1)
        self._required_rows = instance.units > instance.slack
        self.dual, self.penalty = -np.inf, np.zeros(instance.n_columns)
        self.fixing = np.zeros(instance.n_columns, dtype=np.int8)
        self.multipliers = self.column_value = np.zeros(len(self.row_of))
        first = np.zeros(len(self.row_of))
        if instance.maximises_area:
            first[: instance.n_rows] = self.units
        else:
            # Feasible: each row's share of its best column, so that no reduced cost is negative.
            weights = np.ones(instance.n_rows) if instance.full else self.units
            transposed = self.At if len(self.row_of) == instance.n_rows else self.At[:, : instance.n_rows]
            rates = (transposed @ weights) / instance.costs
            largest = reduce_slices(np.maximum, instance.row_start, instance.row_columns, rates.__getitem__)
            np.divide(weights, largest, out=first[: instance.n_rows], where=largest > 0)
        self.evaluate(first)

    @property
    def bound(self) -> int:
        """Certified lower bound on the objective."""
        if self.instance.maximises_area:
            return self.certified_uncovered(self.size)
        return max(ceil(self.dual - _rounding(self.dual)), 0)

    def set_size(self, size: int) -> None:
        """Bound the uncovered units of another number of columns, up to `max_columns`."""
        self.size, self.dual = size, -np.inf
        self.evaluate(self.multipliers)

    def may_be_feasible(self, fixing: NDArray[np.int8]) -> bool:
        """Return whether a selection with these columns in and out may reach the target."""
        if self.size >= 0:
            return int((fixing > 0).sum()) <= self.size
        instance = self.instance
        satisfied = (self.A @ (fixing >= 0))[: instance.n_rows] >= 1.0 - ROUNDING  # shares are rounded
        return bool(satisfied.all()) if instance.full else int(instance.units[satisfied].sum()) >= instance.required

    def fix(self, fixing: NDArray[np.int8]) -> None:
        """Bound selections with these columns in and out."""
        self.fixing, self.dual = fixing, -np.inf
        self.evaluate(self.multipliers)

    def excludes(self, objective: int) -> bool:
        """Return whether no selection of the current `fixing` has an objective of at most this."""
        return self.dual > objective + self._margin(objective)

    def certified_uncovered(self, size: int) -> int:
        """Return a certified lower bound on the uncovered units of this number of columns."""
        units = self.instance.units
        grain = int(np.gcd.reduce(units)) if len(units) else 1  # all sums of units are multiples of it
        bound = float(self.uncovered_bounds[size]) - AREA_ROUNDING * self.instance.total_units
        return max(ceil(bound / grain) * grain, 0)

    def useful_columns(self, objective: int) -> Bools:
        """Return (V,) whether a selection with at most this objective may contain a column (reduced-cost fixing)."""
        useful: Bools = self.dual + self.penalty <= objective + self._margin(objective)
        return useful

    def _margin(self, objective: int) -> float:
        if self.instance.maximises_area:
            return AREA_ROUNDING * self.instance.total_units
        return _rounding(objective)

    def evaluate(self, u: Floats) -> float:
        """Return L(u); the best multipliers are kept."""
        instance = self.instance
        by_row: Floats = np.bincount(self.row_of, u, instance.n_rows).astype(np.float64, copy=False)
        if instance.maximises_area:
            scale = self.units / np.maximum(by_row, self.units)
            u, by_row = u * scale[self.row_of], by_row * scale
            return self._evaluate_area(u, by_row)
        reduced = instance.costs - self.At @ u
        fixed_in = self.fixing > 0
        below = np.where(fixed_in, reduced, np.minimum(reduced, 0.0) * (self.fixing == 0))
        by_group = instance.group_costs + np.bincount(instance.group, below, len(instance.group_costs))
        opened = np.isin(np.arange(len(by_group)), instance.group[fixed_in])
        dual = self._cheapest_rows(by_row) + float(np.where(opened, by_group, np.minimum(by_group, 0.0)).sum())
        if dual > self.dual:
            self.dual, self.multipliers = dual, u
            self.penalty = np.maximum(reduced, 0.0) + (np.maximum(by_group, 0.0) * ~opened)[instance.group]
        return dual

    def _cheapest_rows(self, by_row: Floats) -> float:
        """Return the minimum of u y over choices y of rows that reach the required area."""
        instance = self.instance
        if instance.full:
            return float(by_row.sum())
        free = np.flatnonzero(~self._required_rows)
        missing = float(instance.required - int(instance.units[self._required_rows].sum()))
        order = free[np.argsort(by_row[free] / self.units[free], kind="stable")]
        before = np.concatenate(([0.0], np.cumsum(self.units[order])))
        share = np.clip((missing - before[:-1]) / self.units[order], 0.0, 1.0)
        return float(by_row[self._required_rows].sum() + share @ by_row[order])

    def _evaluate_area(self, u: Floats, by_row: Floats) -> float:
        """Return L_k(u) for k = `size`, and keep L_k(u) for all k if no column is fixed."""
        value = self.column_value = np.asarray(self.At @ u)
        fixed_in, free = self.fixing > 0, self.fixing == 0
        n_fixed = int(fixed_in.sum())
        largest = np.sort(value[free])[::-1][: len(self.uncovered_bounds) - 1 - n_fixed]
        # once all free columns are used, more leave no less uncovered
        covered = np.zeros(len(self.uncovered_bounds) - n_fixed)
        covered[1 : 1 + len(largest)] = np.cumsum(largest)
        covered[1 + len(largest) :] = covered[len(largest)]
        uncovered = float(by_row.sum() - value[fixed_in].sum()) - covered
        if free.all():
            self.uncovered_bounds = np.maximum(self.uncovered_bounds, uncovered)
        size = min(self.size - n_fixed, len(largest))
        dual = float(uncovered[self.size - n_fixed])
        if dual > self.dual:
            self.dual, self.multipliers = dual, u
            # if no more columns may enter, no free one will
            self.penalty = (
                np.maximum(largest[size - 1] - value, 0.0) if size else value * 0.0 + self.instance.total_units
            )
        return dual


def _rounding(value: float) -> float:
    """Return more than the float error of a bound of this size."""
    return ROUNDING * max(1.0, value * 1e-3)


def _shares(instance: CoverInstance) -> tuple[Any, Ints]:
    """Return the loads as shares of their row's demand, second rows included, and the row of each."""
    A = instance.matrix()
    rows = np.arange(instance.n_rows)
    if instance.has_unit_demand:
        return A, rows
    A.data /= np.repeat(instance.demand, np.diff(instance.row_start))
    if instance.has_unit_loads:
        return A, rows
    min_columns = np.ones(instance.n_rows, dtype=np.int64)
    for row in rows:
        loads = np.sort(instance.row_load[instance.row_start[row] : instance.row_start[row + 1]])[::-1]
        if loads[:1].sum() < instance.demand[row]:
            min_columns[row] = int(np.searchsorted(np.cumsum(loads), instance.demand[row])) + 1
    cut_rows = np.flatnonzero(min_columns > 1)
    cuts = sp.csr_array(A[cut_rows])
    cuts.data = 1.0 / np.repeat(min_columns[cut_rows], np.diff(cuts.indptr))
    return sp.csr_array(sp.vstack((A, cuts))), np.concatenate((rows, cut_rows))


def subgradient_ascent(relaxation: Relaxation, known: int, budget: Budget) -> None:
    """Raise the bound of maximum coverage by deflected subgradient steps (Camerini, Fratta, Maffioli 1975).

    With few columns nearly every row stays partly uncovered, and the linear programme has too many rows to begin with.
    The steps, of Polyak's length, approach its value at two products with the matrix each (doi:10.1007/BFb0120697).
    They are scaled by each row's units, so that rows of 1e-12 and of 1e6 move alike.

    Args:
        relaxation: receives the multipliers.
        known: units that a known selection leaves uncovered.
        budget: charged for each step.
    """
    units, effort = relaxation.units, STEP_EFFORT_PER_ENTRY * relaxation.A.nnz + STEP_EFFORT
    u = best_u = relaxation.multipliers
    direction = np.zeros(len(units))
    step, stalled, highest = FIRST_STEP, 0, -np.inf
    while step > LAST_STEP and relaxation.bound < known and budget.spend(effort):
        dual = relaxation.evaluate(u)
        stalled = stalled + 1 if dual <= highest + 1e-7 * abs(highest) else 0
        if dual > highest:
            highest, best_u = dual, u
        if stalled >= PATIENCE:
            step, stalled, u = step * SHRINK, 0, best_u
            dual = relaxation.evaluate(u)
        selected = np.zeros(relaxation.instance.n_columns)
        selected[np.argsort(-relaxation.column_value, kind="stable")[: relaxation.size]] = 1.0
        direction = (1.0 - DEFLECTION) * (1.0 - relaxation.A @ selected) + DEFLECTION * direction
        at_limit = ((u <= 0) & (direction < 0)) | ((u >= units) & (direction > 0))
        move = np.where(at_limit, 0.0, direction)
        length = float((units * move) @ (units * move))
        if length == 0.0:
            break
        u = np.clip(u + step * max(known - dual, 0.0) / length * units * units * move, 0.0, units)


class LinearModel:
    """Linear programme of some rows of a relaxation, in HiGHS.

    Attributes:
        contains: (R,) whether each row of the relaxation is in the model.
    """

    def __init__(self, relaxation: Relaxation, rows: Ints) -> None:
        instance = relaxation.instance
        self.relaxation, self.instance, self.A = relaxation, instance, relaxation.A
        self.contains = np.zeros(self.A.shape[0], dtype=bool)
        self._order: list[Ints] = []
        self._slack_of = np.full(instance.n_rows, -1)
        mean_units = max(float(instance.units.mean()), 1e-300) if instance.n_rows else 1.0
        self._weights = instance.units / mean_units
        self._scale = float(instance.costs.mean())
        self._heads = self._n_basic = 0
        self.highs = _highs()
        self._fixing = np.zeros(instance.n_columns, dtype=np.int8)
        is_unit = instance.full and instance.has_unit_loads and instance.has_unit_demand
        self._limit = np.inf if is_unit else 1.0
        costs = 0.0 if instance.maximises_area else instance.costs / self._scale
        columns = self._add_variables(instance.n_columns, self._limit, costs)
        if instance.max_columns is not None:
            self._add_head(-np.inf, float(instance.max_columns), columns, np.ones(len(columns)))
        elif not instance.full:
            slack = instance.slack + AREA_RELAXATION * instance.total_units
            self._add_head(-np.inf, slack / float(instance.units.mean()), [], [])
        for g in np.flatnonzero(instance.group_costs).tolist():
            # a variable for each group with a cost, at least as large as each of its columns
            opened = int(self._add_variables(1, 1.0, instance.group_costs[g] / self._scale)[0])
            for j in np.flatnonzero(instance.group == g).tolist():
                self._add_head(0.0, np.inf, np.array([opened, j]), np.array([1.0, -1.0]))
        self.add(rows)

    def _add_variables(self, count: int, upper: float, costs: Any) -> Ints:
        """Add variables from 0 to a limit; return their numbers."""
        first = self.highs.getNumCol()
        self.highs.addVars(count, np.zeros(count), np.full(count, upper))
        index = np.arange(first, first + count, dtype=np.int32)
        self.highs.changeColsCost(count, index, np.broadcast_to(np.asarray(costs, dtype=np.float64), count).copy())
        return index.astype(np.int64)

    def _add_head(self, lower: float, upper: float, index: Any, values: Any) -> None:
        """Add a constraint that is not a row of the problem."""
        self.highs.addRow(lower, upper, len(index), np.asarray(index, np.int32), np.asarray(values, np.float64))
        self._heads += 1

    def add(self, rows: Ints) -> None:
        """Add rows of the relaxation to the model."""
        instance, row_of = self.instance, self.relaxation.row_of[rows]
        if not instance.full:
            new = np.unique(row_of[self._slack_of[row_of] < 0])
            # A row that is larger than the slack must be covered.
            must_be_covered = (instance.units[new] > instance.slack) & (not instance.maximises_area)
            upper = np.where(must_be_covered, 0.0, 1.0)
            costs = self._weights[new] if instance.maximises_area else 0.0
            index = self._add_variables(len(new), 1.0, costs)
            self.highs.changeColsBounds(len(index), index.astype(np.int32), np.zeros(len(index)), upper)
            self._slack_of[new] = index
            if not instance.maximises_area:
                for k, i in zip(index.tolist(), new.tolist(), strict=True):
                    self.highs.changeCoeff(0, k, float(self._weights[i]))
        A = self.A[rows]
        A.sort_indices()
        starts, entries, values = A.indptr[:-1], A.indices, A.data
        if not instance.full:
            starts = starts + np.arange(len(rows))
            entries = np.insert(entries, A.indptr[1:], self._slack_of[row_of])
            values = np.insert(values, A.indptr[1:], 1.0)
        is_exact = instance.has_unit_loads and instance.has_unit_demand
        lower = np.full(len(rows), 1.0 if is_exact else 1.0 - VIOLATED)  # shares are rounded
        self.highs.addRows(
            len(rows), lower, np.full(len(rows), np.inf), len(entries),
            starts.astype(np.int32), entries.astype(np.int32), values,
        )  # fmt: skip
        self.contains[rows] = True
        self._order.append(rows)

    def add_violated(self, x: Floats, uncovered: Floats) -> bool:
        """Add the most violated rows of a solution to the model; return whether there are any."""
        missing = 1.0 - self.A @ x - uncovered[self.relaxation.row_of]
        rows = np.flatnonzero((missing > VIOLATED) & ~self.contains)
        if not len(rows):
            return False
        weights = 1.0 if self.instance.full else self._weights[self.relaxation.row_of[rows]]
        worst = np.argsort(-missing[rows] * weights, kind="stable")
        self.add(rows[worst[: max(MIN_ROWS, int(MORE_ROWS * self.contains.sum()))]])
        return True

    def fix(self, fixing: NDArray[np.int8]) -> None:
        """Fix columns in (1) and out (-1), free the others (0)."""
        index = np.flatnonzero(fixing != self._fixing)
        upper = np.choose(fixing[index] + 1, (0.0, self._limit, 1.0))
        self.highs.changeColsBounds(len(index), index.astype(np.int32), (fixing[index] > 0).astype(np.float64), upper)
        self._fixing = fixing

    def set_size(self, size: int) -> None:
        """Set the number of columns (maximum coverage)."""
        self.highs.changeRowBounds(0, -np.inf, float(size))

    def _iteration_effort(self, k: float) -> int:
        """Return the charge of a simplex iteration with k of the problem's columns in the basis.

        Pricing touches the entries of as many rows, and the factors of the basis fill up with it.
        """
        highs = self.highs
        n_rows, n_columns, entries = highs.getNumRow(), highs.getNumCol(), highs.getNumNz()
        filled = min(entries / n_rows / n_columns * k / FULL_FACTOR_ENTRIES, 1.0)
        return int(
            PIVOT_EFFORT + SIZE_EFFORT * (n_rows + n_columns) + PRICE_EFFORT * entries * k / n_rows
            + FACTOR_EFFORT * k * k * filled
        )  # fmt: skip

    def run(self, budget: Budget) -> None:
        """Solve as far as the budget and `PIVOTS` allow."""
        budget.spend(CALL_EFFORT + ENTRY_EFFORT * self.highs.getNumNz() + 2 * self.A.nnz)
        expected = self._iteration_effort(min(self._n_basic + PIVOTS / 2, self.highs.getNumRow()))
        self.highs.setOptionValue("simplex_iteration_limit", min(max(budget.remaining // expected, 1), PIVOTS))
        interruptible(self.highs.run)
        iterations = max(int(self.highs.getInfo().simplex_iteration_count), 0)
        n_basic = self._count_basic_columns()
        budget.spend(iterations * self._iteration_effort((n_basic + self._n_basic) / 2))
        self._n_basic = n_basic

    def _count_basic_columns(self) -> int:
        from highspy import HighsBasisStatus

        return int(self.highs.getBasis().col_status[: self.instance.n_columns].count(HighsBasisStatus.kBasic))

    @property
    def is_optimal(self) -> bool:
        """Whether the last run ended at an optimum of the model."""
        from highspy import HighsModelStatus

        return bool(self.highs.getModelStatus() == HighsModelStatus.kOptimal)

    @property
    def reached_iteration_limit(self) -> bool:
        """Whether the last run ended at the iteration limit and may be continued."""
        from highspy import HighsModelStatus

        return bool(self.highs.getModelStatus() == HighsModelStatus.kIterationLimit)

    def solution(self) -> tuple[Floats, Floats]:
        """Return (n,) x and the (S,) uncovered share of each row."""
        values = np.array(self.highs.getSolution().col_value)
        uncovered = np.zeros(self.instance.n_rows)
        has_slack = self._slack_of >= 0
        uncovered[has_slack] = values[self._slack_of[has_slack]]
        return values[: self.instance.n_columns], uncovered

    def multipliers(self) -> Floats:
        """Return the (R,) duals of the problem's rows, in its units."""
        u = np.zeros(len(self.contains))
        order = np.concatenate(self._order)
        duals = np.array(self.highs.getSolution().row_dual)[self._heads :]
        if len(duals) == len(order):
            unit = float(self.instance.units.mean()) if self.instance.maximises_area else self._scale
            u[order] = np.maximum(duals, 0.0) * unit
        return u


def _highs() -> Any:
    """Return a silent solver on one thread."""
    import highspy  # delays start-up

    highs = highspy.Highs()  # type: ignore[no-untyped-call] # highspy does not type this call
    highs.silent()
    options: dict[str, float | str] = {
        "threads": 1, "random_seed": 0, "presolve": "off", "solver": "simplex", "simplex_strategy": 1,
    }  # fmt: skip
    for name, value in options.items():
        highs.setOptionValue(name, value)
    return highs


def raise_bound(relaxation: Relaxation, upper: int, budget: Budget, model: LinearModel | None = None) -> LinearModel:
    """Improve the bound by row generation until it is optimal, meets the upper bound, or the effort is spent.

    Args:
        relaxation: receives the multipliers.
        upper: objective of a known selection.
        budget: charged for iterations; also receives the bound.
        model: the model of an earlier call; None: a new one.

    Returns:
        The model, from which another call can continue.
    """
    instance = relaxation.instance
    if instance.maximises_area and instance.has_unit_loads:
        with budget.portion(SUBGRADIENT_SHARE):
            subgradient_ascent(relaxation, upper - instance.tolerance, budget)
        budget.raise_lower_bound(relaxation.bound)
    if model is None:
        shortest = np.argsort(np.diff(relaxation.A.indptr), kind="stable")
        model = LinearModel(relaxation, shortest[: max(MIN_ROWS, int(FIRST_ROWS * instance.n_columns))])
    if instance.maximises_area:
        model.set_size(relaxation.size)
    while relaxation.bound < upper - instance.tolerance and budget.spend(0):
        model.run(budget)
        relaxation.evaluate(model.multipliers())
        budget.raise_lower_bound(relaxation.bound)
        if model.is_optimal:
            if not model.add_violated(*model.solution()):
                break
        elif not model.reached_iteration_limit:
            break
    return model
