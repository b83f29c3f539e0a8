"""Decimate the reference mesh to the planning mesh, from which viewpoints are generated (Section 3.1).

Three methods work together:

quadric edge collapse   of the library fast_simplification, at several aggressions; gets stuck on the needles that CAD
                        systems write for cylinders and fillets: each collapse there makes a triangle flatter than its
                        guard against folds allows.
remeshing               contracts short edges and splits long ones: a coarse isotropic remeshing without edge flips
                        (after Botsch and Kobbelt 2004, Section 4), after which the collapse succeeds.
vertex clustering       merges all vertices in a cell of a grid (Rossignac, Borrel 1993, "Multi-resolution 3D
                        approximations for rendering complex scenes", doi:10.1007/978-3-642-78114-8_29): 0.3 s for a
                        million faces, where the collapse takes 3 s and 400 MB. It blunts edges by up to a cell, so it
                        is the first step for a mesh with very many faces, and serves for pictures.

Object frame (the axes of the mesh file), metres.
"""

import threading
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError
from planner.geometry.mesh import TriangleMesh, face_cross_products, row_norms, without_unused
from planner.values import Bools, Floats, Ints, Ints32

CLUSTERING_RATIO = 2.5
"""A mesh is clustered if it has at least this many times the wanted faces."""

_AGGRESSIONS = (7, 5, 6, 8, 4)  # in this order; 7 is the library's default, see `decimate`
_INTERMEDIATE = 40  # faces of the intermediate copy per wanted face: close to the mesh, yet fast to collapse again
_TOO_LONG = 2.5  # edges longer than this many face sizes are split: a right triangle then has up to 1.6 times the area
_MANY, _EACH = 200_000, 4  # least faces of a clustered copy, and its faces per wanted face

# Vertex clustering
_CELLS = 3.0  # faces per squared cell side of surface: the surface meets 1.5 cells there, and a vertex has two faces
_OPPOSED = 0.3  # ratio of the summed to the total area of a cell's faces; below: two sides of a wall, or a fold
_THIN = 0.05  # largest share of the area in such cells; above, walls are thinner than a cell

# Remeshing
_SHORT, _LONG = 0.4, 1.2  # edges to contract and to split, in face sizes: leaves about four faces per wanted face
_PASSES = 12  # of contraction and splitting; a cylinder of 2000 needles takes 10
_ROUNDS = 60  # of one contraction: each contracts a set of edges that do not touch; 10^4 needles take about 15
_MIN_AGREEMENT = 0.85  # smallest cosine between a face before and after (32 degrees): no chamfer along a sharp edge

_decimation_lock = threading.Lock()  # fast_simplification keeps its mesh in module globals


def decimate(mesh: TriangleMesh, face_count: int) -> TriangleMesh:
    """Return a coarser copy with about `face_count` faces, by quadric edge collapse.

    The thresholds of the library are absolute, so the mesh is scaled to a diagonal of 1: the result does not depend on
    the unit. A high aggression sometimes leaves edges with more than two faces, a low one stops short of the count. The
    first aggression with neither flaw is taken, else the one with the smallest flaw; from the second on they run on an
    intermediate copy of 40 faces per wanted face. If the needles of a CAD mesh keep it far above the count, this copy
    is remeshed first. A mesh with very many faces is clustered first, and used unclustered if the count is then missed.
    Faces without area and repeated faces are dropped.

    Args:
        mesh: the reference.
        face_count: wanted number of faces, > 0. A mesh with fewer keeps them all; faces far larger than wanted are
            split, so that a box of 12 triangles still gives viewpoints all over its sides.

    Returns:
        The planning mesh. The caller judges a miss of the count (needle-thin parts, several bodies and counts near the
        coarsest closed shape miss).
    """
    if face_count < 1:
        raise PlannerError(f"face_count is {face_count}; it must be at least 1")
    if (coarse := cluster_vertices(mesh, max(_MANY, _EACH * face_count))) is not None:
        mesh_copy = _decimate_clean(coarse, face_count)
        if not _flaws(mesh_copy, face_count)[0]:
            return mesh_copy
    return _decimate_clean(_clean(mesh.vertices, mesh.faces), face_count)


def _decimate_clean(clean: TriangleMesh, face_count: int) -> TriangleMesh:
    """Decimate a mesh whose faces all have an area."""
    if face_count >= len(clean.faces):
        return _split_to_size(clean, face_count)
    middle = (clean.vertices.min(axis=0) + clean.vertices.max(axis=0)) / 2
    diagonal = clean.diagonal
    fine = TriangleMesh((clean.vertices - middle) / diagonal, clean.faces)
    best = _collapse(fine, face_count, _AGGRESSIONS[0])
    if _flaws(best, face_count) != (False, 0):
        intermediate = fine
        if len(fine.faces) > _INTERMEDIATE * face_count:
            coarser = _collapse(fine, _INTERMEDIATE * face_count, _AGGRESSIONS[0])
            stuck = _flaws(coarser, _INTERMEDIATE * face_count)[0]  # a copy that is stuck is crumpled
            intermediate = fine if stuck else coarser
        best = _best(best, intermediate, face_count, _AGGRESSIONS[1:])
        if len(best.faces) > face_count + _allowed_miss(face_count):
            area = float(fine.areas.sum())
            repaired = _clean(*remesh(intermediate.vertices, intermediate.faces, np.sqrt(area / face_count)))
            candidate = _best(repaired, repaired, face_count, _AGGRESSIONS)
            if len(candidate.faces) < len(best.faces) and abs(float(candidate.areas.sum()) / area - 1) < 0.2:
                best = candidate
    return TriangleMesh(best.vertices * diagonal + middle, best.faces)


def collapse_edges(vertices: Floats, faces: Ints32, face_count: int, aggression: int) -> tuple[Floats, Ints32]:
    """Run the quadric edge collapse of the library once; safe to call from several threads.

    Args:
        vertices: (V, 3), scaled to a diagonal of about 1, see `decimate`.
        faces: (F, 3).
        face_count: number of faces at which it stops; each collapse in a closed surface removes two.
        aggression: growth of the error threshold from pass to pass; 7 is the library's default.

    Returns:
        (V', 3) vertices and (F', 3) faces as the library leaves them.
    """
    import fast_simplification  # not loaded by commands that decimate nothing

    with _decimation_lock:
        points, triangles = fast_simplification.simplify(
            np.array(vertices), np.array(faces), target_count=face_count, agg=aggression
        )
    return points.astype(np.float64), triangles.astype(np.int32)


def _split_to_size(mesh: TriangleMesh, face_count: int) -> TriangleMesh:
    """Halve the longest edges until they suit `face_count` faces."""
    longest = _TOO_LONG * np.sqrt(float(mesh.areas.sum()) / face_count)
    vertices, faces = mesh.vertices, mesh.faces
    before = 0
    while before < len(faces) < face_count:  # a needle would be cut into ever more pieces
        before = len(faces)
        vertices, faces = split_long_edges(vertices, faces, longest)
    return TriangleMesh(vertices, faces)


def _best(best: TriangleMesh, mesh: TriangleMesh, face_count: int, aggressions: Sequence[int]) -> TriangleMesh:
    """Return the copy with the smallest flaw: `best`, or `mesh` (diagonal about 1) collapsed at an aggression."""
    for aggression in aggressions:
        flaws = _flaws(best, face_count)
        if flaws == (False, 0) or (len(best.faces) > 2 * face_count and best is not mesh):
            break  # nothing to improve; or stuck on slivers, at any aggression
        best = min(best, _collapse(mesh, face_count, aggression), key=lambda each: _flaws(each, face_count))
    return best


def _collapse(mesh: TriangleMesh, face_count: int, aggression: int) -> TriangleMesh:
    """Collapse edges once and clean the result; return the mesh itself if no face is left."""
    vertices, faces = collapse_edges(mesh.vertices, mesh.faces, face_count, aggression)
    return _clean(vertices, faces) if len(faces) else mesh


def _flaws(mesh: TriangleMesh, face_count: int) -> tuple[bool, int]:
    """Return whether the count is missed, and the number of edges with more than two faces plus the miss."""
    miss = abs(len(mesh.faces) - face_count)
    crowded = int((unique_edges(mesh.faces)[1] > 2).sum())
    return miss > _allowed_miss(face_count), crowded + max(miss - 2, 0)


def _allowed_miss(face_count: int) -> float:
    return 2 + 0.02 * face_count


def _clean(vertices: Floats, faces: NDArray[np.integer]) -> TriangleMesh:
    """Drop faces without area, repeated faces and unused vertices; the order stays."""
    extent = float(np.ptp(vertices[faces.ravel()], axis=0).max())
    twice = row_norms(face_cross_products(vertices, faces))
    remaining = faces[twice > 1e-14 * extent**2]  # below, the cross product is rounding
    low, between, high = np.sort(remaining, axis=1).T
    order = np.lexsort((high, between, low))  # stable: of equal faces the first stays
    again = (np.diff(low[order]) == 0) & (np.diff(between[order]) == 0) & (np.diff(high[order]) == 0)
    remaining = np.delete(remaining, order[1:][again], axis=0)
    if not len(remaining):
        raise PlannerError("no face of the mesh has an area; a surface needs at least one")
    return without_unused(vertices, remaining)


def cluster_vertices(mesh: TriangleMesh, face_count: int) -> TriangleMesh | None:
    """Return a copy with about `face_count` (> 0) faces, in which a vertex replaces all vertices of a grid cell.

    Coincident faces with opposite windings cancel, as those of a fold do. Regions are ignored.

    Returns:
        The copy, each vertex the mean of the ones that it replaces. None if the mesh has less than `CLUSTERING_RATIO`
        times the faces, or walls so thin that their two sides would fall into one.
    """
    if len(mesh.faces) < CLUSTERING_RATIO * face_count:
        return None
    side = np.sqrt(_CELLS * float(mesh.areas.sum()) / face_count)
    cells = ((mesh.vertices - mesh.vertices.min(axis=0)) / side).astype(np.int64)
    count = cells.max(axis=0) + 1
    _, cell = np.unique((cells[:, 0] * count[1] + cells[:, 1]) * count[2] + cells[:, 2], return_inverse=True)
    if _thin_share(mesh, cell[mesh.faces[:, 0]]) > _THIN:
        return None
    members = np.bincount(cell)
    vertices = np.stack([np.bincount(cell, weights=axis) / members for axis in mesh.vertices.T], axis=1)
    faces = cell.astype(np.int32)[mesh.faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    remaining = _cancel_opposite(faces, len(vertices))
    return without_unused(vertices, remaining) if len(remaining) else None


def _thin_share(mesh: TriangleMesh, cell: Ints) -> float:
    """Return the share of the area in cells whose faces oppose each other; `cell` (F,) is the cell of each face."""
    twice = face_cross_products(mesh.vertices, mesh.faces)
    summed = np.linalg.norm([np.bincount(cell, weights=axis) for axis in twice.T], axis=0)
    area = np.bincount(cell, weights=2 * mesh.areas)
    return float(area[summed < _OPPOSED * area].sum() / area.sum())


def _cancel_opposite(faces: Ints32, n_vertices: int) -> Ints32:
    """Keep one of the faces with the same corners where their windings do not cancel, none where they do."""
    first = faces.argmin(axis=1)[:, None]
    turned = np.take_along_axis(faces, (first + np.arange(3)) % 3, axis=1)
    low, high = np.minimum(turned[:, 1], turned[:, 2]), np.maximum(turned[:, 1], turned[:, 2])
    _, pair = np.unique(turned[:, 0] * np.int64(n_vertices) + low, return_inverse=True)
    _, at, same = np.unique(pair * np.int64(n_vertices) + high, return_index=True, return_inverse=True)
    winding = np.where(turned[:, 1] < turned[:, 2], 1.0, -1.0)
    net = np.bincount(same, weights=winding)
    return np.asarray(np.where((net * winding[at] < 0)[:, None], turned[at][:, [0, 2, 1]], turned[at])[net != 0])


def remesh(vertices: Floats, faces: Ints32, face_size: float) -> tuple[Floats, Ints32]:
    """Return about the same surface with triangles that are neither needles nor too large.

    Args:
        vertices: (V, 3), any unit.
        faces: (F, 3).
        face_size: square root of the wanted area of a face, same unit.

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
    """Contract edges below a limit, each onto the end at which the surface bends more.

    An edge stays if contraction would pinch the surface (its ends share another neighbour than those of its own faces)
    or turn a face by more than 32 degrees.

    Args:
        vertices: (V, 3), any unit.
        faces: (F, 3).
        shortest: the limit, same unit.

    Returns:
        (V, 3) the same vertices, and (F', 3) the remaining faces, of the same winding.
    """
    order = np.random.default_rng(0)  # breaks ties between edges only; the same in every call
    for _ in range(_ROUNDS):
        edges, degree = unique_edges(faces)
        length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
        short = length < shortest
        short[short] = _common_neighbours(edges, edges[short], len(vertices)) == degree[short]
        edges = edges[short][order.permutation(int(short.sum()))]
        bend = _bend(vertices, faces)
        firsts = np.where(bend[edges[:, 0]] >= bend[edges[:, 1]], edges[:, 0], edges[:, 1])
        edges = np.stack([firsts, edges.sum(axis=1) - firsts], axis=1)
        edges = edges[~_turns_a_face(vertices, faces, edges)]
        edges = _independent(edges, faces, len(vertices))
        if not len(edges):
            break
        target = np.arange(len(vertices), dtype=np.int32)
        target[edges[:, 1]] = edges[:, 0]
        faces = target[faces]
        faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    return vertices, faces


def split_long_edges(vertices: Floats, faces: Ints32, longest: float) -> tuple[Floats, Ints32]:
    """Halve the edges above a limit that are the longest of one of their faces, once.

    Splitting only the longest side of a needle makes it stouter; halving all three would keep its shape. An edge is
    split in all its faces, so that a closed mesh stays closed.

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
    is_split = (squared > longest**2) & (squared >= squared.max(axis=1, keepdims=True) * (1 - 1e-9))
    edge = np.unique(key[is_split])
    if not len(edge):
        return vertices, faces
    place = np.minimum(np.searchsorted(edge, key), len(edge) - 1)
    middle = np.where(edge[place] == key, len(vertices) + place, -1).astype(np.int32)
    vertices = np.vstack([vertices, (vertices[edge // len(vertices)] + vertices[edge % len(vertices)]) / 2])
    return vertices, _split_at_middles(vertices, faces, middle)


def unique_edges(faces: Ints32) -> tuple[Ints32, Ints]:
    """Return (E, 2) undirected edges of faces (F, 3), and (E,) the number of faces of each."""
    size = int(faces.max()) + 1
    ends = faces, np.roll(faces, -1, axis=1)
    key, count = np.unique(np.minimum(*ends) * np.int64(size) + np.maximum(*ends), return_counts=True)
    return np.stack([key // size, key % size], axis=1).astype(np.int32), count


def _common_neighbours(edges: Ints32, selection: Ints32, n_vertices: int) -> Ints:
    """Return for each selected edge the number of vertices that are connected with both its ends."""
    from scipy.sparse import coo_array  # not loaded by commands that decimate nothing

    rows, columns = np.concatenate([edges, edges[:, ::-1]]).T
    graph = coo_array((np.ones(len(rows), np.int32), (rows, columns)), shape=(n_vertices, n_vertices)).tocsr()
    shared = graph[selection[:, 0]].multiply(graph[selection[:, 1]]).sum(axis=1)
    return np.asarray(shared, np.int64).ravel()


def _bend(vertices: Floats, faces: Ints32) -> Floats:
    """Return (V,) 0 if the faces at a vertex lie in one plane, up to 1 if their normals diverge."""
    normals = face_cross_products(vertices, faces)
    total, size = np.zeros((len(vertices), 3)), np.zeros(len(vertices))
    for corner in range(3):
        np.add.at(total, faces[:, corner], normals)
        np.add.at(size, faces[:, corner], np.linalg.norm(normals, axis=1))
    loss = 1 - np.divide(np.linalg.norm(total, axis=1), size, out=np.ones(len(size)), where=size > 0)
    return np.asarray(np.round(loss, 6))  # so that rounding does not decide between equals


def _turns_a_face(vertices: Floats, faces: Ints32, edges: Ints32) -> Bools:
    """Return for each edge whether moving its second end onto its first turns a face too far."""
    corner_of = np.argsort(faces.ravel(), kind="stable")
    start = np.searchsorted(faces.ravel()[corner_of], np.arange(len(vertices) + 1))
    count = start[edges[:, 1] + 1] - start[edges[:, 1]]
    edge = np.repeat(np.arange(len(edges)), count)
    within = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)
    corner = corner_of[np.repeat(start[edges[:, 1]], count) + within]
    face = faces[corner // 3].copy()
    is_removed = (face == edges[edge, :1]).any(axis=1)
    before = face_cross_products(vertices, face)
    face[np.arange(len(face)), corner % 3] = edges[edge, 0]
    after = face_cross_products(vertices, face)
    agreement = np.einsum("nj,nj->n", before, after)
    size = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
    bad = ~is_removed & (agreement < _MIN_AGREEMENT * size)
    return np.bincount(edge[bad], minlength=len(edges)) > 0


def _independent(edges: Ints32, faces: Ints32, n_vertices: int) -> Ints32:
    """Return edges of which no two touch the same face, earlier ones preferred."""
    rank = np.arange(len(edges))
    best = np.full(n_vertices, len(edges))
    np.minimum.at(best, edges[:, 0], rank)
    np.minimum.at(best, edges[:, 1], rank)
    of_face = best[faces].min(axis=1)
    lowest = best.copy()
    for corner in range(3):
        np.minimum.at(lowest, faces[:, corner], of_face)
    return np.asarray(edges[(lowest[edges[:, 0]] == rank) & (lowest[edges[:, 1]] == rank)])


def _split_at_middles(vertices: Floats, faces: Ints32, middle: Ints32) -> Ints32:
    """Cut faces at the middles (F, 3) of their sides 0-1, 1-2 and 2-0: indices of vertices, -1 for an uncut side."""
    count = (middle >= 0).sum(axis=1)
    # Turn each face so that a split side comes first, and of two split sides the uncut one last.
    first = np.where(count == 2, (np.argmin(middle, axis=1) + 1) % 3, np.argmax(middle >= 0, axis=1))
    turn = (first[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(faces, turn, axis=1).T
    ab, bc, ca = np.take_along_axis(middle, turn, axis=1).T
    one, two, three = (count == n for n in (1, 2, 3))
    shorter = np.linalg.norm(vertices[a] - vertices[bc], axis=1) < np.linalg.norm(vertices[ab] - vertices[c], axis=1)

    def pieces(selection: Bools, *corners: tuple[Ints32, Ints32, Ints32]) -> list[Ints32]:
        return [np.stack([p[selection], q[selection], r[selection]], axis=1) for p, q, r in corners]

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
