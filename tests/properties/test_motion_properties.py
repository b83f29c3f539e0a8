"""Properties of times, motions, orders and certified paths on generated input."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from planner.path.certified_edge import quantise, quantise_inside, subdivide
from planner.ports import JointLimits
from planner.timing.motion import retime
from planner.timing.move_time import RESOLUTION, move_time

BOUND = 13.0
angles = arrays(float, 6, elements=st.floats(-BOUND, BOUND))
positive = arrays(float, 6, elements=st.floats(0.01, 50.0))


def limits(velocity: np.ndarray, acceleration: np.ndarray) -> JointLimits:
    """Return limits with a range that contains every generated angle."""
    return JointLimits(np.full(6, -BOUND), np.full(6, BOUND), velocity, acceleration)


@given(angles, angles, angles, positive, positive)
def test_move_time_is_a_metric(a: np.ndarray, b: np.ndarray, c: np.ndarray, v: np.ndarray, acc: np.ndarray) -> None:
    """Symmetric, zero exactly between equal angles, and no move over a third configuration is faster."""
    law = limits(v, acc)
    ab, ba = float(move_time(a, b, law)), float(move_time(b, a, law))
    assert ab == ba >= 0
    assert (ab == 0) == bool((np.abs(a - b) <= RESOLUTION).all())
    assert ab <= (float(move_time(a, c, law)) + float(move_time(c, b, law))) * (1 + 1e-12) + 1e-6 * RESOLUTION**0.5


@given(st.lists(angles, min_size=1, max_size=5), positive, positive)
def test_samples_never_exceed_a_limit(via: list[np.ndarray], v: np.ndarray, acc: np.ndarray) -> None:
    """Speed, acceleration, range and first differences hold without tolerance; time increases; ends are exact."""
    law = limits(v, acc)
    motion = retime(np.array(via), [0] * len(via), [-1] * len(via), law, 0.05)
    assert (np.abs(motion.qd) <= v).all()
    assert (np.abs(motion.qdd) <= acc).all()
    steps = np.diff(motion.t)
    assert (steps > 0).all()
    assert (np.abs(np.diff(motion.q, axis=0)) <= v * steps[:, None] + 4 * np.spacing(BOUND)).all()
    low, high = np.min(via, axis=0), np.max(via, axis=0)
    assert ((motion.q >= low) & (motion.q <= high)).all()
    np.testing.assert_allclose(motion.q[[0, -1]], [via[0], via[-1]], atol=len(via) * RESOLUTION, rtol=0)


@given(angles, positive, positive, st.floats(0.1, 1.0))
def test_less_speed_never_saves_time(q: np.ndarray, v: np.ndarray, acc: np.ndarray, fraction: float) -> None:
    """Lower limits never shorten a move, except for the last bits: limits in one ratio are timed by one of them.

    Scaling speed by f and acceleration by f^2 takes exactly 1 / f.
    """
    rest = np.zeros(6)
    full = float(move_time(rest, q, limits(v, acc)))
    assert full <= float(move_time(rest, q, limits(v * fraction, acc))) * (1 + 1e-12)
    assert full <= float(move_time(rest, q, limits(v, acc * fraction))) * (1 + 1e-12)
    assert float(move_time(rest, q, limits(v * fraction, acc * fraction**2))) == pytest.approx(
        full / fraction, rel=1e-9
    )


@given(angles, arrays(float, 6, elements=st.floats(-BOUND, 0)), arrays(float, 6, elements=st.floats(0.001, BOUND)))
def test_set_points_stay_inside_any_range(q: np.ndarray, low: np.ndarray, high: np.ndarray) -> None:
    """The nearest set-point inside the range, at most half a step away if the angle is inside by a step."""
    law = JointLimits(low, high, np.ones(6), np.ones(6))
    found = quantise_inside(q, law)
    assert ((found >= low) & (found <= high)).all()
    inside = (q - low > 1e-5) & (high - q > 1e-5)
    np.testing.assert_array_equal(found[inside], quantise(q)[inside])


class Weighted:
    """A checker with clearance and travel only."""

    def __init__(self, clearance: float, weights: np.ndarray) -> None:
        self.clearance, self.weights = clearance, weights

    def travel(self, q_from: np.ndarray, q_to: np.ndarray) -> np.ndarray:
        return np.abs(q_to - q_from) @ self.weights


@given(angles, angles, st.floats(0.005, 0.1), arrays(float, 6, elements=st.floats(0.0, 2.0)))
def test_two_checked_neighbours_are_less_than_a_clearance_apart(
    a: np.ndarray, b: np.ndarray, clearance: float, weights: np.ndarray
) -> None:
    """Subdivision is even, keeps the ends, and the travel between neighbours stays below 0.9 clearances."""
    checker = Weighted(clearance, weights)
    marks = subdivide(a, b, checker)  # type: ignore[arg-type]
    np.testing.assert_array_equal(marks[0], a)
    np.testing.assert_array_equal(marks[-1], b)
    if len(marks) > 1:
        assert checker.travel(marks[:-1], marks[1:]).max() <= 0.9 * clearance * (1 + 1e-9)
