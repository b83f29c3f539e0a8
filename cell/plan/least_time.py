"""`--cost time`: the fewest views are where the search for the least time begins, and bounds are in seconds.

Views that were moved so that fewer do are candidates here too. From them on, views and motion are chosen in turns
(`cell.plan.view_exchange`), so that no plan takes longer than one that chooses the fewest views and orders them after;
but where views sweep, are refused and chosen again, or a wish hangs on them: then the motion is no part of the choice.
"""

from dataclasses import replace

import numpy as np

from cell.plan.problem import Problem
from cell.plan.request import WORK, Selected, seconds_of_views
from cell.plan.view_plan import first_choice


def counted(problem: Problem) -> Problem:
    """The same problem, asked for the fewest views."""
    return replace(problem, request=replace(problem.request, costs=None))


def priced(problem: Problem) -> Problem:
    """The same problem, asked for the least time: every candidate at the seconds that it takes at least."""
    home = problem.world.home if problem.at_rest else None
    costs = seconds_of_views(problem.request.plan, problem.reached, home, problem.limits)
    return replace(problem, request=replace(problem.request, costs=costs))


def in_seconds(problem: Problem, fewest: Selected, rng: np.random.Generator) -> tuple[Problem, Selected]:
    """The problem with its views priced in seconds, and the selection with which the search for less time begins.

    Args:
        problem: as `counted` asks it.
        fewest: the views chosen for that.
        rng: randomness of the selection that bounds the seconds.
    """
    problem = priced(problem)
    if not problem.request.exchangeable:  # nothing is chosen again when the motion is known
        return problem, first_choice(problem, rng)
    # A bound for the coverage that is asked for, which the target of the views may be above.
    cheapest = first_choice(problem, rng, looked=replace(fewest, targets=problem.request.asked), look=WORK)
    return problem, replace(fewest, cost_bound=cheapest.cost_bound)
