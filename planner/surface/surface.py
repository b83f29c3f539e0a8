"""The part's surface: triangle mesh, its decimated copy, and the samples that stand for it (Sections 3.1 and 3.2).

The *reference* mesh is the part; the *planning* mesh is its decimated copy, from which viewpoints are generated.
Coverage is a sum of the areas of samples of the reference. Object frame (the mesh file's axes), metres.
"""

import threading
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError
from planner.surface.closest import closest_face
from planner.surface.remesh import split_long_edges, stout
from planner.values import readonly

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

_AGGRESSIONS = (7, 5, 6, 8, 4)  # in this order; 7 is the library's default, see `decimate`
_TOO_LONG = 2.5  # edges above so many face sizes are split: a right triangle then has at most 1.6 times the wanted area
_GOLDEN = 0.6180339887498949  # the most irrational step: its multiples modulo 1 are the most evenly spread
_decimation_lock = threading.Lock()  # fast_simplification keeps its mesh in module globals


@dataclass(frozen=True, slots=True, eq=False)
class TriangleMesh:
    """A triangle mesh; a face's corners turn counter-clockwise when seen from outside.

    Attributes:
        vertices: (V, 3) [m], object frame.
        faces: (F, 3) int32 indices of vertices, F > 0.
        diagonal: length of the bounding box's diagonal [m]; tolerances are shares of it.
    """

    vertices: Floats
    faces: Ints
    diagonal: float = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices", readonly("vertices", self.vertices, (None, 3)))
        object.__setattr__(self, "faces", readonly("faces", self.faces, (None, 3), np.int32))
        if not np.isfinite(self.vertices).all():
            raise PlannerError("vertices contains infinity; every coordinate must be finite")
        if not len(self.faces):
            raise PlannerError("faces is empty; a mesh needs at least one face")
        if self.faces.min() < 0 or self.faces.max() >= len(self.vertices):
            raise PlannerError(
                f"faces refers to vertices {self.faces.min()} to {self.faces.max()}; "
                f"valid are 0 to {len(self.vertices) - 1}"
            )
        object.__setattr__(self, "diagonal", float(np.linalg.norm(np.ptp(self.vertices, axis=0))))


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceSamples:
    """Surface features: the rows of the measurability matrix, or the points on which coverage is measured.

    Attributes:
        points: (S, 3) [m], object frame.
        normals: (S, 3) outward unit normals, object frame.
        areas: (S,) area that each one stands for [m^2].
        face: (S,) int32 face of the reference mesh that it lies on (for a feature of the planning mesh: the closest).
        planning_face: (S,) int32 face of the planning mesh that it belongs to.
    """

    points: Floats
    normals: Floats
    areas: Floats
    face: Ints
    planning_face: Ints

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", readonly("points", self.points, (None, 3)))
        count = len(self.points)
        object.__setattr__(self, "normals", readonly("normals", self.normals, (count, 3)))
        object.__setattr__(self, "areas", readonly("areas", self.areas, (count,)))
        object.__setattr__(self, "face", readonly("face", self.face, (count,), np.int32))
        object.__setattr__(self, "planning_face", readonly("planning_face", self.planning_face, (count,), np.int32))

    def __len__(self) -> int:
        return len(self.points)


def face_normals(mesh: TriangleMesh) -> Floats:
    """(F, 3) outward unit normals, object frame; zero for a face without area."""
    cross = _cross(mesh)
    length = np.linalg.norm(cross, axis=1, keepdims=True)
    normals: Floats = np.divide(cross, length, out=np.zeros_like(cross), where=length > 0)
    return normals


def face_areas(mesh: TriangleMesh) -> Floats:
    """(F,) areas [m^2]."""
    areas: Floats = np.linalg.norm(_cross(mesh), axis=1) / 2
    return areas


def face_centres(mesh: TriangleMesh) -> Floats:
    """(F, 3) centres of gravity of the faces [m], object frame."""
    centres: Floats = mesh.vertices[mesh.faces].mean(axis=1)
    return centres


def decimate(mesh: TriangleMesh, face_count: int) -> TriangleMesh:
    """A coarser copy with about so many faces, by quadric edge collapse.

    The library's thresholds are absolute, so the mesh is brought to a diagonal of 1 first: the result does not depend
    on the unit. At a high aggression it sometimes leaves edges with more than two faces, at a low one it stops short of
    the count; the first aggression that does neither is taken, else the one that came nearest. Where the needles of a
    CAD mesh hold it far above the count, it is made stout first (see `planner.surface.remesh`). Faces without area and
    faces that appear twice are dropped from the result.

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
    clean = _clean(mesh.vertices, mesh.faces)
    if face_count >= len(clean.faces):
        return _split(clean, face_count)
    middle = (clean.vertices.min(axis=0) + clean.vertices.max(axis=0)) / 2
    diagonal = clean.diagonal
    fine = TriangleMesh((clean.vertices - middle) / diagonal, clean.faces)
    best = _collapse(fine, face_count)
    if len(best.faces) > face_count + _allowed_miss(face_count):
        area = float(face_areas(fine).sum())
        repaired = _clean(*stout(fine.vertices, fine.faces, np.sqrt(area / face_count)))
        candidate = _collapse(repaired, face_count)
        if len(candidate.faces) < len(best.faces) and abs(float(face_areas(candidate).sum()) / area - 1) < 0.2:
            best = candidate
    return TriangleMesh(best.vertices * diagonal + middle, best.faces)


def collapse_edges(vertices: Floats, faces: Ints, face_count: int, aggression: int) -> tuple[Floats, Ints]:
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


def sample(reference: TriangleMesh, planning: TriangleMesh, count: int, rng: np.random.Generator) -> SurfaceSamples:
    """Area-weighted, stratified samples of the reference surface.

    The faces are laid end to end by area along a space-filling (Morton) curve and the line is cut into `count` equal
    strata; each gives one sample at a random place. So a patch of the surface holds its share of the samples to within
    a few, where independent samples scatter with the square root. A face without area holds none.

    Args:
        reference: the part, object frame.
        planning: its decimated copy, object frame, from which the planning faces are taken.
        count: how many samples, > 0.
        rng: source of randomness.

    Returns:
        `count` samples of equal area (total / count), in the order of the curve.

    Raises:
        PlannerError: if `count` is not positive or the reference has no area.
    """
    if count < 1:
        raise PlannerError(f"count is {count}; at least 1 sample is needed")
    areas = face_areas(reference)
    order = _morton_order(face_centres(reference))
    ends = np.cumsum(areas[order])
    total = float(ends[-1])
    if not total > 0:
        raise PlannerError("the reference mesh has no area; every face of it is degenerate")
    places = np.minimum((np.arange(count) + rng.random(count)) * (total / count), np.nextafter(total, 0))
    slot = np.searchsorted(ends, places, side="right")  # 'right' passes over faces of zero length on the line
    face = order[slot]
    # Where on the face: the place within its stretch of the line is one coordinate (so stratified too), a golden-ratio
    # sequence with a random start the other. The square root makes the density even over the triangle.
    along = np.clip((places - (ends[slot] - areas[face])) / areas[face], 0, 1)
    across = (rng.random() + _GOLDEN * np.arange(count)) % 1.0
    root = np.sqrt(along)
    weights = np.stack([1 - root, root * (1 - across), root * across], axis=1)
    points = np.einsum("sc,scj->sj", weights, reference.vertices[reference.faces[face]])
    normals = face_normals(reference)[face]
    planning_face = closest_face(points, normals, planning.vertices[planning.faces], face_normals(planning))
    return SurfaceSamples(points, normals, np.full(count, total / count), face.astype(np.int32), planning_face)


def face_features(reference: TriangleMesh, planning: TriangleMesh) -> SurfaceSamples:
    """The paper's rows: one feature per planning face, its centre, with the face's area (Section 3.5).

    Args:
        reference: the part, object frame.
        planning: its decimated copy, object frame.

    Returns:
        As many features as the planning mesh has faces; `face` is the closest face of the reference.
    """
    points, normals = face_centres(planning), face_normals(planning)
    face = closest_face(points, normals, reference.vertices[reference.faces], face_normals(reference))
    return SurfaceSamples(points, normals, face_areas(planning), face, np.arange(len(points), dtype=np.int32))


def _cross(mesh: TriangleMesh) -> Floats:
    """(F, 3) cross product of two edges: twice the area long, outward."""
    corners = mesh.vertices[mesh.faces]
    cross: Floats = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return cross


def _split(mesh: TriangleMesh, face_count: int) -> TriangleMesh:
    """The same surface, its longest edges halved until they suit `face_count` faces; a mesh that does stays."""
    longest = _TOO_LONG * np.sqrt(float(face_areas(mesh).sum()) / face_count)
    vertices, faces = mesh.vertices, mesh.faces
    before = 0
    while before < len(faces) < face_count:  # a needle would be cut into ever more pieces
        before = len(faces)
        vertices, faces = split_long_edges(vertices, faces, longest)
    return TriangleMesh(vertices, faces)


def _collapse(mesh: TriangleMesh, face_count: int) -> TriangleMesh:
    """The best of several aggressions: first the count, then no edge of more than two faces. Diagonal of about 1."""
    best, best_key = mesh, (True, float("inf"))
    for aggression in _AGGRESSIONS:
        vertices, faces = collapse_edges(mesh.vertices, mesh.faces, face_count, aggression)
        if not len(faces):
            continue
        result = _clean(vertices, faces)
        miss = abs(len(result.faces) - face_count)
        key = (miss > _allowed_miss(face_count), float(_crowded_edges(result.faces) + max(miss - 2, 0)))
        if key < best_key:
            best, best_key = result, key
        if key == (False, 0) or miss > face_count:  # nothing to improve; or stuck on slivers at any aggression
            break
    return best


def _allowed_miss(face_count: int) -> float:
    """Faces by which the count may be missed before another way is tried."""
    return 2 + 0.02 * face_count


def _clean(vertices: Floats, faces: NDArray[np.integer]) -> TriangleMesh:
    """Drop faces without area, faces that appear twice and vertices that no face uses; the order stays."""
    extent = float(np.ptp(vertices[faces.ravel()], axis=0).max())
    corners = vertices[faces]
    twice = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    kept = faces[twice > 1e-14 * extent**2]  # below, the cross product is rounding
    low, between, high = np.sort(kept, axis=1).T
    order = np.lexsort((high, between, low))  # stable: of equal faces the first stays
    again = (np.diff(low[order]) == 0) & (np.diff(between[order]) == 0) & (np.diff(high[order]) == 0)
    kept = np.delete(kept, order[1:][again], axis=0)
    if not len(kept):
        raise PlannerError("no face of the mesh has an area; a surface needs at least one")
    used, compact = np.unique(kept, return_inverse=True)
    return TriangleMesh(vertices[used], compact.reshape(-1, 3).astype(np.int32))


def _crowded_edges(faces: Ints) -> int:
    """Number of edges that more than two faces share."""
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64), axis=1)
    _, uses = np.unique(edges[:, 0] * (int(faces.max()) + 1) + edges[:, 1], return_counts=True)
    return int((uses > 2).sum())


def _morton_order(points: Floats) -> NDArray[np.int64]:
    """(N,) the order of points along a Z-shaped space-filling curve of 2^10 cells per axis."""
    low = points.min(axis=0)
    extent = float(np.ptp(points, axis=0).max()) or 1.0
    cells = np.minimum((points - low) / extent * 1024, 1023).astype(np.uint32)
    for shift, mask in ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
        cells = (cells | (cells << np.uint32(shift))) & np.uint32(mask)  # spread the bits of each coordinate apart
    code = cells[:, 0] | (cells[:, 1] << np.uint32(1)) | (cells[:, 2] << np.uint32(2))
    return np.argsort(code, kind="stable")
