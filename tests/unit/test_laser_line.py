"""The `laser-line` scanner: limits, codes, parameters, refusals."""

import numpy as np
import pytest

from cell.errors import SceneError
from cell.scanners.laser_line import LaserLine
from planner.ports import Rejection

BACK = np.array([0.0, 0.0, -1.0])


def _line(**keys) -> LaserLine:
    return LaserLine(**{"fan_deg": 30, "range_mm": (200, 400), "baseline_mm": 100, "sweep_mm": 80, **keys})


def _in_sheet(degrees: float, depth: float) -> np.ndarray:
    return np.array([0.0, np.tan(np.radians(degrees)) * depth, depth])


@pytest.mark.parametrize(
    ("point", "normal", "reason"),
    [
        (_in_sheet(0, 0.3), BACK, Rejection.MEASURED),
        (_in_sheet(15, 0.3), BACK, Rejection.MEASURED),
        (_in_sheet(-15, 0.3), BACK, Rejection.MEASURED),
        (_in_sheet(15.0001, 0.3), BACK, Rejection.OUT_OF_FOV),
        (_in_sheet(15, 0.4), BACK, Rejection.MEASURED),  # 414 mm from the source: the range is the depth
        (_in_sheet(0, 0.2), BACK, Rejection.MEASURED),
        (_in_sheet(0, 0.19999), BACK, Rejection.OUT_OF_RANGE),
        (_in_sheet(15, 0.40001), BACK, Rejection.OUT_OF_RANGE),
        (np.array([0.005, 0, 0.3]), BACK, Rejection.MEASURED),
        (np.array([-0.005, 0, 0.3]), BACK, Rejection.MEASURED),
        (np.array([0.0050001, 0, 0.3]), BACK, Rejection.OUT_OF_FOV),
        (_in_sheet(0, -0.3), -BACK, Rejection.OUT_OF_FOV),
        (_in_sheet(0, 0.3), -BACK, Rejection.GRAZING_SOURCE),
        (_in_sheet(0, 0.3), np.zeros(3), Rejection.GRAZING_SOURCE),
        (_in_sheet(0, 0.3), np.array([-np.sin(1.3), 0, -np.cos(1.3)]), Rejection.GRAZING_SENSOR),
        (_in_sheet(0, 0.3), np.array([np.sin(1.3), 0, -np.cos(1.3)]), Rejection.MEASURED),
        (np.full(3, np.nan), BACK, Rejection.OUT_OF_FOV),
    ],
)
def test_every_limit_is_inclusive_and_the_first_failed_one_is_reported(point, normal, reason) -> None:
    """Points on a limit are measured, and points slightly beyond are rejected."""
    scanner = _line(grazing_max_deg=80)
    assert scanner.reject(point[None], normal[None]).tolist() == [reason]


def test_a_turned_sheet_is_a_wedge() -> None:
    """With six steps of 30 degrees the sheet is a wedge of 2.5 degrees to either side at every depth."""
    scanner = _line(sweep_mm=None, sweep_deg=30, sweep_steps=6)
    for depth in (0.2, 0.4):
        for degrees, reason in ((2.5, Rejection.MEASURED), (2.5001, Rejection.OUT_OF_FOV)):
            points = np.array([[np.tan(np.radians(s * degrees)) * depth, 0, depth] for s in (-1, 1)])
            assert scanner.reject(points, np.tile(BACK, (2, 1))).tolist() == [reason, reason]


def test_the_rays_of_a_line_lie_in_the_sheet_and_are_measured() -> None:
    """Rays are unit vectors in the sheet at equal angles inside the fan, and their number is that of `grid_shape`."""
    scanner = _line(line_points=7)
    rays = scanner.ray_directions()
    assert scanner.grid_shape == (7, 1)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1, atol=1e-15)
    angles = np.degrees(np.arctan2(rays[:, 1], rays[:, 2]))
    np.testing.assert_allclose(np.diff(angles), 30 / 7)
    np.testing.assert_allclose(angles[[0, -1]], [-15 + 15 / 7, 15 - 15 / 7])
    assert (rays[:, 0] == 0).all()
    assert not scanner.reject(0.3 * rays, np.tile(BACK, (7, 1))).any()


def test_the_default_sweep_has_the_length_of_the_line_in_mid_range() -> None:
    """The default sweep is the length of the line in mid range: 2 x 300 x tan(15 deg) for a fan of 30 degrees."""
    scanner = _line(sweep_mm=None)
    assert scanner.sweep_mm == pytest.approx(600 * np.tan(np.radians(15)), rel=1e-12)
    poses = scanner.T_view_scanner
    assert np.ptp(poses[:, 0, 3]) == pytest.approx(scanner.sweep_mm / 1000 * 7 / 8)


def test_sigma_in_front_of_a_wall_is_that_of_triangulation() -> None:
    """On the source's axis sigma is sigma_angle (z^2 + b^2) / b, corrected for the sensor's incidence."""
    z, b = 0.3, 0.1
    cos_sensor = z / np.hypot(z, b)
    expected = np.radians(2e-3) * (z * z + b * b) / b / (z / z) * np.sqrt(1 / cos_sensor)
    got = _line(sigma_angle_mdeg=2.0).sigma(np.array([[0, 0, z]]), BACK[None])[0]
    alone = np.radians(2e-3) * np.hypot(z, b) / (b / np.hypot(z, b)) / np.sqrt(cos_sensor)
    assert got == pytest.approx(alone, rel=1e-12)
    assert got == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("keys", [{}, {"sweep_mm": None, "sweep_deg": 20.0}, {"sweep_mm": None}, {"line_points": 3}])
def test_parameters_rebuild_the_scanner(keys: dict) -> None:
    """The stored parameters create the same scanner again."""
    scanner = _line(**keys)
    recorded = scanner.parameters()
    assert recorded.pop("type") == "laser-line"
    again = LaserLine(**recorded)
    assert again.parameters() == scanner.parameters()
    assert (again.T_view_scanner == scanner.T_view_scanner).all()


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"fan_deg": 180}, "scanner.fan_deg is 180.*below 180"),
        ({"fan_deg": None}, "scanner.fan_deg is None"),
        ({"fan_deg": float("nan")}, "scanner.fan_deg is nan"),
        ({"fan_deg": [30, 30]}, "scanner.fan_deg"),
        ({"sweep_deg": 20}, "both describe the sweep; give one"),
        ({"sweep_mm": 0}, "scanner.sweep_mm is 0.*above 0"),
        ({"sweep_mm": float("inf")}, "scanner.sweep_mm is inf"),
        ({"sweep_mm": None, "sweep_deg": 180}, "scanner.sweep_deg is 180.*below 180"),
        ({"sweep_steps": 0}, "scanner.sweep_steps is 0.*at least 1"),
        ({"sweep_steps": 2.5}, "scanner.sweep_steps is 2.5.*whole number"),
        ({"line_points": True}, "scanner.line_points is True"),
        ({"range_mm": (400, 200)}, "scanner.range_mm.*min < max"),
        ({"range_mm": 300}, "scanner.range_mm is 300.*pair"),
        ({"range_mm": (200, float("inf"))}, "scanner.range_mm"),
        ({"baseline_mm": -1}, "scanner.baseline_mm.*0 or more"),
        ({"grazing_max_deg": 91}, "scanner.grazing_max_deg.*0 to 90"),
    ],
)
def test_invalid_parameters_are_refused(keys: dict, words: str) -> None:
    """An invalid parameter is refused with the scene's key and the rule."""
    with pytest.raises(SceneError, match=words):
        _line(**keys)
