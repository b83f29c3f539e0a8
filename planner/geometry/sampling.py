"""Samples of the surface: rows of the measurability matrix, or points on which coverage is measured.

Coverage is a sum of the areas of samples of the *reference* mesh (Section 3.2). Object frame, metres.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

import numpy as np

from planner.errors import PlannerError
from planner.geometry.closest import closest_facing_faces
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats, Ints, Ints32, Rows

_GOLDEN = 0.6180339887498949  # the most irrational step: its multiples modulo 1 are the most evenly spread


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceSamples(Rows):
    """Samples of the part's surface.

    Attributes:
        points: (S, 3) [m].
        normals: (S, 3) outward unit normals.
        areas: (S,) area that each sample represents [m^2].
        face: (S,) face of the reference mesh that contains it (for a sample of the planning mesh: the closest one).
        planning_face: (S,) face of the planning mesh to which it belongs.
        region: (S,) number of the region that contains it, from 0; None: the part has no regions.
    """

    points: Annotated[Floats, "S 3"]
    normals: Annotated[Floats, "S 3"]
    areas: Annotated[Floats, "S"]
    face: Annotated[Ints32, "S"]
    planning_face: Annotated[Ints32, "S"]
    region: Annotated[Ints32, "S"] | None = None


def draw_samples(
    reference: TriangleMesh, planning: TriangleMesh, count: int, rng: np.random.Generator
) -> SurfaceSamples:
    """Draw area-weighted, stratified samples of the reference surface.

    The faces are laid end to end by area along a space-filling (Morton) curve, and the line is cut into `count` equal
    strata with one sample each at a random place. So a patch of the surface holds its share of the samples to within
    a few, while independent samples scatter with the square root. Faces without area and faces without a region
    (`TriangleMesh.region` below 0) hold none.

    Args:
        reference: the part.
        planning: its decimated copy, which gives the planning faces.
        count: number of samples, > 0.
        rng: source of randomness.

    Returns:
        `count` samples of equal area (total / count), in the order of the curve.
    """
    if count < 1:
        raise PlannerError(f"count is {count}; at least 1 sample is needed")
    order, areas, ends = _cumulative_areas(reference)
    total = float(ends[-1])
    if not total > 0:
        raise PlannerError("the reference mesh has no area; every face of it is degenerate")
    places = np.minimum((np.arange(count) + rng.random(count)) * (total / count), np.nextafter(total, 0))
    slot = np.searchsorted(ends, places, side="right")  # 'right' passes over faces of zero length on the line
    face = order[slot]
    # On the face, one coordinate is the place within its stretch of the line (so it is stratified too), the other a
    # golden-ratio sequence with a random start. The square root makes the density uniform over the triangle.
    along = np.clip((places - (ends[slot] - areas[face])) / areas[face], 0, 1)
    across = (rng.random() + _GOLDEN * np.arange(count)) % 1.0
    root = np.sqrt(along)
    weights = np.stack([1 - root, root * (1 - across), root * across], axis=1)
    points = np.einsum("sc,scj->sj", weights, reference.vertices[reference.faces[face]])
    normals = reference.normals[face]
    planning_face = closest_facing_faces(points, normals, planning)
    region = None if reference.region is None else reference.region[face]
    return SurfaceSamples(points, normals, np.full(count, total / count), face.astype(np.int32), planning_face, region)


def samples_at_face_centres(reference: TriangleMesh, planning: TriangleMesh) -> SurfaceSamples:
    """Return one sample per planning face, at its centre and with its area: the rows of the paper (Section 3.5)."""
    points, normals = planning.centres, planning.normals
    face = closest_facing_faces(points, normals, reference)
    return SurfaceSamples(points, normals, planning.areas, face, np.arange(len(points), dtype=np.int32))


@lru_cache(maxsize=1)  # of the part, whose surface is sampled several times in a plan
def _cumulative_areas(mesh: TriangleMesh) -> tuple[Ints, Floats, Floats]:
    """Return (F,) faces in the order of the curve, (F,) areas (0 without a region), (F,) sums of the ordered areas."""
    areas = mesh.areas if mesh.region is None else np.where(mesh.region >= 0, mesh.areas, 0.0)
    order = _morton_order(mesh.centres)
    return order, areas, np.cumsum(areas[order])


def _morton_order(points: Floats) -> Ints:
    """Return (N,) the order of points along a Z-shaped space-filling curve of 2^10 cells per axis."""
    extent = max(float(np.ptp(axis)) for axis in points.T) or 1.0
    code = np.zeros(len(points), np.uint32)
    for number, axis in enumerate(points.T):
        cells = np.minimum((axis - axis.min()) / extent * 1024, 1023).astype(np.uint32)
        for shift, mask in ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
            cells = (cells | (cells << np.uint32(shift))) & np.uint32(mask)  # interleave the bits of the coordinates
        code |= cells << np.uint32(number)
    return np.argsort(code, kind="stable")
