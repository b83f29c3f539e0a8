"""Certified edges and paths around boxes in joint space."""

import numpy as np
import pytest

from planner.errors import PlannerError
from planner.path.certified_edge import (
    STEP,
    certify,
    certify_many,
    quantise,
    quantise_inside,
    subdivide,
)
from planner.path.path import PathStatus, connect, path_time, shorten
from planner.ports import JointLimits
from planner.timing.move_time import move_time
from tests.support.joint_space import BIG, Boxes, at, box

LIMITS = JointLimits(
    lower=np.full(6, -3.0), upper=np.full(6, 3.0), velocity=np.full(6, 2.0), acceleration=np.full(6, 4.0)
)


LEFT, RIGHT = quantise([-1.0, 0, 0, 0, 0, 0]), quantise([1.0, 0, 0, 0, 0, 0])


WALL = box(x=(-0.2, 0.2), y=(-BIG, 0.5))
LEFT, RIGHT = at(-1.0), at(1.0)


def rng() -> np.random.Generator:
    """Return a generator with a fixed seed."""
    return np.random.default_rng(0)


def test_quantised_angles_are_integers_of_a_ten_thousandth_of_a_degree() -> None:
    """Rounding moves an angle by at most half a step; rounding again does not move it."""
    q = np.random.default_rng(1).uniform(-6, 6, (1000, 6))
    rounded = quantise(q)
    steps = np.degrees(rounded) * 1e4
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    assert np.abs(np.degrees(rounded - q)).max() <= 0.5e-4 * (1 + 1e-9)
    np.testing.assert_array_equal(quantise(rounded), rounded)


def test_quantising_stays_inside_a_range_that_is_no_multiple() -> None:
    """An angle beyond a limit becomes the last multiple inside."""
    outside = quantise_inside(np.full(6, 9.0), LIMITS)
    assert (outside <= LIMITS.upper).all()
    assert np.degrees(LIMITS.upper - outside).max() < 1e-4


def test_subdivision_keeps_every_configuration_near_a_checked_one() -> None:
    """No point of the segment lies farther than STEP clearances from a checked configuration; both ends are checked."""
    checker = Boxes()
    marks = subdivide(LEFT[None], RIGHT[None], checker)[0]
    np.testing.assert_array_equal(marks[[0, -1]], [LEFT, RIGHT])
    dense = LEFT + np.linspace(0, 1, 3001)[:, None] * (RIGHT - LEFT)
    nearest = np.abs(dense[:, None, 0] - marks[None, :, 0]).min(axis=1)
    assert nearest.max() <= STEP * checker.clearance * (1 + 1e-12)
    assert len(marks) <= 2.0 / (2 * STEP * checker.clearance) + 2  # and no finer than that needs


def test_a_thin_obstacle_between_two_free_ends_is_found() -> None:
    """A wall without thickness blocks the edge: its clearance zone is wider than the spacing of the checks."""
    for place in np.linspace(-0.9, 0.9, 61):
        sheet = Boxes(box(x=(place, place)))
        assert not certify(LEFT, RIGHT, sheet)[0]


def test_batched_certification_gives_the_verdicts_of_the_single_one() -> None:
    """`certify_many` and `certify` agree on random edges, of which some are blocked and some are free."""
    checker = Boxes(WALL)
    ends = quantise(np.random.default_rng(2).uniform(-2, 2, (200, 6)))
    ends = ends[checker.free(ends)]
    starts, stops = ends[:60], ends[60:120]
    single = [certify(a, b, checker)[0] for a, b in zip(starts, stops, strict=True)]
    many, _ = certify_many(starts, stops, checker)
    assert many.tolist() == single
    assert 5 < sum(single) < 55


def test_a_blocked_edge_is_refused_after_few_checks() -> None:
    """Bisection finds a wall in the middle with a small share of the checks that a free edge needs."""
    _, blocked = certify(LEFT, RIGHT, Boxes(WALL))
    _, free = certify(LEFT, RIGHT, Boxes())
    assert blocked <= 8 < free / 10


def test_a_free_straight_move_is_taken() -> None:
    """Without obstacles the path is its two ends, also if they are equal, and no random number is drawn."""
    source = rng()
    found = connect(LEFT, RIGHT, Boxes(([2] * 6, [2.5] * 6)), LIMITS, source)
    assert found.status is PathStatus.STRAIGHT
    np.testing.assert_array_equal(found.via, [LEFT, RIGHT])
    assert found.duration == move_time(LEFT, RIGHT, LIMITS)
    still = connect(LEFT, LEFT, Boxes(), LIMITS, source)
    assert (still.status, still.via.shape, still.duration) == (PathStatus.STRAIGHT, (2, 6), 0.0)
    assert source.random() == rng().random()


def test_a_detour_goes_around_the_wall() -> None:
    """The via points are set-points with the given ends, and a check ten times denser finds no contact.

    All checks are counted.
    """
    checker = Boxes(WALL)
    found = connect(LEFT, RIGHT, checker, LIMITS, rng())
    assert (found.status, found.checks) == (PathStatus.DETOUR, checker.checked)
    np.testing.assert_array_equal(found.via[[0, -1]], [LEFT, RIGHT])
    np.testing.assert_array_equal(quantise(found.via), found.via)
    for a, b in zip(found.via[:-1], found.via[1:], strict=True):
        n = 10 * len(subdivide(a[None], b[None], checker)[0])
        dense = a + np.linspace(0, 1, n)[:, None] * (b - a)
        assert checker.distances(dense).min() >= (1 - STEP) * checker.clearance
    assert found.duration == path_time(found.via, LIMITS)


def test_shortening_never_slows_and_keeps_the_ends() -> None:
    """A zigzag of certified edges becomes faster; the straight segment is used where it is free."""
    checker = Boxes(([2] * 6, [2.5] * 6))
    zigzag = quantise(np.array([LEFT, [0, 1, 0, 0, 0, 0], [0.5, -1, 0, 0, 0, 0], RIGHT]))
    short, _ = shorten(zigzag, checker, LIMITS, rng(), 10_000)
    np.testing.assert_array_equal(short, [LEFT, RIGHT])
    around = quantise(np.array([LEFT, [-1, 2, 0, 0, 0, 0], [0, 2.5, 0, 0, 1, 0], [1, 2, 0, 0, 0, 0], RIGHT]))
    short, _ = shorten(around, Boxes(WALL), LIMITS, rng(), 10_000)
    assert path_time(short, LIMITS) < 0.7 * path_time(around, LIMITS)


def test_a_checker_without_clearance_is_refused() -> None:
    """Without clearance no segment can be certified, because the space between two checks is unknown."""
    checker = Boxes()
    checker.clearance = 0.0
    with pytest.raises(PlannerError, match=r"clearance is 0\.0 m; it must be above 0"):
        connect(LEFT, RIGHT, checker, LIMITS, rng())
