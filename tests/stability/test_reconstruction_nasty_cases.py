"""Clouds on which reconstruction may fail, by name."""

import numpy as np
import pytest

from cell.metrology.reconstruct import ReconstructionStatus, reconstruct
from planner.registration.cloud import PointCloud, ScanCloud, merge

SENSOR = np.array([0.0, 0.0, 0.3])


def _plane(side: int = 50, pitch: float = 1e-3) -> np.ndarray:
    x, y = np.meshgrid((np.arange(side) - side / 2) * pitch, (np.arange(side) - side / 2) * pitch)
    return np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)


NO_SURFACE = {
    "no scan": [],
    "a view that sees nothing": [ScanCloud(np.empty((0, 3)), SENSOR)],
    "one point": [ScanCloud(np.zeros((1, 3)), SENSOR)],
    "the same point a hundred times": [ScanCloud(np.zeros((100, 3)), SENSOR)],
    "eleven points": [ScanCloud(_plane()[:11], SENSOR)],
}


@pytest.mark.parametrize("name", NO_SURFACE)
def test_too_few_points_are_reported(name: str) -> None:
    """Too few points give the status TOO_FEW_POINTS and no mesh."""
    result = reconstruct(merge(NO_SURFACE[name]))
    assert result.mesh is None
    assert result.status is ReconstructionStatus.TOO_FEW_POINTS
    assert len(result.closed) == 0


def test_a_line_of_points_makes_a_ribbon_no_wider_than_the_cut() -> None:
    """Points on a line give only a strip that faces the scanner, up to two spacings wide on either side."""
    line = np.stack([np.arange(200) * 1e-3, np.zeros(200), np.zeros(200)], axis=1)
    result = reconstruct(merge([ScanCloud(line, SENSOR)]))
    assert result.mesh is not None
    assert 0.5e-3 < np.abs(result.mesh.vertices[:, 1]).max() <= 2e-3
    assert np.abs(result.mesh.vertices[:, 2]).max() < 1e-9


def test_outliers_of_one_percent_do_not_show() -> None:
    """With 1 % of the points up to 20 mm off, every vertex is within a tenth of the pitch of the plane."""
    points = _plane(100)
    rng = np.random.default_rng(0)
    bad = rng.choice(len(points), len(points) // 100, replace=False)
    points[bad, 2] += rng.uniform(-0.02, 0.02, len(bad))
    result = reconstruct(merge([ScanCloud(points, SENSOR)]))
    assert result.mesh is not None
    near = np.abs(points[bad, 2]) < 0.3e-3  # within a third of a pitch: noise, not outliers
    assert result.outliers >= (~near).sum()
    assert np.abs(result.mesh.vertices[:, 2]).max() < 0.1e-3
    assert result.holes == 1


def test_two_blobs_without_overlap_stay_apart() -> None:
    """Two patches a metre apart give two surfaces and no vertex between them."""
    points, aside = _plane(30), np.array([1.0, 0.0, 0.0])
    result = reconstruct(merge([ScanCloud(points, SENSOR), ScanCloud(points + aside, SENSOR + aside)]))
    assert result.mesh is not None
    assert result.holes == 2
    assert not ((result.mesh.vertices[:, 0] > 0.03) & (result.mesh.vertices[:, 0] < 0.97)).any()


def test_a_sharp_edge_is_rounded_by_less_than_a_spacing() -> None:
    """At a 90 degree edge all vertices are within 0.6 pitches of a plane, most of them within 2 micrometres."""
    flat = _plane(40)
    wall = np.stack(
        [np.full(len(flat), flat[:, 0].max() + 0.5e-3), flat[:, 1], flat[:, 0] - flat[:, 0].max() - 0.5e-3], 1
    )
    sensor = np.array([0.25, 0, 0.25])
    result = reconstruct(merge([ScanCloud(np.concatenate([flat, wall]), sensor)]))
    assert result.mesh is not None
    x, _, z = result.mesh.vertices.T
    off = np.minimum(np.abs(z), np.abs(x - wall[0, 0]))
    assert off.max() < 0.6e-3
    assert np.quantile(off, 0.8) < 2e-6


def test_a_huge_box_is_coarsened_not_filled() -> None:
    """Patches ten metres apart would need billions of nodes. The grid is coarsened, and both patches remain."""
    points = _plane(100)
    scans = [ScanCloud(points + shift, SENSOR + shift) for shift in (np.zeros(3), np.array([10.0, 10.0, 10.0]))]
    result = reconstruct(merge(scans))
    assert result.grid > 10 * result.spacing
    assert result.mesh is not None
    assert result.holes == 2
    assert np.abs(result.mesh.vertices[:, 2] - np.round(result.mesh.vertices[:, 2], -1)).max() < 1e-6


def test_normals_of_the_wrong_sign_give_no_doubled_surface() -> None:
    """With 1 % wrong normals the result is one surface near the plane."""
    cloud = merge([ScanCloud(_plane(60), SENSOR)])
    normals = cloud.normals.copy()
    normals[np.random.default_rng(1).choice(len(normals), len(normals) // 100, replace=False)] *= -1
    result = reconstruct(PointCloud(cloud.points, normals, cloud.scan))
    assert result.mesh is not None
    assert np.abs(result.mesh.vertices[:, 2]).max() < 0.05e-3
