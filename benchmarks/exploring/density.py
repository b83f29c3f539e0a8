"""Views of a density frontier, the end of measured surface, without voxels or meshes.

R. Border, J. D. Gammell, P. Newman, "Surface Edge Explorer (SEE): planning next best views directly from 3D
observations", ICRA 2018; R. Border, J. D. Gammell, "The Surface Edge Explorer (SEE): a measurement-direct approach to
next best view planning", International Journal of Robotics Research 43 (2024), doi:10.1177/02783649241230098.

A point is a core if at least a given number of others lie within the resolution radius, else an outlier. An outlier
with cores among its neighbours belongs to the frontier. At each frontier point the principal axes of the neighbours
give the normal of the surface, and the direction from their mean to the point leads out of the measured surface. The
view is at the view distance along the normal. A frontier point that remains one after a view gets another view, tilted
over the edge. Views that are obstructed by known points are turned about the frontier point until they are free. The
next view is the nearest to the last one (2018), or the one that sees the most frontier points (2024). The filtering of
noise is omitted: the laboratory has no noise.
"""

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.exploring.lab import Knowledge, Lab, Policy
from planner.values import Bools, Floats
from planner.viewpoints.viewpoints import aim_viewpoints

_TILTS = np.radians((0, 20, 40, 60))
_TURNS = 8
_CELLS = 3  # cells of the thinning grid per resolution radius
_CORE = 0.7
_MOST = 300  # frontier points with a proposed view, spread evenly
_OVER = np.radians((0, 45, 90))
"""Tilts over the edge, one for each attempt at a frontier point."""


def density_frontier(setting: str) -> Policy:
    """Return the policy of a setting: resolution radius in edges of a voxel, and rule for the next view."""
    edges, rule = setting.split(", ")
    return lambda lab, rng: _Explorer(lab, float(edges), rule == "most")


SETTINGS = ("6, nearest", "6, most", "12, nearest", "12, most")


class _Explorer:
    def __init__(self, lab: Lab, edges: float, most: bool) -> None:
        self._lab, self._most = lab, most
        self._radius = edges * lab.unknown.edge
        self._tried = np.empty((0, 3))

    def __call__(self, known: Knowledge) -> Floats | None:
        points, towards = thinned(known, self._radius / _CELLS)
        tree = cKDTree(points)
        frontier = self._frontier(points, tree)
        often = np.zeros(len(frontier), dtype=np.int64)
        if len(self._tried) and len(frontier):
            often = cKDTree(self._tried).query_ball_point(points[frontier], self._radius, return_length=True)
        rows = np.flatnonzero(often < len(_OVER))
        if not len(rows):
            return None
        rows = rows[np.linspace(0, len(rows) - 1, min(_MOST, len(rows))).astype(int)]
        frontier, over = frontier[rows], _OVER[often[rows]][:, None]
        local = [_normal_and_way_out(points, tree, at, self._radius, towards[at]) for at in frontier]
        normals, out = (np.stack(each) for each in zip(*local, strict=True))
        normals = np.cos(over) * normals + np.sin(over) * out
        poses, aimed = self._proposed(known, points[frontier], normals, tree)
        if not len(poses):
            return None
        if self._most:
            best = int(np.argmax(self._sees(poses, points[frontier], normals).sum(axis=0)))
        else:
            best = int(np.argmin(np.linalg.norm(poses[:, :3, 3] - known.poses[-1][:3, 3], axis=1)))
        self._tried = np.concatenate([self._tried, points[frontier[aimed[best]]][None]])
        return poses[best]

    def _frontier(self, points: Floats, tree: cKDTree) -> np.ndarray:
        """Return the rows of outliers with cores among their neighbours.

        A core has at least `_CORE` of the neighbours that a point inside a plane patch has at the thinned spacing; at a
        straight edge a point has half of them.
        """
        core = tree.query_ball_point(points, self._radius, return_length=True) >= _CORE * np.pi * _CELLS**2
        near_core = cKDTree(points[core]).query(points, distance_upper_bound=self._radius)[0] if core.any() else np.inf
        return np.flatnonzero(~core & np.isfinite(near_core))

    def _proposed(self, known: Knowledge, at: Floats, normals: Floats, tree: cKDTree) -> tuple[Floats, np.ndarray]:
        """Return (n, 4, 4) views and the frontier point of each.

        Each view is the least tilted free and unobstructed one of its frontier point.
        """
        free, open_ = self._lab.free(known.space), np.arange(len(at))
        poses, aimed = [], []
        for tilt in _TILTS:
            for turn in np.arange(_TURNS) * 2 * np.pi / _TURNS if tilt else (0.0,):
                if not len(open_):
                    break
                out = _tilted(normals[open_], tilt, turn)
                T = aim_viewpoints(
                    at[open_], out, np.full(len(open_), -1), [self._lab.middle_range], [0.0]
                ).T_object_scanner[:, 0]
                good = free(T) & self._unhidden(at[open_], out, tree)
                poses.append(T[good])
                aimed.append(open_[good])
                open_ = open_[~good]
        return np.concatenate(poses), np.concatenate(aimed)

    def _unhidden(self, at: Floats, out: Floats, tree: cKDTree) -> Bools:
        """Return (n,) whether no known point lies near the line of sight beyond two radii above the surface."""
        away = np.arange(2.5, 2.5 + 2 * self._lab.cylinder.radius / self._radius, 1.0) * self._radius
        line = at[:, None] + away[None, :, None] * out[:, None]
        near = tree.query(line.reshape(-1, 3), distance_upper_bound=self._radius)[0].reshape(len(at), -1)
        return np.asarray(np.isinf(near).all(axis=1))

    def _sees(self, poses: Floats, at: Floats, normals: Floats) -> Bools:
        """Return (frontier, poses) whether a view faces each frontier point within field of view and range."""
        seen = [self._lab.scanner.reject((at - T[:3, 3]) @ T[:3, :3], normals @ T[:3, :3]) == 0 for T in poses]
        return np.stack(seen, axis=1)


def thinned(known: Knowledge, spacing: float) -> tuple[Floats, Floats]:
    """Return (P, 3) a point of each cell of a grid, and the unit direction to the source that measured it."""
    points = np.concatenate(known.points)
    origin = np.concatenate(
        [np.broadcast_to(T[:3, 3], p.shape) for T, p in zip(known.poses, known.points, strict=True)]
    )
    first = np.unique(np.floor(points / spacing).astype(np.int64), axis=0, return_index=True)[1]
    away = origin[first] - points[first]
    return points[first], away / np.linalg.norm(away, axis=1, keepdims=True)


def _normal_and_way_out(
    points: Floats, tree: cKDTree, at: int, radius: float, towards: Floats
) -> tuple[Floats, Floats]:
    """Return the unit normal at a point, on the measured side, and the direction out of the measured surface."""
    near = points[tree.query_ball_point(points[at], radius)]
    middle = near.mean(axis=0)
    axes = np.linalg.svd(near - middle, full_matrices=False)[2]
    normal = axes[2] if len(axes) == 3 else towards
    normal = normal if normal @ towards > 0 else -normal
    out = points[at] - middle - (points[at] - middle) @ normal * normal
    length = float(np.linalg.norm(out))
    return normal, out / length if length > 0 else out


def _tilted(normals: Floats, tilt: float, turn: float) -> Floats:
    """Return (n, 3) unit vectors at an angle from normals, at another angle about them."""
    helper = np.where(np.abs(normals[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    a = np.cross(normals, helper)
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    b = np.cross(normals, a)
    return np.asarray(np.cos(tilt) * normals + np.sin(tilt) * (np.cos(turn) * a + np.sin(turn) * b))
