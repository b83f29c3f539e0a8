"""Meta-RaPS for set cover (Lan, DePuy, Whitehouse 2007, doi:10.1016/j.ejor.2005.09.028): the paper's own solver.

Each iteration builds a cover with the greedy rule, randomised: with probability `PRIORITY` a best column is taken,
otherwise a random one among those within `RESTRICTION` of the best. Redundant columns are removed. A cover that is at
most `IMPROVEMENT` dearer than the cheapest one built so far is improved: a share `MAGNITUDE` of its columns is thrown
away at random and it is built up again in the same way, kept if not dearer, `IMPROVEMENT_ITERATIONS` times.

The parameters are those of an open implementation of the procedure for set cover; they were not checked against the
paper's own table. In place of the paper's core problem every solver here gets the reduced problem; its several priority
rules (with unit cost they order columns alike) and its penalty on columns that often come out worst are left out.
"""

import numpy as np

from planner.cover.budget import Budget
from planner.cover.greedy import Open, prune
from planner.cover.sets import Sets
from planner.values import Ints

PRIORITY, RESTRICTION, IMPROVEMENT, MAGNITUDE = 0.05, 0.15, 0.15, 0.3
ITERATIONS, IMPROVEMENT_ITERATIONS = 1000, 100


def meta_raps(sets: Sets, rng: np.random.Generator, budget: Budget) -> None:
    """Cover by Meta-RaPS; it stops at its iterations or at the budget, whichever comes first.

    Args:
        sets: what to cover.
        rng: all random choices.
        budget: charged for what constructions touch; receives better covers.
    """
    best = int(sets.total if sets.most >= 0 else sets.costs.sum() + sets.group_costs.sum())
    for _ in range(ITERATIONS):
        if not budget.spend(0):
            break
        cover = _construct(sets, np.zeros(0, dtype=np.int64), rng, budget)
        best = min(best, sets.objective(cover))
        if sets.objective(cover) <= (1.0 + IMPROVEMENT) * best:
            cover = _improve(sets, cover, rng, budget)
        budget.offer(cover, sets.objective(cover))


def _improve(sets: Sets, cover: Ints, rng: np.random.Generator, budget: Budget) -> Ints:
    """Throw away part of a cover and build it up again, as often as the parameters and the budget say."""
    for _ in range(IMPROVEMENT_ITERATIONS):
        if not len(cover) or not budget.spend(0):
            break
        keep = len(cover) - max(1, int(MAGNITUDE * len(cover)))
        rebuilt = _construct(sets, rng.permutation(cover)[:keep], rng, budget)
        if sets.objective(rebuilt) <= sets.objective(cover):
            cover = rebuilt
    return cover


def _construct(sets: Sets, part: Ints, rng: np.random.Generator, budget: Budget) -> Ints:
    """Complete a partial cover by randomised priority and remove what is redundant."""
    still = Open(sets, part)
    while still.missing > 0 and (sets.most < 0 or len(still.chosen) < sets.most):
        worth = np.maximum(still.gains, 0.0) / sets.costs
        threshold = worth.max()
        if threshold <= 0:
            break
        if rng.random() >= PRIORITY:
            threshold *= 1.0 - RESTRICTION
        candidates = np.flatnonzero((worth >= threshold) & (still.gains > 0))
        still.take(int(candidates[int(rng.random() * len(candidates))]))
    budget.spend(still.work)
    return prune(sets, np.array(still.chosen, dtype=np.int64))
