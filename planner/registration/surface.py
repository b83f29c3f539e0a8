"""Surface of a point cloud: implicit signed distance, holes of a mesh, deviation from the reference.

Implicit surface: a signed distance blended from the nearest points and their normals. A point p with normal n predicts
the distance n . (x - p) at x. Averaging these alone (implicit moving least squares, Kolluri, ACM Trans. Algorithms
4(2), 2008, doi:10.1145/1361192.1361195) shrinks round parts: a neighbour at distance t on a sphere of radius R predicts
-t^2 / 2R for a point that is on the sphere. Here every neighbour predicts with the mean of its own normal and the
blended normal: the chord between two points of a sphere is at right angles to the sum of their normals, so that the
shrinking cancels.

Holes: a closing face is not measured, so it is marked. A loop is closed by a fan round its middle, the simplest
assumption about an unmeasured region; the fan may cut through the part where the rim of a hole is strongly bent.

Deviation: the deviation of a point of a mesh is its distance to the closest point of the reference, positive outside
the part. Rms, mean and the 95 % quantile are over area-weighted samples of the mesh, so that many small faces count no
more than their area; the largest deviation is over samples and vertices. Faces that close holes have separate numbers.
A surface from points rounds sharp edges of the part, whatever the scanner's error. So the numbers leave out a band
about these edges whose width follows from the spacing of the points; the numbers with the band are stated beside them.
A point is in the band if its closest point of the part is, because a surface also runs on beyond an edge.
Missing surface does not show here: that is coverage. Object frame, metres.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.errors import PlannerError
from planner.geometry.closest import ClosestPointQuery
from planner.geometry.mesh import TriangleMesh
from planner.registration.cloud import PointCloud
from planner.values import Floats, Value

Singles = NDArray[np.float32]

NEIGHBOURS = 12
"""Blended neighbours: more of them remove more noise and more detail."""

_CHUNK = 16_384  # positions a pass, so that its arrays stay in the processor's cache


@dataclass(frozen=True, slots=True, eq=False)
class FieldValues:
    """Values of the implicit surface at N positions.

    Attributes:
        distance: (N,) float32 signed distance, positive outside [m].
        normal: (N, 3) float32 blended unit normal, along which the distance grows.
        nearest: (N,) float32 distance to the nearest point of the cloud [m].
    """

    distance: Singles
    normal: Singles
    nearest: Singles


class ImplicitSurface:
    """Signed distance to the surface of a point cloud, see the module's docstring.

    Args:
        cloud: at least one point, with normals.
    """

    def __init__(self, cloud: PointCloud) -> None:
        self._points = cloud.points
        self._normals: Singles = cloud.normals.astype(np.float32)
        self._tree = cKDTree(cloud.points, balanced_tree=False, compact_nodes=False)
        self._neighbours = min(NEIGHBOURS, len(cloud))

    def evaluate(self, positions: Floats) -> FieldValues:
        """Evaluate the field at positions (N, 3) [m].

        The weight is (1 - (d / D)^2)^4 with D just beyond the farthest neighbour. It reaches zero where a neighbour
        drops out and depends on the lateral offset only: at a height h above the surface both d^2 and D^2 grow by h^2.
        Neighbours with normals opposite to that of the nearest point get no weight: they belong to the other face of a
        thin sheet.
        """
        starts = range(0, len(positions), _CHUNK)
        with ThreadPoolExecutor(2) as pool:  # NumPy and the tree release the interpreter lock
            parts = list(pool.map(lambda start: self._chunk(positions[start : start + _CHUNK]), starts))
        if not parts:
            empty = np.empty(0, dtype=np.float32)
            return FieldValues(empty, np.empty((0, 3), dtype=np.float32), empty)
        distance, normal, nearest = (np.concatenate(values) for values in zip(*parts, strict=True))
        return FieldValues(distance, normal, nearest)

    def _chunk(self, positions: Floats) -> tuple[Singles, Singles, Singles]:
        """Return the attributes of `FieldValues` at positions (n, 3) [m]."""
        nearest = self._tree.query(positions, self._neighbours)
        exact, index = (np.asarray(each).reshape(len(positions), -1) for each in nearest)
        distance = exact.astype(np.float32)
        offset = (positions[:, None, :] - self._points[index]).astype(np.float32)
        normals = self._normals[index]
        agreement = np.einsum("nkj,nj->nk", normals, normals[:, 0])
        # A nearest point has a wrong normal if nearly all others contradict it.
        agreement[(agreement > 0).sum(axis=1) < self._neighbours / 4] *= -1
        ratio = distance / (distance[:, -1:] * np.float32(1.02) + np.float32(1e-12))
        weight = (1 - ratio**2) ** 4 * np.maximum(agreement, 0)
        weight /= weight.sum(axis=1, keepdims=True)
        blended = np.einsum("nk,nkj->nj", weight, normals)
        blended /= np.linalg.norm(blended, axis=1, keepdims=True)
        normals += blended[:, None, :]
        predicted = np.einsum("nkj,nkj->nk", normals, offset)
        value: Singles = np.einsum("nk,nk->n", weight, predicted) / np.float32(2)
        return value, blended, distance[:, 0]


def boundary_loops(mesh: TriangleMesh) -> list[NDArray[np.int32]]:
    """Return the closed walks along edges with one face only, each against the direction of its faces.

    Walks are cut into simple loops at vertices where several loops touch. Each loop is an array of vertex indices; the
    loops are in order of the smallest directed edge.
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
    """Count the holes of a mesh and, if `close`, add faces that close them.

    Returns:
        The mesh, (F,) True for added faces (the last ones), and the number of holes found.
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


_BINS = 40

EDGE_BAND = 1.5
"""Half width of the band about sharp edges, in spacings of the points."""

_MAX_EDGE_ERROR = 2.0
"""Largest deviation in the band, in its half widths: a larger one is no rounded edge."""

_SHARP_EDGE = np.cos(np.radians(30.0))  # cosine of the angle between the normals of the faces at a sharp edge
_MAX_EDGE_POINTS = 2_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Deviation(Value):
    """Signed deviation of the measured faces of a mesh from the reference, positive outside.

    Attributes:
        at_vertices: (V,) signed deviation of each vertex of the complete mesh [m], for colouring.
        rms: root of the area-weighted mean square [m].
        mean: area-weighted mean [m]; near the rms if the mesh is too large everywhere.
        quantile_95: 95 % of the mesh's area deviate by no more than this, without sign [m].
        largest: largest deviation without sign among samples and vertices [m].
        histogram: (B,) share of the area in each bin; the outer bins include everything beyond them.
        bin_edges: (B + 1,) [m], symmetric about zero.
        sample_count: number of area samples.
        closed: the same numbers for the faces that close holes; None without such faces.
        with_edges: the same numbers with the band about sharp edges; None if no sample is in the band, or all are: then
            these numbers include it.
        edge_share: share of the area in the band.
    """

    at_vertices: Annotated[Floats, "V"]
    rms: float
    mean: float
    quantile_95: float
    largest: float
    histogram: Annotated[Floats, "B"]
    bin_edges: Annotated[Floats, "B+1"]
    sample_count: int
    closed: "Deviation | None" = None
    with_edges: "Deviation | None" = None
    edge_share: float = 0.0


def measure_deviation(
    mesh: TriangleMesh,
    reference: TriangleMesh | ClosestPointQuery,
    rng: np.random.Generator,
    *,
    closed: NDArray[np.bool_] | None = None,
    count: int = 100_000,
    edge_band: float = 0.0,
) -> Deviation:
    """Measure a reconstructed mesh against the reference part.

    Args:
        mesh: object frame.
        reference: object frame; a `ClosestPointQuery` is used as it is.
        rng: of the samples.
        closed: (F,) True for faces that close a hole.
        count: number of area-weighted samples, > 0; the closing faces get a tenth of it.
        edge_band: half width of the band about sharp edges of the reference that is left out [m]; 0 leaves out nothing.
    """
    nearest = reference if isinstance(reference, ClosestPointQuery) else ClosestPointQuery(reference)
    surfaces, counts = [mesh], [count]
    if closed is not None and closed.any():
        surfaces = [TriangleMesh(mesh.vertices, mesh.faces[mask]) for mask in (~closed, closed)]
        counts = [count, -(-count // 10)]
    samples = [sample_by_area(surface, n, rng) for surface, n in zip(surfaces, counts, strict=True)]
    signed = nearest.signed_distance(np.concatenate([mesh.vertices, *samples]))
    at_vertices, *over_area = np.split(signed, np.cumsum([len(mesh.vertices), *counts])[:-1])
    used = [np.unique(surface.faces) for surface in surfaces]
    parts = [_statistics(at_vertices, at_vertices[mask], at) for mask, at in zip(used, over_area, strict=True)]
    result = replace(parts[0], closed=parts[1]) if len(parts) > 1 else parts[0]
    edges = sharp_edge_points(nearest.mesh, edge_band / 2) if edge_band > 0 else np.zeros((0, 3))
    if not len(edges):
        return result
    feet = nearest.closest(np.concatenate([samples[0], mesh.vertices[used[0]]]))
    distance, _ = cKDTree(edges).query(feet.point, workers=-1)
    inner, inner_vertices = np.split((distance > edge_band) | (feet.distance > _MAX_EDGE_ERROR * edge_band), [count])
    if inner.all() or not inner.any():
        return result
    without = _statistics(at_vertices, at_vertices[used[0]][inner_vertices], over_area[0][inner])
    return replace(without, closed=result.closed, with_edges=parts[0], edge_share=float(1 - inner.mean()))


def sharp_edge_points(mesh: TriangleMesh, spacing: float) -> Floats:
    """Return points (N, 3) along the edges where faces meet at more than 30 deg, or that belong to one face.

    Args:
        mesh: with equal vertices merged.
        spacing: largest distance of adjacent points on an edge [m]; larger if the mesh has very long edges.
    """
    sides = np.sort(np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]]), axis=1)
    key = sides[:, 0].astype(np.int64) * len(mesh.vertices) + sides[:, 1]
    order = np.argsort(key, kind="stable")
    begins = np.flatnonzero(np.append(True, np.diff(key[order]) != 0))
    uses = np.diff(np.append(begins, len(order)))
    normals = mesh.normals[np.tile(np.arange(len(mesh.faces)), 3)[order]]
    following = np.minimum(begins + 1, len(order) - 1)
    flat = (uses == 2) & (np.einsum("ej,ej->e", normals[begins], normals[following]) > _SHARP_EDGE)
    ends = mesh.vertices[sides[order[begins[~flat]]]]
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    spacing = max(spacing, float(length.sum()) / _MAX_EDGE_POINTS)
    counts = np.ceil(length / spacing).astype(np.int64) + 1
    edge = np.repeat(np.arange(len(ends)), counts)
    step = np.arange(len(edge)) - np.repeat(np.cumsum(counts) - counts, counts)
    share = (step / np.maximum(counts - 1, 1)[edge])[:, None]
    points: Floats = ends[edge, 0] * (1 - share) + ends[edge, 1] * share
    return points


def _statistics(at_vertices: Floats, own_vertices: Floats, over_area: Floats) -> Deviation:
    """Compute statistics from the deviation of the measured vertices and of the area samples (S,) [m].

    Args:
        at_vertices: (V,) of all vertices.
        own_vertices: of the vertices that count.
        over_area: (S,) of the samples that count.
    """
    quantile = float(np.quantile(np.abs(over_area), 0.95))
    limit = 1.5 * quantile if quantile > 0 else 1e-9  # a mesh that is exactly the reference still needs bins
    edges = np.linspace(-limit, limit, _BINS + 1)
    counts, _ = np.histogram(np.clip(over_area, -limit, limit), edges)
    return Deviation(
        at_vertices,
        rms=float(np.sqrt(np.mean(over_area**2))),
        mean=float(over_area.mean()),
        quantile_95=quantile,
        largest=float(max(np.abs(over_area).max(), np.abs(own_vertices).max(initial=0.0))),
        histogram=counts / len(over_area),
        bin_edges=edges,
        sample_count=len(over_area),
    )


def sample_by_area(mesh: TriangleMesh, count: int, rng: np.random.Generator) -> Floats:
    """Draw (count, 3) points on a mesh by area: equal strata over the faces laid end to end, uniform within a face.

    Raises:
        PlannerError: if `count` is not positive or the mesh has no area.
    """
    if count < 1:
        raise PlannerError(f"count is {count}; at least 1 sample is needed")
    ends = np.cumsum(mesh.areas)
    if not ends[-1] > 0:
        raise PlannerError("the mesh has no area; every face of it is degenerate")
    places = np.minimum((np.arange(count) + rng.random(count)) * (ends[-1] / count), np.nextafter(ends[-1], 0))
    corners = mesh.vertices[mesh.faces[np.searchsorted(ends, places, side="right")]]
    root, across = np.sqrt(rng.random(count)), rng.random(count)
    weights = np.stack([1 - root, root * (1 - across), root * across], axis=1)
    points: Floats = np.einsum("sc,scj->sj", weights, corners)
    return points
