"""Covers that hang together, against trying all selections; connectedness is judged by networkx."""

from itertools import combinations

import networkx as nx
import numpy as np
import pytest

from planner.cover import CoverProblem, Overlap, solve
from planner.cover.overlap import overlap_graph


def hangs_together(M, areas, views, overlap):
    """Whether the graph of views is connected, by networkx and plain sums of areas."""
    graph = nx.Graph()
    graph.add_nodes_from(views)
    for a, b in combinations(views, 2):
        shared = areas[M[:, a] & M[:, b]].sum()
        least = overlap.area
        if least is None:
            least = overlap.share * min(areas[M[:, a]].sum(), areas[M[:, b]].sum())
        if shared > 0 and shared >= least - 1e-9:
            graph.add_edge(a, b)
    return len(views) == 0 or nx.is_connected(graph)


def fewest(M, areas, coverage, overlap, pinned=()):
    """Fewest views that cover and hang together by trying all subsets; None where there are none."""
    useful = np.flatnonzero(M.any(axis=0))
    coverable = M.any(axis=1)
    for size in range(len(useful) + 1):
        for subset in combinations(useful.tolist(), size):
            covered = M[:, list(subset)].any(axis=1)
            enough = (
                (covered == coverable).all()
                if coverage == 1.0
                else areas[covered].sum() >= coverage * areas[coverable].sum() - 1e-9
            )
            if enough and set(pinned) <= set(subset) and hangs_together(M, areas, subset, overlap):
                return size
    return None


def small(seed):
    """A strip of overlapping windows with some scattered columns: graphs of every kind."""
    rng = np.random.default_rng(seed)
    n_rows = int(rng.integers(6, 18))
    columns = []
    for _ in range(int(rng.integers(3, 10))):
        start, width = rng.integers(0, n_rows), rng.integers(2, max(3, n_rows // 2))
        column = np.zeros(n_rows, dtype=bool)
        column[start : start + width] = True
        columns.append(column)
    return np.stack(columns, axis=1), rng.integers(1, 4, n_rows).astype(float)


@pytest.mark.parametrize("coverage", [0.8, 1.0])
@pytest.mark.parametrize("overlap", [Overlap(area=2.0), Overlap(share=0.4)], ids=["area", "share"])
def test_the_fewest_that_hang_together_are_found(coverage, overlap):
    """On 40 small instances: the search finds the optimum, its bound is below, and what cannot be is said."""
    feasible = priced = impossible = 0
    for seed in range(40):
        M, areas = small(seed)
        best = fewest(M, areas, coverage, overlap)
        problem = CoverProblem(M, areas, overlap=overlap, coverage=coverage)
        found = solve(problem, rng=np.random.default_rng(0), effort_budget=3_000_000)
        how, views = overlap_graph(problem, found), found.views.tolist()
        covered, coverable = M[:, views].any(axis=1), M.any(axis=1)
        assert areas[covered].sum() >= coverage * areas[coverable].sum() - 1e-9
        if best is None:
            impossible += 1
            assert not how.is_connected, seed
            assert not hangs_together(M, areas, views, overlap)
            assert len(set(how.component.tolist())) == len(how.component_area) > 1
            continue
        feasible += 1
        assert how.is_connected
        assert hangs_together(M, areas, views, overlap), seed
        assert found.lower_bound <= best == len(views), seed
        priced += len(views) > found.n_views_without_overlap
        unconnected = solve(CoverProblem(M, areas, coverage=coverage), rng=np.random.default_rng(0))
        assert found.n_views_without_overlap == len(unconnected.views)
    assert min(feasible, priced, impossible) > 1  # the instances ask everything


def test_pinned_views_stay_and_hang_together():
    """With pinned views the optimum is that of the selections that contain them."""
    asked = 0
    for seed in range(40):
        M, areas = small(seed)
        pinned = [int(np.random.default_rng(seed).integers(M.shape[1]))]
        overlap = Overlap(area=2.0)
        best = fewest(M, areas, 1.0, overlap, pinned)
        found = solve(
            CoverProblem(M, areas, overlap=overlap, pinned=pinned),
            rng=np.random.default_rng(0),
            effort_budget=2_000_000,
        )
        assert set(pinned) <= set(found.views.tolist())
        if best is not None:
            asked += 1
            assert len(found.views) == best, seed
            assert hangs_together(M, areas, found.views.tolist(), overlap)
    assert asked > 2


def test_a_view_is_exchanged_where_adding_alone_would_cost_more():
    """Two far views cover all; joined by a chain they need three more. Two others cover as much and touch."""
    M = np.zeros((12, 7), dtype=bool)
    M[:6, 0] = M[6:, 1] = True  # the two that a plain cover may take, which share nothing
    M[:7, 2] = M[6:, 3] = True  # the two that touch in row 6
    M[3:5, 4] = M[4:8, 5] = M[7:9, 6] = True  # a chain
    areas = np.ones(12)
    found = solve(CoverProblem(M, areas, overlap=Overlap(area=1.0)), rng=np.random.default_rng(0))
    assert len(found.views) == 2
    assert found.n_views_without_overlap == 2
    assert hangs_together(M, areas, found.views.tolist(), Overlap(area=1.0))
