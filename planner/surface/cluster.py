"""A coarse copy of a mesh with very many faces: one vertex for all that lie in a cell of a grid.

Vertex clustering (Rossignac, Borrel 1993, "Multi-resolution 3D approximations for rendering complex scenes",
doi:10.1007/978-3-642-78114-8_29) takes 0.3 s for a million faces, where edge collapse takes 3 s and 400 MB. Edges are
blunted by up to a cell, so it serves where the copy is far finer than what is made of it, and for pictures.
"""

import numpy as np

from planner.surface.mesh import TriangleMesh, cross_products
from planner.values import Ints, Ints32

FAR = 2.5
"""A mesh is clustered where it has so many times the faces that are wanted."""

_CELLS = 3.0  # faces for each cell's side squared in the surface: it meets 1.5 cells, and a vertex has two faces
_OPPOSED = 0.3  # of its area is what the faces of a cell face together: below, they are two sides of a wall, or a fold
_THIN = 0.05  # of the area that may be such: with more, walls are thinner than a cell


def clustered(mesh: TriangleMesh, face_count: int) -> TriangleMesh | None:
    """The copy, with about so many faces.

    Faces that come to lie on each other with opposite windings cancel, as those of a fold do.

    Args:
        mesh: any frame; its regions are not looked at.
        face_count: how many faces are wanted, > 0.

    Returns:
        The copy, each vertex in the middle of those that it stands for; None where the mesh has less than `FAR` times
        the faces, or walls so thin that their two sides would fall into one.
    """
    if len(mesh.faces) < FAR * face_count:
        return None
    side = np.sqrt(_CELLS * float(mesh.areas.sum()) / face_count)
    cells = ((mesh.vertices - mesh.vertices.min(axis=0)) / side).astype(np.int64)
    count = cells.max(axis=0) + 1
    _, cell = np.unique((cells[:, 0] * count[1] + cells[:, 1]) * count[2] + cells[:, 2], return_inverse=True)
    if _share_of_walls(mesh, cell[mesh.faces[:, 0]]) > _THIN:
        return None
    members = np.bincount(cell)
    vertices = np.stack([np.bincount(cell, weights=axis) / members for axis in mesh.vertices.T], axis=1)
    faces = cell.astype(np.int32)[mesh.faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    kept = _uncancelled(faces, len(vertices))
    if not len(kept):
        return None
    used, compact = np.unique(kept, return_inverse=True)
    return TriangleMesh(vertices[used], compact.reshape(-1, 3).astype(np.int32))


def _share_of_walls(mesh: TriangleMesh, cell: Ints) -> float:
    """Share of the area whose faces, by the (F,) cell of each, face against those of their cell."""
    twice = cross_products(mesh.vertices, mesh.faces)
    together = np.linalg.norm([np.bincount(cell, weights=axis) for axis in twice.T], axis=0)
    area = np.bincount(cell, weights=2 * mesh.areas)
    return float(area[together < _OPPOSED * area].sum() / area.sum())


def _uncancelled(faces: Ints32, n_vertices: int) -> Ints32:
    """The faces, of those with the same corners one where the windings do not cancel, none where they do."""
    first = faces.argmin(axis=1)[:, None]
    turned = np.take_along_axis(faces, (first + np.arange(3)) % 3, axis=1)
    low, high = np.minimum(turned[:, 1], turned[:, 2]), np.maximum(turned[:, 1], turned[:, 2])
    _, pair = np.unique(turned[:, 0] * np.int64(n_vertices) + low, return_inverse=True)
    _, at, same = np.unique(pair * np.int64(n_vertices) + high, return_index=True, return_inverse=True)
    winding = np.where(turned[:, 1] < turned[:, 2], 1.0, -1.0)
    left = np.bincount(same, weights=winding)
    return np.asarray(np.where((left * winding[at] < 0)[:, None], turned[at][:, [0, 2, 1]], turned[at])[left != 0])
