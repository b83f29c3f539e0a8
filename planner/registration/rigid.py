"""Rigid motions as 4 x 4 matrices, screws and small motions. Metres, radians.

A small motion is a vector (translation [m], rotation [rad]) about a centre. Rotations are compared with translations
after multiplication by a length, the root mean square distance of the body's points from the centre: each component is
then about the distance by which it moves these points.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from planner.geometry.rigid import rigid_transform
from planner.values import Floats

_UNWIND = 5  # a free screw and the remaining motion do not commute: each pass leaves a fraction of what it removes
_SMALL = 1e-3  # rad: below, series whose next term is 1e-12 of the first


def transform_points(T: NDArray[np.floating[Any]], points: Floats) -> Floats:
    """Apply a motion (4, 4) to points (N, 3)."""
    return np.asarray(points @ T[:3, :3].T + T[:3, 3], dtype=np.float64)


def skew(v: Floats) -> Floats:
    """Return the matrices (..., 3, 3) of the cross product v x w for vectors (..., 3)."""
    x, y, z = np.moveaxis(np.asarray(v, dtype=np.float64), -1, 0)
    o = np.zeros_like(x)
    return np.stack([np.stack(row, axis=-1) for row in ((o, -z, y), (z, o, -x), (-y, x, o))], axis=-2)


def length_scale(length: float) -> Floats:
    """Return the (6,) factors that make the rotation of a small motion comparable with its translation [m]."""
    return np.array([1.0, 1.0, 1.0, length, length, length])


def motion_from_vector(change: Floats, centre: Floats) -> Floats:
    """Return the motion (4, 4): rotation by the vector change[3:] about `centre`, then translation by change[:3].

    The rotation is Rodrigues' formula.
    """
    angle = float(np.linalg.norm(change[3:]))
    x, y, z = change[3:] / angle if angle > 0 else np.zeros(3)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    rotation = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return rigid_transform(rotation, centre + change[:3] - rotation @ centre)


def motion_from_screw(screw: Floats, centre: Floats) -> Floats:
    """Return the motion (4, 4) with the screw (6,) about a centre (3,), its exponential.

    Closed form: Murray, Li, Sastry (1994), A Mathematical Introduction to Robotic Manipulation, 2.36.
    """
    turn, angle = skew(screw[3:]), float(np.linalg.norm(screw[3:]))
    if angle > _SMALL:
        sine, cosine = np.sin(angle) / angle, 2.0 * (np.sin(angle / 2.0) / angle) ** 2
        rest = (1.0 - sine) / angle**2
    else:
        sine, cosine, rest = 1.0 - angle**2 / 6.0, 0.5 - angle**2 / 24.0, 1.0 / 6.0 - angle**2 / 120.0
    T, twice = np.eye(4), turn @ turn
    T[:3, :3] += sine * turn + cosine * twice
    T[:3, 3] = screw[:3] + (cosine * turn + rest * twice) @ screw[:3] + centre - T[:3, :3] @ centre
    return T


def screw_from_motion(T: Floats, centre: Floats) -> Floats:
    """Return the screw (6,) about a centre (3,) of a motion (4, 4), its logarithm.

    The inverse of the left Jacobian of SO(3): Barfoot, "State Estimation for Robotics" (2017), eq. 7.37.
    """
    turn = Rotation.from_matrix(T[:3, :3]).as_rotvec()
    angle, cross = float(np.linalg.norm(turn)), skew(turn)
    square = 1 / 12 if angle < 1e-4 else (1 - angle / 2 / np.tan(angle / 2)) / angle**2
    shift = T[:3, :3] @ centre + T[:3, 3] - centre
    return np.concatenate([(np.eye(3) - cross / 2 + square * cross @ cross) @ shift, turn])


def recentring_matrix(offset: Floats) -> Floats:
    """Return the (6, 6) matrix that converts a small motion to another centre, `offset` (3,) away [m]."""
    A = np.eye(6)
    A[:3, 3:] = -skew(offset)
    return A


def recentre_directions(free: Floats, offset: Floats, lengths: tuple[float, float]) -> Floats:
    """Return (6, f) orthonormal directions about a centre `offset` (3,) away; lengths at both centres [m]."""
    there = length_scale(lengths[1])[:, None] * (recentring_matrix(offset) @ (free / length_scale(lengths[0])[:, None]))
    return np.asarray(np.linalg.qr(there)[0])


def remove_free_motion(T: Floats, free: Floats, centre: Floats, length: float) -> Floats:
    """Return the smallest of all motions (4, 4) that differ from T by free motions alone.

    The free directions (6, f) are orthonormal in coordinates (translation, length * rotation) about the centre.
    """
    scale = length_scale(length)
    for _ in range(_UNWIND):
        T = motion_from_screw(-(free @ (free.T @ (scale * screw_from_motion(T, centre)))) / scale, centre) @ T
    return T


def restricted_covariance(information: Floats, directions: Floats, length: float) -> Floats:
    """Return the (6, 6) covariance of a least-squares estimate in some directions, zero in the others.

    `information` (6, 6) is the sum of J^T J / sigma^2 for (translation [m], rotation [rad]); the directions (6, r) are
    orthonormal in coordinates (translation, length * rotation).
    """
    B = directions / length_scale(length)[:, None]
    return np.asarray(B @ np.linalg.solve(B.T @ information @ B, B.T))
