"""Properties of moves and motions with generated limits and distances, also infinite and tiny ones."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from planner.ports import JointLimits
from planner.timing.limits import scale_limits, without_jerk_limit
from planner.timing.motion import retime
from planner.timing.move_time import RESOLUTION, move_time
from planner.timing.s_curve import Profile, fastest_profile, sample_profile

angles = arrays(float, 6, elements=st.floats(-13.0, 13.0))
positive = arrays(float, 6, elements=st.floats(0.01, 50.0))
maybe_endless = arrays(float, 6, elements=st.floats(0.01, 50.0) | st.just(np.inf))
ENDLESS = np.full(6, np.inf)
inverse = st.floats(1e-9, 1e9) | st.just(0.0)


def limits(velocity: np.ndarray, acceleration: np.ndarray, jerk: np.ndarray) -> JointLimits:
    """Return limits with a range that contains every generated angle."""
    return JointLimits(np.full(6, -13.0), np.full(6, 13.0), velocity, acceleration, jerk)


def widths(v: float, a: float, j: float) -> Profile:
    """Return the fastest profile as floats."""
    return Profile(*(width.item() for width in fastest_profile(np.array(v), np.array(a), np.array(j))))


@settings(max_examples=4 * settings.default.max_examples)
@given(inverse, inverse, inverse)
def test_the_peaks_keep_every_limit_and_some_limit_is_reached(v: float, a: float, j: float) -> None:
    """The widths are ordered and finite, also without limits of speed, acceleration or jerk."""
    if a == 0.0 and j == 0.0:
        v = 0.0  # a move of length 0; limits of speed alone are refused by `check_limits`
    cruise, ramp, ease = widths(v, a, j)
    assert np.isfinite([cruise, ramp, ease]).all()
    assert cruise * (1 + 1e-12) >= ramp + ease
    assert ramp >= ease * (1 - 1e-12)
    peaks = np.array([cruise, cruise * ramp, cruise * ramp * ease])
    inverse_limits = np.array([v, a, j])
    assert (peaks >= inverse_limits * (1 - 1e-12)).all()
    if inverse_limits.any():
        assert (peaks[inverse_limits > 0] <= inverse_limits[inverse_limits > 0] * (1 + 1e-12)).any()


@settings(max_examples=4 * settings.default.max_examples)
@given(inverse, inverse, inverse, inverse, inverse, inverse)
def test_one_move_is_never_slower_than_two(v: float, a: float, j: float, v2: float, a2: float, j2: float) -> None:
    """Duration is subadditive in the inverse limits, which is why fewer stops are never slower."""
    a, a2 = max(a, 1e-9), max(a2, 1e-9)
    one = widths(v + v2, a + a2, j + j2).duration
    assert one <= (widths(v, a, j).duration + widths(v2, a2, j2).duration) * (1 + 1e-12)


@given(inverse, inverse, inverse, arrays(float, 20, elements=st.floats(0.0, 1.0)))
def test_samples_rise_from_0_to_1_and_are_symmetric(v: float, a: float, j: float, shares: np.ndarray) -> None:
    """Monotone, point-symmetric about the middle, speeds and accelerations at most the peaks."""
    profile = widths(v, max(a, 1e-9), j)
    t = np.sort(np.concatenate([[0.0, 1.0], shares])) * profile.duration
    s, sd, sdd = sample_profile(profile, t)
    assert (s[0], s[-1], sd[0], sd[-1]) == (0.0, 1.0, 0.0, 0.0)
    assert (np.diff(s) >= -1e-12).all()
    back = sample_profile(profile, profile.duration - t)
    np.testing.assert_allclose(s + back[0], 1.0, atol=1e-9)
    rounded = 4 * np.spacing(profile.duration)  # of a time: all of a ramp that is ten decades shorter than the move
    np.testing.assert_allclose(sd, back[1], atol=(1e-6 + rounded / profile.ramp) / profile.cruise)
    assert sd.max() <= 1.0 / profile.cruise
    assert np.abs(sdd).max() <= (1.0 / profile.cruise) / profile.ramp


@given(angles, angles, angles, positive, positive, maybe_endless)
def test_move_time_is_a_metric(
    a: np.ndarray, b: np.ndarray, c: np.ndarray, v: np.ndarray, acc: np.ndarray, jerk: np.ndarray
) -> None:
    """Symmetric, zero exactly between equal angles, and no move over a third configuration is faster."""
    law = limits(v, acc, jerk)
    ab = float(move_time(a, b, law))
    assert ab == float(move_time(b, a, law)) >= float(move_time(a, b, without_jerk_limit(law))) >= 0
    assert (ab == 0) == bool((np.abs(a - b) <= RESOLUTION).all())
    assert ab <= (float(move_time(a, c, law)) + float(move_time(c, b, law))) * (1 + 1e-12) + 1e-3 * RESOLUTION ** (
        1 / 3
    )


@given(st.lists(angles, min_size=1, max_size=4), maybe_endless, positive, positive, st.floats(0.1, 1.0))
def test_samples_never_exceed_a_limit(
    via: list[np.ndarray], v: np.ndarray, acc: np.ndarray, jerk: np.ndarray, override: float
) -> None:
    """Speed, acceleration and jerk between samples hold without tolerance beyond rounding, at every override.

    Angles stay within those of the via points, and both ends are exact.
    """
    law = limits(v, acc, jerk)
    motion = retime(np.array(via), [0] * len(via), [-1] * len(via), law, 0.05, speed=override)
    steps = np.diff(motion.t)[:, None]
    assert (steps > 0).all()
    assert ((motion.q >= np.min(via, axis=0)) & (motion.q <= np.max(via, axis=0))).all()
    np.testing.assert_allclose(motion.q[[0, -1]], [via[0], via[-1]], atol=len(via) * RESOLUTION, rtol=0)
    assert (np.abs(np.diff(motion.q, axis=0)) <= v * override * steps + 1e-14).all()
    assert (np.abs(motion.qd) <= v * override).all()
    assert (np.abs(motion.qdd) <= acc).all()
    assert (np.abs(np.diff(motion.qd, axis=0)) <= acc * steps + 1e-13).all()
    assert (np.abs(np.diff(motion.qdd, axis=0)) <= jerk * steps + 1e-13).all()
    assert (motion.limits.velocity == scale_limits(law, override).velocity).all()
    assert motion.duration >= retime(np.array(via), [0] * len(via), [-1] * len(via), law, 0.5).duration * (1 - 1e-12)


@given(arrays(float, (3, 1, 6), elements=st.floats(-7, 7)), arrays(float, (4, 6), elements=st.floats(-7, 7)), positive)
def test_limits_in_one_ratio_are_timed_as_all_others(a: np.ndarray, b: np.ndarray, v: np.ndarray) -> None:
    """If one axis limits speed, acceleration and jerk, the shortcut gives the result of three maxima."""
    together = limits(v, 2 * v, 20 * v)
    # One part in 10^9 apart on an axis is no longer one ratio for the shortcut.
    apart = limits(v, 2 * v * [1, 1, 1, 1, 1, 1 + 1e-9], 20 * v * [1, 1, 1, 1, 1 + 1e-9, 1])
    np.testing.assert_allclose(move_time(a, b, together), move_time(a, b, apart), rtol=1e-8)


@given(angles, positive, positive, st.floats(0.1, 1.0))
def test_less_speed_never_saves_time(q: np.ndarray, v: np.ndarray, acc: np.ndarray, fraction: float) -> None:
    """Lower limits never shorten a move, except for the last bits: limits in one ratio are timed by one of them.

    Scaling speed by f and acceleration by f^2 takes exactly 1 / f.
    """
    rest = np.zeros(6)
    full = float(move_time(rest, q, limits(v, acc, ENDLESS)))
    assert full <= float(move_time(rest, q, limits(v * fraction, acc, ENDLESS))) * (1 + 1e-12)
    assert full <= float(move_time(rest, q, limits(v, acc * fraction, ENDLESS))) * (1 + 1e-12)
    assert float(move_time(rest, q, limits(v * fraction, acc * fraction**2, ENDLESS))) == pytest.approx(
        full / fraction, rel=1e-9
    )
