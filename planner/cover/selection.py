"""`solve`: check, bring into canonical form, answer, and tell."""

import time
from collections.abc import Callable

import numpy as np

from planner.cover.answer import Cover
from planner.cover.answer_of_columns import told
from planner.cover.budget import DEFAULT_EFFORT, LARGE, LARGE_PACE, Budget, scaled_effort
from planner.cover.canonical import canonical
from planner.cover.overlap import connected_cover
from planner.cover.problem import CoverProblem
from planner.cover.solvers import SOLVERS, answer
from planner.cover.targets import solve_parts
from planner.errors import PlannerError
from planner.values import Ints

CANONICAL_WORK = 25
"""Charge of checking and sorting, for each entry of the matrix."""


def solve(
    problem: CoverProblem,
    *,
    rng: np.random.Generator,
    solver: str = "auto",
    start: Ints | None = None,
    effort_budget: int | None = None,
    time_limit_s: float | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> Cover:
    """Choose the fewest or cheapest columns for a coverage, or the most area with a number of them.

    A first cover and a lower bound are always computed, whatever the budget. Ctrl-C ends the search: the best so far is
    returned, and its status says so.

    Args:
        problem: what is asked for.
        rng: random choices of the search.
        solver: a name in `SOLVERS`.
        start: (n,) columns of a choice to begin with, which need not meet what is asked for; others are left out where
            they may not be used. None, and where views have to hang together: the greedy choice.
        effort_budget: units of work for everything together (500 million are about a second of one core); None:
            `DEFAULT_WORK`, `grown` with the matrix where there are no targets for parts and no weights.
        time_limit_s: wall-clock guard [s]; reported in the status when it fires.
        clock: seconds, for the guard.

    Raises:
        PlannerError: for a problem that contradicts itself, or an unknown solver.
    """
    if solver not in SOLVERS:
        raise PlannerError(f"there is no solver {solver!r}; choose one of {', '.join(SOLVERS)}")
    if problem.region_coverage or problem.weights is not None:
        since = clock()

        def ask(single: CoverProblem, share: float) -> Cover:
            left = None if time_limit_s is None else max(time_limit_s - (clock() - since), 0.0)
            work = int(share * (DEFAULT_EFFORT if effort_budget is None else effort_budget))
            return solve(
                single, rng=rng, solver=solver, start=start, effort_budget=work, time_limit_s=left, clock=clock
            )

        return solve_parts(problem, ask, start)
    work = Budget(DEFAULT_EFFORT if effort_budget is None else effort_budget, time_limit_s, clock)
    found = canonical(problem)
    if effort_budget is None:
        work.limit = scaled_effort(work.limit, found.whole.n_entries)
    work.pace = LARGE_PACE if found.whole.n_entries > LARGE else 1.0
    work.spend(CANONICAL_WORK * found.whole.n_entries)
    if len(found.rest.adjacent):
        return connected_cover(problem, found, rng, work, solver)
    begun = None if start is None else np.flatnonzero(np.isin(found.columns[found.rest_columns], start))
    inner, bound, fewest = answer(found.rest, solver, rng, work, begun)
    columns = np.concatenate((found.fixed, found.rest_columns[inner]))
    if problem.max_views is None:
        bound += found.whole.cost(columns) - found.rest.cost(inner)
    return told(found, columns, bound, solver=solver, work=work, problem=problem, fewest=fewest + len(found.pinned))
