"""Convex pieces that enclose a part's triangles: approximate convex decomposition by plane cuts.

Space is cut into cells by planes, one cell at a time: always the cell whose hull stands out farthest from the surface
in it, by the plane that leaves the least volume in the two hulls (the greedy of V-HACD: Mamou and Ghorbel 2009,
doi:10.1109/ICIP.2009.5414068; a surface in place of voxels). How far a hull stands out is measured on samples; the
planes found, the part's triangles are clipped to each cell, and a piece is the hull of what is in it. So every point of
every triangle is inside a piece, whatever the mesh: open, flat, of many shells or with crossing faces. Flat pieces are
`solid_hull.MIN_THICKNESS` thick; apart from that and from rounding (below 1e-9 m) the pieces have no margin of their
own. Material deep inside a part need not be in a piece: nothing gets there without crossing one.

Deterministic: the samples are drawn with a fixed seed. Work is bounded by the number of samples and of pieces, not by
the number of triangles. Object frame, metres.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import ConvexHull, QhullError, cKDTree

from cell.world import piece_cache
from cell.world.solid_hull import solid_hull
from planner.ports import Progress
from planner.surface.mesh import TriangleMesh, face_areas, face_centres, face_normals
from planner.values import Floats

TOLERANCE = 0.004
"""Cutting ends where no hull stands out farther from the surface than this [m]."""

MOST_PIECES = 48
"""At most so many pieces: each costs time in every check."""

_SAMPLES = 8_000  # of the surface
_SCORED = 500  # samples of a cell that its cuts are compared on
_SHARES = (0.15, 0.25, 0.35, 0.45, 0.5, 0.55, 0.65, 0.75, 0.85)  # where cuts are tried, along each axis of the object
_PROBES = 400  # points of a hull at which its distance from the surface is looked at
_FLAT = 1e-5  # m; hulls of cells thinner than this count as having this thickness


@dataclass(frozen=True, slots=True, eq=False)
class _Cell:
    """A convex region, the samples in it, and how far their hull stands out.

    Attributes:
        planes: rows n, c: n.x <= c holds in the region.
        samples: (N, 3) of the surface.
        triangles: (F, 3, 3) of the part, clipped to the region.
        standing_out: largest distance of the hull from the surface [m].
    """

    planes: tuple[tuple[Floats, float], ...]
    samples: Floats
    triangles: Floats
    standing_out: float


def enclosing_pieces(
    mesh: TriangleMesh,
    *,
    tolerance: float = TOLERANCE,
    most: int = MOST_PIECES,
    use_cache: bool = True,
    progress: Progress | None = None,
) -> tuple[TriangleMesh, ...]:
    """Convex pieces whose union holds every triangle of a mesh.

    Args:
        mesh: at least one face [m].
        tolerance: how far a piece may stand out from the surface before it is cut [m].
        most: number of pieces at most; with fewer than the shape needs, some stand out farther.
        use_cache: whether they may be taken from and left in the cache.
        progress: called with (pieces so far, at most).

    Returns:
        The pieces, each a convex mesh; equal meshes give equal pieces.
    """
    key = piece_cache.key_of(mesh, tolerance, most)
    kept = piece_cache.load(key) if use_cache else None
    if kept is not None:
        return kept
    cells = _cells(mesh, tolerance, most, progress)
    pieces = tuple(solid_hull(cell.triangles.reshape(-1, 3)) for cell in cells if len(cell.triangles))
    if use_cache:
        piece_cache.save(key, pieces)
    return pieces


def _cells(mesh: TriangleMesh, tolerance: float, most: int, progress: Progress | None) -> list[_Cell]:
    """Cut until every hull is close to the surface."""
    surface = _Surface(mesh)
    triangles = np.array(mesh.vertices[mesh.faces], dtype=np.float64)
    cells = [_Cell((), surface.samples, triangles, surface.standing_out(surface.samples, ()))]
    while len(cells) < most:
        worst = max(range(len(cells)), key=lambda k: cells[k].standing_out)
        cell = cells[worst]
        if cell.standing_out <= tolerance:
            break
        cut = _best_cut(cell.samples)
        if cut is None:
            cells[worst] = replace(cell, standing_out=0.0)
            continue
        del cells[worst]
        normal, offset = cut
        below = cell.samples @ normal <= offset
        for side, sign in ((below, 1.0), (~below, -1.0)):
            planes = (*cell.planes, (sign * normal, sign * offset))
            samples = cell.samples[side]
            triangles = _clipped(cell.triangles, *planes[-1])
            cells.append(_Cell(planes, samples, triangles, surface.standing_out(samples, planes)))
        if progress is not None:
            progress(len(cells), most)
    return cells


class _Surface:
    """Samples of a mesh, and how far a hull stands out from it.

    Attributes:
        samples: (N, 3), evenly by area, with the vertices that lie farthest out [m].
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        rng = np.random.default_rng(0)
        areas, normals = face_areas(mesh), face_normals(mesh)
        total = float(areas.sum())
        face = rng.choice(len(areas), _SAMPLES, p=areas / total if total > 0 else None)
        corners = mesh.vertices[mesh.faces[face]]
        weights = rng.dirichlet((1.0, 1.0, 1.0), _SAMPLES)
        centres = face_centres(mesh)
        outmost = np.array([np.argmax(centres @ direction) for direction in _directions(128)])
        farthest = mesh.vertices[mesh.faces[outmost]].reshape(-1, 3)
        self.samples: Floats = np.concatenate([np.einsum("pk,pkj->pj", weights, corners), farthest])
        self._normals = np.concatenate([normals[face], np.repeat(normals[outmost], 3, axis=0)])
        self._closed = is_closed(mesh)
        self._tree = cKDTree(self.samples)
        # Samples lie this far apart, so a hull that lies on the surface seems to stand out by it.
        apart = np.asarray(self._tree.query(self.samples, k=2)[0])[:, 1]
        self._spacing = 2 * float(np.median(apart))

    def standing_out(self, samples: Floats, planes: tuple[tuple[Floats, float], ...]) -> float:
        """How far the hull of a cell's samples stands out [m].

        Left out is what lies on the planes of the cell, where its neighbour goes on, and what is inside a closed part.
        """
        corners = _outline(samples)
        areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        if not areas.sum() > 0:
            return 0.0
        rng = np.random.default_rng(1)
        chosen = corners[rng.choice(len(areas), _PROBES, p=areas / areas.sum())]
        weights = rng.dirichlet((1.0, 1.0, 1.0), _PROBES)
        probes = np.concatenate([np.einsum("pk,pkj->pj", weights, chosen), corners.mean(axis=1)])
        for normal, offset in planes:
            probes = probes[np.abs(probes @ normal - offset) > self._spacing]
        if not len(probes):
            return 0.0
        distance, nearest = (np.asarray(found) for found in self._tree.query(probes))
        if self._closed:
            inside = np.einsum("pj,pj->p", probes - self.samples[nearest], self._normals[nearest]) < 0
            distance = np.where(inside, 0.0, distance)
        return max(0.0, float(distance.max()) - self._spacing)


def is_closed(mesh: TriangleMesh) -> bool:
    """Whether every edge of a mesh is shared by exactly two faces."""
    faces = mesh.faces.astype(np.int64)
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    counts = np.unique(edges[:, 0] * (int(faces.max()) + 1) + edges[:, 1], return_counts=True)[1]
    return bool((counts == 2).all())


def _directions(count: int) -> Floats:
    """(count, 3) unit vectors, evenly over the sphere (Fibonacci)."""
    k = np.arange(count) + 0.5
    z, angle = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)


def _outline(samples: Floats) -> Floats:
    """(F, 3, 3) triangles of the hull of points; of points in a plane, from their middle to their outline."""
    middle = samples.mean(axis=0)
    try:
        hull = ConvexHull(samples - middle)
        return np.asarray(samples[hull.simplices])
    except (QhullError, ValueError):
        pass
    _, _, axes = np.linalg.svd(samples - middle, full_matrices=False)
    try:
        hull = ConvexHull((samples - middle) @ axes[:2].T)
    except (QhullError, ValueError):
        return np.zeros((0, 3, 3))  # a line
    ends = samples[hull.simplices]
    return np.concatenate([np.broadcast_to(middle, (len(ends), 1, 3)), ends], axis=1)


def _best_cut(samples: Floats) -> tuple[Floats, float] | None:
    """The plane, across an axis of the object, whose two sides have the least volume of hulls; None: no cut."""
    few = samples[:: max(1, len(samples) // _SCORED)]
    best: tuple[float, Floats, float] | None = None
    for axis in range(3):
        normal = np.eye(3)[axis]
        low, high = few[:, axis].min(), few[:, axis].max()
        for share in _SHARES:
            offset = float(low + share * (high - low))
            below = few[:, axis] <= offset
            if below.sum() < 4 or (~below).sum() < 4:
                continue
            volume = _volume(few[below]) + _volume(few[~below])
            if best is None or volume < best[0] * (1 - 1e-9):
                best = (volume, normal, offset)
    return None if best is None else (best[1], best[2])


def _volume(points: Floats) -> float:
    """Volume of a hull; of a flat one, as if it had a little thickness."""
    try:
        hull = ConvexHull(points)
        return float(hull.volume) + _FLAT * float(hull.area)
    except (QhullError, ValueError):
        spread = np.sort(np.ptp(points, axis=0))
        return _FLAT * float(spread[1] * spread[2])


def _clipped(corners: Floats, normal: Floats, offset: float) -> Floats:
    """The parts of triangles (F, 3, 3) where n.x <= c, as triangles again."""
    height = corners @ normal - offset
    out = height > 0
    count = out.sum(axis=1)
    kept = [corners[count == 0]]
    for n_out in (1, 2):
        cut = count == n_out
        # Turn each triangle so that the corner that is alone on its side comes first.
        alone = np.argmax(out[cut] if n_out == 1 else ~out[cut], axis=1)
        order = (alone[:, None] + np.arange(3)) % 3
        a, b, c = np.swapaxes(np.take_along_axis(corners[cut], order[:, :, None], axis=1), 0, 1)
        ha, hb, hc = np.take_along_axis(height[cut], order, axis=1).T
        ab = a + (ha / (ha - hb))[:, None] * (b - a)
        ac = a + (ha / (ha - hc))[:, None] * (c - a)
        if n_out == 2:
            kept.append(np.stack([a, ab, ac], axis=1))
        else:
            kept += [np.stack([ab, b, c], axis=1), np.stack([ab, c, ac], axis=1)]
    return np.concatenate(kept)
