"""The faces of a CAD model beside the triangles that stand for them: number, kind of surface and its parameters.

Faces are numbered from 1 in the order of the file, as CAD programs number them. Object frame, metres, radians.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

import numpy as np

from planner.geometry.mesh import TriangleMesh
from planner.values import Floats, Ints32, Value


class SurfaceKind(StrEnum):
    """What a face is a piece of."""

    PLANE = "plane"
    CYLINDER = "cylinder"
    CONE = "cone"
    SPHERE = "sphere"
    TORUS = "torus"
    OTHER = "other"
    """A surface without parameters of its own, such as a spline."""


@dataclass(frozen=True, slots=True, eq=False)
class CadFace(Value):
    """One face; what its kind does not have is None.

    Attributes:
        number: 1, 2, ... in the order of the file.
        kind: of its surface.
        point: (3,) on the plane or the axis, the centre of a sphere or torus, the apex of a cone [m].
        axis: (3,) unit: the plane's normal, the axis of a cylinder, cone or torus.
        radius: of a cylinder or sphere; of a torus that of its tube [m].
        centre_radius: of a torus: from its centre to the middle of its tube [m].
        half_angle: of a cone, between axis and surface [rad].
    """

    number: int
    kind: SurfaceKind
    point: Annotated[Floats, "3"] | None = None
    axis: Annotated[Floats, "3"] | None = None
    radius: float | None = None
    centre_radius: float | None = None
    half_angle: float | None = None

    @property
    def dimensions(self) -> str:
        """Its sizes with their units; "" where it has none."""
        if self.half_angle is not None:
            return f"half angle {np.degrees(self.half_angle):.4g} deg"
        if self.radius is None:
            return ""
        size = f"diameter {2000 * self.radius:.5g} mm"
        return size if self.centre_radius is None else f"tube's {size}, about {2000 * self.centre_radius:.5g} mm"


@dataclass(frozen=True, slots=True, eq=False)
class CadModel(Value):
    """Which face each triangle of a part belongs to.

    Attributes:
        faces: in the order of their numbers; those of what is no solid are missing.
        of_triangle: (F,) index in `faces` of each triangle.
    """

    faces: tuple[CadFace, ...]
    of_triangle: Annotated[Ints32, "F"]

    def counts(self) -> dict[str, int]:
        """How many faces there are of each kind that there is."""
        kinds = [face.kind for face in self.faces]
        return {kind.value: kinds.count(kind) for kind in SurfaceKind if kind in kinds}

    def areas(self, mesh: TriangleMesh) -> Floats:
        """(N,) area of each face [m^2], of the triangles of `mesh`."""
        return np.bincount(self.of_triangle, weights=mesh.areas, minlength=len(self.faces)).astype(np.float64)

    def centres(self, mesh: TriangleMesh) -> Floats:
        """(N, 3) centre of gravity of each face's triangles [m]; zero where it has none."""
        areas, centres = mesh.areas, mesh.centres
        whole = np.maximum(self.areas(mesh), np.finfo(np.float64).tiny)
        sums = [np.bincount(self.of_triangle, weights=areas * axis, minlength=len(self.faces)) for axis in centres.T]
        return np.stack(sums, axis=1) / whole[:, None]
