"""Closest point of a triangle mesh to each of many points, exact, and on which side of the surface a point lies.

Every face is cut into pieces no larger than a common radius, and a k-d tree holds the pieces' centres. A piece whose
centre is farther than (distance found so far) + (its radius) cannot hold a closer point; the answer is certified when
the next piece that the tree would give is farther than that. That settles most points near the surface; for the others
branch and bound over the pieces (`cell.reconstruction.face_blocks`) leaves out only pieces that are certainly
farther. So the result is the exact closest point up to rounding, whatever the triangles look like. Object frame,
metres.

The side follows Baerentzen and Aanaes, "Signed distance computation using the angle weighted pseudonormal", IEEE TVCG
11 (2005), doi:10.1109/TVCG.2005.49: the normal of the face, edge or corner on which the closest point lies decides,
which is right on closed meshes also where the closest point is on an edge.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from cell.reconstruction import kdtree
from cell.reconstruction.face_blocks import FaceBlocks
from planner.surface.closest import squared_distance
from planner.surface.mesh import TriangleMesh, face_normals
from planner.values import Value

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

_CANDIDATES = (8, 32)  # the first certify about nine of ten points near the surface, the next most of the others
_NEAR = 4.0  # largest radii of a piece within which the tree is asked; farther out it hardly certifies, and takes long
_PIECES = 40_000  # a mesh of few faces is cut into about so many pieces
_CHUNK = 16_384  # points a pass, so that its arrays stay in the processor's cache
_CREASE = np.cos(np.radians(30.0))  # corners whose faces differ by more keep their face's normal


@dataclass(frozen=True, slots=True, eq=False)
class ClosestPoints(Value):
    """Closest points of a surface.

    Attributes:
        point: (N, 3) closest points [m], object frame.
        face: (N,) int32 face on which each lies.
        weights: (N, 3) barycentric coordinates there; exactly zero for the corners that do not count.
        distance: (N,) unsigned distance [m].
    """

    point: Annotated[Floats, "N 3"]
    face: Annotated[NDArray[np.int32], "N"]
    weights: Annotated[Floats, "N 3"]
    distance: Annotated[Floats, "N"]


class NearestSurface:
    """The service for one mesh: built once, asked often.

    Args:
        mesh: the surface, object frame.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        self.mesh = mesh
        self._triangles: Floats = mesh.vertices[mesh.faces]
        self._normals = face_normals(mesh)
        pieces, self._owner = _pieces(self._triangles)
        centres, self._radius = _centre_and_radius(pieces)
        self._largest_radius = float(self._radius.max())
        self._rounding = 1e-12 * float(np.abs(mesh.vertices).max())
        self._tree = kdtree.build(centres)
        self._blocks = FaceBlocks(pieces)
        self._corner_normals: Floats | None = None
        self._edge_normals: Floats | None = None
        self._smooth: Floats | None = None

    def closest(self, points: Floats) -> ClosestPoints:
        """The closest point of the surface to each point.

        Args:
            points: (N, 3) [m], object frame, finite.
        """
        face = np.empty(len(points), dtype=np.int32)
        for start in range(0, len(points), _CHUNK):
            part = slice(start, start + _CHUNK)
            face[part] = self._closest_face(points[part])
        weights = _foot_weights(points, self._triangles[face])
        foot = np.einsum("nc,ncj->nj", weights, self._triangles[face])
        return ClosestPoints(foot, face, weights, np.linalg.norm(points - foot, axis=1))

    def signed(self, points: Floats, closest: ClosestPoints) -> Floats:
        """Signed distances: positive outside, negative inside.

        Args:
            points: (N, 3) [m], object frame.
            closest: what `closest` gave for them.

        Returns:
            (N,) [m].
        """
        side = np.einsum("nj,nj->n", points - closest.point, self._pseudonormals(closest))
        return np.where(side < 0, -closest.distance, closest.distance)

    def normals(self, closest: ClosestPoints) -> Floats:
        """(N, 3) unit normals at closest points, interpolated over the face except across creases of 30 degrees.

        Flat facets would resist a rotation that the round surface they stand for does not resist.
        """
        if self._smooth is None:
            self._smooth = self._round_normals()
        return _unit(np.einsum("nc,ncj->nj", closest.weights, self._smooth[closest.face]))

    def _round_normals(self) -> Floats:
        """(F, 3, 3) unit normals of the corners of faces; a crease at a vertex parts its faces into sides."""
        corner, _ = self._adjacent_normals()
        faces = self.mesh.faces
        smooth = corner[faces]
        sharp_face, sharp_corner = np.nonzero(np.einsum("fcj,fj->fc", smooth, self._normals) < _CREASE)
        # At a crease, only the faces at the vertex that look about the same way as this one are averaged.
        order = np.argsort(faces.ravel(), kind="stable")
        start = np.searchsorted(faces.ravel()[order], np.arange(len(corner) + 1))
        vertex = faces[sharp_face, sharp_corner]
        count = start[vertex + 1] - start[vertex]
        row = np.repeat(np.arange(len(vertex)), count)
        place = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
        other = self._normals[order[start[vertex][row] + place] // 3]
        own = self._normals[sharp_face][row]
        other = np.where(np.einsum("nj,nj->n", own, other)[:, None] >= _CREASE, other, 0.0)
        total = np.zeros((len(vertex), 3))
        np.add.at(total, row, other)
        smooth[sharp_face, sharp_corner] = _unit(total)
        return np.asarray(smooth, dtype=np.float64)

    def _closest_face(self, points: Floats) -> NDArray[np.int32]:
        """(N,) the face that holds the closest point; the certificate of the module docstring."""
        result = np.zeros(len(points), dtype=np.int32)
        found = np.full(len(points), np.inf)  # as long as too few pieces are near
        is_certain = np.zeros(len(points), dtype=np.bool_)
        asked = np.arange(len(points))
        for count in _CANDIDATES:
            is_certain[asked] = self._try(points, asked, min(count, len(self._owner)), result, found)
            asked = np.flatnonzero(~is_certain & (found <= self._largest_radius))
        open_points = np.flatnonzero(~is_certain)
        rounding = self._rounding + 1e-12 * float(np.abs(points).max(initial=0.0))
        for row, piece in self._blocks.pairs(points[open_points], found[open_points], rounding):
            face = self._owner[piece]
            squared = self._squared_distance(points[open_points[row]], face)
            order = np.lexsort((squared, row))
            first = order[np.concatenate([[True], row[1:] != row[:-1]])]  # `row` ascends, so the order keeps its runs
            result[open_points[row[first]]] = face[first]
        return result

    def _try(
        self, points: Floats, chosen: Indices, count: int, result: NDArray[np.int32], found: Floats
    ) -> NDArray[np.bool_]:
        """Take the best of `count` near pieces into `result` and its distance into `found`; whether it is certain."""
        bound = _NEAR * self._largest_radius  # beyond it the tree gives infinity
        answer = self._tree.query(points[chosen], count, distance_upper_bound=bound, workers=2)
        distance, piece = (np.reshape(values, (len(chosen), count)) for values in answer)
        is_near = np.isfinite(distance[:, -1])
        certain = np.zeros(len(chosen), dtype=np.bool_)
        chosen, distance, piece = chosen[is_near], distance[is_near], piece[is_near]
        query, face = points[chosen], self._owner[piece]
        first = self._squared_distance(query, face[:, 0])
        reach = np.sqrt(first) + self._rounding
        row, column = np.nonzero(distance[:, 1:] - self._radius[piece[:, 1:]] <= reach[:, None])
        squared = np.full(face.shape, np.inf)
        squared[:, 0] = first
        squared[row, column + 1] = self._squared_distance(query[row], face[row, column + 1])
        best = np.argmin(squared, axis=1)
        result[chosen] = face[np.arange(len(best)), best]
        found[chosen] = np.sqrt(squared.min(axis=1))
        certain[is_near] = distance[:, -1] - self._largest_radius > found[chosen] + self._rounding
        return certain

    def _squared_distance(self, points: Floats, face: NDArray[np.int32]) -> Floats:
        """(N,) squared distance [m^2] of each point to one face; only these triangles are touched."""
        return squared_distance(points, self._triangles[face], np.arange(len(face)))

    def _pseudonormals(self, closest: ClosestPoints) -> Floats:
        """(N, 3) normals of the feature (face, edge, corner) on which each closest point lies; not of unit length."""
        corner, edge = self._adjacent_normals()
        on = closest.weights > 0
        n_on = on.sum(axis=1)
        normals = self._normals[closest.face].copy()
        on_edge = n_on == 2
        normals[on_edge] = edge[closest.face[on_edge], np.argmin(on[on_edge], axis=1)]
        on_corner = n_on == 1
        vertex = self.mesh.faces[closest.face[on_corner], np.argmax(on[on_corner], axis=1)]
        normals[on_corner] = corner[vertex]
        return normals

    def _adjacent_normals(self) -> tuple[Floats, Floats]:
        """Angle-weighted unit normals of the vertices (V, 3), and normals of the edges (F, 3, 3) by opposite corner."""
        if self._corner_normals is None or self._edge_normals is None:
            faces, triangles = self.mesh.faces, self._triangles
            corner = np.zeros_like(self.mesh.vertices)
            for i in range(3):
                out = _unit(triangles[:, (i + 1) % 3] - triangles[:, i])
                back = _unit(triangles[:, (i + 2) % 3] - triangles[:, i])
                angle = np.arccos(np.clip(np.einsum("fj,fj->f", out, back), -1, 1))
                for axis in range(3):
                    corner[:, axis] += np.bincount(faces[:, i], angle * self._normals[:, axis], minlength=len(corner))
            opposite = np.stack([faces[:, [1, 2]], faces[:, [2, 0]], faces[:, [0, 1]]], axis=1).astype(np.int64)
            opposite.sort(axis=2)
            key = opposite[:, :, 0] * len(corner) + opposite[:, :, 1]
            _, edge = np.unique(key.ravel(), return_inverse=True)
            total = np.stack(
                [np.bincount(edge.ravel(), np.repeat(self._normals[:, axis], 3)) for axis in range(3)], axis=1
            )
            self._corner_normals = _unit(corner)
            self._edge_normals = np.asarray(total[edge].reshape(-1, 3, 3), dtype=np.float64)
        return self._corner_normals, self._edge_normals


def _unit(vectors: Floats) -> Floats:
    """Vectors of length one along the last axis; a zero vector stays zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    unit: Floats = np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)
    return unit


def _foot_weights(points: Floats, triangles: Floats) -> Floats:
    """Barycentric coordinates of the closest point of one triangle each.

    The foot of the perpendicular where it lies inside, else the nearest of the closest points of the three edges (which
    is also right for a triangle without area).

    Args:
        points: (N, 3) [m].
        triangles: (N, 3, 3) corners [m].

    Returns:
        (N, 3), not negative, sum 1.
    """
    first, second = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    offset = points - triangles[:, 0]
    normal = np.cross(first, second)
    squared = np.einsum("nj,nj->n", normal, normal)
    safe = np.where(squared > 0, squared, 1.0)
    inner = np.empty((len(points), 3))
    inner[:, 1] = np.einsum("nj,nj->n", np.cross(offset, second), normal) / safe
    inner[:, 2] = np.einsum("nj,nj->n", np.cross(first, offset), normal) / safe
    inner[:, 0] = 1 - inner[:, 1] - inner[:, 2]
    is_inside = (squared > 0) & (inner > 0).all(axis=1)
    best = np.full(len(points), np.inf)
    weights = np.zeros((len(points), 3))
    for i in range(3):
        j = (i + 1) % 3
        along = triangles[:, j] - triangles[:, i]
        length = np.einsum("nj,nj->n", along, along)
        reached = np.einsum("nj,nj->n", points - triangles[:, i], along)
        step = np.clip(np.divide(reached, length, out=np.zeros_like(length), where=length > 0), 0, 1)
        distance = ((points - triangles[:, i] - step[:, None] * along) ** 2).sum(axis=1)
        nearer = distance < best
        best[nearer] = distance[nearer]
        weights[nearer] = 0.0
        weights[nearer, i] = 1 - step[nearer]
        weights[nearer, j] = step[nearer]
    weights[is_inside] = inner[is_inside]
    return weights


def _pieces(triangles: Floats) -> tuple[Floats, NDArray[np.int32]]:
    """Cut triangles at the middle of their longest edge until none reaches farther than a common radius.

    Returns:
        (P, 3, 3) corners [m] and (P,) the triangle that each is a piece of.
    """
    owner = np.arange(len(triangles), dtype=np.int32)
    radius = _centre_and_radius(triangles)[1]
    area = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1).sum()
    # A piece of radius r cut from a large triangle has about the area r^2; long thin faces give length / r pieces.
    limit = max(float(np.quantile(radius, 0.9)), float(np.sqrt(area / 2 / _PIECES)), radius.sum() / (4 * _PIECES))
    limit = min(limit, float(radius.max()))
    pieces, owners = [], []
    while True:
        small = radius <= limit * (1 + 1e-9)
        pieces.append(triangles[small])
        owners.append(owner[small])
        if small.all():
            return np.concatenate(pieces), np.concatenate(owners)
        triangles, owner = triangles[~small], owner[~small]
        edges = np.linalg.norm(np.roll(triangles, -1, axis=1) - triangles, axis=2)
        start = np.argmax(edges, axis=1)
        rows = np.arange(len(triangles))
        a, b, c = (triangles[rows, (start + i) % 3] for i in range(3))
        middle = (a + b) / 2
        triangles = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
        owner = np.concatenate([owner, owner])
        radius = _centre_and_radius(triangles)[1]


def _centre_and_radius(triangles: Floats) -> tuple[Floats, Floats]:
    """(N, 3) centres of gravity, and (N,) the distance from there to the farthest corner [m]."""
    centre = triangles.mean(axis=1)
    return centre, np.linalg.norm(triangles - centre[:, None, :], axis=2).max(axis=1)
