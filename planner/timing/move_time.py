"""Duration of synchronised straight joint moves, rest to rest.

A move from `q_from` to `q_to` is `q(s) = q_from + s (q_to - q_from)`, s from 0 to 1: all axes start and stop together
and the path is the straight joint segment that is checked for collision. The limits of an axis on speed, acceleration
and jerk divided by its `|dq|` limit s; the smallest over the axes applies, and `planner.timing.s_curve` gives the
fastest profile of s. All limits are reduced by `MARGIN`, so that rounding never lifts a sample, or a finite difference
of samples, above a limit.
"""

import math
from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from planner.ports import ARM_AXES, JointLimits
from planner.timing.limits import require_usable
from planner.timing.s_curve import Profile, fastest_profile
from planner.values import Floats

MARGIN = 1e-8
"""Relative reduction of the limits; at samples 1 ms apart a hundred times the rounding of a second difference."""

RESOLUTION = 1e-13
"""Largest difference [rad] of equal joint angles: rounding, a millionth of the resolution of any controller."""

_BLOCK = 4096  # moves timed at once: their temporaries stay in the core's cache
_EQUAL_RATIO = 1e-12  # largest relative difference of equal ratios between limits


def move_time(q_from: ArrayLike, q_to: ArrayLike, limits: JointLimits) -> Floats:
    """Return the shortest durations [s] of synchronised straight moves, rest to rest; 0 if both ends are equal.

    With an indexed table (`limits.table_turn_q`) it is the sum of the times of arm and table: no path that moves them
    one after the other is faster.

    Args:
        q_from: (..., axes) joint angles [rad].
        q_to: (..., axes) joint angles [rad]; broadcast against `q_from`, so `(n, 1, axes)` and `(m, axes)` give a cost
            matrix.
        limits: limits of velocity, acceleration and jerk.
    """
    a, b = np.asarray(q_from, dtype=float), np.asarray(q_to, dtype=float)
    if limits.table_turn_q is not None:
        arm, table = _split_limits(limits)
        return move_time(a[..., :ARM_AXES], b[..., :ARM_AXES], arm) + move_time(
            a[..., ARM_AXES:], b[..., ARM_AXES:], table
        )
    times = np.empty(np.broadcast_shapes(a.shape, b.shape)[:-1])
    for rows, profile in move_profiles(a, b, limits):
        times[rows] = profile.duration
    return np.asarray(times[()])


@lru_cache(maxsize=64)
def _split_limits(limits: JointLimits) -> tuple[JointLimits, JointLimits]:
    """Return the limits of the arm's axes and those of the external ones."""
    each = (limits.lower, limits.upper, limits.velocity, limits.acceleration, limits.jerk)
    return JointLimits(*(limit[:ARM_AXES] for limit in each)), JointLimits(*(limit[ARM_AXES:] for limit in each))


@lru_cache(maxsize=64)
def _inverse(limits: JointLimits) -> tuple[Floats, tuple[float, float]]:
    """Return (3, axes) inverse limits with `MARGIN`, and the ratios of acceleration and jerk to speed.

    If all axes have the same ratio (such as an acceleration reached in the same time), the axis that limits the speed
    also limits acceleration and jerk, and two of the three maxima over the axes are not needed. Else the ratio is NaN.
    """
    require_usable(limits)
    inverse = (1.0 + MARGIN) / np.stack([limits.velocity, limits.acceleration, limits.jerk])
    ratios = np.divide(inverse[1:], inverse[0], out=np.full_like(inverse[1:], np.inf), where=inverse[0] > 0)
    one = np.isfinite(ratios).all(axis=1) & (ratios.max(axis=1) <= ratios.min(axis=1) * (1.0 + _EQUAL_RATIO))
    acceleration, jerk = np.where(one, ratios.max(axis=1), np.nan).tolist()
    return inverse, (acceleration, jerk)


def move_profiles(q_from: Floats, q_to: Floats, limits: JointLimits) -> Iterator[tuple[tuple[slice, ...], Profile]]:
    """Yield the profiles of all moves in blocks along the first axis of the broadcast shape."""
    inverse, ratios = _inverse(limits)
    shape = np.broadcast_shapes(q_from.shape, q_to.shape)[:-1]
    if 0 in shape:
        return
    ends = [np.ascontiguousarray(np.moveaxis(q, -1, 0)) for q in (q_from, q_to)]  # axis by axis
    a, b = (q.reshape(len(inverse[0]), *[1] * (len(shape) + 1 - q.ndim), *q.shape[1:]) for q in ends)
    speed, *others = (rates.reshape(len(inverse[0]), *[1] * len(shape)) for rates in inverse)
    step = max(1, _BLOCK * shape[0] // math.prod(shape)) if shape else 1
    for start in range(0, shape[0] if shape else 1, step):
        rows = (slice(start, start + step),) if shape else ()
        distance = (b[:, *rows] if b.shape[1:2] != (1,) else b) - (a[:, *rows] if a.shape[1:2] != (1,) else a)
        np.abs(distance, out=distance)
        distance *= distance > RESOLUTION
        at_speed = (distance * speed).max(axis=0)
        at_acceleration, at_jerk = (
            (distance * rates).max(axis=0) if math.isnan(ratio) else at_speed * ratio
            for rates, ratio in zip(others, ratios, strict=True)
        )
        yield rows, fastest_profile(at_speed, at_acceleration, at_jerk)
