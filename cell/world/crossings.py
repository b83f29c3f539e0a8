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
