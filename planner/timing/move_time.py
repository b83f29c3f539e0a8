"""Time of synchronised straight joint moves, rest to rest.

A move from `q_from` to `q_to` is `q(s) = q_from + s (q_to - q_from)`, s from 0 to 1: all axes start and stop together
and the path is the straight joint segment that was checked for collision. An axis' limit on speed, acceleration or jerk
divided by its `|dq|` limits s; the smallest over the axes holds, and `planner.timing.s_curve` gives the fastest profile
of s under the three. All limits are taken `MARGIN` smaller than given, so that rounding never lifts a sample, or a
finite difference of samples, above a limit.
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
"""Relative distance kept from the limits; at samples 1 ms apart it is a hundred times the rounding of a second
difference."""

RESOLUTION = 1e-13
"""A joint difference [rad] up to which two angles are equal: their rounding, a millionth of what any controller
resolves."""

_BLOCK = 4096  # moves that are timed at once: their temporaries stay in the core's cache
_EQUAL_RATIO = 1e-12  # relative differences up to which limits of the axes are in one ratio


def move_time(q_from: ArrayLike, q_to: ArrayLike, limits: JointLimits) -> Floats:
    """Shortest time of the synchronised straight move, rest to rest, over broadcast arrays.

    Args:
        q_from: (..., axes) joint angles [rad].
        q_to: (..., axes) joint angles [rad]; broadcast against `q_from`, so `(n, 1, axes)` and `(m, axes)` give a cost
            matrix.
        limits: limits of velocity, acceleration and jerk.

    Returns:
        (...) time [s]; 0 where both ends are equal. Of arm and table one after the other where `limits.q_table_turn`
        says so: no way that keeps to it is faster.
    """
    a, b = np.asarray(q_from, dtype=float), np.asarray(q_to, dtype=float)
    if limits.table_turn_q is not None:
        arm, table = _apart(limits)
        return move_time(a[..., :ARM_AXES], b[..., :ARM_AXES], arm) + move_time(
            a[..., ARM_AXES:], b[..., ARM_AXES:], table
        )
    times = np.empty(np.broadcast_shapes(a.shape, b.shape)[:-1])
    for rows, profile in move_profiles(a, b, limits):
        times[rows] = profile.duration
    return np.asarray(times[()])


@lru_cache(maxsize=64)
def _apart(limits: JointLimits) -> tuple[JointLimits, JointLimits]:
    """Limits of the arm's axes, and of those behind them."""
    arm, behind = (
        JointLimits(limits.lower[axes], limits.upper[axes], limits.velocity[axes], limits.acceleration[axes],
                    limits.jerk[axes])
        for axes in (slice(ARM_AXES), slice(ARM_AXES, None))
    )  # fmt: skip
    return arm, behind


@lru_cache(maxsize=64)
def _inverse(limits: JointLimits) -> tuple[Floats, tuple[float, float]]:
    """Inverse limits of speed, acceleration and jerk, and what makes the first the others, for limits that can be used.

    Where the limits of all axes are in one ratio (each acceleration reached in the same time, say), the axis that
    limits the speed limits acceleration and jerk as well, and two of the three maxima over the axes can be left out.

    Returns:
        (3, axes) 1 / limit, `MARGIN` added, and the ratios of acceleration and jerk to speed; NaN where axes differ.
    """
    require_usable(limits)
    inverse = (1.0 + MARGIN) / np.stack([limits.velocity, limits.acceleration, limits.jerk])
    ratios = np.divide(inverse[1:], inverse[0], out=np.full_like(inverse[1:], np.inf), where=inverse[0] > 0)
    one = np.isfinite(ratios).all(axis=1) & (ratios.max(axis=1) <= ratios.min(axis=1) * (1.0 + _EQUAL_RATIO))
    acceleration, jerk = np.where(one, ratios.max(axis=1), np.nan).tolist()
    return inverse, (acceleration, jerk)


def move_profiles(q_from: Floats, q_to: Floats, limits: JointLimits) -> Iterator[tuple[tuple[slice, ...], Profile]]:
    """Profiles of all moves, in blocks along the first axis of the broadcast shape."""
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
