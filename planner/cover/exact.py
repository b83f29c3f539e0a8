"""The fewest columns by mixed-integer programming (HiGHS through scipy), stopped by a number of nodes, not by a clock.

scipy's interface takes no starting solution. The incumbent is used all the same: the model only asks for covers with
fewer columns than it (so that "infeasible" means the incumbent is optimal), and columns whose reduced cost rules them
out of such a cover are left out of the model.
"""

from typing import Any

import numpy as np

from planner.cover.bound import ROUNDING, bound, without_useless_columns
from planner.cover.budget import Budget
from planner.cover.greedy import complete, greedy, prune
from planner.cover.problem import CoverProblem, Ints
from planner.cover.reductions import reduce

NODE_WORK = 60
"""Charge of one branch-and-bound node for each one of the model's matrix (a few dual simplex pivots)."""

ROOT_NODES = 40
"""The root (relaxation, cuts, heuristics) counts as this many nodes."""


def node_limit(problem: CoverProblem, budget: Budget) -> int:
    """Nodes that the budget pays for on this problem; zero when not even the root is affordable."""
    return max(budget.left // max(NODE_WORK * problem.n_entries, 1) - ROOT_NODES + 1, 0)


def exact(problem: CoverProblem, rng: np.random.Generator, budget: Budget) -> Ints:
    """Solve the root and as many nodes as the budget pays for; the root is always solved, whatever the budget.

    Args:
        problem: what to cover.
        rng: not used (one signature for all solvers).
        budget: also receives the solver's dual bound; a fired time limit is noted there.

    Returns:
        Columns of the best cover, which is the incumbent or greedy one if none with fewer columns was found.
    """
    if budget.best is None:
        greedy(problem, rng, budget)
    best = budget.best
    assert best is not None
    if problem.trivial or budget.proven:
        return best
    if budget.dual is None:
        with budget.portion(0.3):
            budget.dual = bound(problem, len(best), budget)
        if budget.proven:
            return best
    return _improve(problem, best, max(node_limit(problem, budget), 1), budget)


def _improve(problem: CoverProblem, best: Ints, nodes: int, budget: Budget) -> Ints:
    """Look for a cover with fewer columns than the incumbent."""
    assert budget.dual is not None
    core = without_useless_columns(problem, budget.dual, len(best))
    if core is None:
        budget.prove(len(best))
        return best
    reduction = reduce(core[0])
    fewer = len(best) - 1 - len(reduction.forced)  # columns that the reduced problem may use
    if fewer < 0 or (fewer == 0 and not reduction.problem.trivial):
        budget.prove(len(best))
        return best
    if reduction.problem.trivial:
        found: Ints | None = np.zeros(0, dtype=np.int64)
        lower = len(reduction.forced)
    else:
        found, inner = _solve_model(reduction.problem, fewer, nodes, budget)
        lower = len(reduction.forced) + inner
    budget.prove(min(lower, len(best)))  # covers outside the core have at least len(best) columns
    if found is None:
        return best
    # HiGHS may miss an area target by its feasibility tolerance; the exact test is ours.
    cover = prune(problem, complete(problem, core[1][reduction.lift(found)]))
    if len(cover) < len(best):
        budget.offer(cover)
        return cover
    return best


def _solve_model(problem: CoverProblem, at_most: int, nodes: int, budget: Budget) -> tuple[Ints | None, int]:
    """Run HiGHS.

    Args:
        problem: a reduced problem.
        at_most: covers with more columns are of no use.
        nodes: node limit.
        budget: charged for the nodes; its clock limits the run.

    Returns:
        Columns of the best cover found (None: none), and a lower bound (`at_most + 1` when there is none that small).
    """
    import scipy.sparse as sp
    from scipy.optimize import Bounds, LinearConstraint, milp

    n_rows, n_columns = problem.shape
    M = problem.matrix()
    if problem.full:
        costs, integrality = np.ones(n_columns), np.ones(n_columns, dtype=np.int64)
        constraints = [LinearConstraint(M, lb=1.0)]
    else:
        # y_i = 1 where row i counts as covered; it may stay continuous, because x decides its largest value.
        costs = np.concatenate((np.ones(n_columns), np.zeros(n_rows)))
        integrality = np.repeat((1, 0), (n_columns, n_rows))
        scale = problem.units.mean()
        weights = np.concatenate((np.zeros(n_columns), problem.units / scale))
        constraints = [
            LinearConstraint(sp.hstack((M, -sp.eye_array(n_rows))).tocsr(), lb=0.0),
            LinearConstraint(sp.csr_array(weights[None, :]), lb=problem.required / scale),
        ]
    constraints.append(LinearConstraint(sp.csr_array(costs[None, :]), ub=float(at_most)))
    seconds = budget.seconds_left
    options: Any = {"node_limit": min(nodes, 2**31 - 1), "mip_rel_gap": 0.0}
    if seconds is not None:
        options["time_limit"] = seconds
    result = milp(costs, integrality=integrality, bounds=Bounds(0, 1), constraints=constraints, options=options)
    used = getattr(result, "mip_node_count", None) or 0
    budget.spend(NODE_WORK * problem.n_entries * (ROOT_NODES + int(used)))
    if result.status == 2:
        return None, at_most + 1
    dual = getattr(result, "mip_dual_bound", None)
    lower = int(np.ceil(dual - ROUNDING)) if dual is not None and np.isfinite(dual) else 0
    found = None if result.x is None else np.flatnonzero(result.x[:n_columns] > 0.5)
    return found, max(min(lower, at_most + 1), 0)
