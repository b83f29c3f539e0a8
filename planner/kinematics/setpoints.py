"""Set-points: joint angles as a controller takes them, with every turn of +-360 deg that the joint limits allow.

A set-point is a multiple of 1e-4 deg on each axis: an integer on every wire. Angles are rounded before the limits and
before any collision check, so that the commanded configuration is the checked one.
"""

import itertools
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from planner.ports import JointLimits
from planner.values import Bools, Floats, Ints, Value

STEPS_PER_DEGREE = 10_000
TURN = 360 * STEPS_PER_DEGREE  # steps
_LIMIT_NOISE = 1e-6  # rounding, in steps, of limits that were given in degrees


def to_steps(q: ArrayLike) -> Ints:
    """Return the nearest multiples of 1e-4 deg of joint angles [rad], as the integers of a controller."""
    return np.asarray(np.rint(np.rad2deg(np.asarray(q, dtype=np.float64)) * STEPS_PER_DEGREE), dtype=np.int64)


def from_steps(steps: ArrayLike) -> Floats:
    """Return the joint angles [rad] of multiples of 1e-4 deg."""
    return np.deg2rad(np.asarray(steps, dtype=np.int64) / STEPS_PER_DEGREE)


def range_in_steps(limits: JointLimits) -> tuple[Ints, Ints]:
    """Return (axes,) the first and (axes,) the last multiple of 1e-4 deg inside the joint range."""
    lower = np.ceil(np.rad2deg(limits.lower) * STEPS_PER_DEGREE - _LIMIT_NOISE)
    upper = np.floor(np.rad2deg(limits.upper) * STEPS_PER_DEGREE + _LIMIT_NOISE)
    return lower.astype(np.int64), upper.astype(np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Setpoints(Value):
    """All set-points within the joint limits that bring the flange to N poses.

    Attributes:
        real: (N,) whether the pose has a configuration at all, limits aside.
        q: (n, axes) set-points [rad], ordered by pose, branch, turn; the turn nearest to the branch comes first.
        pose: (n,) pose of each row of q.
        first: (g,) first row of q of each geometry, that is, of each pose and branch.
        geometry: (n,) geometry of which each row is a turn.
    """

    real: Annotated[Bools, "N"]
    q: Annotated[Floats, "n axes"]
    pose: Annotated[Ints, "n"]
    first: Annotated[Ints, "g"]
    geometry: Annotated[Ints, "n"]


def setpoints(branches: Floats, limits: JointLimits) -> Setpoints:
    """Round the branches to set-points and add every turn of +-360 deg within the limits.

    A pose with `real` False has no configuration. A pose with `real` True and no row of q has some, but none within the
    limits.

    Args:
        branches: (N, B, axes) joint angles [rad] in (-pi, pi], NaN for a branch without a real solution.
        limits: joint limits.
    """
    exists: Bools = np.asarray(~np.isnan(branches).any(axis=-1))
    steps = to_steps(np.where(exists[..., None], branches, 0.0))
    lower, upper = range_in_steps(limits)
    choices = _turns(lower, upper)
    # Test each turn of each axis once; a combination of turns fits if all its axes do.
    axis_fits = [
        {k: (steps[..., axis] >= lower[axis] - k * TURN) & (steps[..., axis] <= upper[axis] - k * TURN) for k in turns}
        for axis, turns in enumerate(choices)
    ]
    turns = np.array(list(itertools.product(*choices)), dtype=np.int64).reshape(-1, len(choices))
    fits = np.empty((*exists.shape, len(turns)), dtype=np.bool_)
    for index, turn in enumerate(turns.tolist()):
        fits[..., index] = exists & np.logical_and.reduce([axis_fits[axis][k] for axis, k in enumerate(turn)])
    pose, branch, which = np.nonzero(fits)
    # The limits themselves are set-points; clipping removes the last bit by which their radians may differ.
    q = np.clip(from_steps(steps[pose, branch] + turns[which] * TURN), limits.lower, limits.upper)
    fresh = np.ones(len(q), dtype=np.bool_)
    fresh[1:] = (pose[1:] != pose[:-1]) | (branch[1:] != branch[:-1])
    return Setpoints(np.asarray(exists.any(axis=-1)), q, pose, np.flatnonzero(fresh), np.cumsum(fresh) - 1)


def first_setpoints(branches: Floats, limits: JointLimits) -> tuple[Floats, Ints]:
    """Return the first set-point (g, axes) [rad] of each geometry of `setpoints`, and the pose (g,) of each.

    The axes are independent: the first turn of each that fits makes the first combination that fits.
    """
    pose, branch = np.nonzero(~np.isnan(branches).any(axis=-1))
    lower, upper = range_in_steps(limits)
    choices = _turns(lower, upper)
    turns = np.array([[each[min(k, len(each) - 1)] for each in choices] for k in range(max(map(len, choices)))])
    steps = to_steps(branches[pose, branch]) + TURN * turns[:, None]
    fits = (steps >= lower) & (steps <= upper)
    is_within = fits.any(axis=0).all(axis=1)
    first = np.take_along_axis(steps, fits.argmax(axis=0)[None], axis=0)[0, is_within]
    return np.clip(from_steps(first), limits.lower, limits.upper), pose[is_within]


def _turns(lower: Ints, upper: Ints) -> list[list[int]]:
    """Return for each axis the full turns that keep some angle of (-180, 180] deg within its limits; 0 first."""
    half = TURN // 2
    most = int(np.abs([lower, upper]).max()) // TURN + 1
    return [
        sorted(
            (k for k in range(-most, most + 1) if k * TURN + half >= low and k * TURN - half <= high),
            key=lambda k: (abs(k), k),
        )
        for low, high in zip(lower.tolist(), upper.tolist(), strict=True)
    ]
