"""Noise and pose error: their statistics, and no effect when they are switched off."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cell.scan.simulated import Disturbance, rotation_from_vector
from planner.geometry.rigid import pose_difference


def _pose(seed=1):
    T = np.eye(4)
    rng = np.random.default_rng(seed)
    T[:3, :3] = Rotation.random(random_state=seed).as_matrix()
    T[:3, 3] = rng.normal(size=3)
    return T


@pytest.mark.parametrize("length", [0.0, 1e-9, 0.3, np.pi, 5.0])
def test_rotation_is_scipys(length: float) -> None:
    """Rodrigues' formula against SciPy's rotation vector."""
    vector = length * np.array([0.6, -0.48, 0.64])
    np.testing.assert_allclose(rotation_from_vector(vector), Rotation.from_rotvec(vector).as_matrix(), atol=1e-15)


def test_switched_off_nothing_changes_bit_for_bit() -> None:
    """Without noise and pose error, pose and points are returned unchanged and no random number is drawn."""
    off, T, points = Disturbance(), _pose(), np.random.default_rng(0).normal(size=(9, 3))
    rng = np.random.default_rng(4)
    assert off.true_pose(T, rng) is T
    assert off.reported_points(points, T, T, np.zeros(3), rng) is points
    assert rng.random() == np.random.default_rng(4).random()
    assert not off.moves_pose


def test_the_pose_error_has_the_given_sigma_on_every_axis() -> None:
    """Position and rotation vector of the error, in the scanner's frame, have zero mean and the given sigma."""
    requests, T = Disturbance(position=0.5e-3, rotation=np.radians(0.1)), _pose()
    rng = np.random.default_rng(7)
    errors = [np.linalg.inv(T) @ requests.true_pose(T, rng) for _ in range(3000)]
    position = np.array([E[:3, 3] for E in errors])
    turn = Rotation.from_matrix(np.array([E[:3, :3] for E in errors])).as_rotvec()
    for values, sigma in ((position, 0.5e-3), (turn, np.radians(0.1))):
        assert np.abs(values.mean(axis=0)).max() < 4 * sigma / np.sqrt(3000)
        np.testing.assert_allclose(values.std(axis=0), sigma, rtol=0.06)


def test_range_noise_lies_along_the_ray_only() -> None:
    """Each point keeps its direction from the source, and the distances scatter with the given sigma."""
    T, source = _pose(), np.array([0.02, 0.0, 0.01])
    rng = np.random.default_rng(3)
    points = T[:3, 3] + rng.normal(size=(5000, 3)) + 5.0
    noisy = Disturbance(range_noise=2e-3).reported_points(points, T, T, source, rng)
    origin = T[:3, :3] @ source + T[:3, 3]
    before, after = points - origin, noisy - origin
    assert np.abs(np.cross(before, after)).max() < 1e-9
    change = np.linalg.norm(after, axis=1) - np.linalg.norm(before, axis=1)
    assert change.std() == pytest.approx(2e-3, rel=0.05)
    assert abs(change.mean()) < 4 * 2e-3 / np.sqrt(5000)


def test_a_pose_error_moves_the_scan_as_one_piece() -> None:
    """Points are stored relative to the reported pose, so they are unchanged in scanner coordinates."""
    requests, T = Disturbance(position=1e-2, rotation=0.05), _pose()
    rng = np.random.default_rng(5)
    true = requests.true_pose(T, rng)
    points = rng.normal(size=(20, 3))
    message = requests.reported_points(points, true, T, np.zeros(3), rng)

    def scanner(pose, p):
        return (p - pose[:3, 3]) @ pose[:3, :3]

    np.testing.assert_allclose(scanner(T, message), scanner(true, points), atol=1e-12)


def test_difference_of_poses_is_the_distance_and_the_angle() -> None:
    """The result agrees with SciPy, small angles are exact, and equal poses have the difference 0."""
    T = _pose()
    for angle in (1e-8, 1e-3, 1.0, 3.1):
        moved = T.copy()
        moved[:3, :3] = T[:3, :3] @ Rotation.from_rotvec([0, angle, 0]).as_matrix()
        moved[:3, 3] += [0.3, 0.0, 0.4]
        assert pose_difference(T, moved) == pytest.approx((0.5, angle), rel=1e-6)
    assert pose_difference(T, T)[0] == 0.0
    assert pose_difference(T, T)[1] < 1e-15
