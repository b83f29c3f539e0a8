"""The line of a sweep: through its poses, half a step beyond them, with a constant twist."""

import numpy as np
import pytest

from planner.geometry.rigid import rotation_matrices, rotation_vectors
from planner.path.sweep_line import DEFAULT_SPEED, SweepSpeed, line_through
from planner.values import Floats
from planner.viewpoints.viewpoints import straight_sweep_poses, turned_sweep_poses


def _somewhere(seed: int) -> Floats:
    """Return a random pose (4, 4)."""
    rng = np.random.default_rng(seed)
    T = np.eye(4)
    T[:3, :3] = rotation_matrices(rng.uniform(-2, 2, (1, 3)))[0]
    T[:3, 3] = rng.uniform(-1, 1, 3)
    return T


@pytest.mark.parametrize("count", [2, 3, 8, 40])
@pytest.mark.parametrize("turned", [False, True])
def test_the_poses_are_in_the_middles_of_the_cells_of_the_line(count: int, turned: bool) -> None:
    """Pose k is at u = (k + 0.5) / K, and the line has the length of the sweep."""
    poses = _somewhere(count) @ (
        turned_sweep_poses(0.4, count) if turned else straight_sweep_poses(0.15, count, (1, 2, 0.5))
    )
    line = line_through(poses)
    assert line is not None
    np.testing.assert_allclose(line.at((np.arange(count) + 0.5) / count), poses, atol=1e-12)
    assert (line.length, line.angle) == pytest.approx((0.0, 0.4) if turned else (0.15, 0.0), abs=1e-12)
    assert not line.is_stationary


def test_a_screw_is_a_line_too() -> None:
    """Translation and rotation at the same time are accepted if they are proportional."""
    T = _somewhere(5)
    u = np.linspace(0, 1, 6)
    poses = np.tile(T, (6, 1, 1))
    poses[:, :3, :3] = rotation_matrices(u[:, None] * np.array([0.1, -0.2, 0.3])) @ T[:3, :3]
    poses[:, :3, 3] += u[:, None] * np.array([0.05, 0.0, -0.1])
    line = line_through(poses)
    assert line is not None
    np.testing.assert_allclose(line.at((np.arange(6) + 0.5) / 6), poses, atol=1e-12)


def test_poses_without_a_line_give_none() -> None:
    """A bend, unequal steps, a single pose and more than half a turn give no line."""
    straight = straight_sweep_poses(0.1, 5)
    bent = straight.copy()
    bent[3, 1, 3] += 1e-4
    uneven = straight.copy()
    uneven[4, 0, 3] += 1e-4
    assert line_through(bent) is None
    assert line_through(uneven) is None
    assert line_through(straight[:1]) is None
    assert line_through(turned_sweep_poses(3.1, 3) @ turned_sweep_poses(3.1, 3)) is None


def test_a_sweep_without_length_is_stationary() -> None:
    """A sweep of equal poses needs no speed."""
    line = line_through(np.tile(_somewhere(2), (4, 1, 1)))
    assert line is not None
    assert line.is_stationary


@pytest.mark.parametrize("count", [2, 8, 64])
@pytest.mark.parametrize("length", [1e-3, 0.15, 2.0])
def test_the_ramps_end_before_the_first_pose_and_keep_the_acceleration(count: int, length: float) -> None:
    """Between the first and the last pose the speed is constant, and at most the given one."""
    from planner.timing.s_curve import sample_profile

    line = line_through(straight_sweep_poses(length, count))
    assert line is not None
    speed = SweepSpeed(linear=0.2)
    profile = line.profile(line.cruise(speed))
    t = np.linspace(0, float(profile.duration), 4001)
    u, ud, udd = sample_profile(profile, t)
    between = (u >= 0.5 / count - 1e-12) & (u <= 1 - 0.5 / count + 1e-12)
    np.testing.assert_allclose(ud[between], 1 / float(profile.cruise), rtol=1e-9)
    assert ud.max() * length <= speed.linear * (1 + 1e-9)
    assert np.abs(udd).max() * length <= DEFAULT_SPEED.linear_acceleration * (1 + 1e-9)
    assert np.abs(np.diff(udd) / np.diff(t)).max() * length <= DEFAULT_SPEED.linear_acceleration * 10 * (1 + 1e-6)


def test_rotation_vectors_and_rotations_are_inverse() -> None:
    """The conversion and its inverse agree, also for zero and tiny rotations."""
    vectors = np.array([[0, 0, 0], [1e-9, 0, 0], [0.3, -0.4, 0.5], [0, 0, 3.0], [-1.2, 0.1, 2.0]], dtype=float)
    np.testing.assert_allclose(rotation_vectors(rotation_matrices(vectors)), vectors, atol=1e-12)
