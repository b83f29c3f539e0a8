"""Mesh an implicit shape: marching cubes near its surface, then decimation to an exact number of faces.

The field is evaluated from coarse to fine blocks near the surface. Marching cubes (Lewiner et al. 2003, scikit-image)
extract the mesh. Each quadric edge collapse removes two faces, so an even count is met exactly.
"""

import numpy as np
from numpy.typing import NDArray

from benchmarks.part_models.fields import Field
from planner.geometry.decimation import collapse_edges
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats, Ints32

Grid = NDArray[np.float32]

_COARSE, _FINE = 16, 4  # cells along an edge of the blocks of the two levels
_SLACK = 1.6  # the fields are not exact distances: a block is skipped if the surface is 1.6 times its reach away
_CHUNK = 32768  # points of a call; temporaries of this size stay in the processor's cache
_SNAP = 0.03  # cells: values nearer to zero are pushed away, so that no vertex falls on a grid point (no slivers)


def mesh_of(field: Field, low: tuple[float, ...], high: tuple[float, ...], cell: float) -> TriangleMesh:
    """Return the largest body of the field's zero set, closed, with outward faces.

    Args:
        field: the shape [mm].
        low: corner of a box around the shape with a margin of one cell [mm].
        high: the opposite corner.
        cell: edge of a grid cell [mm].

    Returns:
        The mesh in millimetres.
    """
    from skimage.measure import marching_cubes

    values = _sample(field, np.array(low), np.array(high), cell)
    vertices, faces, _, _ = marching_cubes(values, 0.0)
    faces = _largest_body(faces, len(vertices))
    used, faces = np.unique(faces, return_inverse=True)
    faces = faces.reshape(-1, 3).astype(np.int32)
    points = vertices[used].astype(np.float64) * cell + np.array(low)
    return TriangleMesh(points, faces)


def collapsed_to(mesh: TriangleMesh, face_count: int) -> tuple[Floats, Ints32]:
    """Decimate a closed mesh to an exact number of faces.

    Returns:
        The vertices in shares of the diagonal of `mesh`, and the faces.

    Raises:
        ArithmeticError: if the count is missed because of the cell size of the shape.
    """
    vertices, faces = collapse_edges(mesh.vertices / mesh.diagonal, mesh.faces, face_count, 7)
    if len(faces) != face_count:
        raise ArithmeticError(f"{len(mesh.faces)} faces were reduced to {len(faces)}, not to {face_count}")
    return vertices, faces


def _sample(field: Field, low: NDArray[np.float64], high: NDArray[np.float64], cell: float) -> Grid:
    """Sample the field on a grid; far from the surface the value is a large constant of the right sign."""
    blocks = np.ceil((high - low) / (cell * _COARSE)).astype(int)
    shape = blocks * _COARSE

    def evaluate(indices: NDArray[np.float32]) -> Grid:
        out = np.empty(indices.shape[1], np.float32)
        origin = low.astype(np.float32)[:, None]
        for start in range(0, len(out), _CHUNK):
            part = slice(start, start + _CHUNK)
            out[part] = field(indices[:, part] * np.float32(cell) + origin)
        return out

    def centres(corners: NDArray[np.int64], edge: int) -> NDArray[np.float32]:
        return (corners + (edge - 1) / 2).astype(np.float32)

    def near(values: Grid, edge: int) -> NDArray[np.bool_]:
        reached: NDArray[np.bool_] = np.abs(values) < _SLACK * np.sqrt(3) / 2 * edge * cell
        return reached

    corners = np.stack(np.meshgrid(*(np.arange(n) * _COARSE for n in blocks), indexing="ij")).reshape(3, -1)
    coarse = evaluate(centres(corners, _COARSE))
    ratio = _COARSE // _FINE
    fine = np.repeat(coarse.reshape(blocks), ratio, 0).repeat(ratio, 1).repeat(ratio, 2)
    open_blocks = corners[:, near(coarse, _COARSE)] // _FINE
    inside = np.stack(np.meshgrid(*([np.arange(ratio)] * 3), indexing="ij")).reshape(3, -1)
    corners = (open_blocks[:, :, None] + inside[:, None]).reshape(3, -1)
    values = evaluate(centres(corners * _FINE, _FINE))
    fine[tuple(corners)] = values
    grid = np.repeat(np.where(fine < 0, np.float32(-1e3), np.float32(1e3)), _FINE, 0).repeat(_FINE, 1).repeat(_FINE, 2)

    corners = corners[:, near(values, _FINE)] * _FINE
    inside = np.stack(np.meshgrid(*([np.arange(_FINE)] * 3), indexing="ij")).reshape(3, -1)
    points = (corners[:, :, None] + inside[:, None]).reshape(3, -1)
    values = evaluate(points.astype(np.float32)) / np.float32(cell)
    values = np.where(np.abs(values) < _SNAP, np.where(values < 0, -np.float32(_SNAP), np.float32(_SNAP)), values)
    grid.ravel()[np.ravel_multi_index(tuple(points), tuple(shape))] = values
    return grid


def _largest_body(faces: NDArray[np.int32], n_vertices: int) -> NDArray[np.int32]:
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    rows, columns = faces[:, [0, 1]].T.ravel(), faces[:, [1, 2]].T.ravel()
    graph = coo_array((np.ones(len(rows), np.int8), (rows, columns)), shape=(n_vertices, n_vertices))
    label = connected_components(graph, directed=False)[1][faces[:, 0]]
    largest: NDArray[np.int32] = faces[label == np.bincount(label).argmax()]
    return largest
