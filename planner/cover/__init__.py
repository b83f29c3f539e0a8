"""Certified view selection: the fewest views that cover the part, and how far a plan is from them.

problem       check the input, canonical order, areas as whole numbers
reductions    exact simplifications, and the way back
greedy, meta_raps, local_search, exact    solvers; `solvers` names them and adds `auto`
local_search_kernels    the compiled loops of the local search, imported when it runs
bound         lower bound on the cost
budget        work, clock guard, best cover so far
interrupts    Ctrl-C: heard during HiGHS, and the end of a search
selection     `solve`: all of it, with a status and a gap

Beside it stand requests that are no cover of this form; each has a module of its own and is imported by its name.

most_coverage    the most area with at most k views; area_bound, area_search, area_kernels
curve            coverage over the number of views, bounded
overlap          views whose scans hang together
robust           views that keep a promise although poses are off
demands          what the last two search: rows that ask for a sum; demand_search, demand_bound, demand_kernels
prepared, answer    the way in and out that they share
"""

from planner.cover.budget import DEFAULT_WORK, Budget
from planner.cover.meta_raps import MetaRapsParameters
from planner.cover.selection import Cover, CoverStatus, solve
from planner.cover.solvers import SOLVERS

__all__ = ["DEFAULT_WORK", "SOLVERS", "Budget", "Cover", "CoverStatus", "MetaRapsParameters", "solve"]
