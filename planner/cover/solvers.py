"""The solvers by name, all with one signature: `(problem, rng, budget) -> columns`."""

from collections.abc import Callable

import numpy as np

from planner.cover.bound import bound
from planner.cover.budget import Budget
from planner.cover.exact import exact, node_limit
from planner.cover.greedy import greedy
from planner.cover.local_search import local_search
from planner.cover.meta_raps import meta_raps
from planner.cover.problem import CoverProblem, Ints

Solver = Callable[[CoverProblem, np.random.Generator, Budget], Ints]
"""Takes a reduced problem, gives a cover without redundant columns; best cover, bound and work stay in the budget."""

BOUND_SHARE, SEARCH_SHARE = 0.35, 0.7
"""`auto`: share of the budget for the bound, and of what is left then for the search before the exact solver."""

HOPEFUL_EXCESS = 0.1
"""`auto` tries to prove a cover that exceeds the bound by at most this share (or 2 columns); beyond, it searches on."""

SMALL = 150
"""With no more columns than this the exact solver is tried whatever the gap."""


def auto(problem: CoverProblem, rng: np.random.Generator, budget: Budget) -> Ints:
    """Greedy, bound, local search, and the exact solver while a gap and enough budget for its root remain."""
    best = greedy(problem, rng, budget) if budget.best is None else budget.best
    if problem.trivial or budget.proven:
        return best
    if budget.dual is None:
        with budget.portion(BOUND_SHARE):
            budget.dual = bound(problem, len(best), budget)
    affordable = node_limit(problem, budget) > 0
    with budget.portion(SEARCH_SHARE if affordable else 1.0):
        best = local_search(problem, rng, budget)
    if budget.proven or not affordable:
        return best
    excess = len(best) - budget.lower_bound
    if excess > max(2, HOPEFUL_EXCESS * len(best)) and problem.n_columns > SMALL:
        return local_search(problem, rng, budget)
    return exact(problem, rng, budget)


SOLVERS: dict[str, Solver] = {
    "auto": auto,
    "greedy": greedy,
    "meta-raps": meta_raps,
    "local-search": local_search,
    "exact": exact,
}
