"""Joint set-points as integers: int32 counts of 1e-4 deg, the only representation of axes on every wire.

A plan is quantised to these counts *before* the collision check, so every driver executes exactly the checked motion.
`to_rad(from_rad(q))` is this quantisation, bit for bit `radians(round(degrees(q), 4))`. The conversion of counts to
radians and back is exact. An int32 holds +-214,748 deg.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drivers.errors import SetPointError

SetPoints = NDArray[np.int32]
Floats = NDArray[np.float64]

PER_DEGREE = 10_000
"""Counts per degree."""

AXES = 6
"""Smallest number of axes of an arm; external axes follow A6."""

MAX_COUNT = np.iinfo(np.int32).max
"""Largest number of counts of a set-point, in both directions."""


def axis_name(axis: int) -> str:
    """Return the name of the axis with this 0-based number: A1 to A6, then external axes from E1."""
    return f"A{axis + 1}" if axis < AXES else f"E{axis + 1 - AXES}"


def from_rad(q: ArrayLike) -> SetPoints:
    """Round joint angles to the nearest counts.

    Args:
        q: (..., n) joint angles [rad], n at least 6.

    Returns:
        (..., n) int32 counts of 1e-4 deg, read-only.

    Raises:
        SetPointError: if the last dimension is below 6, or a value is not finite or does not fit an int32.
    """
    angles = np.asarray(q)
    if angles.dtype.kind not in "fiu":
        raise SetPointError(f"joint angles have type {angles.dtype}; they must be real numbers in radians")
    if angles.ndim == 0 or angles.shape[-1] < AXES:
        raise SetPointError(
            f"joint angles have shape {angles.shape}; they must be (..., n), n >= {AXES}, in radians from A1 on"
        )
    counts = np.rint(np.degrees(angles.astype(np.float64)) * PER_DEGREE)
    if not (np.abs(counts) <= MAX_COUNT).all():
        axis = int(np.argwhere(~(np.abs(counts) <= MAX_COUNT))[0][-1])
        raise SetPointError(
            f"a joint angle of {axis_name(axis)} is not finite or does not fit 32 bits; it must lie within "
            f"+-{MAX_COUNT / PER_DEGREE:.4f} deg"
        )
    return frozen(counts, np.int32)


def to_rad(counts: SetPoints) -> Floats:
    """Convert counts of any shape to joint angles [rad], bit-identical for equal counts."""
    return np.radians(np.asarray(counts, dtype=np.int32) / PER_DEGREE)


def to_deg(counts: SetPoints) -> Floats:
    """Convert counts of any shape to joint angles [deg]."""
    return np.asarray(np.asarray(counts, dtype=np.int32) / PER_DEGREE)


def require_set_points(set_points: Any) -> SetPoints:
    """Validate set-points without any conversion.

    Args:
        set_points: (N, n) int32 counts of 1e-4 deg, N at least 1, n at least 6.

    Returns:
        A read-only copy.

    Raises:
        SetPointError: if the type is not int32 or the shape not (N, n).
    """
    if not isinstance(set_points, np.ndarray) or set_points.dtype != np.dtype(np.int32):
        kind = set_points.dtype if isinstance(set_points, np.ndarray) else type(set_points).__name__
        raise SetPointError(
            f"set-points have type {kind}; they must be a NumPy array of int32 in counts of 1e-4 deg "
            "(drivers.setpoints.from_rad makes them from radians)"
        )
    if set_points.ndim != 2 or set_points.shape[1] < AXES or len(set_points) == 0:
        raise SetPointError(
            f"set-points have shape {set_points.shape}; they must be (N, n), one row per via point, at least one, of "
            f"n >= {AXES} axes"
        )
    return frozen(set_points, np.int32)


def frozen(values: ArrayLike, dtype: Any) -> NDArray[Any]:
    """Return a C-contiguous, read-only copy."""
    array = np.array(values, dtype=dtype, order="C", copy=True)
    array.flags.writeable = False
    return array


def format_axes(counts: SetPoints) -> str:
    """Format axes for a message: "(0.0000, -90.0000, 90.0000, 0.0000, 90.0000, 0.0000) deg"."""
    return "(" + ", ".join(f"{angle:.4f}" for angle in to_deg(counts)) + ") deg"
