"""Geometric shapes, signed distances from them and their derivatives.

A small change of a shape has seven components in its frame (x, y, axis): shift along x, y and axis [m], tilt of the
axis towards x and y [rad], size [m] and half angle [rad]. `PARAMETERS` lists the components of each kind. Distances are
positive on the side of a plane's normal, and outside the other shapes.
"""

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

import numpy as np

from planner.values import Floats, Value


class ShapeKind(StrEnum):
    """Kind of a shape."""

    LINE = "line"
    PLANE = "plane"
    CIRCLE = "circle"
    SPHERE = "sphere"
    CYLINDER = "cylinder"
    CONE = "cone"


X, Y, Z, TILT_X, TILT_Y, SIZE, ANGLE = range(7)
N_COMPONENTS = 7
COMPONENT_NAMES = (
    "position along x", "position along y", "position along the axis", "tilt towards x", "tilt towards y", "size",
    "angle",
)  # fmt: skip

PARAMETERS: dict[ShapeKind, tuple[int, ...]] = {
    ShapeKind.LINE: (X, Y, TILT_X, TILT_Y),
    ShapeKind.PLANE: (Z, TILT_X, TILT_Y),
    ShapeKind.CIRCLE: (X, Y, Z, TILT_X, TILT_Y, SIZE),
    ShapeKind.SPHERE: (X, Y, Z, SIZE),
    ShapeKind.CYLINDER: (X, Y, TILT_X, TILT_Y, SIZE),
    ShapeKind.CONE: (X, Y, TILT_X, TILT_Y, SIZE, ANGLE),
}


@dataclass(frozen=True, slots=True, eq=False)
class Shape(Value):
    """A shape.

    Attributes:
        kind: of the shape.
        point: (3,) on the line, plane or axis; centre of a circle or sphere [m].
        axis: (3,) unit direction, or normal of a plane or circle; of a cone from its apex to its open side.
        size: radius; of a cone the distance from `point` to its surface [m]; 0 for lines and planes.
        half_angle: of a cone, between axis and surface [rad].
    """

    kind: ShapeKind
    point: Annotated[Floats, "3"]
    axis: Annotated[Floats, "3"]
    size: float = 0.0
    half_angle: float = 0.0

    @property
    def frame(self) -> Floats:
        """(3, 3) right-handed frame whose columns are x, y and the axis."""
        a, b, c = self.axis.tolist()  # np.cross of two vectors takes twenty times as long
        smallest = int(np.abs(self.axis).argmin())
        x, y, z = ((0.0, c, -b), (-c, 0.0, a), (b, -a, 0.0))[smallest]
        length = math.sqrt(x * x + y * y + z * z)
        x, y, z = x / length, y / length, z / length
        return np.array([[x, b * z - c * y, a], [y, c * x - a * z, b], [z, a * y - b * x, c]])

    def at_foot(self, point: Floats) -> "Shape":
        """Return the same shape with its point at the foot of `point` (3,) on its axis or plane."""
        along = float((point - self.point) @ self.axis)
        if self.kind is ShapeKind.PLANE:
            return self._with(point=point - along * self.axis)
        if self.kind in (ShapeKind.CIRCLE, ShapeKind.SPHERE):
            return self
        return self._with(point=self.point + along * self.axis, size=self.size + along * np.sin(self.half_angle))

    def changed(self, change: Floats) -> "Shape":
        """Return the shape after a small change (7,)."""
        x, y, axis = self.frame.T
        turned = axis + change[TILT_X] * x + change[TILT_Y] * y
        turned, angle = turned / np.linalg.norm(turned), self.half_angle + change[ANGLE]
        if self.kind is ShapeKind.CONE and angle < 0:
            turned, angle = -turned, -angle
        return self._with(
            point=self.point + self.frame @ change[:3], axis=turned, size=self.size + change[SIZE], half_angle=angle
        )

    def distances(self, points: Floats) -> Floats:
        """Return the signed distance (N,) of points (N, 3); of a line and a circle the absolute distance."""
        local = (points - self.point) @ self.frame
        radial, along = np.hypot(local[:, 0], local[:, 1]), local[:, 2]
        match self.kind:
            case ShapeKind.LINE:
                return np.asarray(radial)
            case ShapeKind.PLANE:
                return np.asarray(along)
            case ShapeKind.CIRCLE:
                return np.hypot(radial - self.size, along)
            case ShapeKind.SPHERE:
                return np.asarray(np.linalg.norm(local, axis=1) - self.size)
            case ShapeKind.CYLINDER:
                return np.asarray(radial - self.size)
        return np.asarray(radial * np.cos(self.half_angle) - along * np.sin(self.half_angle) - self.size)

    def normals(self, points: Floats) -> Floats:
        """Return the gradient (N, 3) of the distance at points (N, 3), a unit vector; not for lines and circles."""
        local = (points - self.point) @ self.frame
        if self.kind is ShapeKind.PLANE:
            return np.tile(self.axis, (len(points), 1))
        if self.kind is ShapeKind.SPHERE:
            return (points - self.point) / _positive(np.linalg.norm(local, axis=1))[:, None]
        radial = local[:, :2] / _positive(np.hypot(local[:, 0], local[:, 1]))[:, None]
        sides = np.cos(self.half_angle) * radial
        return np.column_stack([sides, np.full(len(points), -np.sin(self.half_angle))]) @ self.frame.T

    def jacobian(self, points: Floats) -> Floats:
        """Return the derivative (N, 7) of the signed distance by the components of a change; not for lines, circles."""
        u, v, w = ((points - self.point) @ self.frame).T
        J = np.zeros((len(points), N_COMPONENTS))
        if self.kind is ShapeKind.PLANE:
            J[:, Z], J[:, TILT_X], J[:, TILT_Y] = -1.0, u, v
            return J
        J[:, SIZE] = -1.0
        if self.kind is ShapeKind.SPHERE:
            J[:, :3] = -np.column_stack([u, v, w]) / _positive(np.sqrt(u**2 + v**2 + w**2))[:, None]
            return J
        radial = np.hypot(u, v)
        sine, cosine = np.sin(self.half_angle), np.cos(self.half_angle)
        for shift, tilt, side in ((X, TILT_X, u), (Y, TILT_Y, v)):
            J[:, shift] = -cosine * side / _positive(radial)
            J[:, tilt] = J[:, shift] * w - sine * side
        if self.kind is ShapeKind.CONE:
            J[:, ANGLE] = -radial * sine - w * cosine
        return J

    def _with(self, **changes: Floats | float) -> "Shape":
        values = {"point": self.point, "axis": self.axis, "size": self.size, "half_angle": self.half_angle} | changes
        return Shape(self.kind, **values)  # type: ignore[arg-type]


def _positive(values: Floats) -> Floats:
    """Return values bounded away from zero: a point on the axis has no radial direction."""
    return np.maximum(values, np.finfo(np.float64).tiny)
