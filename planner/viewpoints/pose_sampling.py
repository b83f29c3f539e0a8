"""Poses that measure given surface points: a search over all six degrees of freedom, point by point.

A pose that measures a point is six numbers: where in the scanner's frustum the point lies (a distance and two angles),
from which side the laser meets the surface (tilt from the normal and azimuth), and the turn of the scanner about that
ray. `drawn` takes them (the two angles as one number, of a list) from the additive recurrence of Roberts [1], whose
k-th element is

    u_k = frac(1/2 + k (g^-1, ..., g^-6)),        g the real root above 1 of g^7 = g + 1

Any stretch of it fills the unit cube evenly, so that a search may go on where it has stopped, and every point may be
given a stretch of its own. `carried` takes poses that measure neighbours of a point and moves them a little by the same
lattice: in a niche few poses of all succeed, and they lie together; `moved` does so with one pose. Nothing is
random: equal inputs give equal poses.

`Frustum` is where in the scanner frame a surface that faces the laser is measured, asked of the scanner's own law: so
it is that of any scanner. Object frame, metres, radians.

[1] M. Roberts, The unreasonable effectiveness of quasirandom sequences, 2018,
    https://extremelearning.com.au/unreasonable-effectiveness-of-quasirandom-sequences/
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from planner.ports import RayCaster, Rejection, Scanner
from planner.values import Bools, Floats, Ints, Value
from planner.viewpoints.lines_of_sight import RayTargets, lines_of_sight_free, rejections
from planner.viewpoints.viewpoints import rotation_matrices

_ROOT = 1.1127756842787055  # of g^7 = g + 1
_STEPS = _ROOT ** -np.arange(1.0, 7.0)
_STRIDE = 65_537  # elements between the stretches of neighbouring points: a prime above any stretch

_DISTANCES, _ANGLES = 24, 13  # of the lattice of a frustum: along the axis, and in each of the two angles
_NEAREST, _FARTHEST = 1e-3, 30.0  # m, between which a range is looked for
_OPENING = np.tan(np.deg2rad(np.arange(-88.0, 88.1, 0.25)))  # off the axis, where a field of view is looked for
_LEANING = np.deg2rad(np.arange(91.0))

_TURN = np.deg2rad(15.0)  # by which a carried pose is turned about its point at most, about each axis of a turn vector
_SHIFT = 0.15  # of the distance, by which it is moved along each axis at most


@dataclass(frozen=True, slots=True, eq=False)
class Frustum(Value):
    """Where in the scanner frame a scanner measures a surface that faces the laser.

    Attributes:
        points: (n, 3) places [m], by distance; those of one distance follow each other.
        start: (d + 1,) first place of each distance.
        tilt: largest angle between laser and normal at which a point on the axis is measured [rad].
    """

    points: Annotated[Floats, "n 3"]
    start: Annotated[Ints, "d+1"]
    tilt: float


@dataclass(frozen=True, slots=True, eq=False)
class AimedPoses(Value):
    """Poses of the scanner, each aimed at a point.

    Attributes:
        T_object_scanner: (n, 4, 4) poses [m].
        row: (n,) the point.
    """

    T_object_scanner: Annotated[Floats, "n 4 4"]
    row: Annotated[Ints, "n"]

    def __len__(self) -> int:
        return len(self.row)

    def pick(self, which: Ints | Bools) -> "AimedPoses":
        """Some of them."""
        return AimedPoses(self.T_object_scanner[which], self.row[which])


def find_frustum(scanner: Scanner) -> Frustum:
    """Ask a scanner's law where it measures.

    The lattice lies inside the limits, not on them, so that rounded joint angles lose no point that was aimed at.

    Args:
        scanner: the sensor's law.

    Returns:
        The frustum; without places where the law measures nothing on its axis.
    """
    on_axis = np.geomspace(_NEAREST, _FARTHEST, 2000)
    measured = np.flatnonzero(_facing(scanner, on_axis[:, None] * [0.0, 0.0, 1.0]))
    if not len(measured):
        return Frustum(np.empty((0, 3)), np.zeros(1, dtype=np.int64), 0.0)
    near, far = on_axis[measured[[0, -1]]]
    middle = float(np.sqrt(near * far))
    rays = np.stack([*np.meshgrid(_opening(scanner, middle, 0), _opening(scanner, middle, 1)), np.ones((_ANGLES,) * 2)])
    rays = rays.reshape(3, -1).T
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    places = np.geomspace(near, far, _DISTANCES)[:, None, None] * rays
    good = _facing(scanner, places.reshape(-1, 3)).reshape(_DISTANCES, -1)
    counts = good.sum(axis=1)
    start = np.concatenate([[0], np.cumsum(counts[counts > 0])])
    return Frustum(scanner.source + places[good], start, _steepest(scanner, middle))


def draw_poses(
    targets: RayTargets, rows: Ints, stretch: tuple[int, int], within: Frustum, scanner: Scanner
) -> AimedPoses:
    """Poses that would measure their points if nothing stood in the way.

    Args:
        targets: S surface points.
        rows: (n,) the points that are aimed at.
        stretch: first and last (not included) element of the lattice for each point.
        within: the scanner's frustum.
        scanner: the sensor's law; poses that it rejects are left out.
    """
    if not len(within.points):
        return AimedPoses(np.empty((0, 4, 4)), np.empty(0, dtype=np.int64))
    row = np.repeat(rows, stretch[1] - stretch[0])
    u = _lattice(rows, stretch)
    level = (u[:, 0] * (len(within.start) - 1)).astype(np.int64)
    first = within.start[level]
    place = within.points[first + (u[:, 1] * (within.start[level + 1] - first)).astype(np.int64)]
    tilt = np.arccos(1.0 - u[:, 2] * (1.0 - np.cos(within.tilt)))  # even over the cap of directions
    normals = targets.normals[:, row].T
    R = _meeting(place - scanner.source, normals, tilt, 2 * np.pi * u[:, 3], 2 * np.pi * u[:, 4])
    T = np.zeros((len(R), 4, 4))
    T[:, :3, :3] = R
    T[:, :3, 3] = targets.points[:, row].T - np.einsum("nij,nj->ni", R, place)
    T[:, 3, 3] = 1.0
    return AimedPoses(T, row).pick(_accepted(T, row, targets, scanner))


def transfer_poses(
    targets: RayTargets, rows: Ints, stretch: tuple[int, int], known: AimedPoses, neighbours: int, scanner: Scanner
) -> AimedPoses:
    """Poses that measure the nearest points of all, moved a little: every other one goes along with the point.

    Args:
        targets: S surface points.
        rows: (n,) the points that are aimed at.
        stretch: of the lattice, for each point and neighbour.
        known: poses that measure their points.
        neighbours: how many of them are tried; the nearest in place and direction, where a turn by one radian counts as
            much as a way of one distance from the scanner.
        scanner: the sensor's law; poses that it rejects are left out.
    """
    from scipy.spatial import cKDTree  # kept out of the start-up of commands that plan nothing

    place = targets.points[:, known.row].T
    distance = np.linalg.norm(place - known.T_object_scanner[:, :3, 3], axis=1)
    scale = float(np.median(distance))

    def where(points: Ints) -> Floats:
        return np.concatenate([targets.points[:, points].T / scale, targets.normals[:, points].T], axis=1)

    neighbours = min(neighbours, len(known))
    _, nearest = cKDTree(where(known.row)).query(where(rows), k=np.arange(1, neighbours + 1))
    count = stretch[1] - stretch[0]
    row, model = np.repeat(rows, neighbours * count), np.repeat(nearest.ravel(), count)
    u = _lattice(np.arange(len(rows) * neighbours), stretch)
    T, point = known.T_object_scanner[model].copy(), targets.points[:, row].T
    along = (u[:, :1] >= 0.5) * (point - place[model])
    T[:, :3, 3] += along + (2 * u[:, :3] - 1) * (_SHIFT * distance[model, None])
    turn = rotation_matrices((2 * u[:, 3:] - 1) * _TURN)
    T[:, :3, 3] = point + np.einsum("nij,nj->ni", turn, T[:, :3, 3] - point)
    T[:, :3, :3] = turn @ T[:, :3, :3]
    return AimedPoses(T, row).pick(_accepted(T, row, targets, scanner))


def perturb_pose(
    T_object_scanner: Floats, distance: float, share: float, stretch: tuple[int, int], number: int
) -> Floats:
    """(n, 4, 4) poses about a given one [m]: moved, and turned about the point that it is aimed at.

    Args:
        T_object_scanner: (4, 4) the pose [m].
        distance: to the point that it is aimed at [m].
        share: of the largest way and turn of `carried`, 0 to 1.
        stretch: of the lattice.
        number: which of many poses it is: each has a stretch of its own.
    """
    u = _lattice(np.array([number]), stretch)
    turn = rotation_matrices((2 * u[:, 3:] - 1) * (_TURN * share))
    R, t = T_object_scanner[:3, :3], T_object_scanner[:3, 3]
    aim = t + distance * R[:, 2]
    T = np.tile(np.eye(4), (len(u), 1, 1))
    T[:, :3, :3] = turn @ R
    T[:, :3, 3] = aim + turn @ (t - aim) + (2 * u[:, :3] - 1) * (_SHIFT * share * distance)
    return T


def poses_with_free_sight(
    aimed: AimedPoses, targets: RayTargets, scanner: Scanner, casters: Sequence[RayCaster]
) -> AimedPoses:
    """Those of the poses whose two legs to their point are free."""
    pose = np.arange(len(aimed))
    return aimed.pick(lines_of_sight_free(targets, aimed.T_object_scanner, pose, aimed.row, scanner, casters))


def _lattice(numbers: Ints, stretch: tuple[int, int]) -> Floats:
    """(n * count, 6) elements of the recurrence, a stretch for each number."""
    element = (np.arange(*stretch) + numbers[:, None] * _STRIDE).ravel()
    return np.asarray((0.5 + element[:, None] * _STEPS) % 1.0)


def _accepted(T: Floats, row: Ints, targets: RayTargets, scanner: Scanner) -> Bools:
    """(n,) whether nothing but a line of sight may keep each pose from measuring its point."""
    R = T[:, :3, :3]
    place = np.einsum("nij,ni->nj", R, targets.points[:, row].T - T[:, :3, 3])
    normals = np.einsum("nij,ni->nj", R, targets.normals[:, row].T)
    return np.asarray(rejections(targets, row, scanner, place.T, normals.T) == Rejection.MEASURED)


def _facing(scanner: Scanner, places: Floats) -> Bools:
    """(n,) whether a surface at each place (n, 3) from the source [m] that faces the source is measured."""
    normals = -places / np.linalg.norm(places, axis=1, keepdims=True)
    return np.asarray(scanner.reject(scanner.source + places, normals) == Rejection.MEASURED)


def _opening(scanner: Scanner, depth: float, axis: int) -> Floats:
    """(_ANGLES,) tangents inside the field of view across (0) or along (1), evenly spaced."""
    places = np.zeros((len(_OPENING), 3))
    places[:, axis], places[:, 2] = _OPENING * depth, depth
    low, high = _OPENING[np.flatnonzero(_facing(scanner, places))[[0, -1]]]
    return np.asarray(low + (high - low) * (np.arange(_ANGLES) + 0.5) / _ANGLES)


def _steepest(scanner: Scanner, depth: float) -> float:
    """Largest whole degree at which a point on the axis is measured, leaning to any of eight sides [rad]."""
    lean, around = np.meshgrid(_LEANING, np.arange(8) * (np.pi / 4), indexing="ij")
    normals = np.stack([np.sin(lean) * np.cos(around), np.sin(lean) * np.sin(around), -np.cos(lean)], axis=-1)
    places = np.tile(scanner.source + np.array([0.0, 0.0, depth]), (normals[..., 0].size, 1))
    good = scanner.reject(places, normals.reshape(-1, 3)).reshape(lean.shape) == Rejection.MEASURED
    return float(lean[good].max(initial=0.0))


def _meeting(rays: Floats, normals: Floats, tilt: Floats, azimuth: Floats, roll: Floats) -> Floats:
    """(n, 3, 3) R_object_scanner that bring rays (n, 3) of the scanner onto surfaces from given sides."""
    u, v = _across(normals)
    side = np.cos(azimuth)[:, None] * u + np.sin(azimuth)[:, None] * v
    out = np.cos(tilt)[:, None] * normals + np.sin(tilt)[:, None] * side  # from the point to the source, object frame
    back = -rays / np.linalg.norm(rays, axis=1, keepdims=True)  # the same in the scanner frame
    a, b = _across(out)
    c, d = _across(back)
    cos, sin = np.cos(roll)[:, None], np.sin(roll)[:, None]
    turned, beside = cos * a + sin * b, cos * b - sin * a
    return np.asarray(
        out[:, :, None] * back[:, None] + turned[:, :, None] * c[:, None] + beside[:, :, None] * d[:, None]
    )


def _across(directions: Floats) -> tuple[Floats, Floats]:
    """Two unit vectors (n, 3) each across unit vectors (n, 3): direction = first x second."""
    x, y, z = directions.T
    least = np.abs(directions).argmin(axis=1)
    first = np.zeros_like(directions)  # the axis that is least along the direction x the direction
    for axis, sides in enumerate(((1, 2), (2, 0), (0, 1))):
        at = np.flatnonzero(least == axis)
        first[at, sides[0]], first[at, sides[1]] = -directions[at, sides[1]], directions[at, sides[0]]
    first /= np.sqrt(np.einsum("ij,ij->i", first, first))[:, None]
    a, b, c = first.T
    return first, np.stack([y * c - z * b, z * a - x * c, x * b - y * a], axis=1)
