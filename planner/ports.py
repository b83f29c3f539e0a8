"""Protocols of the services that the planner uses; `cell` implements them, tests implement small ones.

Frames: `base` (robot foot, z up), `flange`, `scanner` (origin at the laser source, +z viewing direction, +x from source
to sensor), `object` (axes of the mesh file, metres). `T_a_b` maps b-coordinates to a. Joint angles have KUKA signs.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from planner.values import Bools, DescribedEnum, Floats, Ints, Ints32, Value

ARM_AXES = 6
"""Number of axes of the arm; further entries of a joint vector are external axes."""

Progress = Callable[[int, int], None]
"""Receives `(done, total)` during a long computation; an exception that it raises ends the computation."""


def no_progress(*values: object) -> None:
    """Ignore progress."""


class Rejection(DescribedEnum):
    """First condition that a ray of a scan, or an aimed sample, fails.

    They are checked in this order: NO_HIT, OUT_OF_FOV, OUT_OF_SENSOR_FOV, OUT_OF_RANGE, OUT_OF_DEPTH, GRAZING_SOURCE,
    GRAZING_SENSOR, TOO_SPARSE, TOO_UNCERTAIN, SOURCE_BLOCKED, SENSOR_BLOCKED. Files contain the values: append new
    ones.
    """

    MEASURED = 0, "measured"
    NO_HIT = 1, "the ray hits no surface"
    OUT_OF_FOV = 2, "outside the field of view"
    OUT_OF_RANGE = 3, "outside the scanner's range"
    GRAZING_SOURCE = 4, "the laser's grazing angle is above the limit"
    GRAZING_SENSOR = 5, "the sensor's grazing angle is above the limit"
    SOURCE_BLOCKED = 6, "the line of sight from the laser source is blocked"
    SENSOR_BLOCKED = 7, "the line of sight to the sensor is blocked (shadow effect)"
    OUT_OF_DEPTH = 8, "outside the depth of field"
    OUT_OF_SENSOR_FOV = 9, "outside the sensor's field of view"
    TOO_UNCERTAIN = 10, "the expected standard deviation of the point is above the limit"
    TOO_SPARSE = 11, "the distance of neighbouring points is above the limit"


@dataclass(frozen=True, slots=True, eq=False)
class Hits(Value):
    """First intersections of rays.

    Attributes:
        face: (N,) index of the face that is hit, -1 if the ray hits nothing.
        distance: (N,) distance along the unit direction [m], inf if the ray hits nothing.
    """

    face: Annotated[Ints32, "N"]
    distance: Annotated[Floats, "N"]


class RayCaster(Protocol):
    """Ray casting on one fixed set of triangles."""

    def first_hit(self, origins: Floats, directions: Floats) -> Hits:
        """Return the first intersection of each ray.

        Args:
            origins: (N, 3) [m], in the frame of the triangles.
            directions: (N, 3) unit vectors.
        """

    def blocked(self, origins: Floats, targets: Floats) -> Bools:
        """Return (N,) whether any triangle lies between origin and target.

        The segment ends slightly short of the target, so that the target's own surface does not block it.

        Args:
            origins: (N, 3) [m], free positions (a source or a sensor).
            targets: (N, 3) [m], points on a surface.
        """


class DirectionCaster(RayCaster, Protocol):
    """A ray caster that also casts along directions, faster than `blocked` and in float32."""

    def blocked_along(self, points: Floats, origin: Ints, directions: NDArray[np.float32], length: float) -> Bools:
        """Return (N,) whether any triangle lies within a length [m] of a point along a unit direction.

        Args:
            points: (S, 3) [m], on a surface or slightly above it; their own surface does not block.
            origin: (N,) point from which each ray begins.
            directions: (N, 3) unit vectors.
            length: of the rays [m].
        """


class Scanner(Protocol):
    """Law of a triangulation sensor in its own frame; it knows no part and casts no ray."""

    @property
    def source(self) -> Floats:
        """(3,) position of the laser source [m], scanner frame (its origin)."""

    @property
    def sensor(self) -> Floats:
        """(3,) position of the sensor [m], scanner frame: the baseline along +x."""

    @property
    def grid_shape(self) -> tuple[int, int]:
        """(n_v, n_h) rays of one scan: n = round(FOV / resolution) per axis (Eq. 1)."""

    def ray_directions(self) -> Floats:
        """Return the (n_v * n_h, 3) unit directions of a scan's rays, scanner frame, row by row."""

    def reject(self, points: Floats, normals: Floats) -> NDArray[np.uint8]:
        """Return (N,) the first failed condition that needs no ray, in the order of `Rejection`; limits are inclusive.

        Args:
            points: (N, 3) surface points [m], scanner frame.
            normals: (N, 3) outward unit normals, scanner frame.
        """


class SpacingScanner(Scanner, Protocol):
    """A scanner with a known distance of its points."""

    def spacing(self, points: Floats, normals: Floats) -> Floats:
        """Return the (N,) distance of neighbouring points on the surface [m], the larger of the grid's directions.

        Args:
            points: (N, 3) surface points [m], scanner frame.
            normals: (N, 3) outward unit normals, scanner frame.

        Returns:
            (N,) [m]; inf if the source does not face the surface.
        """


class SigmaScanner(Scanner, Protocol):
    """A scanner with a known precision; only a limit on sigma and model noise need it."""

    def sigma(self, points: Floats, normals: Floats) -> Floats:
        """Return the (N,) expected standard deviation of each measured point along the ray from the source [m].

        Args:
            points: (N, 3) surface points [m], scanner frame.
            normals: (N, 3) outward unit normals, scanner frame.

        Returns:
            (N,) [m]; inf if no measurement is possible.
        """


@runtime_checkable
class AreaLimits(Protocol):
    """A scanner whose `reject` is fully described by limits of angles and lengths."""

    @property
    def area_limits(self) -> tuple[float, ...] | None:
        """The 13 limits; None if `reject` has further conditions.

        Baseline along +x [m]; tangents of half the field of view, and of the sensor's (0: not limited); smallest and
        largest range and depth [m]; cosines of the grazing limits at source and sensor; cosine and sine of the sensor's
        tilt.
        """

    def reject_at(self, points: Floats, normals: Floats, rows: Ints, T: Floats) -> NDArray[np.uint8]:
        """Return (N,) the codes of `reject` for (N,) of S points in another frame; valid if there are limits.

        Args:
            points: (3, S) coordinates [m], read-only.
            normals: (3, S) outward unit normals, read-only.
            rows: (N,) points, writable: the type of a kernel's argument.
            T: (4, 4) pose of the scanner in their frame [m], writable.
        """
        ...


@dataclass(frozen=True, slots=True, eq=False)
class JointLimits(Value):
    """Limits of the axes.

    Attributes:
        lower: (axes,) smallest joint angles [rad].
        upper: (axes,) largest joint angles [rad].
        velocity: (axes,) largest joint speeds [rad/s].
        acceleration: (axes,) largest joint accelerations [rad/s^2].
        jerk: (axes,) largest joint jerks [rad/s^3]; inf: no limit.
        table_turn_q: (axes,) configuration [rad] of the arm for rotations of a table that never moves together with
            it; another configuration with the same clearance may be used. None: all axes move together.
    """

    lower: Annotated[Floats, "axes"]
    upper: Annotated[Floats, "axes"]
    velocity: Annotated[Floats, "axes"]
    acceleration: Annotated[Floats, "axes"]
    jerk: Annotated[Floats, "axes"] = field(default_factory=lambda: np.full(ARM_AXES, np.inf))
    table_turn_q: Annotated[Floats, "axes"] | None = None


def axis_name(axis: int) -> str:
    """Return the name of an axis by its number from 0: A1 to A6 for the arm, E1 for the table."""
    return f"A{axis + 1}" if axis < ARM_AXES else f"E{axis + 1 - ARM_AXES}"


class Kinematics(Protocol):
    """Forward and closed-form inverse kinematics of the arm."""

    @property
    def limits(self) -> JointLimits:
        """Limits of the axes."""

    def forward(self, q: Floats) -> Floats:
        """Return the (N, 4, 4) flange poses T_base_flange [m] of (N, axes) joint angles [rad]."""

    def inverse(self, T_base_flange: Floats) -> Floats:
        """Return all configurations of each pose, ignoring the joint limits: eight of the arm at each table angle.

        Args:
            T_base_flange: (N, 4, 4) [m].

        Returns:
            (N, branches, axes) joint angles [rad], those of the arm in (-pi, pi]; NaN if a branch has no real solution.
        """


class CollisionChecker(Protocol):
    """Collision of arm and tool with the cell, the part and themselves, at a fixed placement and clearance."""

    @property
    def clearance(self) -> float:
        """Distance [m] of a free configuration from everything that it must not touch."""

    def free(self, q: Floats) -> Bools:
        """Return (N,) whether the distance of each checked pair is at least the clearance at (N, axes) angles [rad]."""

    def contacts(self, q: Floats) -> tuple[str, ...]:
        """Return the pairs closer than the clearance at (axes,) angles [rad], nearest first ("housing with part")."""

    def distance(self, q: Floats) -> tuple[Floats, tuple[str, ...]]:
        """Return the smallest distance of any checked pair, and the pair.

        Args:
            q: (N, axes) joint angles [rad].

        Returns:
            (N,) distance [m] (negative in contact) and N names such as "housing with part".
        """

    def travel(self, q_from: Floats, q_to: Floats) -> Floats:
        """Return an upper bound on the displacement of any point of arm or tool along the straight joint segment.

        Args:
            q_from: (N, axes) [rad].
            q_to: (N, axes) [rad].

        Returns:
            (N,) length [m]. The bound is proportional: between two configurations of the segment that are a share f of
            it apart, no point moves by more than f times the length. A bound on speed along the segment has this
            property, a bound on displacement alone has not. The certification of segments depends on it
            (`planner.path.certified_edge`).
        """
