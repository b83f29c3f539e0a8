"""The convex hull that stands for a mesh in collision checks, with thickness where the mesh has none.

A collision engine needs a solid. A flat sheet or a straight wire is grown by `MIN_THICKNESS` across its flat
directions; the grown solid contains the mesh. A hull overstates a hollow part: nothing ever reaches into a mug.
"""

import numpy as np

from planner.errors import PlannerError
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats

MIN_THICKNESS = 2e-4  # m; a hundredth of the thinnest clearance that makes sense, and still a solid to the engine


def solid_hull(vertices: Floats, name: str = "part") -> TriangleMesh:
    """Convex hull of points, at least `MIN_THICKNESS` thick in every direction.

    Args:
        vertices: (N, 3) [m], any frame, N > 0.
        name: what the error calls the mesh.

    Returns:
        The hull in the same frame, faces outward, only vertices that the hull has.

    Raises:
        PlannerError: if a coordinate is not finite, or the points have no hull even when grown.
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
    used, compact = np.unique(simplices, return_inverse=True)
    return TriangleMesh(local[used] + middle, compact.reshape(-1, 3).astype(np.int32))


def _thickened(points: Floats) -> Floats:
    """The points, doubled to both sides across every principal direction in which they are flat."""
    spread = points - points.mean(axis=0)
    _, axes = np.linalg.eigh(spread.T @ spread)
    for axis in axes.T:
        if np.ptp(points @ axis) < MIN_THICKNESS:
            points = np.concatenate([points - axis * MIN_THICKNESS / 2, points + axis * MIN_THICKNESS / 2])
    return points


CONVEX = 1e-3
"""How deep a face may lie under a mesh's hull so that the hull stands for it [m]."""


def is_convex(mesh: TriangleMesh) -> bool:
    """Whether no face's middle or corner lies deeper than `CONVEX` under the mesh's convex hull."""
    from scipy.spatial import ConvexHull, QhullError  # kept out of the start-up

    try:
        planes = np.unique(ConvexHull(mesh.vertices).equations, axis=0)
    except QhullError:
        return False
    corners = mesh.vertices[mesh.faces]
    looked_at = np.concatenate([corners.mean(axis=1), *(corners[:, [i, i - 1]].mean(axis=1) for i in range(3))])
    depth = -(looked_at @ planes[:, :3].T + planes[:, 3]).max(axis=1)
    return bool(depth.max() <= CONVEX)
