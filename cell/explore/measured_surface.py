"""The surface of all points and where it leads: what a stage is planned on once little is open between the voxels.

Voxels fill what is narrower than twice the depth to which a part is believed, a tube or a slot, and hide from the
planning the walls that lead into it. The surface of all points hides nothing. It is continued a little way beyond its
border, along its last normals; what lies before it there is no part's. Where that leads on into what nobody saw stands
what is left of the believed surface, a lid across the tube; so it does on the side of a sheet that nobody saw, and of
one that is too thin for the surface. All of it is cut off where space was seen free.
"""

from collections.abc import Sequence

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from cell.explore import belief
from cell.reconstruction.cloud import PointCloud, ScanCloud, merge
from cell.reconstruction.reconstruct import REACH, ReconstructionStatus, reconstruct
from cell.run.executions import ExecutedScan
from planner.explore.cubes import first_in_cubes, first_of_each_side
from planner.explore.space import OCCUPIED, UNKNOWN, VoxelSpace
from planner.surface.mesh import TriangleMesh, joined
from planner.values import Bools

_ONWARD = 4.0
"""Edges of a voxel by which the surface is continued. Of 4, 6 and 8 the one with which most is measured of tubes."""

_APART = 0.5
"""Edges of the cubes of which one point is kept: what is planned on need not be finer than what is sampled of it."""

_MOST = 40_000
"""Cubes: where there would be more, they are larger. A stage's plan is as good, and takes half the time."""

_ELSEWHERE = 0.7
"""Cosine of the angle between two looks at a cube, of 45 degrees, from which on they may be at two sides of a sheet."""

_GRID = 1.5  # sides of those cubes: what the surface is made with
_BEFORE = 0.5  # edges before the surface from where on nothing is believed
_BESIDE = 2.0  # edges about the surface within which no believed one stands on the same side
_FACES = 3  # of the surface next to a believed one that are asked for their side


def surface_of(scans: Sequence[ExecutedScan]) -> TriangleMesh | None:
    """The surface of all scans, explored frame [m]; None where the points describe none."""
    return reconstruct(merge([ScanCloud(scan.points, scan.T_reported[:3, 3]) for scan in scans])).mesh


def continued(scans: Sequence[ExecutedScan], space: VoxelSpace, believed: Bools) -> TriangleMesh | None:
    """The surface of points that lie half a voxel apart, and where it leads, explored frame [m].

    Args:
        scans: all of them.
        space: what is known after them; where it is free, or voted down, nothing goes on.
        believed: (X, Y, Z) the voxels that the part is believed to fill.

    Returns:
        What a stage is planned on; None where there are too few points.
    """
    cloud, apart = _spread(scans, _APART * space.edge)
    found = reconstruct(cloud, grid=_GRID * apart, reach=_ONWARD * space.edge)
    if found.status is ReconstructionStatus.TOO_FEW_POINTS:
        return None
    parts = list[TriangleMesh]()
    if found.mesh is not None:
        middles = found.mesh.centres
        near = cKDTree(found.cloud.points).query(middles, distance_upper_bound=REACH * found.spacing)[0]
        parts += _some(found.mesh, np.isfinite(near) | space.at(middles, space.possible).astype(np.bool_))
    lids = belief.surface_about(space, believed & ~_before(found.cloud, space, believed))
    for surface in tuple(parts):
        parts += _some(lids, ~_beside(surface, lids, _BESIDE * space.edge))
    vertices, faces, _ = joined([(each.vertices, each.faces) for each in parts or [lids]])
    return TriangleMesh(vertices, faces.astype(np.int32))


def _spread(scans: Sequence[ExecutedScan], apart: float) -> tuple[PointCloud, float]:
    """One point of each cube with such sides [m], two of one that holds two sides of a sheet; and the sides.

    They are longer where there would be more than `_MOST` cubes.
    """
    points = np.concatenate([scan.points for scan in scans]) if scans else np.empty((0, 3))
    number = np.repeat(np.arange(len(scans)), [len(scan.points) for scan in scans])
    sights = np.array([scan.T_reported[:3, 3] for scan in scans]).reshape(-1, 3)[number] - points
    sights /= np.maximum(np.linalg.norm(sights, axis=1, keepdims=True), 1e-12)
    # Before the normals are made, which saves most of their time; and after, as sights tell sides less well.
    kept = first_of_each_side(points, sights, apart, _ELSEWHERE)
    if (many := len(first_in_cubes(points[kept], apart))) > _MOST:
        apart *= np.sqrt(many / _MOST)
        kept = kept[first_of_each_side(points[kept], sights[kept], apart, _ELSEWHERE)]
    points, number = points[kept], number[kept]
    cloud = merge([ScanCloud(points[number == each], scan.T_reported[:3, 3]) for each, scan in enumerate(scans)])
    kept = first_of_each_side(cloud.points, cloud.normals, apart, 0.0)
    return PointCloud(cloud.points[kept], cloud.normals[kept], cloud.scan[kept]), apart


def _before(cloud: PointCloud, space: VoxelSpace, believed: Bools) -> Bools:
    """(X, Y, Z) the believed voxels before the surface of a cloud and where it is continued; not one that was hit."""
    near = ndimage.maximum_filter((space.state == OCCUPIED).view(np.uint8), 2 * int(_ONWARD) + 1)
    doubtful = believed & near.view(np.bool_) & (space.state == UNKNOWN)
    centres = space.centres(doubtful)
    tree, farthest = cKDTree(cloud.points), _ONWARD * space.edge
    nearest, at = map(np.asarray, tree.query(centres, distance_upper_bound=farthest, workers=2))
    beside = np.isfinite(nearest)
    legs, normals = centres[beside] - cloud.points[at[beside]], cloud.normals[at[beside]]
    beside[beside] = np.einsum("nj,nj->n", legs, normals) > _BEFORE * space.edge
    before = np.zeros(doubtful.shape, dtype=np.bool_)
    before[doubtful] = beside
    return before


def _beside(surface: TriangleMesh, lids: TriangleMesh, distance: float) -> Bools:
    """(F,) beside which faces of `lids`, at a distance [m], there is one of the surface that looks to the same side."""
    _, at = cKDTree(surface.centres).query(lids.centres, _FACES, distance_upper_bound=distance, workers=2)
    at = np.asarray(at).reshape(-1, _FACES)
    found = at < len(surface.faces)
    normals = np.concatenate([surface.normals, np.zeros((1, 3))])[at]
    return np.asarray((found & (np.einsum("fkj,fj->fk", normals, lids.normals) > 0)).any(axis=1))


def _some(mesh: TriangleMesh, chosen: Bools) -> list[TriangleMesh]:
    """The mesh of the chosen faces; none where there are none, as no mesh is empty."""
    if not chosen.any():
        return []
    used, faces = np.unique(mesh.faces[chosen], return_inverse=True)
    return [TriangleMesh(mesh.vertices[used], faces.reshape(-1, 3).astype(np.int32))]
