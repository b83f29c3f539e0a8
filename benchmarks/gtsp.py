"""Generalised travelling salesman instances: gap to the best known tour, time, and lower bound.

The instances are those of GTSPLIB (Fischetti, Salazar and Toth 1997, doi:10.1287/opre.45.3.378), read from the folder
SCAN_CELL_GTSP with its `best_known.json`, and random ones: places in a square, clustered as in GTSPLIB (the
farthest places are centres, the others join the nearest one), 50, 80 and 200 clusters of 5 nodes. Their best known cost
is that of one run of a million steps, so a negative excess is possible. Kernels are compiled before the clock starts.

Two real instances are added: the views of the Mseke at 1200,500,0 with their own configurations, and with those of
their alternatives. Their costs are cycle times over straight moves [s].
"""

import json
import os
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np

from benchmarks import gtsplib
from cell.scene.model import Scene
from cell.study.prepared_part import Bench, solve_reach
from cell.world.occluders import fixed_occluders, make_caster
from planner import cover
from planner.measurability.visibility import apply_occluders
from planner.timing.move_time import move_time
from planner.tour import bounds, equivalent_views, generalised_tsp

STEPS = (500, 2_000, 10_000, 40_000)
_SEEDS = 3
_REFERENCE_STEPS = 1_000_000
_BOUND_EFFORT = 2_000_000_000


def run() -> list[dict[str, Any]]:
    """Return rows over files and budgets."""
    _compile()
    rows: list[dict[str, Any]] = []
    for name, problem, best in _files():
        rows += _searched(name, problem, best, STEPS)
    for name, problem in _mseke():
        rows += _searched(name, problem, None, (10, 30, 100, 300, 1000, 3000, 10_000))
    for clusters in (50, 80, 200):
        problem = draw_instance(clusters, 5 * clusters)
        _, start = generalised_tsp.best_nodes(problem, np.arange(1, clusters))
        best, _ = generalised_tsp.search(problem, start, _SEEDS, _REFERENCE_STEPS)
        default = generalised_tsp.scale_steps(problem, generalised_tsp.STEPS)
        rows += _searched(f"drawn {clusters}x5", problem, best, (*STEPS, default))
    return rows


def _files() -> list[tuple[str, generalised_tsp.Instance, float]]:
    if "SCAN_CELL_GTSP" not in os.environ:
        return []
    folder = Path(os.environ["SCAN_CELL_GTSP"])
    best = json.loads((folder / "best_known.json").read_text(encoding="utf-8"))
    found = [(name, of_file(folder / f"{name}.gtsp"), float(cost)) for name, cost in best.items()]
    return sorted(found, key=lambda file: file[1].n_clusters)


def _mseke() -> list[tuple[str, generalised_tsp.Instance]]:
    """Return the instances of the default plan: its own views, and with their alternatives."""
    bench = Bench(Scene.model_validate({"placement": {"position_mm": [1200, 500, 0]}}), samples=1000)
    world, candidates = bench.world, bench.candidates
    reached = solve_reach(world, candidates)
    M = bench.matrix("aimed", candidates)
    M = apply_occluders(M, candidates, bench.scanner, make_caster(fixed_occluders(world)), ray_caster=bench.caster)
    rng = np.random.default_rng(0)
    plan = cover.solve(cover.CoverProblem(M.matrix(), M.samples.areas, reached.reachable), rng=rng)
    matrix = equivalent_views.VisibilityIndex(M.matrix(), M.samples.areas, np.asarray(reached.reachable))
    found = equivalent_views.exchange_views(
        matrix, plan.views, reached.configurations_of, world.home, world.limits, rng
    )
    problems = []
    for name, groups in (
        ("own views", [plan.views[k : k + 1] for k in range(len(plan.views))]),
        ("views exchanged", list(found.groups)),
    ):
        q = [np.concatenate([reached.configurations_of(int(view)) for view in group]) for group in groups]
        nodes = np.concatenate([world.home[None], *q])
        cost = move_time(nodes[:, None], nodes, world.limits)
        problems.append((f"mseke, {name}", generalised_tsp.make_instance(cost, np.cumsum([0, 1, *map(len, q)]))))
    return problems


def of_file(path: Path) -> generalised_tsp.Instance:
    """Read the instance of a file; the smallest cluster comes first, as the start of the tour."""
    read = gtsplib.read(path)
    read.sets.sort(key=len)
    return generalised_tsp.make_instance(*read.sorted_by_cluster())


def draw_instance(clusters: int, nodes: int, seed: int = 0) -> generalised_tsp.Instance:
    """Draw places in a square of side 4000, clustered as in GTSPLIB; distances are integers."""
    places = np.random.default_rng([seed, clusters]).uniform(0, 4000, (nodes, 2)).round()
    cost = gtsplib._distances(places, "EUC_2D")
    centres = [int(np.unravel_index(cost.argmax(), cost.shape)[0])]
    near = cost[centres[0]].copy()
    while len(centres) < clusters:
        centres.append(int(near.argmax()))
        np.minimum(near, cost[centres[-1]], out=near)
    owner = cost[centres].argmin(axis=0)
    sets = sorted((np.flatnonzero(owner == k) for k in range(clusters)), key=len)
    return generalised_tsp.make_instance(*gtsplib.Gtsp("drawn", cost, sets).sorted_by_cluster())


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
    quick = bounds.one_tree_bound(problem.cost, problem.first)
    strong = max(quick, bounds.walk_bound(problem.cost, problem.first, min(min(c) for c in costs), _BOUND_EFFORT).value)
    bound_seconds = process_time() - begin
    return [
        {
            "case": name,
            "clusters": problem.n_clusters,
            "nodes": len(problem.cost),
            "steps": steps,
            "mean": float(np.mean(cost)),
            "bound": strong,
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
    small = draw_instance(5, 20)
    begin = perf_counter()
    _, start = generalised_tsp.best_nodes(small, np.arange(1, 5))
    cost, _ = generalised_tsp.search(small, start, 0, 10)
    bounds.walk_bound(small.cost, small.first, cost, 10_000)
    print(f"kernels loaded or compiled in {perf_counter() - begin:.1f} s")  # noqa: T201 - once


def chart(rows: list[dict[str, Any]], folder: Path) -> None:
    """Draw cycle time over the search's budget with the lower bound, and cost over the best known one by time."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.3))
    for colour, case in zip(("C0", "C1"), ("mseke, own views", "mseke, views exchanged"), strict=True):
        points = [row for row in rows if row["case"] == case]
        label = f"{case[7:]}: {points[0]['clusters'] - 1} views, {points[0]['nodes'] - 1} solutions"
        left.plot([row["steps"] for row in points], [row["mean"] for row in points], "o-", color=colour, label=label)
        left.axhline(points[0]["bound"], color=colour, linestyle="--", linewidth=1)
    left.set(xscale="log", xlabel="steps of the search", ylabel="cycle time over straight moves [s]")
    left.set_title("Mseke at 1200,500,0 (dashed: lower bound)", fontsize=10)
    left.legend()
    others = [row for row in rows if not row["case"].startswith("mseke")]
    for case in dict.fromkeys(row["case"] for row in others):
        points = [row for row in others if row["case"] == case]
        seconds, over = [row["seconds"] for row in points], [row["mean over best %"] for row in points]
        right.plot(seconds, over, "o-", label=case)
    right.set(xscale="log", xlabel="processor time [s]", ylabel="mean cost over the best known [%]")
    right.set_title("GTSPLIB files and drawn instances", fontsize=10)
    right.legend(fontsize=8)
    for axes in (left, right):
        axes.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(folder / "ordering_budget.png", dpi=150)
    plt.close(figure)
