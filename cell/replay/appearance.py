"""How the cell looks in the viewer: colours, and surfaces for the eye alone, which take no part in collisions."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from cell.view.palette import LOOKS, look_of
from planner.geometry.decimation import decimate
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco

VIEW_FACES = 200_000
"""Faces above which the part is decimated for the view: finer than any pixel, and software rendering pays for each."""

_IS_PART = re.compile(r"part(_\d+)?")
_VISUAL_GROUP, _ROBOT_GROUP, _HIDDEN_GROUP = 1, 3, 4


def paint(spec: mujoco.MjSpec) -> None:
    """Give every shape the colour that it has in pictures."""
    links = {geom.name for body in spec.bodies if of_robot(body) for geom in body.geoms}
    for geom in spec.geoms:
        look = look_of("part" if _IS_PART.fullmatch(geom.name) else geom.name, of_robot=geom.name in links)
        geom.rgba = [*LOOKS[look], 1]
        if geom.name in links:
            geom.group = _ROBOT_GROUP


def of_robot(body: mujoco.MjsBody) -> bool:
    """Whether a body is the arm's: the base, a link, or what a link drives along."""
    return body.name == "base" or len(body.joints) > 0


def part_pieces(spec: mujoco.MjSpec) -> list[mujoco.MjsGeom]:
    """The shapes that stand for the part: its hull, or its convex pieces in runs of earlier versions."""
    return [geom for geom in spec.body("object").geoms if _IS_PART.fullmatch(geom.name)]


def light(spec: mujoco.MjSpec, centre: Floats) -> None:
    """A pale sky, a floor to the horizon, and even light; part and arm in the middle."""
    import mujoco

    sky, gradient = mujoco.mjtTexture.mjTEXTURE_SKYBOX, mujoco.mjtBuiltin.mjBUILTIN_GRADIENT
    pale, blue = [0.97, 0.98, 1.0], [0.72, 0.78, 0.86]
    spec.add_texture(name="sky", type=sky, builtin=gradient, rgb1=pale, rgb2=blue, width=512, height=3072)
    spec.geom("floor").size = [0.0, 0.0, 0.1]  # a plane is endless to collisions anyway
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.25] * 3, [0.15] * 3
    for lamp in spec.lights:
        lamp.castshadow = False
    spec.visual.rgba.haze = [0.93, 0.95, 0.97, 1.0]
    spec.stat.extent, spec.stat.center = 2.0, [0.5 * centre[0], 0.5 * centre[1], 0.4]


def show_surface(spec: mujoco.MjSpec, name: str, mesh: TriangleMesh, hulls: Sequence[mujoco.MjsGeom]) -> None:
    """A true surface, in the frame of the body that has the convex shapes, in place of these."""
    import mujoco

    shown = decimate(mesh, VIEW_FACES) if len(mesh.faces) > VIEW_FACES else mesh
    add_mesh(spec, name, shown, smooth=True)
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


def add_mesh(spec: mujoco.MjSpec, name: str, mesh: TriangleMesh, *, smooth: bool = False) -> None:
    """A mesh for the eye alone: surface inertia, so that open and thin ones compile as well."""
    import mujoco

    # The engine asks for four vertices; a lone triangle gets one of its own again.
    vertices = mesh.vertices if len(mesh.vertices) > 3 else np.concatenate([mesh.vertices, mesh.vertices[:1]])
    spec.add_mesh(
        name=name,
        uservert=vertices.ravel(),
        userface=mesh.faces.ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        smoothnormal=smooth,
    )
