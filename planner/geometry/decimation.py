"""The planning mesh: a coarser copy of the reference, from which viewpoints are generated (Section 3.1).

Object frame (the mesh file's axes), metres.

A coarse copy of a mesh with very many faces: one vertex for all that lie in a cell of a grid.

Vertex clustering (Rossignac, Borrel 1993, "Multi-resolution 3D approximations for rendering complex scenes",
doi:10.1007/978-3-642-78114-8_29) takes 0.3 s for a million faces, where edge collapse takes 3 s and 400 MB. Edges are
blunted by up to a cell, so it serves where the copy is far finer than what is made of it, and for pictures.

Make a mesh of slivers stout: contract its short edges and split its long ones.

Quadric edge collapse with a guard against folded triangles gets stuck on the needles that CAD systems write for
cylinders and fillets: there, every collapse makes a triangle flatter than the guard allows. After one pass of this, a
coarse isotropic remeshing without edge flips (after Botsch and Kobbelt 2004, Section 4), the collapse goes through.
"""

import threading
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array

from planner.errors import PlannerError
from planner.geometry.mesh import TriangleMesh, cross_products, lengths
from planner.values import Bools, Floats, Ints, Ints32

_AGGRESSIONS = (7, 5, 6, 8, 4)  # in this order; 7 is the library's default, see `decimate`
_BETWEEN = 40  # faces of the copy between, for each one wanted: fine enough to be taken for the mesh, quick to try on
_TOO_LONG = 2.5  # edges above so many face sizes are split: a right triangle then has at most 1.6 times the wanted area

_MANY, _EACH = 200_000, 4  # faces, and for each one wanted, of the copy that is made first of a mesh with far more

_decimation_lock = threading.Lock()  # fast_simplification keeps its mesh in module globals


def decimate(mesh: TriangleMesh, face_count: int) -> TriangleMesh:
    """A coarser copy with about so many faces, by quadric edge collapse.

    The library's thresholds are absolute, so the mesh is brought to a diagonal of 1 first: the result does not depend
    on the unit. At a high aggression it sometimes leaves edges with more than two faces, at a low one it stops short of
    the count; the first aggression that does neither is taken, else the one that came nearest; from the second on they
    are tried on a copy between, of 40 faces to each one wanted. Where the needles of a CAD mesh hold it far above the
    count, that copy is made stout (`stout`). A mesh with very many faces is clustered first
    (`clustered`), and taken as it is where the count is missed then. Faces without area and faces that
    appear twice are dropped from the result.

    Args:
        mesh: the reference, object frame.
        face_count: how many faces to keep, > 0. A mesh that has no more keeps them all; faces far larger than wanted
            are split, so that a box of 12 triangles still gives viewpoints all over its sides.

    Returns:
        The planning mesh, object frame. The count that came out is `len(result.faces)`: a miss is the caller's to judge
        (needle-thin parts, several bodies or a count near the coarsest closed shape miss).

    Raises:
        PlannerError: if `face_count` is not positive, or no face has an area.
    """
    if face_count < 1:
        raise PlannerError(f"face_count is {face_count}; it must be at least 1")
    if (coarse := clustered(mesh, max(_MANY, _EACH * face_count))) is not None:
        found = _decimated(coarse, face_count)
        if not _flaws(found, face_count)[0]:
            return found
    return _decimated(_clean(mesh.vertices, mesh.faces), face_count)


def _decimated(clean: TriangleMesh, face_count: int) -> TriangleMesh:
    """As `decimate`, of a mesh without faces of no area."""
    if face_count >= len(clean.faces):
        return _split(clean, face_count)
    middle = (clean.vertices.min(axis=0) + clean.vertices.max(axis=0)) / 2
    diagonal = clean.diagonal
    fine = TriangleMesh((clean.vertices - middle) / diagonal, clean.faces)
    best = _collapsed(fine, face_count, _AGGRESSIONS[0])
    if _flaws(best, face_count) == (False, 0):
        return TriangleMesh(best.vertices * diagonal + middle, best.faces)
    between = fine
    if len(fine.faces) > _BETWEEN * face_count:
        coarser = _collapsed(fine, _BETWEEN * face_count, _AGGRESSIONS[0])
        between = fine if _flaws(coarser, _BETWEEN * face_count)[0] else coarser  # a copy that is stuck is crumpled
    best = _best(best, between, face_count, _AGGRESSIONS[1:])
    if len(best.faces) > face_count + _allowed_miss(face_count):
        area = float(fine.areas.sum())
        repaired = _clean(*stout(between.vertices, between.faces, np.sqrt(area / face_count)))
        candidate = _best(repaired, repaired, face_count, _AGGRESSIONS)
        if len(candidate.faces) < len(best.faces) and abs(float(candidate.areas.sum()) / area - 1) < 0.2:
            best = candidate
    return TriangleMesh(best.vertices * diagonal + middle, best.faces)


def collapse_edges(vertices: Floats, faces: Ints32, face_count: int, aggression: int) -> tuple[Floats, Ints32]:
    """One run of the library's quadric edge collapse, safe to call from several threads.

    Args:
        vertices: (V, 3), scaled to a diagonal of about 1, see `decimate`.
        faces: (F, 3).
        face_count: how many faces to stop at; each collapse in a closed surface removes two.
        aggression: how fast the error threshold grows from pass to pass; 7 is the library's default.

    Returns:
        (V', 3) vertices and (F', 3) faces as the library leaves them.
    """
    import fast_simplification  # kept out of the start-up of commands that decimate nothing

    with _decimation_lock:
        points, triangles = fast_simplification.simplify(
            np.array(vertices), np.array(faces), target_count=face_count, agg=aggression
        )
    return points.astype(np.float64), triangles.astype(np.int32)


def _split(mesh: TriangleMesh, face_count: int) -> TriangleMesh:
    """The same surface, its longest edges halved until they suit `face_count` faces; a mesh that does stays."""
    longest = _TOO_LONG * np.sqrt(float(mesh.areas.sum()) / face_count)
    vertices, faces = mesh.vertices, mesh.faces
    before = 0
    while before < len(faces) < face_count:  # a needle would be cut into ever more pieces
        before = len(faces)
        vertices, faces = split_long_edges(vertices, faces, longest)
    return TriangleMesh(vertices, faces)


def _best(best: TriangleMesh, mesh: TriangleMesh, face_count: int, aggressions: Sequence[int]) -> TriangleMesh:
    """The best of what is known and of the mesh collapsed at several aggressions; its diagonal is about 1."""
    for aggression in aggressions:
        flaws = _flaws(best, face_count)
        if flaws == (False, 0) or (len(best.faces) > 2 * face_count and best is not mesh):
            break  # nothing to improve; or stuck on slivers, at any aggression
        best = min(best, _collapsed(mesh, face_count, aggression), key=lambda each: _flaws(each, face_count))
    return best


def _collapsed(mesh: TriangleMesh, face_count: int, aggression: int) -> TriangleMesh:
    """The mesh after one run of the library, tidied; the mesh itself where nothing is left of it."""
    vertices, faces = collapse_edges(mesh.vertices, mesh.faces, face_count, aggression)
    return _clean(vertices, faces) if len(faces) else mesh


def _flaws(mesh: TriangleMesh, face_count: int) -> tuple[bool, int]:
    """Whether the count is missed, then the number of edges of more than two faces and by how much it is missed."""
    miss = abs(len(mesh.faces) - face_count)
    crowded = int((edges_of(mesh.faces)[1] > 2).sum())
    return miss > _allowed_miss(face_count), crowded + max(miss - 2, 0)


def _allowed_miss(face_count: int) -> float:
    """Faces by which the count may be missed before another way is tried."""
    return 2 + 0.02 * face_count


def _clean(vertices: Floats, faces: NDArray[np.integer]) -> TriangleMesh:
    """Drop faces without area, faces that appear twice and vertices that no face uses; the order stays."""
    extent = float(np.ptp(vertices[faces.ravel()], axis=0).max())
    twice = lengths(cross_products(vertices, faces))
    kept = faces[twice > 1e-14 * extent**2]  # below, the cross product is rounding
    low, between, high = np.sort(kept, axis=1).T
    order = np.lexsort((high, between, low))  # stable: of equal faces the first stays
    again = (np.diff(low[order]) == 0) & (np.diff(between[order]) == 0) & (np.diff(high[order]) == 0)
    kept = np.delete(kept, order[1:][again], axis=0)
    if not len(kept):
        raise PlannerError("no face of the mesh has an area; a surface needs at least one")
    used, compact = np.unique(kept, return_inverse=True)
    return TriangleMesh(vertices[used], compact.reshape(-1, 3).astype(np.int32))


FAR = 2.5
"""A mesh is clustered where it has so many times the faces that are wanted."""

_CELLS = 3.0  # faces for each cell's side squared in the surface: it meets 1.5 cells, and a vertex has two faces
_OPPOSED = 0.3  # of its area is what the faces of a cell face together: below, they are two sides of a wall, or a fold
_THIN = 0.05  # of the area that may be such: with more, walls are thinner than a cell


def clustered(mesh: TriangleMesh, face_count: int) -> TriangleMesh | None:
    """The copy, with about so many faces.

    Faces that come to lie on each other with opposite windings cancel, as those of a fold do.

    Args:
        mesh: any frame; its regions are not looked at.
        face_count: how many faces are wanted, > 0.

    Returns:
        The copy, each vertex in the middle of those that it stands for; None where the mesh has less than `FAR` times
        the faces, or walls so thin that their two sides would fall into one.
    """
    if len(mesh.faces) < FAR * face_count:
        return None
    side = np.sqrt(_CELLS * float(mesh.areas.sum()) / face_count)
    cells = ((mesh.vertices - mesh.vertices.min(axis=0)) / side).astype(np.int64)
    count = cells.max(axis=0) + 1
    _, cell = np.unique((cells[:, 0] * count[1] + cells[:, 1]) * count[2] + cells[:, 2], return_inverse=True)
    if _share_of_walls(mesh, cell[mesh.faces[:, 0]]) > _THIN:
        return None
    members = np.bincount(cell)
    vertices = np.stack([np.bincount(cell, weights=axis) / members for axis in mesh.vertices.T], axis=1)
    faces = cell.astype(np.int32)[mesh.faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    kept = _uncancelled(faces, len(vertices))
    if not len(kept):
        return None
    used, compact = np.unique(kept, return_inverse=True)
    return TriangleMesh(vertices[used], compact.reshape(-1, 3).astype(np.int32))


def _share_of_walls(mesh: TriangleMesh, cell: Ints) -> float:
    """Share of the area whose faces, by the (F,) cell of each, face against those of their cell."""
    twice = cross_products(mesh.vertices, mesh.faces)
    together = np.linalg.norm([np.bincount(cell, weights=axis) for axis in twice.T], axis=0)
    area = np.bincount(cell, weights=2 * mesh.areas)
    return float(area[together < _OPPOSED * area].sum() / area.sum())


def _uncancelled(faces: Ints32, n_vertices: int) -> Ints32:
    """The faces, of those with the same corners one where the windings do not cancel, none where they do."""
    first = faces.argmin(axis=1)[:, None]
    turned = np.take_along_axis(faces, (first + np.arange(3)) % 3, axis=1)
    low, high = np.minimum(turned[:, 1], turned[:, 2]), np.maximum(turned[:, 1], turned[:, 2])
    _, pair = np.unique(turned[:, 0] * np.int64(n_vertices) + low, return_inverse=True)
    _, at, same = np.unique(pair * np.int64(n_vertices) + high, return_index=True, return_inverse=True)
    winding = np.where(turned[:, 1] < turned[:, 2], 1.0, -1.0)
    left = np.bincount(same, weights=winding)
    return np.asarray(np.where((left * winding[at] < 0)[:, None], turned[at][:, [0, 2, 1]], turned[at])[left != 0])


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
    return vertices, _split_faces(vertices, faces, middle)


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


def _split_faces(vertices: Floats, faces: Ints32, middle: Ints32) -> Ints32:
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
