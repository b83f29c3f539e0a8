"""The integer programme, row by row: a better choice than the best one known, or the proof that there is none.

The model of `planner.cover.linear` in whole numbers, on the columns that reduced costs leave, with the rows that have
a multiplier, asks for a choice better than the best one known; that there is none proves the best. Rows that a solution
violates are added, and HiGHS is asked again.
"""

import numpy as np
from highspy import HighsModelStatus, SolutionStatus

from planner.cover.bound import Relaxation
from planner.cover.budget import Budget
from planner.cover.greedy import complete, prune
from planner.cover.linear import ROOT_CALLS, Model
from planner.cover.row_generation import LEAST_ROWS, MORE_ROWS
from planner.values import Ints


def close_gap(relaxation: Relaxation, best: Ints, budget: Budget, *, at_least_root: bool = False) -> Ints:
    """Look for a better choice, or prove that there is none, as far as the budget goes.

    Args:
        relaxation: bound whose penalties rule columns out, and whose multipliers name the rows that matter.
        best: the best choice known.
        budget: charged; receives what is proven or found.
        at_least_root: solve the root even where the budget does not pay for it; otherwise do nothing then.

    Returns:
        The best choice.
    """
    sets, model = relaxation.sets, None
    while not budget.proven:
        aim = sets.objective(best) - 1 - sets.tolerance
        if model is None:
            core = np.flatnonzero(relaxation.useful(aim))
            if aim < 0 or not len(core) or not (sets.most >= 0 or sets.met(core)):
                budget.prove(aim + 1)
                break
            model = Model(relaxation, core, at_most=aim)
            model.add(_decisive(relaxation))
        if not at_least_root and budget.left < ROOT_CALLS * model.call_work[0]:
            break
        model.run(budget)
        at_least_root = False
        if model.status == HighsModelStatus.kInfeasible:
            budget.prove(aim + 1)  # what the core leaves out is no better
            break
        info = model.highs.getInfo()
        budget.prove(min(model.certified(info.mip_dual_bound), aim + 1))
        if info.primal_solution_status != SolutionStatus.kSolutionStatusFeasible:
            break
        x, slack = model.solution()
        chosen = prune(sets, complete(sets, core[x > 0.5]))
        rows = model.violated(x, slack)
        if budget.offer(chosen, sets.objective(chosen)):
            best, model = chosen, None
        elif model.status != HighsModelStatus.kOptimal or not len(rows):
            break
        else:
            model.add(rows[: max(LEAST_ROWS, int(MORE_ROWS * model.inside.sum()))])
    return best


def _decisive(relaxation: Relaxation) -> Ints:
    """Rows with a multiplier, and the rows of fewest columns where these are few."""
    rows = np.flatnonzero(relaxation.multipliers > 1e-9 * relaxation.multipliers.max())
    few = np.argsort(np.diff(relaxation.A.indptr), kind="stable")[:LEAST_ROWS]
    return np.union1d(rows, few)
