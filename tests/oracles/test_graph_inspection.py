"""Graph inspection planning against brute force on graphs written by the tests."""

import heapq

import numpy as np
import pytest

from benchmarks.open import graph_inspection


def _written(folder, edges, weights, inspects):
    """Write the two files of a roadmap, with point numbers from 100."""
    lines = [f"{a} {b} 1 1 0 0 {w} \n" for (a, b), w in zip(edges, weights, strict=True)]
    (folder / "tiny_edge").write_text("".join(lines))
    lines = [
        f"{v} 0 1 {' '.join(str(100 + p) for p in np.flatnonzero(inspects[:, v]))}\n" for v in range(inspects.shape[1])
    ]
    (folder / "tiny_vertex").write_text("".join(lines))


def _shortest(edges, weights, inspects, through=-1):
    """Return the length of the shortest closed walk from vertex 0 that inspects all, over states (vertex, points).

    With `through` it is the shortest one that uses this edge: its use counts as one more point.
    """
    n_points, n = inspects.shape
    n_points += through >= 0
    masks = [sum(1 << int(p) for p in np.flatnonzero(inspects[:, v])) for v in range(n)]
    near = {v: [] for v in range(n)}
    for number, ((a, b), w) in enumerate(zip(edges, weights, strict=True)):
        used = 1 << (n_points - 1) if number == through else 0
        near[a].append((b, w, used))
        near[b].append((a, w, used))
    queue, closed = [(0.0, 0, masks[0])], set()
    while queue:
        length, v, seen = heapq.heappop(queue)
        if (v, seen) in closed:
            continue
        closed.add((v, seen))
        if v == 0 and seen == (1 << n_points) - 1:
            return length
        for to, w, used in near[v]:
            heapq.heappush(queue, (length + w, to, seen | masks[to] | used))
    raise AssertionError("not connected")


def _random(rng, n=9, n_points=8):
    tree = [(int(rng.integers(v)), v) for v in range(1, n)]
    more = [(a, b) for a in range(n) for b in range(a + 1, n) if (a, b) not in tree and rng.random() < 0.3]
    inspects = rng.random((n_points, n)) < 0.25
    inspects[np.arange(n_points), rng.integers(1, n, n_points)] = True
    return tree + more, rng.uniform(0.5, 3.0, len(tree) + len(more)).round(3), inspects


@pytest.mark.parametrize("seed", range(8))
def test_walk_and_bound_enclose_the_optimum(seed, tmp_path):
    """The walk of a small graph is the shortest one of all; the bound is below it, and not far."""
    edges, weights, inspects = _random(np.random.default_rng(seed))
    _written(tmp_path, edges, weights, inspects)
    roadmap = graph_inspection.read(tmp_path, "tiny")
    np.testing.assert_array_equal(roadmap.inspects, inspects)
    rows = graph_inspection.needed(roadmap.inspects)
    optimum = _shortest(edges, weights, inspects)
    assert graph_inspection.judge(roadmap, graph_inspection.walk(roadmap, rows, 100)) == pytest.approx(optimum)
    found = graph_inspection.lower_bound(roadmap, rows, 20.0)
    assert found.is_solved
    assert 0.6 * optimum < found.value <= optimum
    for number in range(len(edges)):
        assert found.value + found.reduced[number] <= _shortest(edges, weights, inspects, through=number) + 1e-9


def test_bound_of_a_tree_is_exact():
    """If each leaf of a tree has its own point, the best walk and the bound are twice the length of the tree."""
    rng = np.random.default_rng(3)
    edges = np.array([(int(rng.integers(v)), v) for v in range(1, 30)])
    weights = rng.uniform(0.1, 1.0, len(edges))
    leaves = np.setdiff1d(np.arange(1, 30), edges[:, 0])
    roadmap = graph_inspection.Roadmap(edges, weights, leaves[:, None] == np.arange(30))
    rows = graph_inspection.needed(roadmap.inspects)
    found = graph_inspection.lower_bound(roadmap, rows, 20.0)
    assert found.is_solved
    assert found.value == pytest.approx(2 * weights.sum(), rel=1e-6)
    assert found.value <= 2 * weights.sum()


def test_certified_value_holds_for_any_duals():
    """Random duals, far from feasible, are repaired to a value below the optimum."""
    rng = np.random.default_rng(5)
    edges, weights, inspects = _random(rng)
    roadmap = graph_inspection.Roadmap(np.array(edges), weights, inspects)
    rows = graph_inspection.needed(inspects)
    programme = graph_inspection._Programme(roadmap, rows)
    optimum = _shortest(edges, weights, inspects)
    values = [programme.certified(rng.exponential(2.0, len(programme.sets)))[0] for _ in range(50)]
    assert max(values) <= optimum
    assert min(values) > 0


@pytest.mark.parametrize(("path", "rule"), [([0, 1, 0], "misses"), ([0, 2, 0], "no edge"), ([1, 2, 1], "not closed")])
def test_wrong_walks_are_refused(path, rule):
    """A walk needs the root, edges of the graph, and all points."""
    inspects = np.array([[False, False, True]])
    roadmap = graph_inspection.Roadmap(np.array([[0, 1], [1, 2]]), np.ones(2), inspects)
    with pytest.raises(ValueError, match=rule):
        graph_inspection.judge(roadmap, np.array(path))
    assert graph_inspection.judge(roadmap, np.array([0, 1, 2, 1, 0])) == 4
