"""Holes of a mesh: its open boundary loops, and faces that close them.

A closing face is invented, so it is marked. A loop is closed by a fan round its middle, which is what can be said about
a region of which nothing was measured; the fan may cut through the part where the rim of a hole is strongly bent.
"""

import numpy as np
from numpy.typing import NDArray

from planner.geometry.mesh import TriangleMesh


def boundary_loops(mesh: TriangleMesh) -> list[NDArray[np.int32]]:
    """Closed walks along the edges that belong to one face only, each against the direction of its faces.

    Where several loops touch in a vertex the walk is cut there into simple loops.

    Returns:
        One array of vertex indices per loop, in order of the smallest directed edge.
    """
    count = np.int64(len(mesh.vertices))
    directed = mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
    key = np.minimum(directed[:, 0], directed[:, 1]) * count + np.maximum(directed[:, 0], directed[:, 1])
    order = np.argsort(key, kind="stable")
    ordered = key[order]
    differs = np.concatenate([[True], ordered[1:] != ordered[:-1], [True]])
    is_open = order[differs[1:] & differs[:-1]]
    following: dict[int, list[int]] = {}
    for end, start in directed[is_open].tolist():
        following.setdefault(start, []).append(end)
    loops: list[NDArray[np.int32]] = []
    for first in sorted(following):
        while following[first]:
            walk, place = [first], {first: 0}
            while following.get(walk[-1]):
                vertex = following[walk[-1]].pop(0)
                if vertex in place:
                    since = place[vertex]
                    loops.append(np.array(walk[since:], dtype=np.int32))
                    for left in walk[since + 1 :]:
                        del place[left]
                    del walk[since + 1 :]
                else:
                    place[vertex] = len(walk)
                    walk.append(vertex)
            if len(walk) == 1 and not following[first]:
                break
    return loops


def close_holes(mesh: TriangleMesh, *, close: bool) -> tuple[TriangleMesh, NDArray[np.bool_], int]:
    """Count the holes and, if asked, close them.

    Args:
        mesh: object frame.
        close: whether to add faces.

    Returns:
        The mesh, (F,) True for faces that were added (they stand last), and the number of holes found.
    """
    loops = boundary_loops(mesh)
    if not close or not loops:
        return mesh, np.zeros(len(mesh.faces), dtype=np.bool_), len(loops)
    vertices, faces = [mesh.vertices], [mesh.faces]
    middle = len(mesh.vertices)
    for loop in loops:
        after = np.roll(loop, -1)
        if len(loop) == 3:
            faces.append(loop[None, :])
        elif len(loop) > 3:
            vertices.append(mesh.vertices[loop].mean(axis=0, keepdims=True))
            faces.append(np.stack([loop, after, np.full(len(loop), middle, dtype=np.int32)], axis=1))
            middle += 1
    result = TriangleMesh(np.concatenate(vertices), np.concatenate(faces))
    return result, np.arange(len(result.faces)) >= len(mesh.faces), len(loops)
