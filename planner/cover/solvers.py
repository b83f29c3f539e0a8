"""The solvers by name, all with one signature: `(problem, rng, budget) -> columns`."""

from collections.abc import Callable

import numpy as np

from planner.cover.area_search import search_most
from planner.cover.bound import bound
from planner.cover.budget import Budget
from planner.cover.exact import exact, improve_or_prove
from planner.cover.greedy import greedy, prune
from planner.cover.local_search import local_search
from planner.cover.meta_raps import meta_raps
from planner.cover.canonical import CoverProblem
from planner.values import Ints

Solver = Callable[[CoverProblem, np.random.Generator, Budget], Ints]
"""Takes a reduced problem, gives a cover without redundant columns; best cover, bound and work stay in the budget."""

BOUND_SHARE, SEARCH_SHARE = 0.35, 0.5
"""`auto`: most of the budget that the bound may take, and share of what is left for the search before `exact`."""

AREA_SHARE = 0.4
"""`auto` below full coverage: share of what is left for each search with one column less."""

HOPEFUL_EXCESS = 0.1
"""`auto` tries the exact solver on a cover that exceeds the bound by at most this share, or by 2 columns."""

SMALL = 150
"""With no more columns than this the exact solver is tried whatever the gap, and before the search where that is small.

What the reductions leave of most parts is so small that the exact solver ends it in an instant.
"""


def auto(problem: CoverProblem, rng: np.random.Generator, budget: Budget) -> Ints:
    """Greedy, bound, local search, the exact solver where the budget pays for its root, local search with the rest."""
    best = greedy(problem, rng, budget) if budget.best is None else budget.best
    if problem.trivial or budget.proven:
        return best
    if budget.dual is None:
        with budget.portion(BOUND_SHARE):
            budget.dual = bound(problem, problem.cost(best), budget)
    if _hopeful(problem, best, budget):
        best = improve_or_prove(problem, best, budget.dual, budget, most_columns=SMALL)
    if budget.spend(0):
        with budget.portion(SEARCH_SHARE):
            best = local_search(problem, rng, budget)
        best = _fewer_by_area(problem, best, rng, budget)
    if (_hopeful(problem, best, budget) or problem.n_columns <= SMALL) and budget.spend(0):
        best = improve_or_prove(problem, best, budget.dual, budget)
    if budget.spend(0):
        best = local_search(problem, rng, budget)
    return best


def _fewer_by_area(problem: CoverProblem, best: Ints, rng: np.random.Generator, budget: Budget) -> Ints:
    """Below full coverage: the most area with one column less, as long as it is enough.

    Which rows are left out is what such covers differ in, and swaps judged by area find it where row weights do not.
    """
    if problem.full or not (problem.once and problem.unit_cost):
        return best
    while len(best) > 1 and budget.spend(0):
        with budget.portion(AREA_SHARE):
            columns, area = search_most(problem, len(best) - 1, rng, budget, problem.required)
        if area < problem.required:
            break
        best = prune(problem, columns)
        budget.offer(best, problem.cost(best))
    return best


def _hopeful(problem: CoverProblem, best: Ints, budget: Budget) -> bool:
    """Whether a cover is so near to the bound that the exact solver may close the gap."""
    excess = (problem.cost(best) - budget.lower_bound) / float(problem.costs.mean())
    return excess <= max(2.0, HOPEFUL_EXCESS * len(best))


SOLVERS: dict[str, Solver] = {
    "auto": auto,
    "greedy": greedy,
    "meta-raps": meta_raps,
    "local-search": local_search,
    "exact": exact,
}
