"""The paper's Table 5 on the built-in Mseke, reduced: order of the reachable counts, and the row without a robot."""

import numpy as np

from cell.part import workpiece
from cell.robot.arm import kinematics_of
from cell.scene.model import Scene
from cell.world.collision import MujocoCollisionChecker
from cell.world.model import compile_world
from planner.geometry.decimation import decimate
from planner.kinematics import reach
from planner.viewpoints.viewpoints import optimal_scanning_zone


def test_reachable_counts_fall_as_the_part_moves_away() -> None:
    """1500 < 1400 < 1300 < 1200 at y = 500 and 500 > 600 > 700 > 800 at x = 1200; without a robot all are usable."""
    part = workpiece.load("mseke")
    planning = decimate(part.reference, 930)
    candidates = optimal_scanning_zone(planning, [0.3], [0.0])
    world = compile_world(Scene(), part.reference.vertices, baseline_mm=75.0)
    kinematics = kinematics_of(world.model)

    def count(x: float, y: float) -> int:
        centre = np.eye(4)
        centre[:3, 3] = [x / 1000, y / 1000, 0]
        T = world.T_base_object_at(centre)
        checker = MujocoCollisionChecker(world, T)
        found = reach.solve_reach(candidates, T, world.T_flange_scanner, kinematics, checker)
        return int(found.reachable.sum())

    away = [count(x, 500) for x in (1200, 1300, 1400, 1500)]
    aside = [count(1200, y) for y in (500, 600, 700, 800)]
    assert away == sorted(away, reverse=True)
    assert aside == sorted(aside, reverse=True)
    assert len(set(away)) == len(set(aside)) == 4
    assert len(candidates) == len(planning.faces) > away[0] > 0
