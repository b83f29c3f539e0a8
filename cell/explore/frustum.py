"""Frustum of the scanner, and views that keep the minimum range.

The belief extends a little behind measured surface; the part itself may extend towards the scanner through unseen
space. A ray that meets it before the minimum range gives no point, and other views from the same distance give none
either. Therefore, after a batch that was too close, the next batches keep the minimum range: a line of sight counts as
free only if space that may belong to the part is no closer than the range. Requiring this always would cost small parts
a third more views.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from cell.explore import belief
from cell.scene.model import Scene
from cell.world.embree import EmbreeRayCaster
from planner.explore.gain import N_LATEST_BATCHES
from planner.explore.space import VoxelSpace
from planner.geometry.sampling import SurfaceSamples
from planner.ports import Hits, RayCaster, Scanner
from planner.values import Bools, Floats

_JOINED = 4.0
"""Largest distance of points of neighbouring rays on one surface, in distances at normal incidence: that at 75 degrees.
The surface between points on a steeper one stays uncovered."""

_RAYS, _MIN_POINTS = 8, 100
"""Rays compared around a known point, of 12 on a surface; smallest number of points for a share."""

_MAX_SHARE = 0.5
"""Share of the expected surface below the minimum range, above which the next batches keep the minimum range."""


@dataclass(frozen=True, slots=True, eq=False)
class SensorFrustum:
    """Rays and range of a scanner, scanner frame.

    Attributes:
        source: (3,) [m].
        sensor: (3,) [m].
        rays: (R, 3) unit vectors of a scan, row by row.
        columns: rays per row.
        near: smallest distance from the source [m].
        far: largest distance [m].
        apart: angle between neighbouring rays [rad].
    """

    source: Floats
    sensor: Floats
    rays: Floats
    columns: int
    near: float
    far: float
    apart: float

    @classmethod
    def of(cls, scanner: Scanner, scene: Scene) -> "SensorFrustum":
        """Return the frustum of a scanner in a settled scene."""
        assert scene.scanner.range_mm is not None
        near, far = (limit / 1000 for limit in scene.scanner.range_mm)
        rays = np.asarray(scanner.ray_directions())
        apart = float(np.arccos(np.clip(rays[0] @ rays[1], -1.0, 1.0)))
        columns = scanner.grid_shape[1]
        return cls(np.asarray(scanner.source), np.asarray(scanner.sensor), rays, columns, near, far, apart)

    def blank(self, points: Floats, T: Floats) -> Floats:
        """Return (M, 3) directions of rays without a point (N, 3) [m] nearby, in the frame of the pose T."""
        rays = self.rays @ T[:3, :3].T
        return np.asarray(rays[~self._beside(rays, self.towards(points, T))])

    def answered(self, targets: Floats, points: Floats, T: Floats) -> Bools:
        """Return (M,) whether a point (N, 3) [m] came back near the ray to each target (M, 3) [m]."""
        return self._beside(self.towards(targets, T), self.towards(points, T))

    def passed(self, known: Floats, points: Floats, T: Floats, margin: float) -> float:
        """Return the share of known points that a view looked past: all rays around them returned from farther away.

        Points of a moved part are passed. Points with missing rays around them do not count: at an outline, or on a
        steep surface, rays pass that belong to what lies behind. Points below the minimum range do not count either.

        Args:
            known: (K, 3) points of earlier views [m].
            points: (N, 3) points of one scan [m].
            T: (4, 4) pose of the scanner in their frame [m].
            margin: additional distance [m].
        """
        if not len(known) or not len(points):
            return 0.0
        source = self.source_at(T)
        near, far = (np.linalg.norm(each - source, axis=1) for each in (known, points))
        tree = cKDTree(self.towards(points, T))
        apart, at = map(np.asarray, tree.query(self.towards(known, T), k=_RAYS, distance_upper_bound=2 * self.apart))
        looked = np.isfinite(apart).all(axis=1) & (near >= self.near)
        past = far[at[looked]].min(axis=1, initial=np.inf) > near[looked] + margin
        return float(past.mean()) if len(past) >= _MIN_POINTS else 0.0

    def between(self, points: Floats, T: Floats, gap: float) -> Floats:
        """Return (M, 3) positions between points of neighbouring rays on one surface, at most `gap` apart [m].

        Args:
            points: (N, 3) points of one scan [m]; of several near one ray the first counts.
            T: (4, 4) pose of the scanner in their frame [m].
            gap: distance [m].
        """
        point_of = np.full(len(self.rays), -1)
        of = np.asarray(cKDTree(self.rays).query(self.towards(points, T) @ T[:3, :3])[1])
        point_of[of[::-1]] = np.arange(len(points))[::-1]
        number = np.arange(len(self.rays)).reshape(-1, self.columns)
        one, other = (
            np.concatenate([rays.ravel() for rays in pair])
            for pair in ((number[:-1], number[:, :-1]), (number[1:], number[:, 1:]))
        )
        known = (point_of[one] >= 0) & (point_of[other] >= 0)
        one, other = one[known], other[known]
        begin, end, squarely = points[point_of[one]], points[point_of[other]], self.rays[one] - self.rays[other]
        length, away = np.linalg.norm(end - begin, axis=1), np.linalg.norm(begin - self.source_at(T), axis=1)
        is_gap = (length > gap) & (length <= _JOINED * away * np.linalg.norm(squarely, axis=1))
        begin, end, parts = begin[is_gap], end[is_gap], np.ceil(length[is_gap] / gap).astype(np.int64)
        pair = np.repeat(np.arange(len(parts)), parts - 1)
        step = np.arange(len(pair)) - np.repeat(np.cumsum(parts - 1) - (parts - 1), parts - 1) + 1
        return np.asarray(begin[pair] + (step / parts[pair])[:, None] * (end - begin)[pair])

    def source_at(self, T: Floats) -> Floats:
        """Return (3,) the origin of the rays for a scanner pose T (4, 4) [m]."""
        return np.asarray(T[:3, :3] @ self.source + T[:3, 3])

    def towards(self, points: Floats, T: Floats) -> Floats:
        """Return (N, 3) unit directions from the source to points (N, 3) [m]."""
        legs = points - self.source_at(T)
        return np.asarray(legs / np.maximum(np.linalg.norm(legs, axis=1, keepdims=True), 1e-12))

    def _beside(self, rays: Floats, others: Floats) -> Bools:
        """Return (M,) whether a unit vector of `others` (N, 3) is within two ray angles of each of `rays`."""
        if not len(others):
            return np.zeros(len(rays), dtype=np.bool_)
        return np.isfinite(cKDTree(others).query(rays, distance_upper_bound=2 * self.apart)[0])


def area_below_min_range(
    samples: SurfaceSamples,
    sees: Bools,
    views: Sequence[tuple[Floats, Floats]],
    before: VoxelSpace,
    frustum: SensorFrustum,
) -> float:
    """Return the area without points, of the expected samples, where the part may begin before the range [m^2].

    Args:
        samples: N expected samples.
        sees: (N, views) samples expected from each view.
        views: points (N, 3) [m] and scanner pose (4, 4) [m] of each view.
        before: voxels before these views.
        frustum: of the scanner.
    """
    hidden, answered = np.zeros((2, len(samples)), dtype=np.bool_)
    for (points, T), its in zip(views, sees.T, strict=True):
        hidden |= its & ~before.is_ray_clear(frustum.source_at(T), frustum.towards(samples.points, T), frustum.near)
        answered |= its & frustum.answered(samples.points, points, T)
    return float(samples.areas[hidden & ~answered].sum())


def should_keep_min_range(batches: Sequence[tuple[float, float]]) -> bool:
    """Return whether views must keep the minimum range, because a recent batch was too close.

    Args:
        batches: area below the minimum range (`area_below_min_range`) and expected area of each batch, same unit.
    """
    return any(near > _MAX_SHARE * expected for near, expected in batches[-N_LATEST_BATCHES:])


class MinRangeOccluder:
    """Ray caster of the occluders, and of space that may belong to the part up to the minimum range.

    Args:
        occluders: their ray caster; None if there are none.
        space: voxels with at least one hit [m].
        near: minimum range [m].
    """

    def __init__(self, occluders: RayCaster | None, space: VoxelSpace, near: float) -> None:
        surface = belief.enclosing_surface(space, space.maybe_part)
        self._occluders, self._near = occluders, near
        self._possible = EmbreeRayCaster(surface.vertices, surface.faces)

    def first_hit(self, origins: Floats, directions: Floats) -> Hits:
        """Return the first hits of the occluders."""
        assert self._occluders is not None
        return self._occluders.first_hit(origins, directions)

    def blocked(self, origins: Floats, targets: Floats) -> Bools:
        """Return whether each line of sight is blocked (see `RayCaster.blocked`)."""
        nothing = np.zeros(len(origins), dtype=np.bool_)
        is_blocked = nothing if self._occluders is None else np.array(self._occluders.blocked(origins, targets))
        left = np.flatnonzero(~is_blocked)
        legs = targets[left] - origins[left]
        share = np.minimum(self._near / np.maximum(np.linalg.norm(legs, axis=1, keepdims=True), 1e-12), 1.0)
        is_blocked[left] = self._possible.blocked(origins[left], origins[left] + share * legs)
        return is_blocked
