"""Columns of M put side by side or picked, in the order of the candidates that they belong to.

A candidate is one row of `Viewpoints` and of `Reach` and one column of `Measurability`; a generator that adds
candidates appends to all three, and the numbers of those that were there before stay.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError
from planner.measurability.matrix import Measurability
from planner.surface.sample import SurfaceSamples

if TYPE_CHECKING:
    from scipy.sparse import csr_array


def join_measurability(parts: Sequence[Measurability]) -> Measurability:
    """M with the columns of all parts, which have the same features; with its sigma where every part has it.

    Raises:
        PlannerError: if the parts differ in their number of features.
    """
    from scipy.sparse import hstack

    if len({len(part.features) for part in parts}) != 1:
        sizes = ", ".join(str(len(part.features)) for part in parts)
        raise PlannerError(f"matrices of {sizes} features cannot be joined; their features must be the same")
    sigmas = [part.sigma for part in parts]
    layer = [sigma for sigma in sigmas if sigma is not None]
    if len(layer) < len(parts):
        return _of(hstack([part.matrix() for part in parts], format="csr"), parts[0].features)
    stacks = [_with(part, sigma) for part, sigma in zip(parts, layer, strict=True)]
    return _of(hstack(stacks, format="csr"), parts[0].features, layered=True)


def pick_measurability(measurability: Measurability, which: NDArray[np.integer]) -> Measurability:
    """M with some of its columns: (n,) viewpoints in the order that is wanted."""
    return _of(measurability.matrix().tocsc()[:, which].tocsr(), measurability.features)


def spread_measurability(measurability: Measurability, which: NDArray[np.integer], total: int) -> Measurability:
    """M whose columns are those of some viewpoints of a longer list; the columns of the others are empty.

    Args:
        measurability: M of n viewpoints.
        which: (n,) their rows in the list, ascending.
        total: length of the list.
    """
    indices = np.asarray(which, dtype=np.int32)[measurability.indices]
    return Measurability(measurability.indptr, indices, measurability.features, total, measurability.sigma)


def _with(measurability: Measurability, data: NDArray[np.float32]) -> "csr_array":
    from scipy.sparse import csr_array

    return csr_array((data, measurability.indices, measurability.indptr), shape=measurability.shape)


def _of(matrix: "csr_array", features: SurfaceSamples, *, layered: bool = False) -> Measurability:
    matrix.sort_indices()
    sigma = matrix.data if layered else None
    indptr, indices = matrix.indptr.astype(np.int64), matrix.indices.astype(np.int32)
    return Measurability(indptr, indices, features, matrix.shape[1], sigma)
