"""Point clouds: single scans, the merged cloud, point spacing and normals. Object frame, metres.

Normals come from local principal components and are turned toward the place from which the scanner saw the point, which
is always outside the part. Neighbours that were seen from the opposite side do not take part, so that the two faces of
a thin sheet keep their own normals.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.errors import PlannerError
from planner.values import Floats, Value, freeze, readonly

NEIGHBOURS = 12
"""Neighbours for a normal, the point itself among them: fewer follow the noise, more round off edges."""

# Where a scan grazes the surface its rows lie far apart, and the nearest points are all of one row: no plane is sure,
# or it is the plane that also holds the line of sight. Such a normal is taken from more points.
_ROW = 0.1  # second over first principal variance; a plane covered evenly has 1, three rows of four have 0.5
_EDGE_ON = 0.2  # cosine between normal and line of sight (78 degrees): no scanner measures so edge-on a surface
_MORE_NEIGHBOURS = (3, 8)  # times as many
_CHUNK = 16_384  # points a pass, so that its arrays stay in the processor's cache


@dataclass(frozen=True, slots=True, eq=False)
class ScanCloud(Value):
    """The points of one scan.

    Attributes:
        points: (P, 3) [m], object frame; P may be 0.
        sensor: (3,) where the scanner stood [m], object frame (its laser source).
    """

    points: Floats
    sensor: Annotated[Floats, "3"]

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", finite("points of the scan", self.points))
        freeze(self)

    def __len__(self) -> int:
        return len(self.points)

    def moved(self, T: Floats) -> "ScanCloud":
        """The scan, scanner and all, after a rigid motion T (4, 4) in the object frame."""
        return ScanCloud(self.points @ T[:3, :3].T + T[:3, 3], T[:3, :3] @ self.sensor + T[:3, 3])


@dataclass(frozen=True, slots=True, eq=False)
class PointCloud(Value):
    """Merged scans.

    Attributes:
        points: (N, 3) [m], object frame; N may be 0.
        normals: (N, 3) unit normals, outward (toward the scanner), object frame.
        scan: (N,) int32 which scan each point is from.
    """

    points: Floats
    normals: Annotated[Floats, "N 3"]
    scan: Annotated[NDArray[np.int32], "N"]

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", finite("points of the cloud", self.points))
        freeze(self, N=len(self.points))

    def __len__(self) -> int:
        return len(self.points)

    def moved(self, T: Floats) -> "PointCloud":
        """The cloud after a rigid motion T (4, 4)."""
        return PointCloud(self.points @ T[:3, :3].T + T[:3, 3], self.normals @ T[:3, :3].T, self.scan)


def finite(name: str, points: Floats) -> Floats:
    """Points as a read-only (N, 3) array.

    Raises:
        PlannerError: if a coordinate is NaN or infinite; the message has the name.
    """
    values = np.asarray(points, dtype=np.float64)
    bad = int((~np.isfinite(values)).any(axis=-1).sum())
    if bad:
        raise PlannerError(f"{name}: {bad} of {len(values)} have NaN or infinity; every coordinate must be finite")
    return readonly(name, values.reshape(0, 3) if values.size == 0 else values, (None, 3))


def merge(scans: Sequence[ScanCloud]) -> PointCloud:
    """All points of all scans, in order, with their normals.

    Args:
        scans: object frame, after registration.
    """
    if not scans:
        return PointCloud(np.empty((0, 3)), np.empty((0, 3)), np.empty(0, dtype=np.int32))
    points = np.concatenate([scan.points for scan in scans])
    index = np.repeat(np.arange(len(scans), dtype=np.int32), [len(scan) for scan in scans])
    sensors = np.stack([scan.sensor for scan in scans])[index]
    return PointCloud(points, estimate_normals(points, sensors), index)


def point_spacing(points: Floats, scan: NDArray[np.integer] | None = None) -> float:
    """Median distance from a point to its nearest neighbour in the same scan [m].

    Within a scan, because overlapping scans put points next to each other by chance, however coarse each scan is.
    Points that coincide are no neighbours.

    Args:
        points: (N, 3) [m].
        scan: (N,) which scan each point is from; None takes all as one.

    Returns:
        The spacing; NaN when no scan has two different points.
    """
    groups = [points] if scan is None else [points[scan == i] for i in np.unique(scan)]
    found = [np.empty(0)]
    for group in groups:
        if len(group) > 1:
            tree = cKDTree(group, balanced_tree=False, compact_nodes=False)  # builds several times faster, asks as fast
            distance = np.asarray(tree.query(group, 2, workers=2)[0])[:, 1]
            found.append(distance[distance > 0])
    distances = np.concatenate(found)
    return float(np.median(distances)) if len(distances) else float("nan")


def estimate_normals(points: Floats, sensor_positions: Floats) -> Floats:
    """Normals by principal components of the `NEIGHBOURS` nearest points, turned toward the sensor.

    Args:
        points: (N, 3) [m].
        sensor_positions: (N, 3) or (3,) from where each point was seen [m].

    Returns:
        (N, 3) unit normals. Where the neighbours span no plane, the normal faces the sensor as far as they allow.
    """
    if len(points) == 0:
        return np.empty((0, 3))
    sight = np.broadcast_to(sensor_positions, points.shape) - points
    sight /= np.maximum(np.linalg.norm(sight, axis=1, keepdims=True), 1e-12)
    toward: NDArray[np.float32] = sight.astype(np.float32)
    if len(points) < 3:
        return sight
    tree = cKDTree(points, balanced_tree=False, compact_nodes=False)
    normals, along, is_sure = _principal(tree, points, toward, np.arange(len(points)), NEIGHBOURS)
    unsure = np.flatnonzero(~is_sure)
    for more in _MORE_NEIGHBOURS:
        normals[unsure], along[unsure], is_sure = _principal(tree, points, toward, unsure, more * NEIGHBOURS)
        unsure = unsure[~is_sure]
    # A row and nothing beside it: of all planes through it, the one that faces the sensor.
    facing = sight[unsure] - np.einsum("nj,nj->n", sight[unsure], along[unsure])[:, None] * along[unsure]
    length = np.linalg.norm(facing, axis=1, keepdims=True)
    normals[unsure] = np.where(length > 1e-6, facing / np.maximum(length, 1e-6), normals[unsure])
    return normals


def _principal(
    tree: cKDTree, points: Floats, toward: NDArray[np.float32], chosen: NDArray[np.intp], neighbours: int
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Of the chosen points: normals (C, 3), directions (C, 3) of widest spread, whether the neighbours span a plane."""
    count = min(neighbours, len(points))

    def of_part(start: int) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        part = chosen[start : start + _CHUNK]
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
        parts = list(pool.map(of_part, range(0, len(chosen), _CHUNK)))
    if not parts:
        return np.empty((0, 3)), np.empty((0, 3)), np.empty(0, dtype=np.bool_)
    found, along, is_sure = (np.concatenate(values) for values in zip(*parts, strict=True))
    return found, along, is_sure
