"""What stands in a cell while the robot is at home, as solids in the base frame."""

import numpy as np

from cell.checks.solid import Solid
from cell.rays.occluders import post, shape_triangles
from cell.robot.model import bodies
from cell.world.model import World
from planner.geometry.mesh import joined

_SIDES = 192  # of a prism around a cylinder: its corners stand off by 0.04 mm at a radius of 300 mm
OWN = ("post", "pedestal", "floor")
"""What the cell has without being a fixture."""


def standing(world: World) -> dict[str, Solid]:
    """Part, fixtures, post, pedestal, base, links, bracket and housing by name; the floor, which is endless, is not."""
    data, T = world.data(), world.T_base_object
    attached = {fixture.name: fixture.attached_to == "object" for fixture in world.scene.fixtures}
    of_robot = arm(world)
    meshes = {"part": world.part_mesh, **world.fixture_meshes}
    found = {}
    for name in dict.fromkeys(world.entities):
        geoms = [geom for geom, entity in enumerate(world.entities) if entity == name]
        if name == "floor":
            continue
        if name in meshes:
            mesh = meshes[name]
            frame = T if attached.get(name, True) else np.eye(4)
            hull = world.part_hull.vertices if name == "part" else None
            found[name] = Solid(name, mesh.vertices, mesh.faces, frame[:3, :3].T, T=frame, hull=hull)
        elif name == "post":
            if data.body("post").xpos[2] > world.floor:
                found[name] = Solid(name, *post(data, world.floor, _SIDES))
        else:
            sides = {} if name in of_robot else {"sides": _SIDES}
            pieces = [shape_triangles(world.model, data, geom, **sides) for geom in geoms]
            axes = data.geom_xmat[geoms[0]].reshape(3, 3).T if len(geoms) == 1 else None
            found[name] = Solid(name, *joined(pieces)[:2], axes)
    return found


def arm(world: World) -> tuple[str, ...]:
    """Names of base, links, what they drive along, bracket and housing."""
    return (*bodies(world.model), "bracket", "housing")


def robot(world: World, solids: dict[str, Solid]) -> Solid:
    """Base, arm, bracket and housing as one."""
    pieces = [(solids[name].vertices, solids[name].faces) for name in arm(world) if name in solids]
    return Solid("robot", *joined(pieces)[:2])
