"""Generalised travelling salesman files: how near the best known tour, how soon, and what the bound says.

The files are GTSPLIB's (Fischetti, Salazar and Toth 1997, doi:10.1287/opre.45.3.378), read from the folder that
SCAN_CELL_GTSP names, with `best_known.json` beside them; without it, and in any case, instances are drawn: places in a
square, clustered as GTSPLIB's (the farthest places are centres; the others join the nearest centre), up to 200 clusters
of 5 nodes. Their best known cost is the best of this run. Kernels are compiled before the clock starts.
"""

import json
import os
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np

from benchmarks import gtsplib
from planner import generalised_tsp, tour_bound

STEPS = (500, 2_000, 10_000, 40_000)
_SEEDS = 5
_LARGE_STEPS = 150_000
_BOUND_WORK = 2_000_000_000


def run() -> list[dict[str, Any]]:
    """Rows over files and budgets."""
    _compile()
    rows: list[dict[str, Any]] = []
    for name, problem, best in _files():
        rows += _searched(name, problem, best, STEPS)
    for clusters in (20, 50, 100, 200):
        problem = drawn(clusters, 5 * clusters)
        rows += _searched(f"drawn {clusters}x5", problem, None, STEPS if clusters <= 50 else (*STEPS, _LARGE_STEPS))
    return rows


def _files() -> list[tuple[str, generalised_tsp.Instance, float]]:
    if "SCAN_CELL_GTSP" not in os.environ:
        return []
    folder = Path(os.environ["SCAN_CELL_GTSP"])
    best = json.loads((folder / "best_known.json").read_text(encoding="utf-8"))
    found = [(name, of_file(folder / f"{name}.gtsp"), float(cost)) for name, cost in best.items()]
    return sorted(found, key=lambda file: file[1].n_clusters)


def of_file(path: Path) -> generalised_tsp.Instance:
    """The instance of a file; the smallest cluster comes first, as the tour's start."""
    read = gtsplib.read(path)
    read.sets.sort(key=len)
    return generalised_tsp.instance(*read.sorted_by_cluster())


def drawn(clusters: int, nodes: int, seed: int = 0) -> generalised_tsp.Instance:
    """Places drawn in a square of side 4000, clustered as GTSPLIB's; distances are whole numbers."""
    places = np.random.default_rng([seed, clusters]).uniform(0, 4000, (nodes, 2)).round()
    cost = gtsplib._distances(places, "EUC_2D")
    centres = [int(np.unravel_index(cost.argmax(), cost.shape)[0])]
    near = cost[centres[0]].copy()
    while len(centres) < clusters:
        centres.append(int(near.argmax()))
        np.minimum(near, cost[centres[-1]], out=near)
    owner = cost[centres].argmin(axis=0)
    sets = sorted((np.flatnonzero(owner == k) for k in range(clusters)), key=len)
    return generalised_tsp.instance(*gtsplib.Gtsp("drawn", cost, sets).sorted_by_cluster())


def _searched(
    name: str, problem: generalised_tsp.Instance, best: float | None, budgets: tuple[int, ...]
) -> list[dict[str, Any]]:
    _, start = generalised_tsp.best_nodes(problem, np.arange(1, problem.n_clusters))
    costs, seconds = [], []
    for steps in budgets:
        begin = process_time()
        costs.append([generalised_tsp.search(problem, start, seed, steps)[0] for seed in range(_SEEDS)])
        seconds.append((process_time() - begin) / _SEEDS)
    best = min(min(c) for c in costs) if best is None else best
    begin = process_time()
    quick = tour_bound.one_tree(problem.cost, problem.first)
    strong = max(quick, tour_bound.by_walks(problem.cost, problem.first, min(min(c) for c in costs), _BOUND_WORK).value)
    bound_seconds = process_time() - begin
    return [
        {
            "case": name,
            "clusters": problem.n_clusters,
            "nodes": len(problem.cost),
            "steps": steps,
            "seconds": second,
            "mean over best %": 100 * (float(np.mean(cost)) / best - 1),
            "worst over best %": 100 * (max(cost) / best - 1),
            "best over bound %": 100 * (best / strong - 1),
            "over quick bound %": 100 * (best / quick - 1),
            "bound s": bound_seconds,
        }
        for steps, second, cost in zip(budgets, seconds, costs, strict=True)
    ]


def _compile() -> None:
    small = drawn(5, 20)
    begin = perf_counter()
    _, start = generalised_tsp.best_nodes(small, np.arange(1, 5))
    cost, _ = generalised_tsp.search(small, start, 0, 10)
    tour_bound.by_walks(small.cost, small.first, cost, 10_000)
    print(f"kernels loaded, or compiled where they were not yet, in {perf_counter() - begin:.1f} s")  # noqa: T201 - told once
