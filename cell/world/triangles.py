"""True triangles of a part, fixture or link: their distance from a body by a tree of bounds over GJK, compiled.

A body is a box, a cylinder, or the triangles of another tree.

Triangles are sorted along Morton's curve and split evenly into the leaves of a complete binary tree. A query goes down
to the nearer child first and leaves out whatever cannot be nearer than what it has found; the bound of a node is that
of two upright boxes, then a few steps of GJK. The result is a lower bound within 1e-8 m of the true distance
(`cell.world.triangle_distance`).

A surface has no depth: bodies that touch or cut it are 0 apart. Where the mesh is closed, a body that floats wholly
inside is found by counting crossings of a ray, and its distance is negative. Lengths in metres.
"""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cell.world.crossings import crossings
from cell.world.triangle_distance import HULL, nearest_pair, nearest_triangle, scratch
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats

Frames = tuple[tuple[Floats, Floats], tuple[Floats, Floats]]
"""Origin (3,) and axes (9,), row by row, of two frames in base [m]."""

_BLOCK = 8192  # triangles worked on at once: what they need fits into a core's cache
_LEAF = 4  # triangles in a leaf, about: fewer cost more nodes, more cost more narrow checks

# Directions along which nothing is built.
_RAYS = np.array([[0.5391, 0.6173, 0.5729], [-0.7213, 0.3911, 0.5717], [0.2417, -0.8719, 0.4259]])


class TriangleTree:
    """A mesh that answers how far it is from a body; never changed, so that checkers share it.

    Attributes:
        closed: whether every edge joins two faces, or four where bodies meet, so that there is an inside.
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
        """Distance of a body from the part.

        Args:
            kind: `cell.world.triangle_distance.BOX`, `CYLINDER` or `HULL`.
            size: (3,) half sides; radius, half length; (n, 3) the vertices of a hull [m].
            position: (3,) its middle, base frame [m].
            rotation: (9,) its axes, row by row, base frame.
            part_position: (3,) origin of the part's frame, base frame [m].
            part_rotation: (9,) its axes, row by row, base frame.
            reach: nothing beyond is looked for [m].
            any_nearer: stop at the first triangle nearer than `reach`: enough for yes or no.
            points: (2, 3) is overwritten with the nearest points of body and part, base frame [m].

        Returns:
            The distance [m]: `reach` where it is more, 0 in contact, negative where the body floats inside a closed
            part (and its distance from the surface is what is measured).
        """
        found = np.zeros((2, 3)) if points is None else points
        measured = nearest_triangle(
            kind, size.reshape(-1, 3), (position, rotation), (part_position, part_rotation), self._tree, reach,
            any_nearer, found, scratch(),
        )  # fmt: skip
        if measured > 0 and self.closed and self._inside(part_rotation.reshape(3, 3).T @ (position - part_position)):
            return -measured
        return float(measured)

    def from_hull(
        self, other: "TriangleTree", frames: Frames, reach: float, *, any_nearer: bool, points: Floats | None
    ) -> float:
        """Distance of the convex hull of another tree's triangles from those of this one; see `from_tree`."""
        (middle, vertices), (here, (position, R)) = other.hull, frames
        position = position + R.reshape(3, 3) @ middle
        return self.distance(HULL, vertices, position, R, *here, reach, any_nearer=any_nearer, points=points)

    @cached_property
    def hull(self) -> tuple[Floats, Floats]:
        """Middle (3,) of the triangles' box, and from there the vertices (n, 3) of their convex hull [m]."""
        from scipy.spatial import ConvexHull  # kept out of the start-up

        points = np.unique(self._tree[0].reshape(-1, 3), axis=0)
        middle = (points.min(axis=0) + points.max(axis=0)) / 2
        return middle, np.ascontiguousarray(points[ConvexHull(points).vertices] - middle)

    def from_tree(
        self, other: "TriangleTree", frames: Frames, reach: float, *, any_nearer: bool = False,
        points: Floats | None = None,
    ) -> float:  # fmt: skip
        """Distance from the triangles of another tree.

        Args:
            other: that tree.
            frames: of this one and of the other.
            reach: nothing beyond is looked for [m].
            any_nearer: stop at the first two triangles nearer than `reach`.
            points: (2, 3) is overwritten with the nearest points of this one and the other, base frame [m].

        Returns:
            The distance [m]: `reach` where it is more, 0 in contact, negative where a triangle of one floats inside
            the other, which is closed.
        """
        found = np.zeros((2, 3)) if points is None else points
        measured = nearest_pair(frames[0], self._tree, frames[1], other._tree, reach, any_nearer, found)
        if measured > 0:
            (here, R), (there, of_other) = frames
            turn = R.reshape(3, 3).T @ of_other.reshape(3, 3)
            shift = R.reshape(3, 3).T @ (there - here)
            held = self.closed and self._inside(turn @ other._tree[0][0, 0] + shift)
            if held or (other.closed and other._inside(turn.T @ (self._tree[0][0, 0] - shift))):
                return -measured
        return float(measured)

    def _inside(self, local: Floats) -> bool:
        """Whether a point off the surface, object frame, is inside the closed mesh: most of three rays say so."""
        low, high = self._tree[2][1, :2]
        if (local < low).any() or (local > high).any():
            return False
        odd = [crossings(local, ray, self._tree) % 2 for ray in _RAYS]
        return sum(odd) >= 2


def is_closed(mesh: TriangleMesh) -> bool:
    """Whether every edge of a mesh is shared by an even number of faces, so that a ray tells inside from outside.

    Equal edges cancel in the exclusive or of a hash of each (splitmix64 of Steele, Lea, Flood 2014,
    doi:10.1145/2714064.2660195): 0 is left of a closed mesh, and of one in 2^64 others.
    """
    left = np.uint64(0)
    for begin in range(0, len(mesh.faces), _BLOCK):
        corners = mesh.faces[begin : begin + _BLOCK].T.astype(np.uint64)
        for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            edge = np.minimum(start, end) << np.uint64(32) | np.maximum(start, end)
            edge = edge[start != end] + np.uint64(0x9E3779B97F4A7C15)  # without those of faces collapsed to a line
            for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
                edge = (edge ^ (edge >> np.uint64(shift))) * np.uint64(factor)
            left ^= np.bitwise_xor.reduce(edge ^ (edge >> np.uint64(31)))
    return bool(left == 0)


def _morton(points: "Floats") -> NDArray[np.uint64]:
    """(N,) place of each point on Morton's curve, 21 bits an axis."""
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
