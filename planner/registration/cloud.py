"""Point clouds: single scans, the merged cloud, point spacing and normals. Object frame, metres.

Normals come from local principal components and point toward the scanner, which is always outside the part. Neighbours
that were scanned from the opposite side are excluded, so that the two faces of a thin sheet keep their own normals.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.errors import PlannerError
from planner.registration.rigid import transform_points
from planner.values import Floats, Value, freeze, readonly

NEIGHBOURS = 12
"""Neighbours for a normal, including the point itself: fewer follow the noise, more round off edges."""

# At grazing incidence the rows of a scan lie far apart and the nearest points are all in one row: the plane is
# undetermined, or it is the plane that contains the line of sight. Such a normal is computed from more points.
_ROW = 0.1  # second over first principal variance; an evenly covered plane has 1, three rows of four have 0.5
_EDGE_ON = 0.2  # cosine between normal and line of sight (78 degrees): no scanner measures a surface so edge-on
_MORE_NEIGHBOURS = (3, 8)  # factors of `NEIGHBOURS`
_CHUNK = 16_384  # points a pass, so that its arrays stay in the processor's cache


@dataclass(frozen=True, slots=True, eq=False)
class ScanCloud(Value):
    """The points of one scan.

    Attributes:
        points: (P, 3) [m], object frame; P may be 0.
        sensor: (3,) position of the scanner's laser source [m], object frame.
    """

    points: Floats
    sensor: Annotated[Floats, "3"]

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", _finite("points of the scan", self.points))
        freeze(self)

    def __len__(self) -> int:
        return len(self.points)

    def transformed(self, T: Floats) -> "ScanCloud":
        """Return points and sensor after a rigid motion T (4, 4) in the object frame."""
        return ScanCloud(transform_points(T, self.points), T[:3, :3] @ self.sensor + T[:3, 3])


@dataclass(frozen=True, slots=True, eq=False)
class PointCloud(Value):
    """Merged scans.

    Attributes:
        points: (N, 3) [m], object frame; N may be 0.
        normals: (N, 3) unit normals, outward (toward the scanner), object frame.
        scan: (N,) index of each point's scan.
    """

    points: Floats
    normals: Annotated[Floats, "N 3"]
    scan: Annotated[NDArray[np.int32], "N"]

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", _finite("points of the cloud", self.points))
        freeze(self, N=len(self.points))

    def __len__(self) -> int:
        return len(self.points)

    def transformed(self, T: Floats) -> "PointCloud":
        """Return the cloud after a rigid motion T (4, 4)."""
        return PointCloud(transform_points(T, self.points), self.normals @ T[:3, :3].T, self.scan)


def _finite(name: str, points: Floats) -> Floats:
    """Return points as a read-only (N, 3) array; raise PlannerError if a coordinate is not finite."""
    values = np.asarray(points, dtype=np.float64)
    bad = int((~np.isfinite(values)).any(axis=-1).sum())
    if bad:
        raise PlannerError(f"{name}: {bad} of {len(values)} have NaN or infinity; every coordinate must be finite")
    return readonly(name, values.reshape(0, 3) if values.size == 0 else values, (None, 3))


def merge(scans: Sequence[ScanCloud]) -> PointCloud:
    """Merge registered scans, in order, and estimate the normals."""
    if not scans:
        return PointCloud(np.empty((0, 3)), np.empty((0, 3)), np.empty(0, dtype=np.int32))
    points = np.concatenate([scan.points for scan in scans])
    index = np.repeat(np.arange(len(scans), dtype=np.int32), [len(scan) for scan in scans])
    sensors = np.stack([scan.sensor for scan in scans])[index]
    return PointCloud(points, estimate_normals(points, sensors), index)


def point_spacing(points: Floats, scan: NDArray[np.integer] | None = None) -> float:
    """Return the median distance from a point to its nearest neighbour in the same scan [m].

    Only one scan counts at a time, because points of overlapping scans lie side by side by chance, however coarse each
    scan is. Coincident points are no neighbours. NaN if no scan has two different points.

    Args:
        points: (N, 3) [m].
        scan: (N,) index of each point's scan; None takes all as one scan.
    """
    groups = [points] if scan is None else [points[scan == i] for i in np.unique(scan)]
    by_scan = [np.empty(0)]
    for group in groups:
        if len(group) > 1:
            tree = cKDTree(group, balanced_tree=False, compact_nodes=False)  # several times faster to build
            distance = np.asarray(tree.query(group, 2, workers=2)[0])[:, 1]
            by_scan.append(distance[distance > 0])
    distances = np.concatenate(by_scan)
    return float(np.median(distances)) if len(distances) else float("nan")


def estimate_normals(points: Floats, sensor_positions: Floats) -> Floats:
    """Estimate unit normals (N, 3) by principal components of the `NEIGHBOURS` nearest points, toward the sensor.

    Where the neighbours span no plane, the normal faces the sensor as far as they allow.

    Args:
        points: (N, 3) [m].
        sensor_positions: (N, 3) or (3,) position of the sensor for each point [m].
    """
    if len(points) == 0:
        return np.empty((0, 3))
    sight = np.broadcast_to(sensor_positions, points.shape) - points
    length = np.linalg.norm(sight, axis=1, keepdims=True)
    # A point at the sensor has no direction to it: z stands for it.
    sight = np.where(length > 1e-12, sight / np.maximum(length, 1e-12), [0.0, 0.0, 1.0])
    toward: NDArray[np.float32] = sight.astype(np.float32)
    if len(points) < 3:
        return sight
    tree = cKDTree(points, balanced_tree=False, compact_nodes=False)
    normals, along, is_sure = _principal(tree, points, toward, np.arange(len(points)), NEIGHBOURS)
    unsure = np.flatnonzero(~is_sure)
    for more in _MORE_NEIGHBOURS:
        normals[unsure], along[unsure], is_sure = _principal(tree, points, toward, unsure, more * NEIGHBOURS)
        unsure = unsure[~is_sure]
    # A single row: of all planes through it, the one that faces the sensor.
    facing = sight[unsure] - np.einsum("nj,nj->n", sight[unsure], along[unsure])[:, None] * along[unsure]
    length = np.linalg.norm(facing, axis=1, keepdims=True)
    normals[unsure] = np.where(length > 1e-6, facing / np.maximum(length, 1e-6), normals[unsure])
    return normals


def _principal(
    tree: cKDTree, points: Floats, toward: NDArray[np.float32], rows: NDArray[np.intp], neighbours: int
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Return normals (C, 3), directions of widest spread (C, 3) and whether the neighbours span a plane (C,)."""
    count = min(neighbours, len(points))

    def chunk(start: int) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        part = rows[start : start + _CHUNK]
        index = tree.query(points[part], count)[1]
        # float32 is enough for offsets of neighbours (7 digits of some millimetres), and halves the memory traffic.
        offsets = (points[index] - points[part, None, :]).astype(np.float32)
        weights = (np.einsum("nkj,nj->nk", toward[index], toward[part]) > 0).astype(np.float32)
        total = weights.sum(axis=1)
        offsets -= (np.einsum("nkj,nk->nj", offsets, weights) / total[:, None])[:, None, :]
        offsets *= weights[:, :, None]
        covariance = np.matmul(offsets.transpose(0, 2, 1), offsets).astype(np.float64)
        values, vectors = np.linalg.eigh(covariance)
        normals = np.asarray(vectors[:, :, 0], dtype=np.float64)
        normals[total < 3] = toward[part][total < 3]
        cosine = np.einsum("nj,nj->n", normals, toward[part])
        normals[cosine < 0] *= -1
        return normals, vectors[:, :, 2], (values[:, 1] > _ROW * values[:, 2]) & (np.abs(cosine) > _EDGE_ON)

    with ThreadPoolExecutor(2) as pool:  # NumPy and the tree release the interpreter lock
        parts = list(pool.map(chunk, range(0, len(rows), _CHUNK)))
    if not parts:
        return np.empty((0, 3)), np.empty((0, 3)), np.empty(0, dtype=np.bool_)
    estimates, along, is_sure = (np.concatenate(values) for values in zip(*parts, strict=True))
    return estimates, along, is_sure
