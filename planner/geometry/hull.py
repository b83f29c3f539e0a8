"""Convex hulls of meshes for collision checks, with thickness where the mesh has none.

A collision engine needs a solid. A flat sheet or a straight wire is thickened by `MIN_THICKNESS` across its flat
directions; the thickened solid contains the mesh. The hull of a hollow part is larger than the part: nothing ever
reaches into a mug.
"""

from functools import lru_cache

import numpy as np

from planner.errors import PlannerError
from planner.geometry.mesh import TriangleMesh, without_unused
from planner.values import Floats

MIN_THICKNESS = 2e-4  # m; far below any useful clearance, and still a solid for the engine

CONVEX = 1e-3
"""Largest depth of a face below its mesh's hull at which the hull represents the mesh [m]."""

_BLOCK = 1024  # points that are compared with all planes of a hull at a time: with thousands of planes some 20 MB


def solid_hull(vertices: Floats, name: str = "part") -> TriangleMesh:
    """Compute the convex hull of points, at least `MIN_THICKNESS` thick in every direction.

    Args:
        vertices: (N, 3) [m], any frame, N > 0.
        name: name of the mesh in the error.

    Returns:
        The hull in the same frame, faces outward, without unused vertices.

    Raises:
        PlannerError: if a coordinate is not finite, or the thickened points have no hull.
    """
    from scipy.spatial import ConvexHull, QhullError

    points = np.asarray(vertices, dtype=np.float64)
    if points.ndim != 2 or points.shape[1:] != (3,) or not len(points) or not np.isfinite(points).all():
        raise PlannerError(
            f"the {name} has no finite vertices (shape {points.shape}); give a mesh with triangles in it"
        )
    middle = (points.min(axis=0) + points.max(axis=0)) / 2  # a hull far from the origin would lose digits
    try:
        local = _thickened(points - middle)
        hull = ConvexHull(local)
    except (QhullError, np.linalg.LinAlgError) as error:
        raise PlannerError(f"the {name} has no convex hull; check its scale and units") from error
    corners = local[hull.simplices]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.einsum("fj,fj->f", normals, hull.equations[:, :3]) < 0
    simplices = np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices)
    return without_unused(local + middle, simplices)


def _thickened(points: Floats) -> Floats:
    """Return the points, doubled to both sides across every principal direction in which they are flat."""
    spread = points - points.mean(axis=0)
    _, axes = np.linalg.eigh(spread.T @ spread)
    for axis in axes.T:
        if np.ptp(points @ axis) < MIN_THICKNESS:
            points = np.concatenate([points - axis * MIN_THICKNESS / 2, points + axis * MIN_THICKNESS / 2])
    return points


def is_convex(mesh: TriangleMesh) -> bool:
    """Return whether no middle of a face or edge is deeper than `CONVEX` below the mesh's convex hull."""
    return _is_convex(mesh.vertices.tobytes(), mesh.faces.tobytes())


@lru_cache(maxsize=64)  # the links of a few robots, of which every scene has its own copies
def _is_convex(vertex_bytes: bytes, face_bytes: bytes) -> bool:
    from scipy.spatial import ConvexHull, QhullError  # kept out of the start-up

    vertices = np.frombuffer(vertex_bytes).reshape(-1, 3)
    try:
        planes = np.unique(ConvexHull(vertices).equations, axis=0)
    except QhullError:
        return False
    corners = vertices[np.frombuffer(face_bytes, dtype=np.int32).reshape(-1, 3)]
    points = np.concatenate([corners.mean(axis=1), *(corners[:, [i, i - 1]].mean(axis=1) for i in range(3))])
    blocks = (points[begin : begin + _BLOCK] for begin in range(0, len(points), _BLOCK))
    depths = (-(block @ planes[:, :3].T + planes[:, 3]).max(axis=1) for block in blocks)
    return all(bool(depth.max() <= CONVEX) for depth in depths)
