"""The controller's interpolator compared with the planner's timing, two independent implementations."""

import numpy as np
import pytest

from drivers.profile import Reference, interpolate
from drivers.setpoints import from_rad, to_rad
from planner.kinematics.setpoints import from_steps, to_steps
from planner.path.certified_edge import quantise
from planner.ports import JointLimits
from planner.timing.motion import retime
from planner.timing.move_time import move_time
from tests.support.arms import KR16


def limits(speed: float) -> JointLimits:
    """Return the controller's limits for the planner."""
    robot = KR16
    return JointLimits(to_rad(robot.lower), to_rad(robot.upper), robot.velocity * speed, robot.acceleration, robot.jerk)


def tour(rng: np.random.Generator, count: int, spread_deg: float) -> np.ndarray:
    """Return via points (count, 6) inside the limits [rad] with steps of up to `spread_deg`, some of them zero."""
    robot = KR16
    middle = (robot.lower + robot.upper.astype(np.int64)) / 2
    steps = rng.uniform(-spread_deg, spread_deg, (count, 6)) * 1e4 * rng.integers(0, 2, (count, 6))
    return to_rad(np.clip(middle + np.cumsum(steps, axis=0), robot.lower, robot.upper).astype(np.int32))


def by_controller(via: np.ndarray, speed: float) -> Reference:
    """Return the controller's reference."""
    return interpolate(via[0], via[1:], KR16.velocity * speed, KR16.acceleration, KR16.jerk)


@pytest.mark.parametrize("spread_deg", [1e-4, 0.01, 5.0, 170.0])
@pytest.mark.parametrize("speed", [1e-3, 0.1, 1.0])
def test_durations_agree(spread_deg: float, speed: float) -> None:
    """The total and each segment agree, up to the margins of both to the limits."""
    via = tour(np.random.default_rng(1), 200, spread_deg)
    expected = move_time(via[:-1], via[1:], limits(speed))
    assert by_controller(via, speed).duration == pytest.approx(expected.sum(), rel=3e-8)
    for k in range(0, 199, 20):
        assert by_controller(via[k : k + 2], speed).duration == pytest.approx(expected[k], rel=3e-8, abs=1e-15)


def test_the_motions_agree_at_every_sample() -> None:
    """Angles, speeds and accelerations at the planner's sample times."""
    via = tour(np.random.default_rng(2), 40, 60.0)
    motion = retime(via, np.arange(40), np.full(40, -1), limits(0.7))
    q, qd, qdd = by_controller(via, 0.7).sample(motion.t)
    assert np.abs(q - motion.q).max() < 1e-6
    assert np.abs(qd - motion.qd).max() < 1e-5
    assert np.abs(qdd - motion.qdd).max() < 1e-4


def test_speeds_and_accelerations_stay_inside_the_limits_and_integrate() -> None:
    """No sample exceeds a limit, some axis reaches one, and the speeds integrate to the angles."""
    via = tour(np.random.default_rng(3), 30, 120.0)
    reference, allowed = by_controller(via, 1.0), limits(1.0)
    t = np.arange(0, reference.duration, 1e-3)
    q, qd, qdd = reference.sample(t)
    assert (np.abs(qd) <= allowed.velocity).all()
    assert (np.abs(qdd) <= allowed.acceleration).all()
    assert (np.abs(qd) / allowed.velocity).max() > 1 - 1e-8
    assert (np.abs(qdd) / allowed.acceleration).max() > 1 - 1e-8
    assert (np.abs(np.diff(qdd, axis=0)) <= 1e-3 * allowed.jerk + 1e-11).all()
    assert (np.abs(np.diff(qdd, axis=0)) / (1e-3 * allowed.jerk)).max() > 1 - 1e-8
    # The trapezoid rule misses at most a quarter of a millisecond of acceleration where a piece ends between samples.
    missed = np.abs(np.diff(q, axis=0) - 0.5e-3 * (qd[1:] + qd[:-1]))
    assert (missed <= 0.25 * 1e-6 * 2 * allowed.acceleration + 1e-12).all()


def test_quantisation_equals_the_planners() -> None:
    """Planner and wire quantise equally: equal floats, equal integers."""
    q = np.random.default_rng(4).uniform(-6.2, 6.2, (50_000, 6))
    counts = from_rad(q)
    assert (to_rad(counts) == quantise(q)).all()
    assert (to_rad(counts) == from_steps(to_steps(q))).all()
    assert (counts == to_steps(q)).all()
    assert (from_rad(to_rad(counts)) == counts).all()
