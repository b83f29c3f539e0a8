"""Lower bounds on the cost of a cover: Lagrangian dual, certified by one exact evaluation.

For multipliers u >= 0 of the rows (Beasley 1990, doi:10.1002/1520-6750(199002)37:1<151::AID-NAV3220370110>3.0.CO;2-2)

    L(u) = min { sum_i u_i d_i y_i } + sum_j min(0, c_j - sum_{i in j} u_i)

is at most the least cost (c_j = 1: the fewest columns). d_i is what row i demands. y says which rows are covered: all
of them for a full cover; otherwise the cheapest fractional choice that reaches the required area (a knapsack solved by
sorting u_i d_i / area_i), so the same bound holds for partial cover. max_u L(u) equals the bound of the linear
relaxation.

Whatever proposes u (subgradient steps, or the dual of an LP solver), the bound is L(u) evaluated here and rounded up as
ceil(L - 1e-6) (costs are whole numbers): a tolerance inside a solver can weaken it but never make it wrong.
"""

from typing import Any

import numpy as np

from planner.cover.budget import STEP_WORK, Bound, Budget
from planner.cover.interrupts import interruptible
from planner.cover.canonical import CoverProblem
from planner.values import Floats, Ints

LARGE_SUM = 1e-9
"""Share that is taken off sums of units that are too large to be exact: far above their float error."""

LP_ENTRIES, LP_ENTRIES_WIDE, WIDE = 400_000, 60_000, 4
"""Matrices up to the first number of ones get the LP solver's dual, those with more than `WIDE` columns for each row up
to the second; larger ones cost it many seconds, and the subgradient steps come as near."""

LP_PIVOTS = 3
"""The LP solver is not started where the budget pays for fewer pivots than this for each row: it would end in vain."""

FIRST_STEP, LAST_STEP, SHRINK, PATIENCE, DEFLECTION = 0.1, 1e-3, 0.6, 20, 0.8
"""Constants of the subgradient steps, see there."""

PIVOT_WORK = 30
"""Charge of one simplex pivot for each row and column of the matrix."""

MOST_STEPS, MOST_PIVOTS = 1000, 2
"""At most so many subgradient steps are made, and so many pivots for each row and column; this is what is charged."""


def evaluate(problem: CoverProblem, multipliers: Floats, columns_by_rows: Any) -> tuple[Bound, Floats]:
    """L(u), and the y of its knapsack.

    Args:
        problem: the problem.
        multipliers: (S,) u, not negative.
        columns_by_rows: (V, S) transposed matrix.
    """
    reduced = problem.costs - columns_by_rows @ multipliers
    y = np.ones(problem.n_rows)
    demanded = multipliers * problem.demand
    if not problem.full:
        ratio = demanded / problem.units
        order = np.argsort(ratio, kind="stable")
        reached = np.cumsum(problem.units[order])
        last = int(np.searchsorted(reached, problem.required))
        y[order[last:]] = 0.0
        if last < problem.n_rows:
            before = reached[last - 1] if last else 0.0
            y[order[last]] = (problem.required - before) / problem.units[order[last]]
    dual = float(demanded @ y + np.minimum(reduced, 0.0).sum())
    return Bound(dual, multipliers, reduced), y


def bound(problem: CoverProblem, upper: int, budget: Budget) -> Bound:
    """The best lower bound that the budget allows; at budget 0 that of one evaluation.

    Args:
        problem: the problem (reduce it first: the bound costs less and is the same).
        upper: cost of a known cover; scales the subgradient steps, and nothing is done once the bound reaches it.
        budget: work, charged with all that the bound could have cost unless the first evaluation closes the gap; also
            receives the bound.
    """
    rows_by_columns = problem.matrix()
    columns_by_rows = rows_by_columns.T.tocsr()
    everything = budget.spent + min(budget.left, _most_work(problem))
    best, _ = evaluate(problem, _first_multipliers(problem), columns_by_rows)
    largest = _largest_columns(problem)
    budget.prove(max(best.value, largest))
    if max(best.value, largest) >= upper or not budget.spend(4 * problem.n_entries):
        return best
    limit, budget.limit = budget.limit, everything
    try:
        best = _raise(problem, best, upper, budget, rows_by_columns, columns_by_rows)
    finally:
        # The number of steps hangs on float rounding, which differs between machines; what is left must not.
        budget.limit, budget.spent = limit, max(budget.spent, everything)
    return best


def _raise(
    problem: CoverProblem, best: Bound, upper: int, budget: Budget, rows_by_columns: Any, columns_by_rows: Any
) -> Bound:
    """Improve the multipliers with an LP solver or by subgradient steps."""
    if _suits_lp(problem) and budget.left >= LP_PIVOTS * problem.n_rows * _pivot_work(problem):
        lp, work = _linear_programme(problem, rows_by_columns, columns_by_rows, budget)
        budget.spend(work)
        best = max(best, lp, key=lambda candidate: candidate.dual)
        solved = lp.dual > 0.999 * best.dual
    else:
        solved = False
    if not solved:
        best = _subgradient(problem, best, upper, budget, rows_by_columns, columns_by_rows)
    budget.prove(best.value)
    return best


def _most_work(problem: CoverProblem) -> int:
    """Charge of a bound, whatever way it takes."""
    size = problem.n_rows + problem.n_columns
    if _suits_lp(problem):
        return 4 * problem.n_entries + MOST_PIVOTS * PIVOT_WORK * size**2
    return 4 * problem.n_entries + MOST_STEPS * (problem.n_entries + STEP_WORK)


def _suits_lp(problem: CoverProblem) -> bool:
    wide = problem.n_columns > WIDE * problem.n_rows
    return problem.n_entries <= (LP_ENTRIES_WIDE if wide else LP_ENTRIES)


def _pivot_work(problem: CoverProblem) -> int:
    return PIVOT_WORK * (problem.n_rows + problem.n_columns)


def _first_multipliers(problem: CoverProblem) -> Floats:
    """Feasible multipliers: each row's share of the best of its columns, so that no reduced cost is negative."""
    weights = np.ones(problem.n_rows) if problem.full else problem.units
    per_column = np.add.reduceat(weights[problem.column_rows], problem.column_start[:-1]) / problem.costs
    largest = np.maximum.reduceat(per_column[problem.row_columns], problem.row_start[:-1])
    share: Floats = weights / largest
    return share


def _largest_columns(problem: CoverProblem) -> int:
    """The fewest columns whose areas, overlaps ignored, reach what is required; 0 where costs differ."""
    if not problem.unit_cost:
        return 0
    # In float64: thousands of columns that each cover half of the area sum to more than an int64 holds.
    areas = np.add.reduceat(problem.units[problem.column_rows], problem.column_start[:-1])
    required = float(problem.units @ problem.demand if problem.full else problem.required * int(problem.demand.min()))
    if required >= 2**53:  # sums below that are exact
        required *= 1 - LARGE_SUM
    return int(np.searchsorted(np.cumsum(np.sort(areas)[::-1]), required)) + 1


def _subgradient(
    problem: CoverProblem, best: Bound, upper: int, budget: Budget, rows_by_columns: Any, columns_by_rows: Any
) -> Bound:
    """Deflected subgradient steps of Polyak's length (Camerini, Fratta, Maffioli 1975, doi:10.1007/BFb0120697).

    u <- max(0, u + step (upper - L) d / |d|^2) along the smoothed direction d = (1 - DEFLECTION) g + DEFLECTION d;
    the step shrinks when L has not risen for PATIENCE iterations. The constants were tuned on visibility matrices and
    random ones.
    """
    multipliers = best.multipliers
    direction = np.zeros(problem.n_rows)
    step = FIRST_STEP
    stalled = 0
    work = problem.n_entries + STEP_WORK
    for _ in range(MOST_STEPS):
        if best.value >= upper or step <= LAST_STEP or not budget.spend(work):
            break
        current, y = evaluate(problem, multipliers, columns_by_rows)
        if current.dual > best.dual * (1.0 + 1e-6):
            best, stalled = current, 0
        else:
            stalled += 1
            if stalled >= PATIENCE:
                step, stalled = step * SHRINK, 0
        gradient = y * problem.demand - rows_by_columns @ (current.reduced_costs < 0).astype(np.float64)
        direction = (1.0 - DEFLECTION) * gradient + DEFLECTION * direction
        move = np.where((multipliers <= 0) & (direction < 0), 0.0, direction)
        length = float(move @ move)
        if length == 0.0:
            break
        multipliers = np.maximum(multipliers + step * (upper - current.dual) / length * move, 0.0)
    return best


def _linear_programme(
    problem: CoverProblem, rows_by_columns: Any, columns_by_rows: Any, budget: Budget
) -> tuple[Bound, int]:
    """The dual of the linear relaxation by HiGHS, evaluated exactly here; and the work it was charged."""
    import scipy.sparse as sp
    from scipy.optimize import linprog

    n_rows, n_columns = problem.shape
    per_pivot = _pivot_work(problem)
    limit = min(max(budget.left // per_pivot, 1), MOST_PIVOTS * (n_rows + n_columns))
    options: Any = {"maxiter": limit}
    if budget.seconds_left is not None:
        options["time_limit"] = budget.seconds_left
    scale = float(problem.costs.mean())
    if problem.full:
        costs, A, b = problem.costs / scale, -rows_by_columns, -problem.demand.astype(np.float64)
    else:
        weights = problem.units / problem.units.mean()
        target = problem.required / problem.units.mean()
        covering = sp.hstack((-rows_by_columns, sp.diags_array(problem.demand.astype(np.float64))))
        area = sp.csr_array(np.concatenate((np.zeros(n_columns), -weights))[None, :])
        A = sp.vstack((covering, area)).tocsr()
        costs = np.concatenate((problem.costs / scale, np.zeros(n_rows)))
        b = np.concatenate((np.zeros(n_rows), [-target]))
    # Where once is enough no column is wanted more than once, and the dual needs no multiplier for that.
    bounds = (0, None) if problem.full and problem.once else (0, 1)
    result = interruptible(lambda: linprog(costs, A_ub=A, b_ub=b, bounds=bounds, method="highs-ds", options=options))
    multipliers: Floats = np.zeros(n_rows)
    if getattr(result, "ineqlin", None) is not None and result.status == 0:
        multipliers = np.maximum(-scale * np.asarray(result.ineqlin.marginals[:n_rows], dtype=np.float64), 0.0)
    evaluated, _ = evaluate(problem, multipliers, columns_by_rows)
    return evaluated, int(result.nit) * per_pivot


def without_useless_columns(problem: CoverProblem, known: Bound, upper: int) -> tuple[CoverProblem, Ints] | None:
    """The core of the problem for finding a cover that costs less than `upper`.

    Returns:
        The problem on the columns that such a cover may contain, and their indices; None when it cannot exist because
        a row that must be covered, or the required area, is out of their reach.
    """
    keep = known.useful(upper)
    covered = problem.covered(np.flatnonzero(keep))
    if not problem.met(covered):
        return None
    required = problem.required
    return problem.restricted(covered, keep, problem.units, required), np.flatnonzero(keep)
