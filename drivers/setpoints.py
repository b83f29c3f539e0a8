"""Joint set-points as integers: int32 counts of 1e-4 deg, the one form in which axes travel on every wire.

A plan is quantised to these counts *before* it is checked for collision, so whatever back end executes it executes
exactly what was checked. `to_rad(from_rad(q))` is that quantisation, bit for bit `radians(round(degrees(q), 4))`; the
counts survive the way to radians and back. An int32 holds +-214,748 deg.
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
"""Fewest axes of an arm; external axes follow A6."""


def axis_name(axis: int) -> str:
    """What a reader calls an axis by its number from 0: A1 to A6, then the external E1 on."""
    return f"A{axis + 1}" if axis < AXES else f"E{axis + 1 - AXES}"


_INT32 = np.iinfo(np.int32)


def from_rad(q: ArrayLike) -> SetPoints:
    """Nearest counts of joint angles.

    Args:
        q: (..., n) joint angles [rad], n at least 6.

    Returns:
        (..., n) int32 counts of 1e-4 deg, read-only.

    Raises:
        SetPointError: if the last axis is less than 6 long, a value is not finite, or it does not fit an int32.
    """
    angles = np.asarray(q)
    if angles.dtype.kind not in "fiu":
        raise SetPointError(f"joint angles have type {angles.dtype}; they must be real numbers in radians")
    if angles.ndim == 0 or angles.shape[-1] < AXES:
        raise SetPointError(
            f"joint angles have shape {angles.shape}; they must be (..., n), n >= {AXES}, A1 on in radians"
        )
    counts = np.rint(np.degrees(angles.astype(np.float64)) * PER_DEGREE)
    if not (np.abs(counts) <= _INT32.max).all():
        axis = int(np.argwhere(~(np.abs(counts) <= _INT32.max))[0][-1])
        raise SetPointError(
            f"a joint angle of {axis_name(axis)} is not finite or does not fit 32 bits; it must lie within "
            f"+-{_INT32.max / PER_DEGREE:.4f} deg"
        )
    return frozen(counts, np.int32)


def to_rad(counts: SetPoints) -> Floats:
    """Joint angles [rad] of counts of any shape, bit-identical for equal counts."""
    return np.radians(np.asarray(counts, dtype=np.int32) / PER_DEGREE)


def to_deg(counts: SetPoints) -> Floats:
    """Joint angles [deg] of counts of any shape."""
    return np.asarray(np.asarray(counts, dtype=np.int32) / PER_DEGREE)


def check(set_points: Any) -> SetPoints:
    """Take set-points in, strictly: a cast that could change a number is the caller's to make (`from_rad`).

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
    """A C-contiguous, read-only copy."""
    array = np.array(values, dtype=dtype, order="C", copy=True)
    array.flags.writeable = False
    return array


def text(counts: SetPoints) -> str:
    """Axes for a message: "(0.0000, -90.0000, 90.0000, 0.0000, 90.0000, 0.0000) deg"."""
    return "(" + ", ".join(f"{angle:.4f}" for angle in to_deg(counts)) + ") deg"
