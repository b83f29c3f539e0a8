"""The measurability matrix M: which sample of the surface is measured from which viewpoint (Section 3.5.1).

M is binary. Its rows are samples of the part's surface (or the planning faces of the paper), its columns candidate
viewpoints. `planner.measurability.visibility` fills it.

A candidate is one row of `Viewpoints` and of `Reach` and one column of M. A generator that adds candidates appends to
all three, so the numbers of earlier candidates stay.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError
from planner.geometry.sampling import SurfaceSamples
from planner.values import Bools, Ints, Ints32, Value, freeze

if TYPE_CHECKING:
    from scipy.sparse import csr_array


@dataclass(frozen=True, slots=True, eq=False)
class Measurability(Value):
    """A binary matrix in compressed sparse rows: S samples x V viewpoints.

    Attributes:
        indptr: (S + 1,) position in `indices` at which each sample's viewpoints start.
        indices: (nnz,) viewpoints that measure the sample, ascending within a row.
        samples: the S rows.
        n_viewpoints: number of columns V.
        sigma: (nnz,) expected standard deviation of the point of each entry [m], from
            `planner.measurability.quality.sigma_layer`; None if it is not needed.
    """

    indptr: Annotated[Ints, "S+1"]
    indices: Annotated[Ints32, "nnz"]
    samples: Annotated[SurfaceSamples, "S"]
    n_viewpoints: int
    sigma: Annotated[NDArray[np.float32], "nnz"] | None = None

    def __post_init__(self) -> None:
        freeze(self)
        if self.sigma is not None and not (self.sigma >= 0).all():
            raise PlannerError("sigma must be 0 or more at every entry")
        if self.indptr[0] != 0 or self.indptr[-1] != len(self.indices) or (np.diff(self.indptr) < 0).any():
            raise PlannerError("indptr does not fit indices; it must rise from 0 to their number")
        if len(self.indices) and not (self.indices.min() >= 0 and self.indices.max() < self.n_viewpoints):
            raise PlannerError(f"indices must be viewpoints, 0 to {self.n_viewpoints - 1}")
        rising = np.diff(self.indices) > 0
        starts = self.indptr[1:-1]
        rising[starts[(starts > 0) & (starts < len(self.indices))] - 1] = True  # a new row may start anywhere
        if not rising.all():
            raise PlannerError("indices must rise within each row, without repetition")

    @property
    def shape(self) -> tuple[int, int]:
        """(samples, viewpoints)."""
        return len(self.samples), self.n_viewpoints

    def matrix(self) -> "csr_array":
        """Return the (S, V) scipy matrix of bool, which shares the read-only arrays."""
        from scipy.sparse import csr_array

        indptr = self.indptr if len(self.indices) > np.iinfo(np.int32).max else self.indptr.astype(np.int32)
        matrix = csr_array((np.ones(len(self.indices), np.bool_), self.indices, indptr), shape=self.shape, copy=False)
        matrix.has_canonical_format = True
        return matrix

    def with_entries(self, retained: Bools) -> "Measurability":
        """Return the matrix with the selected ones of its (nnz,) entries."""
        before = np.concatenate([[0], np.cumsum(retained)])
        sigma = None if self.sigma is None else self.sigma[retained]
        return replace(self, indptr=before[self.indptr], indices=self.indices[retained], sigma=sigma)


def join_measurability(parts: Sequence[Measurability]) -> Measurability:
    """Join the columns of matrices with the same samples; keep sigma if every part has it."""
    from scipy.sparse import csr_array, hstack

    if len({len(part.samples) for part in parts}) != 1:
        sizes = ", ".join(str(len(part.samples)) for part in parts)
        raise PlannerError(f"matrices of {sizes} samples cannot be joined; their samples must be the same")
    sigmas = [part.sigma for part in parts if part.sigma is not None]
    if len(sigmas) < len(parts):
        return _from_csr(hstack([part.matrix() for part in parts], format="csr"), parts[0].samples)
    stacks = [
        csr_array((sigma, part.indices, part.indptr), shape=part.shape)
        for part, sigma in zip(parts, sigmas, strict=True)
    ]
    return _from_csr(hstack(stacks, format="csr"), parts[0].samples, has_sigma=True)


def measurability_of(seen: Bools, samples: SurfaceSamples) -> Measurability:
    """Return the matrix of (S, n) measured samples."""
    from scipy.sparse import csr_array

    return _from_csr(csr_array(seen), samples)


def pick_measurability(measurability: Measurability, which: NDArray[np.integer]) -> Measurability:
    """Return M with the columns (n,) `which`, in this order, without sigma."""
    return _from_csr(measurability.matrix().tocsc()[:, which].tocsr(), measurability.samples)


def spread_measurability(measurability: Measurability, which: NDArray[np.integer], total: int) -> Measurability:
    """Return M with `total` columns, of which (n,) `which` (ascending) are those of M and the others empty."""
    indices = np.asarray(which, dtype=np.int32)[measurability.indices]
    return replace(measurability, indices=indices, n_viewpoints=total)


def _from_csr(matrix: "csr_array", samples: SurfaceSamples, *, has_sigma: bool = False) -> Measurability:
    matrix.sort_indices()
    sigma = matrix.data if has_sigma else None
    indptr, indices = matrix.indptr.astype(np.int64), matrix.indices.astype(np.int32)
    return Measurability(indptr, indices, samples, matrix.shape[1], sigma)


def append_rows(measurability: Measurability, more: Measurability, spread: SurfaceSamples) -> Measurability:
    """Append samples to M and share out the areas again.

    All samples of a planning face (of a region on it, if the part has regions) share its area equally, so that many
    samples on one face enlarge neither it nor a region. The total area stays.

    Args:
        measurability: M.
        more: the same columns over other samples, with sigma if M has it.
        spread: samples all over the surface, from which the area of each face (or region on it) is estimated. A face
            without such samples has the area of one of them.
    """
    if measurability.n_viewpoints != more.n_viewpoints:
        raise PlannerError(
            f"rows of {more.n_viewpoints} viewpoints cannot be added to M of {measurability.n_viewpoints}; fill them "
            "for the same candidates"
        )
    if (measurability.sigma is None) != (more.sigma is None):
        raise PlannerError("only one of the matrices has a layer of sigma; calculate it for both")
    samples_before, new = measurability.samples, more.samples
    samples = SurfaceSamples.join([samples_before, new])
    piece, piece_of_spread = _piece_numbers(samples, spread)
    count = np.bincount(piece)
    area = np.bincount(piece_of_spread, weights=spread.areas, minlength=len(count))[: len(count)]
    areas = (np.maximum(area, spread.areas.min()) / np.maximum(count, 1))[piece]
    sigma = None
    if measurability.sigma is not None and more.sigma is not None:
        sigma = np.concatenate([measurability.sigma, more.sigma])
    return Measurability(
        np.concatenate([measurability.indptr, measurability.indptr[-1] + more.indptr[1:]]),
        np.concatenate([measurability.indices, more.indices]),
        replace(samples, areas=areas * (samples_before.areas.sum() / areas.sum())),
        measurability.n_viewpoints,
        sigma,
    )


def _piece_numbers(*samples: SurfaceSamples) -> list[Ints]:
    """Return for each set of samples (S,) a number of the planning face and region of each sample."""
    regions = [each.region for each in samples if each.region is not None]
    if len(regions) < len(samples):
        return [each.planning_face.astype(np.int64) for each in samples]
    count = 1 + max(int(region.max()) for region in regions)
    return [each.planning_face * np.int64(count) + region for each, region in zip(samples, regions, strict=True)]
