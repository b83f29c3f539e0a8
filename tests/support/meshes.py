"""Closed-form test meshes."""

import numpy as np
import trimesh

from cell.world.embree import EmbreeRayCaster
from planner.geometry.mesh import TriangleMesh


def sphere(subdivisions: int = 4, radius: float = 0.1) -> TriangleMesh:
    """Return an icosphere [m]."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return TriangleMesh(ball.vertices, ball.faces)


def box(x: float = 0.1, y: float = 0.2, z: float = 0.3) -> TriangleMesh:
    """Return a box of twelve faces about the origin [m]."""
    body = trimesh.creation.box(extents=(x, y, z))
    return TriangleMesh(body.vertices, body.faces)


def with_zero_area_faces(mesh: TriangleMesh) -> TriangleMesh:
    """Return the mesh with a degenerate face before, between and after its own."""
    first, *_, last = mesh.faces
    slivers = [[first[0], first[0], first[1]], [last[0], last[1], last[1]], [last[2], last[2], last[2]]]
    half = len(mesh.faces) // 2
    return TriangleMesh(
        mesh.vertices, np.vstack([[slivers[0]], mesh.faces[:half], [slivers[1]], mesh.faces[half:], [slivers[2]]])
    )


def as_triangles(mesh: trimesh.Trimesh) -> TriangleMesh:
    """Return the triangles of a trimesh mesh."""
    return TriangleMesh(mesh.vertices, mesh.faces)


def block(size: object, centre: object = (0, 0, 0)) -> TriangleMesh:
    """Return a box with outward faces, two consecutive triangles on each side [m]."""
    corners = (np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) - 0.5) * size + centre
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return TriangleMesh(corners, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]))


def joined(*meshes: TriangleMesh) -> TriangleMesh:
    """Return one mesh of several."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts[:-1], strict=True)]
    return TriangleMesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))


def caster_of(mesh: TriangleMesh) -> EmbreeRayCaster:
    """Return a ray caster of a mesh."""
    return EmbreeRayCaster(mesh.vertices, mesh.faces)
