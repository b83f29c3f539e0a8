"""The closed form of the S-curve compared with ruckig (Berscheid and Kroeger 2021) and with its integrated jerk.

Ruckig solves the general state-to-state problem by case enumeration and polynomial roots; only its state-to-state call
is used.
"""

import numpy as np
import pytest
import ruckig

from planner.ports import JointLimits
from planner.timing.limits import without_jerk_limit
from planner.timing.motion import retime
from planner.timing.move_time import MARGIN, move_time
from planner.timing.s_curve import Profile, fastest_profile, sample_profile

LIMITS = JointLimits(
    np.full(6, -7.0),
    np.full(6, 7.0),
    np.radians([156, 156, 156, 330, 330, 615]),
    np.radians([312, 312, 312, 660, 660, 1230]),
    np.radians([3120, 3120, 3120, 6600, 6600, 12300]),
)


def by_ruckig(velocity: np.ndarray, acceleration: np.ndarray, jerk: np.ndarray, to: np.ndarray) -> ruckig.Trajectory:
    """Return ruckig's fastest motion from rest at 0 to rest at `to`, all axes in one phase."""
    dof = len(to)
    asked = ruckig.InputParameter(dof)
    asked.current_position, asked.current_velocity, asked.current_acceleration = [0.0] * dof, [0.0] * dof, [0.0] * dof
    asked.target_position, asked.target_velocity, asked.target_acceleration = list(to), [0.0] * dof, [0.0] * dof
    asked.max_velocity, asked.max_acceleration, asked.max_jerk = list(velocity), list(acceleration), list(jerk)
    asked.synchronization = ruckig.Synchronization.Phase
    found = ruckig.Trajectory(dof)
    assert ruckig.Ruckig(dof).calculate(asked, found) == ruckig.Result.Working
    return found


def random_limits(rng: np.random.Generator) -> np.ndarray:
    """Return limits of speed, acceleration and jerk of a path of length 1, over four decades each."""
    return 10.0 ** rng.uniform(-1.5, 2.5, 3)


def test_durations_and_states_agree_in_every_case() -> None:
    """2,000 random limits: duration to 1e-9, position, speed and acceleration at random times; all four cases occur."""
    rng = np.random.default_rng(0)
    cases = set()
    for _ in range(2000):
        velocity, acceleration, jerk = random_limits(rng)
        profile = Profile(
            *(w.item() for w in fastest_profile(*(np.array(1.0 / x) for x in (velocity, acceleration, jerk))))
        )
        truth = by_ruckig(*(np.array([x]) for x in (velocity, acceleration, jerk)), np.ones(1))
        assert profile.duration == pytest.approx(truth.duration, rel=1e-9)
        cases.add((profile.cruise > profile.ramp + profile.ease, profile.ramp > profile.ease))
        t = rng.uniform(0.0, truth.duration, 6)
        s, sd, sdd = sample_profile(profile, t)
        theirs = np.array([np.ravel(truth.at_time(x)[:3]) for x in t]).T
        scale = np.array([[1.0], [1.0 / profile.cruise], [1.0 / (profile.cruise * profile.ramp)]])
        assert (np.abs(np.array([s, sd, sdd]) - theirs) <= 1e-6 * scale).all()
    assert len(cases) == 4


def test_synchronised_moves_of_six_axes_take_as_long_as_ruckigs_in_one_phase() -> None:
    """Random moves of the KR 16 from 1e-4 to 6 rad: times agree up to the margin of the limits."""
    rng = np.random.default_rng(1)
    for _ in range(200):
        to = rng.uniform(-1, 1, 6) * 10.0 ** rng.uniform(-4, 0.78)
        truth = by_ruckig(LIMITS.velocity, LIMITS.acceleration, LIMITS.jerk, to)
        assert float(move_time(np.zeros(6), to, LIMITS)) == pytest.approx(truth.duration, rel=2 * MARGIN)


@pytest.mark.parametrize("law", [[1, 0.5, 0.05], [1, 0.1, 0.09], [0.1, 0.5, 0.05], [0.1, 0.1, 1]])
def test_the_jerk_integrates_to_the_samples(law: list[float]) -> None:
    """Three cumulative sums of the bang-zero-bang jerk, made from switching times alone, give the samples."""
    profile = Profile(*(w.item() for w in fastest_profile(*(np.array(x) for x in law))))
    cruise, ramp, ease = profile
    n = 200_000
    t = np.linspace(0.0, profile.duration, n + 1)
    step = t[1]
    middle = 0.5 * (t[1:] + t[:-1])
    # A step smoothed by three moving averages: the signs of its third difference.
    sign = sum(
        (-1) ** (i + j + k) * (middle > i * cruise + j * ramp + k * ease)
        for i in (0, 1) for j in (0, 1) for k in (0, 1)
    )  # fmt: skip
    acceleration = np.concatenate([[0.0], np.cumsum(sign / (cruise * ramp * ease)) * step])
    speed = np.concatenate([[0.0], np.cumsum(0.5 * (acceleration[1:] + acceleration[:-1])) * step])
    s = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1])) * step])
    ours = sample_profile(profile, t)
    for found, truth in zip(ours, (s, speed, acceleration), strict=True):
        assert np.abs(found - truth).max() <= 1e-4 * np.abs(truth).max()


def test_no_jerk_limit_is_the_limit_of_large_ones() -> None:
    """Times decrease with the jerk limit towards those without limit, never below."""
    rng = np.random.default_rng(2)
    a, b = rng.uniform(-6, 6, (2, 500, 6))
    bound = move_time(a, b, without_jerk_limit(LIMITS))
    before = move_time(a, b, LIMITS)
    assert (before > bound).all()
    for factor in (10.0, 1e3, 1e6):
        limits = JointLimits(LIMITS.lower, LIMITS.upper, LIMITS.velocity, LIMITS.acceleration, LIMITS.jerk * factor)
        now = move_time(a, b, limits)
        assert (bound <= now).all()
        assert (now <= before).all()
        before = now
    np.testing.assert_allclose(before, bound, rtol=1e-6)


def test_sampled_motions_keep_the_jerk_limit() -> None:
    """Divided differences of the sampled accelerations, and third ones of the angles, stay below it."""
    via = np.random.default_rng(3).uniform(-6, 6, (12, 6))
    motion = retime(via, [0] * 12, [-1] * 12, LIMITS)
    steps = np.diff(motion.t)[:, None]
    jerk = np.diff(motion.qdd, axis=0) / steps
    assert (np.abs(jerk) <= LIMITS.jerk).all()
    assert (np.abs(jerk) / LIMITS.jerk).max() > 0.99
    for start, stop in zip(motion.via_t[:-1], motion.via_t[1:], strict=True):
        one = (motion.t >= start) & (motion.t <= stop)  # evenly spaced inside a move
        third = np.diff(motion.q[one], n=3, axis=0) / np.diff(motion.t[one]).mean() ** 3
        assert (np.abs(third) <= LIMITS.jerk * (1 + 1e-6)).all()  # 1e-6: rounding of q, times 8 / step^3
