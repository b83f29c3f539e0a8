"""Cover problems on which methods fail, by name."""

import time
from itertools import combinations

import numpy as np
import pytest
import scipy.sparse as sp

from planner.cover import SOLVERS, CoverProblem, CoverStatus, solve
from planner.errors import PlannerError


@pytest.fixture(params=list(SOLVERS))
def solver(request):
    """Each solver by name."""
    return request.param


def run(M, areas, solver="auto", **options):
    """Solve with a fresh generator and the tests' budget; options go to the problem or to `solve`."""
    told = {name: options.pop(name) for name in ("effort_budget", "time_limit_s", "clock") if name in options}
    problem = CoverProblem(M, areas, **options)
    return solve(problem, rng=np.random.default_rng(0), solver=solver, **{"effort_budget": 30_000_000} | told)


@pytest.mark.parametrize("shape", [(0, 0), (0, 5), (5, 0), (5, 5)])
def test_empty_matrix(solver, shape):
    """No rows, no columns or no ones: no views, a status, all area uncoverable; no exception."""
    result = run(sp.csr_array(shape, dtype=bool), np.ones(shape[0]), solver)
    assert result.status is CoverStatus.NOTHING_COVERABLE
    assert (len(result.views), result.lower_bound, result.gap, result.covered_area) == (0, 0, 0.0, 0.0)
    assert result.total_area - result.coverable_area == shape[0]
    assert len(result.uncoverable_rows) == shape[0]


def test_no_allowed_column(solver):
    """Nothing is reachable: nothing is coverable."""
    result = run(np.ones((4, 3), dtype=bool), np.ones(4), solver, allowed=np.zeros(3, dtype=bool))
    assert result.status is CoverStatus.NOTHING_COVERABLE
    assert result.coverable_area == 0.0


def test_rows_that_nothing_covers_are_reported_with_their_area(solver):
    """They lower the coverable area and do not spoil the plan."""
    M = np.array([[1, 0], [0, 0], [0, 1], [0, 0]], dtype=bool)
    result = run(M, [1.0, 10.0, 100.0, 1000.0], solver)
    assert result.uncoverable_rows.tolist() == [1, 3]
    assert result.total_area - result.coverable_area == pytest.approx(1010.0)
    assert (result.covered_area, result.status) == (101.0, CoverStatus.PROVEN)
    assert result.views.tolist() == [1, 0]


def test_one_column_covers_all(solver):
    """It alone is the plan, proven."""
    M = np.random.default_rng(0).random((40, 12)) < 0.3
    M[:, 7] = True
    result = run(M, np.ones(40), solver)
    assert result.views.tolist() == [7]
    assert result.status is CoverStatus.PROVEN


def test_identical_columns_give_the_first(solver):
    """Of columns with the same rows the one with the lowest index is used."""
    block = np.eye(4, dtype=bool)
    result = run(np.hstack((block, block, block)), np.ones(4), solver)
    assert sorted(result.views.tolist()) == [0, 1, 2, 3]


def test_identical_rows(solver):
    """A thousand copies of each row change nothing but areas."""
    rng = np.random.default_rng(5)
    M = rng.random((8, 6)) < 0.4
    M = M[M.any(axis=1)]
    one, many = run(M, np.ones(len(M)), solver), run(np.repeat(M, 1000, axis=0), np.ones(1000 * len(M)), solver)
    assert len(one.views) == len(many.views)
    assert many.covered_area == 1000 * one.covered_area


@pytest.mark.parametrize("coverage", [0.5, 0.999999, 1.0])
def test_areas_from_1e_minus_12_to_1e6(solver, coverage):
    """Eighteen orders of magnitude: full cover still covers the tiniest row, partial cover counts areas exactly."""
    rng = np.random.default_rng(6)
    M = rng.random((60, 25)) < 0.15
    M[:, 0] |= ~M.any(axis=1)
    areas = np.geomspace(1e-12, 1e6, 60)
    result = run(M, areas, solver, coverage=coverage)
    covered = M[:, result.views].any(axis=1)
    assert covered.all() if coverage == 1.0 else areas[covered].sum() >= coverage * areas.sum() * (1 - 1e-12)


def test_areas_near_the_largest_float_do_not_overflow():
    """Areas whose sum overflows are still weighed one against the other."""
    with np.errstate(over="ignore"):
        result = run(np.eye(3, dtype=bool), [1e308, 1e308, 1e308], coverage=0.6)
    assert len(result.views) == 2


def test_all_areas_zero(solver):
    """Rows without area still have to be covered at full coverage."""
    assert len(run(np.eye(3, dtype=bool), np.zeros(3), solver).views) == 3


def test_target_zero_needs_no_view(solver):
    """Coverage 0 is met by the empty plan, which is proven fewest."""
    result = run(np.ones((5, 5), dtype=bool), np.ones(5), solver, coverage=0.0)
    assert (len(result.views), result.lower_bound, result.status) == (0, 0, CoverStatus.PROVEN)


def test_tiniest_target_needs_one_view(solver):
    """The smallest positive target needs one view."""
    result = run(np.eye(5, dtype=bool), np.ones(5), solver, coverage=5e-324)
    assert (len(result.views), result.lower_bound) == (1, 1)


def test_one_ulp_below_full_coverage_still_needs_every_row_of_weight(solver):
    """0.9999999999999999 of ten equal rows is ten rows."""
    result = run(np.eye(10, dtype=bool), np.full(10, 0.1), solver, coverage=float(np.nextafter(1.0, 0.0)))
    assert len(result.views) == 10


@pytest.mark.parametrize("percent", range(1, 100))
def test_a_share_of_equal_areas_means_that_many(percent):
    """With p % of 100 equal rows p rows are meant, whichever way the float p / 100 is rounded."""
    assert (
        len(run(np.eye(100, dtype=bool), np.full(100, 0.1), "greedy", coverage=percent / 100, effort_budget=0).views)
        == percent
    )


@pytest.mark.parametrize("coverage", [np.nextafter(1.0, 2.0), -1e-300, np.nan, np.inf])
def test_coverage_outside_its_range_is_refused(coverage):
    """One ulp above what can be reached is not a share of it."""
    with pytest.raises(PlannerError, match=r"coverage is .* from 0 to 1"):
        run(np.eye(2, dtype=bool), np.ones(2), coverage=float(coverage))


@pytest.mark.parametrize("bad", [np.nan, -1e-12, np.inf])
def test_bad_areas_are_refused_with_their_row(bad):
    """NaN, negative or infinite areas are named."""
    with pytest.raises(PlannerError, match=r"areas\[1\]"):
        run(np.eye(3, dtype=bool), [1.0, bad, 1.0])


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"allowed": np.ones(3, dtype=bool)}, "allowed has shape"),
        ({"allowed": np.ones(2)}, "of bool"),
        ({"pinned": [2]}, "pinned names column 2"),
        ({"banned": [-1]}, "banned names column -1"),
        ({"pinned": [0], "banned": [0]}, "banned or not among"),
        ({"pinned": [0], "allowed": np.array([False, True])}, "banned or not among"),
        ({"solver": "gready"}, "choose one of"),
        ({"effort_budget": -1}, "budget is -1"),
        ({"time_limit_s": float("nan")}, "time limit"),
        ({"demand": 0}, "at least once"),
        ({"costs": [1.0]}, r"must be \(2,\)"),
        ({"costs": [1.0, float("nan")]}, r"costs\[1\] is nan"),
        ({"costs": [0.0, 1.0]}, r"costs\[0\] is 0.0"),
        ({"costs": [1.0, -2.0]}, r"costs\[1\] is -2.0"),
        ({"costs": [float("inf"), 1.0]}, r"costs\[0\] is inf"),
    ],
)
def test_broken_input_is_refused_with_a_sentence(options, sentence):
    """Each message says what would be valid."""
    with pytest.raises(PlannerError, match=sentence):
        run(np.eye(2, dtype=bool), np.ones(2), **options)


def test_areas_of_another_length_are_refused():
    """One area per row."""
    with pytest.raises(PlannerError, match=r"must be \(2,\)"):
        run(np.eye(2, dtype=bool), np.ones(3))


def test_budget_zero_gives_greedy_and_a_bound(solver):
    """Without any work there is still a cover and a positive bound (`exact` always solves its root)."""
    M = np.random.default_rng(1).random((200, 100)) < 0.06
    result = run(M, np.ones(200), solver, effort_budget=0)
    assert (M[:, result.views].any(axis=1) == M.any(axis=1)).all()
    assert 1 <= result.lower_bound <= len(result.views)


def test_a_pinned_view_that_sees_nothing_stays(solver):
    """The user's wish counts, though the view adds no area."""
    M = np.eye(3, 4, dtype=bool)
    result = run(M, np.ones(3), solver, pinned=[3])
    assert result.views.tolist()[-1] == 3
    assert (len(result.views), result.lower_bound, result.marginal_area[-1]) == (4, 4, 0.0)


def steiner_triples(points):
    """Bose's construction of a Steiner triple system on 6n + 3 points."""
    n = points // 3
    half = (n + 1) // 2
    triples = [tuple(sorted((x, n + x, 2 * n + x))) for x in range(n)]
    for x, y in combinations(range(n), 2):
        z = (x + y) * half % n
        triples += [(i * n + x, i * n + y, (i + 1) % 3 * n + z) for i in range(3)]
    M = np.zeros((len(triples), points), dtype=bool)
    for row, triple in enumerate(triples):
        M[row, list(triple)] = True
    pairs = M.T.astype(int) @ M
    assert (pairs[~np.eye(points, dtype=bool)] == 1).all()  # every pair of points lies in exactly one triple
    return M


@pytest.mark.parametrize(("points", "fewest"), [(9, 5), (15, 9)])
def test_steiner_triples(solver, points, fewest):
    """Highly symmetric covers with a weak relaxation (points / 3): solved by the exact ones, never undercut."""
    M = steiner_triples(points)
    budget = 400_000_000 if solver in ("auto", "exact") else 30_000_000
    result = run(M, np.ones(len(M)), solver, effort_budget=budget)
    assert points / 3 <= result.lower_bound <= fewest <= len(result.views)
    if solver in ("auto", "exact"):
        assert (len(result.views), result.status) == (fewest, CoverStatus.PROVEN)
    if solver == "local-search":
        assert len(result.views) == fewest


def test_a_last_column_that_loses_all_its_rows(solver):
    """Rows that contain others are dropped, and with them all rows of the last column; the cover is still the best."""
    M = np.array(
        [
            [0, 1, 0, 1, 1, 0],
            [1, 0, 0, 1, 1, 1],
            [0, 1, 0, 1, 0, 0],
            [1, 1, 1, 0, 0, 1],
            [0, 0, 0, 1, 0, 1],
            [1, 1, 0, 0, 1, 1],
        ],
        dtype=bool,
    )
    result = run(sp.csr_array(M), np.ones(6), solver)
    assert M[:, result.views].any(axis=1).all()
    fewest = next(n for n in range(1, 7) if any(M[:, list(c)].any(axis=1).all() for c in combinations(range(6), n)))
    assert result.lower_bound <= fewest <= len(result.views)


def test_costs_from_1e_minus_12_to_1e6(solver):
    """Eighteen orders of magnitude: the cheapest columns still cover, and the bound holds."""
    M = np.vstack((np.eye(12, dtype=bool), np.ones((1, 12), dtype=bool)))
    M = np.hstack((M, M))
    costs = np.concatenate((np.geomspace(1e-12, 1e6, 12), np.geomspace(2e-12, 2e6, 12)))
    result = run(M, np.ones(len(M)), solver, costs=costs)
    assert sorted(result.views.tolist())[-1] < 24
    assert M[:, result.views].any(axis=1).all()
    assert sorted(result.views.tolist()) == list(range(12))
    assert result.cost == pytest.approx(costs[:12].sum(), rel=1e-12)
    assert result.cost * (1 - 1e-3) <= result.cost_bound <= result.cost


def test_costs_far_below_the_rounding_bound_nothing_falsely(solver):
    """Columns of a millionth beside one of a million: their cost is told as given, and no bound is above it."""
    M = np.hstack((np.repeat(np.eye(3, dtype=bool), 2, axis=1), np.ones((3, 1), dtype=bool)))
    costs = np.array([2e-6, 1e-6, 2e-6, 1e-6, 2e-6, 1e-6, 1e6])
    result = run(M, np.ones(3), solver, costs=costs)
    assert sorted(result.views.tolist()) == [1, 3, 5]
    assert result.cost == pytest.approx(3e-6, rel=1e-12)
    assert 0 < result.cost_bound <= 3e-6


def test_columns_whose_areas_sum_beyond_an_int64():
    """Ten thousand columns that each cover half of all: two of them are enough, and no bound says more."""
    rng = np.random.default_rng(0)
    M = np.argsort(rng.random((80, 9000)), axis=0) < 40
    M[:, 4001] = ~M[:, 17]
    result = run(M, np.ones(80), "greedy", effort_budget=0)
    assert result.lower_bound == 2


def test_as_many_views_as_rows_are_told_quickly():
    """Each row has a column of its own: nothing to search, and the order of so many views costs no seconds."""
    start = time.process_time()
    result = run(sp.eye_array(4000, format="csc").astype(bool), np.arange(4000.0))
    np.testing.assert_array_equal(result.views[:-1], np.arange(3999, 0, -1))
    assert result.status is CoverStatus.PROVEN
    assert time.process_time() - start < 5.0


def test_ctrl_c_before_the_bound_still_tells_the_costs(solver, monkeypatch):
    """The greedy cover and the cost of one column are all that is known; the sentence says so."""

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("planner.cover.solvers.Relaxation", interrupted)
    M = np.random.default_rng(3).random((60, 80)) < 0.1
    result = run(M, np.ones(60), solver, costs=np.random.default_rng(4).uniform(1.0, 2.0, 80))
    assert result.status is CoverStatus.INTERRUPTED
    assert 0 < result.cost_bound < result.cost
    assert result.sentence.startswith("the search was interrupted; costs at most")


def test_a_multiplicity_beyond_all_columns_takes_every_column_that_covers(solver):
    """Demanding more than there is means all there is: reported, not refused."""
    M = np.random.default_rng(2).random((20, 8)) < 0.4
    M[:, 7] = False
    result = run(M, np.ones(20), solver, demand=2**70)
    assert sorted(result.views.tolist()) == [j for j in range(8) if M[:, j].any()]
    np.testing.assert_array_equal(result.unsatisfiable_rows, np.flatnonzero(M.any(axis=1)))
    assert result.status is CoverStatus.PROVEN


@pytest.mark.parametrize("demand", [1, 2])
def test_permuting_rows_and_columns_of_ties(solver, demand):
    """A ring in which every column looks like every other: any numbering gives as many views."""
    n = 12
    ring = sum(np.roll(np.eye(n, dtype=int), k, axis=1) for k in range(3)).astype(bool)
    sizes = set()
    for seed in range(3):
        rng = np.random.default_rng(seed)
        M = ring[rng.permutation(n)][:, rng.permutation(n)]
        sizes.add(len(run(M, np.ones(n), solver, demand=demand).views))
    assert len(sizes) == 1 or solver in ("greedy", "meta-raps")
    if solver in ("auto", "exact", "local-search"):
        assert sizes == {4 * demand}


def test_target_one_ulp_above_what_a_subset_reaches(solver):
    """A target that three of four equal rows just miss needs the fourth; one that they meet does not."""
    areas = np.full(4, 0.1)
    assert len(run(np.eye(4, dtype=bool), areas, solver, coverage=0.75).views) == 3
    above = 0.75 * (1 + 1e-9)
    assert len(run(np.eye(4, dtype=bool), areas, solver, coverage=above).views) == 4
