"""Distance of triangle meshes from convex bodies and from each other: a tree of bounds over GJK, compiled.

`TriangleTree` holds a mesh. Its triangles are sorted along Morton's curve and split evenly into the leaves of a
complete binary tree. A query visits the nearer child first and skips every node whose lower bound is not below the best
distance so far; the bound of a node is that of two upright boxes, then of a few steps of GJK.

GJK (Gilbert, Johnson and Keerthi 1988, doi:10.1109/56.2083) iterates towards the point v of the difference A - B that
is nearest to the origin. At each step the support point w of A - B against v gives

    v.w / |v|  <=  distance(A, B)  <=  |v|,

the left side being the distance of the origin from a plane that has all of A - B behind it. The largest left side is
returned: an iteration that is cut short or stalls on a degenerate simplex returns a smaller distance, never a larger
one. The result is a lower bound within 1e-8 m of the true distance. The nearest point of a simplex is searched among
all its faces: slightly slower than Johnson's recursion, and without its cases where cancelled digits choose the wrong
face.

A surface has no depth: bodies that touch or intersect it have distance 0. A body wholly inside a closed mesh is found
by counting the crossings of a ray, and its distance is negative.

The kernels need numba: import this module only where it is used (`planner.compiled`). They are written number by
number, because arrays made inside a kernel take most of its time, and array expressions most of the time to compile it.
Metres.
"""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planner.compiled import compiled
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats, Ints

BOX, CYLINDER, HULL = 0, 1, 2
"""Kinds of body A, by its rows: half sides; radius and half length along z; vertices."""

TRIANGLE, BOUNDS = 0, 1
"""Kinds of body B, by its rows: three corners; lowest and highest corner of an upright box."""

TOLERANCE = 1e-8
"""Gap between both bounds at which the iteration ends [m]."""

WORK = 13
"""Number of rows of the scratch array (`WORK`, 4)."""

POINT, OFFSET = 11, 9
"""Rows of the scratch array after `distance`: the nearest point of A, and the vector to it from that of B."""

_TOUCHING = 1e-12  # m; |v| below this is contact
_INFINITE = 1e300

# Passed as int64: numba compiles GJK anew for each constant argument.
_NODE_STEPS = 6  # of GJK for the bound of a node: nearly the final bound, in a third of the time
_HULL_STEPS = 20  # the same for a hull of many vertices, which converges more slowly
_FULL_STEPS = 64
_DEPTH = 128  # size of the stack of nodes: two for each level

# Rows of the scratch array: four corners of A - B, their points of A, weights, and single vectors.
_A, _WEIGHT, _V, _W, _P, _OF_B = 4, 8, 9, 10, 11, 12


Scratch = tuple[Floats, Floats, Floats, Floats, Floats, Floats, Ints]


def scratch() -> Scratch:
    """Create the arrays of `nearest_triangle`; created inside, they would take a tenth of its time to compile."""
    bounds = np.empty(_DEPTH), np.empty(_DEPTH, dtype=np.int64)
    return np.zeros((3, 3)), np.zeros(3), np.zeros(3), np.zeros((WORK, 4)), np.zeros((2, 3)), *bounds


@compiled
def nearest_triangle(
    kind: int,
    size: Floats,
    body: tuple[Floats, Floats],
    part: tuple[Floats, Floats],
    tree: tuple[Floats, Ints, Floats],
    reach: float,
    any_nearer: bool,
    points: Floats,
    scratch: Scratch,
) -> float:
    """Compute the distance of a body from the triangles, at most `reach`; see `TriangleTree.distance`."""
    position, rotation = body
    part_position, part_rotation = part
    triangles, first, bounds = tree
    R, p, extent, s, nearest, lower_of, waiting = scratch
    for i in range(3):  # into the object frame
        for k in range(3):
            p[i] += part_rotation[3 * k + i] * (position[k] - part_position[k])
            for j in range(3):
                R[i, j] += part_rotation[3 * k + i] * rotation[3 * k + j]
    for i in range(3):
        if kind == BOX:
            extent[i] = abs(R[i, 0]) * size[0, 0] + abs(R[i, 1]) * size[0, 1] + abs(R[i, 2]) * size[0, 2]
        elif kind == HULL:
            for k in range(len(size)):
                reach_of = abs(R[i, 0] * size[k, 0] + R[i, 1] * size[k, 1] + R[i, 2] * size[k, 2])
                extent[i] = max(extent[i], reach_of)
        else:
            extent[i] = size[0, 0] * np.sqrt(max(0.0, 1 - R[i, 2] * R[i, 2])) + abs(R[i, 2]) * size[0, 1]
    leaves = len(first) - 1
    waiting[0], lower_of[0], count, best = 1, 0.0, 1, reach
    is_nearer = False
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
                    best, is_nearer = apart, True
                    for i in range(3):
                        nearest[0, i], nearest[1, i] = s[POINT, i], s[POINT, i] - s[OFFSET, i]
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
    if is_nearer:
        for k in range(2):
            for i in range(3):
                points[k, i] = part_position[i]
                for j in range(3):
                    points[k, i] += part_rotation[3 * i + j] * nearest[k, j]
    return best


@compiled
def nearest_pair(
    one: tuple[Floats, Floats],
    tree_one: tuple[Floats, Ints, Floats],
    two: tuple[Floats, Floats],
    tree_two: tuple[Floats, Ints, Floats],
    reach: float,
    any_nearer: bool,
    points: Floats,
) -> float:
    """Compute the distance of the triangles of two trees, at most `reach`; see `TriangleTree.distance_to_tree`.

    Args:
        one: origin (3,) and axes (9,) of the first tree's frame in base.
        tree_one: its triangles, first triangle of each leaf, and boxes.
        two: frame of the second tree.
        tree_two: the second tree.
        reach: largest distance that is measured [m].
        any_nearer: stop at the first two triangles nearer than `reach`.
        points: (2, 3) is overwritten with the nearest points, base frame [m].
    """
    triangles_one, first_one, bounds_one = tree_one
    triangles_two, first_two, bounds_two = tree_two
    R, p = np.zeros((3, 3)), np.zeros(3)
    for i in range(3):  # the second in the frame of the first
        for k in range(3):
            p[i] += one[1][3 * k + i] * (two[0][k] - one[0][k])
            for j in range(3):
                R[i, j] += one[1][3 * k + i] * two[1][3 * k + j]
    leaves_one, leaves_two = len(first_one) - 1, len(first_two) - 1
    waiting, lower_of = np.empty((2 * _DEPTH, 2), dtype=np.int64), np.empty(2 * _DEPTH)
    waiting[0, 0], waiting[0, 1], lower_of[0], count, best = 1, 1, 0.0, 1, reach
    s, nearest, is_nearer = np.zeros((WORK, 4)), np.zeros((2, 3)), False
    size, extent, middle, corners = np.zeros((1, 3)), np.zeros(3), np.zeros(3), np.zeros((3, 3))
    here, upright = np.zeros(3), np.eye(3)
    child, lower = np.zeros((2, 2), dtype=np.int64), np.zeros(2)
    between = np.zeros(2)  # squared distance of the middles, for boxes with equal bounds
    while count:
        count -= 1
        a, b = waiting[count, 0], waiting[count, 1]
        if lower_of[count] >= best:
            continue
        if a >= leaves_one and b >= leaves_two:
            for u in range(first_two[b - leaves_two], first_two[b - leaves_two + 1]):
                for k in range(3):
                    for i in range(3):
                        corners[k, i] = p[i]
                        for j in range(3):
                            corners[k, i] += R[i, j] * triangles_two[u, k, j]
                for t in range(first_one[a - leaves_one], first_one[a - leaves_one + 1]):
                    if _boxes_apart(corners, triangles_one[t]) >= best:
                        continue
                    apart = distance(
                        int(np.int64(HULL)), corners, upright, here, int(np.int64(TRIANGLE)), triangles_one[t],
                        best, int(np.int64(_FULL_STEPS)), s,
                    )  # fmt: skip
                    if apart < best:
                        best, is_nearer = apart, True
                        for i in range(3):
                            nearest[1, i], nearest[0, i] = s[POINT, i], s[POINT, i] - s[OFFSET, i]
                        if any_nearer or best <= 0.0:
                            count = 0
                            break
                if is_nearer and (any_nearer or best <= 0.0):
                    break
            continue
        long_one, long_two = 0.0, 0.0
        for i in range(3):
            long_one = max(long_one, bounds_one[a, 1, i] - bounds_one[a, 0, i])
            long_two = max(long_two, bounds_two[b, 1, i] - bounds_two[b, 0, i])
        split_one = b >= leaves_two or (a < leaves_one and long_one > long_two)
        for k in range(2):
            child[k, 0], child[k, 1] = (2 * a + k, b) if split_one else (a, 2 * b + k)
            box = bounds_two[child[k, 1]]
            for i in range(3):
                size[0, i] = (box[1, i] - box[0, i]) / 2
            for i in range(3):
                middle[i], extent[i] = p[i], 0.0
                for j in range(3):
                    middle[i] += R[i, j] * (box[0, j] + box[1, j]) / 2
                    extent[i] += abs(R[i, j]) * size[0, j]
            other = bounds_one[child[k, 0]]
            between[k] = 0.0
            for i in range(3):
                across = middle[i] - (other[0, i] + other[1, i]) / 2
                between[k] += across * across
            lower[k] = _node_bound(int(np.int64(BOX)), size, R, middle, extent, other, best, s)
        far = 0 if lower[0] > lower[1] or (lower[0] == lower[1] and between[0] > between[1]) else 1
        for k in (far, 1 - far):
            if lower[k] < best:
                waiting[count, 0], waiting[count, 1], lower_of[count] = child[k, 0], child[k, 1], lower[k]
                count += 1
    if is_nearer:
        for k in range(2):
            for i in range(3):
                points[k, i] = one[0][i]
                for j in range(3):
                    points[k, i] += one[1][3 * i + j] * nearest[k, j]
    return best


@compiled
def _boxes_apart(one: Floats, two: Floats) -> float:
    """Return a lower bound on the distance of two triangles: that of their upright boxes."""
    squared = 0.0
    for i in range(3):
        gap = max(
            min(one[0, i], one[1, i], one[2, i]) - max(two[0, i], two[1, i], two[2, i]),
            min(two[0, i], two[1, i], two[2, i]) - max(one[0, i], one[1, i], one[2, i]),
        )
        if gap > 0:
            squared += gap * gap
    apart: float = squared**0.5
    return apart


@compiled
def _node_bound(
    kind: int, size: Floats, R: Floats, p: Floats, extent: Floats, box: Floats, enough: float, s: Floats
) -> float:
    """Return a lower bound on the distance of the body from an upright box."""
    squared = 0.0
    for i in range(3):
        gap = max(box[0, i] - p[i] - extent[i], p[i] - extent[i] - box[1, i])
        if gap > 0:
            squared += gap * gap
    rough: float = squared**0.5
    if rough >= enough:
        return rough
    steps = int(np.int64(_HULL_STEPS)) if kind == HULL else int(np.int64(_NODE_STEPS))
    return max(rough, distance(kind, size, R, p, int(np.int64(BOUNDS)), box, enough, steps, s))


@compiled
def distance(
    kind: int, size: Floats, R: Floats, p: Floats, kind_b: int, b: Floats, enough: float, steps: int, s: Floats
) -> float:
    """Return a lower bound on the distance of two convex bodies, within `TOLERANCE` of it if it is below `enough`.

    Args:
        kind: kind of A.
        size: (n, 3) rows of A [m].
        R: (3, 3) axes of A.
        p: (3,) origin of A.
        kind_b: kind of B.
        b: (3, 3) rows of B.
        enough: the iteration ends as soon as the distance is known to be this or more [m].
        steps: largest number of steps; few give a cheap bound.
        s: (WORK, 4) scratch; afterwards the rows `POINT` and `OFFSET` are valid.

    Returns:
        The bound [m]; 0 where they touch or overlap.
    """
    for i in range(3):
        s[_V, i] = p[i] - (b[0, i] + b[1, i]) / 2
    if s[_V, 0] * s[_V, 0] + s[_V, 1] * s[_V, 1] + s[_V, 2] * s[_V, 2] < _TOUCHING * _TOUCHING:
        s[_V, 0] = 1.0
    lower: float = 0.0
    n, upper = 0, _INFINITE
    for _ in range(steps):
        _support(kind, size, R, p, kind_b, b, s)
        length = (s[_V, 0] * s[_V, 0] + s[_V, 1] * s[_V, 1] + s[_V, 2] * s[_V, 2]) ** 0.5
        bound = (s[_V, 0] * s[_W, 0] + s[_V, 1] * s[_W, 1] + s[_V, 2] * s[_W, 2]) / length
        lower = max(lower, bound)
        if lower >= enough or upper - lower <= TOLERANCE:
            return lower
        for k in range(n):
            if s[k, 0] == s[_W, 0] and s[k, 1] == s[_W, 1] and s[k, 2] == s[_W, 2]:
                return lower
        for i in range(3):
            s[n, i], s[_A + n, i] = s[_W, i], s[_W, i] + s[_OF_B, i]
        n += 1
        inside = _nearest(n, s)
        n_corners = 0
        for k in range(n):  # the simplex keeps the corners that span v
            if s[_WEIGHT, k] > 0.0:
                for i in range(3):
                    s[n_corners, i], s[_A + n_corners, i] = s[k, i], s[_A + k, i]
                s[_WEIGHT, n_corners] = s[_WEIGHT, k]
                n_corners += 1
        n = n_corners
        for i in range(3):
            s[_V, i] = s[_P, i] = 0.0
            for k in range(n):
                s[_V, i] += s[_WEIGHT, k] * s[k, i]
                s[_P, i] += s[_WEIGHT, k] * s[_A + k, i]
        shrunk = (s[_V, 0] * s[_V, 0] + s[_V, 1] * s[_V, 1] + s[_V, 2] * s[_V, 2]) ** 0.5
        if inside or shrunk <= _TOUCHING:
            return 0.0
        if shrunk >= upper:  # only rounding is left
            return lower
        upper = shrunk
    return lower


@compiled
def _support(kind: int, size: Floats, R: Floats, p: Floats, kind_b: int, b: Floats, s: Floats) -> None:
    """Write the support point of A - B against v to row _W, and its point of B to row _OF_B."""
    vx, vy, vz = s[_V, 0], s[_V, 1], s[_V, 2]
    x = -(R[0, 0] * vx + R[1, 0] * vy + R[2, 0] * vz)
    y = -(R[0, 1] * vx + R[1, 1] * vy + R[2, 1] * vz)
    z = -(R[0, 2] * vx + R[1, 2] * vy + R[2, 2] * vz)
    if kind == BOX:
        x = size[0, 0] if x >= 0 else -size[0, 0]
        y = size[0, 1] if y >= 0 else -size[0, 1]
        z = size[0, 2] if z >= 0 else -size[0, 2]
    elif kind == HULL:
        farthest, corner = -_INFINITE, 0
        for k in range(len(size)):
            height = size[k, 0] * x + size[k, 1] * y + size[k, 2] * z
            if height > farthest:
                farthest, corner = height, k
        x, y, z = size[corner, 0], size[corner, 1], size[corner, 2]
    else:
        across = (x * x + y * y) ** 0.5
        x, y = (size[0, 0] * x / across, size[0, 0] * y / across) if across > 0 else (size[0, 0], 0.0)
        z = size[0, 1] if z >= 0 else -size[0, 1]
    row = 0
    if kind_b == TRIANGLE:
        first = b[0, 0] * vx + b[0, 1] * vy + b[0, 2] * vz
        second = b[1, 0] * vx + b[1, 1] * vy + b[1, 2] * vz
        third = b[2, 0] * vx + b[2, 1] * vy + b[2, 2] * vz
        row = 2 if third > max(first, second) else 1 if second > first else 0
    for i in range(3):
        if kind_b == BOUNDS:
            row = 1 if s[_V, i] >= 0 else 0
        s[_OF_B, i] = b[row, i]
        s[_W, i] = p[i] + R[i, 0] * x + R[i, 1] * y + R[i, 2] * z - b[row, i]


@compiled
def _nearest(n: int, s: Floats) -> bool:
    """Compute the weights of the point of a simplex nearest to the origin; True if the origin is inside a tetrahedron.

    Args:
        n: number of corners, 1 to 4, in the first rows of s.
        s: scratch; row _WEIGHT is overwritten with n weights of sum 1.
    """
    if n == 4:
        whole = _volume(s, n)
        scale = 0.0
        for k in range(1, 4):
            for i in range(3):
                scale = max(scale, abs(s[k, i] - s[0, i]))
        if abs(whole) > 1e-12 * scale * scale * scale:
            inside = True
            for k in range(4):
                s[_WEIGHT, k] = _volume(s, k) / whole
                inside = inside and s[_WEIGHT, k] > 0.0
            if inside:
                return True
    for k in range(4):
        s[_WEIGHT, k] = 0.0
    if n == 1:
        s[_WEIGHT, 0] = 1.0
    best = _INFINITE
    if n == 2:
        best = _of_segment(n - 2, n - 1, best, s)
    for left_out in range(4):
        if n == 4 or (n == 3 and left_out == 3):
            best = _of_triangle((left_out + 1) % 4, (left_out + 2) % 4, (left_out + 3) % 4, best, s)
    return False


@compiled
def _of_triangle(i: int, j: int, k: int, best: float, s: Floats) -> float:
    """Store the weights of the point of a triangle nearest to the origin if its squared distance is below `best`."""
    ux, uy, uz = s[j, 0] - s[i, 0], s[j, 1] - s[i, 1], s[j, 2] - s[i, 2]
    vx, vy, vz = s[k, 0] - s[i, 0], s[k, 1] - s[i, 1], s[k, 2] - s[i, 2]
    uu, vv, uv = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, ux * vx + uy * vy + uz * vz
    ru = -(ux * s[i, 0] + uy * s[i, 1] + uz * s[i, 2])
    rv = -(vx * s[i, 0] + vy * s[i, 1] + vz * s[i, 2])
    area = uu * vv - uv * uv
    if area > 1e-14 * uu * vv:
        a, b = (vv * ru - uv * rv) / area, (uu * rv - uv * ru) / area
        if a > 0 and b > 0 and a + b < 1:
            return _store(i, j, k, 1 - a - b, a, b, best, s)
    best = _of_segment(i, j, best, s)
    best = _of_segment(j, k, best, s)
    return _of_segment(k, i, best, s)


@compiled
def _of_segment(i: int, j: int, best: float, s: Floats) -> float:
    """Store the weights for a segment, as `_of_triangle`."""
    dx, dy, dz = s[j, 0] - s[i, 0], s[j, 1] - s[i, 1], s[j, 2] - s[i, 2]
    along = dx * dx + dy * dy + dz * dz
    t = -(dx * s[i, 0] + dy * s[i, 1] + dz * s[i, 2]) / along if along > 0 else 0.0
    t = min(1.0, max(0.0, t))
    return _store(i, j, i, 1 - t, t, 0 * t, best, s)


@compiled
def _store(i: int, j: int, k: int, a: float, b: float, c: float, best: float, s: Floats) -> float:
    """Store the weights of a point of three corners if its squared length is below `best`; return the smaller one."""
    squared: float = 0.0
    for axis in range(3):
        x = a * s[i, axis] + b * s[j, axis] + c * s[k, axis]
        squared += x * x
    if squared < best:
        for corner in range(4):
            s[_WEIGHT, corner] = 0.0
        s[_WEIGHT, i] += a
        s[_WEIGHT, j] += b
        s[_WEIGHT, k] += c
        return squared
    return best


@compiled
def _volume(s: Floats, origin: int) -> float:
    """Return six times the signed volume of the tetrahedron, with corner number `origin` moved to the origin."""
    a, b, c, d = origin != 0, origin != 1, origin != 2, origin != 3
    px, py, pz = a * s[0, 0], a * s[0, 1], a * s[0, 2]
    ux, uy, uz = b * s[1, 0] - px, b * s[1, 1] - py, b * s[1, 2] - pz
    vx, vy, vz = c * s[2, 0] - px, c * s[2, 1] - py, c * s[2, 2] - pz
    wx, wy, wz = d * s[3, 0] - px, d * s[3, 1] - py, d * s[3, 2] - pz
    volume: float = ux * (vy * wz - vz * wy) - uy * (vx * wz - vz * wx) + uz * (vx * wy - vy * wx)
    return volume


@compiled
def count_crossings(origin: Floats, ray: Floats, tree: tuple[Floats, Ints, Floats]) -> int:
    """Count the crossings of a ray with the triangles (Moeller, Trumbore 1997, doi:10.1080/10867651.1997.10487468)."""
    triangles, first, bounds = tree
    leaves = len(first) - 1
    waiting = np.empty(_DEPTH, dtype=np.int64)
    waiting[0], count, met = 1, 1, 0
    while count:
        count -= 1
        node = waiting[count]
        near, far = 0.0, np.inf
        for i in range(3):  # no component of a ray is 0
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
    """Return the edges from the first of three corners to the second and third: one compiled form for each caller."""
    x, y, z = corners[0, 0], corners[0, 1], corners[0, 2]
    return (
        corners[1, 0] - x, corners[1, 1] - y, corners[1, 2] - z, corners[2, 0] - x, corners[2, 1] - y, corners[2, 2] - z
    )  # fmt: skip


Frames = tuple[tuple[Floats, Floats], tuple[Floats, Floats]]
"""Origin (3,) and axes (9,), row by row, of two frames in base [m]."""

_BLOCK = 8192  # triangles a pass: its arrays fit into the cache of a core
_LEAF = 4  # triangles a leaf, about: fewer cost more nodes, more cost more calls of GJK

# Directions that no edge or face of a real part is parallel to.
_RAYS = np.array([[0.5391, 0.6173, 0.5729], [-0.7213, 0.3911, 0.5717], [0.2417, -0.8719, 0.4259]])


class TriangleTree:
    """A mesh prepared for distance queries. It never changes, so checkers share it.

    Attributes:
        closed: whether every edge joins an even number of faces, so that there is an inside.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        """Sort the triangles and build the tree.

        Args:
            mesh: at least one face [m].
        """
        order = np.argsort(_morton(mesh.centres), kind="stable")
        triangles = np.take(mesh.vertices, np.take(mesh.faces, order, axis=0), axis=0)
        leaves = 1 << max(0, int(np.ceil(np.log2(max(1.0, len(order) / _LEAF)))))
        first = (np.arange(leaves + 1, dtype=np.int64) * len(order)) // leaves
        bounds = np.empty((2 * leaves, 3, 3))
        bounds[:, 2] = 0.0
        a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
        bounds[leaves:, 0] = np.minimum.reduceat(np.minimum(np.minimum(a, b), c), first[:-1])
        bounds[leaves:, 1] = np.maximum.reduceat(np.maximum(np.maximum(a, b), c), first[:-1])
        below = leaves
        while below > 1:
            left, right = bounds[below : 2 * below : 2], bounds[below + 1 : 2 * below : 2]
            below //= 2
            bounds[below : 2 * below, 0] = np.minimum(left[:, 0], right[:, 0])
            bounds[below : 2 * below, 1] = np.maximum(left[:, 1], right[:, 1])
        bounds[0] = bounds[1]
        self._tree = triangles, first, bounds
        self.closed = is_closed(mesh)

    def distance(
        self,
        kind: int,
        size: Floats,
        position: Floats,
        rotation: Floats,
        part_position: Floats,
        part_rotation: Floats,
        reach: float,
        *,
        any_nearer: bool = False,
        points: Floats | None = None,
    ) -> float:
        """Compute the distance of a convex body from the mesh.

        Args:
            kind: `BOX`, `CYLINDER` or `HULL`.
            size: (3,) half sides; radius, half length; (n, 3) the vertices of a hull [m].
            position: (3,) middle of the body, base frame [m].
            rotation: (9,) axes of the body, row by row, base frame.
            part_position: (3,) origin of the mesh's frame, base frame [m].
            part_rotation: (9,) axes of the mesh's frame, row by row, base frame.
            reach: largest distance that is measured [m].
            any_nearer: stop at the first triangle nearer than `reach`: enough for yes or no.
            points: (2, 3), overwritten with the nearest points of body and mesh, base frame [m].

        Returns:
            The distance [m]: `reach` if it is larger, 0 in contact, the negative distance from the surface for a body
            inside a closed mesh.
        """
        nearest = np.zeros((2, 3)) if points is None else points
        measured = nearest_triangle(
            kind, size.reshape(-1, 3), (position, rotation), (part_position, part_rotation), self._tree, reach,
            any_nearer, nearest, scratch(),
        )  # fmt: skip
        if measured > 0 and self.closed:
            # A point of the body: the origin of a hull's vertices may lie outside it.
            point = position + rotation.reshape(3, 3) @ size[0] if kind == HULL else position
            if self._inside(part_rotation.reshape(3, 3).T @ (point - part_position)):
                return -measured
        return float(measured)

    def distance_to_hull(
        self, other: "TriangleTree", frames: Frames, reach: float, *, any_nearer: bool, points: Floats | None
    ) -> float:
        """Compute the distance of the convex hull of another mesh from this mesh; see `distance_to_tree`."""
        (middle, vertices), (here, (position, R)) = other.hull, frames
        position = position + R.reshape(3, 3) @ middle
        return self.distance(HULL, vertices, position, R, *here, reach, any_nearer=any_nearer, points=points)

    @cached_property
    def hull(self) -> tuple[Floats, Floats]:
        """Middle (3,) of the mesh's box, and the vertices (n, 3) of its convex hull relative to it [m]."""
        from scipy.spatial import ConvexHull  # kept out of the start-up

        points = np.unique(self._tree[0].reshape(-1, 3), axis=0)
        middle = (points.min(axis=0) + points.max(axis=0)) / 2
        return middle, np.ascontiguousarray(points[ConvexHull(points).vertices] - middle)

    def distance_to_tree(
        self, other: "TriangleTree", frames: Frames, reach: float, *, any_nearer: bool = False,
        points: Floats | None = None,
    ) -> float:  # fmt: skip
        """Compute the distance of another mesh.

        Args:
            other: the other mesh.
            frames: of this mesh and of the other.
            reach: largest distance that is measured [m].
            any_nearer: stop at the first two triangles nearer than `reach`.
            points: (2, 3), overwritten with the nearest points of this mesh and of the other, base frame [m].

        Returns:
            The distance [m]: `reach` if it is larger, 0 in contact, negative for a mesh inside the other, closed one.
        """
        nearest = np.zeros((2, 3)) if points is None else points
        measured = nearest_pair(frames[0], self._tree, frames[1], other._tree, reach, any_nearer, nearest)
        if measured > 0:
            (here, R), (there, of_other) = frames
            turn = R.reshape(3, 3).T @ of_other.reshape(3, 3)
            shift = R.reshape(3, 3).T @ (there - here)
            is_inside = self.closed and self._inside(turn @ other._tree[0][0, 0] + shift)
            if is_inside or (other.closed and other._inside(turn.T @ (self._tree[0][0, 0] - shift))):
                return -measured
        return float(measured)

    def _inside(self, local: Floats) -> bool:
        """Return whether a point off the surface is inside the closed mesh, by the majority of three rays."""
        low, high = self._tree[2][1, :2]
        if (local < low).any() or (local > high).any():
            return False
        odd = [count_crossings(local, ray, self._tree) % 2 for ray in _RAYS]
        return sum(odd) >= 2


def is_closed(mesh: TriangleMesh) -> bool:
    """Return whether every edge of a mesh is shared by an even number of faces, so that it has an inside.

    Equal edges cancel in the exclusive or of a hash of each (splitmix64 of Steele, Lea, Flood 2014,
    doi:10.1145/2660193.2660195): 0 remains of a closed mesh, and of one in 2^64 open ones.
    """
    left = np.uint64(0)
    for begin in range(0, len(mesh.faces), _BLOCK):
        corners = mesh.faces[begin : begin + _BLOCK].T.astype(np.uint64)
        for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            edge = np.minimum(start, end) << np.uint64(32) | np.maximum(start, end)
            edge = edge[start != end] + np.uint64(0x9E3779B97F4A7C15)  # without edges of degenerate faces
            for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
                edge = (edge ^ (edge >> np.uint64(shift))) * np.uint64(factor)
            left ^= np.bitwise_xor.reduce(edge ^ (edge >> np.uint64(31)))
    return bool(left == 0)


def _morton(points: Floats) -> NDArray[np.uint64]:
    """Return the position (N,) of each point on Morton's curve, 21 bits an axis."""
    low = points.min(axis=0)
    span = max(float((points.max(axis=0) - low).max()), 1e-300)
    code = np.zeros(len(points), dtype=np.uint64)
    for begin in range(0, len(points), _BLOCK):
        block = slice(begin, begin + _BLOCK)
        cells = np.minimum((points[block] - low) / span * 2097151.0, 2097151.0).astype(np.uint64)
        for axis, x in enumerate(cells.T):
            for shift, mask in _SPREAD:
                x = (x | (x << np.uint64(shift))) & np.uint64(mask)
            code[block] |= x << np.uint64(axis)
    return code


_SPREAD = (
    (32, 0x1F00000000FFFF),
    (16, 0x1F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)
