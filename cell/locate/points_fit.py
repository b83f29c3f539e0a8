"""Placements from named points: pairs of nominal and measured points, and the 3-2-1 rule of six points.

Pairs: the least-squares rotation and translation by singular values (Arun, Huang and Blostein, IEEE PAMI 9(5), 1987,
doi:10.1109/TPAMI.1987.4767965, with Umeyama's sign, doi:10.1109/34.88573).

3-2-1: three points lie on a plane, two on a plane across it, one on a plane across both; each measured point need only
lie somewhere on its plane. Six conditions for six unknowns, so nothing is left over that says how precise they are.
Nominal points in the object frame, measured ones in base; metres, radians.
"""

import numpy as np

from cell.errors import UsageError
from cell.reconstruction.freedom import split
from cell.reconstruction.rigid import RigidFit, covariance_of, hat
from planner.values import Floats

_SAME = 1e-6  # m; points that are no farther apart are one


def of_pairs(nominal: Floats, measured: Floats, centre: Floats, length: float, sd: float | None = None) -> RigidFit:
    """T_base_object of pairs of points.

    Args:
        nominal: (N, 3) on the part, object frame [m].
        measured: (N, 3) the same points, base [m].
        centre: (3,) of the part [m], object frame.
        length: of the part [m].
        sd: standard deviation of a measured coordinate [m]; None takes it from what is left over, if anything is.

    Raises:
        UsageError: if there are fewer than three pairs, or all points are one.
    """
    if len(nominal) < 3:
        raise UsageError(f"{len(nominal)} pairs of points say no placement; give at least three, not on one line")
    middle, there = nominal.mean(axis=0), measured.mean(axis=0)
    if np.linalg.norm(nominal - middle, axis=1).max() < _SAME:
        raise UsageError("the pairs name one point only; give at least three, not on one line")
    left_axes, _, right_axes = np.linalg.svd((measured - there).T @ (nominal - middle))
    T = np.eye(4)
    T[:3, :3] = left_axes @ np.diag([1.0, 1.0, np.sign(np.linalg.det(left_axes @ right_axes))]) @ right_axes
    T[:3, 3] = there - T[:3, :3] @ middle
    left = measured @ T[:3, :3] - (T[:3, 3] @ T[:3, :3]) - nominal  # in object axes
    J = np.concatenate([np.broadcast_to(np.eye(3), (len(nominal), 3, 3)), -hat(nominal - centre)], axis=2)
    J = J.reshape(-1, 6)
    seen, free = split(J.T @ J, 3.0 * len(nominal), length)
    surplus = 3 * len(nominal) - seen.shape[1]
    if sd is None and surplus > 0:
        sd = float(np.sqrt((left**2).sum() / surplus))
    covariance = None if sd is None else sd**2 * covariance_of(J.T @ J, seen, length)
    return RigidFit(T, covariance, free, centre, length, np.linalg.norm(left, axis=1))


def of_six(nominal: Floats, measured: Floats, centre: Floats, length: float, sd: float | None = None) -> RigidFit:
    """T_base_object by the 3-2-1 rule.

    Args:
        nominal: (6, 3) on the part, object frame [m]: three of the first plane, two of the second, one of the third.
        measured: (6, 3) on the same planes, base [m].
        centre: (3,) of the part [m], object frame.
        length: of the part [m].
        sd: standard deviation of a measured coordinate [m]; None: not known.

    Returns:
        The placement; residuals are the distances of measured from nominal points along their planes, which the rule
        leaves open.

    Raises:
        UsageError: if there are not six pairs, the first three lie on a line, or the next two stand across their plane.
    """
    if len(nominal) != 6 or len(measured) != 6:
        raise UsageError(f"3-2-1 takes six pairs of points, three, two and one; there are {len(nominal)}")
    T_object_frame, T_base_frame = _frame("nominal", nominal), _frame("measured", measured)
    T: Floats = T_base_frame @ np.linalg.inv(T_object_frame)
    along = measured @ T[:3, :3] - (T[:3, 3] @ T[:3, :3]) - nominal
    normals = T_object_frame[:3, :3].T[[2, 2, 2, 1, 1, 0]]
    J = np.hstack([normals, np.cross(nominal - centre, normals)])
    covariance = None if sd is None else sd**2 * covariance_of(J.T @ J, np.eye(6), length)
    left = np.linalg.norm(along - (along * normals).sum(axis=1)[:, None] * normals, axis=1)
    return RigidFit(T, covariance, np.empty((6, 0)), centre, length, left)


def _frame(what: str, points: Floats) -> Floats:
    """(4, 4) the frame of six points: z across the first plane, x along the two, the origin where the planes meet."""
    a, b, c, d, e, f = points
    across = np.cross(b - a, c - a)
    size = max(float(np.linalg.norm(b - a) * np.linalg.norm(c - a)), _SAME**2)
    if np.linalg.norm(across) < 1e-3 * size:
        raise UsageError(f"the first three {what} points lie on a line and give no plane; spread them")
    z = across / np.linalg.norm(across)
    x = (e - d) - z * (z @ (e - d))
    if np.linalg.norm(x) < max(1e-3 * float(np.linalg.norm(e - d)), _SAME):
        raise UsageError(
            f"the fourth and the fifth of the {what} points stand above each other on the plane of the first three; "
            "choose them side by side"
        )
    x = x / np.linalg.norm(x)
    y = np.cross(z, x)
    T = np.eye(4)
    T[:3, :3] = np.stack([x, y, z], axis=1)
    T[:3, 3] = x * (x @ f) + y * (y @ d) + z * (z @ a)
    return T
