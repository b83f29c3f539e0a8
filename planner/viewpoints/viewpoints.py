"""Candidate viewpoints: poses of the scanner from which the part may be measured (Section 3.4).

A viewpoint is one column of the measurability matrix: K poses of the scanner in the object frame, K = 1 for an area
scanner. The origin of the scanner is the laser source, +z the viewing direction, +x from source to sensor (the
baseline).

Roll turns the scanner about its viewing axis. At roll 0 the baseline is as parallel as possible to the object's z axis
(to its x axis if the view is along z). A positive roll turns the baseline from scanner +x towards scanner +y,
right-handed about the viewing direction: clockwise for an observer who looks along with the scanner.

A line sensor moves or turns while it measures, so its viewpoint has many poses: a sweep. The laser sheet is the plane
x = 0 of the scanner frame. It contains the viewing direction z and the line (along y), and is perpendicular to the
baseline (x), because the triangulation plane (x, z) must be perpendicular to it. A sweep therefore advances the sheet
along x or turns it about y. Its length (or angle) is divided into K equal cells, as the rays of a grid are, with a pose
in the middle of each: pose k is at ((k + 0.5) / K - 0.5) x length. A scanner whose line counts as one cell thick,

    |x| <= length / (2 K)          straight
    |atan2(x, z)| <= angle / (2 K) turned,

tiles the swept volume without gap and without overlap for any K. K only determines how near to its true place a point
is judged: at most half a cell away. The sweep is symmetric about the candidate from which it is made.

Object frame, metres, radians.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner.errors import PlannerError
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats, Ints32, Rows, readonly

_ALONG_Z = 1e-3  # sine below which a view counts as along z: a flat top's normals scatter by less in a float32 mesh


@dataclass(frozen=True, slots=True, eq=False)
class Viewpoints(Rows):
    """Candidate viewpoints.

    Attributes:
        T_object_scanner: (V, K, 4, 4) poses of the scanner [m].
        face: (V,) planning face for which the viewpoint was made, -1 for none.
        standoff: (V,) distance from the source to the point at which it is aimed [m].
        roll: (V,) angle about the viewing axis [rad].
    """

    T_object_scanner: Annotated[Floats, "V K 4 4"]
    face: Annotated[Ints32, "V"]
    standoff: Annotated[Floats, "V"]
    roll: Annotated[Floats, "V"]


def aim_viewpoints(
    targets: Floats, outward: Floats, face: NDArray[np.integer], standoffs: Sequence[float], rolls: Sequence[float]
) -> Viewpoints:
    """Return views of given points from given directions; standoffs and rolls change fastest, the rolls last.

    Args:
        targets: (N, 3) points at which the views are aimed [m].
        outward: (N, 3) unit directions from the points to the scanner.
        face: (N,) planning face of each point, -1 for none.
        standoffs: distances from point to source [m], > 0.
        rolls: angles about the viewing axis [rad].
    """
    distances, angles = _require_lengths("standoffs", standoffs), _require_angles(rolls)
    rotations = _level_rotations(-outward)
    cos, sin, zero = np.cos(angles), np.sin(angles), np.zeros(len(angles))
    about_z = np.stack([cos, -sin, zero, sin, cos, zero, zero, zero, zero + 1], axis=1).reshape(-1, 3, 3)
    shape = (len(targets), len(distances), len(angles))
    poses = np.zeros((*shape, 4, 4))
    poses[..., :3, :3] = np.einsum("nij,rjk->nrik", rotations, about_z)[:, None]
    poses[..., :3, 3] = (targets[:, None] + distances[:, None] * outward[:, None])[:, :, None]
    poses[..., 3, 3] = 1.0
    return Viewpoints(
        poses.reshape(-1, 1, 4, 4),
        np.broadcast_to(np.asarray(face)[:, None, None], shape).ravel().astype(np.int32),
        np.broadcast_to(distances[None, :, None], shape).ravel(),
        np.broadcast_to(angles, shape).ravel(),
    )


def viewpoints_from_poses(T_object_scanner: Floats, aim: Floats, face: NDArray[np.integer]) -> Viewpoints:
    """Return viewpoints of given poses.

    Args:
        T_object_scanner: (N, 4, 4) poses of the scanner [m].
        aim: (N, 3) points at which they are aimed [m]; their distance is the standoff.
        face: (N,) planning face of each point, -1 for none.
    """
    R = T_object_scanner[:, :3, :3]
    level = _level_rotations(R[:, :, 2])
    along, across = (np.einsum("ni,ni->n", level[:, :, axis], R[:, :, 0]) for axis in (0, 1))
    return Viewpoints(
        T_object_scanner[:, None],
        np.asarray(face, dtype=np.int32),
        np.linalg.norm(aim - T_object_scanner[:, :3, 3], axis=1),
        np.arctan2(across, along) % (2 * np.pi),
    )


def optimal_scanning_zone(planning: TriangleMesh, standoffs: Sequence[float], rolls: Sequence[float]) -> Viewpoints:
    """Return a viewpoint per planning face, standoff and roll, the last changing fastest (Section 3.4.2).

    The source is at the standoff from the centre of the face along its normal, and looks against the normal. A face
    without area has no normal and gives no viewpoint.

    Args:
        planning: the decimated mesh.
        standoffs: distances from the centre of the face [m], > 0.
        rolls: angles about the viewing axis [rad].
    """
    face = np.flatnonzero(planning.areas > 0)
    return aim_viewpoints(planning.centres[face], planning.normals[face], face, standoffs, rolls)


def view_sphere(
    centre: ArrayLike, radius: float, step_x: float, step_y: float, rolls: Sequence[float] = (0.0,)
) -> Viewpoints:
    """Return viewpoints on a sphere about a point, all aimed at it (Section 3.4.1).

    The outward direction is +z, turned about x by multiples of `step_x` from -90 to 90 degrees and then about y by
    multiples of `step_y` below 360 degrees. The poles (on the y axis), which a turn about y does not move, occur once:
    steps of 15 degrees give 11 x 24 + 2 = 266 directions.

    Args:
        centre: (3,) point at which the views are aimed [m].
        radius: of the sphere [m]; it must enclose the part, see `enclosing_radius`.
        step_x: step about x [rad], in (0, pi].
        step_y: step about y [rad], in (0, pi].
        rolls: angles about the viewing axis [rad].
    """
    if not (radius > 0 and np.isfinite(radius)):
        raise PlannerError(f"radius is {radius:g} m; it must be above 0 and finite")
    for name, step in (("step_x", step_x), ("step_y", step_y)):
        if not 0 < step <= np.pi:
            raise PlannerError(f"{name} is {step:g} rad; it must be above 0 and at most pi")
    n_x = int(np.floor(np.pi / 2 / step_x + 1e-9))
    n_y = int(np.ceil(2 * np.pi / step_y - 1e-9))
    about_x, about_y = np.meshgrid(np.arange(-n_x, n_x + 1) * step_x, np.arange(n_y) * step_y, indexing="ij")
    pole = np.abs(np.cos(about_x)) < 1e-9
    once = ~pole | (about_y == 0)
    a, b = about_x[once], about_y[once]
    outward = np.stack([np.cos(a) * np.sin(b), -np.sin(a), np.cos(a) * np.cos(b)], axis=1)  # Ry(b) Rx(a) e_z
    middle = np.broadcast_to(readonly("centre", centre, (3,)), outward.shape)
    return aim_viewpoints(middle, outward, np.full(len(outward), -1), [radius], rolls)


def enclosing_radius(mesh: TriangleMesh, centre: ArrayLike) -> float:
    """Return the radius [m] of the smallest sphere about `centre` (3,) [m] that contains every vertex."""
    return float(np.linalg.norm(mesh.vertices - readonly("centre", centre, (3,)), axis=1).max())


def straight_sweep_poses(length: float, count: int, direction: ArrayLike = (1.0, 0.0, 0.0)) -> Floats:
    """Return (K, 4, 4) T_view_scanner [m]: the poses of a straight sweep about a candidate at the identity.

    Args:
        length: of the path [m], > 0.
        count: K poses.
        direction: (3,) of the path in the scanner frame, of any length. Default: along the baseline.
    """
    if not (np.isfinite(length) and length > 0):
        raise PlannerError(f"a straight sweep of {length:g} m is not possible; its length must be above 0 and finite")
    along = np.array(readonly("direction", direction, (3,)))
    norm = float(np.linalg.norm(along))
    if not (np.isfinite(norm) and norm > 0):
        raise PlannerError(f"direction {along.tolist()} has no direction; give three numbers that are not all 0")
    offsets = _cell_middles(count)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, 3] = (offsets * length)[:, None] * (along / norm)
    return poses


def turned_sweep_poses(angle: float, count: int) -> Floats:
    """Return (K, 4, 4) T_view_scanner [m]: the poses of a turned sweep about a candidate at the identity.

    Args:
        angle: swept by the sheet [rad], above 0 and below pi; it turns about the scanner's y axis, from -x to +x.
        count: K poses.
    """
    if not 0 < angle < np.pi:
        raise PlannerError(f"a sweep turned by {angle:g} rad is not possible; the angle must be above 0 and below pi")
    turn = _cell_middles(count) * angle
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 0, 0] = poses[:, 2, 2] = np.cos(turn)
    poses[:, 0, 2], poses[:, 2, 0] = np.sin(turn), -np.sin(turn)
    return poses


def sweep_viewpoints(viewpoints: Viewpoints, T_view_scanner: ArrayLike) -> Viewpoints:
    """Replace the single pose of each viewpoint by the sweep pose x T_view_scanner (K, 4, 4) [m], centred on it."""
    poses = readonly("T_view_scanner", T_view_scanner, (None, 4, 4))
    if not len(poses):
        raise PlannerError("T_view_scanner holds no pose; a sweep needs at least one")
    if viewpoints.T_object_scanner.shape[1] != 1:
        raise PlannerError(
            f"the viewpoints have {viewpoints.T_object_scanner.shape[1]} poses each; a sweep is made from single poses"
        )
    return Viewpoints(viewpoints.T_object_scanner @ poses, viewpoints.face, viewpoints.standoff, viewpoints.roll)


def _cell_middles(count: int) -> Floats:
    """Return (count,) middles of equal cells of [-0.5, 0.5]."""
    if count < 1:
        raise PlannerError(f"a sweep of {count} poses is not possible; it needs at least one")
    return (np.arange(count) + 0.5) / count - 0.5


def _level_rotations(directions: Floats) -> Floats:
    """Return (N, 3, 3) R_object_scanner with roll 0 for unit viewing directions (N, 3)."""
    towards_z = np.array([0.0, 0.0, 1.0]) - directions[:, 2:] * directions
    towards_x = np.array([1.0, 0.0, 0.0]) - directions[:, :1] * directions
    along_z = np.hypot(directions[:, 0], directions[:, 1]) < _ALONG_Z
    baseline = np.where(along_z[:, None], towards_x, towards_z)
    baseline /= np.linalg.norm(baseline, axis=1, keepdims=True)
    # Orthogonalise twice: near the z axis the first subtraction cancels digits.
    baseline -= np.einsum("nj,nj->n", baseline, directions)[:, None] * directions
    baseline /= np.linalg.norm(baseline, axis=1, keepdims=True)
    return np.stack([baseline, np.cross(directions, baseline), directions], axis=2)


def _require_lengths(name: str, values: Sequence[float]) -> Floats:
    """Return the values as (n,) array of finite lengths above zero [m]."""
    lengths = readonly(name, values, (None,))
    if not len(lengths):
        raise PlannerError(f"{name} is empty; give at least one length in metres")
    if not (np.isfinite(lengths).all() and (lengths > 0).all()):
        raise PlannerError(f"{name} contains {float(lengths.min()):g} m; every length must be above 0 and finite")
    return lengths


def _require_angles(rolls: Sequence[float]) -> Floats:
    """Return the rolls as (n,) array of finite angles [rad]."""
    angles = readonly("rolls", rolls, (None,))
    if not len(angles) or not np.isfinite(angles).all():
        raise PlannerError("rolls must hold at least one finite angle in radians")
    return angles
