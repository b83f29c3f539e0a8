"""Closed-form test meshes."""

import numpy as np
import trimesh

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
