"""Closest points of a triangle mesh, exact up to rounding, and on which side of the surface a point lies.

libigl's tree of boxes finds them. Which of two faces is named where both are equally near (beside an edge) is its
choice, the same in every run and on any number of threads.

The side follows Baerentzen and Aanaes, "Signed distance computation using the angle weighted pseudonormal", IEEE TVCG
11 (2005), doi:10.1109/TVCG.2005.49: the normal of the face, edge or corner on which the closest point lies decides,
which is right on closed meshes also where the closest point is on an edge. Any one frame, metres.
"""

from dataclasses import dataclass
from itertools import product
from typing import Annotated

import numpy as np

from planner.errors import PlannerError
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats, Ints32, Value

_CREASE_DEG = 30.0  # across edges that turn by more, normals are not interpolated
_DIRECTIONS = np.array([np.divide(d, np.linalg.norm(d)) for d in product((-1, 0, 1), repeat=3) if any(d)])  # 26


@dataclass(frozen=True, slots=True, eq=False)
class ClosestPoints(Value):
    """Closest points of a surface.

    Attributes:
        point: (N, 3) closest points [m].
        face: (N,) int32 face on which each lies.
        distance: (N,) unsigned distance [m].
    """

    point: Annotated[Floats, "N 3"]
    face: Annotated[Ints32, "N"]
    distance: Annotated[Floats, "N"]


class NearestSurface:
    """The service for one mesh: built once, asked often.

    Args:
        mesh: the surface; its faces without area are left out, because they have no side.

    Raises:
        PlannerError: if no face has an area.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        import igl  # takes 0.13 s, which commands that measure no distance need not wait for

        self.mesh = mesh
        self._igl, self._tree = igl, igl.AABB()
        self._rows = np.flatnonzero(mesh.areas > 0)
        if not len(self._rows):
            raise PlannerError("no face of the mesh has an area; a surface needs at least one")
        self._arrays = (mesh.vertices, mesh.faces[self._rows].astype(np.int64))  # libigl wants them in every call
        self._tree.init(*self._arrays)
        self._smooth: Floats | None = None

    def closest(self, points: Floats) -> ClosestPoints:
        """The closest point of the surface to each point.

        Args:
            points: (N, 3) [m], in the mesh's frame.

        Raises:
            PlannerError: if a point is not finite.
        """
        squared, row, point = self._tree.squared_distance(*self._arrays, _finite(points))
        return ClosestPoints(point, self._rows[row], np.sqrt(squared))

    def signed(self, points: Floats) -> Floats:
        """Signed distances: positive outside, negative inside. Ask for many points at once: a call works out normals.

        Args:
            points: (N, 3) [m], in the mesh's frame.

        Returns:
            (N,) [m].

        Raises:
            PlannerError: if a point is not finite.
        """
        by_pseudonormal = self._igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL
        return np.asarray(self._igl.signed_distance(_finite(points), *self._arrays, sign_type=by_pseudonormal)[0])

    def normals(self, closest: ClosestPoints) -> Floats:
        """(N, 3) unit normals at closest points, interpolated over the face except across creases of 30 degrees.

        Flat facets would resist a rotation that the round surface they stand for does not resist.
        """
        if self._smooth is None:
            self._smooth = self._igl.per_corner_normals(*self._arrays, _CREASE_DEG).reshape(-1, 3, 3)
        corners = self.mesh.vertices[self.mesh.faces[closest.face]] - closest.point[:, None, :]
        # The areas opposite to the corners are barycentric coordinates, and stay sane on needles.
        weights = np.linalg.norm(np.cross(corners[:, [1, 2, 0]], corners[:, [2, 0, 1]]), axis=2)
        normals = np.einsum("nc,ncj->nj", weights, self._smooth[np.searchsorted(self._rows, closest.face)])
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        return np.asarray(np.divide(normals, length, out=np.zeros_like(normals), where=length > 0))


def closest_face(points: Floats, normals: Floats, mesh: TriangleMesh) -> Ints32:
    """The face nearest to each point; where that looks away, the nearest that looks the same way and is about as near.

    The normal keeps the two sides of a thin wall apart. The other face is looked for in groups of faces that have about
    one normal, and taken if it is no more than the size of a face farther.

    Args:
        points: (N, 3) [m], in the mesh's frame.
        normals: (N, 3) unit normals.
        mesh: whose faces; one without area is never named.

    Returns:
        (N,) int32 face indices.

    Raises:
        PlannerError: if no face has an area, or a point is not finite.
    """
    facing = mesh.normals
    closest = NearestSurface(mesh).closest(points)
    face = closest.face.copy()
    away = np.flatnonzero(np.einsum("nj,nj->n", normals, facing[face]) <= 0)
    if not len(away):
        return face
    nearest = closest.distance[away] + np.sqrt(mesh.areas.mean())
    group = np.where(facing.any(axis=1), np.argmax(facing @ _DIRECTIONS.T, axis=1), -1)
    for rows in (np.flatnonzero(group == direction) for direction in np.unique(group[group >= 0])):
        found = NearestSurface(TriangleMesh(mesh.vertices, mesh.faces[rows])).closest(points[away])
        same_way = np.einsum("nj,nj->n", normals[away], facing[rows[found.face]]) > 0
        better = same_way & (found.distance < nearest)
        nearest[better], face[away[better]] = found.distance[better], rows[found.face[better]]
    return face


def _finite(points: Floats) -> Floats:
    """The points; libigl would name a face that does not exist for one that is not finite."""
    if not np.isfinite(points).all():
        raise PlannerError("points contains infinity or NaN; every coordinate must be finite")
    return points
