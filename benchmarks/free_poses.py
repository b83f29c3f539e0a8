"""Attainable coverage: a free search over poses for each of 10^5 samples, compared with the generators.

This is the oracle of `plan.candidates = "grown"`. Each held-out sample is searched for by itself: poses are drawn over
all six degrees of freedom (`pose_sampling`), 2,048 for each sample that none measures. A pose counts if the scanner's
conditions hold, both lines of sight are free of part and occluders, and the arm reaches it without collision. A pose
that measures one sample is tested on the others, so that those need no search. Samples, order and poses differ from
those of candidate growth, and no pose is transferred from a neighbour.

Both incidence limits are 75 degrees for all rows; everything else is as in `candidates`.
"""

import tempfile
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from benchmarks.candidates import Bench, parts
from cell.plan import candidates as generators
from cell.scene.file import load_scene
from planner.geometry.sampling import draw_samples
from planner.measurability import coverage
from planner.values import Bools
from planner.viewpoints import growth
from planner.viewpoints.growth import ViewEvaluator
from planner.viewpoints.lines_of_sight import RayTargets
from planner.viewpoints.pose_sampling import draw_poses, find_frustum

_LIMIT_DEG = 75.0
_RANGES = ((0, 32), (32, 128), (128, 512), (512, 2048))
_TOGETHER = 200_000  # poses drawn at a time
_FIRST = 256  # samples searched at a time while nearly all are open
_SHARED = 64  # found poses of a batch that are tested on the other samples


def run() -> list[dict[str, Any]]:
    """Return one row per part."""
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as scratch:
        for name, options in parts(Path(scratch)):
            limits = {"grazing_max_deg": _LIMIT_DEG, "sensor_grazing_max_deg": _LIMIT_DEG}
            rows.append({"part": name, **_part(Bench(options, limits))})
    return rows


def _part(bench: Bench) -> dict[str, Any]:
    scene = load_scene(None, {**bench.tables, "plan": {"candidates": "optimal-scanning-zone"}})
    arm = bench.arm()
    zone = generators.generate_viewpoints(scene, bench.settings, bench.part, bench.planning)
    usable = bench.reach_of(zone).reachable
    start = process_time()
    scouts = draw_samples(bench.part.reference, bench.planning, growth.N_SCOUTS, np.random.default_rng([0, 7]))
    added = generators.grow_viewpoints(zone, usable, scouts, arm)
    seconds = process_time() - start
    first, second = zone.T_object_scanner[usable], added.T_object_scanner
    one, both = (
        coverage.visible_coverage(views, bench.held_out, bench.scanner, bench.casters).fraction
        for views in (first, np.concatenate([first, second]))
    )
    start = process_time()
    free = free_search(bench.held_out.points, bench.held_out.normals, arm).mean()
    return {
        "one a face %": round(100 * one, 2),
        "reachable": len(first),
        "grown %": round(100 * both, 2),
        "added": len(second),
        "cpu s": round(seconds, 2),
        "free search %": round(100 * float(free), 2),
        "open points": round(100 * float(free - both), 2),
        "free cpu s": round(process_time() - start, 1),
    }


def free_search(points: np.ndarray[Any, Any], normals: np.ndarray[Any, Any], arm: ViewEvaluator) -> Bools:
    """Return (S,) whether a reachable pose measures each of (S, 3) points [m] with normals (S, 3)."""
    targets, within = RayTargets.of(points, normals), find_frustum(arm.scanner)
    seen = np.zeros(len(targets), dtype=np.bool_)
    order = np.random.default_rng(0).permutation(len(targets))
    for stretch in _RANGES:
        size = min(_TOGETHER // (stretch[1] - stretch[0]), _FIRST if stretch[0] == 0 else len(targets))
        waiting = order[~seen[order]]
        while len(waiting):
            found = arm.measuring(draw_poses(targets, waiting[:size], stretch, within, arm.scanner), targets)
            own, which = np.unique(found.row, return_index=True)
            seen[own] = True
            still = np.flatnonzero(~seen)
            views = arm.views(found.pick(which[:_SHARED]))
            seen[still] = arm.measured(views, targets, still).any(axis=1)
            waiting = waiting[size:]
            waiting = waiting[~seen[waiting]]
    return seen
