"""Samples that stand for the surface: rows of the measurability matrix, or points on which coverage is measured.

Coverage is a sum of the areas of samples of the *reference* mesh (Section 3.2). Object frame, metres.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError
from planner.geometry.closest import closest_face
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats, Ints, Ints32, Value

_GOLDEN = 0.6180339887498949  # the most irrational step: its multiples modulo 1 are the most evenly spread


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceSamples(Value):
    """Surface features: the rows of the measurability matrix, or the points on which coverage is measured.

    Attributes:
        points: (S, 3) [m], object frame.
        normals: (S, 3) outward unit normals, object frame.
        areas: (S,) area that each one stands for [m^2].
        face: (S,) int32 face of the reference mesh that it lies on (for a feature of the planning mesh: the closest).
        planning_face: (S,) int32 face of the planning mesh that it belongs to.
        region: (S,) int32 region of the part that it lies in, from 0; None: the part has no regions.
    """

    points: Annotated[Floats, "S 3"]
    normals: Annotated[Floats, "S 3"]
    areas: Annotated[Floats, "S"]
    face: Annotated[Ints32, "S"]
    planning_face: Annotated[Ints32, "S"]
    region: Annotated[Ints32, "S"] | None = None

    def __len__(self) -> int:
        return len(self.points)


def sample(reference: TriangleMesh, planning: TriangleMesh, count: int, rng: np.random.Generator) -> SurfaceSamples:
    """Area-weighted, stratified samples of the reference surface.

    The faces are laid end to end by area along a space-filling (Morton) curve and the line is cut into `count` equal
    strata; each gives one sample at a random place. So a patch of the surface holds its share of the samples to within
    a few, where independent samples scatter with the square root. A face without area holds none, nor does one that
    nobody cares for (`TriangleMesh.region`).

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
    order, areas, ends = _laid_end_to_end(reference)
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
    normals = reference.normals[face]
    planning_face = closest_face(points, normals, planning)
    region = None if reference.region is None else reference.region[face]
    return SurfaceSamples(points, normals, np.full(count, total / count), face.astype(np.int32), planning_face, region)


def face_features(reference: TriangleMesh, planning: TriangleMesh) -> SurfaceSamples:
    """The paper's rows: one feature per planning face, its centre, with the face's area (Section 3.5).

    Args:
        reference: the part, object frame.
        planning: its decimated copy, object frame.

    Returns:
        As many features as the planning mesh has faces; `face` is the closest face of the reference.
    """
    points, normals = planning.centres, planning.normals
    face = closest_face(points, normals, reference)
    return SurfaceSamples(points, normals, planning.areas, face, np.arange(len(points), dtype=np.int32))


@lru_cache(maxsize=1)  # of the part, whose surface is sampled several times in a plan
def _laid_end_to_end(mesh: TriangleMesh) -> tuple[Ints, Floats, Floats]:
    """(F,) the faces in the order of the curve, (F,) the area of each face that counts, and up to its end [m^2]."""
    areas = mesh.areas if mesh.region is None else np.where(mesh.region >= 0, mesh.areas, 0.0)
    order = _morton_order(mesh.centres)
    return order, areas, np.cumsum(areas[order])


def _morton_order(points: Floats) -> Ints:
    """(N,) the order of points along a Z-shaped space-filling curve of 2^10 cells per axis."""
    extent = max(float(np.ptp(axis)) for axis in points.T) or 1.0
    code = np.zeros(len(points), np.uint32)
    for number, axis in enumerate(points.T):
        cells = np.minimum((axis - axis.min()) / extent * 1024, 1023).astype(np.uint32)
        for shift, mask in ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
            cells = (cells | (cells << np.uint32(shift))) & np.uint32(mask)  # spread the bits of each coordinate apart
        code |= cells << np.uint32(number)
    return np.argsort(code, kind="stable")


def pick_samples(samples: SurfaceSamples, which: NDArray[Any]) -> SurfaceSamples:
    """Some of the samples: (S,) bool, or their indices; each stands for the area that it did."""
    return SurfaceSamples(
        samples.points[which],
        samples.normals[which],
        samples.areas[which],
        samples.face[which],
        samples.planning_face[which],
        None if samples.region is None else samples.region[which],
    )


def join_samples(samples: Sequence[SurfaceSamples]) -> SurfaceSamples:
    """Samples of the same two meshes one after the other, each with the area that it stands for."""
    regions = [each.region for each in samples if each.region is not None]
    return SurfaceSamples(
        np.concatenate([each.points for each in samples]),
        np.concatenate([each.normals for each in samples]),
        np.concatenate([each.areas for each in samples]),
        np.concatenate([each.face for each in samples]),
        np.concatenate([each.planning_face for each in samples]),
        np.concatenate(regions) if regions else None,
    )
