"""A triangle mesh cut along planes across an axis: every triangle lies on one side then, the surface is the same.

Object frame, metres.
"""

from dataclasses import replace

import numpy as np

from planner.surface.mesh import TriangleMesh
from planner.values import Floats, Ints, Ints32

_ON = 1e-9  # of the diagonal: what is nearer to a plane lies on it


def cut(mesh: TriangleMesh, axis: int, at: float) -> tuple[TriangleMesh, Ints]:
    """Cut the triangles that a plane crosses; edges are cut for both of their triangles alike.

    Args:
        mesh: any mesh; its regions are kept.
        axis: 0, 1 or 2: the plane is across x, y or z.
        at: where it stands on the axis [m].

    Returns:
        The mesh, its first V vertices unchanged, and the (F',) triangle of `mesh` that each of its triangles is of.
    """
    height = mesh.vertices[:, axis] - at
    side = np.sign(np.where(np.abs(height) <= _ON * mesh.diagonal, 0.0, height)).astype(np.int64)
    of_corner = side[mesh.faces]
    crossed = (of_corner.min(axis=1) < 0) & (of_corner.max(axis=1) > 0)
    whole = np.flatnonzero(~crossed)
    if len(whole) == len(mesh.faces):
        return mesh, whole
    faces, which = mesh.faces[crossed].astype(np.int64), np.flatnonzero(crossed)
    # Turned so that the corner that is alone on its side comes first; of three different sides one that is off.
    alone = np.where((of_corner[crossed] > 0).sum(axis=1) == 1, 1, -1)[:, None]
    turn = (np.argmax(of_corner[crossed] == alone, axis=1)[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(faces, turn, axis=1).T
    vertices, number = _crossings(mesh.vertices, height, side, np.concatenate([a, a]), np.concatenate([b, c]))
    ab, ac = np.split(number, 2)
    pieces = [np.stack(each, axis=1) for each in ((a, ab, ac), (ab, b, c), (ab, c, ac))]
    parent = np.concatenate([whole, which, which, which])
    every = np.concatenate([mesh.faces[whole].astype(np.int64), *pieces])
    kept = (every != np.roll(every, 1, axis=1)).all(axis=1)  # where b or c lies on the plane, a piece has no area
    every, parent = every[kept], parent[kept]
    region = None if mesh.region is None else mesh.region[parent]
    return replace(mesh, vertices=vertices, faces=every.astype(np.int32), region=region), parent


def _crossings(vertices: Floats, height: Floats, side: Ints, start: Ints, end: Ints) -> tuple[Floats, Ints]:
    """The vertices with those where edges from (n,) `start` to `end` cross the plane, and (n,) which these are.

    An edge has one crossing, whichever triangle asks for it; where an end lies on the plane, that end is it.
    """
    edge, place = np.unique(np.stack([np.minimum(start, end), np.maximum(start, end)]), axis=1, return_inverse=True)
    p, q = edge
    number = np.where(side[p] == 0, p, q)
    through = side[p] * side[q] < 0
    number[through] = len(vertices) + np.arange(int(through.sum()))
    p, q = p[through], q[through]
    share = height[p] / (height[p] - height[q])
    new = vertices[p] + share[:, None] * (vertices[q] - vertices[p])
    return np.concatenate([vertices, new]), number[place.ravel()]


def faces_within(mesh: TriangleMesh, low: Floats, high: Floats) -> Ints32:
    """The triangles whose middle lies in a box between (3,) corners [m], the box's sides included."""
    middle = mesh.vertices[mesh.faces].mean(axis=1)
    return np.flatnonzero(((middle >= low) & (middle <= high)).all(axis=1)).astype(np.int32)
