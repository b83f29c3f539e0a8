"""Singular poses and poses near them, at which closed forms divide by zero or lose digits."""

import numpy as np
import pytest

from cell.robot.arm import kr16_kinematics

STRETCHED = -np.rad2deg(np.arctan2(0.035, 0.670))

SINGULAR = {
    "zero: wrist and level": (0, 0, 0, 0, 0, 0),
    "upright, wrist straight": (0, -90, 90, 0, 0, 0),
    "wrist straight, A4 and A6 share": (20, -80, 100, 40, 0, -10),
    "wrist straight, A4 = 0": (20, -80, 100, 0, 0, 30),
    "arm stretched": (0, -45, STRETCHED, 0, 40, 0),
    "arm and wrist stretched": (15, -45, STRETCHED, 0, 0, 25),
    "wrist centre over A1": (0, -120, 33.857864, 0, 60, 0),
    "wrist centre over A1, wrist straight": (50, -120, 33.857864, 10, 0, 60),
}
OFFSETS = (0.0, 1e-16, 1e-14, 1e-12, 1e-10, 1e-9, 1e-8, 1e-7)


@pytest.fixture(scope="module")
def kinematics():
    """Return the kinematics of models/kr16.xml."""
    return kr16_kinematics()


@pytest.mark.parametrize("name", SINGULAR)
def test_round_trip_at_and_near(kinematics, name):
    """Within 1e-7 rad of a singular pose a branch exists, and every branch leads back to 1e-10 m and 1e-10 rad."""
    rng = np.random.default_rng(7)
    steps = rng.choice([-1.0, 0.0, 1.0], (60, 6))
    q = np.deg2rad(SINGULAR[name]) + np.concatenate([offset * steps for offset in OFFSETS])
    T = kinematics.forward(q)
    solutions = kinematics.inverse(T)
    real = ~np.isnan(solutions[..., 0])
    assert real.any(axis=1).all()
    pose, slot = np.nonzero(real)
    np.testing.assert_allclose(kinematics.forward(solutions[pose, slot]), T[pose], rtol=0, atol=1e-10)


@pytest.mark.parametrize("name", ["wrist straight, A4 and A6 share", "wrist straight, A4 = 0"])
def test_straight_wrist_follows_the_convention(kinematics, name):
    """At A5 = 0 the pose's own branch has A5 = 0, A4 = 0 and A6 equal to the sum of the original A4 and A6."""
    q = np.deg2rad(SINGULAR[name])
    solution = kinematics.inverse(kinematics.forward(q[None]))[0, 0]
    np.testing.assert_allclose(solution, [*q[:3], 0.0, 0.0, q[3] + q[5]], rtol=0, atol=1e-12)
    assert solution[3] == 0.0
    assert solution[4] == 0.0


def test_the_wrist_centre_on_a1_gives_a1_zero(kinematics):
    """With the wrist centre exactly on A1 any A1 is a solution; the branches have 0 and 180 deg."""
    T = np.eye(4)[None].copy()
    T[0, 2, 3] = 1.9  # flange straight up, the wrist centre below it on the A1 axis
    solutions = kinematics.inverse(T)[0]
    assert not np.isnan(solutions).any()
    assert (solutions[:4, 0] == 0.0).all()
    assert (solutions[4:, 0] == np.pi).all()
    np.testing.assert_allclose(kinematics.forward(solutions), np.repeat(T, 8, axis=0), rtol=0, atol=1e-12)


def test_a_hundred_thousand_poses(kinematics):
    """The round trip is exact to 1e-9 for random poses, 40 percent of them near singularities."""
    rng = np.random.default_rng(8)
    q = rng.uniform(kinematics.limits.lower, kinematics.limits.upper, (100_000, 6))
    q[:20_000, 4] *= 10.0 ** rng.uniform(-17, 0, 20_000)
    q[10_000:30_000, 2] = np.deg2rad(STRETCHED) + 10.0 ** rng.uniform(-17, 0, 20_000)
    # r = 0: the forearm's direction for which its reach cancels a1 + a2 cos A2.
    lean = np.arccos(np.clip(-(0.26 + 0.68 * np.cos(q[30_000:40_000, 1])) / np.hypot(0.67, 0.035), -1, 1))
    q[30_000:40_000, 2] = lean + np.deg2rad(STRETCHED) - q[30_000:40_000, 1] + 10.0 ** rng.uniform(-17, -3, 10_000)
    T = kinematics.forward(q)
    solutions = kinematics.inverse(T)
    real = ~np.isnan(solutions[..., 0])
    assert real.any(axis=1).all()
    back = kinematics.forward(solutions.reshape(-1, 6)).reshape(-1, 8, 4, 4)
    assert np.abs(back - T[:, None])[real].max() < 1e-9
