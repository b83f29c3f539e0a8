"""Trial of a row of the paper's tables: its method (`rays`, Meta-RaPS) and ours (`aimed`, `auto`) on equal viewpoints.

The scanner is `paper`, whose range and baseline follow the standoff. Both plans are evaluated on the same held-out
samples, and scanned with the same fine resolution.
"""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from time import perf_counter

from benchmarks.paper.comparison import fewest_for, most_with
from cell.scene.file import Tables, load_scene
from cell.study.bench import Bench, Mask, placed_at
from cell.study.trial import JsonTable

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
        zone, spherical = bench.zone, bench.sphere
        allowed, sphere_allowed = (
            None if place is None else bench.reach(candidates, placed_at(place)).reachable
            for candidates in (zone, spherical)
        )
    with timed("rays"):
        rays = bench.select("rays", zone, allowed, solver="meta-raps")
    with timed("ours"):
        ours = bench.select("aimed", zone, allowed, solver="auto")
    with timed("ours at their coverage"):
        fewer = fewest_for(bench, zone, allowed, rays.visible, ours)
    with timed("ours at their views"):
        enough = len(ours.cover.views) <= len(rays.cover.views) and ours.visible >= rays.visible
        most = ours if enough else most_with(bench, zone, allowed, len(rays.cover.views), ours)
    with timed("view sphere"):
        sphere = bench.select("aimed", spherical, sphere_allowed, solver="auto")
    with timed("scans"):
        sampled = [bench.sampled(plan.T_object_scanner) for plan in (rays, ours)]
    return {
        "viewpoints": _count(allowed, len(zone)),
        "rays": {**rays.values(), "sampled": sampled[0]},
        "ours": {**ours.values(), "sampled": sampled[1]},
        "ours_at_their_visible": fewer.values(),
        "ours_at_their_views": most.values(),
        "sphere": {"viewpoints": _count(sphere_allowed, len(spherical)), **sphere.values()},
        "seconds": seconds,
    }


@lru_cache(maxsize=1)
def _bench(settings: str) -> Bench:
    """Return the bench of a row; rows of Table 5 in one process share it, with part and matrices."""
    keys = scene_keys(json.loads(settings))
    keys["scanner"] = {"resolution_deg": [FINE_RESOLUTION_DEG] * 2, **keys["scanner"]}
    return Bench(load_scene(None, keys))


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


def _count(allowed: Mask | None, total: int) -> int:
    return total if allowed is None else int(allowed.sum())
