"""Certified view selection: the fewest, cheapest or best views, and their distance from the optimum.

    from planner import cover

    answer = cover.solve(cover.CoverProblem(matrix, areas, coverage=0.99), rng=np.random.default_rng(0))
    answer.views, answer.lower_bound, answer.sentence

`CoverProblem` states the problem, `solve` answers it with a `Cover`, whose status and bounds say what is proven.

problem       the problem as stated and as an integer instance; the overlap graph
answer        `Cover`, and its conversion from selected columns
budget        effort, Ctrl-C, incumbent
reductions    canonical form and exact reductions
search        greedy selection, local search, Meta-RaPS
bounds        certified lower bounds; the linear programme in HiGHS
tree          branch and bound
solvers       `SOLVERS` by name
solve         `solve`; targets for several regions
overlap       views whose overlap graph is connected
curve         coverage over the number of views
robust        coverage at a confidence under pose errors
grouped       fewest groups of columns (set-ups), then fewest views
"""

from planner.cover.answer import Cover, CoverStatus
from planner.cover.budget import DEFAULT_EFFORT, EFFORT_PER_SECOND, scaled_effort
from planner.cover.problem import CoverProblem, Overlap
from planner.cover.solve import solve
from planner.cover.solvers import SOLVERS

__all__ = [
    "DEFAULT_EFFORT",
    "EFFORT_PER_SECOND",
    "SOLVERS",
    "Cover",
    "CoverProblem",
    "CoverStatus",
    "Overlap",
    "scaled_effort",
    "solve",
]
