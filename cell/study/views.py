"""One scene without a motion: how many views measure how much. The trial of the studies of standoff and scanner."""

import numpy as np

from cell.study.bench import Bench
from cell.study.scenes import scene_of
from cell.study.trial import JsonTable
from planner.kinematics.frames import pose_from_kuka_abc


def views(settings: JsonTable) -> dict[str, object]:
    """Views and coverage of a scene's scanner on its part.

    Args:
        settings: scene and files (`cell.study.scenes`), and robot: whether only what the robot reaches at the scene's
            placement may be used.
    """
    scene = scene_of(settings)
    bench = Bench(scene)
    candidates = bench.zone
    allowed = None
    if settings["robot"]:
        place = scene.placement
        centre = pose_from_kuka_abc(np.array(place.position_mm) / 1000, np.deg2rad(place.abc_deg))
        allowed = bench.reach(candidates, centre).reachable
    found = bench.select(scene.plan.fill, candidates, allowed, solver=scene.plan.solver, share=scene.plan.coverage)
    return {
        "standoff_mm": 1000 * bench.settings.standoffs[0],
        "candidates": len(candidates) if allowed is None else int(allowed.sum()),
        **found.values(),
        "sampled": bench.sampled(found.T_object_scanner) if len(found.cover.views) else 0.0,
    }
