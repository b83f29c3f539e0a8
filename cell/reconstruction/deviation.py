"""How far a reconstructed mesh is from the reference: signed, over its area and at its vertices.

The deviation of a point of the mesh is its distance to the closest point of the reference, positive outside the part.
The numbers (rms, 95 %, mean) are over area-weighted samples of the mesh, so that a region of many small faces counts no
more than its area; the largest is over samples and vertices. Faces that close holes are invented, so they have numbers
of their own. What the mesh lacks does not show here: that is coverage. Object frame, metres.
"""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError
from planner.geometry.closest import ClosestPointQuery
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats, Value

_BINS = 40


@dataclass(frozen=True, slots=True, eq=False)
class Deviation(Value):
    """Signed deviation of a mesh from the reference, positive outside; of its measured faces but for `closed`.

    Attributes:
        at_vertices: (V,) signed deviation of each vertex of the whole mesh [m], for colouring.
        rms: root of the area-weighted mean square [m].
        mean: area-weighted mean [m]; a mesh that is too large all over has it near the rms.
        quantile_95: 95 % of the mesh's area deviate by no more than this, without sign [m].
        largest: largest deviation without sign among samples and vertices [m].
        histogram: (B,) share of the area in each bin; the outer bins also hold what lies beyond them.
        bin_edges: (B + 1,) [m], symmetric about zero.
        sample_count: how many samples stand for the area.
        closed: the same of the faces that close holes; None where there are none.
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


def deviation(
    mesh: TriangleMesh,
    reference: TriangleMesh | ClosestPointQuery,
    rng: np.random.Generator,
    *,
    closed: NDArray[np.bool_] | None = None,
    count: int = 100_000,
) -> Deviation:
    """Measure the mesh against the reference.

    Args:
        mesh: the reconstructed surface, object frame.
        reference: the part, object frame; a `NearestSurface` of it saves building that again.
        rng: source of randomness of the samples.
        closed: (F,) True for faces that close a hole; None where there are none.
        count: number of area-weighted samples, > 0; the closing faces get a tenth as many.

    Raises:
        PlannerError: if `count` is not positive or the measured or the closing faces have no area.
    """
    nearest = reference if isinstance(reference, ClosestPointQuery) else ClosestPointQuery(reference)
    surfaces, counts = [mesh], [count]
    if closed is not None and closed.any():
        surfaces = [TriangleMesh(mesh.vertices, mesh.faces[chosen]) for chosen in (~closed, closed)]
        counts = [count, -(-count // 10)]
    samples = [area_samples(surface, n, rng) for surface, n in zip(surfaces, counts, strict=True)]
    signed = nearest.signed_distance(np.concatenate([mesh.vertices, *samples]))
    at_vertices, *over_area = np.split(signed, np.cumsum([len(mesh.vertices), *counts])[:-1])
    parts = [_numbers(surface, at_vertices, at) for surface, at in zip(surfaces, over_area, strict=True)]
    return replace(parts[0], closed=parts[1]) if len(parts) > 1 else parts[0]


def _numbers(surface: TriangleMesh, at_vertices: Floats, over_area: Floats) -> Deviation:
    """The numbers of a surface from the deviation of its vertices (V,) and of samples of its area (S,) [m]."""
    quantile = float(np.quantile(np.abs(over_area), 0.95))
    limit = 1.5 * quantile if quantile > 0 else 1e-9  # a mesh that is exactly the reference still needs bins
    edges = np.linspace(-limit, limit, _BINS + 1)
    counts, _ = np.histogram(np.clip(over_area, -limit, limit), edges)
    return Deviation(
        at_vertices,
        rms=float(np.sqrt(np.mean(over_area**2))),
        mean=float(over_area.mean()),
        quantile_95=quantile,
        largest=float(max(np.abs(over_area).max(), np.abs(at_vertices[np.unique(surface.faces)]).max())),
        histogram=counts / len(over_area),
        bin_edges=edges,
        sample_count=len(over_area),
    )


def area_samples(mesh: TriangleMesh, count: int, rng: np.random.Generator) -> Floats:
    """Points spread over a mesh by area: equal strata along the faces laid end to end, uniform within a face.

    Args:
        mesh: object frame.
        count: how many, > 0.
        rng: source of randomness.

    Returns:
        (count, 3) points [m], object frame.

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
