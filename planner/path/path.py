"""Connect two configurations by a certified path: the straight joint segment, else a short detour.

With an indexed table (`planner.path.indexed`), arm and table move one after the other, each along such a path.

A detour is found by RRT-Connect and then shortened in time. Each via point is an exact stop, so few via points matter
more than short moves: parts of the path are replaced by a straight segment, or by a single via point near them,
wherever this is certified and faster.
"""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from planner.path import indexed
from planner.path.certified_edge import certify, quantise_inside
from planner.path.rrt_connect import rrt_connect
from planner.ports import ARM_AXES, CollisionChecker, JointLimits
from planner.timing.limits import require_inside, require_usable
from planner.timing.move_time import move_time
from planner.values import DescribedEnum, Floats, Value, readonly

MAX_CHECKS = 40_000
"""Default budget of a search in checked configurations: about half a second at 80,000 per second."""


class PathStatus(DescribedEnum):
    """Result of a connection."""

    STRAIGHT = 0, "the straight joint move is free"
    DETOUR = 1, "the straight joint move collides; a detour is free"
    START_IN_COLLISION = 2, "the start is nearer to an object than the clearance"
    GOAL_IN_COLLISION = 3, "the goal is nearer to an object than the clearance"
    NO_PATH_FOUND = 4, "no free path was found within the budget (which does not prove that there is none)"


@dataclass(frozen=True, slots=True, eq=False)
class PathResult(Value):
    """A certified path, or the reason why there is none.

    Attributes:
        via: (m, axes) via points with both ends [rad], multiples of 1e-4 deg, joined by straight joint segments; None
            without a path.
        status: result of the connection.
        checks: checked configurations.
        duration: time of the moves [s]; inf without a path.
    """

    via: Annotated[Floats, "m axes"] | None
    status: PathStatus
    checks: int
    duration: float


def connect(
    q_from: Floats,
    q_to: Floats,
    checker: CollisionChecker,
    limits: JointLimits,
    rng: np.random.Generator,
    budget: int = MAX_CHECKS,
) -> PathResult:
    """Connect two configurations by a path that is certified free.

    Args:
        q_from: (axes,) start [rad], inside the joint range; rounded to multiples of 1e-4 deg.
        q_to: (axes,) goal [rad], likewise.
        checker: collision checker with a clearance above 0.
        limits: the joint range that is searched, and the speeds that rate a detour.
        rng: source of the search's randomness; not used if the straight segment is free.
        budget: configurations that the search may check; shortening may check half as many more. With an indexed table
            each path of the arm, up to two for each posture, has half of both.
    """
    require_usable(limits)
    axes = len(limits.lower)
    ends = np.stack([readonly("q_from", q_from, (axes,)), readonly("q_to", q_to, (axes,))])
    require_inside("end", ends, limits)
    ends = quantise_inside(ends, limits)
    free = checker.free(ends)
    if not free.all():
        status = PathStatus.GOAL_IN_COLLISION if free[0] else PathStatus.START_IN_COLLISION
        return PathResult(None, status, 2, float("inf"))
    if limits.table_turn_q is not None:
        return _connect_indexed(ends, checker, limits, rng, budget)
    return _connect_free(ends, checker, limits, rng, budget)


def _connect_free(
    ends: Floats, checker: CollisionChecker, limits: JointLimits, rng: np.random.Generator, budget: int
) -> PathResult:
    """Connect free ends (2, axes) [rad] with all axes moving together."""
    straight, checks = certify(ends[0], ends[1], checker)
    checks += 2
    via, status = ends, PathStatus.STRAIGHT
    if not straight:
        via_points, used = rrt_connect(ends[0], ends[1], checker, limits, rng, budget - checks)
        checks += used
        if via_points is None:
            return PathResult(None, PathStatus.NO_PATH_FOUND, checks, float("inf"))
        via, used = shorten(via_points, checker, limits, rng, budget // 2)
        checks += used
        status = PathStatus.DETOUR
    return PathResult(via, status, checks, path_time(via, limits))


def _connect_indexed(
    ends: Floats, checker: CollisionChecker, limits: JointLimits, rng: np.random.Generator, budget: int
) -> PathResult:
    """Connect free ends (2, axes) [rad] with an indexed table, which turns at an end or at `table_turn_q`."""
    if np.array_equal(ends[0, ARM_AXES:], ends[1, ARM_AXES:]):
        return _connect_free(ends, checker, indexed.fix_table(limits, ends[0]), rng, budget)
    assert limits.table_turn_q is not None, "the table is indexed"
    checks, best = 0, PathResult(None, PathStatus.NO_PATH_FOUND, 0, float("inf"))
    for place, posture in enumerate((*ends, quantise_inside(limits.table_turn_q, limits))):
        if place == len(ends) and best.via is not None:
            break
        turns, used = indexed.may_turn(posture, checker, limits)
        checks += used
        if not turns:
            continue
        stops = indexed.table_turn(posture, *ends)
        # Certified at all angles, the arm may still be closer than the clearance between the checks: the driven move is
        # certified itself, as the verification before driving will do again.
        if not checker.free(stops).all():
            continue
        turns, used = certify(stops[0], stops[1], checker)
        checks += used + len(stops)
        if not turns:
            continue
        pieces = [
            PathResult(each[:1], PathStatus.STRAIGHT, 0, 0.0)
            if np.array_equal(*each)
            else _connect_free(each, checker, indexed.fix_table(limits, each[0]), rng, budget // 2)
            for each in (np.stack([ends[0], stops[0]]), np.stack([stops[1], ends[1]]))
        ]
        checks += sum(piece.checks for piece in pieces)
        if all(piece.via is not None for piece in pieces):
            via = np.concatenate([piece.via for piece in pieces if piece.via is not None])
            status = PathStatus.STRAIGHT if len(via) <= 3 else PathStatus.DETOUR
            best = min(best, PathResult(via, status, 0, path_time(via, limits)), key=lambda each: each.duration)
    return replace(best, checks=checks)


def is_detour(via: Floats) -> bool:
    """Return whether via points (m, axes) [rad] need more than one move of the arm; turns of the table do not count."""
    return bool((np.diff(via[:, :ARM_AXES], axis=0) != 0).any(axis=1).sum() > 1)


def path_time(via: Floats, limits: JointLimits) -> float:
    """Return the time [s] through via points (m, axes) [rad] with a stop at each."""
    return float(move_time(via[:-1], via[1:], limits).sum())


_MAX_FAILURES = 40  # failed replacements in a row after which a path counts as short
_CANDIDATES, _CERTIFICATIONS = 96, 3  # via points drawn per replacement, and certified at most (fastest first)


def shorten(
    via: Floats, checker: CollisionChecker, limits: JointLimits, rng: np.random.Generator, budget: int
) -> tuple[Floats, int]:
    """Make a certified path faster; a path on which an indexed table turns stays.

    Args:
        via: (m, axes) via points of certified segments [rad].
        checker: collision checker.
        limits: range and speeds.
        rng: source of the candidates.
        budget: largest number of checks before the last replacement.

    Returns:
        (k, axes) via points of certified segments with the same ends, never slower, and the checks.
    """
    if limits.table_turn_q is not None:
        if (via[:, ARM_AXES:] != via[0, ARM_AXES:]).any():
            return via, 0
        limits = indexed.fix_table(limits, via[0])
    via, checks = _skip(via, checker, budget)
    failures = 0
    while len(via) > 2 and checks < budget and failures < _MAX_FAILURES:
        span = int(rng.integers(2, min(4, len(via) - 1) + 1))
        i = int(rng.integers(0, len(via) - span))
        j = i + span
        inner, sigma = via[i + 1 : j], 10.0 ** rng.uniform(-2.0, 0.0)
        middle = 0.5 * (via[i] + via[j])
        # Near a via point of the replaced part, or between it and the middle of the straight segment.
        seeds = inner[rng.integers(0, len(inner), _CANDIDATES)]
        seeds = seeds + rng.uniform(0.0, 1.0, (_CANDIDATES, 1)) ** 2 * (middle - seeds)
        seeds[::2] += sigma * rng.standard_normal(seeds[::2].shape)
        candidates = quantise_inside(seeds, limits)
        times = move_time(via[i], candidates, limits) + move_time(candidates, via[j], limits)
        now = path_time(via[i : j + 1], limits)
        fastest = np.argsort(times, kind="stable")
        fastest = fastest[times[fastest] < now * (1.0 - 1e-3)]
        free = checker.free(candidates[fastest]) if len(fastest) else np.zeros(0, dtype=bool)
        checks += len(fastest)
        failures += 1
        for k in fastest[free][:_CERTIFICATIONS]:
            certified, used = certify(via[i], candidates[k], checker)
            checks += used
            if certified:
                certified, used = certify(candidates[k], via[j], checker)
                checks += used
            if certified:
                via = np.concatenate((via[: i + 1], candidates[k : k + 1], via[j:]))
                failures = 0
                break
    return via, checks


def _skip(via: Floats, checker: CollisionChecker, budget: int) -> tuple[Floats, int]:
    """Skip via points greedily: go straight from each kept one to the farthest reachable one.

    Fewer stops are never slower: the time of a straight move is subadditive.
    """
    remaining, i, checks = [via[0]], 0, 0
    while i < len(via) - 1:
        j = len(via) - 1
        while j > i + 1:
            if checks < budget:
                certified, used = certify(via[i], via[j], checker)
                checks += used
                if certified:
                    break
            j -= 1
        remaining.append(via[j])
        i = j
    return np.array(remaining), checks
