"""Views of the boundary of the measured points.

L. Li, L. Wan, X. Zhang, "Boundary exploration for next best view policy in 3D robotic scanning" (BENBV),
arXiv:2412.10444, 2024. A point belongs to the boundary if its neighbours, seen along the normal, leave a gap of more
than 120 degrees. The boundary is divided into 20 clusters by k-means; the point nearest to the middle of each is a
target. A view looks at its target from the working distance along the normal, or tilted by 45 degrees out of or into
the measured surface (the publication takes one of the three for each target). The view with the best score is next.

The published score is a weighted sum of coverage and overlap, simulated with a model of the part or predicted by a
trained network. Neither is known here: the score is the number of unknown voxels along the rays of a view, as in
`volumetric`. Overlap is omitted, because the laboratory knows the poses. A view next to an executed one is left out: a
simulated score would find nothing new there.
"""

import numpy as np
from numpy.random import Generator
from scipy.cluster.vq import kmeans2
from scipy.spatial import cKDTree

from benchmarks.exploring.density import thinned
from benchmarks.exploring.lab import Knowledge, Lab, NextView
from benchmarks.exploring.rivals import most_unknown
from planner.values import Bools, Floats
from planner.viewpoints.viewpoints import aim_viewpoints

N_NEIGHBOURS, GAP, N_CLUSTERS = 30, np.radians(120), 20
TILTS = np.radians((-45, 0, 45))
_SPACING = 2.0  # edges of a voxel between thinned points
_NEXT_TO, _ALIGNED = 0.1, np.cos(np.radians(10))  # distance as a share of the working distance, and angle of the axes


def boundary(lab: Lab, rng: Generator) -> NextView:
    """Return the policy of views at the boundary of the measured points."""

    def next_view(known: Knowledge) -> Floats | None:
        points, towards = thinned(known, _SPACING * lab.unknown.edge)
        if len(points) <= N_NEIGHBOURS:
            return None
        near = cKDTree(points).query(points, N_NEIGHBOURS + 1)[1][:, 1:]
        normals = _normals(points, near, towards)
        edge = np.flatnonzero(is_boundary(points, normals, near))
        if not len(edge):
            return None
        seed, count = int(rng.integers(2**31)), min(N_CLUSTERS, len(edge))
        middles, _ = kmeans2(points[edge], count, minit="++", seed=seed)
        at = np.unique(edge[cKDTree(points[edge]).query(middles)[1]])
        out = points[at] - points[near[at]].mean(axis=1)
        out -= np.einsum("nj,nj->n", out, normals[at])[:, None] * normals[at]
        out /= np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-12)
        directions = np.concatenate([np.cos(tilt) * normals[at] + np.sin(tilt) * out for tilt in TILTS])
        targets = np.tile(points[at], (len(TILTS), 1))
        viewpoints = aim_viewpoints(targets, directions, np.full(len(targets), -1), [lab.middle_range], [0.0])
        T = viewpoints.T_object_scanner[:, 0]
        return most_unknown(lab, known, T[~_executed(T, np.stack(known.poses), _NEXT_TO * lab.middle_range)])

    return next_view


def is_boundary(points: Floats, normals: Floats, near: np.ndarray) -> Bools:
    """Return (n,) whether the neighbours (n, k) of points leave a gap of more than `GAP` about the normals."""
    helper = np.where(np.abs(normals[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    a = np.cross(normals, helper)
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    b = np.cross(normals, a)
    away = points[near] - points[:, None]
    turn = np.sort(np.arctan2(np.einsum("nkj,nj->nk", away, b), np.einsum("nkj,nj->nk", away, a)), axis=1)
    gaps = np.diff(np.column_stack([turn, turn[:, 0] + 2 * np.pi]), axis=1)
    return np.asarray(gaps.max(axis=1) > GAP)


def _executed(T: Floats, before: Floats, distance: float) -> Bools:
    """Return (n,) whether poses (n, 4, 4) are next to one of those before."""
    near = np.linalg.norm(T[:, None, :3, 3] - before[None, :, :3, 3], axis=2) < distance
    return np.asarray((near & (T[:, :3, 2] @ before[:, :3, 2].T > _ALIGNED)).any(axis=1))


def _normals(points: Floats, near: np.ndarray, towards: Floats) -> Floats:
    """Return (n, 3) unit normals by the principal axes of the neighbours, on the measured side."""
    away = points[near] - points[near].mean(axis=1, keepdims=True)
    normals = np.linalg.svd(away, full_matrices=False)[2][:, 2]
    return np.asarray(normals * np.where(np.einsum("nj,nj->n", normals, towards) < 0, -1.0, 1.0)[:, None])
