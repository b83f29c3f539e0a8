"""How the cell looks: colours, light, floor, sky, shapes for the eye alone, which take no part in collisions."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from cell.robot import model as robot
from cell.view.palette import LOOKS, Look, look_of
from planner.surface.decimate import decimate
from planner.surface.mesh import TriangleMesh
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco

VIEW_FACES = 200_000
"""Faces above which the part is decimated for the view: finer than any pixel, and software rendering pays for each."""

_IS_PART = re.compile(r"part(_\d+)?")
_VISUAL_GROUP, _ROBOT_GROUP, _HIDDEN_GROUP = 1, 3, 4
_SHINE: dict[Look, tuple[float, float]] = {  # specular, shininess
    "orange": (0.35, 0.45), "anthracite": (0.4, 0.4), "aluminium": (0.6, 0.6), "painted": (0.15, 0.2),
    "fixture": (0.2, 0.3), "surface": (0.25, 0.35),
}  # fmt: skip


def paint(spec: mujoco.MjSpec) -> None:
    """Give every shape its material, and the robot's boxes their look."""
    import mujoco

    for name, (specular, shininess) in _SHINE.items():
        spec.add_material(name=name, rgba=[*LOOKS[name], 1], specular=specular, shininess=shininess)
    links = {geom.name for body in spec.bodies if body.name in robot.LINKS for geom in body.geoms}
    for geom in list(spec.geoms):
        look = look_of("part" if _IS_PART.fullmatch(geom.name) else geom.name, of_robot=geom.name in links)
        if look == "floor":
            continue
        geom.material, geom.rgba = look, [*LOOKS[look], 1]
        if geom.name in links:
            geom.group = _ROBOT_GROUP
            if geom.type == mujoco.mjtGeom.mjGEOM_BOX:
                _chamfer(spec, geom)


def part_pieces(spec: mujoco.MjSpec) -> list[mujoco.MjsGeom]:
    """The shapes that stand for the part: its hull, or its convex pieces in runs of earlier versions."""
    return [geom for geom in spec.body("object").geoms if _IS_PART.fullmatch(geom.name)]


def light(spec: mujoco.MjSpec, centre: Floats) -> None:
    """Sky, patterned floor, a key light that casts shadows and a fill light from the other side."""
    import mujoco

    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.97, 0.98, 1.0],
        rgb2=[0.72, 0.78, 0.86],
        width=512,
        height=3072,
    )
    spec.add_texture(
        name="grid",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
        mark=mujoco.mjtMark.mjMARK_EDGE,
        rgb1=[0.86, 0.87, 0.88],
        rgb2=[0.86, 0.87, 0.88],
        markrgb=[0.72, 0.74, 0.77],
        width=512,
        height=512,
    )
    textures = [""] * int(mujoco.mjtTextureRole.mjNTEXROLE)
    textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "grid"
    # One square of the pattern is half a metre.
    spec.add_material(
        name="floor",
        textures=textures,
        texuniform=True,
        texrepeat=[2, 2],
        reflectance=0.0,
        specular=0.0,
        shininess=0.0,
    )
    floor = spec.geom("floor")
    floor.material, floor.rgba = "floor", [1, 1, 1, 1]
    floor.size = [0.0, 0.0, 0.1]  # drawn to the horizon; a plane is endless to collisions anyway
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.40] * 3, [0.22] * 3
    spec.visual.headlight.specular = [0.05] * 3
    for lamp in list(spec.lights):
        spec.delete(lamp)
    aim = np.array([0.5 * centre[0], 0.5 * centre[1], 0.4])
    for place, diffuse, specular, shadows in (
        ([1.6, -2.6, 4.2], [0.62, 0.61, 0.58], 0.3, True),
        ([-2.5, 3.0, 3.0], [0.20, 0.22, 0.26], 0.0, False),
    ):
        direction = aim - place
        spec.worldbody.add_light(
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            pos=place,
            dir=direction / np.linalg.norm(direction),
            diffuse=diffuse,
            specular=[specular] * 3,
            castshadow=shadows,
        )
    spec.visual.quality.shadowsize = 4096
    spec.visual.map.znear, spec.visual.map.zfar, spec.visual.map.shadowclip = 0.01, 30.0, 1.2
    spec.visual.rgba.haze = [0.93, 0.95, 0.97, 1.0]
    spec.stat.extent, spec.stat.center = 2.0, aim


def show_surface(spec: mujoco.MjSpec, name: str, mesh: TriangleMesh, hulls: Sequence[mujoco.MjsGeom]) -> None:
    """A true surface, in the frame of the body that has the convex shapes, in place of these."""
    import mujoco

    shown = decimate(mesh, VIEW_FACES) if len(mesh.faces) > VIEW_FACES else mesh
    add_mesh(spec, name, shown, smooth=True)
    hulls[0].parent.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=name,
        material=hulls[0].material,
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


def _chamfer(spec: mujoco.MjSpec, box: mujoco.MjsGeom) -> None:
    """Show a box of the robot with its edges taken off, inside the checked box, which moves to a hidden group."""
    import mujoco

    half = np.array(box.size)
    cut = min(0.022, 0.4 * float(half.min()))
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    corners = np.concatenate([signs * (half - cut * (1 - np.eye(3)[axis])) for axis in range(3)])
    spec.add_mesh(name=f"{box.name}_look", uservert=corners.ravel())
    box.parent.add_geom(
        name=f"{box.name}_look",
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=f"{box.name}_look",
        pos=box.pos,
        quat=box.quat,
        material=box.material,
        group=_VISUAL_GROUP,
        contype=0,
        conaffinity=0,
    )
    box.group = _HIDDEN_GROUP
