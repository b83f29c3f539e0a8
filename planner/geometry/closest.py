"""Closest points of a triangle mesh, exact up to rounding, and the side of the surface on which a point lies.

The search uses the bounding-box tree of libigl. If two faces are equally near (at an edge), libigl chooses one of them,
the same in every run and for any number of threads.

The side follows Baerentzen and Aanaes, "Signed distance computation using the angle weighted pseudonormal", IEEE TVCG
11 (2005), doi:10.1109/TVCG.2005.49: the normal of the face, edge or corner at the closest point decides. This is right
on closed meshes also where the closest point is on an edge. One frame for all arguments, metres.
"""

from dataclasses import dataclass
from itertools import product
from typing import Annotated

import numpy as np

from planner.errors import PlannerError
from planner.geometry.mesh import TriangleMesh, cross_rows
from planner.values import Floats, Ints32, Value

_CREASE_DEG = 30.0  # normals are not interpolated across edges with a larger dihedral angle
_DIRECTIONS = np.array([np.divide(d, np.linalg.norm(d)) for d in product((-1, 0, 1), repeat=3) if any(d)])  # 26


@dataclass(frozen=True, slots=True, eq=False)
class ClosestPoints(Value):
    """Closest points of a surface.

    Attributes:
        point: (N, 3) closest points [m].
        face: (N,) face that contains each.
        distance: (N,) unsigned distance [m].
    """

    point: Annotated[Floats, "N 3"]
    face: Annotated[Ints32, "N"]
    distance: Annotated[Floats, "N"]


class ClosestPointQuery:
    """Closest-point and signed-distance queries of one mesh, with a tree that is built once.

    Faces without area have no side and are left out; a mesh that has no other face is refused.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        import igl  # takes 0.13 s; commands that measure no distance do not pay for it

        self.mesh = mesh
        self._igl, self._tree = igl, igl.AABB()
        self._faces = np.flatnonzero(mesh.areas > 0)
        if not len(self._faces):
            raise PlannerError("no face of the mesh has an area; a surface needs at least one")
        self._arrays = (mesh.vertices, mesh.faces[self._faces].astype(np.int64))  # libigl takes them in every call
        self._tree.init(*self._arrays)
        self._smooth: Floats | None = None

    def closest(self, points: Floats) -> ClosestPoints:
        """Return the closest point of the surface to each of (N, 3) points [m]."""
        squared, row, point = self._tree.squared_distance(*self._arrays, _require_finite(points))
        return ClosestPoints(point, self._faces[row], np.sqrt(squared))

    def signed_distance(self, points: Floats) -> Floats:
        """Return (N,) distances [m] of (N, 3) points, negative inside. Each call computes normals: pass many points."""
        by_pseudonormal = self._igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL
        points = _require_finite(points)
        return np.asarray(self._igl.signed_distance(points, *self._arrays, sign_type=by_pseudonormal)[0])

    def normals(self, closest: ClosestPoints) -> Floats:
        """Return (N, 3) unit normals at closest points, interpolated over each face but not across creases of 30 deg.

        Flat facets would resist a rotation that the approximated round surface does not resist.
        """
        if self._smooth is None:
            self._smooth = self._igl.per_corner_normals(*self._arrays, _CREASE_DEG).reshape(-1, 3, 3)
        corners = self.mesh.vertices[self.mesh.faces[closest.face]] - closest.point[:, None, :]
        # The areas opposite to the corners are barycentric coordinates; they stay well conditioned on needles.
        second, third = (corners[:, order].reshape(-1, 3) for order in ([1, 2, 0], [2, 0, 1]))
        weights = np.linalg.norm(cross_rows(second, third).reshape(corners.shape), axis=2)
        normals = np.einsum("nc,ncj->nj", weights, self._smooth[np.searchsorted(self._faces, closest.face)])
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        return np.asarray(np.divide(normals, length, out=np.zeros_like(normals), where=length > 0))


def closest_facing_faces(points: Floats, normals: Floats, mesh: TriangleMesh) -> Ints32:
    """Return (N,) the closest face to each point, with a normal on the same side as the point's normal if possible.

    The normal keeps the two sides of a thin wall apart. If the closest face has the opposite side, another one is
    searched in groups of faces with about the same normal. It is taken if it is farther by at most the size of a face.

    Args:
        points: (N, 3) [m].
        normals: (N, 3) unit normals.
        mesh: the mesh; a face without area is never returned.
    """
    facing = mesh.normals
    closest = ClosestPointQuery(mesh).closest(points)
    face = closest.face.copy()
    away = np.flatnonzero(np.einsum("nj,nj->n", normals, facing[face]) <= 0)
    if not len(away):
        return face
    nearest = closest.distance[away] + np.sqrt(mesh.areas.mean())
    group = np.where(facing.any(axis=1), np.argmax(facing @ _DIRECTIONS.T, axis=1), -1)
    for rows in (np.flatnonzero(group == direction) for direction in np.unique(group[group >= 0])):
        facing_closest = ClosestPointQuery(TriangleMesh(mesh.vertices, mesh.faces[rows])).closest(points[away])
        same_side = np.einsum("nj,nj->n", normals[away], facing[rows[facing_closest.face]]) > 0
        better = same_side & (facing_closest.distance < nearest)
        nearest[better], face[away[better]] = facing_closest.distance[better], rows[facing_closest.face[better]]
    return face


def _require_finite(points: Floats) -> Floats:
    """Refuse infinite coordinates: for them libigl returns a face that does not exist."""
    if not np.isfinite(points).all():
        raise PlannerError("points contains infinity or NaN; every coordinate must be finite")
    return points
