"""Cover problems on which methods fail, by name."""

import time
from itertools import combinations
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import csr_array

from planner.cover import SOLVERS, Cover, CoverProblem, CoverStatus, Overlap, solve
from planner.cover.curve import CoverageCurve, coverage_curve
from planner.cover.overlap import OverlapGraph, overlap_graph
from planner.cover.robust import RobustCover, loads, robust_cover
from planner.errors import PlannerError
from planner.measurability.pose_ensemble import ProbabilityLayer
from tests.support.cover_oracle import assert_consistent


@pytest.fixture(params=list(SOLVERS))
def solver(request: pytest.FixtureRequest) -> str:
    """Return each solver by name."""
    return str(request.param)


def run(
    M: Any, areas: Any, solver: str = "auto", *, effort: int = 30_000_000, is_minimal: bool = True, **options: Any
) -> Cover:
    """Solve with a fresh generator and the tests' budget; check the answer."""
    problem = CoverProblem(M, areas, **options)
    cover = solve(problem, rng=np.random.default_rng(0), solver=solver, effort_budget=effort)
    assert_consistent(problem, cover, is_minimal=is_minimal)
    return cover


def draw(M: Any, areas: Any, *, known: Any = (), effort: int = 20_000_000, **options: Any) -> CoverageCurve:
    """Return the curve with a fresh generator and the tests' budget."""
    problem, rng = CoverProblem(M, areas, **options), np.random.default_rng(0)
    return coverage_curve(problem, rng=rng, known_selections=known, effort_budget=effort)


def connected(M: Any, areas: Any, overlap: Overlap, **options: Any) -> tuple[Cover, OverlapGraph]:
    """Return a connected cover and its graph."""
    cover = run(M, areas, overlap=overlap, effort=2_000_000, **options)
    return cover, overlap_graph(CoverProblem(M, areas, overlap=overlap, **options), cover)


def robust(M: Any, hits: Any, *, alpha: float = 0.05, effort: int = 2_000_000, **options: Any) -> RobustCover:
    """Return a robust cover of a dense matrix whose entries have hits out of 32."""
    matrix = csr_array(np.asarray(M, dtype=bool))
    layer = ProbabilityLayer(matrix.indptr, matrix.indices, np.broadcast_to(hits, matrix.nnz), 32)
    problem = CoverProblem(matrix, np.ones(len(M)), **options)
    return robust_cover(problem, layer, alpha=alpha, rng=np.random.default_rng(0), effort_budget=effort)


# Empty problems and targets


@pytest.mark.parametrize("shape", [(0, 0), (0, 5), (5, 0), (5, 5)])
@pytest.mark.parametrize(
    "options", [{}, {"max_views": 3}, {"overlap": Overlap(area=1.0)}], ids=["full", "area", "overlap"]
)
def test_an_empty_matrix_is_answered_by_no_view(solver: str, shape: tuple[int, int], options: dict[str, Any]) -> None:
    """Without rows, columns, entries or an allowed column the status is NOTHING_COVERABLE."""
    M = sp.csr_array(shape, dtype=bool)
    banned = run(np.ones((4, 3), dtype=bool), np.ones(4), solver, allowed=np.zeros(3, dtype=bool), **options)
    assert banned.status is CoverStatus.NOTHING_COVERABLE
    cover = run(M, np.ones(shape[0]), solver, **options)
    assert cover.status is CoverStatus.NOTHING_COVERABLE
    assert cover.sentence == "no allowed candidate measures any sample"
    assert (len(cover.views), cover.lower_bound, cover.gap, cover.gap_percent) == (0, 0, 0.0, 0.0)
    assert len(cover.uncoverable_rows) == shape[0]
    curve = draw(M, np.ones(shape[0]))
    assert (curve.covered_area.tolist(), curve.upper_area.tolist()) == ([0.0], [0.0])
    assert curve.fewest_views(1.0) == (0, 0)
    found = robust(np.zeros(shape, dtype=bool), np.zeros(0))
    assert (len(found.cover.views), found.robust_coverable_area) == (0, 0.0)


@pytest.mark.parametrize(("coverage", "n_views"), [(0.0, 0), (5e-324, 1), (float(np.nextafter(1.0, 0.0)), 10)])
def test_extreme_targets(solver: str, coverage: float, n_views: int) -> None:
    """A target of 0 needs no view, the smallest positive target one, and one ulp below full coverage every row."""
    is_minimal = coverage != 5e-324  # below the tolerance of the check
    cover = run(np.eye(10, dtype=bool), np.full(10, 0.1), solver, coverage=coverage, is_minimal=is_minimal)
    assert (len(cover.views), cover.lower_bound, cover.status) == (n_views, n_views, CoverStatus.PROVEN)


def test_a_share_of_equal_areas_is_exact() -> None:
    """P % of 100 equal rows are p rows for any rounding of p / 100. A slightly larger share is one row more."""
    for percent in (1, 29, 57, 58, 99):  # 0.29, 0.57 and 0.58 are rounded down
        M, areas = np.eye(100, dtype=bool), np.full(100, 0.1)
        assert len(run(M, areas, "greedy", coverage=percent / 100, effort=0).views) == percent
        assert len(run(M, areas, "greedy", coverage=percent / 100 * (1 + 1e-9), effort=0).views) == percent + 1


# Sizes, ties and symmetry


@pytest.mark.parametrize("coverage", [0.999999, 1.0])
def test_areas_over_eighteen_decades(solver: str, coverage: float) -> None:
    """Full cover still covers the smallest row; partial cover counts areas exactly; the curve does not fall."""
    rng = np.random.default_rng(6)
    M = rng.random((60, 25)) < 0.15
    M[:, 0] |= ~M.any(axis=1)
    areas = np.geomspace(1e-12, 1e6, 60)
    cover = run(M, areas, solver, coverage=coverage)
    assert cover.covered_area == pytest.approx(areas[M[:, cover.views].any(axis=1)].sum())
    curve = draw(M, areas)
    assert (np.diff(curve.covered_area) >= 0).all()
    assert (curve.upper_area >= curve.covered_area).all()
    assert curve.covered_area[-1] == pytest.approx(areas.sum())


def test_costs_far_below_their_rounding_give_no_false_bound(solver: str) -> None:
    """With costs of 1e-6 beside one of 1e6, the cost is exact and the bound does not exceed it."""
    M = np.hstack((np.repeat(np.eye(3, dtype=bool), 2, axis=1), np.ones((3, 1), dtype=bool)))
    cover = run(M, np.ones(3), solver, costs=np.array([2e-6, 1e-6, 2e-6, 1e-6, 2e-6, 1e-6, 1e6]))
    assert sorted(cover.views.tolist()) == [1, 3, 5]
    assert cover.cost == pytest.approx(3e-6, rel=1e-12)
    assert 0 < cover.cost_bound <= 3e-6


def test_columns_whose_areas_sum_beyond_an_int64() -> None:
    """Two of 9,000 columns that each cover half suffice, and the bound is 2."""
    rng = np.random.default_rng(0)
    M = np.argsort(rng.random((80, 9000)), axis=0) < 40
    M[:, 4001] = ~M[:, 17]
    problem = CoverProblem(M, np.ones(80))
    assert solve(problem, rng=rng, solver="greedy", effort_budget=0).lower_bound == 2


def test_as_many_views_as_rows_are_ordered_quickly() -> None:
    """Each row has its own column, and the order of 4,000 views is found within 5 s."""
    start = time.process_time()
    problem = CoverProblem(sp.eye_array(4000, format="csc").astype(bool), np.arange(4000.0))
    cover = solve(problem, rng=np.random.default_rng(0))
    np.testing.assert_array_equal(cover.views[:-1], np.arange(3999, 0, -1))
    assert cover.status is CoverStatus.PROVEN
    assert time.process_time() - start < 5.0


def test_identical_columns_give_the_first_and_identical_rows_change_only_areas(solver: str) -> None:
    """The first of identical columns is selected. A thousand copies of each row change only the areas."""
    block = np.eye(4, dtype=bool)
    assert sorted(run(np.hstack((block, block, block)), np.ones(4), solver).views) == [0, 1, 2, 3]
    M = np.random.default_rng(5).random((8, 6)) < 0.4
    M = M[M.any(axis=1)]
    one, many = run(M, np.ones(len(M)), solver), run(np.repeat(M, 1000, axis=0), np.ones(1000 * len(M)), solver)
    assert len(one.views) == len(many.views)
    assert many.covered_area == 1000 * one.covered_area


def test_a_demand_beyond_all_columns_takes_every_useful_column(solver: str) -> None:
    """The unsatisfiable rows are reported, and every useful column is selected."""
    M = np.random.default_rng(2).random((20, 8)) < 0.4
    M[:, 7] = False
    cover = run(M, np.ones(20), solver, demand=2**70)
    assert sorted(cover.views.tolist()) == [j for j in range(8) if M[:, j].any()]
    np.testing.assert_array_equal(cover.unsatisfiable_rows, np.flatnonzero(M.any(axis=1)))
    assert cover.status is CoverStatus.PROVEN


def steiner_triples(points: int) -> np.ndarray:
    """Return a Steiner triple system on 6n + 3 points by Bose's construction."""
    n = points // 3
    half = (n + 1) // 2
    triples = [(x, n + x, 2 * n + x) for x in range(n)]
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
def test_steiner_triples(solver: str, points: int, fewest: int) -> None:
    """The exact solvers solve these symmetric covers with a weak relaxation (points / 3), and no bound is too high."""
    M = steiner_triples(points)
    effort = 400_000_000 if solver in ("auto", "exact") else 10_000_000
    cover = run(M, np.ones(len(M)), solver, effort=effort)
    assert points / 3 <= cover.lower_bound <= fewest <= len(cover.views)
    if solver in ("auto", "exact"):
        assert (len(cover.views), cover.status) == (fewest, CoverStatus.PROVEN)
    assert solver != "local-search" or len(cover.views) == fewest


def test_meta_raps_improves_on_greedy() -> None:
    """Meta-RaPS finds smaller covers than greedy on at least four of six random instances."""
    better = 0
    for seed in range(6):
        M = np.random.default_rng(seed).random((100, 100)) < 0.08
        found, first = (run(M, np.ones(100), name, effort=10**7) for name in ("meta-raps", "greedy"))
        better += len(found.views) < len(first.views)
    assert better >= 4


# Pins, maximum coverage and curves


def test_pinned_views_that_measure_nothing_stay(solver: str) -> None:
    """Such views are the last ones, count in the bound and use one of the `max_views` places."""
    cover = run(np.eye(3, 4, dtype=bool), np.ones(3), solver, pinned=[3])
    assert (cover.views[-1], len(cover.views), cover.lower_bound) == (3, 4, 4)
    M = np.array([[0, 1, 0], [0, 0, 1]], dtype=bool)
    cover = run(M, np.ones(2), solver, max_views=2, pinned=[0])
    assert (cover.views[-1], cover.covered_area) == (0, 1.0)
    assert draw(M, np.ones(2), pinned=[0]).first_n_views == 1
    assert sorted(run(M, np.ones(2), solver, max_views=10**12).views) == [1, 2]


def test_a_known_plan_is_on_the_curve_and_ends_it() -> None:
    """Without effort the known plan is the last point of the curve."""
    M = np.random.default_rng(1).random((80, 30)) < 0.15
    M = M[M.any(axis=1)]
    full = draw(M, np.ones(len(M))).views[-1]
    curve = draw(M, np.ones(len(M)), effort=0, known=[full])
    assert curve.n_views[-1] == len(full)
    assert curve.covered_area[-1] == curve.coverable_area
    with pytest.raises(PlannerError, match="pinned"):
        draw(M, np.ones(len(M)), known=[full], pinned=np.setdiff1d(np.arange(30), full)[:1].tolist())
    with pytest.raises(PlannerError, match="from 0 to 1"):
        curve.fewest_views(1.5)


# Overlap


def islands() -> np.ndarray:
    """Return two pairs of overlapping columns; the pairs have no common row."""
    M = np.zeros((10, 4), dtype=bool)
    M[:4, 0] = M[3:7, 1] = M[7:9, 2] = M[8:, 3] = True
    return M


def test_two_islands_cannot_be_connected() -> None:
    """The cover is complete, each component is connected, and the message names the largest."""
    cover, graph = connected(islands(), np.ones(10), Overlap(area=1.0))
    assert not graph.is_connected
    assert sorted(cover.views.tolist()) == [0, 1, 2, 3]
    assert graph.component_area.tolist() == [7.0, 3.0]
    assert set(cover.views[graph.component == 0].tolist()) == {0, 1}
    for words in ("falls into 2 components", "2 of 4 views", "70.00 %"):
        assert words in graph.sentence
    cover, graph = connected(islands(), np.ones(10), Overlap(area=1.0), coverage=0.7)
    assert graph.is_connected
    assert sorted(cover.views.tolist()) == [0, 1]
    cover, graph = connected(islands(), np.ones(10), Overlap(area=1.0), coverage=0.7, pinned=[3])
    assert not graph.is_connected


def test_a_pinned_view_that_measures_nothing_does_not_end_the_search_early() -> None:
    """The pinned view counts in the bound and not in the number of searched columns."""
    for seed in (48, 98, 117):  # instances that need a search to save the last view
        M = np.random.default_rng(seed).random((30, 16)) < 0.25
        M[:, 15] = False
        without, _ = connected(M, np.ones(30), Overlap(area=2.0))
        pinned, _ = connected(M, np.ones(30), Overlap(area=2.0), pinned=[15])
        assert len(pinned.views) == len(without.views) + 1


# Coverage at a confidence


def test_simple_robust_covers() -> None:
    """One view with 32 hits of 32 gives 98.5 %, so 99 % needs two views. Pinned and banned views are obeyed."""
    assert len(robust(np.ones((1, 1)), 32).cover.views) == 1
    assert robust(np.ones((1, 1)), 32, alpha=0.01).robust_coverable_area == 0.0
    assert len(robust(np.ones((1, 2)), 32, alpha=0.01).cover.views) == 2
    assert robust(np.ones((2, 4)), 32, pinned=[2], banned=[0]).cover.views.tolist() == [2]
    never = robust(np.eye(3, dtype=bool), 0)
    assert (len(never.cover.views), never.robust_coverable_area, never.cover.coverable_area) == (0, 0.0, 3.0)
    assert "no sample can be measured" in never.sentence
    for effort in (0, 2_000_000):  # four views of each row: (13.5 / 33)^4 < 0.05 < (13.5 / 33)^3
        found = robust(np.repeat(np.eye(4, dtype=bool), 5, axis=1), 20, effort=effort)
        assert found.robust_area == 4.0
        assert found.cover.lower_bound <= 16 == len(found.cover.views)


def test_exact_poses_are_the_plain_cover() -> None:
    """A layer without ensemble gives exactly the cover of `solve`."""
    M = np.random.default_rng(3).random((40, 20)) < 0.2
    matrix = csr_array(M)
    layer = ProbabilityLayer(matrix.indptr, matrix.indices, np.zeros(matrix.nnz, dtype=int), 0)
    for coverage in (0.9, 1.0):
        problem = CoverProblem(matrix, np.ones(40), coverage=coverage)
        found = robust_cover(problem, layer, alpha=0.01, rng=np.random.default_rng(7))
        plain = solve(problem, rng=np.random.default_rng(7))
        np.testing.assert_array_equal(found.cover.views, plain.views)
        assert (found.cover.lower_bound, found.cover.status) == (plain.lower_bound, plain.status)
        assert (found.robust_area, found.robust_coverable_area) == (plain.covered_area, plain.coverable_area)


def test_loads_are_rounded_down_and_limited_to_the_demand() -> None:
    """No load is above its logarithm, and p = 1 - alpha gives the full demand."""
    M = csr_array(np.ones((1, 33), dtype=bool))
    layer = ProbabilityLayer(M.indptr, M.indices, np.arange(33), 32)
    integers = loads(layer, 0.05, (1, 33)).toarray()[0]
    exact = np.minimum(-np.log1p(-layer.probability) / -np.log(0.05), 1.0) * 2**16
    assert ((integers <= exact + 1e-6) & (integers >= exact - 1)).all()
    assert integers[0] == 0
    assert loads(layer, 1 - float(layer.probability[20]), (1, 33)).toarray()[0, 20] == 2**16


def test_a_start_that_is_not_usable_is_not_taken_for_regions() -> None:
    """A start with a banned view, with a view that is not allowed or without a pinned view is not used."""
    M = np.ones((4, 3), dtype=bool)
    M[:2, 1] = M[2:, 2] = False
    options: dict[str, Any]
    for options in ({"banned": [0]}, {"allowed": np.array([False, True, True])}, {"pinned": [1]}):
        problem = CoverProblem(M, np.ones(4), region=np.array([0, 0, 1, 1]), region_coverage=(0.9, 0.9), **options)
        cover = solve(problem, rng=np.random.default_rng(0), effort_budget=1, start=np.array([0]))
        assert sorted(cover.views.tolist()) == ([0, 1] if "pinned" in options else [1, 2])


def test_groups_without_columns_cover_nothing() -> None:
    """A problem without columns has an empty cover, whatever its groups cost."""
    problem = CoverProblem(np.zeros((3, 0), dtype=bool), np.ones(3), group=[], group_costs=[0.5])
    assert solve(problem, rng=np.random.default_rng(0)).status is CoverStatus.NOTHING_COVERABLE


# Refusals


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"areas": np.ones(3)}, r"must be \(2,\)"),
        *(({"areas": [1.0, bad]}, r"areas\[1\]") for bad in (np.nan, -1e-12, np.inf)),
        *(({"coverage": bad}, r"coverage is .* from 0 to 1") for bad in (1.0 + 2**-52, -1e-300, np.nan, np.inf)),
        ({"allowed": np.ones(3, dtype=bool)}, "allowed has shape"),
        ({"allowed": np.ones(2)}, "of bool"),
        ({"pinned": [2]}, "pinned names column 2"),
        ({"banned": [-1]}, "banned names column -1"),
        ({"pinned": [0], "banned": [0]}, "banned or not among"),
        ({"pinned": [0], "allowed": np.array([False, True])}, "banned or not among"),
        ({"demand": 0}, "at least once"),
        ({"demand": np.ones(3, dtype=int)}, "shape"),
        ({"demand": np.zeros(2, dtype=int)}, "at least once"),
        ({"matrix": -np.eye(2, dtype=np.int64)}, "load of the matrix is -1"),
        ({"costs": [1.0]}, r"must be \(2,\)"),
        *(({"costs": [1.0, bad]}, r"costs\[1\] is") for bad in (np.nan, 0.0, -2.0, np.inf)),
        ({"group": [0, 1], "group_costs": [1.0]}, "group from 0 to 0"),
        ({"group": [0, 0], "group_costs": [-1.0]}, "group_costs must be"),
        ({"max_views": -1}, "max_views is -1"),
        ({"max_views": 1, "pinned": [0, 1]}, "2 views are pinned"),
        ({"max_views": 1, "costs": [1.0, 2.0]}, "cannot be combined"),
        ({"region": [2, 2], "region_coverage": (0.5, 0.5)}, "from 0 to 1"),
        ({"region": [0, 0], "region_coverage": (1.5,)}, "from 0 to 1"),
        ({"region": [0, 0], "region_coverage": (0.5,), "max_views": 2}, "maximises the area"),
        ({"weights": -np.ones(2)}, "finite numbers"),
        ({"weights": np.ones(2), "overlap": Overlap(share=0.2)}, "cannot be combined"),
        ({"region": [0, 0], "region_coverage": (0.5,), "group": [0, 0], "group_costs": [1.0]}, "cannot be combined"),
        ({"solver": "gready"}, "choose one of"),
        ({"effort_budget": -1}, "budget is -1"),
    ],
)  # fmt: skip
def test_invalid_input_is_refused(options: dict[str, Any], words: str) -> None:
    """Each message names the value and the valid values."""
    of_solve = {key: options[key] for key in ("solver", "effort_budget") if key in options}
    fields = {"matrix": np.eye(2, dtype=bool), "areas": np.ones(2)} | options
    problem = CoverProblem(**{key: value for key, value in fields.items() if key not in of_solve})
    with pytest.raises(PlannerError, match=words):
        solve(problem, rng=np.random.default_rng(0), **of_solve)


@pytest.mark.parametrize(
    "options", [{}, {"area": 1.0, "share": 0.5}, {"area": 0.0}, {"area": np.inf}, {"share": 0.0}, {"share": 1.1}]
)
def test_invalid_overlaps_are_refused(options: dict[str, float]) -> None:
    """An overlap needs either a finite positive area or a share above 0 and up to 1."""
    with pytest.raises(PlannerError, match="overlap"):
        Overlap(**options)


@pytest.mark.parametrize("alpha", [0.0, 1.0, -0.1, 2.0, np.nan])
def test_invalid_confidences_are_refused(alpha: float) -> None:
    """Alpha must be above 0 and below 1."""
    with pytest.raises(PlannerError, match="alpha"):
        robust(np.eye(3, dtype=bool), 32, alpha=alpha)


@pytest.mark.parametrize("is_pinned", [False, True])
def test_an_expensive_forced_column_does_not_round_the_others(is_pinned: bool) -> None:
    """A forced column of 10^9 keeps its cost in the bound, and the others are compared to a thousandth."""
    matrix = np.array([[1, 0, 0, 0], [0, 1, 1, 0], [0, 0, 1, 1], [0, 1, 0, 1]], dtype=bool)
    matrix[0, 1:] = is_pinned  # without the pin, the first row needs the first column
    costs, pinned = np.array([1e9, 1.001, 1.002, 1.004]), [0] if is_pinned else []
    problem = CoverProblem(matrix, np.ones(4), costs=costs, pinned=pinned)
    found = solve(problem, rng=np.random.default_rng(0))
    assert sorted(found.views.tolist()) == [0, 1, 2]
    assert found.cost_bound == pytest.approx(1e9 + 2.003, abs=1e-3)
    assert found.lower_bound == 3


def test_a_forced_column_of_any_cost_is_priced_exactly() -> None:
    """The cost of a forced column is no int64 in units of the others, and is part of cost and bound all the same."""
    problem = CoverProblem(np.eye(2, dtype=bool), np.ones(2), costs=[1e20, 1.5], pinned=[0], coverage=0.4)
    found = solve(problem, rng=np.random.default_rng(0))
    assert (found.views.tolist(), found.status, found.cost_bound) == ([0], CoverStatus.PROVEN, 1e20)


@pytest.mark.parametrize("seed", range(4))
def test_costs_over_twelve_orders_of_magnitude(seed: int) -> None:
    """The cover costs no more than one that HiGHS finds from expensive to cheap columns: no cost is rounded away."""
    rng = np.random.default_rng(seed)
    matrix = rng.random((40, 60)) < 0.15
    costs = np.sort(10 ** rng.uniform(-6, 6, 60))
    matrix[~matrix.any(axis=1), 59] = True
    found = solve(CoverProblem(matrix, np.ones(40), costs=costs), rng=np.random.default_rng(0))
    cost = float(costs[found.views].sum())
    low, high = np.zeros(60), np.ones(60)
    for block in (costs > 1e2, (costs > 1e-2) & (costs <= 1e2), costs <= 1e-2):
        scaled = np.where(block, costs / costs[block].max(), 0.0)
        rows = LinearConstraint(matrix.astype(np.float64), lb=1)
        low[block] = high[block] = np.round(
            milp(scaled, constraints=[rows], bounds=Bounds(low, high), integrality=np.ones(60)).x[block]
        )
    assert cost <= float(costs @ low) * (1 + 1e-9)
