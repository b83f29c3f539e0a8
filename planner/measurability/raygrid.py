"""Fill by casting the scanner's ray grid from every viewpoint: the paper's way (Sections 3.5.1 and 3.6, Eq. 1).

Each ray of the grid is traced to its first hit; range and grazing are judged there; the reflected ray is traced from
the sensor. The row that the hit face belongs to is set. Cost: viewpoints x rays, so the grid's resolution decides.
"""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from planner.ports import RayCaster, Rejection, Scanner
from planner.surface.mesh import TriangleMesh
from planner.values import Floats, Ints, Ints32
from planner.viewpoints.lines_of_sight import BUNDLE, lift


def scanned_rows(
    poses: Floats, part: TriangleMesh, row_of_face: Ints32, scanner: Scanner, ray_caster: RayCaster
) -> Iterator[tuple[int, Ints, Ints]]:
    """Rows that a scan from each pose measures.

    Rays that pass the part's bounding sphere are not cast: they cannot hit.

    Args:
        poses: (P, 4, 4) T_object_scanner [m].
        part: the mesh that the caster holds, object frame.
        row_of_face: (F,) row of each face, -1 for none.
        scanner: its ray grid and its conditions.
        ray_caster: casts on the part.

    Yields:
        (poses done, pose of each pair, row of each pair) in bundles; each pair once.
    """
    normals = part.normals
    used = part.vertices[part.faces.ravel()]
    low, high = used.min(axis=0), used.max(axis=0)
    middle, diagonal = (low + high) / 2, float(np.linalg.norm(high - low))
    radius = float(np.linalg.norm(used - middle, axis=1).max()) * (1 + 1e-6)
    grid = scanner.ray_directions()
    n_rows = int(row_of_face.max(initial=0)) + 1
    waiting: list[Ints] = []
    first, count = 0, 0
    for pose in range(len(poses)):
        T = poses[pose]
        waiting.append(_towards(grid, T[:3, :3].T @ (middle - T[:3, 3]), scanner.source, radius))
        count += len(waiting[-1])
        if count < BUNDLE and pose + 1 < len(poses):
            continue
        which, face = _scan(poses[first : pose + 1], waiting, grid, normals, diagonal, scanner, ray_caster)
        row = row_of_face[face].astype(np.int64)
        keys = np.unique(((which + first) * n_rows + row)[row >= 0])
        yield pose + 1, keys // n_rows, keys % n_rows
        waiting, first, count = [], pose + 1, 0


def _towards(grid: Floats, middle: Floats, source: Floats, radius: float) -> Ints:
    """Rays of the grid that meet a sphere; all in the scanner frame."""
    towards = middle - source
    squared = float(towards @ towards) - radius**2
    if squared <= 0:  # the source is inside
        return np.arange(len(grid))
    return np.flatnonzero(grid @ towards >= np.sqrt(squared))


def _scan(
    poses: Floats,
    rays: list[Ints],
    grid: Floats,
    normals: Floats,
    diagonal: float,
    scanner: Scanner,
    ray_caster: RayCaster,
) -> tuple[Ints, Ints32]:
    """(pose, face) of every ray that is measured; `rays[i]` are those of the grid that pose i casts."""
    ends = np.concatenate([[0], np.cumsum([len(chosen) for chosen in rays])])
    pose = np.repeat(np.arange(len(poses)), np.diff(ends))
    local = grid[np.concatenate(rays)]
    directions = np.empty_like(local)
    for i, (start, stop) in enumerate(pairwise(ends)):
        directions[start:stop] = local[start:stop] @ poses[i, :3, :3].T
    sources = poses[:, :3, :3] @ scanner.source + poses[:, :3, 3]
    sensors = poses[:, :3, :3] @ scanner.sensor + poses[:, :3, 3]
    hits = ray_caster.first_hit(sources[pose], directions)
    hit = np.flatnonzero(hits.face >= 0)
    pose, face, distance = pose[hit], hits.face[hit], hits.distance[hit, None]
    outward = normals[face]
    in_scanner = np.empty_like(outward)
    for i, (start, stop) in enumerate(pairwise(np.searchsorted(pose, np.arange(len(poses) + 1)))):
        in_scanner[start:stop] = outward[start:stop] @ poses[i, :3, :3]
    codes = scanner.reject(scanner.source + local[hit] * distance, in_scanner)
    good = np.flatnonzero(codes == Rejection.MEASURED)
    pose, face = pose[good], face[good]
    points = sources[pose] + directions[hit[good]] * distance[good]
    free = ~ray_caster.blocked(sensors[pose], lift(points, outward[good], diagonal))
    return pose[free], face[free]
