"""The paper's Table 5 on the built-in Mseke: reachable viewpoints, views and coverage over the part's position.

One candidate per face, as in the paper (roll 0 alone), and the same with the two rolls of the default. The paper gives
the robot with respect to the object's centre; docs/frames.md says how that is read.
"""

from time import perf_counter
from typing import Any

import numpy as np

from cell.part import workpiece
from cell.rays.embree import EmbreeRayCaster
from cell.rays.matrix import PartSurface, part_matrix, surface_features
from cell.robot.kinematics import Kr16Kinematics
from cell.scanners.laser_area import LaserArea
from cell.scene.resolve import resolve
from cell.scene.scene import Scene
from cell.world.collision import MujocoCollisionChecker
from cell.world.world import compile as compile_world
from planner import cover
from planner.measurability import coverage
from planner.reach import reach
from planner.surface.decimate import decimate
from planner.surface.sample import sample
from planner.viewpoints.zone import optimal_scanning_zone

# robot position [mm], viewpoints, views, cover % of the paper's rows
PAPER = (
    (None, 930, 11, 97.91),
    ((1500, 500, 0), 76, 18, 52.96),
    ((1400, 500, 0), 304, 23, 88.28),
    ((1300, 500, 0), 495, 15, 95.08),
    ((1200, 500, 0), 692, 11, 97.54),
    ((1200, 600, 0), 600, 11, 97.82),
    ((1200, 700, 0), 515, 15, 96.43),
    ((1200, 800, 0), 432, 20, 92.16),
)


def run() -> list[dict[str, Any]]:
    """One row per position and set of rolls: the paper's numbers beside ours, with the seconds of the row."""
    scene = Scene()
    part = workpiece.load("mseke")
    settings = resolve(scene, part)
    planning = decimate(part.reference, settings.faces)
    features = surface_features(scene, part.reference, planning, np.random.default_rng([0, 0]))
    held_out = sample(part.reference, planning, coverage.SAMPLES, np.random.default_rng([0, 1]))
    caster = EmbreeRayCaster(part.reference.vertices, part.reference.faces)
    scanner = LaserArea(**settings.scanner)
    world = compile_world(
        scene, part.reference.vertices, part_faces=part.reference.faces, baseline_mm=settings.scanner["baseline_mm"]
    )
    kinematics = Kr16Kinematics.from_model(world.model)
    rows: list[dict[str, Any]] = []
    for rolls in ((0.0,), settings.rolls):
        candidates = optimal_scanning_zone(planning, settings.standoffs, rolls)
        start = perf_counter()
        surface = PartSurface(part.reference, planning, features, caster)
        M = part_matrix(scene, settings, surface, candidates, use_cache=False).matrix()
        fill_seconds = perf_counter() - start
        for position, viewpoints_paper, views_paper, cover_paper in PAPER:
            start = perf_counter()
            allowed = np.ones(len(candidates), dtype=bool)
            if position is not None:
                centre = np.eye(4)
                centre[:3, 3] = np.array(position) / 1000
                T = world.placed(centre)
                checker = MujocoCollisionChecker(world, T)
                allowed = reach.solve(candidates, T, world.T_flange_scanner, kinematics, checker).reachable
            found = cover.solve(M, features.areas, allowed, rng=np.random.default_rng(0))
            views = candidates.T_object_scanner[found.views]
            seconds = perf_counter() - start
            rows.append(
                {
                    "position mm": "no robot" if position is None else ",".join(map(str, position)),
                    "rolls deg": ",".join(f"{np.degrees(roll):g}" for roll in rolls),
                    "paper viewpoints": viewpoints_paper,
                    "reachable": int(allowed.sum()),
                    "share %": round(100 * float(allowed.mean()), 1),
                    "paper views": views_paper,
                    "views": len(found.views),
                    "lower bound": found.lower_bound,
                    "paper cover %": cover_paper,
                    "visible %": round(100 * coverage.visible(views, held_out, scanner, (caster,)).fraction, 2),
                    "fill s": round(fill_seconds, 2),
                    "s": round(seconds, 2),
                }
            )
    return rows
