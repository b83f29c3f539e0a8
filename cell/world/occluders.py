"""Occluders: triangles of everything that can be between scanner and part, for the ray caster.

Cylinders become circumscribed prisms, the floor a large square. A mesh fixture has its true triangles, not the convex
hull of collision checks. Arm and scanner move: `arm_occluders` returns their shapes at one configuration.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cell.robot import model as robot
from cell.robot.model import mesh_of
from cell.world.embree import EmbreeRayCaster
from cell.world.model import World
from planner.geometry.mesh import TriangleMesh, concatenate_meshes
from planner.kinematics.rotary_table import RotaryTable
from planner.ports import ARM_AXES
from planner.values import Floats, Value, readonly

if TYPE_CHECKING:
    import mujoco


_SIDES = 48  # of a prism around a cylinder: its corners exceed the radius by 0.2 %
_FLOOR_HALF = 10.0  # m
_NEAR = 1e-4  # m; margin of the box test before a point is tested against a convex shape

_BOX_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
_BOX_FACES = np.array(
    [
        *([0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]),
        *([2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]),
    ],
    dtype=np.int32,
)


@dataclass(frozen=True, slots=True, eq=False)
class Occluder(Value):
    """A named triangle mesh.

    Attributes:
        name: in reports.
        vertices: [m], object frame unless stated otherwise.
        faces: outward.
    """

    name: str
    vertices: Annotated[Floats, "V 3"]
    faces: Annotated[NDArray[np.int32], "F 3"]


def fixed_occluders(world: World, T_base_object: ArrayLike | None = None) -> tuple[Occluder, ...]:
    """Return post, pedestal, floor and the occluding fixtures, object frame.

    With a rotary table: only what turns with it, the table itself, and the floor below an upright axis, which look the
    same at every angle. The other obstacles occlude differently at each angle (`occluders_beside_table`).

    Args:
        world: the compiled scene.
        T_base_object: (4, 4) placement [m]; None is the scene's.
    """
    T = world.T_base_object if T_base_object is None else readonly("T_base_object", T_base_object, (4, 4))
    beside = _names_beside_table(world)
    return tuple(piece for piece in _all_occluders(world, T) if piece.name not in beside)


def occluders_beside_table(world: World) -> tuple[Occluder, ...]:
    """Return the stationary occluders beside a rotary table, base frame: pedestal, fixtures of the base; else none."""
    beside = _names_beside_table(world)
    if not beside:
        return ()
    T = world.T_base_object
    return tuple(
        Occluder(piece.name, piece.vertices @ T[:3, :3].T + T[:3, 3], piece.faces)
        for piece in _all_occluders(world, T)
        if piece.name in beside
    )


def names_beside_table(table: RotaryTable | None, base_fixtures: Iterable[str]) -> set[str]:
    """Return the names of the obstacles that look different from each angle of a table; none without a table.

    The floor looks the same about an upright axis.
    """
    if table is None:
        return set()
    return {"pedestal", *base_fixtures} | (set() if table.upright else {"floor"})


def _names_beside_table(world: World) -> set[str]:
    return names_beside_table(world.table, (each.name for each in world.scene.fixtures if each.attached_to == "base"))


def _all_occluders(world: World, T_base_object: Floats) -> tuple[Occluder, ...]:
    transparent = [fixture.name for fixture in world.scene.fixtures if not fixture.occludes]
    return occluders_of_model(world.data(T_base_object), T_base_object, world.fixture_meshes, transparent)


def occluders_of_model(
    data: mujoco.MjData, T_base_object: Floats, meshes: Mapping[str, TriangleMesh], transparent: Collection[str]
) -> tuple[Occluder, ...]:
    """Return everything of a compiled model that is neither robot nor part, object frame.

    Args:
        data: a state with part and post at the placement, kinematics up to date.
        T_base_object: (4, 4) the placement [m].
        meshes: triangles of the mesh fixtures by name [m], in the frame of the body of their hulls.
        transparent: names of the fixtures that do not occlude.
    """
    import mujoco

    model = data.model
    pieces: list[tuple[str, Floats, NDArray[np.int32]]] = []
    floor = float(model.geom("floor").pos[2])
    if model.body("post").geomnum[0] and data.body("post").xpos[2] > floor:
        pieces.append(("post", *post_triangles(data, floor)))
    part = model.body("object").id
    for geom in np.flatnonzero((model.geom_bodyid == 0) | (model.geom_bodyid == part)):
        name = model.geom(geom).name
        if name == "floor" or name in transparent:
            continue
        if name in meshes:
            vertices, faces = meshes[name].vertices, meshes[name].faces
            if model.geom_bodyid[geom] == part:
                vertices = vertices @ T_base_object[:3, :3].T + T_base_object[:3, 3]
        elif model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
            continue  # the part
        else:
            vertices, faces = geom_triangles(model, data, int(geom))
        pieces.append((name, vertices, faces))
    pieces.append(("floor", *floor_triangles(floor)))
    to_object = np.linalg.inv(T_base_object)
    return tuple(Occluder(name, v @ to_object[:3, :3].T + to_object[:3, 3], faces) for name, v, faces in pieces)


def post_triangles(data: mujoco.MjData, floor: float, sides: int = _SIDES) -> tuple[Floats, NDArray[np.int32]]:
    """Return the post down to the floor, where its collision shape is longer; on a rotary table down to its face."""
    radius, half = (float(size) for size in data.model.geom("post").size[:2])
    top, R = data.body("post").xpos, data.body("post").xmat.reshape(3, 3)
    length = 2 * half if R[2, 2] <= 0 else min(2 * half, float(top[2] - floor) / float(R[2, 2]))
    vertices, faces = prism_triangles(radius, length, sides)
    return (vertices - [0.0, 0.0, length / 2]) @ R.T + top, faces


def make_caster(pieces: Sequence[Occluder], T: NDArray[np.floating[Any]] | None = None) -> EmbreeRayCaster:
    """Create one ray caster of several pieces, at least one.

    Args:
        pieces: in one frame.
        T: (4, 4) from their frame to that of the rays [m]; None is the identity.
    """
    vertices, faces, _ = concatenate_meshes((piece.vertices, piece.faces) for piece in pieces)
    if T is not None:
        vertices = vertices @ T[:3, :3].T + T[:3, 3]
    return EmbreeRayCaster(vertices, faces.astype(np.int32))


def arm_occluders(world: World, q: ArrayLike, ends: ArrayLike | None = None) -> list[Occluder]:
    """Return the enclosing shapes of base, arm, bracket and housing at one configuration, base frame.

    Args:
        world: the compiled scene.
        q: (axes,) joint angles [rad], KUKA signs.
        ends: (n, 3) source and sensor [m], scanner frame. A shape that contains one of them has a window there and is
            left out. With its front face in the plane of the source (the default), the housing occludes nothing. None:
            the housing is left out, and nothing else.
    """
    import mujoco

    data = world.data()
    data.qpos[:] = world.mimic_joints.qpos(readonly("q", q, (len(world.home),))[:ARM_AXES])
    mujoco.mj_kinematics(world.model, data)
    links = robot.bodies(world.model)
    names = (*links, "bracket") if ends is None else (*links, "bracket", "housing")
    pieces = [
        Occluder(name, *geom_triangles(world.model, data, geom, mesh=world.shapes.meshes.get(geom)))
        for geom, name in enumerate(world.entities)
        if name in names
    ]
    if ends is None:
        return pieces
    flange = data.site("flange")
    R = flange.xmat.reshape(3, 3) @ world.T_flange_scanner[:3, :3]
    origin = flange.xpos + flange.xmat.reshape(3, 3) @ world.T_flange_scanner[:3, 3]
    in_base = readonly("ends", ends, (None, 3)) @ R.T + origin
    return [piece for piece in pieces if not _holds_any(piece, in_base)]


def _holds_any(piece: Occluder, points: Floats) -> bool:
    """Return whether one of (n, 3) points [m] is inside a convex piece, or on it within a micrometre."""
    low, high = piece.vertices.min(axis=0) - _NEAR, piece.vertices.max(axis=0) + _NEAR
    points = points[((points >= low) & (points <= high)).all(axis=1)]
    if not len(points):
        return False
    a, b, c = (piece.vertices[piece.faces[:, corner]] for corner in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return bool((np.einsum("ij,nij->ni", normals, points[:, None] - a) <= 1e-6).all(axis=1).any())


def geom_triangles(
    model: mujoco.MjModel, data: mujoco.MjData, geom: int, sides: int = _SIDES, *, mesh: TriangleMesh | None = None
) -> tuple[Floats, NDArray[np.int32]]:
    """Return a geom as triangles, base frame; a cylinder is a prism with a number of sides.

    `mesh` is that of a mesh geom in the frame of its body, if it is known.
    """
    import mujoco

    size = model.geom_size[geom]
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
        mesh, body = mesh or mesh_of(model, geom), int(model.geom_bodyid[geom])
        return mesh.vertices @ data.xmat[body].reshape(3, 3).T + data.xpos[body], mesh.faces
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
        vertices, faces = box_triangles(size)
    else:
        vertices, faces = prism_triangles(float(size[0]), 2 * float(size[1]), sides)
    return vertices @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom], faces


def box_triangles(half: Floats) -> tuple[Floats, NDArray[np.int32]]:
    """Return a box of half sides (3,) [m] about the origin, faces outward."""
    return _BOX_CORNERS * half, _BOX_FACES


def floor_triangles(height: float) -> tuple[Floats, NDArray[np.int32]]:
    """Return a large square at a height [m], base frame."""
    square = _FLOOR_HALF * np.array([[-1.0, -1.0, 0.0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    square[:, 2] = height
    return square, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)


@lru_cache(maxsize=64)  # the arm's cylinders are needed at every configuration
def prism_triangles(radius: float, length: float, sides: int = _SIDES) -> tuple[Floats, NDArray[np.int32]]:
    """Return a prism around a cylinder along z about the origin, faces outward; the arrays are read-only."""
    angles = np.arange(sides) * (2 * np.pi / sides)
    ring = radius / np.cos(np.pi / sides) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    low = np.column_stack([ring, np.full(sides, -length / 2)])
    high = np.column_stack([ring, np.full(sides, length / 2)])
    ends = np.array([[0, 0, -length / 2], [0, 0, length / 2]])
    i = np.arange(sides)
    j = (i + 1) % sides
    bottom, top = np.full(sides, 2 * sides), np.full(sides, 2 * sides + 1)
    faces = np.concatenate(
        [
            np.stack([i, j, sides + j], axis=1),
            np.stack([i, sides + j, sides + i], axis=1),
            np.stack([bottom, j, i], axis=1),
            np.stack([top, sides + i, sides + j], axis=1),
        ]
    )
    vertices, faces = np.concatenate([low, high, ends]), faces.astype(np.int32)
    vertices.setflags(write=False)
    faces.setflags(write=False)
    return vertices, faces
