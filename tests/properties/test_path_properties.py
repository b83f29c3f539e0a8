"""Properties of set-points and certified segments on generated input."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from planner.path.certified_edge import quantise, quantise_inside, subdivide
from planner.ports import JointLimits

BOUND = 13.0
angles = arrays(float, 6, elements=st.floats(-BOUND, BOUND))


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
    marks = subdivide(a[None], b[None], checker)[0]  # type: ignore[arg-type]
    np.testing.assert_array_equal(marks[0], a)
    np.testing.assert_array_equal(marks[-1], b)
    if len(marks) > 1:
        assert checker.travel(marks[:-1], marks[1:]).max() <= 0.9 * clearance * (1 + 1e-9)
