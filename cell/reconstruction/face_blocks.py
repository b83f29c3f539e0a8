"""Which triangles may be the closest to a point: branch and bound over blocks of triangles.

Neighbours of a k-d tree cannot certify the closest triangle of a point that is far from the surface or near its medial
axis: thousands of triangles are then about as near. Here the triangles stand in Morton order, so that runs of them
are compact; a run has a box along the axes and a slab along its mean normal, four runs make a larger one, and so on.
A run whose box or slab is farther than the surface is known to be is left out as a whole. The slab is what makes the
bound tight: a run is a nearly flat patch, and its box along the axes is thick where the patch is tilted. One corner of
each run tells how far the surface is at most. No such bound parts triangles that really are as near as each other: of
the middle of a ball all triangles remain. Any one frame, metres.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

_FAN = 4  # triangles in a run, and runs in a larger one: measured, 8 takes a fifth longer and 16 three times as long
_TOP = 64  # runs at most in the coarsest level, each of which every point is compared with
_POINTS = 512  # a pass, so that its arrays stay in the processor's cache
_PAIRS = 500_000  # of a point and a run; more of them, of several points, are taken in two halves
_MORTON_BITS = 10  # per axis


class FaceBlocks:
    """Runs of triangles with bounds, in levels from fine to coarse.

    Args:
        triangles: (P, 3, 3) corners [m], P > 0.
    """

    def __init__(self, triangles: Floats) -> None:
        self._order = _morton_order(triangles.mean(axis=1))
        corners = triangles[self._order]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self._levels = [_Level.of(corners, normal, 1, None)]
        while len(self._levels[-1].axis) > _TOP:
            self._levels.append(_Level.of(corners, normal, _FAN ** len(self._levels), self._levels[-1]))

    def pairs(self, points: Floats, reach: Floats, margin: float) -> Iterator[tuple[Indices, Indices]]:
        """Pairs of a point and a triangle, among them the closest triangle of each point.

        Args:
            points: (N, 3) [m].
            reach: (N,) no less than the distance of the triangles from each point [m]; inf where nothing is known.
            margin: for the rounding of `reach` and of the bounds [m].

        Yields:
            (M,) rows of `points`, ascending, and (M,) triangles; all pairs of a point come at once.
        """
        known = reach.copy()
        top = np.arange(len(self._levels[-1].axis))
        for start in range(0, len(points), _POINTS):
            rows = np.arange(start, min(start + _POINTS, len(points)))
            waiting = [(len(self._levels) - 1, np.repeat(rows, len(top)), np.tile(top, len(rows)))]
            while waiting:
                level, row, run = waiting.pop()
                row, run = self._step(level, points, row, run, known, margin)
                if level == 0:
                    yield row, self._order[run]
                    continue
                cut = len(row)
                if len(row) > _PAIRS and row[0] != row[-1]:
                    middle = row[len(row) // 2]
                    cut = int(np.searchsorted(row, middle, side="right" if middle == row[0] else "left"))
                    waiting.append((level - 1, *self._parts(level - 1, row[cut:], run[cut:])))
                waiting.append((level - 1, *self._parts(level - 1, row[:cut], run[:cut])))

    def _step(
        self, level: int, points: Floats, row: Indices, run: Indices, known: Floats, margin: float
    ) -> tuple[Indices, Indices]:
        """The pairs whose run is within reach; `known` is lowered on the way by what the runs' samples tell."""
        runs, query = self._levels[level], points[row]
        if level:
            first = np.flatnonzero(np.concatenate([[True], row[1:] != row[:-1]]))
            offset = query - runs.sample[run]
            at_most = np.sqrt(np.minimum.reduceat(np.einsum("nj,nj->n", offset, offset), first))
            known[row[first]] = np.minimum(known[row[first]], at_most)
        keep = runs.within(query, run, known[row] * (1 + 1e-9) + margin)
        return row[keep], run[keep]

    def _parts(self, level: int, row: Indices, run: Indices) -> tuple[Indices, Indices]:
        """The pairs with the runs of `level` that the runs of the level above consist of."""
        row, run = np.repeat(row, _FAN), (run[:, None] * _FAN + np.arange(_FAN)).ravel()
        is_there = run < len(self._levels[level].axis)
        return row[is_there], run[is_there]


@dataclass(frozen=True, slots=True, eq=False)
class _Level:
    """R runs of equal length, the last one perhaps shorter.

    Attributes:
        low, high: (R, 3) box [m].
        axis: (R, 3) mean normal.
        least, most: (R,) slab along it [m].
        sample: (R, 3) a point of each [m].
    """

    low: Floats
    high: Floats
    axis: Floats
    least: Floats
    most: Floats
    sample: Floats

    @classmethod
    def of(cls, corners: Floats, normal: Floats, length: int, finer: "_Level | None") -> "_Level":
        """Runs of `length` of triangles in order: (P, 3, 3) corners [m], (P, 3) normals by area."""
        starts = np.arange(0, len(corners), length)
        axis = _unit(normal if finer is None else np.add.reduceat(normal, starts))
        along = np.repeat(axis, length, axis=0)[: len(corners)]
        heights = [np.einsum("pj,pj->p", corners[:, i], along) for i in range(3)]
        groups = np.arange(0, 0 if finer is None else len(finer.low), _FAN)
        return cls(
            _fold(np.minimum, list(corners.swapaxes(0, 1)))
            if finer is None
            else np.minimum.reduceat(finer.low, groups),
            _fold(np.maximum, list(corners.swapaxes(0, 1)))
            if finer is None
            else np.maximum.reduceat(finer.high, groups),
            axis,
            np.minimum.reduceat(_fold(np.minimum, heights), starts),
            np.maximum.reduceat(_fold(np.maximum, heights), starts),
            corners[np.minimum(starts + length // 2, len(corners) - 1), 0],
        )

    def within(self, points: Floats, run: Indices, reach: Floats) -> Indices:
        """Which pairs of a point (N, 3) and a run (N,) have both box and slab within reach (N,) [m]."""
        height = np.einsum("nj,nj->n", points, self.axis[run])
        near = np.flatnonzero((height <= self.most[run] + reach) & (height >= self.least[run] - reach))
        points, run = points[near], run[near]
        beyond = np.maximum(self.low[run] - points, points - self.high[run])
        np.maximum(beyond, 0, out=beyond)
        within: Indices = near[np.einsum("nj,nj->n", beyond, beyond) <= reach[near] ** 2]
        return within


def _fold(extreme: np.ufunc, of_corners: list[Floats]) -> Floats:
    """The least or the most over three corners; ten times as fast as a reduction over an axis of length three."""
    value: Floats = extreme(extreme(of_corners[0], of_corners[1]), of_corners[2])
    return value


def _unit(vectors: Floats) -> Floats:
    """(N, 3) of length one; the z axis where there is no direction."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.where(length > 0, vectors / np.where(length > 0, length, 1.0), np.array([0.0, 0.0, 1.0]))


def _morton_order(centres: Floats) -> Indices:
    """Order along a Z-shaped curve (G. M. Morton 1966): the bits of the three coordinates interleaved."""
    low = centres.min(axis=0)
    extent = max(float((centres.max(axis=0) - low).max()), 1e-300)
    place = np.minimum((centres - low) / extent * 2**_MORTON_BITS, 2**_MORTON_BITS - 1).astype(np.int64)
    code = np.zeros(len(centres), dtype=np.int64)
    for bit in range(_MORTON_BITS):
        for axis in range(3):
            code |= ((place[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")
