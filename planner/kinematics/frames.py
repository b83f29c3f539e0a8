"""KUKA's A, B, C angles and poses, both ways: R = Rz(A) Ry(B) Rx(C).

Metres and radians; callers with millimetres and degrees (scene file, command line, wire) convert. A rotation has one
(A, B, C) with B in [-90, 90] deg, except at B = +-90 deg, where only A - C (B = 90) or A + C (B = -90) is determined:
there C = 0.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner.errors import PlannerError
from planner.values import Floats

# Below this cosine of B, A and C are rounding noise; B is then +-90 deg to within 1e-14 rad.
_GIMBAL = 1e-14


def pose_from_kuka_abc(position: ArrayLike, abc: ArrayLike) -> Floats:
    """Return the homogeneous transform of a position and KUKA's angles.

    Args:
        position: (..., 3) x, y, z of the frame's origin [m].
        abc: (..., 3) angles A, B, C [rad]; R = Rz(A) Ry(B) Rx(C).

    Returns:
        (..., 4, 4) T that maps the frame's coordinates to those of the position.
    """
    xyz, angles = _triples("position", position), _triples("abc", abc)
    if xyz.shape != angles.shape:
        raise PlannerError(f"position has shape {xyz.shape} and abc {angles.shape}; they must be equal")
    (sa, sb, sc), (ca, cb, cc) = np.moveaxis(np.sin(angles), -1, 0), np.moveaxis(np.cos(angles), -1, 0)
    T = np.zeros((*xyz.shape[:-1], 4, 4))
    T[..., 0, 0], T[..., 0, 1], T[..., 0, 2] = ca * cb, ca * sb * sc - sa * cc, ca * sb * cc + sa * sc
    T[..., 1, 0], T[..., 1, 1], T[..., 1, 2] = sa * cb, sa * sb * sc + ca * cc, sa * sb * cc - ca * sc
    T[..., 2, 0], T[..., 2, 1], T[..., 2, 2] = -sb, cb * sc, cb * cc
    T[..., :3, 3] = xyz
    T[..., 3, 3] = 1.0
    return T


def kuka_abc_from_pose(T: ArrayLike) -> tuple[Floats, Floats]:
    """Return position and KUKA's angles of a homogeneous transform.

    C is computed from the rotation that remains after A is undone. The angles therefore reproduce the rotation to
    rounding error everywhere, B = +-90 deg included (C = 0 there).

    Args:
        T: (..., 4, 4) rigid transform [m].

    Returns:
        (..., 3) position [m] and (..., 3) angles A, B, C [rad]: A and C in (-pi, pi], B in [-pi/2, pi/2].
    """
    pose = np.asarray(T, dtype=np.float64)
    if pose.ndim < 2 or pose.shape[-2:] != (4, 4):
        raise PlannerError(f"T has shape {pose.shape}; it must be (..., 4, 4)")
    R = pose[..., :3, :3]
    # In this form NaN fails the check too.
    if not (np.isfinite(pose).all() and np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max(initial=0.0) < 1e-6):
        raise PlannerError("T has a rotation part that is not orthonormal to 1e-6; give a rigid transform in metres")
    if (np.linalg.det(R) < 0.0).any():
        raise PlannerError("T has a mirrored rotation part (determinant -1); give a right-handed rigid transform")
    cb = np.hypot(R[..., 0, 0], R[..., 1, 0])
    b = np.arctan2(-R[..., 2, 0], cb)
    a = np.where(cb < _GIMBAL, np.arctan2(-R[..., 0, 1], R[..., 1, 1]), np.arctan2(R[..., 1, 0], R[..., 0, 0]))
    sa, ca = np.sin(a), np.cos(a)
    c = np.arctan2(sa * R[..., 0, 2] - ca * R[..., 1, 2], ca * R[..., 1, 1] - sa * R[..., 0, 1])
    c = np.where(cb < _GIMBAL, 0.0, c)
    abc = np.stack([a, b, c], axis=-1)
    abc[..., [0, 2]] = np.where(abc[..., [0, 2]] <= -np.pi, np.pi, abc[..., [0, 2]])
    return pose[..., :3, 3].copy(), abc


def _triples(name: str, values: ArrayLike) -> NDArray[Any]:
    array = np.asarray(values, dtype=np.float64)
    if array.ndim < 1 or array.shape[-1] != 3:
        raise PlannerError(f"{name} has shape {array.shape}; it must be (..., 3)")
    if not np.isfinite(array).all():
        raise PlannerError(f"{name} has a value that is not finite; every value must be a number")
    return array
