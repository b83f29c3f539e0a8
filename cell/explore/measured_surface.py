"""The surface of all points and where it leads: what a stage is planned on once little is open between the voxels.

Voxels fill what is narrower than twice the depth to which a part is believed, a tube or a slot, and hide from the
planning the walls that lead into it. The surface of all points hides nothing. It is continued a little way beyond its
border, along its last normals; what lies before it there is no part's. Where that leads on into what nobody saw stands
what is left of the believed surface, a lid across the tube. All of it is cut off where space was seen free.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from cell.explore import belief
from cell.reconstruction.cloud import PointCloud, ScanCloud, merge
from cell.reconstruction.implicit import ImplicitSurface
from cell.reconstruction.reconstruct import REACH, reconstruct
from cell.run.executions import ExecutedScan
from planner.explore.space import OCCUPIED, UNKNOWN, VoxelSpace
from planner.surface.mesh import TriangleMesh, joined
from planner.values import Floats

_ONWARD = 4.0
"""Edges of a voxel by which the surface is continued. Of 4, 6 and 8 the one with which most is measured of tubes."""

_APART = 0.5
"""Edges of the cubes of which one point is kept: what is planned on need not be finer than what is sampled of it."""

_GRID = 0.75  # of an edge: what the surface is made with
_BEFORE = 0.5  # edges before the surface from where on nothing is believed
_BESIDE = 2.0  # edges about the surface within which no believed one stands beside it


def surface_of(scans: Sequence[ExecutedScan]) -> TriangleMesh | None:
    """The surface of all scans, explored frame [m]; None where the points describe none."""
    return reconstruct(merge([ScanCloud(scan.points, scan.T_reported[:3, 3]) for scan in scans])).mesh


def continued(scans: Sequence[ExecutedScan], space: VoxelSpace) -> TriangleMesh | None:
    """The surface of points that lie half a voxel apart, and where it leads, explored frame [m].

    Sheets thinner than two thirds of a voxel may be missing, or have one side.

    Args:
        scans: all of them.
        space: what is known after them; where it is free, or voted down, nothing goes on.

    Returns:
        What a stage is planned on; None where the points describe no surface.
    """
    apart = _APART * space.edge
    # Of each scan before the normals are made, which saves most of their time, then of what scans have in common.
    cloud = merge([ScanCloud(scan.points[_apart(scan.points, apart)], scan.T_reported[:3, 3]) for scan in scans])
    first = _apart(cloud.points, apart)
    cloud = PointCloud(cloud.points[first], cloud.normals[first], cloud.scan[first])
    found = reconstruct(cloud, grid=_GRID * space.edge, reach=_ONWARD * space.edge)
    if found.mesh is None:
        return None
    middles = found.mesh.centres
    measured = np.isfinite(cKDTree(cloud.points).query(middles, distance_upper_bound=REACH * found.spacing)[0])
    kept = measured | space.at(middles, space.possible).astype(np.bool_)
    surface = TriangleMesh(found.mesh.vertices, found.mesh.faces[kept])
    vertices, faces, _ = joined([(surface.vertices, surface.faces), _lids(cloud, space, surface)])
    return TriangleMesh(vertices, faces.astype(np.int32))


def _lids(cloud: PointCloud, space: VoxelSpace, surface: TriangleMesh) -> tuple[Floats, NDArray[np.int32]]:
    """Vertices [m] and faces of the believed surface where the other one does not lead.

    Of what is believed, without what lies before that surface.
    """
    believed = space.believed()
    near = ndimage.maximum_filter((space.state == OCCUPIED).view(np.uint8), 2 * int(_ONWARD) + 1)
    doubtful = believed & near.view(np.bool_) & (space.state == UNKNOWN)  # what was hit stays
    field = ImplicitSurface(cloud).evaluate(space.centres(doubtful))
    before = (field.distance > _BEFORE * space.edge) & (field.nearest <= _ONWARD * space.edge)
    believed[doubtful] = ~before
    lids = belief.surface_about(space, believed)
    far = cKDTree(surface.centres).query(lids.centres, distance_upper_bound=_BESIDE * space.edge)[0]
    alone = ~np.isfinite(far) & ~space.seen(lids.centres, lids.normals)
    return lids.vertices, lids.faces[alone]


def _apart(points: Floats, sides: float) -> NDArray[np.intp]:
    """Of the points (N, 3) [m], those that are the first in a cube with such sides [m]."""
    if not len(points):
        return np.empty(0, dtype=np.intp)
    cubes = np.floor(points / sides).astype(np.int64)
    cubes -= cubes.min(axis=0)
    number = np.ravel_multi_index(tuple(cubes.T), tuple(cubes.max(axis=0) + 1))
    return np.sort(np.unique(number, return_index=True)[1])
