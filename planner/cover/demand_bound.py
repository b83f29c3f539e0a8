"""Lower bound on the number of columns of a cover with demands: Lagrangian dual, the LP's dual, and HiGHS where small.

With A the loads as shares of their row's demand (cut at 1, which no choice can use more of) and u >= 0

    L(u) = min { sum_i u_i y_i : y reaches the required units } + sum_j min(0, 1 - sum_i A_ij u_i)

is at most the fewest columns, as in `planner.cover.bound`. Whatever proposes u, the bound is L(u) evaluated here.

Where no column satisfies a row alone, sums of shares are a weak description: two columns of 0.9 each are needed, and
their sum asks for 1.1. Such a row gets a second one: at least r columns, r being how many of its largest shares it
takes (a Chvatal-Gomory cut). Both share y_i.
"""

from math import ceil
from typing import Any

import numpy as np

from planner.cover.bound import PIVOT_WORK
from planner.cover.budget import ROUNDING, STEP_WORK, Budget
from planner.cover.demands import DemandProblem
from planner.cover.interrupts import ends_search, interruptible
from planner.values import Floats, Ints

LP_ENTRIES = 200_000
"""Matrices up to this many loads get the LP solver's dual where the budget pays for it."""

FIRST_STEP, LAST_STEP, SHRINK, PATIENCE, DEFLECTION = 0.1, 1e-3, 0.6, 20, 0.8
"""Constants of the subgradient steps, those of `planner.cover.bound`."""

NODE_WORK, ROOT_NODES = 1000, 100
"""Charge of a node of HiGHS for each load of the model; the root with its cuts and heuristics counts as many."""

LESS = 1e-6
"""HiGHS is asked for rows satisfied to 1 less this, so that its tolerance cannot make its bound wrong."""


class DemandBound:
    """The best bound so far, with its multipliers.

    Attributes:
        dual: L(u).
        reduced_costs: (V,) 1 - sum_i A_ij u_i.
    """

    def __init__(self, problem: DemandProblem) -> None:
        self.problem = problem
        self.A, self.twice = strengthened(problem)
        self.At = self.A.T.tocsr()
        self.units = problem.units.astype(np.float64)
        self.dual = 0.0
        self.multipliers: Floats = np.zeros(self.A.shape[0])
        self.reduced_costs: Floats = np.ones(problem.n_columns)
        # Feasible to begin with: each row's part of the column that has most of it.
        weights = np.ones(problem.n_rows) if problem.full else self.units
        per_column = np.asarray(self.At[:, : problem.n_rows] @ weights)
        best = np.maximum.reduceat(np.append(per_column[problem.row_columns], 0.0), problem.row_start[:-1])
        self.evaluate(np.concatenate((weights / np.maximum(best, 1e-300), np.zeros(len(self.twice)))))

    @property
    def value(self) -> int:
        """No choice that meets the target has fewer columns."""
        return max(ceil(self.dual - ROUNDING), 0)

    def evaluate(self, u: Floats) -> tuple[float, Floats, Floats]:
        """L(u), the reduced costs, and y of each row of A; kept where it is the best."""
        problem = self.problem
        reduced: Floats = 1.0 - np.asarray(self.At @ u)
        y = np.ones(problem.n_rows)
        of_row = u[: problem.n_rows].copy()
        of_row[self.twice] += u[problem.n_rows :]
        if not problem.full:
            order = np.argsort(of_row / self.units, kind="stable")
            reached = np.cumsum(self.units[order])
            last = int(np.searchsorted(reached, problem.required))
            y[order[last:]] = 0.0
            if last < problem.n_rows:
                y[order[last]] = (problem.required - (reached[last - 1] if last else 0.0)) / self.units[order[last]]
        dual = float(of_row @ y + np.minimum(reduced, 0.0).sum())
        if dual > self.dual:
            self.dual, self.multipliers, self.reduced_costs = dual, u, reduced
        return dual, reduced, np.concatenate((y, y[self.twice]))

    def climb(self, upper: int, budget: Budget) -> None:
        """Deflected subgradient steps of Polyak's length, until the bound meets the upper one or nothing rises."""
        u, direction = self.multipliers, np.zeros(self.A.shape[0])
        step, stalled, work = FIRST_STEP, 0, 2 * self.problem.n_entries + STEP_WORK
        while self.value < upper and step > LAST_STEP and budget.spend(work):
            before = self.dual
            dual, reduced, y = self.evaluate(u)
            stalled = 0 if self.dual > before * (1 + 1e-6) else stalled + 1
            if stalled >= PATIENCE:
                step, stalled = step * SHRINK, 0
            gradient = y - np.asarray(self.A @ (reduced < 0).astype(np.float64))
            direction = (1.0 - DEFLECTION) * gradient + DEFLECTION * direction
            go = np.where((u <= 0) & (direction < 0), 0.0, direction)
            length = float(go @ go)
            if length == 0.0:
                break
            u = np.maximum(u + step * max(upper - dual, 0.0) / length * go, 0.0)

    def linear_programme(self, budget: Budget) -> None:
        """The dual of the linear relaxation by HiGHS, evaluated here."""
        import scipy.sparse as sp
        from scipy.optimize import linprog

        problem = self.problem
        n_rows, n_columns = self.A.shape
        per_pivot = PIVOT_WORK * (n_rows + n_columns)
        limit = min(budget.left // per_pivot, 2**31 - 1)
        if self.A.nnz > LP_ENTRIES or limit < n_columns:
            return
        costs, A, b = np.ones(n_columns), -self.A, -np.ones(n_rows)
        if not problem.full:
            weights, target = self.units / self.units.mean(), problem.required / self.units.mean()
            area = sp.csr_array(np.concatenate((np.zeros(n_columns), -weights))[None, :])
            counted = sp.vstack((sp.eye_array(problem.n_rows), sp.eye_array(problem.n_rows).tocsr()[self.twice]))
            A = sp.vstack((sp.hstack((-self.A, counted)), area)).tocsr()
            costs = np.concatenate((costs, np.zeros(problem.n_rows)))
            b = np.concatenate((np.zeros(n_rows), [-target]))
        options: Any = {"maxiter": int(limit)}
        if budget.seconds_left is not None:
            options["time_limit"] = budget.seconds_left
        result = interruptible(
            lambda: linprog(costs, A_ub=A, b_ub=b, bounds=(0, 1), method="highs-ds", options=options)
        )
        budget.spend(int(result.nit) * per_pivot)
        if result.status == 0:
            self.evaluate(np.maximum(-np.asarray(result.ineqlin.marginals[:n_rows], dtype=np.float64), 0.0))


def strengthened(problem: DemandProblem) -> tuple[Any, Ints]:
    """The shares with a second row for each row that no column satisfies alone, and which rows these are."""
    import scipy.sparse as sp

    A = problem.matrix()
    need = np.ones(problem.n_rows, dtype=np.int64)
    for row in range(problem.n_rows):
        brings = np.sort(problem.row_load[problem.row_start[row] : problem.row_start[row + 1]])[::-1]
        if len(brings) and brings[0] < problem.demand[row]:
            reached = np.cumsum(brings)
            need[row] = min(int(np.searchsorted(reached, problem.demand[row])) + 1, len(brings))
    twice = np.flatnonzero(need > 1)
    counted = A[twice]
    counted.data = 1.0 / np.repeat(need[twice], np.diff(counted.indptr))
    return sp.vstack((A, counted)).tocsr(), twice


def lower_bound(problem: DemandProblem, upper: int, budget: Budget) -> DemandBound:
    """The best bound that the budget allows; work is charged as a whole.

    Args:
        problem: what is demanded.
        upper: size of a known choice; nothing is done once the bound meets it.
        budget: work and clock.
    """
    everything = budget.spent + budget.left
    found = DemandBound(problem)
    try:
        with ends_search(budget):
            if found.value < upper:
                found.linear_programme(budget)
            found.climb(upper, budget)
    finally:
        # Steps hang on float rounding, which differs between machines; what is left must not.
        budget.spent = max(budget.spent, everything)
    return found


def close_gap(problem: DemandProblem, best: Ints, known: DemandBound, budget: Budget) -> tuple[Ints, int]:
    """HiGHS on the columns that a choice with fewer columns may contain, where the budget pays for its root.

    Returns:
        The best choice, and a lower bound.
    """
    import scipy.sparse as sp
    from scipy.optimize import Bounds, LinearConstraint, milp

    lower, upper = min(known.value, len(best)), len(best)
    if lower >= upper or budget.interrupted:
        return best, lower
    keep = np.flatnonzero(known.dual + np.maximum(known.reduced_costs, 0.0) <= upper - 1 + ROUNDING)
    core = problem.on_columns(keep)
    if not core.met(np.arange(core.n_columns)):
        return best, upper
    nodes = budget.left // max(NODE_WORK * core.n_entries, 1) - ROOT_NODES + 1
    if nodes <= 0:
        return best, lower
    A, n_rows, n_columns = core.matrix(), core.n_rows, core.n_columns
    costs, integrality = np.ones(n_columns), np.ones(n_columns, dtype=np.int64)
    if core.full:
        constraints = [LinearConstraint(A, lb=1.0 - LESS)]
    else:
        scale = float(core.units.mean())
        costs = np.concatenate((costs, np.zeros(n_rows)))
        integrality = np.ones(n_columns + n_rows, dtype=np.int64)  # a row counts as a whole or not at all
        weights = np.concatenate((np.zeros(n_columns), core.units / scale))
        constraints = [
            LinearConstraint(sp.hstack((A, -sp.eye_array(n_rows))).tocsr(), lb=-LESS),
            LinearConstraint(sp.csr_array(weights[None, :]), lb=core.required / scale * (1 - LESS)),
        ]
    constraints.append(LinearConstraint(sp.csr_array(costs[None, :]), ub=float(upper - 1)))
    options: Any = {"node_limit": int(min(nodes, 2**31 - 1)), "mip_rel_gap": 0.0}
    if budget.seconds_left is not None:
        options["time_limit"] = budget.seconds_left
    with ends_search(budget):
        result = interruptible(
            lambda: milp(costs, integrality=integrality, bounds=Bounds(0, 1), constraints=constraints, options=options)
        )
    if budget.interrupted:
        return best, lower
    budget.spend(NODE_WORK * core.n_entries * (ROOT_NODES + int(getattr(result, "mip_node_count", None) or 0)))
    if result.status == 2:
        return best, upper
    dual = getattr(result, "mip_dual_bound", None)
    if dual is not None and np.isfinite(dual):
        lower = max(lower, min(ceil(dual - ROUNDING), upper))
    if result.x is not None:
        found = keep[result.x[:n_columns] > 0.5]
        if len(found) < upper and problem.met(found):
            best = found
    return best, min(lower, len(best))
