"""The surface of all points and where it leads: what a stage is planned on once little is open between the voxels.

Voxels fill what is narrower than twice the depth to which a part is believed, a tube or a slot, and hide from the
planning the walls that lead into it. The surface of all points hides nothing. It is continued a little way beyond its
border, along its last normals; what lies before it there is no part's. Where no face of it looks to the same side
stands what is left of the believed surface: a lid across a tube, the side of a sheet that nobody saw, or that is too
thin for the other one to have it. All of it is cut off where space was seen free.
"""

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from cell.explore import belief
from cell.metrology.reconstruct import REACH, ReconstructionStatus, reconstruct
from cell.runs.run import ExecutedScan
from planner.explore.space import UNKNOWN, VoxelSpace, first_in_cubes
from planner.geometry.mesh import TriangleMesh, concatenate_meshes
from planner.registration.cloud import PointCloud, ScanCloud, merge
from planner.values import Bools

_ONWARD = 4.0
"""Edges of a voxel by which the surface is continued. Of 4, 6 and 8 the one with which most is measured of tubes."""

_APART = 0.5
"""Edges of the cubes of which one point is kept: what is planned on need not be finer than what is sampled of it."""

_MOST = 40_000
"""Cubes at most: where there would be more they are larger. A stage's plan is as good, and takes half the time."""

_GRID = 1.5  # sides of those cubes: what the surface is made with
_AHEAD = 0.5  # edges before the surface from where on nothing is believed
_BESIDE, _FACES = 2.0, 3
"""Edges about a face of the believed surface, and how many faces of the other one next to it, of which one looks to the
same side where the believed one has no place."""


def surface_of(scans: Sequence[ExecutedScan]) -> TriangleMesh | None:
    """The surface of all scans, explored frame [m]; None where the points describe none."""
    return reconstruct(merge([ScanCloud(scan.points, scan.T_reported[:3, 3]) for scan in scans])).mesh


def continued(scans: Sequence[ExecutedScan], space: VoxelSpace, believed: Bools) -> TriangleMesh | None:
    """The surface of points that lie half a voxel apart or more, and where it leads, explored frame [m].

    Args:
        scans: all of them.
        space: what is known after them; where it is free, or voted down, nothing goes on.
        believed: (X, Y, Z) the voxels that the part is believed to fill.

    Returns:
        What a stage is planned on; None where there are too few points.
    """
    points, apart = _thinned(scans, _APART * space.edge)
    found = reconstruct(merge(points), grid=_GRID * apart, reach=_ONWARD * space.edge)
    if found.status is ReconstructionStatus.TOO_FEW_POINTS:
        return None
    parts, tree = list[TriangleMesh](), cKDTree(found.cloud.points, balanced_tree=False, compact_nodes=False)
    if found.mesh is not None:
        middles = found.mesh.centres
        near = tree.query(middles, distance_upper_bound=REACH * found.spacing, workers=2)[0]
        parts += _chosen(found.mesh, np.isfinite(near) | space.values_at(middles, space.maybe_part).astype(np.bool_))
    lids = belief.surface_about(space, believed & ~_ahead_of(found.cloud, tree, space, believed))
    parts += _chosen(lids, ~_looks_alike(lids, parts[0], _BESIDE * space.edge)) if parts else [lids]
    vertices, faces, _ = concatenate_meshes([(each.vertices, each.faces) for each in parts])
    return TriangleMesh(vertices, faces.astype(np.int32))


def _thinned(scans: Sequence[ExecutedScan], apart: float) -> tuple[list[ScanCloud], float]:
    """Of all scans the first point of each cube with such sides [m]; and the sides, longer where cubes were too many.

    Before the normals are made, which saves most of their time.
    """
    points = np.concatenate([scan.points for scan in scans]) if scans else np.empty((0, 3))
    number = np.repeat(np.arange(len(scans)), [len(scan.points) for scan in scans])
    kept = first_in_cubes(points, apart)
    while len(kept) > _MOST:
        apart *= np.sqrt(len(kept) / _MOST) + 0.01
        kept = kept[first_in_cubes(points[kept], apart)]
    points, number = points[kept], number[kept]
    clouds = [ScanCloud(points[number == each], scan.T_reported[:3, 3]) for each, scan in enumerate(scans)]
    return clouds, apart


def _ahead_of(cloud: PointCloud, tree: cKDTree, space: VoxelSpace, believed: Bools) -> Bools:
    """(X, Y, Z) the believed voxels before the surface of a cloud and where it is continued; not one that was hit.

    `tree` is of its points.
    """
    doubtful = believed & (space.state == UNKNOWN)
    centres = space.centres(doubtful)
    nearest, at = map(np.asarray, tree.query(centres, distance_upper_bound=_ONWARD * space.edge, workers=2))
    near = np.isfinite(nearest)
    legs, normals = centres[near] - cloud.points[at[near]], cloud.normals[at[near]]
    ahead, of_near = np.zeros(doubtful.shape, dtype=np.bool_), np.zeros(len(near), dtype=np.bool_)
    of_near[near] = np.einsum("nj,nj->n", legs, normals) > _AHEAD * space.edge
    ahead[doubtful] = of_near
    return ahead


def _looks_alike(lids: TriangleMesh, surface: TriangleMesh, distance: float) -> Bools:
    """(F,) which faces of `lids` have one of the surface next to them, at a distance [m], that looks to their side."""
    _, at = cKDTree(surface.centres).query(lids.centres, _FACES, distance_upper_bound=distance, workers=2)
    normals = np.concatenate([surface.normals, np.zeros((1, 3))])[np.asarray(at)]  # the last of what is too far
    return np.asarray((np.einsum("fkj,fj->fk", normals, lids.normals) > 0).any(axis=1))


def _chosen(mesh: TriangleMesh, chosen: Bools) -> list[TriangleMesh]:
    """The mesh of the chosen faces; none where there are none, as no mesh is empty."""
    if not chosen.any():
        return []
    used, faces = np.unique(mesh.faces[chosen], return_inverse=True)
    return [TriangleMesh(mesh.vertices[used], faces.reshape(-1, 3).astype(np.int32))]
