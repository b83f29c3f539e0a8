"""What the planner cannot know, it asks through these protocols; `cell` implements them, tests implement toys.

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
"""Axes of the arm; those behind them in a joint vector are external ones."""

Progress = Callable[[int, int], None]
"""Told `(done, total)` while something long goes on; what it raises ends the work."""


class Rejection(Worded):
    """Why a ray of a scan, or an aimed sample, gives no point; the first condition that fails is kept.

    They are asked in this order: NO_HIT, OUT_OF_FOV, OUT_OF_SENSOR_FOV, OUT_OF_RANGE, OUT_OF_DEPTH, GRAZING_SOURCE,
    GRAZING_SENSOR, TOO_SPARSE, TOO_UNCERTAIN, SOURCE_BLOCKED, SENSOR_BLOCKED. The values stand in files: new ones are
    appended.
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
    """First intersections of a bundle of rays.

    Attributes:
        face: (N,) int32 index of the face that is hit, -1 where the ray meets nothing.
        distance: (N,) distance along the unit direction [m], inf where the ray meets nothing.
    """

    face: Annotated[Ints32, "N"]
    distance: Annotated[Floats, "N"]


class RayCaster(Protocol):
    """First hit, and blocked or not, on one fixed set of triangles."""

    def first_hit(self, origins: Floats, directions: Floats) -> Hits:
        """First intersection of each ray.

        Args:
            origins: (N, 3) [m], in the frame of the triangles.
            directions: (N, 3) unit vectors.
        """
        ...

    def blocked(self, origins: Floats, targets: Floats) -> Bools:
        """Whether any triangle stands between origin and target.

        The segment ends a documented hair short of the target, so that the surface on which the target lies does not
        block it.

        Args:
            origins: (N, 3) [m], free positions (a source or a sensor).
            targets: (N, 3) [m], points on a surface.

        Returns:
            (N,) True where something is in the way.
        """
        ...


class Scanner(Protocol):
    """The law of a triangulation sensor, in its own frame; it knows no part and casts no ray."""

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
        """(n_v * n_h, 3) unit directions of a scan's rays in the scanner frame, row by row."""
        ...

    def reject(self, points: Floats, normals: Floats) -> NDArray[np.uint8]:
        """The first condition that needs no ray and fails, in the order that `Rejection` gives; FOV first.

        Every limit is inclusive.

        Args:
            points: (N, 3) surface points [m], scanner frame.
            normals: (N, 3) outward unit normals, scanner frame.

        Returns:
            (N,) `Rejection` values; MEASURED where every condition holds.
        """
        ...


class SpacingScanner(Scanner, Protocol):
    """A scanner that also knows how far apart its points lie."""

    def spacing(self, points: Floats, normals: Floats) -> Floats:
        """Distance of neighbouring points of a scan on the surface, the larger one of the grid's two directions.

        Args:
            points: (N, 3) surface points [m], scanner frame.
            normals: (N, 3) outward unit normals, scanner frame.

        Returns:
            (N,) [m]; inf where the source does not face the surface.
        """
        ...


class SigmaScanner(Scanner, Protocol):
    """A scanner that also knows how precise a point will be; only a limit on sigma and model noise need it."""

    def sigma(self, points: Floats, normals: Floats) -> Floats:
        """Expected standard deviation of the measured point along the ray from the source.

        Args:
            points: (N, 3) surface points [m], scanner frame.
            normals: (N, 3) outward unit normals, scanner frame.

        Returns:
            (N,) [m]; inf where no measurement is possible.
        """
        ...


@dataclass(frozen=True, slots=True, eq=False)
class JointLimits(Value):
    """What the axes can do; q in KUKA signs.

    Attributes:
        lower: (axes,) smallest joint angles [rad].
        upper: (axes,) largest joint angles [rad].
        velocity: (axes,) largest joint speeds [rad/s].
        acceleration: (axes,) largest joint accelerations [rad/s^2].
        jerk: (axes,) largest joint jerks [rad/s^3]; inf: no limit.
        q_table_turn: (axes,) where the arm stands clear while a table turns that never moves together with it, at any
            other place that is as clear too [rad]; None: all axes move together.
    """

    lower: Annotated[Floats, "axes"]
    upper: Annotated[Floats, "axes"]
    velocity: Annotated[Floats, "axes"]
    acceleration: Annotated[Floats, "axes"]
    jerk: Annotated[Floats, "axes"] = field(default_factory=lambda: np.full(ARM_AXES, np.inf))
    table_turn_q: Annotated[Floats, "axes"] | None = None


def axis_name(axis: int) -> str:
    """What a reader calls an axis by its number from 0: A1 to A6 are the arm's, E1 is the table's."""
    return f"A{axis + 1}" if axis < ARM_AXES else f"E{axis + 1 - ARM_AXES}"


class Kinematics(Protocol):
    """Forward and closed-form inverse kinematics of the arm."""

    @property
    def limits(self) -> JointLimits:
        """Limits of the axes."""
        ...

    def forward(self, q: Floats) -> Floats:
        """Flange poses.

        Args:
            q: (N, axes) joint angles [rad], KUKA signs.

        Returns:
            (N, 4, 4) T_base_flange [m].
        """
        ...

    def inverse(self, T_base_flange: Floats) -> Floats:
        """All branches of each pose, not limited to the joint range: eight of the arm, at each angle of a table.

        Args:
            T_base_flange: (N, 4, 4) [m].

        Returns:
            (N, branches, axes) joint angles [rad], those of the arm in (-pi, pi]; NaN where a branch has no real
            solution.
        """
        ...


class CollisionChecker(Protocol):
    """Collision of arm and tool with the cell, the part and themselves, at a fixed placement and clearance."""

    @property
    def clearance(self) -> float:
        """Distance [m] that a free configuration keeps from everything it must not touch."""
        ...

    def free(self, q: Floats) -> Bools:
        """Whether every guarded pair is at least the clearance apart.

        Args:
            q: (N, axes) joint angles [rad].

        Returns:
            (N,) True where the configuration is free.
        """
        ...

    def contacts(self, q: Floats) -> tuple[str, ...]:
        """Names of what is nearer than the clearance at one configuration, nearest first ("housing with part").

        Args:
            q: (axes,) joint angles [rad].
        """
        ...

    def distance(self, q: Floats) -> tuple[Floats, tuple[str, ...]]:
        """Smallest distance of any guarded pair, and which pair.

        Args:
            q: (N, axes) joint angles [rad].

        Returns:
            (N,) distance [m] (negative in contact) and N names such as "housing with part".
        """
        ...

    def travel(self, q_from: Floats, q_to: Floats) -> Floats:
        """An upper bound on how far any point of arm or tool moves along the straight joint segment.

        Args:
            q_from: (N, axes) [rad].
            q_to: (N, axes) [rad].

        Returns:
            (N,) length [m], a bound in proportion: between two configurations of the segment that are a share f of it
            apart, no point is displaced by more than f times the length. A bound on speed along the segment gives
            this, a bound on displacement alone would not; certifying a segment rests on it
            (`planner.path.certified_edge`).
        """
        ...
