"""Closed forms of moves compared with ruckig (Berscheid and Kroeger 2021), integration and a linear programme.

Ruckig solves the general state-to-state problem by case enumeration and polynomial roots; only its state-to-state call
is used.
"""

import numpy as np
import pytest
import ruckig
from scipy.optimize import linprog

from planner.ports import JointLimits
from planner.timing.limits import without_jerk_limit
from planner.timing.motion import retime
from planner.timing.move_time import MARGIN, move_time
from planner.timing.s_curve import Profile, fastest_profile, sample_profile
from tests.support.joint_space import SPEED

LIMITS = JointLimits(np.full(6, -7.0), np.full(6, 7.0), SPEED, 2 * SPEED, 20 * SPEED)
FREE_LIMITS = without_jerk_limit(LIMITS)


def by_ruckig(velocity: np.ndarray, acceleration: np.ndarray, jerk: np.ndarray, to: np.ndarray) -> ruckig.Trajectory:
    """Return ruckig's fastest motion from rest at 0 to rest at `to`, all axes in one phase."""
    dof = len(to)
    request = ruckig.InputParameter(dof)
    request.current_position, request.current_velocity, request.current_acceleration = (
        [0.0] * dof,
        [0.0] * dof,
        [0.0] * dof,
    )
    request.target_position, request.target_velocity, request.target_acceleration = list(to), [0.0] * dof, [0.0] * dof
    request.max_velocity, request.max_acceleration, request.max_jerk = list(velocity), list(acceleration), list(jerk)
    request.synchronization = ruckig.Synchronization.Phase
    found = ruckig.Trajectory(dof)
    assert ruckig.Ruckig(dof).calculate(request, found) == ruckig.Result.Working
    return found


def random_limits(rng: np.random.Generator) -> np.ndarray:
    """Return limits of speed, acceleration and jerk of a path of length 1, over four decades each."""
    return 10.0 ** rng.uniform(-1.5, 2.5, 3)


def test_durations_and_states_agree_in_every_case() -> None:
    """500 random limits: duration to 1e-9, position, speed and acceleration at random times; all four cases occur."""
    rng = np.random.default_rng(0)
    cases = set()
    for _ in range(500):
        velocity, acceleration, jerk = random_limits(rng)
        profile = Profile(
            *(w.item() for w in fastest_profile(*(np.array(1.0 / x) for x in (velocity, acceleration, jerk))))
        )
        truth = by_ruckig(*(np.array([x]) for x in (velocity, acceleration, jerk)), np.ones(1))
        assert profile.duration == pytest.approx(truth.duration, rel=1e-9)
        cases.add((profile.cruise > profile.ramp + profile.ease, profile.ramp > profile.ease))
        t = rng.uniform(0.0, truth.duration, 6)
        s, sd, sdd = sample_profile(profile, t)
        expected = np.array([np.ravel(truth.at_time(x)[:3]) for x in t]).T
        scale = np.array([[1.0], [1.0 / profile.cruise], [1.0 / (profile.cruise * profile.ramp)]])
        assert (np.abs(np.array([s, sd, sdd]) - expected) <= 1e-6 * scale).all()
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
    samples = sample_profile(profile, t)
    for found, truth in zip(samples, (s, speed, acceleration), strict=True):
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


def test_speeds_and_accelerations_integrate_to_the_angles() -> None:
    """The trapezoid rule over qd gives q, with an error that falls with the square of the step."""
    via = np.random.default_rng(0).uniform(-6, 6, (8, 6))
    errors = []
    for period in (0.012, 0.003):
        motion = retime(via, [0] * 8, [-1] * 8, FREE_LIMITS, period)
        steps = np.diff(motion.t)[:, None]
        integral = via[0] + np.cumsum(0.5 * (motion.qd[1:] + motion.qd[:-1]) * steps, axis=0)
        errors.append(np.abs(integral - motion.q[1:]).max())
    assert errors[0] < 1e-3
    assert errors[1] < errors[0] / 8  # second order: four times finer, sixteen times better


@pytest.mark.parametrize("distance", [0.05, 0.4, 1.5, 5.0])
def test_no_sampled_motion_is_faster_than_the_closed_form(distance: float) -> None:
    """A linear programme over piecewise-constant accelerations covers at most the move's distance in the move's time.

    The programme maximises the distance from rest to rest in the time that `move_time` gives, under the same speed and
    acceleration limits: its optimum must be the distance, up to its discretisation.
    """
    speed, acceleration = FREE_LIMITS.velocity[0], FREE_LIMITS.acceleration[0]
    time = float(move_time(np.zeros(6), np.eye(6)[0] * distance, FREE_LIMITS))
    n = 400
    step = time / n
    to_speed = np.tril(np.full((n, n), step))
    to_distance = to_speed.sum(axis=0) * step - 0.5 * step**2  # exact integral of the piecewise-linear speed
    solved = linprog(
        -to_distance,
        A_ub=to_speed,
        b_ub=np.full(n, speed),
        A_eq=to_speed[-1:],
        b_eq=[0.0],
        bounds=(-acceleration, acceleration),
        method="highs",
    )
    assert solved.status == 0
    assert -solved.fun == pytest.approx(distance, rel=1e-3)
    assert -solved.fun <= distance * (1 + 1e-6)
