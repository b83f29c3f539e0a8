"""The sensor's own field of view and the depth of field: closed forms, inclusive limits, refusals."""

import numpy as np
import pytest

from cell.errors import SceneError
from cell.scanners.laser_area import LaserArea
from planner.ports import Rejection

BACK = np.array([0.0, 0.0, -1.0])
BASE = {"baseline_mm": 100, "range_mm": (100, 500), "fov_deg": (120, 120)}


def _codes(scanner: LaserArea, *points: list[float]) -> list[int]:
    return scanner.reject(np.array(points), np.tile(BACK, (len(points), 1))).tolist()


def test_without_the_keys_nothing_changes():
    """Without limits the measured points and the stored parameters are those of earlier versions."""
    rng = np.random.default_rng(0)
    points = rng.uniform([-0.3, -0.3, 0], [0.3, 0.3, 0.6], (5000, 3))
    normals = np.tile(BACK, (5000, 1))
    wide = LaserArea(**BASE, sensor_fov_deg=(179, 179), depth_of_field_mm=(0, 1e6))
    plain = LaserArea(**BASE)
    assert set(wide.parameters()) - set(plain.parameters()) == {
        "sensor_fov_deg", "sensor_tilt_deg", "depth_of_field_mm"
    }  # fmt: skip
    assert (wide.reject(points, normals) == plain.reject(points, normals)).mean() > 0.99
    assert set(plain.reject(points, normals)) <= set(range(8))


def test_parameters_make_the_same_scanner_again():
    """The stored parameters rebuild the scanner, with the derived tilt."""
    scanner = LaserArea(**BASE, sensor_fov_deg=(30, 20), depth_of_field_mm=(200, 400))
    parameters = scanner.parameters()
    again = LaserArea(**{key: value for key, value in parameters.items() if key != "type"})
    assert again.parameters() == parameters
    assert parameters["sensor_tilt_deg"] == pytest.approx(np.degrees(np.arctan2(100, 300)))


@pytest.mark.parametrize("tilt", [0.0, 10.0, 25.0, -5.0, None])
def test_planar_angles_about_the_sensor_s_axis_are_the_limit(tilt):
    """Points inside and on the limit are measured, points 1e-6 beyond are not."""
    scanner = LaserArea(**BASE, sensor_fov_deg=(30, 24), sensor_tilt_deg=tilt)
    turn = np.radians(tilt) if tilt is not None else np.arctan2(0.1, 0.3)  # the range's middle is at 300 mm
    x_axis, z_axis = np.array([np.cos(turn), 0, np.sin(turn)]), np.array([-np.sin(turn), 0, np.cos(turn)])

    def at(h: float, v: float) -> list[float]:
        direction = np.tan(np.radians(h)) * x_axis + np.tan(np.radians(v)) * np.array([0, 1, 0]) + z_axis
        return (scanner.sensor + 0.25 * direction).tolist()

    inside = _codes(scanner, at(0, 0), at(15, 0), at(-15, 0), at(0, 12), at(0, -12), at(15, -12))
    assert inside == [Rejection.MEASURED] * 6
    outside = _codes(scanner, at(15.00001, 0), at(-15.00001, 0), at(0, 12.00001), at(3, -12.00001))
    assert outside == [Rejection.OUT_OF_SENSOR_FOV] * 4


def test_by_default_the_axes_cross_in_the_middle_of_the_working_range():
    """A very narrow sensor sees exactly that point of the source's axis, of the depth of field if given."""
    narrow = {"sensor_fov_deg": (0.01, 0.01)}
    assert _codes(LaserArea(**BASE, **narrow), [0, 0, 0.3], [0, 0, 0.25]) == [0, Rejection.OUT_OF_SENSOR_FOV]
    shallow = LaserArea(**BASE, **narrow, depth_of_field_mm=(200, 300))
    assert _codes(shallow, [0, 0, 0.25], [0, 0, 0.3]) == [0, Rejection.OUT_OF_SENSOR_FOV]


def test_depth_is_along_z_and_inclusive():
    """The limit applies to z and not to the distance. The range has a separate code and is tested first."""
    scanner = LaserArea(**BASE, depth_of_field_mm=(200, 400))
    assert _codes(
        scanner, [0, 0, 0.2], [0.1, 0.1, 0.4], [0, 0, 0.1999999], [0.15, 0, 0.19], [0, 0, 0.4000001], [0, 0, 0.6]
    ) == [0, 0, *[Rejection.OUT_OF_DEPTH] * 3, Rejection.OUT_OF_RANGE]


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"sensor_fov_deg": (0, 20)}, "sensor_fov_deg is"),
        ({"sensor_fov_deg": 30}, "pair of numbers"),
        ({"sensor_tilt_deg": 90}, "between -90 and 90"),
        ({"depth_of_field_mm": (300, 200)}, "min < max"),
        ({"depth_of_field_mm": (-1, 200)}, "0 <= min"),
        ({"sigma_angle_mdeg": -1}, "0 or more"),
        ({"sigma_angle_mdeg": float("nan")}, "finite"),
    ],
)
def test_invalid_values_are_refused(keys, words):
    """Each invalid value gives one sentence with the key and the rule."""
    with pytest.raises(SceneError, match=words):
        LaserArea(**keys)
