"""Sample poses that measure given surface points, over all six degrees of freedom.

A pose that measures a point has six parameters: the place of the point in the scanner's frustum (a distance and two
angles), the direction from which the laser meets the surface (tilt from the normal and azimuth), and the turn of the
scanner about that ray. `draw_poses` takes them (the two angles as one index into a list) from the additive recurrence
of Roberts [1], whose k-th element is

    u_k = frac(1/2 + k (g^-1, ..., g^-6)),        g the real root above 1 of g^7 = g + 1

Any range of elements fills the unit cube evenly, so a search can continue where it stopped, and each point can have its
own range. `transfer_poses` takes poses that measure neighbours of a point and perturbs them with the same sequence: in
a niche few of all poses succeed, and they are close together. `perturb_pose` does this with one pose. Nothing is
random: equal inputs give equal poses.

`Frustum` is the region of the scanner frame in which a surface that faces the laser is measured. It is found by
queries of the scanner's own conditions, so it works with any scanner. Object frame, metres, radians.

[1] M. Roberts, The unreasonable effectiveness of quasirandom sequences, 2018,
    https://extremelearning.com.au/unreasonable-effectiveness-of-quasirandom-sequences/
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from planner.geometry.rigid import rotation_matrices
from planner.ports import RayCaster, Rejection, Scanner
from planner.values import Bools, Floats, Ints, Rows, Value
from planner.viewpoints.lines_of_sight import RayTargets, lines_of_sight_free, rejections

_ROOT = 1.1127756842787055  # of g^7 = g + 1
_STEPS = _ROOT ** -np.arange(1.0, 7.0)
_STRIDE = 65_537  # elements between the ranges of neighbouring points: a prime above any range

_DISTANCES, _ANGLES = 24, 13  # grid of a frustum: along the axis, and in each of the two angles
_NEAREST, _FARTHEST = 1e-3, 30.0  # m, bounds of the search for the scanner's range
_TANGENTS = np.tan(np.deg2rad(np.arange(-88.0, 88.1, 0.25)))  # off the axis, tested for the field of view
_TILTS = np.deg2rad(np.arange(91.0))

_MAX_TURN = np.deg2rad(15.0)  # of a perturbed pose about its point, for each component of the rotation vector
_MAX_SHIFT = 0.15  # of a perturbed pose along each axis, as a share of the distance


@dataclass(frozen=True, slots=True, eq=False)
class Frustum(Value):
    """Grid of places in the scanner frame at which a surface that faces the laser is measured.

    Attributes:
        points: (n, 3) places [m], ordered by distance.
        start: (d + 1,) first place of each distance.
        tilt: largest angle between laser and normal at which a point on the axis is measured [rad].
    """

    points: Annotated[Floats, "n 3"]
    start: Annotated[Ints, "d+1"]
    tilt: float


@dataclass(frozen=True, slots=True, eq=False)
class AimedPoses(Rows):
    """Poses of the scanner, each aimed at a point.

    Attributes:
        T_object_scanner: (n, 4, 4) poses [m].
        row: (n,) index of the point.
    """

    T_object_scanner: Annotated[Floats, "n 4 4"]
    row: Annotated[Ints, "n"]


NO_POSES = AimedPoses(np.empty((0, 4, 4)), np.empty(0, dtype=np.int64))


def find_frustum(scanner: Scanner) -> Frustum:
    """Find the frustum of a scanner; it has no places if the scanner measures nothing on its axis.

    The grid lies inside the limits, not on them, so that rounded joint angles lose no aimed point.
    """
    on_axis = np.geomspace(_NEAREST, _FARTHEST, 2000)
    measured = np.flatnonzero(_measures_facing(scanner, on_axis[:, None] * [0.0, 0.0, 1.0]))
    if not len(measured):
        return Frustum(np.empty((0, 3)), np.zeros(1, dtype=np.int64), 0.0)
    near, far = on_axis[measured[[0, -1]]]
    middle = float(np.sqrt(near * far))
    across, along = (_tangents_in_view(scanner, middle, axis) for axis in (0, 1))
    rays = np.stack([*np.meshgrid(across, along), np.ones((_ANGLES,) * 2)])
    rays = rays.reshape(3, -1).T
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    places = np.geomspace(near, far, _DISTANCES)[:, None, None] * rays
    good = _measures_facing(scanner, places.reshape(-1, 3)).reshape(_DISTANCES, -1)
    counts = good.sum(axis=1)
    start = np.concatenate([[0], np.cumsum(counts[counts > 0])])
    return Frustum(scanner.source + places[good], start, _largest_tilt(scanner, middle))


def draw_poses(
    targets: RayTargets, rows: Ints, elements: tuple[int, int], within: Frustum, scanner: Scanner
) -> AimedPoses:
    """Draw poses that measure their points if nothing occludes them.

    Args:
        targets: S surface points.
        rows: (n,) the points at which the poses are aimed.
        elements: first and last (excluded) element of the sequence for each point.
        within: frustum of the scanner.
        scanner: sensor model; poses that it rejects are left out.
    """
    if not len(within.points):
        return NO_POSES
    row = np.repeat(rows, elements[1] - elements[0])
    u = _sequence(rows, elements)
    level = (u[:, 0] * (len(within.start) - 1)).astype(np.int64)
    first = within.start[level]
    place = within.points[first + (u[:, 1] * (within.start[level + 1] - first)).astype(np.int64)]
    tilt = np.arccos(1.0 - u[:, 2] * (1.0 - np.cos(within.tilt)))  # uniform over the cap of directions
    normals = targets.normals[:, row].T
    R = _rotations_onto(place - scanner.source, normals, tilt, 2 * np.pi * u[:, 3], 2 * np.pi * u[:, 4])
    T = np.zeros((len(R), 4, 4))
    T[:, :3, :3] = R
    T[:, :3, 3] = targets.points[:, row].T - np.einsum("nij,nj->ni", R, place)
    T[:, 3, 3] = 1.0
    return AimedPoses(T, row).pick(_in_view(T, row, targets, scanner))


def transfer_poses(
    targets: RayTargets, rows: Ints, elements: tuple[int, int], known: AimedPoses, neighbours: int, scanner: Scanner
) -> AimedPoses:
    """Perturb poses that measure the nearest points; every other pose is also translated by the points' difference.

    Args:
        targets: S surface points.
        rows: (n,) the points at which the poses are aimed.
        elements: of the sequence, for each point and neighbour.
        known: poses that measure their points.
        neighbours: number of known poses per point: the nearest in position and normal, where a turn by one radian
            counts as much as a displacement by one distance from the scanner.
        scanner: sensor model; poses that it rejects are left out.
    """
    from scipy.spatial import cKDTree  # not loaded by commands that plan nothing

    place = targets.points[:, known.row].T
    distance = np.linalg.norm(place - known.T_object_scanner[:, :3, 3], axis=1)
    scale = float(np.median(distance))

    def position_and_normal(points: Ints) -> Floats:
        return np.concatenate([targets.points[:, points].T / scale, targets.normals[:, points].T], axis=1)

    neighbours = min(neighbours, len(known))
    tree = cKDTree(position_and_normal(known.row))
    _, nearest = tree.query(position_and_normal(rows), k=np.arange(1, neighbours + 1))
    count = elements[1] - elements[0]
    row, model = np.repeat(rows, neighbours * count), np.repeat(nearest.ravel(), count)
    u = _sequence(np.arange(len(rows) * neighbours), elements)
    T, point = known.T_object_scanner[model].copy(), targets.points[:, row].T
    along = (u[:, :1] >= 0.5) * (point - place[model])
    T[:, :3, 3] += along + (2 * u[:, :3] - 1) * (_MAX_SHIFT * distance[model, None])
    turn = rotation_matrices((2 * u[:, 3:] - 1) * _MAX_TURN)
    T[:, :3, 3] = point + np.einsum("nij,nj->ni", turn, T[:, :3, 3] - point)
    T[:, :3, :3] = turn @ T[:, :3, :3]
    return AimedPoses(T, row).pick(_in_view(T, row, targets, scanner))


def perturb_pose(
    T_object_scanner: Floats, distance: float, share: float, elements: tuple[int, int], number: int
) -> Floats:
    """Return (n, 4, 4) poses [m] near a given one: shifted, and turned about the point at which it is aimed.

    Args:
        T_object_scanner: (4, 4) the pose [m].
        distance: to the point at which it is aimed [m].
        share: of the largest shift and turn of `transfer_poses`, 0 to 1.
        elements: of the sequence.
        number: of the pose among many: each has its own range of the sequence.
    """
    u = _sequence(np.array([number]), elements)
    turn = rotation_matrices((2 * u[:, 3:] - 1) * (_MAX_TURN * share))
    R, t = T_object_scanner[:3, :3], T_object_scanner[:3, 3]
    aim = t + distance * R[:, 2]
    T = np.tile(np.eye(4), (len(u), 1, 1))
    T[:, :3, :3] = turn @ R
    T[:, :3, 3] = aim + turn @ (t - aim) + (2 * u[:, :3] - 1) * (_MAX_SHIFT * share * distance)
    return T


def poses_with_free_sight(
    aimed: AimedPoses, targets: RayTargets, scanner: Scanner, casters: Sequence[RayCaster]
) -> AimedPoses:
    """Return the poses whose two lines of sight to their point are free."""
    pose = np.arange(len(aimed))
    return aimed.pick(lines_of_sight_free(targets, aimed.T_object_scanner, pose, aimed.row, scanner, casters))


def _sequence(numbers: Ints, elements: tuple[int, int]) -> Floats:
    """Return (n * count, 6) elements of the recurrence, one range for each number."""
    element = (np.arange(*elements) + numbers[:, None] * _STRIDE).ravel()
    return np.asarray((0.5 + element[:, None] * _STEPS) % 1.0)


def _in_view(T: Floats, row: Ints, targets: RayTargets, scanner: Scanner) -> Bools:
    """Return (n,) whether the point of each pose passes every condition that needs no ray."""
    R = T[:, :3, :3]
    place = np.einsum("nij,ni->nj", R, targets.points[:, row].T - T[:, :3, 3])
    normals = np.einsum("nij,ni->nj", R, targets.normals[:, row].T)
    return np.asarray(rejections(targets, row, scanner, place.T, normals.T) == Rejection.MEASURED)


def _measures_facing(scanner: Scanner, places: Floats) -> Bools:
    """Return (n,) whether a surface at each place (n, 3) from the source [m] that faces the source is measured."""
    normals = -places / np.linalg.norm(places, axis=1, keepdims=True)
    return np.asarray(scanner.reject(scanner.source + places, normals) == Rejection.MEASURED)


def _tangents_in_view(scanner: Scanner, depth: float, axis: int) -> Floats:
    """Return (_ANGLES,) evenly spaced tangents inside the field of view along x (0) or y (1)."""
    places = np.zeros((len(_TANGENTS), 3))
    places[:, axis], places[:, 2] = _TANGENTS * depth, depth
    low, high = _TANGENTS[np.flatnonzero(_measures_facing(scanner, places))[[0, -1]]]
    return np.asarray(low + (high - low) * (np.arange(_ANGLES) + 0.5) / _ANGLES)


def _largest_tilt(scanner: Scanner, depth: float) -> float:
    """Return the largest whole degree [rad] at which a point on the axis is measured, in any of eight directions."""
    tilt, around = np.meshgrid(_TILTS, np.arange(8) * (np.pi / 4), indexing="ij")
    normals = np.stack([np.sin(tilt) * np.cos(around), np.sin(tilt) * np.sin(around), -np.cos(tilt)], axis=-1)
    places = np.tile(scanner.source + np.array([0.0, 0.0, depth]), (normals[..., 0].size, 1))
    good = scanner.reject(places, normals.reshape(-1, 3)).reshape(tilt.shape) == Rejection.MEASURED
    return float(tilt[good].max(initial=0.0))


def _rotations_onto(rays: Floats, normals: Floats, tilt: Floats, azimuth: Floats, roll: Floats) -> Floats:
    """Return (n, 3, 3) R_object_scanner with which rays (n, 3) of the scanner meet surfaces at given angles."""
    u, v = _perpendiculars(normals)
    side = np.cos(azimuth)[:, None] * u + np.sin(azimuth)[:, None] * v
    out = np.cos(tilt)[:, None] * normals + np.sin(tilt)[:, None] * side  # from the point to the source, object frame
    back = -rays / np.linalg.norm(rays, axis=1, keepdims=True)  # the same in the scanner frame
    a, b = _perpendiculars(out)
    c, d = _perpendiculars(back)
    cos, sin = np.cos(roll)[:, None], np.sin(roll)[:, None]
    first, second = cos * a + sin * b, cos * b - sin * a
    return np.asarray(
        out[:, :, None] * back[:, None] + first[:, :, None] * c[:, None] + second[:, :, None] * d[:, None]
    )


def _perpendiculars(directions: Floats) -> tuple[Floats, Floats]:
    """Return two unit vectors (n, 3) perpendicular to unit vectors (n, 3): direction = first x second."""
    x, y, z = directions.T
    smallest = np.abs(directions).argmin(axis=1)
    first = np.zeros_like(directions)  # (axis with the smallest component) x direction
    for axis, sides in enumerate(((1, 2), (2, 0), (0, 1))):
        at = np.flatnonzero(smallest == axis)
        first[at, sides[0]], first[at, sides[1]] = -directions[at, sides[1]], directions[at, sides[0]]
    first /= np.sqrt(np.einsum("ij,ij->i", first, first))[:, None]
    a, b, c = first.T
    return first, np.stack([y * c - z * b, z * a - x * c, x * b - y * a], axis=1)
