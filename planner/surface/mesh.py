"""Triangle meshes: the *reference* mesh is the part, the *planning* mesh its decimated copy (Section 3.1).

Object frame (the mesh file's axes), metres.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
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
