"""The cheapest cover by mixed-integer programming (HiGHS through scipy), stopped by a number of nodes, not by a clock.

scipy's interface takes no starting solution. The incumbent is used all the same: the model only asks for covers that
cost less (so that "infeasible" means the incumbent is optimal), and columns whose reduced cost rules them
out of such a cover are left out of the model.
"""

from typing import Any

import numpy as np

from planner.cover.bound import bound, without_useless_columns
from planner.cover.budget import ROUNDING, WORK_PER_SECOND, Bound, Budget
from planner.cover.greedy import complete, greedy, prune
from planner.cover.interrupts import interruptible
from planner.cover.canonical import CoverProblem
from planner.cover.reductions import reduce
from planner.values import Ints

ROOT_WORK, ROOT_WORK_PER_ENTRY = WORK_PER_SECOND // 10, WORK_PER_SECOND // 4000
"""Charge of the root (relaxation, cuts, and HiGHS's heuristics, which scipy cannot switch off)."""

NODE_WORK, NODE_WORK_PER_ENTRY = WORK_PER_SECOND // 100, WORK_PER_SECOND // 500_000
"""Charge of one further node. Measured on covers of 20 to 16,000 ones, where the time varies fourfold about both."""


def exact(problem: CoverProblem, rng: np.random.Generator, budget: Budget) -> Ints:
    """Solve the root and as many nodes as the budget pays for; the root is always solved, whatever the budget.

    Args:
        problem: what to cover.
        rng: not used (one signature for all solvers).
        budget: also receives the solver's dual bound; a fired time limit is noted there.

    Returns:
        Columns of the best cover, which is the incumbent or greedy one if none that costs less was found.
    """
    best = greedy(problem, rng, budget) if budget.best is None else budget.best
    if problem.trivial or budget.proven:
        return best
    if budget.dual is None:
        with budget.portion(0.3):
            budget.dual = bound(problem, problem.cost(best), budget)
        if budget.proven:
            return best
    return improve_or_prove(problem, best, budget.dual, budget, at_least_root=True)


def improve_or_prove(
    problem: CoverProblem,
    best: Ints,
    known: Bound,
    budget: Budget,
    *,
    at_least_root: bool = False,
    most_columns: int | None = None,
) -> Ints:
    """Look for a cover that costs less than the best, or prove that there is none.

    Args:
        problem: what to cover.
        best: the incumbent.
        known: bound whose reduced costs rule columns out.
        budget: work; receives what is proven or found.
        at_least_root: solve the root even where the budget does not pay for it; otherwise do nothing then.
        most_columns: do nothing where the reduced model has more columns than this; None: any number.

    Returns:
        The best cover.
    """
    cost = problem.cost(best)
    core = without_useless_columns(problem, known, cost)
    if core is None:
        budget.prove(cost)
        return best
    # The reductions of a core that is far too large would cost more than they could save.
    if not at_least_root and _nodes(core[0], budget, discount=10) == 0:
        return best
    reduction = reduce(core[0])
    nodes = _nodes(reduction.problem, budget)
    too_large = most_columns is not None and reduction.problem.n_columns > most_columns
    if too_large or (nodes == 0 and not at_least_root):
        return best
    forced = core[0].cost(reduction.forced)
    allowance = cost - 1 - forced  # what the reduced problem may cost
    if reduction.problem.trivial:
        found: Ints | None = np.zeros(0, dtype=np.int64)
        inner = 0
    elif allowance <= 0:
        found, inner = None, allowance + 1
    else:
        found, inner = _solve_model(reduction.problem, allowance, max(nodes, 1), budget)
    budget.prove(min(forced + inner, cost))  # covers outside the core cost at least as much
    if found is None:
        return best
    # HiGHS may miss an area target by its feasibility tolerance; the exact test is ours.
    cover = prune(problem, complete(problem, core[1][reduction.lift(found)]))
    return cover if budget.offer(cover, problem.cost(cover)) else best


def _nodes(problem: CoverProblem, budget: Budget, discount: int = 1) -> int:
    """Nodes that the budget pays for; zero when not even the root is affordable."""
    left = discount * budget.left - _root_work(problem)
    return 1 + left // _node_work(problem) if left >= 0 else 0


def _root_work(problem: CoverProblem) -> int:
    return ROOT_WORK + ROOT_WORK_PER_ENTRY * problem.n_entries


def _node_work(problem: CoverProblem) -> int:
    return NODE_WORK + NODE_WORK_PER_ENTRY * problem.n_entries


def _solve_model(problem: CoverProblem, at_most: int, nodes: int, budget: Budget) -> tuple[Ints | None, int]:
    """Run HiGHS.

    Args:
        problem: a reduced problem.
        at_most: covers that cost more are of no use.
        nodes: node limit.
        budget: charged for the nodes; its clock limits the run.

    Returns:
        Columns of the best cover found (None: none), and a lower bound (`at_most + 1` when there is none that small).
    """
    import scipy.sparse as sp
    from scipy.optimize import Bounds, LinearConstraint, milp

    n_rows, n_columns = problem.shape
    M = problem.matrix()
    unit = float(problem.costs.mean())  # the solver's tolerances are absolute, meant for numbers near 1
    if problem.full:
        costs, integrality = problem.costs / unit, np.ones(n_columns, dtype=np.int64)
        constraints = [LinearConstraint(M, lb=problem.demand.astype(np.float64))]
    else:
        # y_i = 1 where row i counts as covered. Where once is enough it may stay continuous: x decides its largest
        # value. A row that demands more would otherwise count in part.
        costs = np.concatenate((problem.costs / unit, np.zeros(n_rows)))
        integrality = np.concatenate((np.ones(n_columns, dtype=np.int64), (problem.demand > 1).astype(np.int64)))
        scale = problem.units.mean()
        weights = np.concatenate((np.zeros(n_columns), problem.units / scale))
        constraints = [
            LinearConstraint(sp.hstack((M, -sp.diags_array(problem.demand.astype(np.float64)))).tocsr(), lb=0.0),
            LinearConstraint(sp.csr_array(weights[None, :]), lb=problem.required / scale),
        ]
    constraints.append(LinearConstraint(sp.csr_array(costs[None, :]), ub=(at_most + 0.25) / unit))
    seconds = budget.seconds_left
    options: Any = {"node_limit": min(nodes, 2**31 - 1), "mip_rel_gap": 0.0}
    if seconds is not None:
        options["time_limit"] = seconds
    result = interruptible(
        lambda: milp(costs, integrality=integrality, bounds=Bounds(0, 1), constraints=constraints, options=options)
    )
    if result.status == 1 and budget.seconds_left == 0.0:
        budget.time_limited = True
    used = getattr(result, "mip_node_count", None) or 0
    budget.spend(_root_work(problem) + max(int(used) - 1, 0) * _node_work(problem))
    if result.status == 2:
        return None, at_most + 1
    dual = getattr(result, "mip_dual_bound", None)
    lower = int(np.ceil((dual - ROUNDING) * unit)) if dual is not None and np.isfinite(dual) else 0
    found = None if result.x is None else np.flatnonzero(result.x[:n_columns] > 0.5)
    return found, max(min(lower, at_most + 1), 0)
