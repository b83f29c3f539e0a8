"""Certified view selection: the fewest views that cover the part, and how far a plan is from them.

problem       check the input, canonical order, areas as whole numbers
reductions    exact simplifications, and the way back
greedy, meta_raps, local_search, exact    solvers; `solvers` names them and adds `auto`
bound         lower bound on the number of views
budget        work, clock guard, best cover so far
selection     `solve`: all of it, with a status and a gap
"""

from planner.cover.budget import DEFAULT_WORK, Budget
from planner.cover.meta_raps import MetaRapsParameters
from planner.cover.selection import Cover, CoverStatus, solve
from planner.cover.solvers import SOLVERS

__all__ = ["DEFAULT_WORK", "SOLVERS", "Budget", "Cover", "CoverStatus", "MetaRapsParameters", "solve"]
