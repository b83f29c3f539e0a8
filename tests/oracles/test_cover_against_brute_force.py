"""Covers, bounds and curves against all selections of small problems."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_array

from planner.cover import SOLVERS, CoverProblem, CoverStatus, Overlap, solve
from planner.cover.bounds import Relaxation
from planner.cover.budget import Budget
from planner.cover.curve import coverage_curve
from planner.cover.overlap import overlap_graph
from planner.cover.problem import overlap_adjacency
from planner.cover.reductions import canonical_form, reduce
from planner.cover.robust import min_views_at_confidence, robust_cover
from planner.cover.solvers import solve_instance
from planner.cover.tree import counts_columns, search_by_number
from planner.measurability.pose_ensemble import ProbabilityLayer, credited_probability
from tests.support.cover_oracle import Selections, assert_bounded, assert_consistent, cover_problems


def subsets(columns: np.ndarray) -> list[np.ndarray]:
    """Return all subsets of some columns."""
    return [columns[(k >> np.arange(len(columns))) & 1 > 0] for k in range(2 ** len(columns))]


def reaches_optimum(problem: CoverProblem) -> bool:
    """Return whether `auto` and `exact` must prove the optimum."""
    several_targets = sum(share < 1 for share in problem.region_coverage) > 1
    hard_area = problem.max_views is not None and np.max(problem.demand, initial=1) > 1
    return problem.overlap is None and not several_targets and not hard_area


@settings(max_examples=300)
@given(
    problem=cover_problems(),
    solver=st.sampled_from(sorted(SOLVERS)),
    effort=st.sampled_from([0, 200_000, 20_000_000, 20_000_000]),
    seed=st.integers(0, 9),
)
def test_no_selection_is_better_than_a_bound_and_no_cover_is_better_than_the_best(
    problem: CoverProblem, solver: str, effort: int, seed: int
) -> None:
    """The bounds hold for every problem, solver and budget. `auto` and `exact` prove the optimum with enough effort."""
    effort = min(effort, 1_000_000) if solver == "meta-raps" else effort
    cover = solve(problem, rng=np.random.default_rng(seed), solver=solver, effort_budget=effort)
    assert_consistent(problem, cover)
    is_optimal = solver in ("auto", "exact") and effort > 10**6 and reaches_optimum(problem)
    if is_optimal and cover.status != CoverStatus.PROVEN:  # a linear programme is charged 500,000: with costs 40 nodes
        cover = solve(problem, rng=np.random.default_rng(seed), solver=solver, effort_budget=100 * effort)
    assert_bounded(Selections(problem), cover, is_optimal=is_optimal)


@settings(max_examples=50)
@given(problem=cover_problems(("overlap",), max_rows=16, max_columns=9), seed=st.integers(0, 9))
def test_the_search_finds_the_fewest_connected_views(problem: CoverProblem, seed: int) -> None:
    """The cover has the fewest connected views, or no selection is connected. The graph has the summed areas."""
    problem = replace(problem, costs=None)
    cover = solve(problem, rng=np.random.default_rng(seed), effort_budget=1_000_000)
    graph, selections = overlap_graph(problem, cover), Selections(problem)
    own = Selections(problem, [cover.views.tolist()])
    least = selections.least(selections.size)
    assert graph.is_connected == own.is_connected[0] == (least is not None)
    assert len(set(graph.component.tolist())) == len(graph.component_area)
    assert (np.diff(graph.component_area) <= 0).all()
    for number, area in enumerate(graph.component_area):
        members = Selections(replace(problem, pinned=()), [cover.views[graph.component == number].tolist()])
        assert members.area[0] == pytest.approx(area)
        assert members.is_connected[0]
    if least is not None:
        assert len(cover.views) == least
    free = Selections(replace(problem, overlap=None))
    if own.coverable.any():
        assert cover.n_views_without_overlap == free.least(free.size)


@settings(max_examples=40)
@given(cover_problems(("area",)), st.sampled_from([0, 200_000, 20_000_000]), st.integers(0, 9), st.booleans())
def test_the_curve_lies_between_a_selection_and_the_bound(
    problem: CoverProblem, effort: int, seed: int, with_known: bool
) -> None:
    """At every number of views: area of the selection <= largest area <= bound."""
    problem = replace(problem, demand=1, max_views=None, weights=None, matrix=np.asarray(problem.matrix) > 0)
    full = Selections(problem)
    known = solve(problem, rng=np.random.default_rng(0), effort_budget=10**6)
    curve = coverage_curve(
        problem,
        rng=np.random.default_rng(seed),
        effort_budget=effort,
        known_selections=[known.views] if with_known else (),
        min_views_full_coverage=known.lower_bound if with_known else 0,
    )
    scale = curve.coverable_area * 1e-9
    best = []
    for views, k, area, upper in zip(curve.views, curve.n_views, curve.covered_area, curve.upper_area, strict=True):
        own = Selections(problem, [views.tolist()])
        assert len(views) == k
        assert set(problem.pinned) <= set(views.tolist())
        assert own.area[0] == pytest.approx(area)
        most = Selections(replace(problem, max_views=int(k)))
        best.append(-(most.least(-most.area) or 0.0))
        assert area - scale <= best[-1] <= upper + scale
    assert (np.diff(curve.covered_area) >= 0).all()
    assert (np.diff(curve.upper_area) >= 0).all()
    if effort > 10**6:
        np.testing.assert_allclose(curve.covered_area, best, atol=scale)
    if effort or with_known:
        assert curve.covered_area[-1] == pytest.approx(curve.coverable_area)
    for coverage in (0.0, 0.5, 0.9, 1.0):
        pinned = full.selected[:, np.isin(full.usable, list(problem.pinned))].all(axis=1)
        enough = (full.area >= coverage * curve.coverable_area - scale) & pinned
        fewest = full.size[enough].min()
        found, possible = curve.fewest_views(coverage)
        assert found is None or found >= fewest
        assert possible is None or possible <= fewest


@given(cover_problems(("cost", "area", "regions"), max_rows=25, max_columns=12), st.integers(0, 9))
def test_a_start_that_meets_the_target_is_not_lost(problem: CoverProblem, seed: int) -> None:
    """Without effort the cover is no worse than the start, and its bounds hold."""
    rng = np.random.default_rng(seed)
    start = solve(problem, rng=rng, effort_budget=2_000_000).views
    cover = solve(problem, rng=rng, effort_budget=1, start=start)
    assert_consistent(problem, cover)
    before = Selections(problem, [start.tolist()])
    if problem.max_views is None:
        assert cover.cost <= before.cost[0] * (1 + 1e-9)
    else:
        assert cover.covered_area >= before.area[0] * (1 - 1e-6)
    assert_bounded(Selections(problem), cover, is_optimal=False)
    every = np.arange(np.shape(problem.matrix)[1])
    assert_consistent(problem, solve(problem, rng=rng, effort_budget=1, start=every))


@settings(max_examples=40)
@given(cover_problems(("cost", "area")), st.data())
def test_any_multipliers_give_a_bound(problem: CoverProblem, data: st.DataObject) -> None:
    """L(u) is at most the objective of each selection, for arbitrary u; fixed columns exclude no better one."""
    form = canonical_form(problem)
    instance = form.reduced
    if instance.needs_no_column:
        return
    relaxation = Relaxation(instance)
    size = len(relaxation.row_of)
    relaxation.evaluate(np.array(data.draw(st.lists(st.floats(0, 3), min_size=size, max_size=size))))
    feasible = [some for some in subsets(np.arange(instance.n_columns)) if instance.is_feasible(some)]
    objectives = np.array([instance.objective(some) for some in feasible])
    assert relaxation.bound <= objectives.min() + instance.tolerance
    useful = relaxation.useful_columns(limit := int(np.median(objectives)))
    for some, objective in zip(feasible, objectives, strict=True):
        assert instance.maximises_area or objective > limit or useful[some].all()


@settings(max_examples=40)
@given(cover_problems(("cost",)))
def test_reductions_keep_the_optimum(problem: CoverProblem) -> None:
    """The cheapest cover of the reduced problem, lifted, is a cheapest cover of the original."""
    instance = canonical_form(problem).residual
    reduction = reduce(instance, Budget(10**9))
    rest = reduction.instance
    inner, bound, _ = solve_instance(rest, "exact", np.random.default_rng(0), Budget(10**9))
    lifted = reduction.lift(inner)
    assert instance.is_feasible(lifted)
    feasible = [some for some in subsets(np.arange(instance.n_columns)) if instance.is_feasible(some)]
    assert instance.cost(lifted) == min(instance.cost(some) for some in feasible)
    assert bound == rest.cost(inner)


@settings(max_examples=40)
@given(cover_problems(("cost", "area"), max_rows=25, max_columns=12), st.integers(0, 99))
def test_the_tree_answers_each_number_of_views(problem: CoverProblem, seed: int) -> None:
    """At each objective the tree returns a selection or proves that none exists, for random rows and columns."""
    problem = replace(problem, matrix=np.asarray(problem.matrix) > 0, demand=1, costs=None, group=None, weights=None)
    instance = canonical_form(replace(problem, group_costs=None)).residual
    rng = np.random.default_rng(seed)
    columns = rng.random(instance.n_columns) < 0.8
    left = np.flatnonzero(columns)
    if instance.needs_no_column or not len(left):
        return
    assert counts_columns(instance)
    objectives = [instance.objective(some) for some in subsets(left) if instance.is_feasible(some)]
    least = min(objectives, default=None)
    targets = sorted(set(objectives))[:3] if instance.maximises_area else range(len(left) + 1)
    for target in targets:
        budget = Budget(10**9)
        found, is_complete = search_by_number(instance, rng.random(instance.n_rows) < 0.7, columns, target, budget)
        best = budget.incumbent if found is None else found  # for maximum coverage the budget receives selections
        assert best is None or (instance.is_feasible(best) and instance.objective(best) <= target)
        assert best is not None or (is_complete and (least is None or target < least))


def ensembles(seed: int, members: int = 32) -> tuple[csr_array, ProbabilityLayer, np.ndarray]:
    """Return a random matrix with hits of its entries, and areas."""
    rng = np.random.default_rng(seed)
    M = csr_array(rng.random((int(rng.integers(1, 12)), int(rng.integers(2, 10)))) < 0.5)
    hits = np.where(rng.random(M.nnz) < 0.4, members, rng.integers(0, members + 1, M.nnz))
    return M, ProbabilityLayer(M.indptr, M.indices, hits, members), rng.integers(1, 4, M.shape[0]).astype(float)


@settings(max_examples=40)
@given(
    st.integers(0, 10**6), st.sampled_from([0.2, 0.05, 0.001]), st.sampled_from([0.7, 1.0]), st.integers(0, 1),
    st.sampled_from([0, 20_000_000, 20_000_000]),
)  # fmt: skip
def test_the_fewest_views_at_a_confidence_are_found(
    seed: int, alpha: float, coverage: float, n_pinned: int, effort: int
) -> None:
    """The cover agrees with the products of the probabilities that each view misses a sample, at any budget."""
    M, layer, areas = ensembles(seed)
    n_columns = M.shape[1]
    p = np.zeros(M.shape)
    p[np.repeat(np.arange(M.shape[0]), np.diff(M.indptr)), M.indices] = credited_probability(layer.hits, layer.members)
    selected = (np.arange(2**n_columns)[:, None] >> np.arange(n_columns)) & 1 > 0
    missed = np.array([np.prod(1.0 - p[:, some], axis=1) for some in selected])
    robust = missed <= alpha * (1 + 1e-9)
    possible = areas[robust[-1]].sum()
    pinned = [seed % n_columns][:n_pinned]
    feasible = (robust @ areas >= coverage * possible - 1e-9) & selected[:, pinned].all(axis=1)
    fewest = selected.sum(axis=1)[feasible].min()
    problem = CoverProblem(M, areas, coverage=coverage, pinned=pinned)
    found = robust_cover(problem, layer, alpha=alpha, rng=np.random.default_rng(0), effort_budget=effort)
    own = int((1 << found.cover.views).sum())
    assert set(pinned) <= set(found.cover.views.tolist())
    assert found.cover.lower_bound <= fewest <= len(found.cover.views)
    assert not effort or fewest == len(found.cover.views)
    assert areas[robust[own]].sum() >= coverage * possible - 1e-9
    assert areas[robust[own]].sum() == pytest.approx(found.robust_area)
    assert found.robust_coverable_area == pytest.approx(possible)
    np.testing.assert_allclose(1 - found.probability, missed[own], atol=1e-12)
    assert min_views_at_confidence(alpha, 32) == next(k for k in range(1, 9) if (0.5 / 33) ** k <= alpha)


def test_the_overlap_graph_is_inclusive_and_without_loops() -> None:
    """Views that share exactly the area or the share are adjacent, also if the area is a sum of rounded numbers."""
    M = np.zeros((12, 3), dtype=bool)
    M[:7, 0] = M[4:, 1] = True
    areas = np.full(12, 0.1)
    for overlap in (Overlap(area=0.1 + 0.1 + 0.1), Overlap(share=3 / 7)):
        assert overlap_adjacency(M, areas, overlap).tolist() == [[0, 1, 0], [1, 0, 0], [0, 0, 0]]
    assert not overlap_adjacency(M, areas, Overlap(area=0.3001)).any()
