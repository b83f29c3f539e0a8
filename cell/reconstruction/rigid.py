"""A rigid motion that was fitted to points: what it is worth, and what of it the points do not determine.

A small motion is (translation [m], rotation [rad]) about a centre. To compare turns with translations they are
multiplied by a length, the root mean square distance of the body's points from the centre: a direction's number is then
about what it moves the body's points by. Metres, radians; axes of the body.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.spatial.transform import Rotation

from cell.reconstruction.freedom import FreeMotion, name, shape_of
from planner.values import Floats, Value

ENOUGH = 2.0
"""A direction is determined where so many standard deviations are within what is asked for: 95 of 100 times."""

_UNWIND = 5  # a free screw and the rest do not commute: each turn leaves a fraction of what it finds
_SMALL = 1e-3  # rad: below, series whose next term is 1e-12 of the first
_ENDLESS = 1e3  # lengths: the standard deviation that stands for that of a free motion


@dataclass(frozen=True, slots=True, eq=False)
class RigidFit(Value):
    """A rigid motion, and how well points determine it.

    Attributes:
        T: (4, 4) that was looked for [m].
        covariance: (6, 6) of (translation, rotation) about `centre` in the directions that are seen [m, rad]; None
            where nothing says how precise the points are.
        free: (6, f) orthonormal directions that the points do not see, in coordinates (translation, length * rotation).
        centre: (3,) of the body [m].
        length: of the body [m].
        residuals: (N,) distances that are left [m].
        used: share of the points that count; the others are outliers.
        rivals: sentences about other motions that fit about as well.
        doubts: what speaks against it, a sentence each.
    """

    T: Annotated[Floats, "4 4"]
    covariance: Annotated[Floats, "6 6"] | None
    free: Annotated[Floats, "6 _"]
    centre: Annotated[Floats, "3"]
    length: float
    residuals: Annotated[Floats, "_"]
    used: float = 1.0
    rivals: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()

    @property
    def rms(self) -> float:
        """Root mean square of the residuals [m]; 0 without any."""
        return float(np.sqrt(np.mean(self.residuals**2))) if len(self.residuals) else 0.0

    def undetermined(self, within: float) -> tuple[FreeMotion, ...]:
        """Motions that are free, or whose `ENOUGH` standard deviations move the body's points by more than this [m]."""
        return name(self.open_directions(within), self.centre, self.length)

    def open_directions(self, within: float) -> Floats:
        """(6, f) the same as orthonormal directions, in coordinates (translation, length * rotation)."""
        scale = _scale(self.length)
        known = np.zeros((6, 6)) if self.covariance is None else self.covariance * scale[:, None] * scale
        values, vectors = np.linalg.eigh(known + (_ENDLESS * self.length) ** 2 * self.free @ self.free.T)
        return np.asarray(vectors[:, ENOUGH * np.sqrt(np.maximum(values, 0.0)) > within])

    def off(self, T: Floats, within: float) -> tuple[float, float]:
        """How far the body is moved [m] and turned [rad] by a motion (4, 4), along what is determined alone."""
        scale, open_ = _scale(self.length), self.open_directions(within)
        screw = scale * screw_of(T, self.centre)
        seen = (screw - open_ @ (open_.T @ screw)) / scale
        return float(np.linalg.norm(seen[:3])), float(np.linalg.norm(seen[3:]))

    def deviation_of(self, points: Floats) -> float | None:
        """Standard deviation of that of (N, 3) points of the body that is known least [m], along its worst direction.

        Free motions are left out. None where nothing says how precise the points are.
        """
        if self.covariance is None:
            return None
        J = np.concatenate([np.broadcast_to(np.eye(3), (len(points), 3, 3)), -hat(points - self.centre)], axis=2)
        return float(np.sqrt(np.linalg.eigvalsh(J @ self.covariance @ J.transpose(0, 2, 1)).max(initial=0.0)))


def hat(v: Floats) -> Floats:
    """Matrices (..., 3, 3) that multiply a vector to its cross product with (..., 3): v x w."""
    x, y, z = np.moveaxis(np.asarray(v, dtype=np.float64), -1, 0)
    o = np.zeros_like(x)
    return np.stack([np.stack(row, axis=-1) for row in ((o, -z, y), (z, o, -x), (-y, x, o))], axis=-2)


def about(offset: Floats) -> Floats:
    """(6, 6) that makes of a small motion about one centre the same one about another, `offset` (3,) away [m]."""
    A = np.eye(6)
    A[:3, 3:] = -hat(offset)
    return A


def screw_of(T: Floats, centre: Floats) -> Floats:
    """(6,) the screw (translation, rotation) about a centre (3,) whose exponential is a motion (4, 4) [m, rad].

    The inverse of the left Jacobian of SO(3): Barfoot, "State Estimation for Robotics" (2017), eq. 7.37.
    """
    turn = Rotation.from_matrix(T[:3, :3]).as_rotvec()
    angle, cross = float(np.linalg.norm(turn)), hat(turn)
    square = 1 / 12 if angle < 1e-4 else (1 - angle / 2 / np.tan(angle / 2)) / angle**2
    shift = T[:3, :3] @ centre + T[:3, 3] - centre
    return np.concatenate([(np.eye(3) - cross / 2 + square * cross @ cross) @ shift, turn])


def motion_of(screw: Floats, centre: Floats) -> Floats:
    """(4, 4) the motion whose screw about a centre (3,) is (6,) (translation, rotation) [m, rad].

    Exponential in closed form: Murray, Li, Sastry (1994), A Mathematical Introduction to Robotic Manipulation, 2.36.
    """
    turn, angle = hat(screw[3:]), float(np.linalg.norm(screw[3:]))
    if angle > _SMALL:
        sine, cosine = np.sin(angle) / angle, 2.0 * (np.sin(angle / 2.0) / angle) ** 2
        rest = (1.0 - sine) / angle**2
    else:
        sine, cosine, rest = 1.0 - angle**2 / 6.0, 0.5 - angle**2 / 24.0, 1.0 / 6.0 - angle**2 / 120.0
    T, twice = np.eye(4), turn @ turn
    T[:3, :3] += sine * turn + cosine * twice
    T[:3, 3] = screw[:3] + (cosine * turn + rest * twice) @ screw[:3] + centre - T[:3, :3] @ centre
    return T


def without_free(T: Floats, free: Floats, centre: Floats, length: float) -> Floats:
    """The motion (4, 4) nearest to none of those that differ from T by free motions alone.

    Args:
        T: [m].
        free: (6, f) orthonormal, in coordinates (translation, length * rotation) about the centre.
        centre: (3,) [m].
        length: [m].
    """
    scale = _scale(length)
    for _ in range(_UNWIND):
        T = motion_of(-(free @ (free.T @ (scale * screw_of(T, centre)))) / scale, centre) @ T
    return T


def covariance_of(information: Floats, seen: Floats, length: float) -> Floats:
    """(6, 6) covariance of a least-squares estimate in the directions that it sees, zero in the others.

    Args:
        information: (6, 6) of (translation [m], rotation [rad]): the sum of J^T J / sigma^2.
        seen: (6, r) orthonormal directions in coordinates (translation, length * rotation).
        length: [m].
    """
    B = seen / _scale(length)[:, None]
    return np.asarray(B @ np.linalg.solve(B.T @ information @ B, B.T))


def moved_basis(free: Floats, offset: Floats, lengths: tuple[float, float]) -> Floats:
    """(6, f) orthonormal directions about a centre `offset` (3,) away [m], lengths being those here and there [m]."""
    there = _scale(lengths[1])[:, None] * (about(offset) @ (free / _scale(lengths[0])[:, None]))
    return np.asarray(np.linalg.qr(there)[0])


def told(motions: tuple[FreeMotion, ...]) -> str:
    """Undetermined motions in words: the surface that has them, and each; "" for none."""
    shape = shape_of(motions)
    return (f"{shape}: " if shape else "") + "; ".join(motion.sentence for motion in motions)


def _scale(length: float) -> Floats:
    return np.array([1.0, 1.0, 1.0, length, length, length])
