"""Whether a scanner at a pose measures a surface point: its conditions, and its two legs (Section 3.6, Figure 5).

A point is measured where `Scanner.reject` finds nothing to reject and both legs are free: source to point (active ray)
and point to sensor (reflected ray; blocked, it is the paper's shadow effect). A pair is a pose and a point, each by its
index. Object frame, metres.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError
from planner.ports import RayCaster, Rejection, Scanner
from planner.values import Bools, Floats, Ints, Ints32, readonly

LIFT = 1e-6
"""How far legs end above their point along its normal, as a share of the points' bounding-box diagonal.

A ray that grazes the surface is at the mercy of the caster's rounding: float32 is off by up to 1e-7 of the diagonal
across the ray, so by 1e-7 / cos(grazing angle) along it, and 0.3 to 0.7 % of all legs within 90 degrees were blocked by
the very surface that they end on. Lifted by 1e-6 (0.3 um on a part of 0.3 m) none were, down to a distance of 30 radii.
"""

BUNDLE = 300_000
"""Rays that are cast in one call: enough that Python's share vanishes and both cores have work, 10 MB of arrays."""

_BLOCK = 8192  # points that are transformed at a time: they stay in the core's cache


@dataclass(frozen=True, slots=True, eq=False)
class RayTargets:
    """Surface points prepared to be aimed at.

    Attributes:
        points: (3, S) [m], object frame, coordinates as rows.
        normals: (3, S) outward unit normals, object frame.
        lifted: (S, 3) where legs end [m], object frame: `LIFT` above the points.
        region: (S,) region of the part that each lies in; None: the part has no regions.
    """

    points: Floats
    normals: Floats
    lifted: Floats
    region: Ints32 | None = None

    @classmethod
    def of(cls, points: Floats, normals: Floats, region: Ints32 | None = None) -> "RayTargets":
        """Prepare (S, 3) points [m] and (S, 3) unit normals, object frame, with the (S,) region of each."""
        return cls(
            readonly("points", np.transpose(points), (3, None)),
            readonly("normals", np.transpose(normals), (3, None)),
            readonly("lifted", lift_points(points, normals), (None, 3)),
            region,
        )

    def __len__(self) -> int:
        return len(self.lifted)


def lift_points(points: Floats, normals: Floats, diagonal: float | None = None) -> Floats:
    """Where legs to surface points end.

    Args:
        points: (S, 3) [m].
        normals: (S, 3) outward unit normals.
        diagonal: of the part's bounding box [m]; None takes the points' own.

    Returns:
        (S, 3) points lifted by `LIFT` x the diagonal.
    """
    if diagonal is None:
        diagonal = float(np.linalg.norm(np.ptp(points, axis=0))) if len(points) else 0.0
    return np.asarray(points + (LIFT * diagonal) * normals)


def flatten_poses(T_object_scanner: Floats) -> Floats:
    """(V * K, 4, 4) poses of (V, K, 4, 4) viewpoints: pose i belongs to viewpoint i // K.

    Raises:
        PlannerError: if the shape differs, or a pose is not a rigid motion.
    """
    poses = np.asarray(T_object_scanner, dtype=np.float64)
    if poses.ndim != 4 or poses.shape[2:] != (4, 4) or poses.shape[1] < 1:
        raise PlannerError(f"T_object_scanner has shape {poses.shape}; it must be (V, K, 4, 4) with K at least 1")
    poses = poses.reshape(-1, 4, 4)
    R = poses[:, :3, :3]
    rigid = np.isfinite(poses).all(axis=(1, 2)) & (
        np.abs(np.einsum("nij,nik->njk", R, R) - np.eye(3)).max(axis=(1, 2), initial=0.0) < 1e-6
    )
    if not rigid.all():
        raise PlannerError(
            f"pose {int(np.flatnonzero(~rigid)[0])} of T_object_scanner is not a rigid motion; its upper left "
            "3 x 3 block must be a rotation and all its values finite"
        )
    return poses


def in_view(targets: RayTargets, T: Floats, scanner: Scanner, rows: Ints | None = None) -> Ints:
    """Points that pass every condition of the scanner that needs no ray.

    Args:
        targets: S surface points.
        T: (4, 4) T_object_scanner [m].
        scanner: the sensor's law.
        rows: (n,) the points to ask about; None asks about all.

    Returns:
        Those of the rows that pass, in their order.
    """
    count = len(targets) if rows is None else len(rows)
    into_scanner = T[:3, :3].T
    origin = (into_scanner @ T[:3, 3])[:, None]
    passed = []
    for start in range(0, count, _BLOCK):
        stop = min(start + _BLOCK, count)
        asked = None if rows is None else rows[start:stop]
        points, normals = (
            into_scanner @ (all_[:, start:stop] if asked is None else np.take(all_, asked, axis=1))
            for all_ in (targets.points, targets.normals)
        )
        codes = rejections(targets, slice(start, stop) if asked is None else asked, scanner, points - origin, normals)
        found = np.flatnonzero(codes == Rejection.MEASURED)
        passed.append(found + start if asked is None else asked[found])
    return np.concatenate(passed) if passed else np.empty(0, dtype=np.int64)


def in_view_matrix(targets: RayTargets, poses: Floats, scanner: Scanner, rows: Ints) -> Bools:
    """(P, n) whether each of a few points passes, at each of many poses: `in_view` without a call for each pose.

    Args:
        targets: S surface points.
        poses: (P, 4, 4) T_object_scanner [m].
        scanner: the sensor's law.
        rows: (n,) the points to ask about.
    """
    into_scanner = poses[:, :3, :3].transpose(0, 2, 1)
    origins = into_scanner @ poses[:, :3, 3:]
    points, normals = (into_scanner @ np.take(all_, rows, axis=1) for all_ in (targets.points, targets.normals))
    points -= origins
    points, normals = (each.transpose(1, 0, 2).reshape(3, -1) for each in (points, normals))
    codes = rejections(targets, np.tile(rows, len(poses)), scanner, points, normals)
    return np.asarray(codes == Rejection.MEASURED).reshape(len(poses), len(rows))


def rejections(
    targets: RayTargets, rows: Ints | slice, scanner: Scanner, points: Floats, normals: Floats
) -> NDArray[np.uint8]:
    """What the scanner says of points: its conditions, and those of the region of each, where both have such.

    Args:
        targets: S surface points.
        rows: which of them are asked about, n.
        scanner: the sensor's law.
        points: (3, n) as the scanner sees them [m], scanner frame.
        normals: (3, n) unit, scanner frame.

    Returns:
        (n,) `Rejection` values.
    """
    by_region = None if targets.region is None else getattr(scanner, "reject_in", None)
    if by_region is None or targets.region is None:
        return scanner.reject(points.T, normals.T)
    codes: NDArray[np.uint8] = by_region(points.T, normals.T, targets.region[rows])
    return codes


def lines_of_sight_free(
    targets: RayTargets, poses: Floats, pose: Ints, row: Ints, scanner: Scanner, casters: Sequence[RayCaster]
) -> Bools:
    """Whether nothing stands in either leg of each pair; the sensor leg is cast only where the source leg is free.

    Args:
        targets: S surface points.
        poses: (P, 4, 4) T_object_scanner [m].
        pose: (n,) index of each pair's pose.
        row: (n,) index of each pair's point.
        scanner: where source and sensor are.
        casters: the part's and those of occluders; a leg is blocked if any of them blocks it.

    Returns:
        (n,) True where both legs are free of every caster.
    """
    free = _unhidden(targets, poses, pose, row, scanner.source, casters)
    alive = np.flatnonzero(free)
    free[alive] = _unhidden(targets, poses, pose[alive], row[alive], scanner.sensor, casters)
    return free


Pairs = Iterator[tuple[int, Ints, Ints]]
"""Bundles of (poses done, pose of each pair, row of each pair), in the order of the poses."""


def visible_pairs(
    poses: Floats,
    targets: RayTargets,
    scanner: Scanner,
    casters: Sequence[RayCaster],
    rows_of: Callable[[int], Ints],
    bundle: int = BUNDLE,
) -> Pairs:
    """Pairs with free legs; the points of one pose after the other are asked for, and cast together in bundles.

    Args:
        poses: (P, 4, 4) T_object_scanner [m].
        targets: S surface points.
        scanner: where source and sensor are.
        casters: the part's and those of occluders.
        rows_of: the points that may be measured from a pose.
        bundle: pairs that are cast together at least.
    """
    waiting: list[Ints] = []
    first, count = 0, 0
    for pose in range(len(poses)):
        waiting.append(rows_of(pose))
        count += len(waiting[-1])
        if count < bundle and pose + 1 < len(poses):
            continue
        which = np.repeat(np.arange(first, pose + 1), [len(rows) for rows in waiting])
        rows = np.concatenate(waiting)
        free = lines_of_sight_free(targets, poses, which, rows, scanner, casters)
        yield pose + 1, which[free], rows[free]
        waiting, first, count = [], pose + 1, 0


def _unhidden(
    targets: RayTargets, poses: Floats, pose: Ints, row: Ints, position: Floats, casters: Sequence[RayCaster]
) -> Bools:
    """Whether nothing stands between a position of the scanner (3,) [m] and the point, for each pair.

    Neighbouring poses with the same position (rolls of one viewpoint share the source) share its legs: each is cast
    once. That a leg is cast beside others changes nothing about it.
    """
    origins = poses[:, :3, :3] @ position + poses[:, :3, 3]
    standing = np.cumsum(np.concatenate([[0], (origins[1:] != origins[:-1]).any(axis=1)]))
    if standing[-1] + 1 == len(origins):  # every pose stands somewhere else
        return _free(np.take(origins, pose, axis=0), np.take(targets.lifted, row, axis=0), casters)
    place = standing[pose]
    leg_of = np.empty(len(row), dtype=np.int64)
    at: list[Ints] = []
    towards: list[Ints] = []
    count = 0
    number = np.empty(len(targets), dtype=np.int64)
    steps = np.flatnonzero(place[1:] != place[:-1]) + 1
    bounds = [0, *steps.tolist(), len(place)] if len(place) else [0]
    for start, stop in pairwise(bounds):
        seen = np.zeros(len(targets), dtype=np.bool_)
        seen[row[start:stop]] = True
        distinct = np.flatnonzero(seen)
        number[distinct] = np.arange(count, count + len(distinct))
        leg_of[start:stop] = number[row[start:stop]]
        at.append(np.full(len(distinct), pose[start]))
        towards.append(distinct)
        count += len(distinct)
    if not at:
        return np.ones(len(row), dtype=np.bool_)
    ends = np.take(targets.lifted, np.concatenate(towards), axis=0)
    free = _free(np.take(origins, np.concatenate(at), axis=0), ends, casters)
    return np.take(free, leg_of)


def _free(origins: Floats, ends: Floats, casters: Sequence[RayCaster]) -> Bools:
    """(n,) True where no caster finds anything between origin and end (n, 3) [m]."""
    free = np.ones(len(origins), dtype=np.bool_)
    for caster in casters:
        alive = np.flatnonzero(free)
        if len(alive) < len(free):
            free[alive] = ~caster.blocked(np.take(origins, alive, axis=0), np.take(ends, alive, axis=0))
        elif len(alive):
            free = ~caster.blocked(origins, ends)
    return free
