"""Set-points: joint angles as a controller takes them, with every turn of +-360 deg that the joint limits allow.

A set-point is a multiple of 1e-4 deg on each axis: an integer on every wire. Rounding comes before the limits and
before any collision check, so that what is found free is what is commanded.
"""

import itertools
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from planner.ports import JointLimits
from planner.values import Bools, Floats, Ints, Value

STEPS_PER_DEGREE = 10_000
_TURN = 360 * STEPS_PER_DEGREE
_LIMIT_NOISE = 1e-6  # rounding, in steps, of limits that were given in degrees


def to_steps(q: ArrayLike) -> Ints:
    """Joint angles as the integers of a controller.

    Args:
        q: joint angles [rad].

    Returns:
        The nearest multiples of 1e-4 deg, same shape.
    """
    return np.asarray(np.rint(np.rad2deg(np.asarray(q, dtype=np.float64)) * STEPS_PER_DEGREE), dtype=np.int64)


def from_steps(steps: ArrayLike) -> Floats:
    """Joint angles [rad] of multiples of 1e-4 deg."""
    return np.deg2rad(np.asarray(steps, dtype=np.int64) / STEPS_PER_DEGREE)


def range_in_steps(limits: JointLimits) -> tuple[Ints, Ints]:
    """(axes,) first and (axes,) last multiple of 1e-4 deg inside the joint range."""
    lower = np.ceil(np.rad2deg(limits.lower) * STEPS_PER_DEGREE - _LIMIT_NOISE)
    upper = np.floor(np.rad2deg(limits.upper) * STEPS_PER_DEGREE + _LIMIT_NOISE)
    return lower.astype(np.int64), upper.astype(np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Setpoints(Value):
    """All set-points within the joint limits that put the flange at given poses.

    Attributes:
        real: (N,) True where the pose has a solution at all, limits aside.
        q: (n, axes) set-points [rad], ordered by pose, branch, turn; the turn nearest the branch itself comes first.
        pose: (n,) int64 pose that each row of q reaches.
        first: (g,) int64 row of q that stands for each different geometry: one for each pose and branch.
        geometry: (n,) int64 which of those each row is a turn of.
    """

    real: Annotated[Bools, "N"]
    q: Annotated[Floats, "n axes"]
    pose: Annotated[Ints, "n"]
    first: Annotated[Ints, "g"]
    geometry: Annotated[Ints, "n"]


def setpoints(branches: Floats, limits: JointLimits) -> Setpoints:
    """Round the branches to set-points and take every turn of +-360 deg that the limits allow.

    A pose with `real` False has no solution; one with `real` True and no row of q has some, but none within the
    limits.

    Args:
        branches: (N, B, axes) joint angles [rad] in (-pi, pi], NaN where a branch has no real solution.
        limits: of the axes.
    """
    exists: Bools = np.asarray(~np.isnan(branches).any(axis=-1))
    steps = to_steps(np.where(exists[..., None], branches, 0.0))
    lower, upper = range_in_steps(limits)
    choices = _turns(lower, upper)
    # Whether axis and turn fit, each once; a combination of turns fits where all its axes do.
    axis_fits = [
        {k: (steps[..., axis] >= lower[axis] - k * _TURN) & (steps[..., axis] <= upper[axis] - k * _TURN) for k in some}
        for axis, some in enumerate(choices)
    ]
    turns = np.array(list(itertools.product(*choices)), dtype=np.int64).reshape(-1, len(choices))
    fits = np.empty((*exists.shape, len(turns)), dtype=np.bool_)
    for index, turn in enumerate(turns.tolist()):
        fits[..., index] = exists & np.logical_and.reduce([axis_fits[axis][k] for axis, k in enumerate(turn)])
    pose, branch, which = np.nonzero(fits)
    # The limits themselves are set-points; clipping removes the last bit by which their radians may differ.
    q = np.clip(from_steps(steps[pose, branch] + turns[which] * _TURN), limits.lower, limits.upper)
    fresh = np.ones(len(q), dtype=np.bool_)
    fresh[1:] = (pose[1:] != pose[:-1]) | (branch[1:] != branch[:-1])
    return Setpoints(np.asarray(exists.any(axis=-1)), q, pose, np.flatnonzero(fresh), np.cumsum(fresh) - 1)


def _turns(lower: Ints, upper: Ints) -> list[list[int]]:
    """Of each axis, the whole turns that keep some angle of (-180, 180] deg within its limits; no turn first."""
    half = _TURN // 2
    most = int(np.abs([lower, upper]).max()) // _TURN + 1
    return [
        sorted(
            (k for k in range(-most, most + 1) if k * _TURN + half >= low and k * _TURN - half <= high),
            key=lambda k: (abs(k), k),
        )
        for low, high in zip(lower.tolist(), upper.tolist(), strict=True)
    ]
