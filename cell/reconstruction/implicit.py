"""The implicit surface of a point cloud: a signed distance blended from the nearest points and their normals.

A point p with normal n predicts the distance n . (x - p) at x. Averaging these alone (implicit moving least squares,
Kolluri, ACM Trans. Algorithms 4(2), 2008, doi:10.1145/1361192.1361195) shrinks round parts: a neighbour at distance t
on a sphere of radius R predicts -t^2 / 2R for a point that is on the sphere. Here every neighbour predicts with the
mean of its own normal and the blended normal: the chord between two points of a sphere is at right angles to the sum of
their normals, so that the shrinking cancels. Object frame, metres.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from cell.reconstruction.cloud import PointCloud
from planner.values import Floats

Singles = NDArray[np.float32]

NEIGHBOURS = 12
"""Neighbours blended: more take out more noise and more detail."""

_CHUNK = 16_384  # positions a pass, so that its arrays stay in the processor's cache


@dataclass(frozen=True, slots=True, eq=False)
class FieldValues:
    """The implicit surface at many positions.

    Attributes:
        distance: (N,) float32 signed distance, positive outside [m].
        normal: (N, 3) float32 blended unit normal, the direction in which the distance grows.
        nearest: (N,) float32 distance to the nearest point of the cloud [m].
    """

    distance: Singles
    normal: Singles
    nearest: Singles


class ImplicitSurface:
    """Signed distance to the surface that a cloud describes.

    Args:
        cloud: at least one point, with normals.
    """

    def __init__(self, cloud: PointCloud) -> None:
        self._points = cloud.points
        self._normals: Singles = cloud.normals.astype(np.float32)
        self._tree = cKDTree(cloud.points, balanced_tree=False, compact_nodes=False)
        self._neighbours = min(NEIGHBOURS, len(cloud))

    def evaluate(self, positions: Floats) -> FieldValues:
        """The field at positions (N, 3) [m].

        The weight (1 - (d / D)^2)^4, D just beyond the farthest neighbour, reaches zero where a neighbour drops out,
        and depends on the sideways offset only: at a height h above the surface both d^2 and D^2 grow by h^2.
        Neighbours that look away from the nearest point's normal get no weight: across a thin sheet they describe the
        other face.
        """
        starts = range(0, len(positions), _CHUNK)
        with ThreadPoolExecutor(2) as pool:  # NumPy and the tree release the interpreter lock
            parts = list(pool.map(lambda start: self._part(positions[start : start + _CHUNK]), starts))
        if not parts:
            empty = np.empty(0, dtype=np.float32)
            return FieldValues(empty, np.empty((0, 3), dtype=np.float32), empty)
        distance, normal, nearest = (np.concatenate(values) for values in zip(*parts, strict=True))
        return FieldValues(distance, normal, nearest)

    def _part(self, positions: Floats) -> tuple[Singles, Singles, Singles]:
        exact, index = map(np.asarray, self._tree.query(positions, self._neighbours))
        distance = exact.astype(np.float32)
        offset = (positions[:, None, :] - self._points[index]).astype(np.float32)
        normals = self._normals[index]
        agreement = np.einsum("nkj,nj->nk", normals, normals[:, 0])
        # A nearest point whose normal nearly all the others contradict has a wrong normal.
        agreement[(agreement > 0).sum(axis=1) < self._neighbours / 4] *= -1
        ratio = distance / (distance[:, -1:] * np.float32(1.02) + np.float32(1e-12))
        weight = (1 - ratio**2) ** 4 * np.maximum(agreement, 0)
        weight /= weight.sum(axis=1, keepdims=True)
        blended = np.einsum("nk,nkj->nj", weight, normals)
        blended /= np.linalg.norm(blended, axis=1, keepdims=True)
        normals += blended[:, None, :]
        predicted = np.einsum("nkj,nkj->nk", normals, offset)
        value: Singles = np.einsum("nk,nk->n", weight, predicted) / np.float32(2)
        return value, blended, distance[:, 0]
