"""Branch and bound: a better choice than the best one known, or the proof that there is none.

Where columns have no costs and one is enough for every row, numbers of columns are asked for one by one, from the bound
on, by `planner.cover.tree`. Costs, loads and rows that ask for several columns are answered here:

A node has columns that are in and columns that are out. The linear programme of `planner.cover.linear` goes on from the
node before by the dual simplex, row by row; its multipliers bound what the node holds (`planner.cover.bound`, evaluated
in our own arithmetic). Columns that by their reduced cost no choice as good as asked for contains are out in all that
follows; then the column nearest to one half is put in, and out (Land, Doig 1960). Depth first: from node to node few
columns change.

A proof thus rests on no solver's tolerance, and every call of HiGHS ends after a number of iterations that the budget
pays for. Where best and bound are further apart the middle is asked for: its tree is much the smaller one, and either
end comes nearer.
"""

import numpy as np
from highspy import HighsModelStatus
from numpy.typing import NDArray

from planner.cover import tree
from planner.cover.bound import Relaxation
from planner.cover.budget import Budget
from planner.cover.greedy import complete, prune
from planner.cover.linear import LEAST_ROWS, Model
from planner.values import Ints

WHOLE = 1e-6
"""A column nearer than this to 0 or 1 is not branched on while there are others."""

FINE = 0.1
"""With best and bound no further apart than this share the last step is asked for, in costs."""


def close_gap(relaxation: Relaxation, budget: Budget) -> None:
    """Look for better choices, or prove that there are none, as far as the budget goes.

    Args:
        relaxation: bound whose penalties rule columns out, and whose multipliers name the rows that matter.
        budget: charged; holds the best choice known, receives what is proven or found.
    """
    sets = relaxation.sets
    while budget.spend(0):
        aim = _aim(relaxation, budget)
        useful = relaxation.useful(aim)
        core = np.flatnonzero(useful)
        if aim < 0 or not len(core) or not (sets.most >= 0 or sets.met(core)):
            budget.prove(aim + 1)
            continue
        if tree.can_tell(sets):
            found, ended = tree.search(sets, (relaxation.multipliers > 0) | (sets.most >= 0), useful, aim, budget)
        else:
            budget.spend(12 * sets.n_entries)
            inside = Relaxation(sets.restricted(columns=useful))
            found, ended = _search(inside, Model(inside, _decisive(relaxation)), aim, budget)
            found = None if found is None else core[found]
        if found is not None:
            budget.offer(found, sets.objective(found))
        elif ended:
            # What the core leaves out is no better; on its way the tree may have found better areas than it began with.
            budget.prove(_aim(relaxation, budget) + 1)
        else:
            break


def _aim(relaxation: Relaxation, budget: Budget) -> int:
    """The objective to be asked for: numbers of views from the bound on, the next better area, costs half-way."""
    best = budget.objective - budget.tolerance
    if relaxation.sets.most >= 0:
        return best - 1
    if tree.can_tell(relaxation.sets):
        return budget.lower_bound
    gap = best - budget.lower_bound
    return best - (1 if gap <= FINE * budget.objective and not relaxation.sets.unit_cost else (gap + 2) // 2)


def _decisive(relaxation: Relaxation) -> Ints:
    """Rows with a multiplier, and the rows of fewest columns where these are few."""
    rows = relaxation.owner[relaxation.multipliers > 1e-9 * relaxation.multipliers.max()]
    few = np.argsort(np.diff(relaxation.sets.row_start), kind="stable")[:LEAST_ROWS]
    return np.union1d(rows, few)


def _search(inside: Relaxation, model: Model, aim: int, budget: Budget) -> tuple[Ints | None, bool]:
    """A choice whose objective is at most the aim, or None; and whether there certainly is none."""
    sets = inside.sets
    waiting = [inside.state]
    while waiting:
        state = waiting.pop()
        if not inside.reachable(state):
            continue
        inside.fix(state)
        model.fix(state)
        x = _solved(inside, model, aim, budget)
        if inside.excludes(aim):
            continue
        if x is None:
            return None, False
        chosen = np.flatnonzero(x > 0.5)
        free = state == 0
        unsure = np.where(free, np.abs(x - np.rint(x)), -1.0)
        if unsure.max() <= WHOLE:
            found = prune(sets, complete(sets, chosen))
            if sets.objective(found) <= aim:
                return found, False
            if not free.any():
                continue
            unsure = np.where(free, x, -1.0)  # rows may be open in part though columns are whole
        state = np.where(free & ~inside.useful(aim), np.int8(-1), state)
        for way in (-1, 1):
            waiting.append(_with(state, int(unsure.argmax()), way))
    return None, True


def _with(state: NDArray[np.int8], column: int, way: int) -> NDArray[np.int8]:
    state = state.copy()
    state[column] = way
    return state


def _solved(inside: Relaxation, model: Model, aim: int, budget: Budget) -> NDArray[np.float64] | None:
    """Solution with every row; None where the bound excludes the aim before that, or the linear programme ends not."""
    while not inside.excludes(aim) and budget.spend(0):
        model.run(budget)
        inside.evaluate(model.multipliers())
        if model.status == HighsModelStatus.kOptimal:
            x, slack = model.solution()
            if not model.add_violated(x, slack):
                return x
        elif model.status != HighsModelStatus.kIterationLimit:
            break
    return None
