"""The line of a sweep: through the poses of a column, at equal steps, and half a step beyond its first and last pose.

A line sensor's column holds a pose in the middle of each of K equal cells (`planner.viewpoints.sweeps`). Driven, the
sheet has to pass over the whole of every cell, so the line runs from the edge of the first cell to the edge of the last
one: the poses stand at u = (k + 0.5) / K of it, u from 0 to 1. On the line

    p(u) = p(0) + u displacement          R(u) = exp(u turn) R(0)

the position advances straight and the orientation turns about an axis that keeps its direction, both in proportion:
what a controller's linear motion does. The twist (displacement, turn) of the scanner frame is constant in u.

Base frame, metres, radians.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from planner.ports import JointLimits
from planner.timing.s_curve import Profile
from planner.values import Floats, Value, readonly

_EASE = 0.1  # time in which a ramp's acceleration is reached at the fastest [s]
_SAME = 1e-7
"""Steps that differ by less [m, rad] are equal: set-points are coarser than that."""


@dataclass(frozen=True, slots=True)
class SweepSpeed:
    """How fast a sweep is driven at most; the slower of straight and turning motion holds.

    Attributes:
        linear: speed of the scanner frame's origin [m/s].
        angular: rate of turn [rad/s].
        linear_acceleration: on the ramps [m/s^2]; reached in a tenth of a second at the fastest, as the next.
        angular_acceleration: on the ramps [rad/s^2].
    """

    linear: float = 0.05
    angular: float = 0.35
    linear_acceleration: float = 0.5
    angular_acceleration: float = 1.0

    def scaled(self, speed: float, acceleration: float = 1.0) -> "SweepSpeed":
        """Fractions of the speeds and of the accelerations: an override slows lines down like every other move."""
        return SweepSpeed(
            self.linear * speed,
            self.angular * speed,
            self.linear_acceleration * acceleration,
            self.angular_acceleration * acceleration,
        )

    def slowed(self, limits: JointLimits, full: JointLimits) -> "SweepSpeed":
        """As much slower as limits of the axes are than those at full speed."""
        return self.scaled(_fraction(limits.velocity, full.velocity), _fraction(limits.acceleration, full.acceleration))


def _fraction(limit: Floats, full: Floats) -> float:
    """The fraction to which limits were scaled; those that are not finite say nothing."""
    known = np.isfinite(limit) & np.isfinite(full)
    return float((limit[known] / full[known]).min(initial=1.0))


DEFAULT_SPEED = SweepSpeed()


@dataclass(frozen=True, slots=True, eq=False)
class SweepLine(Value):
    """A line of poses.

    Attributes:
        T_base_begin: (4, 4) scanner pose at u = 0 [m].
        displacement: (3,) of the origin from u = 0 to 1 [m], base frame.
        turn: (3,) rotation vector from u = 0 to 1 [rad], base frame, shorter than pi.
        poses: K measuring poses on it.
    """

    T_base_begin: Annotated[Floats, "4 4"]
    displacement: Annotated[Floats, "3"]
    turn: Annotated[Floats, "3"]
    poses: int

    @property
    def length(self) -> float:
        """Path of the origin [m]."""
        return float(np.linalg.norm(self.displacement))

    @property
    def angle(self) -> float:
        """Turn of the orientation [rad]."""
        return float(np.linalg.norm(self.turn))

    @property
    def stands(self) -> bool:
        """Whether the sweep has no length at all: every pose is the same."""
        return self.length <= _SAME and self.angle <= _SAME

    def at(self, u: Floats) -> Floats:
        """(n, 4, 4) scanner poses [m] at (n,) parameters."""
        T = np.tile(self.T_base_begin, (len(u), 1, 1))
        T[:, :3, :3] = rotations(u[:, None] * self.turn) @ self.T_base_begin[:3, :3]
        T[:, :3, 3] += u[:, None] * self.displacement
        return T

    def cruise(self, speed: SweepSpeed) -> float:
        """Time for the line at constant speed [s], ramps not counted: the shortest that `speed` allows."""
        push = max(self.length / speed.linear_acceleration, self.angle / speed.angular_acceleration)
        rising, easing = self.ramp_shares
        return max(
            self.length / speed.linear,
            self.angle / speed.angular,
            float(np.sqrt(push / rising)),
            float(np.cbrt(push * _EASE / (rising * easing))),
        )

    @property
    def ramp_shares(self) -> tuple[float, float]:
        """`ramp` and `ease` of the profile (`planner.timing.s_curve.Profile`) as shares of `cruise`.

        The ramps take the half cells before the first and behind the last pose, all of them, so that every pose is
        passed at constant speed: a ramp covers half of what the constant speed would in its time.
        """
        return 0.8 / self.poses, 0.2 / self.poses

    def profile(self, cruise: float) -> Profile:
        """The profile of u that takes `cruise` seconds at constant speed, and its ramps besides."""
        rising, easing = self.ramp_shares
        return Profile(np.array(cruise), np.array(cruise * rising), np.array(cruise * easing))


def line_through(T_base_scanner: ArrayLike) -> SweepLine | None:
    """The line of a column of poses.

    Args:
        T_base_scanner: (K, 4, 4) poses [m], K at least 2.

    Returns:
        The line; None where the poses do not follow each other at equal steps on one.
    """
    T = readonly("T_base_scanner", T_base_scanner, (None, 4, 4))
    count = len(T)
    if count < 2:
        return None
    steps = np.diff(T[:, :3, 3], axis=0)
    turns = rotation_vectors(T[1:, :3, :3] @ np.swapaxes(T[:-1, :3, :3], 1, 2))
    step, turn = steps.mean(axis=0), turns.mean(axis=0)
    if max(np.abs(steps - step).max(), np.abs(turns - turn).max()) > _SAME:
        return None
    if np.linalg.norm(turn) * count >= np.pi:
        return None
    begin = T[0].copy()
    begin[:3, 3] -= 0.5 * step
    begin[:3, :3] = rotations(-0.5 * turn[None])[0] @ begin[:3, :3]
    return SweepLine(begin, step * count, turn * count, count)


def rotations(vectors: Floats) -> Floats:
    """(n, 3, 3) rotations of (n, 3) rotation vectors [rad] (Rodrigues)."""
    angle = np.linalg.norm(vectors, axis=1)
    safe = np.where(angle > 0.0, angle, 1.0)
    x, y, z = (vectors / safe[:, None]).T
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    R: Floats = np.eye(3) + np.sin(angle)[:, None, None] * cross + (1.0 - np.cos(angle))[:, None, None] * cross @ cross
    return R


def rotation_vectors(R: Floats) -> Floats:
    """(n, 3) rotation vectors [rad] of (n, 3, 3) rotations by less than pi."""
    sine = 0.5 * np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1)
    length = np.linalg.norm(sine, axis=1)
    angle = np.arctan2(length, 0.5 * (np.trace(R, axis1=1, axis2=2) - 1.0))
    factor = np.where(length > 0.0, angle / np.where(length > 0.0, length, 1.0), 1.0)
    return np.asarray(sine * factor[:, None])
