"""Sweeps: a line sensor is moved or turned while it measures, so its viewpoint is a column of K poses.

The laser sheet of a line sensor is the plane x = 0 of the scanner frame: it holds the viewing direction z and the line
(along y), and stands across the baseline (x), because the triangulation plane (x, z) must be perpendicular to it. A
sweep therefore advances the sheet along x or turns it about y.

The sweep's length (or angle) is divided into K equal cells, as the rays of a grid are, and a pose stands in the middle
of each: pose k is at ((k + 0.5) / K - 0.5) x length. A scanner whose line counts as one cell thick,

    |x| <= length / (2 K)          straight
    |atan2(x, z)| <= angle / (2 K) turned,

tiles the swept volume without gap and without overlap, whatever K is. K only decides from how near to its true place a
point is judged: at most half a cell away. The sweep is symmetric about the candidate viewpoint that it is made from.

Object frame, metres, radians.
"""

import numpy as np
from numpy.typing import ArrayLike

from planner.errors import PlannerError
from planner.values import Floats, readonly
from planner.viewpoints.viewpoints import Viewpoints


def straight_poses(length: float, count: int, direction: ArrayLike = (1.0, 0.0, 0.0)) -> Floats:
    """(K, 4, 4) T_view_scanner [m]: the poses of a straight sweep about a candidate viewpoint at the identity.

    Args:
        length: of the path [m], > 0.
        count: K poses.
        direction: (3,) of the path in the scanner frame, of any length. Default: along the baseline.

    Raises:
        PlannerError: if an argument is not possible.
    """
    if not (np.isfinite(length) and length > 0):
        raise PlannerError(f"a straight sweep of {length:g} m is not possible; its length must be above 0 and finite")
    along = np.array(readonly("direction", direction, (3,)))
    norm = float(np.linalg.norm(along))
    if not (np.isfinite(norm) and norm > 0):
        raise PlannerError(f"direction {along.tolist()} has no direction; give three numbers that are not all 0")
    poses = np.tile(np.eye(4), (_checked(count), 1, 1))
    poses[:, :3, 3] = (_middles(count) * length)[:, None] * (along / norm)
    return poses


def turned_poses(angle: float, count: int) -> Floats:
    """(K, 4, 4) T_view_scanner [m]: the poses of a turned sweep about a candidate viewpoint at the identity.

    Args:
        angle: swept by the sheet [rad], above 0 and below pi; it turns about the scanner's y axis, from -x to +x.
        count: K poses.

    Raises:
        PlannerError: if an argument is not possible.
    """
    if not 0 < angle < np.pi:
        raise PlannerError(f"a sweep turned by {angle:g} rad is not possible; the angle must be above 0 and below pi")
    poses = np.tile(np.eye(4), (_checked(count), 1, 1))
    turn = _middles(count) * angle
    poses[:, 0, 0] = poses[:, 2, 2] = np.cos(turn)
    poses[:, 0, 2], poses[:, 2, 0] = np.sin(turn), -np.sin(turn)
    return poses


def swept(viewpoints: Viewpoints, T_view_scanner: ArrayLike) -> Viewpoints:
    """Each viewpoint becomes the column of poses viewpoint x T_view_scanner, and stays the middle of its sweep.

    Args:
        viewpoints: V of one pose each.
        T_view_scanner: (K, 4, 4) poses in the frame of the viewpoint [m].

    Raises:
        PlannerError: if a viewpoint has several poses already, or there is no pose.
    """
    poses = readonly("T_view_scanner", T_view_scanner, (None, 4, 4))
    if not len(poses):
        raise PlannerError("T_view_scanner holds no pose; a sweep needs at least one")
    if viewpoints.T_object_scanner.shape[1] != 1:
        raise PlannerError(
            f"the viewpoints have {viewpoints.T_object_scanner.shape[1]} poses each; a sweep is made from single poses"
        )
    return Viewpoints(viewpoints.T_object_scanner @ poses, viewpoints.face, viewpoints.standoff, viewpoints.roll)


def _middles(count: int) -> Floats:
    """(K,) middles of K equal cells of [-0.5, 0.5]."""
    return (np.arange(count) + 0.5) / count - 0.5


def _checked(count: int) -> int:
    if count < 1:
        raise PlannerError(f"a sweep of {count} poses is not possible; it needs at least one")
    return count
