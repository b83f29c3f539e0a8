"""Meta-RaPS for set cover (Lan, DePuy, Whitehouse 2007, doi:10.1016/j.ejor.2005.09.028): the paper's own solver.

Each iteration builds a cover with the greedy rule, randomised: with probability `priority` a best column is taken,
otherwise a random one among those within `restriction` of the best. Redundant columns are removed. A cover that is at
most `improvement` dearer than the cheapest one built so far is improved: a share `magnitude` of its columns is thrown
away at random and it is built up again in the same way, kept if not dearer, `improvement_iterations` times.

Where columns cost differently, each construction draws one of several priority rules (Vasko, Wilson 1984,
doi:10.1002/nav.3800310122): functions of a column's cost and of the uncovered area that it covers. With unit cost they
order columns alike, so the first one serves. In place of the paper's core problem every solver here gets the reduced
problem; its penalty on columns that often come out worst is left out.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from planner.cover.budget import STEP_WORK, Budget
from planner.cover.greedy import greedy, missing_units, prune, uncovered_area
from planner.cover.canonical import CoverProblem
from planner.errors import PlannerError
from planner.values import Floats, Ints


@dataclass(frozen=True, slots=True)
class MetaRapsParameters:
    """Parameters of Meta-RaPS, named as in the paper.

    The defaults are those of an open implementation of the procedure for set cover; they were not checked against
    the paper's own table.

    Attributes:
        priority: probability of taking a best column; the rest is the degree of randomisation.
        restriction: a column within this share of the best gain is a candidate.
        improvement: a cover at most this share dearer than the cheapest one built is improved.
        magnitude: share of a cover's columns thrown away in one improvement step.
        iterations: covers built.
        improvement_iterations: improvement steps for each cover that is improved.
    """

    priority: float = 0.05
    restriction: float = 0.15
    improvement: float = 0.15
    magnitude: float = 0.3
    iterations: int = 1000
    improvement_iterations: int = 100

    def __post_init__(self) -> None:
        for name in ("priority", "restriction", "improvement", "magnitude"):
            value = getattr(self, name)
            if not 0.0 <= value <= 1.0:
                raise PlannerError(f"{name} of Meta-RaPS is {value}; it is a share and must be from 0 to 1")
        for name in ("iterations", "improvement_iterations"):
            if getattr(self, name) < 0:
                raise PlannerError(f"{name} of Meta-RaPS is {getattr(self, name)}; it must be zero or above")


PRIORITY_RULES: tuple[Callable[[Floats, Floats], Floats], ...] = (
    lambda gains, costs: gains / costs,
    lambda gains, costs: gains * np.log1p(gains) / costs,
    lambda gains, costs: gains**2 / costs,
    lambda gains, costs: gains**2 / np.sqrt(costs),
    lambda gains, costs: np.log1p(gains) / costs,
)
"""Worth of columns from the uncovered area that they cover, in mean areas of a row, and their costs."""

DEFAULT_PARAMETERS = MetaRapsParameters()


def meta_raps(
    problem: CoverProblem,
    rng: np.random.Generator,
    budget: Budget,
    parameters: MetaRapsParameters = DEFAULT_PARAMETERS,
) -> Ints:
    """Cover by Meta-RaPS; it stops at its iterations or at the budget, whichever comes first.

    Args:
        problem: what to cover.
        rng: all random choices.
        budget: one construction costs the entries that it touches and a third of `STEP_WORK` for each column.
        parameters: see `MetaRapsParameters`.

    Returns:
        Columns of the best cover; the greedy one where the budget allows no iteration.
    """
    best = greedy(problem, rng, budget) if budget.best is None else budget.best
    cheapest = int(problem.costs.sum())
    empty = np.zeros(0, dtype=np.int64)
    for _ in range(parameters.iterations):
        if not budget.spend(0):
            break
        cover = _construct(problem, empty, rng, budget, parameters)
        cheapest = min(cheapest, problem.cost(cover))
        if problem.cost(cover) <= (1.0 + parameters.improvement) * cheapest:
            cover = _improve(problem, cover, rng, budget, parameters)
        if budget.offer(cover, problem.cost(cover)):
            best = cover
    return best


def _improve(
    problem: CoverProblem, cover: Ints, rng: np.random.Generator, budget: Budget, parameters: MetaRapsParameters
) -> Ints:
    """Throw away part of a cover and build it up again, as often as the parameters and the budget say."""
    for _ in range(parameters.improvement_iterations):
        if not len(cover) or not budget.spend(0):
            break
        keep = len(cover) - max(1, int(parameters.magnitude * len(cover)))
        part = rng.permutation(cover)[:keep]
        rebuilt = _construct(problem, part, rng, budget, parameters)
        if problem.cost(rebuilt) <= problem.cost(cover):
            cover = rebuilt
    return cover


def _construct(
    problem: CoverProblem, part: Ints, rng: np.random.Generator, budget: Budget, parameters: MetaRapsParameters
) -> Ints:
    """Complete a partial cover by randomised priority and remove what is redundant."""
    counts = problem.counts(part)
    uncovered = counts < problem.demand
    gains = uncovered_area(problem, np.flatnonzero(uncovered))
    gains[part] = -np.inf
    work = int(uncovered.sum()) * max(problem.n_entries // max(problem.n_rows, 1), 1)
    missing = missing_units(problem, uncovered)
    chosen = part.tolist()
    rule = PRIORITY_RULES[0 if problem.unit_cost else int(rng.random() * len(PRIORITY_RULES))]
    costs, unit = problem.costs.astype(np.float64), float(problem.units.mean())
    while missing > 0:
        worth = rule(np.maximum(gains, 0.0) / unit, costs)
        threshold = worth.max()
        if rng.random() >= parameters.priority:
            threshold *= 1.0 - parameters.restriction
        candidates = np.flatnonzero((worth >= threshold) & (gains > 0))
        column = int(candidates[int(rng.random() * len(candidates))])
        rows = problem.column_rows[problem.column_start[column] : problem.column_start[column + 1]]
        counts[rows] += 1
        done = rows[counts[rows] == problem.demand[rows]]
        uncovered[done] = False
        missing -= int(problem.units[done].sum())
        gains -= uncovered_area(problem, done)
        gains[column] = -np.inf
        chosen.append(column)
    # each row that was open at first is gathered at most twice: at the start and when it is covered
    budget.spend(4 * work + len(chosen) * STEP_WORK // 3)
    return prune(problem, np.array(chosen, dtype=np.int64))
