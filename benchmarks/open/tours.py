"""Tours of tier C: `python -m benchmarks.open.tours` writes entries of two methods, and bounds to best/proofs.json."""

import json
import sys
from time import process_time
from typing import Any

import numpy as np

from benchmarks.open import check
from benchmarks.open.baselines import DATE, METHODS, store
from benchmarks.open.best import PROOFS
from benchmarks.open.check import Array, Instance
from benchmarks.open.tools import HERE, write_json
from planner.tour import generalised_tsp

STEPS, BOUND_EFFORT = 40_000, 4_000_000_000


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


def main() -> None:
    """Run both methods on all instances of tier C."""
    known: dict[str, Any] = json.loads(PROOFS.read_text()) if PROOFS.exists() else {}
    ours, simple = [], []
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
        bound = float(np.floor(found.lower_bound * 1e6) / 1e6)
        known[name] = {"bound": bound, "method": "planner.tour", "date": DATE, "cpu_s": seconds}
        sys.stdout.write(f"{name}: {found.cost:.3f} s, bound {bound:.3f} s, {seconds} s\n")
        sys.stdout.flush()
    store("scan-cell-normal", METHODS["scan-cell-normal"][2], ours)
    store("nearest-neighbour", "The nearest node of a group that was not visited.", simple)
    write_json(PROOFS, dict(sorted(known.items())))


if __name__ == "__main__":
    main()
