"""Certified view selection: the fewest, cheapest or best views, and how far they are from what is possible.

    from planner import cover

    answer = cover.solve(cover.Problem(matrix, areas, coverage=0.99), rng=np.random.default_rng(0))
    answer.views, answer.lower_bound, answer.sentence

`Problem` says what is asked for, `solve` answers it with a `Cover`, whose `status` and bounds say what is proven.
"""

from planner.cover.answer import Cover, CoverStatus
from planner.cover.budget import DEFAULT_WORK, WORK_PER_SECOND
from planner.cover.problem import Overlap, Problem
from planner.cover.solve import solve

__all__ = ["DEFAULT_WORK", "WORK_PER_SECOND", "Cover", "CoverStatus", "Overlap", "Problem", "solve"]
