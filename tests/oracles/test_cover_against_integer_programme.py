"""Covers and bounds of medium problems against plain models of the whole matrix in scipy."""

from functools import cache

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.optimize import LinearConstraint, linprog, milp
from scipy.sparse import csr_array

from planner.cover import SOLVERS, CoverProblem, solve
from planner.cover.bounds import Relaxation, raise_bound
from planner.cover.budget import Budget
from planner.cover.curve import coverage_curve
from planner.cover.problem import CoverInstance
from planner.cover.reductions import canonical_form
from planner.cover.robust import DEMAND
from planner.cover.search import greedy
from planner.cover.tree import close_gap, search_by_number


def medium(seed: int, n_rows: int = 120, n_columns: int = 90, density: float = 0.08) -> tuple[np.ndarray, np.ndarray]:
    """Return a random instance that is easy for an integer programme; everything is coverable."""
    rng = np.random.default_rng(seed)
    M = rng.random((n_rows, n_columns)) < density
    M[np.arange(n_rows), rng.integers(0, n_columns, n_rows)] = True
    return M, rng.uniform(0.5, 2.0, n_rows)


def relaxed(M: np.ndarray, areas: np.ndarray, coverage: float) -> float:
    """Return the optimum of the linear relaxation; rows larger than the slack must be covered."""
    n_rows, n_columns = M.shape
    A = np.block([[-M.astype(float), -np.eye(n_rows)], [np.zeros(n_columns), areas]])
    costs = np.r_[np.ones(n_columns), np.zeros(n_rows)]
    slack = (1 - coverage) * areas.sum()
    bounds = [(0, 1)] * n_columns + [(0, float(area <= slack)) for area in areas]
    return float(linprog(costs, A_ub=A, b_ub=np.r_[-np.ones(n_rows), slack], bounds=bounds).fun)


@pytest.mark.parametrize("coverage", [0.8, 0.99, 1.0])
def test_the_bound_is_the_linear_relaxation(coverage: float) -> None:
    """Row generation reaches the relaxation within 1e-5 and never exceeds it."""
    M, areas = medium(0)
    instance = canonical_form(CoverProblem(M, areas, coverage=coverage)).reduced
    bound = Relaxation(instance)
    raise_bound(bound, len(greedy(instance)[0]), Budget(10**9))
    optimum = relaxed(M, areas, coverage)
    assert optimum * (1 - 1e-5) <= bound.dual <= optimum + 1e-7


def test_the_curve_is_between_selections_and_the_linear_relaxation() -> None:
    """The bounds hold at each number of views, on a random visibility-like matrix."""
    M, areas = medium(5, 150, 70, 0.12)
    curve = coverage_curve(CoverProblem(M, areas), rng=np.random.default_rng(0), effort_budget=10**8)
    A = np.block([[-M.astype(float), np.eye(150)], [np.ones(70), np.zeros(150)]])
    for k in range(1, len(curve.views)):
        most = -linprog(np.r_[np.zeros(70), -areas], A_ub=A, b_ub=np.r_[np.zeros(150), k], bounds=(0, 1)).fun
        assert curve.covered_area[k] * (1 - 1e-9) <= curve.upper_area[k] <= most * (1 + 1e-6)
    found = solve(CoverProblem(M, areas, coverage=0.9), rng=np.random.default_rng(0), effort_budget=10**8)
    suffices, possible = curve.fewest_views(0.9)
    assert possible is not None
    assert suffices is not None
    assert possible <= len(found.views) <= suffices


def test_second_rows_of_the_bound_strengthen_it() -> None:
    """Ten rows, three columns of 0.9 of the demand each: sums of shares require 12 columns, 20 are needed."""
    M = csr_array((0.9 * DEMAND * np.kron(np.eye(10), np.ones((1, 3)))).astype(np.int64))
    bound = Relaxation(canonical_form(CoverProblem(M, np.ones(10), demand=DEMAND)).reduced)
    raise_bound(bound, 20, Budget(10**8))
    assert bound.bound == 20


@cache
def fewest_of(seed: int) -> int:
    """Return the fewest views of a medium problem by an integer programme."""
    M, _ = medium(seed, 80, 60, 0.1)
    ones = np.ones(60)
    return round(milp(ones, integrality=ones, constraints=LinearConstraint(M.astype(float), lb=1)).fun)


@pytest.mark.parametrize("solver", SOLVERS)
def test_the_fewest_views_are_those_of_an_integer_programme(solver: str) -> None:
    """`exact` and `auto` find and prove its optimum; bound <= optimum <= views for all solvers."""
    for seed in range(2):
        fewest, (M, areas) = fewest_of(seed), medium(seed, 80, 60, 0.1)
        effort = 10**9 if solver in ("auto", "exact") else 10**7
        cover = solve(CoverProblem(M, areas), rng=np.random.default_rng(2), solver=solver, effort_budget=effort)
        assert cover.lower_bound <= fewest <= len(cover.views)
        if solver in ("auto", "exact"):
            assert len(cover.views) == cover.lower_bound == fewest


def least(instance: CoverInstance) -> float:
    """Return the smallest objective by an integer programme: number of columns, or uncovered units."""
    A = sp.hstack((instance.matrix(), sp.eye_array(instance.n_rows)))
    n, units = instance.n_columns, instance.units / instance.total_units
    columns, uncovered = np.repeat((1.0, 0.0), (n, instance.n_rows)), np.concatenate((np.zeros(n), units))
    if instance.max_columns is None:
        objective, limited, limit = columns, uncovered, instance.slack / instance.total_units + 1e-12
    else:
        objective, limited, limit = uncovered, columns, float(instance.max_columns)
    rows = [LinearConstraint(A, 1.0, np.inf), LinearConstraint(limited[None, :], -np.inf, limit)]
    found = milp(objective, constraints=rows, integrality=columns, bounds=(0, 1), options={"mip_rel_gap": 0.0})
    return float(found.fun) * (instance.total_units if instance.maximises_area else 1.0)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("options", [{}, {"coverage": 0.9}, {"max_views": 5}], ids=["full", "share", "area"])
def test_the_tree_proves_that_nothing_is_below_the_optimum(seed: int, options: dict[str, float]) -> None:
    """The proof holds with all or few initial rows, and with columns that the first node cannot exclude."""
    M, areas = medium(seed, 90, 60, 0.06 + 0.03 * seed)
    instance = canonical_form(CoverProblem(M, areas, **options)).residual  # type: ignore[arg-type]
    optimum = least(instance)
    rows = np.ones(90, dtype=bool) if seed % 2 else Relaxation(instance).multipliers > 0
    rows[np.random.default_rng(seed).integers(0, 90, 70)] &= seed % 2 == 1
    below, at = round(optimum) - 1, round(optimum)
    if instance.maximises_area:
        below, at = int(optimum * (1 - 1e-6)), int(optimum * (1 + 1e-6))
    every = np.ones(instance.n_columns, dtype=bool)
    found, is_complete = search_by_number(instance, rows, every, below, Budget(10**10))
    assert (found is None, is_complete) == (True, True)
    budget = Budget(10**10)
    found, _ = search_by_number(instance, rows, every, at, budget)
    best = budget.incumbent if found is None else found  # for maximum coverage the budget receives selections
    assert best is not None
    assert instance.is_feasible(best)
    assert instance.objective(best) <= at


@pytest.mark.parametrize("seed", range(4))
def test_a_bound_on_areas_is_not_above_the_optimum(seed: int) -> None:
    """The bound holds from the empty selection and after improvements, with areas of 1e-12 to 1e6."""
    rng = np.random.default_rng(seed)
    M = rng.random((30, 9)) < rng.uniform(0.1, 0.3)
    areas = rng.uniform(0.5, 2.0, 30) if seed % 2 else 10.0 ** rng.uniform(-12, 6, 30)
    instance = canonical_form(CoverProblem(M, areas, max_views=1 + seed)).residual
    subsets = [np.flatnonzero((k >> np.arange(instance.n_columns)) & 1) for k in range(2**instance.n_columns)]
    optimum = min(instance.objective(some) for some in subsets if instance.is_feasible(some))
    budget, relaxation = Budget(10**9), Relaxation(instance)
    budget.begin(instance.tolerance, relaxation.bound)
    budget.offer(np.zeros(0, dtype=np.int64), instance.total_units)
    close_gap(relaxation, budget)
    assert budget.lower_bound <= optimum <= budget.objective <= budget.lower_bound + instance.tolerance


def test_the_effort_of_a_tree_is_charged() -> None:
    """The effort includes that of the chunk in which the tree ends, which is the only one here."""
    M, _ = medium(0, 90, 60, 0.1)
    instance = canonical_form(CoverProblem(M, np.ones(90))).residual
    every, budget = np.ones(instance.n_columns, dtype=bool), Budget(10**9)
    below = round(least(instance)) - 1
    assert search_by_number(instance, np.ones(90, dtype=bool), every, below, budget) == (None, True)
    assert budget.spent > 50_000


@pytest.mark.parametrize("targets", [(0.5, 0.9, 0.98, 0.7), (1.0, 0.9, 0.98, 0.7), (0.3, 0.9, 0.2, 0.1), (0.99,) * 4])
def test_the_bound_of_regions_is_no_weaker_than_the_linear_relaxation(targets: tuple[float, ...]) -> None:
    """The bound on the number of columns is the relaxation of all targets together, rounded up, or higher."""
    M, areas = medium(1)
    region, n_columns = np.arange(len(areas)) % 4, M.shape[1]
    by_region = np.zeros((4, len(areas)))
    by_region[region, np.arange(len(areas))] = areas
    slack = (1 - np.array(targets)) * by_region.sum(axis=1)
    A = np.block([[-M.astype(float), -np.eye(len(areas))], [np.zeros((4, n_columns)), by_region]])
    costs = np.r_[np.ones(n_columns), np.zeros(len(areas))]
    relaxation = linprog(costs, A_ub=A, b_ub=np.r_[-np.ones(len(areas)), slack], bounds=(0, 1)).fun
    problem = CoverProblem(csr_array(M), areas, region=region, region_coverage=targets)
    found = solve(problem, rng=np.random.default_rng(0), effort_budget=2 * 10**8)
    assert np.ceil(relaxation - 1e-6) <= found.lower_bound <= len(found.views)
