"""Certify straight joint segments: free of collision between the checked configurations too.

Proof. Let `c` be the checker's clearance, so that at a free configuration every checked pair is at least `c` apart. A
segment is subdivided evenly at configurations q_0 .. q_n such that from each q_k to the midpoints between it and its
neighbours no point of arm or tool moves farther than `d = STEP * c`: this holds for n >= travel / (2 d), because such a
half interval is a share 1 / (2 n) of the segment and the checker's `travel` bounds displacement in proportion. Every
configuration q of the segment lies in a half interval, so each point of arm and tool is within `d` of its place at a
checked configuration, and

- a pair of a moving and a fixed body is at least `c - d = (1 - STEP) c` apart at q;
- a pair of two moving bodies (such as housing and forearm) is at least `c - 2 d = (1 - 2 STEP) c` apart: both may have
  moved towards each other, and `travel` bounds the motion of each in the base frame, not their relative motion.

With STEP = 0.45 these are 0.55 c and 0.1 c: no contact anywhere on the segment. STEP = 0.5 would leave two moving
bodies no distance.

Via points are rounded to integers of 1e-4 deg (`quantise`) before the check, so the driven path is the certified one.
"""

from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from planner.errors import PlannerError
from planner.kinematics.setpoints import from_steps, range_in_steps, to_steps
from planner.ports import CollisionChecker, JointLimits
from planner.values import Bools, Floats, Ints

STEP = 0.45
"""Largest travel between a configuration and its nearest checked one, as a share of the clearance; below 0.5."""

_FIRST_BATCH, _GROWTH = 8, 4  # a collision is mostly found within a few checks; a free segment needs them all


def quantise(q: ArrayLike) -> Floats:
    """Round joint angles (..., axes) [rad] to multiples of 1e-4 deg, the integers on every wire; idempotent."""
    return from_steps(to_steps(q))


def quantise_inside(q: ArrayLike, limits: JointLimits) -> Floats:
    """Quantise joint angles (..., axes) [rad]; those outside the joint range become the last multiple inside."""
    return np.clip(from_steps(np.clip(to_steps(q), *range_in_steps(limits))), limits.lower, limits.upper)


def certify(q_from: Floats, q_to: Floats, checker: CollisionChecker) -> tuple[bool, int]:
    """Certify one segment (axes,) [rad]; see `certify_many`."""
    certified, checks = certify_many(q_from[None], q_to[None], checker)
    return bool(certified[0]), checks


def certify_many(q_from: Floats, q_to: Floats, checker: CollisionChecker) -> tuple[Bools, int]:
    """Return (N,) whether straight segments with free ends (N, axes) [rad] are free everywhere, and the checks.

    The checks run in bisection order in growing batches; for a segment they stop at the first batch with a collision.
    """
    segments = subdivide(q_from, q_to, checker)
    waiting = [_bisection_batches(len(s)) for s in segments]
    certified, checks, active = np.ones(len(segments), dtype=bool), 0, list(range(len(segments)))
    while active:
        batches = [(k, batch) for k in active if (batch := next(waiting[k], None)) is not None]
        active = []
        if batches:
            free = checker.free(np.concatenate([segments[k][batch] for k, batch in batches]))
            checks += len(free)
            starts = np.cumsum([0, *(len(batch) for _, batch in batches)])
            for (k, _), start, stop in zip(batches, starts[:-1], starts[1:], strict=True):
                certified[k] = free[start:stop].all()
                if certified[k]:
                    active.append(k)
    return certified, checks


def subdivide(q_from: Floats, q_to: Floats, checker: CollisionChecker) -> list[Floats]:
    """Return the configurations of straight segments whose freedom certifies all of each (see the module's proof).

    Args:
        q_from: (N, axes) [rad].
        q_to: (N, axes) [rad].
        checker: gives clearance (which must be above 0) and travel, in one call for all segments.

    Returns:
        For each segment, (n + 1, axes) evenly spaced configurations with both ends; (1, axes) if the ends are equal.
    """
    allowed = STEP * checker.clearance
    if not allowed > 0:
        raise PlannerError(f"the checker's clearance is {checker.clearance} m; it must be above 0 to certify a motion")
    counts = np.maximum(1, np.ceil(checker.travel(q_from, q_to) / (2.0 * allowed))).astype(int)
    pieces = []
    for start, stop, count in zip(q_from, q_to, counts, strict=True):
        configurations = start + np.linspace(0.0, 1.0, count + 1)[:, None] * (stop - start)
        configurations[-1] = stop
        pieces.append(start[None] if np.array_equal(start, stop) else configurations)
    return pieces


def _bisection_batches(count: int) -> Iterator[Ints]:
    """Yield the indices between the ends, 1..count-2, in bisection order, in growing batches."""
    order = _bisection_order(count)[2:]
    start, size = 0, _FIRST_BATCH
    while start < len(order):
        yield order[start : start + size]
        start, size = start + size, size * _GROWTH


@lru_cache(maxsize=4096)
def _bisection_order(count: int) -> Ints:
    """Return (count,) indices, each once: 0, count - 1, then the middles of ever smaller intervals."""
    if count < 3:
        return np.arange(count)
    # The radical inverse in base 2 visits the multiples of 1 / 2^bits in bisection order; each index counts when it
    # first occurs.
    bits = int(np.ceil(np.log2(count)))
    counter = np.arange(2**bits)
    inverse = np.zeros(2**bits)
    for bit in range(bits):
        inverse += ((counter >> bit) & 1) * 0.5 ** (bit + 1)
    indices = np.floor(inverse * count).astype(np.int64)
    _, first = np.unique(indices, return_index=True)
    middle = indices[np.sort(first)]
    middle = middle[(middle != 0) & (middle != count - 1)]
    return np.concatenate((np.array([0, count - 1]), middle))
