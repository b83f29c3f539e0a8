"""Polygon meshes, and their triangulation.

Convex polygons become fans; others are cut by the earcut algorithm in the plane of their normal. A fan of a concave
polygon would cover its notches, and one of a polygon with straight corners has triangles without area, without which
the surface is open along an edge.
"""

from dataclasses import dataclass

import numpy as np

from planner.values import Bools, Floats, Ints

MAX_COORDINATE = 1e9
"""Largest coordinate in the unit of the file: products of three lengths are finite, also in single precision."""

_FLAT = 1e-9
"""Largest negative area of a triangle of a fan, as a share of its polygon's square perimeter: rounding of a straight
corner."""

_STRAIGHT = 2e-7
"""Largest distance of a straight corner from its edge, as a share of the coordinates: rounding to single precision."""

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
        """Return the mean (P, K) of values (V, K) of the vertices over the corners of each of P > 0 valid polygons."""
        sums: Floats = np.add.reduceat(values[self.corners], np.cumsum(self.counts) - self.counts, axis=0)
        return sums / self.counts[:, None]


def distance_problem(vertices: Floats) -> str:
    """Return why vertices (V, 3) are too far away, as a sentence after the name of their file; "" if they are not."""
    if (largest := float(np.abs(vertices).max(initial=0.0))) <= MAX_COORDINATE:
        return ""
    return (
        f"has a coordinate of {largest:.3g}, and the limit is {MAX_COORDINATE:g} in the unit of the file; "
        "check scales and places in it, and export the mesh again"
    )


def triangulate(mesh: PolygonMesh) -> tuple[Ints, Ints]:
    """Return triangles (F, 3) of the polygons in their order, and the index (F,) of the polygon of each.

    Raises:
        PolygonError: if a polygon has fewer than three corners, a missing or too distant vertex, or crosses itself.
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
    infinite = ~np.isfinite(mesh.vertices[mesh.corners]).all(axis=1)
    if infinite.any():
        vertex = int(mesh.corners[np.argmax(infinite)])
        raise PolygonError(
            f"has coordinates that are not numbers (NaN or infinity), first at vertex {vertex + 1}; repair or export "
            "the mesh again"
        )
    if problem := distance_problem(mesh.vertices[mesh.corners]):
        raise PolygonError(problem)
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
        for polygon, polygon_corners in zip(polygons[~is_fan], corners[~is_fan], strict=True):
            cut = _cut(mesh.vertices[polygon_corners], int(polygon))
            triangles.append(polygon_corners[cut])
            owners.append(np.full(len(cut), polygon))
    owner = np.concatenate(owners)
    order = np.argsort(owner, kind="stable")
    return np.concatenate(triangles)[order], owner[order]


def _is_convex(points: Floats, polygons: Ints) -> Bools:
    """Return which polygons (K, n, 3) have no area, or are convex with a fan from the first corner without slivers."""
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
    least_fan, least_turn = (np.einsum("kij,kj->ki", each, unit).min(axis=1) for each in (fan, turns))
    is_convex = (least_fan > _FLAT * perimeter2) & (least_turn >= -_FLAT * perimeter2)
    return np.asarray(is_convex | (length <= _FLAT * perimeter2))


def _cut(points: Floats, polygon: int) -> Ints:
    """Return triangles of a polygon (n, 3) with its winding; every corner is a corner of them, none is a sliver."""
    import mapbox_earcut  # only for concave polygons and straight corners

    spokes = points - points[0]
    normal = np.cross(spokes[1:-1], spokes[2:]).sum(axis=0)
    axis = int(np.argmax(np.abs(normal)))
    flat = np.ascontiguousarray(np.delete(spokes, axis, axis=1))
    tolerance = _STRAIGHT * float(np.abs(points).max())
    turning = _turning_corners(flat, tolerance)
    ring = flat[turning]
    cut = mapbox_earcut.triangulate_float64(ring, np.array([len(ring)], np.uint32)).reshape(-1, 3).astype(np.int64)
    sides = ring[cut[:, 1:]] - ring[cut[:, :1]]
    areas = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]
    sign = (1.0, -1.0, 1.0)[axis] * np.sign(normal[axis])
    cut = cut[:, ::-1] if areas.sum() * sign < 0 else cut  # all have one winding
    perimeter = np.linalg.norm(np.roll(flat, -1, axis=0) - flat, axis=1).sum()
    if abs(np.abs(areas).sum() - abs(normal[axis])) > _CROSSING * perimeter**2:
        raise _crossing(polygon)
    is_repeated = (flat == np.roll(flat, 1, axis=0)).all(axis=1)
    return _flip_slivers(_with_corners(turning[cut], np.flatnonzero(~is_repeated)), flat, tolerance)


def _turning_corners(flat: Floats, tolerance: float) -> Ints:
    """Return the corners of a polygon (n, 2) at which its border turns, in order, without repeated ones."""
    n = len(flat)
    first = int(np.argmax(np.linalg.norm(flat - flat.mean(axis=0), axis=1)))  # on the convex hull, so it turns
    turning = [first]
    for k in range(first + 1, first + n):
        before, at, after = flat[turning[-1]], flat[k % n], flat[(k + 1) % n]
        along, chord = at - before, after - before
        length = float(np.hypot(*chord))
        is_straight = (
            abs(along[0] * chord[1] - along[1] * chord[0]) <= tolerance * length and 0 <= along @ chord <= length**2
        )
        if not is_straight and (at != before).any():
            turning.append(k % n)
    return np.array(turning)


def _with_corners(cut: Ints, corners: Ints) -> list[list[int]]:
    """Add the corners that no triangle has, as triangles without area between their neighbours on the border."""
    used = np.isin(corners, cut)
    ring = np.roll(corners, -int(np.argmax(used)))
    used = np.roll(used, -int(np.argmax(used)))
    triangles: list[list[int]] = cut.tolist()
    begin, before = int(ring[0]), int(ring[0])
    for corner, is_used in zip([*ring[1:].tolist(), int(ring[0])], [*used[1:].tolist(), True], strict=True):
        if before != begin:
            triangles.append([begin, before, corner])
        begin, before = (corner, corner) if is_used else (begin, corner)
    return triangles


def _flip_slivers(triangles: list[list[int]], flat: Floats, tolerance: float) -> Ints:
    """Exchange the longest edge of each triangle without area for the other diagonal with its neighbour.

    Neighbours of the polygon end at the middle corner of such a triangle, so it cannot be dropped.
    """
    owner = {edge: k for k, (a, b, c) in enumerate(triangles) for edge in ((a, b), (b, c), (c, a))}
    todo = list(range(len(triangles)))
    for _ in range(4 * len(triangles)):
        if not todo:
            break
        k = todo.pop()
        a, b, c = triangles[k]
        lengths = [float(np.hypot(*(flat[q] - flat[p]))) for p, q in ((a, b), (b, c), (c, a))]
        longest = lengths.index(max(lengths))
        a, b, c = triangles[k][longest:] + triangles[k][:longest]  # a to b is the longest edge
        (x, y), (u, v) = flat[b] - flat[a], flat[c] - flat[a]
        neighbour = owner.get((b, a))
        if abs(x * v - y * u) > tolerance * max(lengths) or neighbour is None:
            continue
        (d,) = set(triangles[neighbour]) - {a, b}
        for which, (p, q, r) in ((k, (c, d, b)), (neighbour, (d, c, a))):
            triangles[which] = [p, q, r]
            owner |= {(p, q): which, (q, r): which, (r, p): which}
            todo.append(which)
    return np.array(triangles, np.int64).reshape(-1, 3)


def _crossing(polygon: int) -> PolygonError:
    return PolygonError(f"has a face that crosses itself (face {polygon + 1}); split it, or export triangles")
