"""Seeded scenes for benchmarks of motion: a built-in part, its placement, and fixtures around it.

Every scene is drawn from its number alone. Infeasible draws (a fixture inside the robot, a part out of reach) are
replaced by the next draw of the same number.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.errors import SceneError
from cell.part import workpiece
from cell.part.workpiece import Workpiece
from cell.scene.model import Scene
from cell.world.checks import require_feasible
from cell.world.collision import MujocoCollisionChecker
from cell.world.model import World, compile_world
from planner.geometry.decimation import decimate
from planner.geometry.mesh import TriangleMesh
from planner.kinematics import reach
from planner.kinematics.reach import Reach
from planner.viewpoints.viewpoints import Viewpoints, optimal_scanning_zone

PARTS = ("mseke", "mug", "robinet", "petanque", "humerus", "st-jean")

_FIXTURES = 2, 7  # from, to below
_FACES, _ROLLS = 60, np.radians([0.0, 90.0])  # candidates: one per face and roll
_STANDOFF = 0.2  # m: near the part, so that paths around it are needed
_DRAWS = 40


@dataclass(frozen=True, slots=True, eq=False)
class SeededCell:
    """A compiled scene with candidates.

    Attributes:
        number: number of the scene.
        world: the compiled cell.
        checker: its collision checker.
        part: the part's faces, object frame [m].
        viewpoints: candidates.
        reach: their joint configurations.
    """

    number: int
    world: World
    checker: MujocoCollisionChecker
    part: TriangleMesh
    viewpoints: Viewpoints
    reach: Reach

    @property
    def reachable(self) -> NDArray[np.int64]:
        """Return (n,) reachable candidates."""
        return np.flatnonzero(self.reach.reachable)


def usable(number: int, least: int = 2, *, table: str = "") -> SeededCell:
    """Return the first feasible draw of a scene with enough reachable candidates.

    Args:
        number: number of the scene.
        least: required number of reachable candidates.
        table: mode of a rotary table, or "tilted": synchronised, with a tilted axis; "": no table.
    """
    for draw in range(_DRAWS):
        scene = Scene.model_validate(content(number, draw) | ({"table": _table(number, draw, table)} if table else {}))
        part, planning = _part(scene.part.name)
        try:  # a table may be too low for its part
            world = compile_world(scene, part.reference.vertices, part_faces=part.reference.faces, baseline_mm=75.0)
            require_feasible(world)
        except SceneError:
            continue
        candidates = optimal_scanning_zone(planning, (_STANDOFF,), tuple(_ROLLS))
        checker = MujocoCollisionChecker(world)
        if not checker.free(world.home[None])[0]:
            continue
        found = reach.solve_reach(candidates, world.T_base_object, world.T_flange_scanner, world.kinematics, checker)
        if found.reachable.sum() >= least:
            faces = TriangleMesh(part.reference.vertices, part.reference.faces)
            return SeededCell(number, world, checker, faces, candidates, found)
    raise RuntimeError(f"none of {_DRAWS} draws of scene {number} can be used")


def _table(number: int, draw: int, moves: str) -> dict[str, Any]:
    """Return a rotary table: every second one has limits, and the part off its axis."""
    rng = np.random.default_rng([number, draw, 1])
    keys: dict[str, Any] = {
        "diameter_mm": round(float(rng.uniform(200, 500)), 1),
        "angles": int(rng.choice([24, 36, 72])),
    }
    if number % 2:
        middle = np.array(content(number, draw)["placement"]["position_mm"])
        beside = [*rng.uniform(-150, 150, 2), -rng.uniform(350, 550)]
        keys |= {
            "position_mm": (middle + beside).round(1).tolist(),
            "limits_deg": rng.uniform([-180, 20], [-20, 180]).round(1).tolist(),
        }
    if moves == "tilted":
        return keys | {"abc_deg": rng.uniform(-40, 40, 3).round(1).tolist()}
    return keys | {"moves": moves}


@lru_cache
def _part(name: str) -> tuple[Workpiece, TriangleMesh]:
    part = workpiece.load(name)
    return part, decimate(part.reference, _FACES)


def content(number: int, draw: int = 0) -> dict[str, Any]:
    """Return the tables of a scene file for a draw of a number."""
    rng = np.random.default_rng([number, draw])
    distance, bearing = rng.uniform(800, 1350), np.radians(rng.uniform(-80, 80))
    middle = np.array([distance * np.cos(bearing), distance * np.sin(bearing), rng.uniform(-250, 450)])
    turn = [rng.uniform(-180, 180), rng.uniform(-25, 25), rng.uniform(-25, 25)]
    fixtures = []
    for k in range(int(rng.integers(*_FIXTURES))):
        away, side = rng.uniform(200, 520), np.radians(rng.uniform(-180, 180))
        at = middle + np.array([away * np.cos(side), away * np.sin(side), rng.uniform(-350, 250)])
        fixture: dict[str, Any] = {
            "name": f"fixture {k + 1}",
            "position_mm": at.round(1).tolist(),
            "abc_deg": rng.uniform([-180, -20, -20], [180, 20, 20]).round(1).tolist(),
        }
        if rng.random() < 0.5:
            fixture |= {"shape": "box", "size_mm": rng.uniform([40, 40, 60], [350, 200, 600]).round(1).tolist()}
        else:
            fixture |= {"shape": "cylinder", "size_mm": rng.uniform([30, 100], [160, 800]).round(1).tolist()}
        fixtures.append(fixture)
    return {
        "part": {"name": PARTS[number % len(PARTS)]},
        "placement": {"position_mm": middle.round(1).tolist(), "abc_deg": np.round(turn, 1).tolist()},
        "fixtures": fixtures,
    }
