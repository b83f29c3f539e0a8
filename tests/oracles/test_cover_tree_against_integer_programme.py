"""Branch and bound over numbers of views against the plain integer programme in scipy, and brute force."""

from itertools import combinations

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.optimize import LinearConstraint, milp

from planner.cover import tree
from planner.cover.bounds import Relaxation
from planner.cover.budget import Budget
from planner.cover.problem import CoverInstance, CoverProblem
from planner.cover.reductions import canonical_form
from planner.cover.tree import TOUCH_EFFORT, close_gap, search_by_number


def least(sets: CoverInstance) -> float:
    """The least objective: number of columns, or open units."""
    A = sp.hstack((sets.matrix(), sp.eye_array(sets.n_rows)))
    n, units = sets.n_columns, sets.units / sets.total_units
    columns, opened = np.repeat((1.0, 0.0), (n, sets.n_rows)), np.concatenate((np.zeros(n), units))
    most = sets.maximises_area
    limit = (columns, sets.max_columns) if most else (opened, sets.slack / sets.total_units + 1e-12)
    rows = [LinearConstraint(A, 1.0, np.inf), LinearConstraint(limit[0][None, :], -np.inf, limit[1])]
    objective = opened if most else columns
    found = milp(objective, constraints=rows, integrality=columns, bounds=(0, 1), options={"mip_rel_gap": 0.0})
    return float(found.fun) * (sets.total_units if most else 1.0)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("asked", [{}, {"coverage": 0.9}, {"max_views": 5}], ids=["full", "share", "most"])
def test_there_is_none_below_the_least_and_one_at_it(seed: int, asked: dict[str, float]) -> None:
    """With every row or with few to begin with, and columns that the first node cannot rule out."""
    rng = np.random.default_rng(seed)
    M = rng.random((90, 60)) < rng.uniform(0.06, 0.15)
    M[np.arange(90), rng.integers(0, 60, 90)] = True
    sets = canonical_form(CoverProblem(M, rng.uniform(0.5, 2.0, 90), **asked)).residual
    optimum = least(sets)
    rows = np.ones(90, dtype=bool) if seed % 2 else Relaxation(sets).multipliers > 0
    rows[rng.integers(0, 90, 70)] &= seed % 2 == 1
    below, at = round(optimum) - 1, round(optimum)
    if sets.maximises_area:
        below, at = int(optimum * (1 - 1e-6)), int(optimum * (1 + 1e-6))
    every = np.ones(sets.n_columns, dtype=bool)
    found, ended = search_by_number(sets, rows, every, below, Budget(10**10))
    assert (found is None, ended) == (True, True)
    budget = Budget(10**10)
    found, _ = search_by_number(sets, rows, every, at, budget)
    best = budget.incumbent if found is None else found  # the most area is told to the budget on the way
    assert best is not None
    assert sets.is_feasible(best)
    assert sets.objective(best) <= at


@pytest.mark.parametrize("seed", range(20))
def test_a_bound_on_areas_is_not_above_the_least_though_better_ones_are_found_on_the_way(seed: int) -> None:
    """From the empty choice, with areas of 1e-12 to 1e6."""
    rng = np.random.default_rng(seed)
    M = rng.random((30, 9)) < rng.uniform(0.1, 0.3)
    areas = rng.uniform(0.5, 2.0, 30) if seed % 2 else 10.0 ** rng.uniform(-12, 6, 30)
    sets = canonical_form(CoverProblem(M, areas, max_views=1 + seed % 6)).residual
    every = range(sets.n_columns)
    optimum = min(sets.objective(np.array(some)) for some in combinations(every, min(sets.max_columns, len(every))))
    budget, relaxation = Budget(10**9), Relaxation(sets)
    budget.begin(sets.tolerance, relaxation.bound)
    budget.offer(np.zeros(0, dtype=np.int64), sets.total_units)
    close_gap(relaxation, budget)
    assert budget.lower_bound <= optimum <= budget.objective <= budget.lower_bound + sets.tolerance


@pytest.mark.parametrize("seed", range(20))
def test_what_no_column_reaches_stays_open(seed: int) -> None:
    """Some columns are out: some rows have none left."""
    rng = np.random.default_rng(seed)
    M = rng.random((30, 14)) < 0.15
    areas = rng.uniform(0.5, 2.0, 30) if seed % 2 else 10.0 ** rng.uniform(-12, 6, 30)
    sets = canonical_form(CoverProblem(M, areas, coverage=(0.8, 0.6, 0.95, 0.5)[seed % 4])).residual
    columns = rng.random(sets.n_columns) < 0.8
    left = np.flatnonzero(columns).tolist()
    sizes = range(len(left) + 1)
    least = next(
        (k for k in sizes if any(sets.is_feasible(np.array(some, int)) for some in combinations(left, k))), None
    )
    for aim in sizes:
        found, ended = search_by_number(sets, rng.random(sets.n_rows) < 0.7, columns, aim, Budget(10**9))
        assert ended == (found is None)
        assert found is None or (sets.is_feasible(found) and len(found) <= aim)
        assert found is not None or least is None or aim < least


def test_all_work_is_booked(monkeypatch: pytest.MonkeyPatch) -> None:
    """That of the chunk in which a tree ends as well."""
    grow, done = tree.grow, []

    def counted(grown: tree.Tree, limit: int) -> int:
        ended = grow(grown, limit)
        done.append(TOUCH_EFFORT * int(grown.numbers[tree.EFFORT]))
        return ended

    monkeypatch.setattr(tree, "grow", counted)
    rng = np.random.default_rng(0)
    M = rng.random((90, 60)) < 0.1
    M[np.arange(90), rng.integers(0, 60, 90)] = True
    sets = canonical_form(CoverProblem(M, np.ones(90))).residual
    budget = Budget(10**9)
    found, ended = search_by_number(sets, np.ones(90, dtype=bool), np.ones(sets.n_columns, dtype=bool), 11, budget)
    assert (found is None, ended) == (True, True)
    assert budget.spent > sum(done) > 100_000
