"""The bound of the linear programme, whose rows are added where its solution violates them."""

import numpy as np
from highspy import HighsModelStatus

from planner.cover.bound import Relaxation, climb
from planner.cover.budget import Budget
from planner.cover.linear import LEAST_ROWS, Model

FIRST_ROWS = 0.25
"""Rows at the beginning as a share of the columns."""

CLIMB_SHARE = 0.6
"""Most area: of the work for the bound, what subgradient steps get before the linear programme."""


def raise_bound(relaxation: Relaxation, upper: int, budget: Budget, model: Model | None = None) -> Model:
    """Improve the bound by the linear programme, row by row, until it is solved, meets the upper one or work ends.

    Args:
        relaxation: receives the multipliers.
        upper: objective of a known choice.
        budget: charged for iterations; also receives the bound.
        model: rows of an earlier call; None: a new one.

    Returns:
        The model, to go on from.
    """
    sets = relaxation.sets
    if sets.most >= 0 and sets.plain:
        with budget.portion(CLIMB_SHARE):
            climb(relaxation, upper - sets.tolerance, budget)
        budget.prove(relaxation.value)
    if model is None:
        few = np.argsort(np.diff(relaxation.A.indptr), kind="stable")
        model = Model(relaxation, few[: max(LEAST_ROWS, int(FIRST_ROWS * sets.n_columns))])
    if sets.most >= 0:
        model.limit_columns(relaxation.size)
    while relaxation.value < upper - sets.tolerance and budget.spend(0):
        model.run(budget)
        relaxation.evaluate(model.multipliers())
        budget.prove(relaxation.value)
        if model.status == HighsModelStatus.kOptimal:
            if not model.add_violated(*model.solution()):
                break
        elif model.status != HighsModelStatus.kIterationLimit:
            break
    return model
