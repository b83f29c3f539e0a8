"""Covers and their bounds against trying all selections, and against one integer programme over the whole matrix."""

from itertools import combinations

import numpy as np
import pytest
from scipy.optimize import LinearConstraint, linprog, milp

from planner.cover import SOLVERS, CoverProblem, CoverStatus, solve
from planner.cover.bounds import Relaxation, raise_bound
from planner.cover.budget import Budget
from planner.cover.reductions import canonical_form, reduce
from planner.cover.search import greedy
from planner.cover.solvers import solve_instance


def cheapest(problem):
    """Least cost by trying all subsets; rows count when covered as often as is demanded, or by all their columns."""
    M, areas = problem.matrix, problem.areas
    n_columns = M.shape[1]
    costs = np.ones(n_columns) if problem.costs is None else problem.costs
    demand = np.minimum(M.sum(axis=1), problem.demand)
    coverable = demand > 0
    target = problem.coverage * areas[coverable].sum() - 1e-9
    best = np.inf
    for size in range(n_columns + 1):
        for subset in combinations(range(n_columns), size):
            columns = list(subset)
            price = costs[columns].sum()
            if problem.group is not None:
                price += problem.group_costs[sorted({int(problem.group[j]) for j in columns})].sum()
            if price >= best or not set(problem.pinned) <= set(columns):
                continue
            satisfied = (M[:, columns].sum(axis=1) >= demand) & coverable
            met = satisfied.sum() == coverable.sum() if problem.coverage == 1 else areas[satisfied].sum() >= target
            best = price if met else best
    return best


def small(seed):
    """A random problem small enough to try all subsets: shares, demands, costs, pins and groups in all combinations."""
    rng = np.random.default_rng(seed)
    M = rng.random((int(rng.integers(1, 13)), int(rng.integers(1, 9)))) < rng.uniform(0.15, 0.6)
    n_columns = M.shape[1]
    costs = [None, rng.integers(1, 9, n_columns).astype(float), rng.uniform(1, 9, n_columns)][seed // 9 % 3]
    groups = {"group": rng.integers(0, 3, n_columns), "group_costs": rng.integers(0, 4, 3).astype(float)}
    return CoverProblem(
        M,
        rng.integers(1, 6, len(M)).astype(float) if seed % 4 else rng.lognormal(0, 2, len(M)),
        coverage=[0.5, 0.9, 1.0][seed % 3],
        demand=seed // 3 % 3 + 1,
        costs=costs,
        pinned=rng.choice(n_columns, min(n_columns, seed // 27 % 3), replace=False).tolist(),
        **(groups if seed % 2 else {}),
    )


@pytest.mark.parametrize("solver", SOLVERS)
def test_every_wish_against_all_subsets(solver):
    """For every solver bound <= cheapest <= cost; `auto` and `exact` reach and prove it."""
    for seed in range(108):
        problem = small(seed)
        least = cheapest(problem)
        result = solve(problem, rng=np.random.default_rng(0), solver=solver, effort_budget=100_000_000)
        assert result.cost_bound <= least * (1 + 1e-12) + 1e-12, seed
        assert least <= result.cost * (1 + 1e-12), seed
        if solver in ("auto", "exact"):
            assert result.status in (CoverStatus.PROVEN, CoverStatus.NOTHING_COVERABLE), seed
            assert result.cost == pytest.approx(least, rel=1e-4), seed
            assert result.cost_bound == pytest.approx(result.cost, rel=1e-4), seed


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("budget", [0, 200_000])
def test_no_budget_makes_a_bound_wrong(solver, budget):
    """However little work is allowed: bound <= cheapest <= cost."""
    for seed in range(108):
        problem = small(seed)
        result = solve(problem, rng=np.random.default_rng(1), solver=solver, effort_budget=budget)
        assert result.cost_bound <= cheapest(problem) * (1 + 1e-12) + 1e-12, seed
        assert cheapest(problem) <= result.cost * (1 + 1e-12), seed


def test_reductions_keep_the_optimum():
    """Forced plus cheapest(reduced) is the cheapest, and what is lifted is a cover."""
    shrunk = 0
    for seed in range(108):
        problem = small(seed)
        found = canonical_form(problem)
        reduction = reduce(found.residual, Budget(10**8))
        shrunk += reduction.instance.n_entries < found.residual.n_entries
        inner, bound, _ = solve_instance(found.residual, "exact", np.random.default_rng(0), Budget(10**8))
        assert found.residual.is_feasible(inner), seed
        assert bound == found.residual.cost(inner), seed
    assert shrunk > 40  # the reductions did something


def medium(seed, n_rows=120, n_columns=90, density=0.08):
    """A random instance that is easy for an integer programme; everything is coverable."""
    rng = np.random.default_rng(seed)
    M = rng.random((n_rows, n_columns)) < density
    M[:, 0] |= ~M.any(axis=1)
    return M, rng.uniform(0.5, 2.0, n_rows)


def relaxation(M, areas, coverage):
    """Optimum of the linear relaxation, modelled here independently; rows too large to stay open must be covered."""
    n_rows, n_columns = M.shape
    A = np.block([[-M.astype(float), -np.eye(n_rows)], [np.zeros(n_columns), areas]])
    costs = np.r_[np.ones(n_columns), np.zeros(n_rows)]
    slack = (1 - coverage) * areas.sum()
    bounds = [(0, 1)] * n_columns + [(0, float(area <= slack)) for area in areas]
    return linprog(costs, A_ub=A, b_ub=np.r_[-np.ones(n_rows), slack], bounds=bounds).fun


@pytest.mark.parametrize("coverage", [0.8, 0.99, 1.0])
def test_bound_is_the_linear_relaxation(coverage):
    """Row by row it comes within 1e-5 of the whole programme, and never above it."""
    for seed in range(3):
        M, areas = medium(seed)
        sets = canonical_form(CoverProblem(M, areas, coverage=coverage)).reduced
        bound = Relaxation(sets)
        raise_bound(bound, len(greedy(sets)[0]), Budget(10**9))
        assert relaxation(M, areas, coverage) * (1 - 1e-5) <= bound.dual <= relaxation(M, areas, coverage) + 1e-7


def test_fewest_equals_an_independent_integer_programme():
    """`exact` and `auto` agree with a plain model of the whole matrix; bound <= its optimum <= heuristics."""
    for seed in range(3):
        M, areas = medium(seed, 80, 60, 0.1)
        ones = np.ones(M.shape[1])
        fewest = round(milp(ones, integrality=ones, constraints=LinearConstraint(M.astype(float), lb=1)).fun)
        for solver in SOLVERS:
            budget = 10**9 if solver in ("auto", "exact") else 10**7
            result = solve(CoverProblem(M, areas), rng=np.random.default_rng(2), solver=solver, effort_budget=budget)
            assert result.lower_bound <= fewest <= len(result.views)
            if solver in ("auto", "exact"):
                assert len(result.views) == result.lower_bound == fewest


def test_local_search_beats_greedy_where_greedy_is_known_to_fail():
    """On the classical bad instance (two halves against blocks of doubling size) greedy takes 6 columns, 2 suffice."""
    blocks = [2**i for i in range(6)]
    n = sum(blocks)
    M = np.zeros((2 * n, 2 + len(blocks)), dtype=bool)
    M[:n, 0] = M[n:, 1] = True
    at = 0
    for column, size in enumerate(blocks, start=2):
        M[at : at + size, column] = M[n + at : n + at + size, column] = True
        at += size
    sets = canonical_form(CoverProblem(M, np.ones(2 * n))).reduced
    assert len(greedy(sets)[0]) == 6
    found = solve(
        CoverProblem(M, np.ones(2 * n)), rng=np.random.default_rng(0), solver="local-search", effort_budget=10**8
    )
    assert len(found.views) == 2
