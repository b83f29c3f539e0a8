"""The closed-form profile compared with numerical integration and with a linear programme."""

import numpy as np
import pytest
from scipy.optimize import linprog

from planner.ports import JointLimits
from planner.timing.motion import retime
from planner.timing.move_time import move_time

LIMITS = JointLimits(
    lower=np.full(6, -7.0),
    upper=np.full(6, 7.0),
    velocity=np.radians([156, 156, 156, 330, 330, 615]),
    acceleration=np.radians([312, 312, 312, 660, 660, 1230]),
)


def test_speeds_and_accelerations_integrate_to_the_angles() -> None:
    """The trapezoid rule over qd gives q, with an error that falls with the square of the step."""
    via = np.random.default_rng(0).uniform(-6, 6, (8, 6))
    errors = []
    for period in (0.012, 0.003):
        motion = retime(via, [0] * 8, [-1] * 8, LIMITS, period)
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
    speed, acceleration = LIMITS.velocity[0], LIMITS.acceleration[0]
    time = float(move_time(np.zeros(6), np.eye(6)[0] * distance, LIMITS))
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
