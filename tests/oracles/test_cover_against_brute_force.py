"""The cover solvers and bounds against independent exact methods."""

from itertools import combinations

import numpy as np
import pytest
from scipy.optimize import LinearConstraint, linprog, milp

from planner.cover import SOLVERS, Budget, CoverStatus, solve
from planner.cover.bound import bound
from planner.cover.canonical import candidates
from planner.cover.reductions import reduce


def brute_force(M, areas, coverage, pinned=()):
    """Fewest columns by trying all subsets, smallest first."""
    coverable = M.any(axis=1)
    target = coverage * areas[coverable].sum() - 1e-9
    for size in range(M.shape[1] + 1):
        for subset in combinations(range(M.shape[1]), size):
            if not set(pinned) <= set(subset):
                continue
            covered = M[:, list(subset)].any(axis=1)
            if (covered == coverable).all() if coverage == 1.0 else areas[covered].sum() >= target:
                return size
    raise AssertionError("all columns together cover everything")


def small(seed):
    """A random instance small enough to try all subsets."""
    rng = np.random.default_rng(seed)
    n_rows, n_columns = int(rng.integers(1, 14)), int(rng.integers(1, 11))
    M = rng.random((n_rows, n_columns)) < rng.uniform(0.1, 0.6)
    areas = rng.integers(1, 6, n_rows).astype(float) if seed % 2 else rng.lognormal(0, 2, n_rows)
    return M, areas


@pytest.mark.parametrize("coverage", [0.5, 0.9, 1.0])
def test_auto_and_exact_find_and_prove_the_fewest(coverage):
    """On 60 small random instances the optimum is found, proven and equal to trying all subsets."""
    for seed in range(60):
        M, areas = small(seed)
        fewest = brute_force(M, areas, coverage)
        for solver in ("auto", "exact"):
            result = solve(M, areas, rng=np.random.default_rng(0), solver=solver, coverage=coverage, budget=20_000_000)
            assert (len(result.views), result.lower_bound) == (fewest, fewest), (seed, solver)
            assert result.status in (CoverStatus.PROVEN, CoverStatus.NOTHING_COVERABLE)


@pytest.mark.parametrize("coverage", [0.5, 0.9, 1.0])
def test_no_bound_exceeds_the_optimum_and_no_heuristic_undercuts_it(coverage):
    """For every solver and budget 0 or small: lower bound <= fewest <= views."""
    for seed in range(60):
        M, areas = small(seed)
        fewest = brute_force(M, areas, coverage)
        for solver in SOLVERS:
            for budget in (0, 200_000):
                result = solve(M, areas, rng=np.random.default_rng(1), solver=solver, coverage=coverage, budget=budget)
                assert result.lower_bound <= fewest <= len(result.views), (seed, solver, budget)


def test_pinned_views_enter_the_optimum_and_the_bound():
    """With pinned columns the proven fewest is the fewest among the selections that contain them."""
    for seed in range(40):
        M, areas = small(seed)
        pinned = np.random.default_rng(seed).choice(M.shape[1], size=min(2, M.shape[1]), replace=False).tolist()
        result = solve(M, areas, rng=np.random.default_rng(0), pinned=pinned, budget=20_000_000)
        assert len(result.views) == result.lower_bound == brute_force(M, areas, 1.0, pinned), seed


def cheapest(M, areas, coverage, multiplicity, costs):
    """Least cost by trying all subsets; rows count when covered k times, or by all their columns."""
    demand = np.minimum(M.sum(axis=1), multiplicity)
    coverable = demand > 0
    target = coverage * areas[coverable].sum() - 1e-9
    best = np.inf
    for size in range(M.shape[1] + 1):
        for subset in combinations(range(M.shape[1]), size):
            columns = list(subset)
            satisfied = (M[:, columns].sum(axis=1) >= demand) & coverable
            if costs[columns].sum() < best and areas[satisfied].sum() >= target:
                best = costs[columns].sum()
    return best


@pytest.mark.parametrize("coverage", [0.5, 0.9, 1.0])
@pytest.mark.parametrize("priced", ["ones", "whole", "real"])
def test_demands_and_costs_against_all_subsets(coverage, priced):
    """For every solver bound <= cheapest <= cost, k from 1 to 3; `auto` and `exact` reach and prove it."""
    for seed in range(16):
        rng = np.random.default_rng(seed)
        M = rng.random((int(rng.integers(1, 13)), int(rng.integers(1, 9)))) < rng.uniform(0.15, 0.6)
        n_columns = M.shape[1]
        costs = {
            "ones": np.ones(n_columns),
            "whole": rng.integers(1, 9, n_columns).astype(float),
            "real": rng.uniform(1, 9, n_columns),
        }[priced]
        areas, multiplicity = rng.integers(1, 6, len(M)).astype(float), seed % 3 + 1
        least = cheapest(M, areas, coverage, multiplicity, costs)
        for solver in SOLVERS:
            result = solve(
                M,
                areas,
                rng=np.random.default_rng(0),
                solver=solver,
                coverage=coverage,
                multiplicity=multiplicity,
                costs=costs,
                budget=20_000_000 if solver in ("meta-raps", "local-search") else 400_000_000,
            )
            assert result.cost == pytest.approx(costs[result.views].sum(), rel=1e-12)
            assert result.cost_bound <= least * (1 + 1e-12), (seed, solver)
            assert least <= result.cost * (1 + 1e-12), (seed, solver)
            if solver in ("auto", "exact"):
                assert result.status in (CoverStatus.PROVEN, CoverStatus.NOTHING_COVERABLE), (seed, solver)
                assert result.cost_bound == pytest.approx(result.cost, rel=1e-4), (seed, solver)
                assert result.cost == pytest.approx(least, rel=1e-4), (seed, solver)


@pytest.mark.parametrize("coverage", [0.7, 1.0])
def test_reductions_keep_the_optimum(coverage):
    """Forced plus fewest(reduced) is fewest(original), and the lifted cover of the reduced problem is a cover."""
    shrunk = 0
    for seed in range(60):
        M, areas = small(seed)
        problem = candidates(M, areas, coverage=coverage).problem
        reduction = reduce(problem)
        small_problem = reduction.problem
        shrunk += small_problem.n_entries < problem.n_entries
        chosen = np.zeros(0, dtype=np.int64)
        if not small_problem.trivial:
            chosen = SOLVERS["exact"](small_problem, np.random.default_rng(0), Budget(10**9))
        lifted = reduction.lift(chosen)
        assert problem.met(problem.counts(lifted) > 0)
        assert len(lifted) == brute_force(M, areas, coverage), seed
    assert shrunk > 20  # the reductions did something


def medium(seed, n_rows=120, n_columns=90, density=0.08):
    """A random instance that is easy for an integer programme."""
    rng = np.random.default_rng(seed)
    return rng.random((n_rows, n_columns)) < density, rng.uniform(0.5, 2.0, n_rows)


def relaxation(M, areas, coverage):
    """Optimum of the linear relaxation, modelled here independently."""
    M = M[M.any(axis=1)]
    n_rows, n_columns = M.shape
    if coverage == 1.0:
        return linprog(np.ones(n_columns), A_ub=-M.astype(float), b_ub=-np.ones(n_rows)).fun
    a = areas[:n_rows]
    A = np.block([[-M.astype(float), np.eye(n_rows)], [np.zeros(n_columns), -a]])
    costs = np.r_[np.ones(n_columns), np.zeros(n_rows)]
    return linprog(costs, A_ub=A, b_ub=np.r_[np.zeros(n_rows), -coverage * a.sum()], bounds=(0, 1)).fun


@pytest.mark.parametrize("lp_entries", [0, 10**9], ids=["subgradient", "lp"])
@pytest.mark.parametrize("coverage", [0.8, 1.0])
def test_bound_approaches_the_linear_relaxation_from_below(coverage, lp_entries, monkeypatch):
    """The Lagrangian value is at most the LP optimum, and within 1 % of it (1e-6 where the LP solver proposes u)."""
    monkeypatch.setattr("planner.cover.bound.LP_ENTRIES", lp_entries)
    monkeypatch.setattr("planner.cover.bound.LP_ENTRIES_WIDE", lp_entries)
    for seed in range(3):
        M, areas = medium(seed)
        M[:, 0] |= ~M.any(axis=1)  # everything coverable
        problem = candidates(M, areas, coverage=coverage).problem
        optimum = relaxation(M, areas, coverage)
        upper = len(SOLVERS["greedy"](problem, np.random.default_rng(0), Budget(0)))
        value = bound(problem, upper, Budget(10**9)).dual
        assert value <= optimum + 1e-7
        assert value >= optimum * (1 - 1e-6 if lp_entries else 0.99)


def test_fewest_equals_an_independent_integer_programme():
    """`exact` and `auto` agree with a plain model of the whole matrix; bound <= its optimum <= heuristics."""
    for seed in range(3):
        M, _ = medium(seed, 80, 60, 0.1)
        M = M[M.any(axis=1)]
        ones = np.ones(M.shape[1])
        fewest = round(milp(ones, integrality=ones, constraints=LinearConstraint(M.astype(float), lb=1)).fun)
        for solver in SOLVERS:
            budget = 10**9 if solver in ("auto", "exact") else 10**7
            result = solve(M, np.ones(len(M)), rng=np.random.default_rng(2), solver=solver, budget=budget)
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
    areas = np.ones(2 * n)
    problem = candidates(M, areas).problem
    assert len(SOLVERS["greedy"](problem, np.random.default_rng(0), Budget(0))) == 6
    assert len(SOLVERS["local-search"](problem, np.random.default_rng(0), Budget(10**8))) == 2
