"""Decide whether a scanner at a pose measures a surface point: its conditions and two lines of sight (Section 3.6).

A point is measured if `Scanner.reject` rejects nothing and both lines of sight are free: source to point (active ray)
and point to sensor (reflected ray; a blocked one is the shadow effect of the paper, Figure 5). A pair is a pose and a
point, each given by its index. Object frame, metres.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import cast

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError
from planner.ports import AreaLimits, RayCaster, Rejection, Scanner
from planner.values import Bools, Floats, Ints, Ints32, readonly

LIFT = 1e-6
"""Height of the end of a line of sight above its point, as a share of the diagonal of the points' bounding box.

For a ray that grazes the surface, rounding in the ray caster decides: float32 is off by up to 1e-7 of the diagonal
across the ray, so by 1e-7 / cos(grazing angle) along it. Without a lift, the surface itself blocked 0.3 to 0.7 % of all
rays within 90 degrees. With 1e-6 (0.3 um on a part of 0.3 m) it blocked none, down to a distance of 30 radii.
"""

BUNDLE = 300_000
"""Rays of one call to the ray caster: Python's share of the time vanishes, all cores are busy, arrays take 10 MB."""

_BLOCK = 8192  # points that are transformed at a time: they stay in the core's cache


@dataclass(frozen=True, slots=True, eq=False)
class RayTargets:
    """Surface points prepared as ends of rays.

    Attributes:
        points: (3, S) [m], coordinates as rows.
        normals: (3, S) outward unit normals.
        lifted: (S, 3) ends of the lines of sight [m]: `LIFT` above the points.
        region: (S,) region of each point; None: the part has no regions.
    """

    points: Floats
    normals: Floats
    lifted: Floats
    region: Ints32 | None = None

    @classmethod
    def of(cls, points: Floats, normals: Floats, region: Ints32 | None = None) -> "RayTargets":
        """Prepare (S, 3) points [m] with (S, 3) unit normals and the (S,) region of each."""
        return cls(
            readonly("points", np.transpose(points), (3, None)),
            readonly("normals", np.transpose(normals), (3, None)),
            readonly("lifted", lift_points(points, normals), (None, 3)),
            region,
        )

    def __len__(self) -> int:
        return len(self.lifted)


def lift_points(points: Floats, normals: Floats, diagonal: float | None = None) -> Floats:
    """Return points (S, 3) [m] lifted along their unit normals by `LIFT` x the diagonal of the part's bounding box [m].

    If the diagonal is None, it is that of the points.
    """
    if diagonal is None:
        diagonal = float(np.linalg.norm(np.ptp(points, axis=0))) if len(points) else 0.0
    return np.asarray(points + (LIFT * diagonal) * normals)


def flatten_poses(T_object_scanner: Floats) -> Floats:
    """Return (V * K, 4, 4) poses of (V, K, 4, 4) viewpoints, checked to be rigid: pose i is of viewpoint i // K."""
    poses = np.asarray(T_object_scanner, dtype=np.float64)
    if poses.ndim != 4 or poses.shape[2:] != (4, 4) or poses.shape[1] < 1:
        raise PlannerError(f"T_object_scanner has shape {poses.shape}; it must be (V, K, 4, 4) with K at least 1")
    poses = poses.reshape(-1, 4, 4)
    R = poses[:, :3, :3]
    rigid = np.isfinite(poses).all(axis=(1, 2)) & (
        np.abs(np.einsum("nij,nik->njk", R, R) - np.eye(3)).max(axis=(1, 2), initial=0.0) < 1e-6
    )
    rigid[rigid] = np.linalg.det(R[rigid]) > 0.0
    if not rigid.all():
        raise PlannerError(
            f"pose {int(np.flatnonzero(~rigid)[0])} of T_object_scanner is not a rigid motion; its upper left "
            "3 x 3 block must be a rotation and all its values finite"
        )
    return poses


def in_view(targets: RayTargets, T: Floats, scanner: Scanner, rows: Ints | None = None) -> Ints:
    """Return the points that pass every condition of the scanner that needs no ray.

    Args:
        targets: S surface points.
        T: (4, 4) T_object_scanner [m].
        scanner: sensor model.
        rows: (n,) the points to test; None tests all.

    Returns:
        The rows that pass, in their order.
    """
    if (law := _posed_law(targets, scanner)) is not None:
        tested = np.arange(len(targets)) if rows is None else rows
        codes = law.reject_at(targets.points, targets.normals, tested, np.array(T, order="C"))
        return np.asarray(tested[codes == Rejection.MEASURED])
    count = len(targets) if rows is None else len(rows)
    into_scanner = T[:3, :3].T
    origin = (into_scanner @ T[:3, 3])[:, None]
    passed = []
    for start in range(0, count, _BLOCK):
        stop = min(start + _BLOCK, count)
        block = None if rows is None else rows[start:stop]
        points, normals = (
            into_scanner @ (all_[:, start:stop] if block is None else np.take(all_, block, axis=1))
            for all_ in (targets.points, targets.normals)
        )
        codes = rejections(targets, slice(start, stop) if block is None else block, scanner, points - origin, normals)
        hits = np.flatnonzero(codes == Rejection.MEASURED)
        passed.append(hits + start if block is None else block[hits])
    return np.concatenate(passed) if passed else np.empty(0, dtype=np.int64)


def in_view_matrix(targets: RayTargets, poses: Floats, scanner: Scanner, rows: Ints) -> Bools:
    """Return (P, n) whether `in_view` passes each of (n,) points at each of (P, 4, 4) poses [m], in one call."""
    if (law := _posed_law(targets, scanner)) is not None:
        passes = np.empty((len(poses), len(rows)), dtype=np.bool_)
        for number, T in enumerate(poses):
            codes = law.reject_at(targets.points, targets.normals, rows, np.array(T, order="C"))
            passes[number] = codes == Rejection.MEASURED
        return passes
    into_scanner = poses[:, :3, :3].transpose(0, 2, 1)
    origins = into_scanner @ poses[:, :3, 3:]
    points, normals = (into_scanner @ np.take(all_, rows, axis=1) for all_ in (targets.points, targets.normals))
    points -= origins
    points, normals = (each.transpose(1, 0, 2).reshape(3, -1) for each in (points, normals))
    codes = rejections(targets, np.tile(rows, len(poses)), scanner, points, normals)
    return np.asarray(codes == Rejection.MEASURED).reshape(len(poses), len(rows))


def _posed_law(targets: RayTargets, scanner: Scanner) -> AreaLimits | None:
    """Return the scanner if it decides on points in their own frame, by the same conditions for all regions.

    `isinstance` of a protocol would take half the time of a pose.
    """
    has_regions = targets.region is not None and hasattr(scanner, "reject_in")
    is_posed = getattr(scanner, "area_limits", None) is not None and hasattr(scanner, "reject_at")
    return cast(AreaLimits, scanner) if is_posed and not has_regions else None


def rejections(
    targets: RayTargets, rows: Ints | slice, scanner: Scanner, points: Floats, normals: Floats
) -> NDArray[np.uint8]:
    """Apply the conditions of the scanner to points, with those of their regions if both have such.

    Args:
        targets: S surface points.
        rows: n of them.
        scanner: sensor model.
        points: (3, n) [m], scanner frame.
        normals: (3, n) unit normals, scanner frame.

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
    """Return (n,) whether both lines of sight of each pair are free; the sensor's is cast only if the source's is.

    Args:
        targets: S surface points.
        poses: (P, 4, 4) T_object_scanner [m].
        pose: (n,) pose of each pair.
        row: (n,) point of each pair.
        scanner: gives the positions of source and sensor.
        casters: of the part and of occluders; any of them can block a line of sight.
    """
    free = _free_from(targets, poses, pose, row, scanner.source, casters)
    alive = np.flatnonzero(free)
    free[alive] = _free_from(targets, poses, pose[alive], row[alive], scanner.sensor, casters)
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
    """Yield the pairs with free lines of sight; the points of successive poses are cast together in bundles.

    Args:
        poses: (P, 4, 4) T_object_scanner [m].
        targets: S surface points.
        scanner: gives the positions of source and sensor.
        casters: of the part and of occluders.
        rows_of: returns the points in view of a pose; called once per pose, in order.
        bundle: smallest number of pairs that are cast together.
    """
    for first, waiting in bundle_items(len(poses), rows_of, bundle):
        which = np.repeat(np.arange(first, first + len(waiting)), [len(rows) for rows in waiting])
        rows = np.concatenate(waiting)
        free = lines_of_sight_free(targets, poses, which, rows, scanner, casters)
        yield first + len(waiting), which[free], rows[free]


def bundle_items(count: int, items_of: Callable[[int], Ints], size: int) -> Iterator[tuple[int, list[Ints]]]:
    """Yield bundles of at least `size` items (the last may have less): the first number, and the items per number."""
    waiting: list[Ints] = []
    total = 0
    for number in range(count):
        waiting.append(items_of(number))
        total += len(waiting[-1])
        if total >= size or number + 1 == count:
            yield number + 1 - len(waiting), waiting
            waiting, total = [], 0


def _free_from(
    targets: RayTargets, poses: Floats, pose: Ints, row: Ints, position: Floats, casters: Sequence[RayCaster]
) -> Bools:
    """Return (n,) whether nothing is between a position (3,) [m] of the scanner and the point of each pair.

    Neighbouring poses with the same position (rolls of one viewpoint share the source) share their rays: each is cast
    once.
    """
    origins = poses[:, :3, :3] @ position + poses[:, :3, 3]
    place_of_pose = np.cumsum(np.concatenate([[0], (origins[1:] != origins[:-1]).any(axis=1)]))
    if place_of_pose[-1] + 1 == len(origins):  # no two poses share a position
        return _free_segments(np.take(origins, pose, axis=0), np.take(targets.lifted, row, axis=0), casters)
    if not len(pose):
        return np.ones(0, dtype=np.bool_)
    place = place_of_pose[pose]
    ray_of = np.empty(len(row), dtype=np.int64)
    at: list[Ints] = []
    ends: list[Ints] = []
    count = 0
    number = np.empty(len(targets), dtype=np.int64)
    for start, stop in pairwise([0, *(np.flatnonzero(place[1:] != place[:-1]) + 1).tolist(), len(place)]):
        is_used = np.zeros(len(targets), dtype=np.bool_)
        is_used[row[start:stop]] = True
        distinct = np.flatnonzero(is_used)
        number[distinct] = np.arange(count, count + len(distinct))
        ray_of[start:stop] = number[row[start:stop]]
        at.append(np.full(len(distinct), pose[start]))
        ends.append(distinct)
        count += len(distinct)
    lifted = np.take(targets.lifted, np.concatenate(ends), axis=0)
    return np.take(_free_segments(np.take(origins, np.concatenate(at), axis=0), lifted, casters), ray_of)


def _free_segments(origins: Floats, ends: Floats, casters: Sequence[RayCaster]) -> Bools:
    """Return (n,) whether no caster finds anything between origins and ends (n, 3) [m]."""
    free = np.ones(len(origins), dtype=np.bool_)
    for caster in casters:
        alive = np.flatnonzero(free)
        if len(alive) < len(free):
            free[alive] = ~caster.blocked(np.take(origins, alive, axis=0), np.take(ends, alive, axis=0))
        elif len(alive):
            free = ~caster.blocked(origins, ends)
    return free
