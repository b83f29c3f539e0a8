"""Rays: results of Embree compared with float64 brute force, and the matrix at its design sizes.

`hits` and `legs` are 10^6 rays each on a closed mesh with hollows, a tenth of them through its edges, every ray against
every triangle in float64 (`$SCAN_CELL_RAYS` sets another number). A result is wrong if it differs although no edge of
the triangles in question lies within 1e-6 of the size of the part from the ray. Rays through exact vertices are counted
separately: Embree may let one pass between the faces there.

`fill` rows are separate processes, so that their memory is measured separately: Mseke at 1858 x 1858 with 4 samples per
face, and 10,000 faces x 10,000 viewpoints, with the share of Embree in the time, and the time per pair that passes the
culling.
"""

import json
import os
import subprocess
import sys
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.world.embree import HAIR, EmbreeRayCaster
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats

RAYS = int(os.environ.get("SCAN_CELL_RAYS", "1000000"))
_BLOCK = 4000
_MARGIN = 1e-6  # share of the size of the part

_FILL = """
import json, resource, sys, time
import numpy as np
import cell.world.embree
from cell.world.embree import EmbreeRayCaster
from cell.scanners.laser_area import LaserArea
from cell.scene.file import load_scene
from cell.scene.settle import settle
from cell.part.workpiece import load
from planner.measurability import visibility
from planner.viewpoints import lines_of_sight
from planner.geometry.decimation import decimate
from planner import threads
from planner.geometry.sampling import draw_samples
from planner.viewpoints.viewpoints import optimal_scanning_zone

faces, per_face = int(sys.argv[1]), int(sys.argv[2])
part = load("mseke")
settings = settle(load_scene(None, {"part": {"name": "mseke"}}), part).settings
planning = decimate(part.reference, faces)
features = draw_samples(part.reference, planning, per_face * len(planning.faces), np.random.default_rng(0))
views = optimal_scanning_zone(planning, settings.standoffs, (0.0,))
caster = EmbreeRayCaster(part.reference.vertices, part.reference.faces)
passed = [0]
def counting(*arguments):
    passed[0] += len(arguments[3])
    return are_free(*arguments)
are_free, lines_of_sight.lines_of_sight_free = lines_of_sight.lines_of_sight_free, counting
scanner = LaserArea(**settings.scanner)
best = None
for _ in range(int(sys.argv[3])):
    passed[0] = 0
    start = time.perf_counter()
    M = visibility.fill_matrix(views, features, scanner, caster)
    seconds = time.perf_counter() - start
    best = min(best, seconds) if best else seconds

class Timed:
    def __init__(self, scene):
        self.scene, self.seconds = scene, 0.0
    def run(self, *arguments, **keys):
        start = time.perf_counter()
        result = self.scene.run(*arguments, **keys)
        self.seconds += time.perf_counter() - start
        return result

caster._scene = timed = Timed(caster._scene)
threads.CORES = 1  # one thread, so that the share of Embree's seconds is defined
start = time.perf_counter()
visibility.fill_matrix(views, features, scanner, caster)
alone = time.perf_counter() - start
print(json.dumps({
    "what": f"fill {len(planning.faces)} x {len(views)}, {per_face} per face",
    "reference faces": len(part.reference.faces),
    "pairs": len(features) * len(views), "passed culling": passed[0], "entries": len(M.indices), "s": round(best, 2),
    "us per passed pair": round(1e6 * best / passed[0], 3),
    "peak MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024,
    "one thread s": round(alone, 2), "Embree's share %": round(100 * timed.seconds / alone, 1),
}))
"""


def run() -> list[dict[str, Any]]:
    """Return three rows of answers, two of sizes."""
    vertices, faces = _bumpy_sphere()
    rows = [_hits(vertices, faces), _legs(vertices, faces), _vertices(vertices, faces)]
    for arguments in (("1858", "4", "3"), ("10000", "1", "1")):
        process = subprocess.run([sys.executable, "-c", _FILL, *arguments], capture_output=True, text=True, check=True)
        rows.append(json.loads(process.stdout))
    return rows


def _hits(vertices: Floats, faces: NDArray[np.int64]) -> dict[str, Any]:
    rng = np.random.default_rng(0)
    size = float(np.ptp(vertices, axis=0).max())
    origins, targets = _ends(rng, vertices, faces)
    directions = targets - origins
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    start = perf_counter()
    found = EmbreeRayCaster(vertices, faces).first_hit(origins, directions)
    seconds = perf_counter() - start
    wrong = near_edge = 0
    largest = steep = 0.0
    normals = TriangleMesh(vertices, faces).normals
    for block in np.array_split(np.arange(RAYS), RAYS // _BLOCK):
        distance, margin = _all_hits(vertices, faces, origins[block], directions[block])
        first = distance.min(axis=1)
        hit = found.face[block] >= 0
        both = hit & np.isfinite(first)
        off = np.zeros(len(block))
        off[both] = np.abs(found.distance[block][both] - first[both])
        # A grazing hit is off by 1e-7 / cosine; a larger difference means another triangle.
        same = (hit == np.isfinite(first)) & (off <= 1e-4 * size)
        clear = (np.abs(margin) > _MARGIN * size).all(axis=1)
        wrong += int((~same & clear).sum())
        near_edge += int((~same & ~clear).sum())
        off *= same
        largest = max(largest, float(off.max()))
        cosine = np.abs(np.einsum("ni,ni->n", normals[found.face[block]], directions[block]))
        steep = max(steep, float(off[cosine >= np.cos(np.deg2rad(75))].max()))
    return {
        "what": f"{RAYS:,} first hits, {len(faces)} faces", "s": round(seconds, 2), "wrong": wrong,
        "differ at an edge": near_edge, "largest error / size": f"{largest / size:.2g}",
        "the same within 75°": f"{steep / size:.2g}",
    }  # fmt: skip


def _legs(vertices: Floats, faces: NDArray[np.int64]) -> dict[str, Any]:
    rng = np.random.default_rng(1)
    size = float(np.ptp(vertices, axis=0).max())
    half = float(np.linalg.norm(np.ptp(vertices, axis=0))) / 2
    origins, through = _ends(rng, vertices, faces)
    targets = origins + (through - origins) * rng.uniform(0.3, 2.0, (RAYS, 1))
    start = perf_counter()
    blocked = EmbreeRayCaster(vertices, faces).blocked(origins, targets)
    seconds = perf_counter() - start
    along = targets - origins
    length = np.linalg.norm(along, axis=1)
    end = length - HAIR * (length + half)
    wrong = near_edge = 0
    for block in np.array_split(np.arange(RAYS), RAYS // _BLOCK):
        distance, margin = _all_hits(vertices, faces, origins[block], along[block] / length[block, None])
        expected = (distance < end[block, None]).any(axis=1)
        clear = (np.abs(margin) > _MARGIN * size).all(axis=1)
        clear &= (np.abs(distance - end[block, None]) > _MARGIN * size).all(axis=1)
        differs = blocked[block] != expected
        wrong += int((differs & clear).sum())
        near_edge += int((differs & ~clear).sum())
    return {
        "what": f"{RAYS:,} blocked or not, {len(faces)} faces", "s": round(seconds, 2), "wrong": wrong,
        "differ at an edge": near_edge,
    }  # fmt: skip


def _vertices(vertices: Floats, faces: NDArray[np.int64]) -> dict[str, Any]:
    """Cast rays from the inside through exact vertices: a ray without hit passes through the closed mesh."""
    rng = np.random.default_rng(2)
    count = RAYS // 10
    origins = rng.normal(size=(count, 3)) * 0.01
    directions = vertices[rng.integers(len(vertices), size=count)] - origins
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    start = perf_counter()
    found = EmbreeRayCaster(vertices, faces).first_hit(origins, directions)
    return {
        "what": f"{count:,} through exact vertices", "s": round(perf_counter() - start, 2),
        "differ at an edge": int((found.face < 0).sum()),
    }  # fmt: skip


def _ends(rng: np.random.Generator, vertices: Floats, faces: NDArray[np.int64]) -> tuple[Floats, Floats]:
    """Return origins inside and outside, and targets anywhere in the part, one in ten on an edge."""
    size = float(np.ptp(vertices, axis=0).max())
    origins = rng.normal(size=(RAYS, 3)) * size * rng.choice([0.1, 1.0], (RAYS, 1))
    towards = rng.uniform(-0.6, 0.6, (RAYS, 3)) * size
    edge = np.arange(0, RAYS, 10)
    corners = vertices[faces[rng.integers(len(faces), size=len(edge))]]
    share = rng.random((len(edge), 1))
    towards[edge] = corners[:, 0] * share + corners[:, 1] * (1 - share)
    return origins, towards


def _all_hits(vertices: Floats, faces: NDArray[np.int64], origins: Floats, directions: Floats) -> tuple[Floats, Floats]:
    """Return (N, F) distance of each ray to each triangle, inf for a miss, and its distance from the edges [m].

    How far is negative outside, and inf for triangles whose plane the ray does not meet in front of its origin.
    """
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    normal = np.cross(b - a, c - a)
    towards = directions @ normal.T
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (np.einsum("fi,fi->f", a, normal) - origins @ normal.T) / towards
    safe = np.where(np.isfinite(distance), distance, 0.0)
    inside = np.full(safe.shape, np.inf)
    unit = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    for start, stop in ((a, b), (b, c), (c, a)):
        inward = np.cross(unit, stop - start)
        inward /= np.linalg.norm(inward, axis=1, keepdims=True)
        edge_distance = origins @ inward.T + safe * (directions @ inward.T) - np.einsum("fi,fi->f", start, inward)
        inside = np.minimum(inside, edge_distance)
    # Along the ray, the distance of an edge is at most its distance in the plane times the cosine.
    inside *= np.maximum(np.abs(towards) / np.linalg.norm(normal, axis=1), 1e-3)
    ahead = np.isfinite(distance) & (distance > 0)
    return np.where(ahead & (inside >= 0), distance, np.inf), np.where(ahead, inside, np.inf)


def _bumpy_sphere(n: int = 3) -> tuple[Floats, NDArray[np.int64]]:
    """Return a closed mesh of 12 n^2 faces, 0.2 m wide, with hollows: an inflated grid of a cube."""
    grid = np.linspace(-1.0, 1.0, n + 1)
    u, v = (value.ravel() for value in np.meshgrid(grid, grid, indexing="ij"))
    points, triangles = [], []
    cells = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    corner = np.stack([cells[:-1, :-1], cells[1:, :-1], cells[1:, 1:], cells[:-1, 1:]], axis=-1).reshape(-1, 4)
    for axis in range(3):
        for side in (-1.0, 1.0):
            face = np.empty((len(u), 3))
            face[:, axis], face[:, (axis + 1) % 3], face[:, (axis + 2) % 3] = side, u * side, v
            triangles.append(np.concatenate([corner[:, [0, 1, 2]], corner[:, [0, 2, 3]]]) + len(points) * len(u))
            points.append(face)
    everything, index = np.unique(np.concatenate(points).round(9), axis=0, return_inverse=True)
    outward = everything / np.linalg.norm(everything, axis=1, keepdims=True)
    radius = 0.1 * (1 + 0.3 * np.sin(7 * outward[:, 0]) * np.cos(5 * outward[:, 1] + 3 * outward[:, 2]))
    return outward * radius[:, None], index.ravel()[np.concatenate(triangles)]
