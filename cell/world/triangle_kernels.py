"""Walks through a tree of triangles (`cell.world.triangle_tree`), compiled: import only where they are used."""

import numpy as np
from numpy.typing import NDArray

from cell.world.gjk import BOUNDS, BOX, POINT, TRIANGLE, WAY, WORK, distance
from planner.compiled import compiled
from planner.ports import Floats

Ints = NDArray[np.int64]

# As int64: numba would compile GJK anew for each constant that it is called with.
_NODE_STEPS = 6  # of GJK for the bound of a node: most of what the walk would find, for a third of its time
_FULL_STEPS = 64
_DEPTH = 128  # nodes that wait at most: two for each level


@compiled
def nearest_triangle(
    kind: int,
    size: Floats,
    position: Floats,
    rotation: Floats,
    part_position: Floats,
    part_rotation: Floats,
    triangles: Floats,
    first: Ints,
    bounds: Floats,
    reach: float,
    any_nearer: bool,
    points: Floats,
) -> float:
    """Distance of a body from the triangles, `reach` where it is more; see `TriangleTree.distance`."""
    R, p, extent = np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    for i in range(3):  # into the object frame
        for k in range(3):
            p[i] += part_rotation[3 * k + i] * (position[k] - part_position[k])
            for j in range(3):
                R[i, j] += part_rotation[3 * k + i] * rotation[3 * k + j]
    for i in range(3):
        if kind == BOX:
            extent[i] = abs(R[i, 0]) * size[0] + abs(R[i, 1]) * size[1] + abs(R[i, 2]) * size[2]
        else:
            extent[i] = size[0] * np.sqrt(max(0.0, 1 - R[i, 2] * R[i, 2])) + abs(R[i, 2]) * size[1]
    leaves = len(first) - 1
    waiting, lower_of = np.empty(_DEPTH, dtype=np.int64), np.empty(_DEPTH)
    waiting[0], lower_of[0], count, best = 1, 0.0, 1, reach
    s, nearest, found = np.zeros((WORK, 4)), np.zeros((2, 3)), False
    while count:
        count -= 1
        node = waiting[count]
        if lower_of[count] >= best:
            continue
        if node >= leaves:
            for t in range(first[node - leaves], first[node - leaves + 1]):
                apart = distance(
                    kind, size, R, p, int(np.int64(TRIANGLE)), triangles[t], best, int(np.int64(_FULL_STEPS)), s
                )
                if apart < best:
                    best, found = apart, True
                    for i in range(3):
                        nearest[0, i], nearest[1, i] = s[POINT, i], s[POINT, i] - s[WAY, i]
                    if any_nearer or best <= 0.0:
                        count = 0
                        break
            continue
        one, two = 2 * node, 2 * node + 1
        lower_one = _node_bound(kind, size, R, p, extent, bounds[one], best, s)
        lower_two = _node_bound(kind, size, R, p, extent, bounds[two], best, s)
        if lower_one < lower_two:
            one, two, lower_one, lower_two = two, one, lower_two, lower_one
        if lower_one < best:
            waiting[count], lower_of[count] = one, lower_one
            count += 1
        if lower_two < best:
            waiting[count], lower_of[count] = two, lower_two
            count += 1
    if found:
        for k in range(2):
            for i in range(3):
                points[k, i] = part_position[i]
                for j in range(3):
                    points[k, i] += part_rotation[3 * i + j] * nearest[k, j]
    return best


@compiled
def _node_bound(
    kind: int, size: Floats, R: Floats, p: Floats, extent: Floats, box: Floats, enough: float, s: Floats
) -> float:
    """A lower bound on the distance of the body from an upright box."""
    squared = 0.0
    for i in range(3):
        gap = max(box[0, i] - p[i] - extent[i], p[i] - extent[i] - box[1, i])
        if gap > 0:
            squared += gap * gap
    rough: float = squared**0.5
    if rough >= enough:
        return rough
    return max(rough, distance(kind, size, R, p, int(np.int64(BOUNDS)), box, enough, int(np.int64(_NODE_STEPS)), s))


@compiled
def crossings(origin: Floats, ray: Floats, triangles: Floats, first: Ints, bounds: Floats) -> int:
    """How often a ray crosses the triangles (Moeller and Trumbore 1997, doi:10.1080/10867651.1997.10487468)."""
    leaves = len(first) - 1
    waiting = np.empty(_DEPTH, dtype=np.int64)
    waiting[0], count, met = 1, 1, 0
    while count:
        count -= 1
        node = waiting[count]
        near, far = 0.0, np.inf
        for i in range(3):  # the rays have no component that is 0
            one, two = (bounds[node, 0, i] - origin[i]) / ray[i], (bounds[node, 1, i] - origin[i]) / ray[i]
            near, far = max(near, min(one, two)), min(far, max(one, two))
        if near > far:
            continue
        if node < leaves:
            waiting[count], waiting[count + 1] = 2 * node, 2 * node + 1
            count += 2
            continue
        for t in range(first[node - leaves], first[node - leaves + 1]):
            ux, uy, uz = _edge(triangles, t, 1, 0), _edge(triangles, t, 1, 1), _edge(triangles, t, 1, 2)
            vx, vy, vz = _edge(triangles, t, 2, 0), _edge(triangles, t, 2, 1), _edge(triangles, t, 2, 2)
            hx, hy, hz = ray[1] * vz - ray[2] * vy, ray[2] * vx - ray[0] * vz, ray[0] * vy - ray[1] * vx
            det = ux * hx + uy * hy + uz * hz
            if det == 0.0:
                continue
            sx, sy, sz = (
                origin[0] - triangles[t, 0, 0],
                origin[1] - triangles[t, 0, 1],
                origin[2] - triangles[t, 0, 2],
            )
            gx, gy, gz = sy * uz - sz * uy, sz * ux - sx * uz, sx * uy - sy * ux
            a = (sx * hx + sy * hy + sz * hz) / det
            b = (ray[0] * gx + ray[1] * gy + ray[2] * gz) / det
            if a >= 0 and b >= 0 and a + b < 1 and (vx * gx + vy * gy + vz * gz) / det > 0:
                met += 1
    return met


@compiled
def _edge(triangles: Floats, t: int, corner: int, axis: int) -> float:
    return float(triangles[t, corner, axis] - triangles[t, 0, axis])
