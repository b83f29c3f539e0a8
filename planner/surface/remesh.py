"""Make a mesh of slivers stout: contract its short edges and split its long ones.

Quadric edge collapse with a guard against folded triangles gets stuck on the needles that CAD systems write for
cylinders and fillets: there, every collapse makes a triangle flatter than the guard allows. After one pass of this, a
coarse isotropic remeshing without edge flips (after Botsch and Kobbelt 2004, Section 4), the collapse goes through.
"""

import numpy as np
from scipy.sparse import coo_array

from planner.surface.mesh import cross_products
from planner.values import Bools, Floats, Ints, Ints32

_SHORT, _LONG = 0.4, 1.2  # edges to contract and to split, in face sizes: leaves about four faces for each one wanted
_PASSES = 12  # of contracting and splitting; a cylinder of 2000 needles takes 10
_ROUNDS = 60  # of one contraction: each contracts a set of edges that do not touch; 10^4 needles take about 15
_LEAST_AGREEMENT = 0.85  # cosine by which a contraction may turn a face (32 degrees): no chamfer along a sharp edge


def stout(vertices: Floats, faces: Ints32, face_size: float) -> tuple[Floats, Ints32]:
    """A mesh of about the same surface whose triangles are neither needles nor larger than wanted.

    Args:
        vertices: (V, 3), any unit.
        faces: (F, 3).
        face_size: square root of the area of a face as wanted, same unit.

    Returns:
        (V', 3) vertices and (F', 3) faces of the same winding.
    """
    for _ in range(_PASSES):
        vertices, faces = contract_short_edges(vertices, faces, _SHORT * face_size)
        before = len(faces)
        vertices, faces = split_long_edges(vertices, faces, _LONG * face_size)
        if len(faces) == before:
            break
    return vertices, faces


def contract_short_edges(vertices: Floats, faces: Ints32, shortest: float) -> tuple[Floats, Ints32]:
    """Contract edges below a limit, each onto its end at which the surface bends more.

    An edge stays where contracting it would pinch the surface (its ends have another common neighbour than those of its
    own faces) or turn a face by more than 32 degrees.

    Args:
        vertices: (V, 3), any unit.
        faces: (F, 3).
        shortest: the limit, same unit.

    Returns:
        (V, 3) the same vertices, and (F', 3) the faces that remain, of the same winding.
    """
    order = np.random.default_rng(0)  # only breaks ties between edges; the same every time
    for _ in range(_ROUNDS):
        edges, degree = edges_of(faces)
        length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
        short = length < shortest
        short[short] = _common_neighbours(edges, edges[short], len(vertices)) == degree[short]
        edges = edges[short][order.permutation(int(short.sum()))]
        bend = _bend(vertices, faces)
        kept = np.where(bend[edges[:, 0]] >= bend[edges[:, 1]], edges[:, 0], edges[:, 1])
        edges = np.stack([kept, edges.sum(axis=1) - kept], axis=1)
        edges = edges[~_turns_a_face(vertices, faces, edges)]
        edges = _apart(edges, faces, len(vertices))
        if not len(edges):
            break
        target = np.arange(len(vertices), dtype=np.int32)
        target[edges[:, 1]] = edges[:, 0]
        faces = target[faces]
        faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    return vertices, faces


def split_long_edges(vertices: Floats, faces: Ints32, longest: float) -> tuple[Floats, Ints32]:
    """Halve the edges above a limit that are the longest of one of their faces, once.

    Taking only the longest side of a needle makes it stouter, where halving all three sides would leave its shape. An
    edge is split in all its faces alike, so that the mesh stays as closed as it was.

    Args:
        vertices: (V, 3), any unit.
        faces: (F, 3).
        longest: the limit, same unit.

    Returns:
        (V', 3) vertices, the first V unchanged, and (F', 3) faces of the same winding.
    """
    corners = vertices[faces]
    sides = np.roll(corners, -1, axis=1) - corners
    squared = np.einsum("fej,fej->fe", sides, sides)
    start, end = faces, np.roll(faces, -1, axis=1)
    key = np.minimum(start, end).astype(np.int64) * len(vertices) + np.maximum(start, end)
    chosen = (squared > longest**2) & (squared >= squared.max(axis=1, keepdims=True) * (1 - 1e-9))
    edge = np.unique(key[chosen])
    if not len(edge):
        return vertices, faces
    place = np.minimum(np.searchsorted(edge, key), len(edge) - 1)
    middle = np.where(edge[place] == key, len(vertices) + place, -1).astype(np.int32)
    vertices = np.vstack([vertices, (vertices[edge // len(vertices)] + vertices[edge % len(vertices)]) / 2])
    return vertices, _split(vertices, faces, middle)


def edges_of(faces: Ints32) -> tuple[Ints32, Ints]:
    """(E, 2) undirected edges of faces (F, 3), and (E,) how many faces each has."""
    size = int(faces.max()) + 1
    ends = faces, np.roll(faces, -1, axis=1)
    key, count = np.unique(np.minimum(*ends) * np.int64(size) + np.maximum(*ends), return_counts=True)
    return np.stack([key // size, key % size], axis=1).astype(np.int32), count


def _common_neighbours(edges: Ints32, chosen: Ints32, n_vertices: int) -> Ints:
    """How many vertices both ends of each chosen edge are connected with."""
    rows, columns = np.concatenate([edges, edges[:, ::-1]]).T
    graph = coo_array((np.ones(len(rows), np.int32), (rows, columns)), shape=(n_vertices, n_vertices)).tocsr()
    shared = graph[chosen[:, 0]].multiply(graph[chosen[:, 1]]).sum(axis=1)
    return np.asarray(shared, np.int64).ravel()


def _bend(vertices: Floats, faces: Ints32) -> Floats:
    """(V,) 0 where the faces about a vertex lie in one plane, up to 1 where they face apart."""
    normals = cross_products(vertices, faces)
    total, size = np.zeros((len(vertices), 3)), np.zeros(len(vertices))
    for corner in range(3):
        np.add.at(total, faces[:, corner], normals)
        np.add.at(size, faces[:, corner], np.linalg.norm(normals, axis=1))
    lost = 1 - np.divide(np.linalg.norm(total, axis=1), size, out=np.ones(len(size)), where=size > 0)
    return np.asarray(np.round(lost, 6))  # so that rounding does not decide between equals


def _turns_a_face(vertices: Floats, faces: Ints32, edges: Ints32) -> Bools:
    """Whether moving an edge's second end onto its first turns a face about that end too far."""
    corner_of = np.argsort(faces.ravel(), kind="stable")
    start = np.searchsorted(faces.ravel()[corner_of], np.arange(len(vertices) + 1))
    count = start[edges[:, 1] + 1] - start[edges[:, 1]]
    edge = np.repeat(np.arange(len(edges)), count)
    corner = corner_of[
        np.repeat(start[edges[:, 1]], count) + np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)
    ]
    face = faces[corner // 3].copy()
    gone = (face == edges[edge, :1]).any(axis=1)
    before = cross_products(vertices, face)
    face[np.arange(len(face)), corner % 3] = edges[edge, 0]
    after = cross_products(vertices, face)
    agreement = np.einsum("nj,nj->n", before, after)
    size = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
    bad = ~gone & (agreement < _LEAST_AGREEMENT * size)
    return np.bincount(edge[bad], minlength=len(edges)) > 0


def _apart(edges: Ints32, faces: Ints32, n_vertices: int) -> Ints32:
    """A part of the edges, earlier ones preferred, such that no face touches two of them."""
    rank = np.arange(len(edges))
    best = np.full(n_vertices, len(edges))
    np.minimum.at(best, edges[:, 0], rank)
    np.minimum.at(best, edges[:, 1], rank)
    of_face = best[faces].min(axis=1)
    least = best.copy()
    for corner in range(3):
        np.minimum.at(least, faces[:, corner], of_face)
    return np.asarray(edges[(least[edges[:, 0]] == rank) & (least[edges[:, 1]] == rank)])


def _split(vertices: Floats, faces: Ints32, middle: Ints32) -> Ints32:
    """The faces cut at the middles of their sides 0-1, 1-2 and 2-0: (F, 3) vertices, -1 where a side stays whole."""
    count = (middle >= 0).sum(axis=1)
    # Turned so that one marked side comes first, and of two marked sides the whole one last.
    first = np.where(count == 2, (np.argmin(middle, axis=1) + 1) % 3, np.argmax(middle >= 0, axis=1))
    turn = (first[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(faces, turn, axis=1).T
    ab, bc, ca = np.take_along_axis(middle, turn, axis=1).T
    one, two, three = (count == n for n in (1, 2, 3))
    shorter = np.linalg.norm(vertices[a] - vertices[bc], axis=1) < np.linalg.norm(vertices[ab] - vertices[c], axis=1)

    def pieces(chosen: Bools, *corners: tuple[Ints32, Ints32, Ints32]) -> list[Ints32]:
        return [np.stack([p[chosen], q[chosen], r[chosen]], axis=1) for p, q, r in corners]

    return np.concatenate(
        [
            faces[count == 0],
            *pieces(one, (a, ab, c), (ab, b, c)),
            *pieces(two, (ab, b, bc)),
            *pieces(two & shorter, (a, ab, bc), (a, bc, c)),
            *pieces(two & ~shorter, (a, ab, c), (ab, bc, c)),
            *pieces(three, (a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)),
        ]
    )
