"""Closest points and signed distances on the Mseke, full and decimated: seconds, error and wrong signs.

`near` points are scattered about the surface by 0.4 % of the diagonal, one sigma; `far` points fill a box twice as
large as that of the part. Error and sign of a hundred of each are compared with every triangle in turn: the plane if
the foot is inside, else the edges; the sign by the solid angle (van Oosterom and Strackee,
doi:10.1109/TBME.1983.325207).
"""

from time import perf_counter, process_time
from typing import Any

import numpy as np

from cell.part.workpiece import load
from planner.geometry.closest import ClosestPointQuery
from planner.geometry.decimation import decimate
from planner.geometry.mesh import TriangleMesh
from planner.registration.surface import sample_by_area
from planner.values import Floats

FACES = (5_000, 20_000, 80_000, None)
NEAR, FAR, N_CHECKED = 100_000, 20_000, 100


def run() -> list[dict[str, Any]]:
    """Return two rows per mesh."""
    reference = load("mseke").reference
    rows = []
    for count in FACES:
        mesh = reference if count is None else decimate(reference, count)
        rng = np.random.default_rng(0)
        near = sample_by_area(mesh, NEAR, rng) + rng.normal(0, 0.004 * mesh.diagonal, (NEAR, 3))
        low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
        far = rng.uniform(1.5 * low - 0.5 * high, 1.5 * high - 0.5 * low, (FAR, 3))
        rows += [_row(mesh, "near", near), _row(mesh, "far", far)]
    return rows


def _row(mesh: TriangleMesh, what: str, points: Floats) -> dict[str, Any]:
    start, busy = perf_counter(), process_time()
    closest = ClosestPointQuery(mesh).closest(points)
    took = {"seconds": perf_counter() - start, "processor s": process_time() - busy}
    start, busy = perf_counter(), process_time()
    signed = ClosestPointQuery(mesh).signed_distance(points)
    took |= {"signed s": perf_counter() - start, "signed processor s": process_time() - busy}
    rows = np.linspace(0, len(points) - 1, N_CHECKED).astype(int)
    distance, inside = np.array([_brute(mesh.vertices[mesh.faces] - points[i]) for i in rows]).T
    return {
        "faces": len(mesh.faces), "points": f"{len(points):,} {what}", **took,
        "error / diagonal": float(np.abs(closest.distance[rows] - distance).max()) / mesh.diagonal,
        "wrong signs": f"{int(((signed[rows] < 0) != (inside > 0.5)).sum())} of {N_CHECKED}",
    }  # fmt: skip


def _brute(corners: Floats) -> tuple[float, float]:
    """Return the distance of the origin from triangles (F, 3, 3), and their winding number around it."""
    along = np.roll(corners, -1, axis=1) - corners
    step = np.clip(-np.einsum("fej,fej->fe", corners, along) / np.einsum("fej,fej->fe", along, along), 0, 1)
    best = np.linalg.norm(corners + step[:, :, None] * along, axis=2).min()
    normal = np.cross(along[:, 0], along[:, 1])
    height = np.einsum("fj,fj->f", corners[:, 0], normal) / np.linalg.norm(normal, axis=1)
    is_inside = (np.einsum("fej,fj->fe", np.cross(corners, along), normal) >= 0).all(axis=1)
    length = np.linalg.norm(corners, axis=2)
    cosines = np.einsum("fej,fej->fe", corners, np.roll(corners, -1, axis=1))  # of corners 0-1, 1-2, 2-0
    triple = np.einsum("fj,fj->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    angle = 2 * np.arctan2(triple, length.prod(axis=1) + (cosines * length[:, [2, 0, 1]]).sum(axis=1))
    return min(best, np.abs(height[is_inside]).min(initial=np.inf)), float(angle.sum()) / (4 * np.pi)
