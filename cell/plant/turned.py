"""What a rotary table turns, as an inertia about its axis, and the table's drive.

The axis is upright, so that nothing of it weighs on the drive, and it hangs on nothing of the arm: one hinge beside it.
The inertia is that of the shapes that collide (part and mesh fixtures as their hulls), of solid steel, with a faceplate
of the table's diameter: more than a hollow part has. The drive's figures are assumptions of the same class of
positioners as the default table's (models/README.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cell.world.shapes import mesh_of
from planner.kinematics.rotary_table import RotaryTable
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco

DENSITY = 7850.0
"""Of steel [kg/m^3]."""

PLATE = 0.02
"""Thickness of the faceplate [m]."""


@dataclass(frozen=True, slots=True)
class Turned:
    """A hinge with its load and its drive.

    Attributes:
        inertia: of all that it turns about its axis [kg m^2].
        reach: distance of its farthest point from the axis [m].
        rotor_inertia: of the motor, seen through the gear [kg m^2].
        torque: largest torque [Nm].
        coulomb: friction that does not depend on speed [Nm].
        viscous: friction that grows with speed [Nm s/rad].
    """

    inertia: float
    reach: float
    rotor_inertia: float = 20.0
    torque: float = 1000.0
    coulomb: float = 20.0
    viscous: float = 10.0


def of_model(model: mujoco.MjModel, table: RotaryTable, diameter: float) -> Turned:
    """What the table of a compiled cell turns, such as a run's `cell.xml`.

    Args:
        model: part, post and the part's fixtures stand in it at angle 0.
        table: of the cell.
        diameter: of its face [m].
    """
    import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    bodies = {model.body(name).id for name in ("object", "post")}
    inertia = DENSITY * np.pi * PLATE * (diameter / 2) ** 4 / 2
    reach = diameter / 2
    for geom in np.flatnonzero([int(body) in bodies for body in model.geom_bodyid]):
        points, volume, about_middle, middle = _solid(model, data, int(geom))
        off = table.seen(middle)[:2]
        inertia += DENSITY * (about_middle + volume * float(off @ off))
        reach = max(reach, float(np.linalg.norm(table.seen(points)[:, :2], axis=1).max()))
    return Turned(float(inertia), reach)


def _solid(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> tuple[Floats, float, float, Floats]:
    """A shape as a solid in base [m]: points, volume, its moment about the upright through its middle, that."""
    import mujoco
    import trimesh

    T = np.eye(4)
    T[:3, :3], T[:3, 3] = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
        solid = trimesh.creation.box(2.0 * model.geom_size[geom], T)
    elif model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CYLINDER:
        radius, half = model.geom_size[geom][:2]
        solid = trimesh.creation.cylinder(radius, 2.0 * half, transform=T, sections=64)
    else:
        body = int(model.geom_bodyid[geom])
        T[:3, :3], T[:3, 3] = data.xmat[body].reshape(3, 3), data.xpos[body]
        solid = trimesh.convex.convex_hull(mesh_of(model, geom).vertices).apply_transform(T)
    return np.asarray(solid.vertices), float(solid.volume), float(solid.moment_inertia[2, 2]), solid.center_mass
