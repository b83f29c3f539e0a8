"""Appearance of the cell in the viewer: colours, light, and visual meshes that take no part in collisions."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from cell.view.palette import MATERIALS, material_of
from planner.geometry.decimation import decimate
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco

MAX_FACES = 200_000
"""Largest number of faces of a visual mesh: finer than a pixel, and software rendering pays for each face."""

_IS_PART = re.compile(r"part(_\d+)?")
_VISUAL_GROUP, _ROBOT_GROUP, _HIDDEN_GROUP = 1, 3, 4

VISIBLE_GROUPS = (1, 1, 1, 1, 0, 0)
"""Whether each group of geoms is shown: surfaces and the robot, not hulls and the collision boxes inside the robot."""


def set_colours(spec: mujoco.MjSpec) -> None:
    """Give every geom the colour that it has in pictures."""
    links = {geom.name for body in spec.bodies if is_robot_body(body) for geom in body.geoms}
    for geom in spec.geoms:
        material = material_of("part" if _IS_PART.fullmatch(geom.name) else geom.name, is_robot=geom.name in links)
        geom.rgba = [*MATERIALS[material], 1]
        if geom.name in links:
            geom.group = _ROBOT_GROUP


def is_robot_body(body: mujoco.MjsBody) -> bool:
    """Return whether a body is part of the arm: the base, a link, or a body on a mimic joint."""
    return body.name == "base" or len(body.joints) > 0


def part_geoms(spec: mujoco.MjSpec) -> list[mujoco.MjsGeom]:
    """Return the geoms of the part: its hull, or its convex pieces in runs of earlier versions."""
    return [geom for geom in spec.body("object").geoms if _IS_PART.fullmatch(geom.name)]


def set_lighting(spec: mujoco.MjSpec, centre: Floats) -> None:
    """Set a pale sky, a floor to the horizon and even light; place part and arm in the middle."""
    import mujoco

    sky, gradient = mujoco.mjtTexture.mjTEXTURE_SKYBOX, mujoco.mjtBuiltin.mjBUILTIN_GRADIENT
    pale, blue = [0.97, 0.98, 1.0], [0.72, 0.78, 0.86]
    spec.add_texture(name="sky", type=sky, builtin=gradient, rgb1=pale, rgb2=blue, width=512, height=3072)
    spec.geom("floor").size = [0.0, 0.0, 0.1]  # collisions treat a plane as infinite anyway
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.25] * 3, [0.15] * 3
    for lamp in spec.lights:
        lamp.castshadow = False
    spec.visual.rgba.haze = [0.93, 0.95, 0.97, 1.0]
    spec.stat.extent, spec.stat.center = 2.0, [0.5 * centre[0], 0.5 * centre[1], 0.4]


def add_surface(spec: mujoco.MjSpec, name: str, mesh: TriangleMesh, hulls: Sequence[mujoco.MjsGeom]) -> None:
    """Show a true surface in place of its hulls, in the frame of their body."""
    import mujoco

    surface = decimate(mesh, MAX_FACES) if len(mesh.faces) > MAX_FACES else mesh
    add_visual_mesh(spec, name, surface, smooth=True)
    hulls[0].parent.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=name,
        rgba=hulls[0].rgba,
        group=_VISUAL_GROUP,
        contype=0,
        conaffinity=0,
    )
    for hull in hulls:
        hull.group = _HIDDEN_GROUP


def add_visual_mesh(spec: mujoco.MjSpec, name: str, mesh: TriangleMesh, *, smooth: bool = False) -> None:
    """Add a visual mesh. It has surface inertia, so that open and thin meshes compile too."""
    import mujoco

    # The engine requires four vertices; a single triangle repeats one of its own.
    vertices = mesh.vertices if len(mesh.vertices) > 3 else np.concatenate([mesh.vertices, mesh.vertices[:1]])
    spec.add_mesh(
        name=name,
        uservert=vertices.ravel(),
        userface=mesh.faces.ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        smoothnormal=smooth,
    )
