"""Trial of a row of the paper's tables: its method (`rays`, Meta-RaPS) and ours (`aimed`, `auto`) on equal viewpoints.

The scanner is `paper`, whose range and baseline follow the standoff. Both plans are evaluated on the same held-out
samples, and scanned with the same fine resolution.
"""

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from time import perf_counter

import numpy as np

from benchmarks.paper.comparison import DENSER, PaperBench, fewest_for, most_with
from cell import scanners
from cell.plan.candidates import generate_viewpoints
from cell.scene.file import Tables, load_scene
from cell.study.prepared_part import solve_reach
from cell.study.trials import JsonTable
from planner.values import Bools
from planner.viewpoints.viewpoints import Viewpoints

FINE_RESOLUTION_DEG = 0.25
"""Angle between rays in the scans of both plans, independent of the planning resolution."""

PAPER_SCANNER = {"sensor": "paper", "grazing_max_deg": 75.0, "sensor_grazing_max_deg": 90.0}
"""The paper limits only the incidence of the laser."""


def row(settings: JsonTable) -> dict[str, object]:
    """Run both methods on a row.

    Args:
        settings: part, faces and samples_per_face; if the row varies them standoff_mm, fov_deg, resolution_deg and
            place_mm (null or missing: no robot).

    Returns:
        The values, and under "seconds" the time of each step.
    """
    bench = _bench(json.dumps({key: value for key, value in settings.items() if key != "place_mm"}, sort_keys=True))
    place = settings.get("place_mm")
    seconds: dict[str, float] = {}

    @contextmanager
    def timed(name: str) -> Iterator[None]:
        start = perf_counter()
        yield
        seconds[name] = perf_counter() - start

    with timed("reach"):
        zone, spherical = bench.candidates, _view_sphere(bench)
        allowed, sphere_allowed = (
            None if place is None else _reachable(bench, candidates, place) for candidates in (zone, spherical)
        )
    with timed("rays"):
        rays = bench.select("rays", zone, allowed, solver="meta-raps")
    with timed("ours"):
        ours = bench.select("aimed", zone, allowed, solver="auto")
    with timed("ours at their coverage"):
        fewer, fewer_is_denser = fewest_for(bench, zone, allowed, rays.visible, ours)
    with timed("ours at their views"):
        suffices = len(ours.cover.views) <= len(rays.cover.views) and ours.visible >= rays.visible
        most, most_is_denser = (
            (ours, False) if suffices else most_with(bench, zone, allowed, len(rays.cover.views), ours)
        )
    with timed("view sphere"):
        sphere = bench.select("aimed", spherical, sphere_allowed, solver="auto")
    with timed("scans"):
        sampled = [bench.sampled_coverage(plan.T_object_scanner) for plan in (rays, ours)]
    return {
        "viewpoints": _count(allowed, len(zone)),
        "rays": {**rays.values(), "sampled": sampled[0]},
        "ours": {**ours.values(), "sampled": sampled[1]},
        "ours_at_their_visible": {**fewer.values(), "density": DENSER if fewer_is_denser else 1},
        "ours_at_their_views": {**most.values(), "density": DENSER if most_is_denser else 1},
        "sphere": {"viewpoints": _count(sphere_allowed, len(spherical)), **sphere.values()},
        "seconds": seconds,
    }


@lru_cache(maxsize=1)
def _bench(settings: str) -> PaperBench:
    """Return the bench of a row; rows of Table 5 in one process share it, with part and matrices."""
    keys = scene_keys(json.loads(settings))
    keys["scanner"] = {"resolution_deg": [FINE_RESOLUTION_DEG] * 2, **keys["scanner"]}
    return PaperBench(load_scene(None, keys))


def scene_keys(settings: JsonTable) -> Tables:
    """Return the tables of the scene for a row's settings (see `row`)."""
    keys: Tables = {"part": {"name": settings["part"]}, "scanner": dict(PAPER_SCANNER)}
    keys["plan"] = {"rolls_deg": [0.0], "candidates": "optimal-scanning-zone"}
    keys["plan"] |= {key: settings[key] for key in ("faces", "samples_per_face")}
    if "standoff_mm" in settings:
        keys["plan"]["standoffs_mm"] = [settings["standoff_mm"]]
    if "fov_deg" in settings:
        keys["scanner"]["fov_deg"] = [settings["fov_deg"]] * 2
    if "resolution_deg" in settings:
        keys["scanner"]["planning_resolution_deg"] = settings["resolution_deg"]
    if settings.get("place_mm"):
        keys["placement"] = {"position_mm": settings["place_mm"]}
    return keys


def _view_sphere(bench: PaperBench) -> Viewpoints:
    plan = bench.scene.plan.model_copy(update={"candidates": "view-sphere"})
    scene = bench.scene.model_copy(update={"plan": plan})
    return scanners.sweep_columns(bench.scanner, generate_viewpoints(scene, bench.settings, bench.part, bench.planning))


def _reachable(bench: PaperBench, candidates: Viewpoints, place_mm: Sequence[float]) -> Bools:
    centre = np.eye(4)
    centre[:3, 3] = np.asarray(place_mm) / 1000
    return solve_reach(bench.world.with_placement(centre), candidates).reachable


def _count(allowed: Bools | None, total: int) -> int:
    return total if allowed is None else int(allowed.sum())
