"""Robust covers against trying all selections, in floating point and by simulation; closed forms of two views."""

from itertools import combinations

import numpy as np
import pytest
from scipy.sparse import csr_array

from planner.cover import CoverProblem, solve
from planner.cover.bounds import Relaxation, raise_bound
from planner.cover.budget import Budget
from planner.cover.reductions import canonical_form
from planner.cover.robust import DEMAND, loads, min_views_at_confidence, robust_cover
from planner.measurability.pose_ensemble import ProbabilityLayer, credited_probability


def small(seed, members=32):
    """A random matrix with hits of its entries."""
    rng = np.random.default_rng(seed)
    n_rows, n_columns = int(rng.integers(1, 12)), int(rng.integers(2, 10))
    M = csr_array(rng.random((n_rows, n_columns)) < 0.5)
    hits = np.where(rng.random(M.nnz) < 0.4, members, rng.integers(0, members + 1, M.nnz))
    return M, ProbabilityLayer(M.indptr, M.indices, hits, members), rng.integers(1, 4, n_rows).astype(float)


def missed(M, layer, views):
    """(S,) probability that none of the views measures each row, as a plain product."""
    p = np.zeros(M.shape)
    rows = np.repeat(np.arange(M.shape[0]), np.diff(M.indptr))
    p[rows, M.indices] = credited_probability(layer.hits, layer.members)
    return np.prod(1.0 - p[:, views], axis=1)


def fewest(M, layer, areas, alpha, coverage, pinned=()):
    """Fewest views by trying all subsets."""
    promised = missed(M, layer, list(range(M.shape[1]))) <= alpha * (1 + 1e-9)
    target = coverage * areas[promised].sum() - 1e-9
    for size in range(M.shape[1] + 1):
        for subset in combinations(range(M.shape[1]), size):
            kept = missed(M, layer, list(subset)) <= alpha * (1 + 1e-9)
            if set(pinned) <= set(subset) and areas[kept].sum() >= target:
                return size
    raise AssertionError("all columns together keep every promise that can be kept")


@pytest.mark.parametrize("alpha", [0.2, 0.05, 0.001])
@pytest.mark.parametrize("coverage", [0.7, 1.0])
def test_the_fewest_that_keep_the_promise_are_found(alpha, coverage):
    """On 40 small instances: promise kept by plain products, the optimum found, the bound never above it."""
    proven = 0
    for seed in range(40):
        M, layer, areas = small(seed)
        best = fewest(M, layer, areas, alpha, coverage)
        found = robust_cover(
            CoverProblem(M, areas, coverage=coverage),
            layer,
            alpha=alpha,
            rng=np.random.default_rng(0),
            effort_budget=20_000_000,
        )
        kept = missed(M, layer, found.cover.views) <= alpha * (1 + 1e-9)
        possible = missed(M, layer, list(range(M.shape[1]))) <= alpha * (1 + 1e-9)
        assert areas[kept].sum() == pytest.approx(found.robust_area)
        assert areas[possible].sum() == pytest.approx(found.robust_coverable_area)
        assert found.robust_area >= coverage * found.robust_coverable_area - 1e-9
        assert found.cover.lower_bound <= best == len(found.cover.views), seed
        np.testing.assert_allclose(1 - found.probability, missed(M, layer, found.cover.views), atol=1e-12)
        proven += found.cover.lower_bound == best
    assert proven > 30


def test_pinned_views_enter_the_optimum():
    """The optimum among the selections that hold the pinned views; the bound stays below."""
    for seed in range(30):
        M, layer, areas = small(seed)
        pinned = [seed % M.shape[1]]
        found = robust_cover(
            CoverProblem(M, areas, pinned=pinned),
            layer,
            alpha=0.05,
            rng=np.random.default_rng(0),
            effort_budget=20_000_000,
        )
        best = fewest(M, layer, areas, 0.05, 1.0, pinned)
        assert set(pinned) <= set(found.cover.views.tolist())
        assert found.cover.lower_bound <= best == len(found.cover.views), seed


def test_two_views_together_promise_what_the_closed_form_says():
    """1 - (1 - p)(1 - q): two views of 8 and 16 hits in 32 promise 1 - (24.5/33)(16.5/33), and no less and no more."""
    M = csr_array(np.ones((1, 2), dtype=bool))
    layer = ProbabilityLayer(M.indptr, M.indices, np.array([8, 16]), 32)
    together = 1 - (24.5 / 33) * (16.5 / 33)
    for alpha, possible in ((1 - together + 1e-4, True), (1 - together - 1e-4, False)):
        found = robust_cover(CoverProblem(M, [1.0]), layer, alpha=alpha, rng=np.random.default_rng(0))
        assert (found.robust_coverable_area > 0) == possible
        assert len(found.cover.views) == (2 if possible else 0)
        if possible:
            assert found.probability[0] == pytest.approx(together)


@pytest.mark.parametrize(("alpha", "members", "views"), [(0.05, 32, 1), (0.01, 32, 2), (0.001, 32, 2), (1e-4, 32, 3)])
def test_how_many_sure_views_a_promise_needs(alpha, members, views):
    """The credit of a view is capped: 32 hits of 32 give 1 - 0.5 / 33, and its powers say how many are needed."""
    assert min_views_at_confidence(alpha, members) == views
    assert (0.5 / 33) ** views <= alpha < (0.5 / 33) ** (views - 1)


def test_exact_poses_give_the_nominal_plan_to_the_bit():
    """Without members every entry is certain: views, areas, bound and status are those of the plain cover."""
    rng = np.random.default_rng(4)
    M = csr_array(rng.random((60, 30)) < 0.1)
    areas = rng.uniform(1, 2, 60)
    certain = ProbabilityLayer(M.indptr, M.indices, np.zeros(M.nnz, dtype=int), 0)
    for coverage in (0.9, 1.0):
        robust = robust_cover(
            CoverProblem(M, areas, coverage=coverage), certain, alpha=0.01, rng=np.random.default_rng(7)
        )
        plain = solve(CoverProblem(M, areas, coverage=coverage), rng=np.random.default_rng(7))
        for name in ("views", "marginal_area"):
            np.testing.assert_array_equal(getattr(robust.cover, name), getattr(plain, name))
        assert (robust.cover.lower_bound, robust.cover.status) == (plain.lower_bound, plain.status)
        assert robust.robust_area == plain.covered_area
        assert robust.robust_coverable_area == plain.coverable_area


def test_the_promise_holds_when_the_layer_is_the_truth():
    """Entries drawn with the credited probabilities 4,000 times: misses are at most alpha, within 4 sigma."""
    M, layer, areas = small(11)
    alpha = 0.1
    found = robust_cover(CoverProblem(M, areas), layer, alpha=alpha, rng=np.random.default_rng(0))
    p = np.zeros(M.shape)
    p[np.repeat(np.arange(M.shape[0]), np.diff(M.indptr)), M.indices] = layer.probability
    p = p[:, found.cover.views]
    drawn = np.random.default_rng(1).random((4000, *p.shape)) < p
    frequency = drawn.any(axis=2).mean(axis=0)
    promised = found.probability >= 1 - alpha
    assert promised.any()
    assert (frequency[promised] >= 1 - alpha - 4 * np.sqrt(alpha * (1 - alpha) / 4000)).all()


def test_the_second_rows_of_the_bound_pay():
    """Ten rows, disjoint pairs of columns of 0.9 each: sums of shares ask for 12 columns, all 20 are needed."""
    M = csr_array((0.9 * DEMAND * np.kron(np.eye(10), np.ones((1, 3)))).astype(np.int64))
    found = canonical_form(CoverProblem(M, np.ones(10), demand=DEMAND))
    bound = Relaxation(found.reduced)
    raise_bound(bound, 20, Budget(10**8))
    assert bound.bound == 20


def test_parts_are_rounded_down_and_cut_at_the_whole():
    """No load exceeds the demand, none promises more than its logarithm, and p = 1 - alpha alone is enough."""
    M = csr_array(np.ones((1, 33), dtype=bool))
    layer = ProbabilityLayer(M.indptr, M.indices, np.arange(33), 32)
    whole = loads(layer, 0.05, (1, 33)).toarray()[0]
    exact = -np.log1p(-credited_probability(np.arange(33), 32)) / -np.log(0.05) * DEMAND
    assert (whole <= np.minimum(exact, DEMAND) + 1e-6).all()
    assert (whole >= np.minimum(exact, DEMAND) - 1).all()
    assert whole[0] == 0
    assert loads(layer, 1 - float(layer.probability[20]), (1, 33)).toarray()[0, 20] == DEMAND
