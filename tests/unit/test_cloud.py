"""Point clouds: normals, point spacing, merging, and refusal of values that are not finite."""

import numpy as np
import pytest

from planner.errors import PlannerError
from planner.registration.cloud import ScanCloud, estimate_normals, merge, point_spacing


def _ball(count: int, rng: np.random.Generator) -> np.ndarray:
    points = rng.normal(size=(count, 3))
    return 0.05 * points / np.linalg.norm(points, axis=1, keepdims=True)


def test_normals_of_a_ball_point_away_from_its_middle() -> None:
    """Normals of 20,000 random points are within 2.5 degrees and turned towards their own sensor.

    Neighbours span 3 degrees.
    """
    points = _ball(20_000, np.random.default_rng(0))
    sensors = points * 7 + np.random.default_rng(1).uniform(-0.05, 0.05, points.shape)
    cosine = np.einsum("nj,nj->n", estimate_normals(points, sensors), points / 0.05)
    assert np.degrees(np.arccos(cosine.clip(-1, 1))).max() < 2.5


def test_rows_far_apart_do_not_turn_normals_across_the_rows() -> None:
    """A plane scanned at 75 degrees, points 0.3 mm apart in rows 5 mm apart, keeps its own normal."""
    x, y = np.meshgrid(np.arange(-20, 20, 0.3) * 1e-3, np.arange(-20, 20, 5.0) * 1e-3)
    points = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    sensor = 0.3 * np.array([0, np.sin(np.radians(75)), np.cos(np.radians(75))])
    rough = points + np.random.default_rng(0).normal(0, 2e-6, points.shape)
    assert estimate_normals(rough, sensor)[:, 2].min() > 0.99


def test_the_two_faces_of_a_thin_sheet_keep_their_own_normals() -> None:
    """Points 1 mm apart on both faces of a sheet of 0.3 mm keep the normal of their own face."""
    x, y = np.meshgrid(np.arange(40) * 1e-3, np.arange(40) * 1e-3)
    face = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    points = np.concatenate([face, face - [0, 0, 3e-4]])
    sensors = np.where(np.arange(len(points))[:, None] < len(face), [[0.02, 0.02, 0.3]], [[0.02, 0.02, -0.3]])
    normals = estimate_normals(points, sensors)
    np.testing.assert_allclose(normals[: len(face), 2], 1, atol=1e-6)
    np.testing.assert_allclose(normals[len(face) :, 2], -1, atol=1e-6)


def test_a_point_at_the_sensor_has_a_unit_normal() -> None:
    """Zeros for rays without an echo are points at the sensor; there is no line of sight to them."""
    points = np.vstack([np.random.default_rng(1).uniform(0.1, 0.2, (40, 3)), np.zeros((1, 3))])
    normals = estimate_normals(points, np.zeros(3))
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-6)


def test_spacing_is_of_the_scan_not_of_the_overlap() -> None:
    """Two grids of 1 mm, shifted by 0.1 mm, have a spacing of 1 mm as two scans and of 0.1 mm as one cloud."""
    x, y = np.meshgrid(np.arange(30) * 1e-3, np.arange(30) * 1e-3)
    grid = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    both, scan = np.concatenate([grid, grid + np.array([1e-4, 0, 0])]), np.repeat([0, 1], len(grid))
    assert point_spacing(both, scan) == pytest.approx(1e-3)
    assert point_spacing(both) == pytest.approx(1e-4)
    assert np.isnan(point_spacing(grid[:1]))
    assert np.isnan(point_spacing(grid[[0, 0, 0]]))


def test_merged_points_keep_order_and_scan_number() -> None:
    """Merged points are in the order of the scans and keep the scan number.

    Without scans the cloud is empty.
    """
    rng = np.random.default_rng(2)
    scans = [ScanCloud(_ball(count, rng), np.array([0, 0, 0.5])) for count in (50, 0, 30)]
    cloud = merge(scans)
    assert cloud.points.tobytes() == np.concatenate([scans[0].points, scans[2].points]).tobytes()
    assert cloud.scan.tolist() == [0] * 50 + [2] * 30
    assert len(merge([])) == 0


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_infinite_and_missing_numbers_are_refused_by_name(bad: float) -> None:
    """A scan with NaN or infinity is refused with the number of such points."""
    points = np.zeros((5, 3))
    points[3, 1] = bad
    with pytest.raises(PlannerError, match=r"points of the scan: 1 of 5 have NaN or infinity"):
        ScanCloud(points, np.zeros(3))
