"""The measurability matrix M: which surface feature is measured from which viewpoint (Section 3.5.1).

M is binary; its rows are features (samples of the part's surface, or the paper's planning faces), its columns are
candidate viewpoints. It is filled in one of two ways:

    aimed    one leg to each feature: the feature is measured where the scanner's conditions hold and both legs are free
    rays     the paper's: the scanner's ray grid is cast from the viewpoint; the rows of the faces it measures are set

`aimed` answers for the features themselves and does not depend on a ray grid; `rays` answers for what one scan at the
planning resolution would hit. Object frame, metres.

Columns of M put side by side or picked, in the order of the candidates that they belong to.

A candidate is one row of `Viewpoints` and of `Reach` and one column of `Measurability`; a generator that adds
candidates appends to all three, and the numbers of those that were there before stay.

Rows of M added where a plan turned out to need them, and the area that each row stands for then.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError
from planner.geometry.sampling import SurfaceSamples, join_samples
from planner.values import Ints, Ints32, Value, freeze

if TYPE_CHECKING:
    from scipy.sparse import csr_array


@dataclass(frozen=True, slots=True, eq=False)
class Measurability(Value):
    """A binary matrix in compressed sparse rows: features x viewpoints.

    Attributes:
        indptr: (S + 1,) int64 where each feature's viewpoints start in `indices`.
        indices: (nnz,) int32 viewpoints that measure the feature, ascending within a row.
        features: the S rows.
        n_viewpoints: number of columns V.
        sigma: (nnz,) float32 expected standard deviation of the point that each entry gives [m], from
            `planner.measurability.quality.sigma_layer`; None where it was not asked for.
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
        """(features, viewpoints)."""
        return len(self.samples), self.n_viewpoints

    def matrix(self) -> "csr_array":
        """(S, V) scipy matrix of bool; it shares the read-only arrays."""
        from scipy.sparse import csr_array

        indptr = self.indptr if len(self.indices) > np.iinfo(np.int32).max else self.indptr.astype(np.int32)
        matrix = csr_array((np.ones(len(self.indices), np.bool_), self.indices, indptr), shape=self.shape, copy=False)
        matrix.has_canonical_format = True
        return matrix


def join_measurability(parts: Sequence[Measurability]) -> Measurability:
    """M with the columns of all parts, which have the same features; with its sigma where every part has it.

    Raises:
        PlannerError: if the parts differ in their number of features.
    """
    from scipy.sparse import hstack

    if len({len(part.samples) for part in parts}) != 1:
        sizes = ", ".join(str(len(part.samples)) for part in parts)
        raise PlannerError(f"matrices of {sizes} features cannot be joined; their features must be the same")
    sigmas = [part.sigma for part in parts]
    layer = [sigma for sigma in sigmas if sigma is not None]
    if len(layer) < len(parts):
        return _of(hstack([part.matrix() for part in parts], format="csr"), parts[0].samples)
    stacks = [_with(part, sigma) for part, sigma in zip(parts, layer, strict=True)]
    return _of(hstack(stacks, format="csr"), parts[0].samples, layered=True)


def pick_measurability(measurability: Measurability, which: NDArray[np.integer]) -> Measurability:
    """M with some of its columns: (n,) viewpoints in the order that is wanted."""
    return _of(measurability.matrix().tocsc()[:, which].tocsr(), measurability.samples)


def spread_measurability(measurability: Measurability, which: NDArray[np.integer], total: int) -> Measurability:
    """M whose columns are those of some viewpoints of a longer list; the columns of the others are empty.

    Args:
        measurability: M of n viewpoints.
        which: (n,) their rows in the list, ascending.
        total: length of the list.
    """
    indices = np.asarray(which, dtype=np.int32)[measurability.indices]
    return Measurability(measurability.indptr, indices, measurability.samples, total, measurability.sigma)


def _with(measurability: Measurability, data: NDArray[np.float32]) -> "csr_array":
    from scipy.sparse import csr_array

    return csr_array((data, measurability.indices, measurability.indptr), shape=measurability.shape)


def _of(matrix: "csr_array", features: SurfaceSamples, *, layered: bool = False) -> Measurability:
    matrix.sort_indices()
    sigma = matrix.data if layered else None
    indptr, indices = matrix.indptr.astype(np.int64), matrix.indices.astype(np.int32)
    return Measurability(indptr, indices, features, matrix.shape[1], sigma)


def append_rows(measurability: Measurability, more: Measurability, spread: SurfaceSamples) -> Measurability:
    """M with further features below its own.

    All features of a planning face (of a region on it, where the part has regions) share its area equally, so that many
    on one face make neither it nor a region larger. All areas together stay what they were.

    Args:
        measurability: M.
        more: the same columns over other features, with sigma where M has it.
        spread: samples all over the surface, which say how large each face, or a region on it, is; one that none of
            them lies on is as large as what one of them stands for.

    Raises:
        PlannerError: if the columns differ, or only one of the two has sigma.
    """
    if measurability.n_viewpoints != more.n_viewpoints:
        raise PlannerError(
            f"rows of {more.n_viewpoints} viewpoints cannot be added to M of {measurability.n_viewpoints}; fill them "
            "for the same candidates"
        )
    if (measurability.sigma is None) != (more.sigma is None):
        raise PlannerError("only one of the matrices has a layer of sigma; calculate it for both")
    own, new = measurability.samples, more.samples
    features = join_samples([own, new])
    piece, piece_of_spread = _pieces(features, spread)
    number = np.bincount(piece)
    area = np.bincount(piece_of_spread, weights=spread.areas, minlength=len(number))[: len(number)]
    areas = (np.maximum(area, spread.areas.min()) / np.maximum(number, 1))[piece]
    sigma = None
    if measurability.sigma is not None and more.sigma is not None:
        sigma = np.concatenate([measurability.sigma, more.sigma])
    return Measurability(
        np.concatenate([measurability.indptr, measurability.indptr[-1] + more.indptr[1:]]),
        np.concatenate([measurability.indices, more.indices]),
        replace(features, areas=areas * (own.areas.sum() / areas.sum())),
        measurability.n_viewpoints,
        sigma,
    )


def _pieces(*samples: SurfaceSamples) -> list[Ints]:
    """(S,) for each of several samples: a number of the planning face and the region that a sample lies on."""
    regions = [each.region for each in samples if each.region is not None]
    if len(regions) < len(samples):
        return [each.planning_face.astype(np.int64) for each in samples]
    count = 1 + max(int(region.max()) for region in regions)
    return [each.planning_face * np.int64(count) + region for each, region in zip(samples, regions, strict=True)]
