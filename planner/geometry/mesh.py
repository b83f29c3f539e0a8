"""Triangle meshes: the *reference* mesh is the part, the *planning* mesh its decimated copy (Section 3.1).

Object frame (the axes of the mesh file), metres.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError
from planner.values import Floats, Ints, Ints32, Value, freeze

_BLOCK = 8192  # faces whose corners fit into a core's cache
_ON_PLANE = 1e-9  # share of the diagonal: a vertex nearer to a plane counts as on it


@dataclass(frozen=True, eq=False)  # without slots: normals, areas and centres are cached
class TriangleMesh(Value):
    """A triangle mesh; the corners of a face turn counter-clockwise when seen from outside.

    Attributes:
        vertices: (V, 3) [m], object frame.
        faces: (F, 3) indices of vertices, F > 0.
        region: (F,) number of the region of each face, from 0; -1: the face only hides others and needs no coverage.
            None: the part has no regions.
        diagonal: length of the bounding box's diagonal [m]; tolerances are shares of it.
    """

    vertices: Annotated[Floats, "V 3"]
    faces: Annotated[Ints32, "F 3"]
    region: Annotated[Ints32, "F"] | None = None
    diagonal: float = field(init=False)

    def __post_init__(self) -> None:
        freeze(self)
        if not np.isfinite(self.vertices).all():
            raise PlannerError("vertices contains infinity; every coordinate must be finite")
        if not len(self.faces):
            raise PlannerError("faces is empty; a mesh needs at least one face")
        if self.faces.min() < 0 or self.faces.max() >= len(self.vertices):
            raise PlannerError(
                f"faces refers to vertices {self.faces.min()} to {self.faces.max()}; "
                f"valid are 0 to {len(self.vertices) - 1}"
            )
        if self.region is not None and not (self.region >= 0).any():
            raise PlannerError("region is below 0 for every face; at least one face must belong to a region")
        object.__setattr__(self, "diagonal", float(np.linalg.norm([np.ptp(axis) for axis in self.vertices.T])))

    @cached_property
    def normals(self) -> Floats:
        """(F, 3) outward unit normals; zero for a face without area."""
        cross = face_cross_products(self.vertices, self.faces)
        length = row_norms(cross)[:, None]
        return _read_only(np.divide(cross, length, out=np.zeros_like(cross), where=length > 0))

    @cached_property
    def areas(self) -> Floats:
        """(F,) areas of the faces [m^2]."""
        return _read_only(row_norms(face_cross_products(self.vertices, self.faces)) / 2)

    @cached_property
    def centres(self) -> Floats:
        """(F, 3) centroids of the faces [m]."""
        total: Floats = np.take(self.vertices, self.faces[:, 0], axis=0)
        for corner in self.faces.T[1:]:
            total += np.take(self.vertices, corner, axis=0)
        return _read_only(np.divide(total, 3, out=total))


def face_cross_products(vertices: Floats, faces: NDArray[np.integer]) -> Floats:
    """Return (F, 3) cross products of two edges of each face: outward, their length is twice the area."""
    result: Floats = np.empty((len(faces), 3))
    for start in range(0, len(faces), _BLOCK):
        a, b, c = (np.take(vertices, corner, axis=0) for corner in faces[start : start + _BLOCK].T)
        b -= a
        c -= a
        result[start : start + _BLOCK] = cross_rows(b, c)
    return result


def cross_rows(one: Floats, two: Floats) -> Floats:
    """Return (N, 3) cross products of the rows of two arrays (N, 3); `np.cross` takes three times as long."""
    result: Floats = np.empty_like(one)
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        np.subtract(one[:, i] * two[:, j], one[:, j] * two[:, i], out=result[:, k])
    return result


def row_norms(vectors: Floats) -> Floats:
    """Return (N,) lengths of vectors (N, 3), to the last bit as `np.linalg.norm`, which takes three times as long."""
    x, y, z = vectors.T
    result: Floats = np.sqrt(x * x + y * y + z * z)
    return result


def concatenate_meshes(pieces: Iterable[tuple[Floats, NDArray[np.integer]]]) -> tuple[Floats, Ints, Ints]:
    """Concatenate meshes given as vertices (V, 3) and faces (F, 3); also return the piece of each face."""
    vertices, faces = [np.zeros((0, 3))], [np.zeros((0, 3), np.int64)]
    begin, counts = 0, []
    for corners, triangles in pieces:
        vertices.append(corners)
        faces.append(triangles + np.int64(begin))
        counts.append(len(triangles))
        begin += len(corners)
    return np.concatenate(vertices), np.concatenate(faces), np.repeat(np.arange(len(counts)), counts)


def without_unused(vertices: Floats, faces: NDArray[np.integer]) -> TriangleMesh:
    """Return faces (F, 3) with the vertices that they use, in the same order."""
    used, compact = np.unique(faces, return_inverse=True)
    return TriangleMesh(vertices[used], compact.reshape(-1, 3).astype(np.int32))


def cut_at_plane(mesh: TriangleMesh, axis: int, at: float) -> tuple[TriangleMesh, Ints]:
    """Cut the triangles that cross a plane; the surface stays the same and shared edges stay shared.

    Args:
        mesh: any mesh; its regions are kept.
        axis: 0, 1 or 2: the normal of the plane is x, y or z.
        at: position of the plane on this axis [m].

    Returns:
        The mesh, whose first V vertices are those of `mesh`, and (F',) the triangle of `mesh` that contains each of its
        triangles.
    """
    height = mesh.vertices[:, axis] - at
    side = np.sign(np.where(np.abs(height) <= _ON_PLANE * mesh.diagonal, 0.0, height)).astype(np.int64)
    corner_side = side[mesh.faces]
    crossed = (corner_side.min(axis=1) < 0) & (corner_side.max(axis=1) > 0)
    uncut = np.flatnonzero(~crossed)
    if len(uncut) == len(mesh.faces):
        return mesh, uncut
    faces, parents = mesh.faces[crossed].astype(np.int64), np.flatnonzero(crossed)
    # Turn each triangle so that the corner alone on its side comes first; of three different sides, one off the plane.
    alone = np.where((corner_side[crossed] > 0).sum(axis=1) == 1, 1, -1)[:, None]
    turn = (np.argmax(corner_side[crossed] == alone, axis=1)[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(faces, turn, axis=1).T
    vertices, number = _add_crossings(mesh.vertices, height, side, np.concatenate([a, a]), np.concatenate([b, c]))
    ab, ac = np.split(number, 2)
    pieces = [np.stack(each, axis=1) for each in ((a, ab, ac), (ab, b, c), (ab, c, ac))]
    parent = np.concatenate([uncut, parents, parents, parents])
    every = np.concatenate([mesh.faces[uncut].astype(np.int64), *pieces])
    has_area = (every != np.roll(every, 1, axis=1)).all(axis=1)  # where b or c lies on the plane, a piece has no area
    every, parent = every[has_area], parent[has_area]
    region = None if mesh.region is None else mesh.region[parent]
    return replace(mesh, vertices=vertices, faces=every.astype(np.int32), region=region), parent


def _add_crossings(vertices: Floats, height: Floats, side: Ints, start: Ints, end: Ints) -> tuple[Floats, Ints]:
    """Append the points where edges cross the plane; return all vertices and (n,) the crossing of each edge.

    An edge has one crossing for both of its triangles; if an end lies on the plane, this end is the crossing.
    """
    edge, place = np.unique(np.stack([np.minimum(start, end), np.maximum(start, end)]), axis=1, return_inverse=True)
    p, q = edge
    number = np.where(side[p] == 0, p, q)
    through = side[p] * side[q] < 0
    number[through] = len(vertices) + np.arange(int(through.sum()))
    p, q = p[through], q[through]
    share = height[p] / (height[p] - height[q])
    new = vertices[p] + share[:, None] * (vertices[q] - vertices[p])
    return np.concatenate([vertices, new]), number[place.ravel()]


def faces_in_box(mesh: TriangleMesh, low: Floats, high: Floats) -> Ints32:
    """Return the triangles whose centroid lies in the closed box between two corners (3,) [m]."""
    middle = mesh.vertices[mesh.faces].mean(axis=1)
    return np.flatnonzero(((middle >= low) & (middle <= high)).all(axis=1)).astype(np.int32)


def _read_only(array: Floats) -> Floats:
    array.flags.writeable = False
    return array
