"""The solvers by name, all with one signature: `(problem, rng, budget) -> columns`."""

from collections.abc import Callable

import numpy as np

from planner.cover.bound import bound
from planner.cover.budget import Budget
from planner.cover.exact import exact, improve_or_prove
from planner.cover.greedy import greedy
from planner.cover.local_search import local_search
from planner.cover.meta_raps import meta_raps
from planner.cover.problem import CoverProblem, Ints

Solver = Callable[[CoverProblem, np.random.Generator, Budget], Ints]
"""Takes a reduced problem, gives a cover without redundant columns; best cover, bound and work stay in the budget."""

BOUND_SHARE, SEARCH_SHARE = 0.35, 0.5
"""`auto`: share of the budget for the bound, and of what is left then for the search before the exact solver."""

HOPEFUL_EXCESS = 0.1
"""`auto` tries the exact solver on a cover that exceeds the bound by at most this share, or by 2 columns."""

SMALL = 150
"""With no more columns than this the exact solver is tried whatever the gap."""


def auto(problem: CoverProblem, rng: np.random.Generator, budget: Budget) -> Ints:
    """Greedy, bound, local search, the exact solver where the budget pays for its root, local search with the rest."""
    best = greedy(problem, rng, budget) if budget.best is None else budget.best
    if problem.trivial or budget.proven:
        return best
    if budget.dual is None:
        with budget.portion(BOUND_SHARE):
            budget.dual = bound(problem, problem.cost(best), budget)
    with budget.portion(SEARCH_SHARE):
        best = local_search(problem, rng, budget)
    excess = (problem.cost(best) - budget.lower_bound) / float(problem.costs.mean())
    if not budget.proven and (excess <= max(2, HOPEFUL_EXCESS * len(best)) or problem.n_columns <= SMALL):
        best = improve_or_prove(problem, best, budget.dual, budget, at_least_root=False)
    if budget.spend(0):
        best = local_search(problem, rng, budget)
    return best


SOLVERS: dict[str, Solver] = {
    "auto": auto,
    "greedy": greedy,
    "meta-raps": meta_raps,
    "local-search": local_search,
    "exact": exact,
}
