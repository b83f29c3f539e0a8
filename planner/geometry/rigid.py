"""Rotations and rigid motions: rotation vectors, angles, inverse.

scipy's `Rotation` goes through quaternions and rounds differently; these formulas keep the bytes of stored runs.
"""

import numpy as np
from numpy.typing import ArrayLike

from planner.values import Floats


def rotation_matrices(vectors: Floats, *, scale_first: bool = False) -> Floats:
    """Return (n, 3, 3) rotations about vectors (n, 3) by their lengths [rad] (Rodrigues' formula).

    `scale_first` only changes the last bit, by another order of the products: sweeps use it, as stored runs do.
    """
    angle = np.linalg.norm(vectors, axis=1)
    axis = vectors / np.where(angle > 0, angle, 1.0)[:, None]
    K = np.zeros((len(vectors), 3, 3))
    K[:, 0, 1], K[:, 0, 2], K[:, 1, 2] = -axis[:, 2], axis[:, 1], -axis[:, 0]
    K -= K.transpose(0, 2, 1)
    sine, versine = np.sin(angle)[:, None, None], 1.0 - np.cos(angle)[:, None, None]
    return np.asarray(np.eye(3) + sine * K + ((versine * K) @ K if scale_first else versine * (K @ K)))


def rotation_vectors(R: Floats) -> Floats:
    """Return (n, 3) rotation vectors [rad] of (n, 3, 3) rotations by less than pi."""
    sine = 0.5 * np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1)
    length = np.linalg.norm(sine, axis=1)
    angle = np.arctan2(length, 0.5 * (np.trace(R, axis1=1, axis2=2) - 1.0))
    factor = np.where(length > 0.0, angle / np.where(length > 0.0, length, 1.0), 1.0)
    return np.asarray(sine * factor[:, None])


def pose_difference(T_a: Floats, T_b: Floats) -> tuple[float, float]:
    """Return the distance of the origins [m] and the angle between the axes [rad] of two poses (4, 4)."""
    R = T_a[:3, :3].T @ T_b[:3, :3]
    # From sine and cosine together: the arc cosine alone loses half the digits near zero.
    sine = np.linalg.norm([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return float(np.linalg.norm(T_a[:3, 3] - T_b[:3, 3])), float(np.arctan2(sine, np.trace(R) - 1))


def rigid_transform(R: ArrayLike, t: ArrayLike) -> Floats:
    """Return the transform (4, 4) with a rotation (3, 3) and a translation (3,) [m]."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, t
    return T


def translation(t: ArrayLike) -> Floats:
    """Return the transform (4, 4) by a translation (3,) [m]."""
    return rigid_transform(np.eye(3), t)


def inverse_rigid(T: Floats) -> Floats:
    """Return the inverse (4, 4) of a rigid transform."""
    return rigid_transform(T[:3, :3].T, -T[:3, :3].T @ T[:3, 3])
