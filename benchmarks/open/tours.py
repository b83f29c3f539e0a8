"""Tours of tier C: `python -m benchmarks.open.tours` writes entries of two methods, and bounds to best/proofs.json.

Bounds are those of `planner.tour`, or of the vertex sets of `benchmarks.open.graph_inspection`: a tour visits the nodes
of each view. Reduced costs then exclude most moves; with the others HiGHS solves the integer programme (Fischetti,
Salazar, Toth 1997, doi:10.1287/opre.45.3.378).
"""

import json
import sys
from time import perf_counter, process_time
from typing import Any

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, depth_first_order

from benchmarks.open import check
from benchmarks.open.baselines import DATE, METHODS, store
from benchmarks.open.best import EXACT, PROOFS
from benchmarks.open.check import Array, Instance
from benchmarks.open.graph_inspection import Roadmap, lower_bound
from benchmarks.open.tools import HERE, write_json
from planner.tour import generalised_tsp

STEPS, BOUND_EFFORT = 40_000, 4_000_000_000
SETS_S, MILP_S = 120.0, 60.0


def time_matrix(instance: Instance) -> Array:
    """Return (1 + N, 1 + N) seconds between home and nodes."""
    q = np.concatenate([np.asarray(instance.data["home"])[None], instance.arrays["configurations"]])
    speed, acceleration_s = instance.arm.speed, instance.data["acceleration_s"]
    return np.array([check.move_times(a, q, speed, acceleration_s) for a in q])


def nearest_neighbour(cost: Array, group: Array) -> Array:
    """Return nodes in visiting order: always the nearest node of a group that was not visited."""
    tour, is_open = [0], np.ones(len(cost), dtype=bool)
    is_open[0] = False
    while is_open.any():
        tour.append(int(np.argmin(np.where(is_open, cost[tour[-1]], np.inf))))
        is_open[1:] &= group != group[tour[-1] - 1]
    return np.array(tour[1:]) - 1


def prove(cost: Array, group: Array, known: float) -> tuple[float, str, Array | None]:
    """Return a lower bound on all tours, its method, and the nodes of a tour that is optimal, if it was found.

    Args:
        cost: (1 + N, 1 + N) symmetric seconds between home and nodes.
        group: (N,) group of each node.
        known: seconds of a known tour.
    """
    n, views = len(cost), np.concatenate([[-1], group])
    pairs = np.stack(np.triu_indices(n, 1), axis=1)
    pairs = pairs[views[pairs[:, 0]] != views[pairs[:, 1]]]
    rows = views == np.arange(group.max() + 1)[:, None]
    roadmap = Roadmap(pairs, cost[tuple(pairs.T)], rows)
    found = lower_bound(roadmap, rows, SETS_S)
    pairs = pairs[found.value + found.reduced <= known * (1 + 1e-9)]
    weights, n_pairs = cost[tuple(pairs.T)], len(pairs)
    meets = (pairs[:, :1] == np.arange(n)) | (pairs[:, 1:] == np.arange(n))  # (pairs, N)
    visits = np.zeros((len(rows) + 1, n))
    visits[np.arange(len(rows) + 1), :] = np.concatenate([rows, (np.arange(n) == 0)[None]])
    crossing = found.sets[:, pairs[:, 0]] != found.sets[:, pairs[:, 1]]
    constraints = [
        LinearConstraint(csr_array(np.hstack([meets.T, -2.0 * np.eye(n)])), 0, 0),
        LinearConstraint(csr_array(np.hstack([np.zeros((len(visits), n_pairs)), visits])), 1, 1),
        LinearConstraint(csr_array(np.hstack([crossing, np.zeros((len(crossing), n))])), 2, np.inf),
    ]
    end, bound = perf_counter() + MILP_S, found.value
    while (left := end - perf_counter()) > 0:
        result = milp(
            np.concatenate([weights, np.zeros(n)]), integrality=np.ones(n_pairs + n), bounds=Bounds(0, 1),
            constraints=constraints, options={"time_limit": left, "mip_rel_gap": 1e-9},
        )  # fmt: skip
        bound = max(bound, float(result.mip_dual_bound or 0.0) * (1 - 1e-9))
        if result.x is None or result.status != 0:
            break
        chosen = pairs[result.x[:n_pairs] > 0.5]
        graph = csr_array((np.ones(len(chosen)), tuple(chosen.T)), shape=(n, n))
        label = connected_components(graph, directed=False)[1]
        apart = np.setdiff1d(label[chosen[:, 0]], label[0])
        if not len(apart):
            tour = depth_first_order(graph, 0, directed=False, return_predecessors=False)
            return bound, "vertex sets, then HiGHS", tour[1:] - 1
        more = []
        for inside in (label == each for each in apart):  # a border is crossed twice if any node inside is visited
            across = inside[pairs[:, 0]] != inside[pairs[:, 1]]
            for node in np.flatnonzero(inside):
                more.append(np.concatenate([across, -2.0 * (np.arange(n) == node)]))
        constraints.append(LinearConstraint(csr_array(np.array(more)), 0, np.inf))
    return bound, "vertex sets" if bound == found.value else "vertex sets, then HiGHS", None


def main() -> None:
    """Run both methods on all instances of tier C."""
    known: dict[str, Any] = json.loads(PROOFS.read_text()) if PROOFS.exists() else {}
    ours, simple, exact = [], [], []
    for name in sorted(path.stem for path in (HERE / "instances").glob("C-*.json")):
        instance = check.load(name)
        cost, group = time_matrix(instance), instance.arrays["group"]
        entry = {"instance": name}
        since = process_time()
        nodes = nearest_neighbour(cost, group)
        simple.append(entry | {"cpu_s": round(process_time() - since, 2), "tour": nodes.tolist()})
        since = process_time()
        sizes = np.bincount(group)
        problem = generalised_tsp.make_instance((cost + cost.T) / 2, np.concatenate([[0, 1], 1 + np.cumsum(sizes)]))
        found = generalised_tsp.solve(
            problem, group[nodes].astype(np.int64) + 1, np.random.default_rng(0), STEPS, BOUND_EFFORT
        )
        seconds = round(process_time() - since, 1)
        ours.append(entry | {"cpu_s": seconds, "tour": (found.tour[1:] - 1).tolist()})
        since = process_time()
        sets_bound, method, tour = prove((cost + cost.T) / 2, group, found.cost)
        least, method = max((found.lower_bound, "planner.tour"), (sets_bound, method))
        bound = float(np.floor(least * 1e6) / 1e6)
        known[name] = {"bound": bound, "method": method, "date": DATE, "cpu_s": round(process_time() - since, 1)}
        if tour is not None:
            exact.append(entry | {"cpu_s": known[name]["cpu_s"], "tour": tour.tolist()})
        sys.stdout.write(f"{name}: {found.cost:.3f} s, bound {bound:.3f} s by {method}, {seconds} s\n")
        sys.stdout.flush()
    store("scan-cell-normal", METHODS["scan-cell-normal"][2], ours)
    store("nearest-neighbour", "The nearest node of a group that was not visited.", simple)
    store("exact", EXACT, exact)
    write_json(PROOFS, dict(sorted(known.items())))


if __name__ == "__main__":
    main()
