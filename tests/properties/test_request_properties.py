"""Requests of any shape: what must hold for the answers to all of them."""

import networkx as nx
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.sparse import csr_array

from planner.cover import CoverProblem, Overlap, solve
from planner.cover.curve import coverage_curve
from planner.cover.overlap import overlap_graph
from planner.cover.problem import overlap_adjacency
from planner.cover.robust import DEMAND, loads, robust_cover
from planner.measurability.pose_ensemble import ProbabilityLayer

WORK = 300_000
matrices = hnp.arrays(bool, st.tuples(st.integers(0, 12), st.integers(0, 9)))


@st.composite
def problems(draw):
    """A matrix and areas."""
    M = draw(matrices)
    return M, draw(hnp.arrays(float, M.shape[0], elements=st.floats(0.0, 1e6)))


@given(problems(), st.integers(0, 10), st.integers(0, 3))
def test_no_answer_exceeds_its_bound_or_its_number(problem, k, seed):
    """At most k views, none twice; the area is theirs; no selection of the curve exceeds the bound."""
    M, areas = problem
    found = solve(CoverProblem(M, areas, max_views=k), rng=np.random.default_rng(seed), effort_budget=WORK)
    views = found.views
    assert len(views) <= k
    assert len(set(views.tolist())) == len(views)
    np.testing.assert_allclose(found.covered_area, areas[M[:, views].any(axis=1)].sum(), rtol=1e-9)
    assert found.upper_area >= found.covered_area
    curve = coverage_curve(
        CoverProblem(M, areas), rng=np.random.default_rng(seed), known_selections=[views], effort_budget=WORK
    )
    assert (np.diff(curve.covered_area) >= -1e-9 * max(curve.coverable_area, 1.0)).all()
    assert (np.diff(curve.upper_area) >= -1e-9 * max(curve.coverable_area, 1.0)).all()
    if len(views) < len(curve.views):
        assert curve.upper_area[len(views)] >= found.covered_area * (1 - 1e-9)
        assert found.upper_area * (1 + 1e-6) + 1e-12 >= curve.covered_area[len(views)] or len(views) < k


@given(problems(), st.floats(0.05, 1.0), st.sampled_from([0.5, 1.0]), st.integers(0, 3))
def test_what_is_called_connected_is(problem, share, coverage, seed):
    """By networkx; the cover covers in either case; the parts are those of the graph."""
    M, areas = problem
    asked = CoverProblem(M, areas, overlap=Overlap(share=share), coverage=coverage)
    found = solve(asked, rng=np.random.default_rng(seed), effort_budget=WORK)
    how, views = overlap_graph(asked, found), found.views.tolist()
    covered, coverable = M[:, views].any(axis=1), M.any(axis=1)
    if coverage == 1.0:
        assert (covered == coverable).all()
    else:
        assert areas[covered].sum() >= coverage * areas[coverable].sum() * (1 - 1e-9)
    adjacent = overlap_adjacency(M, areas, Overlap(share=share))
    graph = nx.from_numpy_array(adjacent[np.ix_(views, views)])
    parts = nx.number_connected_components(graph)
    assert parts == len(how.component_area) == len(set(how.component.tolist()))
    assert how.is_connected == (parts <= 1)
    assert found.lower_bound <= len(views)


@given(matrices, st.data(), st.floats(0.001, 0.5), st.integers(0, 3))
def test_every_promise_is_kept_by_the_layer(M, data, alpha, seed):
    """What counts as promised is missed with alpha at most; all that can be promised is."""
    matrix = csr_array(M)
    hits = np.array(data.draw(st.lists(st.integers(0, 8), min_size=matrix.nnz, max_size=matrix.nnz)), dtype=int)
    layer = ProbabilityLayer(matrix.indptr, matrix.indices, hits, 8)
    areas = np.ones(len(M))
    found = robust_cover(
        CoverProblem(matrix, areas), layer, alpha=alpha, rng=np.random.default_rng(seed), effort_budget=WORK
    )
    brought = loads(layer, alpha, M.shape).toarray()
    promised = brought[:, found.cover.views].sum(axis=1) >= DEMAND
    assert promised.sum() == found.robust_area == found.robust_coverable_area
    assert (promised == (brought.sum(axis=1) >= DEMAND)).all()
    assert (1 - found.probability[promised] <= alpha * (1 + 1e-9)).all()
    assert found.cover.lower_bound <= len(found.cover.views)
