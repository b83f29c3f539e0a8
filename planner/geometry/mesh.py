"""Triangle meshes: the *reference* mesh is the part, the *planning* mesh its decimated copy (Section 3.1).

Object frame (the mesh file's axes), metres.

A triangle mesh cut along planes across an axis: every triangle lies on one side then, the surface is the same.

Object frame, metres.
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


@dataclass(frozen=True, eq=False)  # without slots: normals, areas and centres are kept once they were asked for
class TriangleMesh(Value):
    """A triangle mesh; a face's corners turn counter-clockwise when seen from outside.

    Attributes:
        vertices: (V, 3) [m], object frame.
        faces: (F, 3) int32 indices of vertices, F > 0.
        region: (F,) int32 region of the part that each face belongs to, from 0; -1: nobody cares for it, it only stands
            in the way. None: the part has no regions.
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
            raise PlannerError("region is below 0 for every face; a part needs a face that somebody cares for")
        object.__setattr__(self, "diagonal", float(np.linalg.norm([np.ptp(axis) for axis in self.vertices.T])))

    @cached_property
    def normals(self) -> Floats:
        """(F, 3) outward unit normals, object frame; zero for a face without area."""
        cross = cross_products(self.vertices, self.faces)
        length = lengths(cross)[:, None]
        return _sealed(np.divide(cross, length, out=np.zeros_like(cross), where=length > 0))

    @cached_property
    def areas(self) -> Floats:
        """(F,) areas of the faces [m^2]."""
        return _sealed(lengths(cross_products(self.vertices, self.faces)) / 2)

    @cached_property
    def centres(self) -> Floats:
        """(F, 3) centres of gravity of the faces [m], object frame."""
        total: Floats = np.take(self.vertices, self.faces[:, 0], axis=0)
        for corner in self.faces.T[1:]:
            total += np.take(self.vertices, corner, axis=0)
        return _sealed(np.divide(total, 3, out=total))


def cross_products(vertices: Floats, faces: NDArray[np.integer]) -> Floats:
    """(F, 3) cross products of two edges of each face (F, 3): twice the area long, outward; vertices (V, 3)."""
    result: Floats = np.empty((len(faces), 3))
    for start in range(0, len(faces), _BLOCK):
        a, b, c = (np.take(vertices, corner, axis=0) for corner in faces[start : start + _BLOCK].T)
        b -= a
        c -= a
        result[start : start + _BLOCK] = crossed(b, c)
    return result


def crossed(one: Floats, two: Floats) -> Floats:
    """(N, 3) cross products of vectors (N, 3), as `np.cross`, which takes three times as long."""
    result: Floats = np.empty_like(one)
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        np.subtract(one[:, i] * two[:, j], one[:, j] * two[:, i], out=result[:, k])
    return result


def lengths(vectors: Floats) -> Floats:
    """(N,) lengths of vectors (N, 3), to the last bit as `np.linalg.norm`, which takes three times as long."""
    x, y, z = vectors.T
    result: Floats = np.sqrt(x * x + y * y + z * z)
    return result


def joined(pieces: Iterable[tuple[Floats, NDArray[np.integer]]]) -> tuple[Floats, Ints, Ints]:
    """Several meshes, each (V, 3) and (F, 3), as one: its vertices, its faces, and the piece of each face."""
    vertices, faces = [np.zeros((0, 3))], [np.zeros((0, 3), np.int64)]
    begin, counts = 0, []
    for corners, triangles in pieces:
        vertices.append(corners)
        faces.append(triangles + np.int64(begin))
        counts.append(len(triangles))
        begin += len(corners)
    return np.concatenate(vertices), np.concatenate(faces), np.repeat(np.arange(len(counts)), counts)


def _sealed(array: Floats) -> Floats:
    array.flags.writeable = False
    return array


_ON = 1e-9  # of the diagonal: what is nearer to a plane lies on it


def cut(mesh: TriangleMesh, axis: int, at: float) -> tuple[TriangleMesh, Ints]:
    """Cut the triangles that a plane crosses; edges are cut for both of their triangles alike.

    Args:
        mesh: any mesh; its regions are kept.
        axis: 0, 1 or 2: the plane is across x, y or z.
        at: where it stands on the axis [m].

    Returns:
        The mesh, its first V vertices unchanged, and the (F',) triangle of `mesh` that each of its triangles is of.
    """
    height = mesh.vertices[:, axis] - at
    side = np.sign(np.where(np.abs(height) <= _ON * mesh.diagonal, 0.0, height)).astype(np.int64)
    of_corner = side[mesh.faces]
    crossed = (of_corner.min(axis=1) < 0) & (of_corner.max(axis=1) > 0)
    whole = np.flatnonzero(~crossed)
    if len(whole) == len(mesh.faces):
        return mesh, whole
    faces, which = mesh.faces[crossed].astype(np.int64), np.flatnonzero(crossed)
    # Turned so that the corner that is alone on its side comes first; of three different sides one that is off.
    alone = np.where((of_corner[crossed] > 0).sum(axis=1) == 1, 1, -1)[:, None]
    turn = (np.argmax(of_corner[crossed] == alone, axis=1)[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(faces, turn, axis=1).T
    vertices, number = _crossings(mesh.vertices, height, side, np.concatenate([a, a]), np.concatenate([b, c]))
    ab, ac = np.split(number, 2)
    pieces = [np.stack(each, axis=1) for each in ((a, ab, ac), (ab, b, c), (ab, c, ac))]
    parent = np.concatenate([whole, which, which, which])
    every = np.concatenate([mesh.faces[whole].astype(np.int64), *pieces])
    kept = (every != np.roll(every, 1, axis=1)).all(axis=1)  # where b or c lies on the plane, a piece has no area
    every, parent = every[kept], parent[kept]
    region = None if mesh.region is None else mesh.region[parent]
    return replace(mesh, vertices=vertices, faces=every.astype(np.int32), region=region), parent


def _crossings(vertices: Floats, height: Floats, side: Ints, start: Ints, end: Ints) -> tuple[Floats, Ints]:
    """The vertices with those where edges from (n,) `start` to `end` cross the plane, and (n,) which these are.

    An edge has one crossing, whichever triangle asks for it; where an end lies on the plane, that end is it.
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


def faces_within(mesh: TriangleMesh, low: Floats, high: Floats) -> Ints32:
    """The triangles whose middle lies in a box between (3,) corners [m], the box's sides included."""
    middle = mesh.vertices[mesh.faces].mean(axis=1)
    return np.flatnonzero(((middle >= low) & (middle <= high)).all(axis=1)).astype(np.int32)
