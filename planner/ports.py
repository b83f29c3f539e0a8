"""Protocols through which the planner uses rays, scanner, kinematics and collision; `cell` implements them.

Frames: `base` (robot foot, z up), `flange`, `scanner` (origin at the laser source, +z viewing direction, +x from source
to sensor), `object` (the mesh file's axes, metres). `T_a_b` maps b-coordinates to a.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, Protocol

import numpy as np
from numpy.typing import NDArray

from planner.values import Bools, Floats, Ints32, Value
from planner.worded import Worded

ARM_AXES = 6
"""Axes of the arm; the following ones in a joint vector are external axes."""

Progress = Callable[[int, int], None]
"""Callback with `(done, total)` during long computations; its exceptions end them."""


class Rejection(Worded):
    """Reason why a ray of a scan, or an aimed sample, gives no point: the first condition that fails.

    The conditions are tested in this order: NO_HIT, OUT_OF_FOV, OUT_OF_SENSOR_FOV, OUT_OF_RANGE, OUT_OF_DEPTH,
    GRAZING_SOURCE, GRAZING_SENSOR, TOO_SPARSE, TOO_UNCERTAIN, SOURCE_BLOCKED, SENSOR_BLOCKED. The values are stored in
    files: new ones are appended.
    """

    MEASURED = 0, "measured"
    NO_HIT = 1, "the ray meets no surface"
    OUT_OF_FOV = 2, "outside the field of view"
    OUT_OF_RANGE = 3, "nearer or farther than the scanner's range"
    GRAZING_SOURCE = 4, "the laser grazes the surface beyond the limit"
    GRAZING_SENSOR = 5, "the sensor sees the surface beyond its grazing limit"
    SOURCE_BLOCKED = 6, "something stands between laser source and surface"
    SENSOR_BLOCKED = 7, "something stands between surface and sensor (shadow effect)"
    OUT_OF_DEPTH = 8, "before or behind the depth of field"
    OUT_OF_SENSOR_FOV = 9, "outside the sensor's field of view"
    TOO_UNCERTAIN = 10, "the expected standard deviation of the point is above the limit"
    TOO_SPARSE = 11, "the scan's points lie farther apart there than the limit"


@dataclass(frozen=True, slots=True, eq=False)
class Hits(Value):
    """First intersections of N rays.

    Attributes:
        face: (N,) index of the hit face, -1 if the ray meets nothing.
        distance: (N,) distance along the unit direction [m], inf if the ray meets nothing.
    """

    face: Annotated[Ints32, "N"]
    distance: Annotated[Floats, "N"]


class RayCaster(Protocol):
    """Ray queries on one fixed set of triangles."""

    def first_hit(self, origins: Floats, directions: Floats) -> Hits:
        """Return the first intersection of each ray.

        Args:
            origins: (N, 3) [m], in the frame of the triangles.
            directions: (N, 3) unit vectors.
        """
        ...

    def blocked(self, origins: Floats, targets: Floats) -> Bools:
        """Return (N,) whether any triangle is between origin and target.

        The segment ends slightly before the target, by a documented distance, so that the surface of the target does
        not block it.

        Args:
            origins: (N, 3) [m], free positions (a source or a sensor).
            targets: (N, 3) [m], points on a surface.
        """
        ...


class Scanner(Protocol):
    """Model of a triangulation sensor in its own frame; it knows no part and casts no ray."""

    @property
    def source(self) -> Floats:
        """(3,) position of the laser source [m], scanner frame (its origin)."""
        ...

    @property
    def sensor(self) -> Floats:
        """(3,) position of the sensor [m], scanner frame: the baseline along +x."""
        ...

    @property
    def grid_shape(self) -> tuple[int, int]:
        """(n_v, n_h) rays of one scan: n = round(FOV / resolution) per axis (Eq. 1)."""
        ...

    def ray_directions(self) -> Floats:
        """Return (n_v * n_h, 3) unit directions of a scan's rays in the scanner frame, row by row."""
        ...

    def reject(self, points: Floats, normals: Floats) -> NDArray[np.uint8]:
        """Return the first failed condition that needs no ray, in the order of `Rejection`; FOV first.

        Every limit is inclusive.

        Args:
            points: (N, 3) surface points [m], scanner frame.
            normals: (N, 3) outward unit normals, scanner frame.

        Returns:
            (N,) `Rejection` values; MEASURED if every condition holds.
        """
        ...


class SpacingScanner(Scanner, Protocol):
    """A scanner that also computes the spacing of its points."""

    def spacing(self, points: Floats, normals: Floats) -> Floats:
        """Return the distance of neighbouring points of a scan on the surface, the larger of the grid's two directions.

        Args:
            points: (N, 3) surface points [m], scanner frame.
            normals: (N, 3) outward unit normals, scanner frame.

        Returns:
            (N,) [m]; inf if the source does not face the surface.
        """
        ...


class SigmaScanner(Scanner, Protocol):
    """A scanner that also computes the precision of a point; only limits on sigma and model noise need it."""

    def sigma(self, points: Floats, normals: Floats) -> Floats:
        """Return the expected standard deviation of the measured point along the ray from the source.

        Args:
            points: (N, 3) surface points [m], scanner frame.
            normals: (N, 3) outward unit normals, scanner frame.

        Returns:
            (N,) [m]; inf if no measurement is possible.
        """
        ...


@dataclass(frozen=True, slots=True, eq=False)
class JointLimits(Value):
    """Limits of the axes; q in KUKA signs.

    Attributes:
        lower: (axes,) smallest joint angles [rad].
        upper: (axes,) largest joint angles [rad].
        velocity: (axes,) largest joint speeds [rad/s].
        acceleration: (axes,) largest joint accelerations [rad/s^2].
        jerk: (axes,) largest joint jerks [rad/s^3]; inf: no limit.
        table_turn_q: (axes,) configuration in which the arm is clear of an indexed table, which turns there or at any
            other configuration that is clear [rad]; None: all axes may move together.
    """

    lower: Annotated[Floats, "axes"]
    upper: Annotated[Floats, "axes"]
    velocity: Annotated[Floats, "axes"]
    acceleration: Annotated[Floats, "axes"]
    jerk: Annotated[Floats, "axes"] = field(default_factory=lambda: np.full(ARM_AXES, np.inf))
    table_turn_q: Annotated[Floats, "axes"] | None = None


def axis_name(axis: int) -> str:
    """Return the name of an axis by its number from 0: A1 to A6 are the arm's, E1 is the table's."""
    return f"A{axis + 1}" if axis < ARM_AXES else f"E{axis + 1 - ARM_AXES}"


class Kinematics(Protocol):
    """Forward and closed-form inverse kinematics of the arm."""

    @property
    def limits(self) -> JointLimits:
        """Limits of the axes."""
        ...

    def forward(self, q: Floats) -> Floats:
        """Return flange poses.

        Args:
            q: (N, axes) joint angles [rad], KUKA signs.

        Returns:
            (N, 4, 4) T_base_flange [m].
        """
        ...

    def inverse(self, T_base_flange: Floats) -> Floats:
        """Return all branches of each pose, also outside the joint range: eight of the arm, at each angle of a table.

        Args:
            T_base_flange: (N, 4, 4) [m].

        Returns:
            (N, branches, axes) joint angles [rad], those of the arm in (-pi, pi]; NaN if a branch has no real solution.
        """
        ...


class CollisionChecker(Protocol):
    """Collision check of arm and tool with the cell, the part and themselves, at a fixed placement and clearance."""

    @property
    def clearance(self) -> float:
        """Smallest distance [m] of a free configuration from every object that it must not touch."""
        ...

    def free(self, q: Floats) -> Bools:
        """Return (N,) whether every checked pair is at least the clearance apart at q (N, axes) [rad]."""
        ...

    def contacts(self, q: Floats) -> tuple[str, ...]:
        """Return the pairs closer than the clearance at q (axes,) [rad], closest first ("housing with part")."""
        ...

    def distance(self, q: Floats) -> tuple[Floats, tuple[str, ...]]:
        """Return (N,) the smallest distance [m] of any pair at q (N, axes) [rad], negative in contact, and N names."""
        ...

    def travel(self, q_from: Floats, q_to: Floats) -> Floats:
        """Return an upper bound on the travel of any point of arm or tool along the straight joint segment.

        Args:
            q_from: (N, axes) [rad].
            q_to: (N, axes) [rad].

        Returns:
            (N,) length [m], a bound in proportion: between two configurations of the segment that are a share f of it
            apart, no point moves by more than f times the length. A bound on speed along the segment gives this, a
            bound on displacement alone does not; the proof of certified segments needs it
            (`planner.path.certified_edge`).
        """
        ...
