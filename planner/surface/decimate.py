"""The planning mesh: a coarser copy of the reference, from which viewpoints are generated (Section 3.1).

Object frame (the mesh file's axes), metres.
"""

import threading
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError
from planner.surface.cluster import clustered
from planner.surface.mesh import TriangleMesh, cross_products, lengths
from planner.surface.remesh import edges_of, split_long_edges, stout
from planner.values import Floats, Ints32

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
    count, that copy is made stout (see `planner.surface.remesh`). A mesh with very many faces is clustered first (see
    `planner.surface.cluster`), and taken as it is where the count is missed then. Faces without area and faces that
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
