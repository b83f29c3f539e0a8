"""Polygon meshes, and their triangulation.

Convex polygons become fans; others are cut by the earcut algorithm in the plane of their normal. A fan of a concave
polygon would cover its notches.
"""

from dataclasses import dataclass

import numpy as np

from planner.values import Bools, Floats, Ints

_FLAT = 1e-9
"""Largest negative area of a triangle of a fan, as a share of its polygon's square perimeter: rounding of a straight
corner."""

_CROSSING = 1e-6
"""Largest difference between the area of a polygon and of its triangles, as a share of its square perimeter."""


class PolygonError(ValueError):
    """A polygon that bounds no surface; the message follows the name of the file."""


@dataclass(frozen=True, slots=True, eq=False)
class PolygonMesh:
    """A mesh of polygons.

    Attributes:
        vertices: (V, 3).
        corners: (C,) vertex indices of all polygons, one polygon after the other.
        counts: (P,) number of corners of each polygon.
        colours: (P, 3) red, green and blue of each polygon, 0 to 255; None without colours.
    """

    vertices: Floats
    corners: Ints
    counts: Ints
    colours: Floats | None = None

    def means(self, values: Floats) -> Floats:
        """Return the mean (P, K) of values (V, K) of the vertices over the corners of each polygon."""
        starts = np.cumsum(self.counts) - self.counts
        sums: Floats = np.add.reduceat(values[self.corners], starts, axis=0) if len(starts) else np.zeros((0, 3))
        return sums / self.counts[:, None]


def triangulate(mesh: PolygonMesh) -> tuple[Ints, Ints]:
    """Return triangles (F, 3) of the polygons in their order, and the index (F,) of the polygon of each.

    Raises:
        PolygonError: if a polygon has fewer than three corners, a missing vertex, or crosses itself.
    """
    if len(mesh.counts) and mesh.counts.min() < 3:
        number = int(np.argmin(mesh.counts))
        raise PolygonError(f"has a face with {mesh.counts[number]} corners (face {number + 1}); a face needs three")
    outside = (mesh.corners < 0) | (mesh.corners >= len(mesh.vertices))
    if outside.any():
        corner = int(np.argmax(outside))
        number = int(np.searchsorted(np.cumsum(mesh.counts), corner, side="right"))
        raise PolygonError(
            f"has a face (face {number + 1}) that refers to vertex {int(mesh.corners[corner])}, counted from 0, but "
            f"there are {len(mesh.vertices)} vertices; export the mesh again"
        )
    starts = np.cumsum(mesh.counts) - mesh.counts
    triangles: list[Ints] = [np.zeros((0, 3), np.int64)]
    owners: list[Ints] = [np.zeros(0, np.int64)]
    for count in np.unique(mesh.counts):
        polygons = np.flatnonzero(mesh.counts == count)
        corners = mesh.corners[starts[polygons][:, None] + np.arange(count)]
        is_fan = np.ones(len(polygons), np.bool_) if count == 3 else _is_convex(mesh.vertices[corners], polygons)
        fans = np.stack([np.broadcast_to(corners[:, :1], (len(corners), count - 2)), corners[:, 1:-1], corners[:, 2:]])
        triangles.append(fans[:, is_fan].transpose(1, 2, 0).reshape(-1, 3))
        owners.append(np.repeat(polygons[is_fan], count - 2))
        for polygon, own in zip(polygons[~is_fan], corners[~is_fan], strict=True):
            cut = _cut(mesh.vertices[own], int(polygon))
            triangles.append(own[cut])
            owners.append(np.full(len(cut), polygon))
    owner = np.concatenate(owners)
    order = np.argsort(owner, kind="stable")
    return np.concatenate(triangles)[order], owner[order]


def _is_convex(points: Floats, polygons: Ints) -> Bools:
    """Return which polygons (K, n, 3) are convex or without area, so that a fan covers exactly their surface."""
    edges = np.roll(points, -1, axis=1) - points
    perimeter2 = np.linalg.norm(edges, axis=2).sum(axis=1) ** 2
    spokes = points - points[:, :1]
    fan = np.cross(spokes[:, 1:-1], spokes[:, 2:])
    normal = fan.sum(axis=1)
    length = np.linalg.norm(normal, axis=1)
    crossing = (length <= _CROSSING * perimeter2) & (np.linalg.norm(fan, axis=2).sum(axis=1) > 0.01 * perimeter2)
    if crossing.any():
        raise _crossing(int(polygons[np.argmax(crossing)]))
    unit = normal / np.maximum(length, np.finfo(np.float64).tiny)[:, None]
    turns = np.cross(np.roll(edges, 1, axis=1), edges)
    least = np.minimum(np.einsum("kij,kj->ki", fan, unit).min(axis=1), np.einsum("kij,kj->ki", turns, unit).min(axis=1))
    return np.asarray((least >= -_FLAT * perimeter2) | (length <= _FLAT * perimeter2))


def _cut(points: Floats, polygon: int) -> Ints:
    """Return the triangles (n - 2, 3) of a concave polygon (n, 3), with its winding."""
    import mapbox_earcut  # only for concave polygons

    spokes = points - points[0]
    normal = np.cross(spokes[1:-1], spokes[2:]).sum(axis=0)
    axis = int(np.argmax(np.abs(normal)))
    flat = np.ascontiguousarray(np.delete(spokes, axis, axis=1))
    cut = mapbox_earcut.triangulate_float64(flat, np.array([len(flat)], np.uint32)).reshape(-1, 3).astype(np.int64)
    sides = flat[cut[:, 1:]] - flat[cut[:, :1]]
    areas = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]
    sign = (1.0, -1.0, 1.0)[axis] * np.sign(normal[axis])
    cut[areas * sign < 0] = cut[areas * sign < 0][:, ::-1]
    perimeter = np.linalg.norm(np.roll(flat, -1, axis=0) - flat, axis=1).sum()
    if abs(np.abs(areas).sum() - abs(normal[axis])) > _CROSSING * perimeter**2:
        raise _crossing(polygon)
    return _with_straight_corners(cut, len(points))


def _with_straight_corners(cut: Ints, count: int) -> Ints:
    """Split triangles at the corners that earcut omits because their edges are collinear: neighbours end there."""
    triangles = [tuple(int(corner) for corner in triangle) for triangle in cut]
    used = set(cut.ravel().tolist())
    for corner in sorted(set(range(count)) - used):
        before = max((other for other in used if other < corner), default=max(used, default=0))
        after = min((other for other in used if other > corner), default=min(used, default=0))
        for k, (a, b, c) in enumerate(triangles):
            for one, two, three in ((a, b, c), (b, c, a), (c, a, b)):
                if (one, two) == (before, after):
                    triangles[k : k + 1] = [(one, corner, three), (corner, two, three)]
                    used.add(corner)
                    break
            if corner in used:
                break
    return np.array(triangles, np.int64).reshape(-1, 3)


def _crossing(polygon: int) -> PolygonError:
    return PolygonError(f"has a face that crosses itself (face {polygon + 1}); split it, or export triangles")
