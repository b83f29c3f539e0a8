"""Local search with row weights: keep a cover that costs too little, swap until the target is met, repeat.

For full cover this is RWLS (Gao, Weise, Li 2015, doi:10.1016/j.ejor.2015.05.038): whenever the target is met the
cover is kept and the column with the smallest loss is removed; otherwise one column leaves (smallest weighted loss, not
the one that came last), one that covers a randomly drawn uncovered row enters (largest weighted gain, and only when a
column that shares a row with it has moved since it left: configuration checking), ties to the one that moved longest
ago, and every row that is still uncovered gains weight 1. With costs, losses and gains count per cost, and columns
enter while the cover stays cheaper than the best one. A row that must be covered several times counts as uncovered
until it is.

Partial cover needs two changes. A row may stay uncovered for good, so the entering column is the best of all columns
rather than of one row's; and only a few random uncovered rows gain weight per step (their area once more), with all
weights drawn back towards the areas when they have grown, so that rows best left out do not come to dominate.

The loops are in `local_search_kernels`; they run in chunks, between which the clock, Ctrl-C and the budget are heard.
"""

from typing import TYPE_CHECKING

import numpy as np

from planner.cover.budget import Budget
from planner.cover.greedy import greedy, prune
from planner.cover.canonical import CoverProblem
from planner.values import Ints

if TYPE_CHECKING:
    from planner.cover.local_search_kernels import State

AREA_WEIGHT = 1000
"""Partial cover: initial weight of a row of mean area (a resolution of 0.1 % of it)."""

CHUNK_WORK = 20_000_000
"""Work between two looks at the clock: about 40 ms."""


def local_search(problem: CoverProblem, rng: np.random.Generator, budget: Budget) -> Ints:
    """Improve the budget's best cover (the greedy one if there is none) while work is left.

    Args:
        problem: what to cover.
        rng: seeds the draws of uncovered rows.
        budget: charged for the entries that the steps touch.

    Returns:
        Columns of the best cover.
    """
    best = greedy(problem, rng, budget) if budget.best is None else budget.best
    if problem.trivial or problem.n_columns == 0 or not budget.spend(0):
        return best
    # Importing numba costs 0.3 s.
    from planner.cover.local_search_kernels import BEST_COST, BEST_MEMBERS, full_steps, partial_steps, start

    steps = full_steps if problem.full else partial_steps
    state = _state(problem, problem.cost(best), rng)
    start(state, best)
    found = int(state.numbers[BEST_COST])
    work = problem.n_entries
    while budget.spend(work):
        work = steps(state, min(CHUNK_WORK, budget.left), budget.lower_bound)
        if state.numbers[BEST_COST] < found:
            found = int(state.numbers[BEST_COST])
            best = prune(problem, state.best[: state.numbers[BEST_MEMBERS]].copy())
            budget.offer(best, problem.cost(best))
    return best


def _state(problem: CoverProblem, best_cost: int, rng: np.random.Generator) -> "State":
    """The arrays of a search that has no column yet."""
    from planner.cover import local_search_kernels as kernels  # importing numba costs 0.3 s

    n_rows, n_columns = problem.shape
    if problem.full:
        areas = np.ones(n_rows, dtype=np.int64)
    else:
        areas = np.maximum(np.rint(problem.units * (AREA_WEIGHT / problem.units.mean())), 1.0).astype(np.int64)
    numbers = np.zeros(kernels.NUMBERS, dtype=np.int64)
    numbers[kernels.OPEN] = n_rows
    numbers[kernels.BEST_COST] = best_cost
    numbers[kernels.TABU] = -1
    units = problem.units.astype(np.int64)
    numbers[kernels.MISSING] = int(units.sum()) - problem.slack

    def of_rows() -> Ints:
        return np.zeros(n_rows, dtype=np.int64)

    def of_columns() -> Ints:
        return np.zeros(n_columns, dtype=np.int64)

    return kernels.State(
        row_start=problem.row_start,
        row_columns=problem.row_columns.astype(np.int32),  # half the memory traffic of the innermost loops
        column_start=problem.column_start,
        column_rows=problem.column_rows.astype(np.int32),
        demand=problem.demand,
        units=units,
        costs=problem.costs,
        areas=areas,
        weights=areas.copy(),
        counts=of_rows(),
        owner=of_rows(),
        score=of_columns(),
        chosen=np.zeros(n_columns, dtype=np.bool_),
        members=of_columns(),
        place=of_columns(),
        open_rows=np.arange(n_rows),
        open_place=np.arange(n_rows),
        stamp=of_columns(),
        row_stamp=of_rows(),
        best=of_columns(),
        numbers=numbers,
        random=rng.integers(0, 2**64, 1, dtype=np.uint64),
    )
