"""Greedy cover: always the column that covers most uncovered area for its cost; and the removal of redundant ones.

Chvatal 1979 (doi:10.1287/moor.4.3.233). A row counts as open until as many columns as it demands cover it. Ties go to
the first column in canonical order, so the result does not depend on how the candidates were numbered.
"""

import heapq

import numpy as np

from planner.cover.budget import Budget
from planner.cover.canonical import CoverProblem
from planner.values import Bools, Floats, Ints


def greedy(problem: CoverProblem, rng: np.random.Generator, budget: Budget) -> Ints:
    """Cover greedily; the baseline that every other solver starts from.

    Args:
        problem: what to cover.
        rng: not used (one signature for all solvers).
        budget: booked but never a reason to stop: without a cover there is no plan.

    Returns:
        Columns in the order in which they were chosen, redundant ones removed.
    """
    chosen = prune(problem, complete(problem, np.zeros(0, dtype=np.int64)))
    budget.spend(problem.n_entries)
    budget.offer(chosen, problem.cost(chosen))
    return chosen


def complete(problem: CoverProblem, columns: Ints) -> Ints:
    """Add columns greedily until the target is met.

    Args:
        problem: what to cover.
        columns: a partial cover; kept, in front.
    """
    counts = problem.counts(columns)
    uncovered = counts < problem.demand
    gains = uncovered_area(problem, np.flatnonzero(uncovered))
    gains[columns] = -np.inf  # where rows are covered more than once, a chosen column would still seem to gain
    unit_cost = problem.unit_cost
    chosen = columns.tolist()
    missing = missing_units(problem, uncovered)
    while missing > 0:
        best = int(np.argmax(gains if unit_cost else gains / problem.costs))
        rows = problem.column_rows[problem.column_start[best] : problem.column_start[best + 1]]
        counts[rows] += 1
        done = rows[counts[rows] == problem.demand[rows]]
        uncovered[done] = False
        missing -= int(problem.units[done].sum())
        gains -= uncovered_area(problem, done)
        gains[best] = -np.inf
        chosen.append(best)
    return np.array(chosen, dtype=np.int64)


def missing_units(problem: CoverProblem, uncovered: Bools) -> int:
    """Units that must still be covered: zero or less means that the target is met."""
    return int(problem.units[uncovered].sum()) - problem.slack


def uncovered_area(problem: CoverProblem, rows: Ints) -> Floats:
    """(V,) units of the given rows that each column covers."""
    columns, lengths = problem.columns_of(rows)
    return column_sums(problem, columns, np.repeat(problem.units[rows], lengths))


def column_sums(problem: CoverProblem, columns: Ints, weights: Floats) -> Floats:
    """(V,) sum of the weights by column."""
    # bincount of nothing is of integers
    return np.bincount(columns, weights=weights, minlength=problem.n_columns).astype(np.float64, copy=False)


def prune(problem: CoverProblem, columns: Ints) -> Ints:
    """Remove redundant columns, the dearest first, of equal cost the last first.

    One pass is enough, because a column that is needed stays needed.
    """
    counts = problem.counts(columns)
    spare = problem.slack - int(problem.units[counts < problem.demand].sum())
    keep = np.ones(len(columns), dtype=bool)
    for position in np.lexsort((np.arange(len(columns)), problem.costs[columns]))[::-1].tolist():
        start = problem.column_start[columns[position] : columns[position] + 2]
        rows = problem.column_rows[start[0] : start[1]]
        needed = rows[counts[rows] == problem.demand[rows]]
        loss = int(problem.units[needed].sum())
        if loss <= spare:
            keep[position] = False
            counts[rows] -= 1
            spare -= loss
    return columns[keep]


def by_marginal_area(problem: CoverProblem, columns: Ints) -> tuple[Ints, list[Ints]]:
    """Order columns by what each adds, largest first, and list the rows whose demand each is the first to satisfy.

    Returns:
        The columns in that order, and for each the rows it completes.
    """
    counts = np.zeros(problem.n_rows, dtype=np.int64)
    rows = {j: problem.column_rows[problem.column_start[j] : problem.column_start[j + 1]] for j in columns.tolist()}

    def gain(column: int) -> int:
        own = rows[column]
        return int(problem.units[own[counts[own] < problem.demand[own]]].sum())

    # Gains only fall, so a gain that is on top and still true is the largest; canonical order decides ties.
    waiting = [(-gain(column), column) for column in rows]
    heapq.heapify(waiting)
    order: list[int] = []
    added: list[Ints] = []
    while waiting:
        known, best = waiting[0]
        if (now := -gain(best)) != known:
            heapq.heapreplace(waiting, (now, best))
            continue
        heapq.heappop(waiting)
        counts[rows[best]] += 1
        order.append(best)
        added.append(rows[best][counts[rows[best]] == problem.demand[rows[best]]])
    return np.array(order, dtype=np.int64), added
