"""Read-only arrays: the one helper through which every value type takes its arrays in."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from planner.errors import PlannerError


def readonly(name: str, values: ArrayLike, shape: Sequence[int | None], dtype: DTypeLike = np.float64) -> NDArray[Any]:
    """Copy, cast and shape-check an array and make it read-only.

    Args:
        name: what the error calls the array.
        values: anything NumPy can turn into an array.
        shape: the required shape; None stands for any length on that axis.
        dtype: the element type of the copy.

    Returns:
        A C-contiguous, read-only copy.

    Raises:
        PlannerError: if the shape differs or a floating-point value is NaN.
    """
    array = np.array(values, dtype=dtype, order="C", copy=True)
    if array.ndim != len(shape) or any(
        want is not None and have != want for have, want in zip(array.shape, shape, strict=True)
    ):
        wanted = ", ".join("any" if want is None else str(want) for want in shape)
        raise PlannerError(f"{name} has shape {array.shape}; it must be ({wanted})")
    if np.issubdtype(array.dtype, np.floating) and np.isnan(array).any():
        raise PlannerError(f"{name} contains NaN; every value must be a number")
    array.flags.writeable = False
    return array
