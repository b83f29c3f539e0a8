"""Times of joint moves and sampled motions."""

import numpy as np
import pytest

from planner.errors import PlannerError
from planner.ports import JointLimits
from planner.timing.limits import scale_limits
from planner.timing.motion import retime
from planner.timing.move_time import move_time

LIMITS = JointLimits(
    lower=np.full(6, -7.0),
    upper=np.full(6, 7.0),
    velocity=np.array([2.0, 2.0, 2.0, 4.0, 4.0, 8.0]),
    acceleration=np.array([4.0, 4.0, 4.0, 8.0, 8.0, 16.0]),
)
REST = np.zeros(6)


def along(axis: int, distance: float) -> np.ndarray:
    """Return the rest configuration with one axis moved."""
    q = np.zeros(6)
    q[axis] = distance
    return q


def test_the_slowest_axis_sets_the_time_of_all() -> None:
    """A synchronised move is no faster than any of its axes alone, and here exactly as fast as the slowest."""
    both = along(0, 1.5) + along(5, 1.5)
    assert (
        move_time(REST, both, LIMITS) == move_time(REST, along(0, 1.5), LIMITS) > move_time(REST, along(5, 1.5), LIMITS)
    )


def test_broadcasting_gives_the_cost_matrix_of_the_single_moves() -> None:
    """(n, 1, 6) against (m, 6) gives (n, m), each entry bit for bit the single move's time."""
    rng = np.random.default_rng(0)
    a, b = rng.uniform(-6, 6, (4, 6)), rng.uniform(-6, 6, (5, 6))
    matrix = move_time(a[:, None], b, LIMITS)
    assert matrix.shape == (4, 5)
    assert matrix.tolist() == [[float(move_time(x, y, LIMITS)) for y in b] for x in a]


def test_a_motion_stops_at_each_via_point_and_holds_it_exactly() -> None:
    """At the time of a via point the sample is the via point, bit for bit, at speed 0; times add up."""
    via = np.random.default_rng(1).uniform(-6, 6, (5, 6))
    motion = retime(via, [0, 0, 1, 1, 2], [-1, -1, 3, -1, -1], LIMITS)
    at = np.searchsorted(motion.t, motion.via_t)
    np.testing.assert_array_equal(motion.t[at], motion.via_t)
    np.testing.assert_array_equal(motion.q[at], via)
    np.testing.assert_array_equal(motion.qd[at], 0.0)
    assert motion.duration == motion.via_t[-1] == pytest.approx(move_time(via[:-1], via[1:], LIMITS).sum())


def test_samples_have_the_number_of_their_segment() -> None:
    """A sample belongs to the segment of the via point at which its move ends."""
    via = np.array([REST, along(0, 1.0), along(0, 2.0), REST])
    motion = retime(via, [0, 0, 1, 2], [-1, 0, 1, -1], LIMITS)
    ends = np.searchsorted(motion.via_t[1:], motion.t, side="left")
    np.testing.assert_array_equal(motion.segment_of_sample, np.array([0, 1, 2])[ends])


def test_samples_are_no_farther_apart_than_the_period() -> None:
    """Inside a move the spacing is even, positive and at most the sample period."""
    motion = retime(np.array([REST, along(0, 3.0), along(1, 2.0)]), [0, 0, 0], [-1] * 3, LIMITS, 0.05)
    steps = np.diff(motion.t)
    assert 0 < steps.min() <= steps.max() <= 0.05 + 1e-12


def test_a_speed_fraction_scales_the_time() -> None:
    """Half the speed and a quarter of the acceleration is the same motion in slow motion: exactly twice the time."""
    via = np.random.default_rng(2).uniform(-6, 6, (4, 6))
    full = retime(via, [0] * 4, [-1] * 4, LIMITS)
    slow = retime(via, [0] * 4, [-1] * 4, LIMITS, speed=0.5, acceleration=0.25)
    assert slow.duration == pytest.approx(2.0 * full.duration, rel=1e-12)
    np.testing.assert_array_equal(slow.limits.velocity, 0.5 * LIMITS.velocity)


@pytest.mark.parametrize("fraction", [0.0, -1.0, 1.01, np.nan])
def test_a_fraction_outside_zero_to_one_is_refused(fraction: float) -> None:
    """The message names the fraction and the valid range."""
    with pytest.raises(PlannerError, match=r"speed fraction is .* must be above 0 and at most 1"):
        scale_limits(LIMITS, speed=fraction)


def test_a_via_point_outside_the_range_is_refused_by_axis() -> None:
    """There is no wrap-around; the message names the via point, the axis and the range."""
    with pytest.raises(PlannerError, match="via point 1 has A4 at 458"):
        retime(np.array([REST, along(3, 8.0)]), [0, 0], [-1, -1], LIMITS)


def test_segments_out_of_order_are_refused() -> None:
    """Segment numbers never decrease along a motion."""
    with pytest.raises(PlannerError, match="segment decreases"):
        retime(np.array([REST, REST]), [1, 0], [-1, -1], LIMITS)
