"""How often a ray crosses the triangles of a tree, compiled: import this module only where it is used."""

import numpy as np

from planner.compiled import compiled
from planner.values import Floats, Ints

_DEPTH = 128  # nodes that wait at most: two for each level


@compiled
def crossings(origin: Floats, ray: Floats, tree: tuple[Floats, Ints, Floats]) -> int:
    """How often a ray crosses the triangles (Moeller and Trumbore 1997, doi:10.1080/10867651.1997.10487468)."""
    triangles, first, bounds = tree
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
            ux, uy, uz, vx, vy, vz = _edges(triangles[t])
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
def _edges(corners: Floats) -> tuple[float, float, float, float, float, float]:
    """From the first of three corners to the second and to the third: one specialisation, whatever the corner."""
    x, y, z = corners[0, 0], corners[0, 1], corners[0, 2]
    return (
        corners[1, 0] - x, corners[1, 1] - y, corners[1, 2] - z, corners[2, 0] - x, corners[2, 1] - y, corners[2, 2] - z
    )  # fmt: skip
