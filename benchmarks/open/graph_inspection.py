"""Tours and bounds for graph inspection planning: `python -m benchmarks.open.graph_inspection FOLDER [NAME ...]`.

A roadmap is a graph with lengths of edges; a vertex inspects points of interest. The shortest closed walk from vertex 0
that inspects all of them is NP-hard: it generalises set cover and the travelling salesman problem (Mizutani and others
2024, arXiv:2407.00251; Morgan, Solovey, Salzman 2026, arXiv:2603.16593). FOLDER holds files NAME_vertex and NAME_edge,
as in the folder `benchmarks` of the second paper's repository (MRSTechnion/ScalableInspectionPlanning); they are not
part of this project.

**Tour.** Only points whose vertices contain those of no other point matter. Each of them becomes a cluster with a copy
of each of its vertices, and distances are those of shortest paths: the generalised travelling salesman problem of the
planner. Copies of a vertex are at distance 0, so both problems have the same optimum. The search begins with a tour of
the fewest vertices that inspect all points.

**Bound.** A closed walk from the root that inspects a point crosses at least twice the border of every vertex set that
contains all vertices of the point and not the root:

    minimise  sum of w_e x_e   subject to   x(border of S) >= 2,  x >= 0

Sets come from minimum cuts, edges from reduced costs. The reported bound is the dual solution, repaired
to feasibility on all edges in this file's own arithmetic: no tolerance of the solver can invalidate it.
"""

import argparse
import sys
from itertools import pairwise
from pathlib import Path
from time import process_time
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import breadth_first_order, connected_components, dijkstra, maximum_flow

from benchmarks.open.check import Array
from planner.cover import CoverProblem, solve
from planner.tour import generalised_tsp

ROOT = 0
NEAREST = 6  # edges of a vertex in the first linear programme
UNIT = 1_000_000  # of a capacity, for the integer flows
VIOLATED = 1e-4
MOST_SETS = 200  # new vertex sets in a round
NESTED = 5  # cuts of a row in a round


class Roadmap(NamedTuple):
    """A roadmap: (E, 2) edges, (E,) weights, and (P, N) whether vertex j inspects point i."""

    edges: Array
    weights: Array
    inspects: Array


class Bound(NamedTuple):
    """A lower bound on the length of closed walks.

    Attributes:
        value: the bound.
        is_solved: whether the linear programme was solved to its end.
        sets: (k, N) its vertex sets.
        reduced: (E,) reduced costs, not negative: a walk with the edge is at least `value + reduced` long.
    """

    value: float
    is_solved: bool
    sets: Array
    reduced: Array


def read(folder: Path, name: str) -> Roadmap:
    """Read NAME_vertex (number, two fields, points) and NAME_edge (two numbers, ..., length)."""
    vertex_lines, edge_lines = (
        [line.split() for line in (folder / f"{name}_{kind}").read_text().splitlines() if line.strip()]
        for kind in ("vertex", "edge")
    )
    vertices = [[int(word) for word in line] for line in vertex_lines]
    points = {point: k for k, point in enumerate(sorted({point for line in vertices for point in line[3:]}))}
    inspects = np.zeros((len(points), 1 + max(line[0] for line in vertices)), dtype=bool)
    for vertex, _, _, *seen in vertices:
        inspects[[points[point] for point in seen], vertex] = True
    return Roadmap(
        np.array([line[:2] for line in edge_lines], int), np.array([float(line[-1]) for line in edge_lines]), inspects
    )


def needed(inspects: Array) -> Array:
    """Return the (P', N) rows that imply all: not inspected at the root, and containing no other row."""
    rows = np.unique(inspects[~inspects[:, ROOT]], axis=0)
    sizes = rows.sum(axis=1)
    shared = rows.astype(np.float32) @ rows.T.astype(np.float32)
    implied = (shared == sizes) & (sizes < sizes[:, None])
    return np.asarray(rows[~implied.any(axis=1)])


def walk(roadmap: Roadmap, rows: Array, steps: int, seed: int = 0) -> Array:
    """Return the vertices of a closed walk from the root that inspects all rows."""
    n = roadmap.inspects.shape[1]
    graph = coo_array((roadmap.weights, roadmap.edges.T), shape=(n, n)).tocsr()
    distance, before = dijkstra(graph, directed=False, return_predecessors=True)
    distance, rng = (distance + distance.T) / 2, np.random.default_rng(seed)
    cover = np.concatenate([[ROOT], solve(CoverProblem(rows, np.ones(len(rows))), rng=rng).views]).astype(int)
    problem = generalised_tsp.make_instance(distance[np.ix_(cover, cover)], np.arange(len(cover) + 1))
    visits = cover[generalised_tsp.solve(problem, np.arange(1, len(cover)), rng, steps, None).tour]
    order = 1 + np.argsort(rows[:, visits].argmax(axis=1), kind="stable")
    nodes = np.concatenate([[ROOT], *(np.flatnonzero(row) for row in rows)]).astype(int)
    first = np.concatenate([[0, 1], 1 + np.cumsum(rows.sum(axis=1))])
    problem = generalised_tsp.make_instance(distance[np.ix_(nodes, nodes)], first)
    found = generalised_tsp.solve(problem, order, rng, steps, None, warm=True)
    stops, path = [*nodes[found.tour], ROOT], [ROOT]
    for a, b in pairwise(stops):
        back = [b]
        while back[-1] != a:
            back.append(before[a, back[-1]])
        path += back[-2::-1]
    return np.array(path)


def judge(roadmap: Roadmap, path: Array) -> float:
    """Return the length of a walk.

    Raises:
        ValueError: if it does not begin and end at the root, uses an edge that does not exist, or misses a point.
    """
    length_of: dict[tuple[int, int], float] = {}
    for (a, b), weight in zip(roadmap.edges.tolist(), roadmap.weights.tolist(), strict=True):
        for pair in ((a, b), (b, a)):
            length_of[pair] = min(weight, length_of.get(pair, np.inf))
    steps = list(pairwise(path.tolist()))
    if path[0] != ROOT or path[-1] != ROOT or any(step not in length_of for step in steps):
        raise ValueError("the walk is not closed at the root, or has a step that is no edge")
    if not roadmap.inspects[:, np.unique(path)].any(axis=1).all():
        raise ValueError("the walk misses a point")
    return float(sum(length_of[step] for step in steps))


def lower_bound(roadmap: Roadmap, rows: Array, seconds: float) -> Bound:
    """Return the bound of the vertex sets; after some processor seconds the best one so far.

    Args:
        roadmap: the graph.
        rows: (P', N) of `needed`.
        seconds: processor time after which no round begins.
    """
    end, is_solved = process_time() + seconds, False
    programme = _Programme(roadmap, rows)
    best = 0.0, roadmap.weights
    while not is_solved and process_time() < end:
        x, y = programme.solve()
        best = max(best, programme.certified(y), key=lambda each: each[0])
        new = _violated_sets(roadmap, rows, x, programme.columns, len(programme.sets))
        programme.add_sets(new)
        is_solved = not programme.price(y) and not len(new)
    return Bound(best[0], is_solved, programme.sets, best[1])


class _Programme:
    """The linear programme over some edges and vertex sets, in HiGHS; weights in units of their mean."""

    def __init__(self, roadmap: Roadmap, rows: Array) -> None:
        import highspy

        self._u, self._v = roadmap.edges.T
        self._unit = float(roadmap.weights.mean())
        self._weights = roadmap.weights / self._unit
        self.sets = np.zeros((0, rows.shape[1]), dtype=bool)
        self._place = np.full(len(self._weights), -1)  # of each edge among the columns
        self.columns = np.zeros(0, dtype=int)
        self._highs: Any = highspy.Highs()  # type: ignore[no-untyped-call]
        self._highs.silent()
        self._highs.setOptionValue("threads", 1)
        for name, value in (("presolve", "off"), ("solver", "simplex"), ("simplex_strategy", 1)):
            self._highs.setOptionValue(name, value)
        ends, edges = np.concatenate([self._u, self._v]), np.tile(np.arange(len(self._u)), 2)
        order = np.lexsort([self._weights[edges], ends])
        begin = np.searchsorted(ends[order], np.arange(rows.shape[1]))
        rank = np.arange(len(order)) - begin[ends[order]]
        graph = coo_array((self._weights, (self._u, self._v)), shape=(rows.shape[1],) * 2).tocsr()
        before = dijkstra(graph, directed=False, indices=ROOT, return_predecessors=True)[1]
        in_tree = (before[self._u] == self._v) | (before[self._v] == self._u)  # with these it has a solution
        self._add_edges(np.union1d(edges[order[rank < NEAREST]], np.flatnonzero(in_tree)))
        self.add_sets(rows)

    def add_sets(self, sets: Array) -> None:
        """Add constraints for (k, N) vertex sets."""
        self.sets = np.concatenate([self.sets, sets])
        crossing = sets[:, self._u[self.columns]] != sets[:, self._v[self.columns]]
        start = np.concatenate([[0], np.cumsum(crossing.sum(axis=1))])
        index = np.nonzero(crossing)[1]
        self._highs.addRows(
            len(sets), np.full(len(sets), 2.0), np.full(len(sets), np.inf), len(index),
            start[:-1].astype(np.int32), index.astype(np.int32), np.ones(len(index)),
        )  # fmt: skip

    def _add_edges(self, edges: Array) -> None:
        crossing = self.sets[:, self._u[edges]] != self.sets[:, self._v[edges]]
        start = np.concatenate([[0], np.cumsum(crossing.sum(axis=0))])
        index = np.nonzero(crossing.T)[1]
        zero, none = np.zeros(len(edges)), np.full(len(edges), np.inf)
        self._highs.addCols(
            len(edges), self._weights[edges], zero, none, len(index), start[:-1].astype(np.int32),
            index.astype(np.int32), np.ones(len(index)),
        )  # fmt: skip
        self._place[edges] = len(self.columns) + np.arange(len(edges))
        self.columns = np.concatenate([self.columns, edges])

    def solve(self) -> tuple[Array, Array]:
        """Return (E,) values of the edges and (sets,) duals, not negative."""
        self._highs.run()
        solution, x = self._highs.getSolution(), np.zeros(len(self._weights))
        x[self.columns] = solution.col_value
        return x, np.maximum(np.array(solution.row_dual), 0.0)

    def _load(self, y: Array) -> Array:
        """Return the (E,) sum of the duals of the sets whose border an edge crosses."""
        used = np.flatnonzero(y)
        found = np.zeros(len(self._weights))
        for k in used:
            found[self.sets[k, self._u] != self.sets[k, self._v]] += y[k]
        return found

    def price(self, y: Array) -> bool:
        """Add the edges with negative reduced costs; return whether there were any."""
        missing = np.flatnonzero((self._weights - self._load(y) < -1e-7) & (self._place < 0))
        self._add_edges(missing)
        return len(missing) > 0

    def certified(self, y: Array) -> tuple[float, Array]:
        """Return value and (E,) reduced costs of the duals after a repair: no edge exceeds its weight."""
        y = y.copy()
        for edge in np.flatnonzero(self._load(y) > self._weights):
            across = np.flatnonzero((self.sets[:, self._u[edge]] != self.sets[:, self._v[edge]]) & (y > 0))
            excess = y[across].sum() - self._weights[edge]
            for k in across:
                taken = min(max(excess, 0.0), y[k])
                y[k] -= taken
                excess -= taken
        reduced = np.maximum(self._weights - self._load(y), 0.0)
        return float(2 * y.sum() * self._unit) * (1 - 1e-9), reduced * self._unit * (1 - 1e-9)


def _violated_sets(roadmap: Roadmap, rows: Array, x: Array, columns: Array, seed: int) -> Array:
    """Return (k, N) vertex sets whose border has a value below 2.

    They are unions of components that contain all vertices of a row, and minimum cuts between root and rows, as for
    Steiner trees (Koch and Martin 1998, doi:10.1002/(SICI)1097-0037(199810)32:3<207::AID-NET5>3.0.CO;2-O):
    with few edges, from both ends, and further cuts after the edges of one are filled up.
    """
    n = rows.shape[1]
    u, v = roadmap.edges[columns].T
    used = x[columns] > 1e-9
    graph = coo_array((np.ones(used.sum()), (u[used], v[used])), shape=(n, n)).tocsr()
    label = connected_components(graph, directed=False)[1]
    cut_off = label != label[ROOT]
    found = [np.isin(label, label[row]) for row in rows if cut_off[row].all()]
    within = list(found)
    if found:
        found = [*np.unique(found, axis=0), cut_off]
    filled = np.round(UNIT * np.minimum(x[columns], 2)).astype(np.int32) + 1
    for row in np.random.default_rng(seed).permutation(rows):
        if len(found) >= MOST_SETS:
            break
        if any(each[row].all() for each in within):
            continue
        ends, capacity = np.flatnonzero(row), filled.copy()
        arcs = np.concatenate([u, v, ends]), np.concatenate([v, u, np.full(len(ends), n)])
        for _ in range(NESTED):
            limits = np.concatenate([capacity, capacity, np.full(len(ends), 4 * UNIT, dtype=np.int32)])
            network = csr_array((limits, arcs), shape=(n + 1, n + 1))
            flow = maximum_flow(network, ROOT, n)
            if flow.flow_value > (2 - VIOLATED) * UNIT:
                break
            left = network - flow.flow
            left.eliminate_zeros()
            for residual, start in ((left, ROOT), (left.T.tocsr(), n)):
                reached = np.zeros(n + 1, dtype=bool)
                reached[breadth_first_order(residual, start, return_predecessors=False)] = True
                found.append(reached[:n] if start == n else ~reached[:n])
                within += [found[-1]] if start == n else []
                capacity[found[-1][u] != found[-1][v]] = 2 * UNIT
    return np.unique(found, axis=0) if found else np.zeros((0, n), dtype=bool)


def main() -> None:
    """Print a table of tours and bounds."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("name", nargs="*")
    parser.add_argument("--steps", type=int, default=5000, help="of the tour, up to 22 clusters; more for larger ones")
    parser.add_argument("--seconds", type=float, default=120, help="processor time of the bound")
    options = parser.parse_args()
    suffix = "_vertex"
    names = options.name or sorted(path.name.removesuffix(suffix) for path in options.folder.glob(f"*{suffix}"))
    sys.stdout.write(
        "| graph | vertices | points | needed | tour | bound | gap | tour s | bound s |\n" + "|---" * 9 + "|\n"
    )
    for name in names:
        roadmap = read(options.folder, name)
        rows, since = needed(roadmap.inspects), process_time()
        length, tour_s = judge(roadmap, walk(roadmap, rows, options.steps)), process_time() - since
        found = lower_bound(roadmap, rows, options.seconds)
        bound, bound_s = (
            found.value,
            f"{process_time() - since - tour_s:.0f}{'' if found.is_solved else ', not finished'}",
        )
        n_points, n = roadmap.inspects.shape
        numbers = f"{length:.5g} | {bound:.5g} | {100 * (length / bound - 1):.1f} % | {tour_s:.0f} | {bound_s}"
        sys.stdout.write(f"| {name} | {n} | {n_points} | {len(rows)} | {numbers} |\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
