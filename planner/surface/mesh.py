"""Triangle meshes: the *reference* mesh is the part, the *planning* mesh its decimated copy (Section 3.1).

Object frame (the mesh file's axes), metres.
"""

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError
from planner.values import Floats, Ints32, Value, freeze


@dataclass(frozen=True, slots=True, eq=False)
class TriangleMesh(Value):
    """A triangle mesh; a face's corners turn counter-clockwise when seen from outside.

    Attributes:
        vertices: (V, 3) [m], object frame.
        faces: (F, 3) int32 indices of vertices, F > 0.
        diagonal: length of the bounding box's diagonal [m]; tolerances are shares of it.
    """

    vertices: Annotated[Floats, "V 3"]
    faces: Annotated[Ints32, "F 3"]
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
        object.__setattr__(self, "diagonal", float(np.linalg.norm(np.ptp(self.vertices, axis=0))))


def face_normals(mesh: TriangleMesh) -> Floats:
    """(F, 3) outward unit normals, object frame; zero for a face without area."""
    cross = cross_products(mesh.vertices, mesh.faces)
    length = np.linalg.norm(cross, axis=1, keepdims=True)
    return np.asarray(np.divide(cross, length, out=np.zeros_like(cross), where=length > 0))


def face_areas(mesh: TriangleMesh) -> Floats:
    """(F,) areas [m^2]."""
    return np.asarray(np.linalg.norm(cross_products(mesh.vertices, mesh.faces), axis=1) / 2)


def face_centres(mesh: TriangleMesh) -> Floats:
    """(F, 3) centres of gravity of the faces [m], object frame."""
    return np.asarray(mesh.vertices[mesh.faces].mean(axis=1))


def cross_products(vertices: Floats, faces: NDArray[np.integer]) -> Floats:
    """(F, 3) cross products of two edges of each face (F, 3): twice the area long, outward; vertices (V, 3)."""
    corners = vertices[faces]
    return np.asarray(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
