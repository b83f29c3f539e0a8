"""Embree as the planner's `RayCaster`: first hits and occlusion on one fixed set of triangles.

Everything else casts rays through the protocol `planner.ports.RayCaster`; another engine only needs another class here.

Embree calculates in float32. The triangles are therefore moved to the middle of their own bounding box (a part 10 m
from the origin loses nothing), rays start and end in float64, and the distance to a hit face is computed again in
float64 from its plane. Errors of Embree were measured with 10^6 random rays on each of three spheres, of 9 mm, 0.2 m
and 5 m: at most 1e-7 of the ray's scale (distance plus the half diagonal of the triangles) across the ray, so 1e-7 /
cos(grazing angle) along it. They decide which of two faces is hit next to an edge, and which object blocks a ray.

Limitation: a ray exactly through a vertex passes between the faces in up to 0.5 % of cases (through an edge, never: 0
of 800,000). Points of a scan and samples of a surface lie on vertices with probability zero.

embreex's bindings check no bounds and read foreign memory for a wrong shape or index: everything is validated here.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.errors import CellError
from planner.geometry.mesh import face_cross_products
from planner.ports import Hits
from planner.threads import run_in_threads
from planner.values import Floats, Ints

HAIR = 2e-6
"""Length by which a ray ends before its target, as a share of its scale (length plus half diagonal of the triangles).

1 um for a part of 0.3 m at 0.3 m. Rays to points of a convex surface under up to 75 degrees are blocked by their own
surface in 65 % of cases with 0, in 0.3 % with 2.5e-7 and in none of 10^7 with 1e-6 or more; 2e-6 keeps a factor of two.
At a larger grazing angle the target also has to be lifted off its surface, see `planner.viewpoints.lines_of_sight`.
"""

_SPLIT_ABOVE = 20_000  # rays; about 3 ms of tracing
_MAX_CORRECTION = 1e-4  # of a ray's scale; Embree's distance is off by 1e-7 / cos(grazing angle): up to 89.9 degrees
_OCCLUDED = 0  # result of embreex's OCCLUDED query for a blocked ray; -1 is a free one


class EmbreeRayCaster:
    """Ray caster on one fixed set of triangles, by Embree 4 in its robust mode.

    More than 20,000 rays are split into one part per core (embreex releases the GIL). Each ray is traced on its own, so
    the result does not depend on the number of cores.

    Args:
        vertices: (V, 3) [m], any frame; rays are in the same frame.
        faces: (F, 3) indices of vertices, F > 0. A face without area is never hit; of two equal faces either one is.

    Raises:
        CellError: if the triangles are not finite, not indexed correctly or none, or if embreex >= 4.4 is missing.
    """

    def __init__(self, vertices: Floats, faces: NDArray[np.integer]) -> None:
        vertices = np.asarray(vertices, dtype=np.float64)
        indices = np.asarray(faces)
        if vertices.ndim != 2 or vertices.shape[1] != 3:
            raise CellError(f"the vertices for ray casting have shape {vertices.shape}; it must be (any, 3)")
        if indices.ndim != 2 or indices.shape[1] != 3 or not len(indices) or indices.dtype.kind not in "iu":
            raise CellError(
                f"the faces for ray casting have shape {indices.shape} and type {indices.dtype}; "
                "they must be (1 or more, 3) integers"
            )
        if indices.min() < 0 or indices.max() >= len(vertices):
            raise CellError(
                f"the faces for ray casting refer to vertices {indices.min()} to {indices.max()}; "
                f"valid are 0 to {len(vertices) - 1}"
            )
        is_used = np.zeros(len(vertices), dtype=np.bool_)
        is_used[indices] = True
        used = vertices[is_used]
        if not np.isfinite(used).all():
            raise CellError("the triangles for ray casting contain NaN or infinity; every coordinate must be finite")
        low, high = used.min(axis=0), used.max(axis=0)
        self._middle: Floats = (low + high) / 2
        self._half_diagonal = float(np.linalg.norm(high - low)) / 2
        centred = np.where(np.isfinite(vertices), vertices - self._middle, 0.0)  # an unused vertex may be NaN
        corner = np.take(centred, indices[:, 0], axis=0)
        self._normals: Floats = face_cross_products(centred, indices)
        self._offsets: Floats = np.einsum("ij,ij->i", self._normals, corner)
        self._scene = _build(centred.astype(np.float32), indices.astype(np.int32))

    def first_hit(self, origins: Floats, directions: Floats) -> Hits:
        """Find the first intersection of each ray, on either side of a triangle; see `RayCaster.first_hit`.

        Raises:
            CellError: if the arrays differ in shape, are not finite, or a direction is not a unit vector.
        """
        origins, directions = _same_shape("origins", origins, "directions", directions)
        face = np.empty(len(origins), dtype=np.int32)
        distance = np.empty(len(origins))

        def trace(part: slice) -> None:
            start, along = self._to_float32(origins[part]), _float32("directions", directions[part])
            if (np.abs(np.einsum("ij,ij->i", along, along) - 1) > 1e-4).any():
                raise CellError("a ray's direction is not a unit vector; distances would not be in metres")
            hits = self._scene.run(start, along, output=True)
            face[part] = hits["primID"]
            distance[part] = self._refined(origins[part], directions[part], hits["primID"], hits["tfar"])

        run_in_threads(trace, len(origins), _SPLIT_ABOVE)
        return Hits(face, distance)

    def blocked(self, origins: Floats, targets: Floats) -> NDArray[np.bool_]:
        """Return whether any triangle is between origin and target; see `RayCaster.blocked`.

        The segment ends `HAIR` x (its length + the half diagonal of the triangles) before the target. A shorter segment
        is free.

        Raises:
            CellError: if the arrays differ in shape or are not finite.
        """
        origins, targets = _same_shape("origins", origins, "targets", targets)
        result = np.empty(len(origins), dtype=np.bool_)

        def trace(part: slice) -> None:
            along = targets[part] - origins[part]
            length = np.sqrt(np.einsum("ij,ij->i", along, along))
            along /= np.where(length > 0, length, 1.0)[:, None]
            reach = length - HAIR * (length + self._half_diagonal)
            start, direction = self._to_float32(origins[part]), _float32("targets", along)
            end = np.maximum(reach, 0.0).astype(np.float32)
            result[part] = (self._scene.run(start, direction, dists=end, query="OCCLUDED") == _OCCLUDED) & (reach > 0)

        run_in_threads(trace, len(origins), _SPLIT_ABOVE)
        return result

    def blocked_along(
        self, points: Floats, origin: Ints, directions: NDArray[np.float32], length: float
    ) -> NDArray[np.bool_]:
        """Return whether any triangle is near along a direction; see `DirectionCaster.blocked_along`.

        Rays begin `HAIR` x (length + the half diagonal of the triangles) after the origin.
        """
        result = np.empty(len(origin), dtype=np.bool_)
        gap = np.float32(HAIR * (length + self._half_diagonal))
        starts = self._to_float32(points)

        def trace(part: slice) -> None:
            along = np.ascontiguousarray(directions[part], dtype=np.float32)
            start = gap * along
            start += np.take(starts, origin[part], axis=0)
            end = np.full(len(start), length, dtype=np.float32)
            result[part] = self._scene.run(start, along, dists=end, query="OCCLUDED") == _OCCLUDED

        run_in_threads(trace, len(origin), _SPLIT_ABOVE)
        return result

    def _refined(
        self, origins: Floats, directions: Floats, face: NDArray[np.int32], rough: NDArray[np.float32]
    ) -> Floats:
        """Compute the distances (N,) to the planes of the hit triangles in float64; inf for no hit [m].

        Embree's own distance is kept if the plane's differs by more than `_MAX_CORRECTION` of the scale: the ray is
        almost in the plane, or the triangle is degenerate.
        """
        distance = np.full(len(face), np.inf)
        hit = np.flatnonzero(face >= 0)
        if len(hit) < len(face):
            face, rough, origins, directions = face[hit], rough[hit], origins[hit], directions[hit]
        rough_distance = rough.astype(np.float64)
        normal = np.take(self._normals, face, axis=0)
        above = np.take(self._offsets, face) - np.einsum("ij,ij->i", origins - self._middle, normal)
        with np.errstate(divide="ignore", invalid="ignore"):
            exact = above / np.einsum("ij,ij->i", directions, normal)
        sure = np.abs(exact - rough_distance) <= _MAX_CORRECTION * (rough_distance + self._half_diagonal)
        distance[hit] = np.where(sure, exact, rough_distance)
        return distance

    def _to_float32(self, points: Floats) -> NDArray[np.float32]:
        return _float32("origins", points - self._middle)


def _build(vertices: NDArray[np.float32], faces: NDArray[np.int32]) -> Any:
    """Build an Embree scene. The first query commits it; afterwards threads may share it."""
    try:
        import embreex
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene
    except ImportError as error:
        raise CellError(
            f"embreex cannot be imported ({error}); rays are cast with embreex >= 4.4, install it with "
            "'pip install \"embreex>=4.4,<5\"'"
        ) from error
    version = tuple(int(part) for part in embreex.__version__.split(".")[:2])
    if version < (4, 4):  # older ones wrap Embree 2, return other values and hold the GIL
        raise CellError(
            f"embreex {embreex.__version__} is installed; rays are cast with embreex >= 4.4, install it with "
            "'pip install \"embreex>=4.4,<5\"'"
        )
    scene = EmbreeScene(robust=True)
    TriangleMesh(scene, np.ascontiguousarray(vertices), np.ascontiguousarray(faces))
    scene.run(np.zeros((1, 3), np.float32), np.array([[0, 0, 1]], np.float32))
    return scene


def _same_shape(name: str, first: Floats, other_name: str, second: Floats) -> tuple[Floats, Floats]:
    first, second = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    if first.ndim != 2 or first.shape[1] != 3 or first.shape != second.shape:
        raise CellError(f"{name} have shape {first.shape} and {other_name} {second.shape}; both must be (N, 3)")
    return first, second


def _float32(name: str, values: Floats) -> NDArray[np.float32]:
    """Convert to contiguous float32; refuse infinite and NaN values, which Embree silently treats as a miss."""
    with np.errstate(over="ignore"):
        cast: NDArray[np.float32] = np.ascontiguousarray(values, dtype=np.float32)
    if not np.isfinite(cast).all():
        raise CellError(f"{name} of rays contain NaN or infinity; every coordinate must be finite")
    return cast
