"""The most area with k views, and the curve over k, against trying all selections and an independent model."""

from itertools import combinations

import numpy as np
import pytest
from scipy.optimize import linprog

from planner.cover import CoverProblem, CoverStatus, solve
from planner.cover.curve import coverage_curve


def small(seed):
    """A random instance small enough to try all subsets; every other one has unequal areas."""
    rng = np.random.default_rng(seed)
    n_rows, n_columns = int(rng.integers(1, 16)), int(rng.integers(1, 10))
    M = rng.random((n_rows, n_columns)) < rng.uniform(0.1, 0.6)
    return M, rng.integers(1, 4, n_rows).astype(float) if seed % 2 else rng.lognormal(0, 1, n_rows)


def most(M, areas, k, pinned=()):
    """The largest area of at most k columns that hold the pinned ones, by trying all."""
    rest = [j for j in range(M.shape[1]) if j not in pinned]
    best = 0.0
    for extra in range(min(k - len(pinned), len(rest)) + 1):
        for subset in combinations(rest, extra):
            best = max(best, float(areas[M[:, [*pinned, *subset]].any(axis=1)].sum()))
    return best


@pytest.mark.parametrize("pins", [0, 2])
def test_the_most_area_is_found_and_proven(pins):
    """For every k: the area is that of trying all selections, the bound meets it, and at most k views are taken."""
    for seed in range(30):
        M, areas = small(seed)
        pinned = np.random.default_rng(seed).choice(M.shape[1], min(pins, M.shape[1]), replace=False).tolist()
        for k in range(len(pinned), M.shape[1] + 2):
            found = solve(
                CoverProblem(M, areas, max_views=k, pinned=pinned),
                rng=np.random.default_rng(0),
                effort_budget=20_000_000,
            )
            best = most(M, areas, k, pinned)
            assert found.covered_area == pytest.approx(best, rel=1e-9, abs=1e-12), (seed, k)
            assert found.upper_area >= best * (1 - 1e-12)
            assert found.status in (CoverStatus.PROVEN, CoverStatus.NOTHING_COVERABLE), (seed, k, found.sentence)
            assert len(found.views) <= k
            assert set(pinned) <= set(found.views.tolist())
            assert areas[M[:, found.views].any(axis=1)].sum() == pytest.approx(found.covered_area)


@pytest.mark.parametrize("budget", [0, 200_000, 50_000_000])
def test_the_curve_lies_between_a_selection_and_the_bound(budget):
    """At every k and budget: a real selection of k views <= the most possible <= the bound; the fewest follow."""
    for seed in range(30):
        M, areas = small(seed)
        curve = coverage_curve(CoverProblem(M, areas), rng=np.random.default_rng(0), effort_budget=budget)
        best = [most(M, areas, int(k)) for k in curve.n_views]
        for views, k, area in zip(curve.views, curve.n_views, curve.covered_area, strict=True):
            assert len(views) == k
            assert areas[M[:, views].any(axis=1)].sum() == pytest.approx(area)
        assert (curve.covered_area <= np.array(best) * (1 + 1e-9)).all()
        assert (curve.upper_area >= np.array(best) * (1 - 1e-9)).all()
        if budget > 1_000_000:
            np.testing.assert_allclose(curve.covered_area, best, rtol=1e-9)
        if budget:
            assert curve.covered_area[-1] == pytest.approx(curve.coverable_area)
        coverable = areas[M.any(axis=1)].sum()
        for coverage in (0.0, 0.5, 0.9, 1.0):
            fewest = next(
                k for k in range(M.shape[1] + 1) if most(M, areas, k) >= coverage * coverable - 1e-9 * coverable
            )
            suffices, possible = curve.fewest_views(coverage)
            assert suffices is None or fewest <= suffices
            assert possible is None or possible <= fewest


def relaxation(M, areas, k):
    """Value of the linear relaxation, modelled here independently."""
    n_rows, n_columns = M.shape
    A = np.block([[-M.astype(float), np.eye(n_rows)], [np.ones(n_columns), np.zeros(n_rows)]])
    costs = np.r_[np.zeros(n_columns), -areas]
    return -linprog(costs, A_ub=A, b_ub=np.r_[np.zeros(n_rows), k], bounds=(0, 1)).fun


def test_one_set_of_multipliers_bounds_every_number_of_views_near_the_relaxation():
    """On a random visibility-like matrix the bound is never below the LP value and at most 1 % above it."""
    rng = np.random.default_rng(5)
    M = rng.random((150, 70)) < 0.12
    M = M[M.any(axis=1)]
    areas = rng.uniform(0.5, 2.0, len(M))
    curve = coverage_curve(CoverProblem(M, areas), rng=np.random.default_rng(0), effort_budget=10**9)
    for k in range(1, len(curve.views)):
        value = min(relaxation(M, areas, k), areas.sum())
        assert curve.covered_area[k] * (1 - 1e-9) <= curve.upper_area[k] <= value * (1 + 1e-6)


def most_greedy(M, areas, k):
    """Area of a greedy selection."""
    uncovered = np.ones(len(M), dtype=bool)
    for _ in range(k):
        uncovered &= ~M[:, int((areas[:, None] * (M & uncovered[:, None])).sum(axis=0).argmax())]
    return float(areas[~uncovered].sum())


def test_search_beats_greedy_where_greedy_is_known_to_fail():
    """Two halves against one column over both middles: greedy takes the middle first, two halves cover everything."""
    M = np.zeros((20, 3), dtype=bool)
    M[:10, 0] = M[10:, 1] = True
    M[4:16, 2] = True
    areas = np.ones(20)
    assert most_greedy(M, areas, 2) == 16
    found = solve(CoverProblem(M, areas, max_views=2), rng=np.random.default_rng(0))
    assert sorted(found.views.tolist()) == [0, 1]
    assert found.covered_area == found.coverable_area


def test_below_full_coverage_the_selection_profits_from_searching_by_area():
    """On random matrices at 90 % the selection has no more views than the curve needs, and is below on none."""
    for seed in range(2):
        rng = np.random.default_rng(seed)
        M = rng.random((150, 60)) < 0.15
        M = M[M.any(axis=1)]
        areas = np.ones(len(M))
        curve = coverage_curve(CoverProblem(M, areas), rng=np.random.default_rng(0), effort_budget=10_000_000)
        suffices, possible = curve.fewest_views(0.9)
        found = solve(CoverProblem(M, areas, coverage=0.9), rng=np.random.default_rng(0), effort_budget=10_000_000)
        assert possible <= len(found.views) <= suffices
