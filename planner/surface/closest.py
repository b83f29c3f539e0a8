"""Closest face of a mesh to each of many points that have a normal.

A k-d tree over points spread on the faces, in position and normal together, proposes candidates; the exact distance
from point to triangle chooses among them. The normal keeps the two sides of a thin wall apart. Any one frame, metres.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Floats = NDArray[np.float64]

_CANDIDATES = (
    8  # tree neighbours whose exact distance is taken; on scanned parts 1 choice in 100 is not the very nearest
)
_NORMAL_WEIGHT = 0.25  # typical face sizes that a unit of normal counts; 1 misses the very nearest ten times as often
_SPREAD_POINTS = 6000  # a mesh of fewer faces gets about so many points, so that a large face is found from its rim too
_MAX_DIVISIONS = 24  # of an edge, which bounds the points on one huge face
_CHUNK = 16384  # points a pass, so that its arrays stay in the processor's cache


def closest_face(points: Floats, normals: Floats, triangles: Floats, triangle_normals: Floats) -> NDArray[np.int32]:
    """The face nearest to each point, among those that look the same way where there are any near.

    Args:
        points: (N, 3) [m].
        normals: (N, 3) unit normals.
        triangles: (F, 3, 3) corners [m], F > 0.
        triangle_normals: (F, 3) unit normals, zero for a face without area.

    Returns:
        (N,) face indices.
    """
    spread, owner = _spread(triangles)
    scale = _NORMAL_WEIGHT * float(np.sqrt(np.median(_longest_squared(triangles))))
    tree = cKDTree(
        np.hstack([spread, scale * triangle_normals[owner]]),
        balanced_tree=False,  # sliding midpoints build several times faster and query as fast
        compact_nodes=False,
    )
    far = float(np.ptp(triangles.reshape(-1, 3), axis=0).sum() + np.ptp(points, axis=0).sum()) ** 2
    n_candidates = min(_CANDIDATES, len(spread))
    closest = np.empty(len(points), dtype=np.int32)
    for start in range(0, len(points), _CHUNK):
        part = slice(start, min(start + _CHUNK, len(points)))
        query = np.hstack([points[part], scale * normals[part]])
        candidates = owner[tree.query(query, k=n_candidates, workers=2)[1].reshape(-1, n_candidates)]
        squared = squared_distance(points[part, None, :], triangles, candidates)
        looks_away = np.einsum("nj,nkj->nk", normals[part], triangle_normals[candidates]) <= 0
        best = np.argmin(np.where(looks_away, squared + far, squared), axis=1)
        closest[part] = candidates[np.arange(len(best)), best]
    return closest


def squared_distance(points: Floats, triangles: Floats, faces: NDArray[np.integer]) -> Floats:
    """Squared distance from points to triangles, exact up to rounding (about 1e-8 of the triangle's size).

    The nearest point lies inside the triangle where the foot of the perpendicular does (its barycentric coordinates are
    not negative), and on the nearest of the three edges elsewhere.

    Args:
        points: (..., 3) [m], broadcast against `faces`.
        triangles: (F, 3, 3) corners [m].
        faces: (...) which triangle to take.

    Returns:
        (...) squared distance [m^2].
    """
    first = triangles[:, 1] - triangles[:, 0]
    second = triangles[:, 2] - triangles[:, 0]
    offset = points - triangles[:, 0][faces]
    dd = np.einsum("...j,...j->...", offset, offset)
    d1 = np.einsum("...j,...j->...", offset, first[faces])
    d2 = np.einsum("...j,...j->...", offset, second[faces])
    a11 = np.einsum("fj,fj->f", first, first)[faces]
    a12 = np.einsum("fj,fj->f", first, second)[faces]
    a22 = np.einsum("fj,fj->f", second, second)[faces]
    a33 = a11 - 2 * a12 + a22
    d3 = d2 - d1 - a12 + a11

    def to_edge(from_start: Floats, along: Floats, length: Floats) -> Floats:
        step = np.clip(np.divide(along, length, out=np.zeros_like(along), where=length > 0), 0, 1)
        return from_start + step * (step * length - 2 * along)

    nearest = to_edge(dd, d1, a11)
    np.minimum(nearest, to_edge(dd, d2, a22), out=nearest)
    np.minimum(nearest, to_edge(dd - 2 * d1 + a11, d3, a33), out=nearest)
    determinant = a11 * a22 - a12 * a12
    has_area = determinant > 1e-14 * a11 * a22
    safe = np.where(has_area, determinant, 1.0)
    s = (a22 * d1 - a12 * d2) / safe
    t = (a11 * d2 - a12 * d1) / safe
    inside = has_area & (s >= 0) & (t >= 0) & (s + t <= 1)
    return np.maximum(np.where(inside, dd - s * d1 - t * d2, nearest), 0.0)


def _longest_squared(triangles: Floats) -> Floats:
    """(F,) squared length of each triangle's longest edge [m^2]."""
    edges = triangles - np.roll(triangles, -1, axis=1)
    longest: Floats = np.einsum("fej,fej->fe", edges, edges).max(axis=1)
    return longest


def _spread(triangles: Floats) -> tuple[Floats, NDArray[np.int32]]:
    """Points over every face, about evenly spaced over the mesh: the middles of equal sub-triangles.

    Returns:
        (P, 3) points [m] and (P,) the face of each.
    """
    longest = np.sqrt(_longest_squared(triangles))
    if len(triangles) >= _SPREAD_POINTS:
        spacing = 2.0 * float(np.median(longest))
    else:
        spacing = float(np.sqrt((longest**2).sum() / _SPREAD_POINTS))
    divisions = np.clip(np.ceil(longest / spacing), 1, _MAX_DIVISIONS).astype(int) if spacing > 0 else np.ones(1, int)
    divisions = np.broadcast_to(divisions, len(triangles))
    points, owners = [], []
    for n in np.unique(divisions):
        faces = np.flatnonzero(divisions == n)
        i, j = (index.ravel() for index in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
        upward = i + j < n
        u = np.concatenate([i[upward] + 1 / 3, i[i + j < n - 1] + 2 / 3]) / n
        v = np.concatenate([j[upward] + 1 / 3, j[i + j < n - 1] + 2 / 3]) / n
        weights = np.stack([1 - u - v, u, v], axis=1)
        points.append(np.einsum("pc,fcj->fpj", weights, triangles[faces]).reshape(-1, 3))
        owners.append(np.repeat(faces, len(weights)))
    return np.concatenate(points), np.concatenate(owners).astype(np.int32)
