"""Certified view selection: the fewest, cheapest or best views, and how far they are from what is possible.

    from planner import cover

    answer = cover.solve(cover.Problem(matrix, areas, coverage=0.99), rng=np.random.default_rng(0))
    answer.views, answer.lower_bound, answer.sentence

`Problem` says what is asked for, `solve` answers it with a `Cover`, whose status and bounds say what is proven.

problem, answer            what goes in and comes out
canonical, told            whole numbers and sorted columns, and the way back
sets                       the problem that is searched
reductions, greedy         exact simplifications (`reduction_kernels`: its compiled test); the first choice
bound, linear, exact       the certified bound; HiGHS, which proposes its multipliers; branch and bound
tree, tree_kernels         branch and bound over numbers of columns and its compiled loops
search, search_kernels     local search and its compiled loops
meta_raps                  the paper's own solver
solvers, selection         `SOLVERS` by name; `solve`
graph, overlap             views whose scans hang together
targets                    several area targets, by problems with one
curve, robust              coverage over the number of views; promises although poses are off
budget                     work, clock, Ctrl-C, best so far
"""

from planner.cover.answer import Cover, CoverStatus
from planner.cover.budget import DEFAULT_EFFORT, EFFORT_PER_SECOND, scaled_effort
from planner.cover.problem import CoverProblem, Overlap
from planner.cover.selection import solve
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
