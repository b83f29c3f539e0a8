"""Branch and bound over numbers of views against the plain integer programme in scipy."""

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.optimize import LinearConstraint, milp

from planner.cover.bound import Relaxation
from planner.cover.budget import Budget
from planner.cover.canonical import canonical
from planner.cover.problem import Problem
from planner.cover.sets import Sets
from planner.cover.tree import search


def least(sets: Sets) -> float:
    """The least objective: number of columns, or open units."""
    A = sp.hstack((sets.matrix(), sp.eye_array(sets.n_rows)))
    n, units = sets.n_columns, sets.units / sets.total
    columns, opened = np.repeat((1.0, 0.0), (n, sets.n_rows)), np.concatenate((np.zeros(n), units))
    most = sets.most >= 0
    limit = (columns, sets.most) if most else (opened, sets.slack / sets.total + 1e-12)
    rows = [LinearConstraint(A, 1.0, np.inf), LinearConstraint(limit[0][None, :], -np.inf, limit[1])]
    objective = opened if most else columns
    found = milp(objective, constraints=rows, integrality=columns, bounds=(0, 1), options={"mip_rel_gap": 0.0})
    return float(found.fun) * (sets.total if most else 1.0)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("asked", [{}, {"coverage": 0.9}, {"max_views": 5}], ids=["full", "share", "most"])
def test_there_is_none_below_the_least_and_one_at_it(seed: int, asked: dict[str, float]) -> None:
    """With every row or with few to begin with, and columns that the first node cannot rule out."""
    rng = np.random.default_rng(seed)
    M = rng.random((90, 60)) < rng.uniform(0.06, 0.15)
    M[np.arange(90), rng.integers(0, 60, 90)] = True
    sets = canonical(Problem(M, rng.uniform(0.5, 2.0, 90), **asked)).rest
    optimum = least(sets)
    rows = np.ones(90, dtype=bool) if seed % 2 else Relaxation(sets).multipliers > 0
    rows[rng.integers(0, 90, 70)] &= seed % 2 == 1
    below, at = round(optimum) - 1, round(optimum)
    if sets.most >= 0:
        below, at = int(optimum * (1 - 1e-6)), int(optimum * (1 + 1e-6))
    every = np.ones(sets.n_columns, dtype=bool)
    found, ended = search(sets, rows, every, below, Budget(10**10))
    assert (found is None, ended) == (True, True)
    budget = Budget(10**10)
    found, _ = search(sets, rows, every, at, budget)
    best = budget.best if found is None else found  # the most area is told to the budget on the way
    assert best is not None
    assert sets.met(best)
    assert sets.objective(best) <= at
