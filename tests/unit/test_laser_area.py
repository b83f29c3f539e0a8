"""The `laser-area` scanner: its grid, its limits and refused values."""

import numpy as np
import pytest

from cell.errors import SceneError
from cell.scanners.laser_area import LaserArea
from planner.measurability.quality import LimitedScanner, QualityLimits
from planner.ports import Rejection
from planner.viewpoints.lines_of_sight import RayTargets, in_view, in_view_matrix

BACK = np.array([0.0, 0.0, -1.0])  # the normal of a surface that faces the scanner


def _at(x_deg, y_deg, distance):
    """Return a point at planar angles and a radial distance."""
    direction = np.array([np.tan(np.radians(x_deg)), np.tan(np.radians(y_deg)), 1.0])
    return direction / np.linalg.norm(direction) * distance


def _towards(point, degrees):
    """Return a normal at an angle from the direction to the source, turned about y; for points with y = 0."""
    angle = np.radians(degrees)
    c, s = np.cos(angle), np.sin(angle)
    direction = -point / np.linalg.norm(point)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ direction


@pytest.mark.parametrize(
    ("fov", "resolution", "shape"),
    [
        ((60, 60), (0.25, 0.25), (240, 240)),
        ((60, 40), (1, 0.5), (80, 60)),
        ((60, 60), (0.1, 0.1), (600, 600)),
        ((10, 10), (3, 3), (3, 3)),
        ((5, 5), (5, 5), (1, 1)),
    ],
)
def test_the_grid_has_the_rays_of_eq_1(fov, resolution, shape):
    """Rays per axis are round(FOV / resolution); the shape is (vertical, horizontal)."""
    scanner = LaserArea(fov_deg=fov, resolution_deg=resolution)
    assert scanner.grid_shape == shape
    assert scanner.ray_directions().shape == (shape[0] * shape[1], 3)


def test_rays_pass_through_the_middles_of_equal_angular_cells_row_by_row():
    """Rays pass through the centres of the angular cells, x changes fastest, and directions are unit vectors."""
    scanner = LaserArea(fov_deg=(60, 30), resolution_deg=(20, 15))
    directions = scanner.ray_directions()
    across = np.degrees(np.arctan2(directions[:, 0], directions[:, 2])).reshape(2, 3)
    down = np.degrees(np.arctan2(directions[:, 1], directions[:, 2])).reshape(2, 3)
    np.testing.assert_allclose(across, [[-20, 0, 20]] * 2, atol=1e-12)
    np.testing.assert_allclose(down, [[-7.5] * 3, [7.5] * 3], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-15)


def test_the_source_is_the_origin_and_the_sensor_is_along_x():
    """The source is the origin of the scanner frame, and the sensor is on its x axis at the baseline [m]."""
    scanner = LaserArea(baseline_mm=75)
    assert scanner.source.tolist() == [0, 0, 0]
    assert scanner.sensor.tolist() == [0.075, 0, 0]


@pytest.mark.parametrize(
    ("point", "normal", "reason"),
    [
        (_at(0, 0, 0.3), BACK, Rejection.MEASURED),
        (_at(30, 0, 0.3), BACK, Rejection.MEASURED),
        (_at(-30, 30, 0.3), BACK, Rejection.MEASURED),
        (_at(30.00001, 0, 0.3), BACK, Rejection.OUT_OF_FOV),
        (_at(0, -30.00001, 0.3), BACK, Rejection.OUT_OF_FOV),
        (-_at(0, 0, 0.3), -BACK, Rejection.OUT_OF_FOV),
        (_at(0, 0, 0.15), BACK, Rejection.MEASURED),
        (_at(0, 0, 0.45), BACK, Rejection.MEASURED),
        (_at(20, 20, 0.45), BACK, Rejection.MEASURED),
        (_at(0, 0, 0.1499999), BACK, Rejection.OUT_OF_RANGE),
        (_at(20, 20, 0.4500001), BACK, Rejection.OUT_OF_RANGE),
        (_at(0, 0, 0.3), _towards(_at(0, 0, 0.3), -75), Rejection.MEASURED),
        (_at(0, 0, 0.3), _towards(_at(0, 0, 0.3), 75), Rejection.MEASURED),
        (_at(10, 0, 0.3), _towards(_at(10, 0, 0.3), -75.00001), Rejection.GRAZING_SOURCE),
        (_at(10, -5, 0.3), -BACK, Rejection.GRAZING_SOURCE),
        (_at(0, 0, 0.3), np.zeros(3), Rejection.GRAZING_SOURCE),
        (_at(0, 0, 0.3), np.full(3, np.nan), Rejection.GRAZING_SOURCE),
        (np.full(3, np.nan), BACK, Rejection.OUT_OF_FOV),
    ],
)
def test_every_limit_is_inclusive_and_the_first_failed_one_is_reported(point, normal, reason):
    """Points on a limit are measured. Points slightly beyond are rejected for the first failed limit."""
    assert LaserArea().reject(point[None], normal[None]).tolist() == [reason]


def test_the_sensor_s_grazing_limit_is_that_of_the_reflected_ray():
    """The grazing limit of the sensor applies to the angle to the sensor."""
    point = np.array([0, 0, 0.3])
    normal = _towards(point, 40.0)
    at_sensor = np.degrees(np.arccos(normal @ (np.array([0.075, 0, 0]) - point) / np.hypot(0.075, 0.3)))
    assert at_sensor == pytest.approx(40 + np.degrees(np.arctan2(75, 300)))
    for limit, reason in ((at_sensor + 1e-6, Rejection.MEASURED), (at_sensor - 1e-5, Rejection.GRAZING_SENSOR)):
        scanner = LaserArea(sensor_grazing_max_deg=limit)
        assert scanner.reject(point[None], normal[None]).tolist() == [reason]


def test_many_points_have_the_results_of_single_ones():
    """10,000 points in one call have the results of a part of them, in any memory layout."""
    rng = np.random.default_rng(0)
    points = rng.normal(size=(10_000, 3)) * 0.3
    normals = rng.normal(size=(10_000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    scanner = LaserArea()
    codes = scanner.reject(points, normals)
    assert (codes == scanner.reject(np.asfortranarray(points), np.asfortranarray(normals))).all()
    assert (codes[5000:6000] == scanner.reject(points[5000:6000], normals[5000:6000])).all()
    assert len(set(codes.tolist())) == 5


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"fov_deg": (180, 60)}, "fov_deg.*below 180"),
        ({"fov_deg": (60, 0)}, "fov_deg.*above 0"),
        ({"fov_deg": 60}, "fov_deg.*pair"),
        ({"fov_deg": (60, float("nan"))}, "fov_deg.*finite"),
        ({"resolution_deg": (0, 1)}, "resolution_deg.*above 0"),
        ({"resolution_deg": (200, 1)}, "resolution_deg.*at most the field of view"),
        ({"range_mm": (300, 300)}, "range_mm.*min < max"),
        ({"range_mm": (-1, 300)}, "range_mm.*0 <= min"),
        ({"baseline_mm": -1}, "baseline_mm.*0 or more"),
        ({"baseline_mm": True}, "baseline_mm.*number"),
        ({"grazing_max_deg": 91}, "grazing_max_deg.*0 to 90"),
        ({"sensor_grazing_max_deg": -1}, "sensor_grazing_max_deg.*0 to 90"),
    ],
)
def test_invalid_parameters_are_refused(keys, words):
    """An invalid parameter is refused with the scene's key and the rule."""
    with pytest.raises(SceneError, match=f"scanner.{words}"):
        LaserArea(**keys)


def test_parameters_rebuild_the_scanner():
    """The stored parameters create the same scanner again."""
    scanner = LaserArea((50, 40), (0.5, 1), (100, 400), 25, 70, 85)
    keys = scanner.parameters()
    assert keys.pop("type") == "laser-area"
    assert LaserArea(**keys).parameters() == scanner.parameters()


@pytest.mark.parametrize("scanner", [LaserArea(), LaserArea(sensor_fov_deg=(40, 30), depth_of_field_mm=(200, 400))])
def test_points_in_another_frame_have_the_codes_of_transformed_points(scanner):
    """`reject_at` gives the codes of `reject`, for chosen points and any pose."""
    points, normals, T = _points_around()
    rows = np.random.default_rng(1).permutation(len(points))[:3000]
    expected = scanner.reject(points, normals)[rows]
    moved, turned = points @ T[:3, :3].T + T[:3, 3], normals @ T[:3, :3].T
    codes = scanner.reject_at(np.ascontiguousarray(moved.T), np.ascontiguousarray(turned.T), rows, T)
    np.testing.assert_array_equal(codes, expected)
    assert len(set(expected.tolist())) >= 4
    assert (expected == Rejection.MEASURED).sum() > 30


class _Half(LaserArea):
    """A subclass that rejects one side of its field of view."""

    def reject(self, points, normals):
        codes = super().reject(points, normals)
        codes[points[:, 0] > 0] = Rejection.OUT_OF_FOV
        return codes


@pytest.mark.parametrize(
    "scanner",
    [
        LaserArea(),
        LaserArea(max_spacing_mm=2.0),
        _Half(),
        LimitedScanner(LaserArea(), max_sigma=2e-5),
        LimitedScanner(LaserArea(), regions=(QualityLimits(sigma=2e-5), QualityLimits())),
    ],
)
def test_points_in_view_pass_all_conditions_of_the_scanner(scanner):
    """`in_view` and `in_view_matrix` find the points that `reject`, or that of their region, passes."""
    points, normals, T = _points_around()
    region = np.arange(len(points), dtype=np.int32) % 2
    has_regions = bool(getattr(scanner, "regions", ()))
    codes = scanner.reject_in(points, normals, region) if has_regions else scanner.reject(points, normals)
    moved, turned = points @ T[:3, :3].T + T[:3, 3], normals @ T[:3, :3].T
    targets, expected = RayTargets.of(moved, turned, region), np.flatnonzero(codes == Rejection.MEASURED)
    assert 0 < len(expected) < np.count_nonzero(LaserArea().reject(points, normals) == 0) or type(scanner) is LaserArea
    np.testing.assert_array_equal(in_view(targets, T, scanner), expected)
    matrix = in_view_matrix(targets, T[None], scanner, np.arange(len(points)))
    np.testing.assert_array_equal(np.flatnonzero(matrix[0]), expected)


def _points_around():
    """Return points and normals in the scanner frame, many of them in view, and a pose."""
    rng = np.random.default_rng(0)
    points = rng.uniform((-0.4, -0.4, -0.1), (0.4, 0.4, 0.6), (4000, 3))
    normals = rng.normal(size=(4000, 3)) - 2 * points / np.linalg.norm(points, axis=1, keepdims=True)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    T = np.eye(4)
    T[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    T[:3, :3] *= np.linalg.det(T[:3, :3])
    T[:3, 3] = 0.2, -0.3, 0.1
    return points, normals, T
