"""Braking on the path: continuous, within the limits, on the segment, and as short as ruckig's fastest stop."""

import numpy as np
import pytest
import ruckig
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from drivers.profile import Reference, interpolate

shares = st.floats(0.0, 1.0) | st.sampled_from([0.0, 1e-9, 0.5, 1.0 - 1e-9, 1.0])
positive = arrays(float, 6, elements=st.floats(0.05, 20.0))


def fastest_stop(speed: float, acceleration: float, limit: float, jerk: float) -> tuple[float, float]:
    """Return duration and length of ruckig's fastest stop."""
    requests = ruckig.InputParameter(1)
    requests.control_interface = ruckig.ControlInterface.Velocity
    requests.current_position, requests.current_velocity, requests.current_acceleration = [0.0], [speed], [acceleration]
    requests.target_velocity, requests.target_acceleration = [0.0], [0.0]
    requests.max_acceleration, requests.max_jerk = [limit], [jerk]
    found = ruckig.Trajectory(1)
    assert ruckig.Ruckig(1).calculate(requests, found) == ruckig.Result.Working
    return found.duration, found.at_time(found.duration)[0][0]


def check_stop(driven: Reference, t: float, jerk: np.ndarray, acceleration: np.ndarray) -> Reference:
    """Check the properties of the stop at time t and return it."""
    braked = driven.braking_from(t)
    q, qd, qdd = (values[0] for values in driven.sample(np.array([t])))
    times = np.linspace(0.0, braked.duration, 400)[:-1] if braked.duration > 0 else np.zeros(1)
    there, speed, rate = braked.sample(times)
    np.testing.assert_allclose(there[0], q, atol=1e-12)
    assert np.abs(there[-1] - braked.end).max() <= np.abs(qd).max() * braked.duration + 1e-12
    at_end = braked.sample(np.array([braked.duration]))
    np.testing.assert_array_equal(at_end[0][0], braked.end)
    if braked.duration > 0:
        np.testing.assert_allclose(speed[0], qd, atol=1e-12)
        if np.isfinite(jerk).all():
            np.testing.assert_allclose(rate[0], qdd, atol=1e-8)
            step = times[1]
            assert (np.abs(np.diff(rate, axis=0)) <= jerk * step + 1e-8).all()
            assert (np.abs(rate[-1]) <= jerk * step + 1e-8).all()
        assert (np.abs(rate) <= acceleration + 1e-8).all()
        # At rest at the end: the integral of the speed is the distance.
        assert (np.abs(speed[-1]) <= acceleration * times[1] + 1e-12).all()
    return braked


@settings(max_examples=4 * settings.default.max_examples)
@given(
    arrays(float, (2, 6), elements=st.floats(-6.0, 6.0)), positive, positive, positive, shares, shares, st.booleans()
)
def test_a_stop_is_smooth_within_the_limits_and_before_the_segments_end(
    points: np.ndarray, v: np.ndarray, a: np.ndarray, j: np.ndarray, share: float, later: float, endless: bool
) -> None:
    """A stop from any phase, also from another stop, ends between the position and the via point."""
    jerk = np.full(6, np.inf) if endless else j
    start, end = np.round(points, 6)
    driven = interpolate(start, end[None], v, a, jerk)
    t = share * driven.duration
    braked = check_stop(driven, t, jerk, a)
    q = driven.sample(np.array([t]))[0][0]
    length = float(np.abs(end - start).max())
    if length > 0:
        axis = int(np.abs(end - start).argmax())
        here, stood = ((x[axis] - start[axis]) / (end[axis] - start[axis]) for x in (q, braked.end))
        assert here - 1e-12 <= stood <= 1.0
        np.testing.assert_allclose(braked.end, start + stood * (end - start), atol=1e-12)
    again = check_stop(braked, later * braked.duration, jerk, a)
    np.testing.assert_allclose(again.end, braked.end, atol=1e-7)


@pytest.mark.parametrize("override", [0.05, 0.3, 1.0])
def test_no_stop_is_faster_or_shorter(override: float) -> None:
    """Ruckig's time-optimal stop from the same speed and acceleration is neither faster nor shorter."""
    rng = np.random.default_rng(0)
    for _ in range(100):
        v, a, j = 10.0 ** rng.uniform(-1, 1, 3)
        distance = 10.0 ** rng.uniform(-3, 1)
        end = np.zeros((1, 6))
        end[0, 2] = distance
        ones = np.ones(6)
        driven = interpolate(np.zeros(6), end, v * override * ones, a * ones, j * ones)
        t = rng.uniform(0, driven.duration)
        q, qd, qdd = (values[0, 2] for values in driven.sample(np.array([t])))
        duration, length = fastest_stop(qd, qdd, a, j)
        braked = driven.braking_from(t)
        assert braked.duration == pytest.approx(duration, rel=1e-6, abs=1e-8)
        assert braked.end[2] - q == pytest.approx(length, rel=1e-6, abs=1e-8)
