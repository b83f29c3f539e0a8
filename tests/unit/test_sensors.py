"""The library of real sensors, and the keys of the scene's scanner table."""

from pathlib import Path

import numpy as np
import pytest

from cell.errors import FileError, SceneError
from cell.part.workpiece import load as load_part
from cell.scene import sensors
from cell.scene.file import load_scene
from cell.scene.model import Scene, scanner_keys
from cell.scene.settle import settle


def _problems(**scanner) -> list[str]:
    with pytest.raises(SceneError) as caught:
        load_scene(None, {"scanner": scanner})
    return [line.strip() for line in str(caught.value).splitlines()[1:]]


REAL = ("gocator-2330", "gocator-2340", "gocator-2350", "keyence-lj-v7200", "keyence-lj-x8400")
GENERIC = ("generic-area-large", "generic-area-medium", "generic-area-small")


def test_the_library_holds_real_sensors_generic_devices_and_the_papers_scanner() -> None:
    """Their names are those of the files."""
    assert set(sensors.names()) == {*REAL, *GENERIC, "paper"}


@pytest.mark.parametrize("name", sensors.names())
def test_every_figure_has_its_source(name: str) -> None:
    """Each figure of the file has a source, and no other figure has one. Derived keys are keys of the type."""
    sensor = sensors.load(name)
    assert set(sensor.source) == sensor.figures.model_fields_set
    assert all(sensor.source.values())
    assert set(sensor.keys) <= set(scanner_keys(sensor.type) or ())


@pytest.mark.parametrize(
    ("name", "near", "far"), [("small", 15.0, 45.0), ("medium", 50.0, 150.0), ("large", 150.0, 450.0)]
)
def test_the_generic_devices_are_scaled_copies(name: str, near: float, far: float) -> None:
    """Baseline and body scale with the range, to 0.1 mm, and no figure is missing."""
    device, large = sensors.load(f"generic-area-{name}"), sensors.load("generic-area-large")
    assert device.figures.range_mm == (near, far)
    assert device.figures.baseline_mm == (near + far) / 8
    for key in ("housing_mm", "bracket_mm"):
        to_scale = np.array(getattr(large.figures, key)) * far / 450
        np.testing.assert_allclose(getattr(device.figures, key), to_scale, atol=0.05)
    assert not device.not_stated


@pytest.mark.parametrize("name", REAL)
def test_figures_that_are_not_stated_must_be_given(name: str) -> None:
    """The baseline of each real sensor is one of them."""
    sensor = sensors.load(name)
    assert set(sensor.keys) | set(sensor.not_stated) >= {"fan_deg", "range_mm", "baseline_mm"}
    assert not set(sensor.keys) & set(sensor.not_stated)
    assert "baseline_mm" in sensor.not_stated


@pytest.mark.parametrize(
    ("name", "near", "far", "from_housing"),
    [
        ("gocator-2330", 47, 85, (90, 170)),
        ("gocator-2340", 96, 194, (190, 400)),
        ("gocator-2350", 158, 365, (300, 700)),
        ("keyence-lj-x8400", 180, 240, (320, 440)),
    ],
)
def test_fan_and_range_give_back_the_data_sheet_s_line(name: str, near: float, far: float, from_housing: tuple) -> None:
    """The line has the length of the data sheet at both ends of the range; fans are 26 to 30 degrees."""
    sensor = sensors.load(name)
    fan, (low, high) = sensor.keys["fan_deg"], sensor.keys["range_mm"]
    assert 26 < fan < 30
    lengths = 2 * np.array([low, high]) * np.tan(np.radians(fan / 2))
    np.testing.assert_allclose(lengths, [near, far], rtol=1e-12)
    behind = sensor.apex_behind_window_mm
    assert behind is not None
    np.testing.assert_allclose(np.array([low, high]) - behind, from_housing, rtol=1e-12)


def test_a_sensor_fills_the_scanner_table_and_the_scene_takes_precedence() -> None:
    """Type, fan and range are those of the library unless the scene replaces them; the standoff is mid-range."""
    scene = load_scene(None, {"scanner": {"sensor": "gocator-2350", "baseline_mm": 160.0, "fan_deg": 27.0}})
    assert scene.scanner.type == "laser-line"
    assert scene.scanner.fan_deg == 27.0
    assert scene.scanner.range_mm == pytest.approx((305.314, 705.314), abs=1e-3)
    settings = settle(scene, load_part("mseke", None)).settings
    assert settings.standoffs == pytest.approx((0.505314,), abs=1e-6)
    assert settings.scanner["baseline_mm"] == 160.0
    assert "fov_deg" not in settings.scanner
    assert "resolution_deg" not in settings.planning_scanner


@pytest.mark.parametrize(
    ("scanner", "lines"),
    [
        (
            {"sensor": "gocator-2350"},
            ["scanner.sensor gocator-2350 does not state its baseline; set scanner.baseline_mm"],
        ),
        (
            {"sensor": "keyence-lj-v7200", "baseline_mm": 90.0},
            [
                "scanner.sensor keyence-lj-v7200 does not state its fan; set scanner.fan_deg",
                "scanner.sensor keyence-lj-v7200 does not state its range; set scanner.range_mm",
            ],
        ),
        ({"sensor": "gocator2350"}, ["scanner.sensor is 'gocator2350'; did you mean 'gocator-2350'? valid are: "]),
        (
            {"sensor": "gocator-2350", "baseline_mm": 90.0, "type": "laser-area"},
            ["scanner.type is 'laser-area', and gocator-2350 is a laser-line; omit type"],
        ),
        ({"sensor": 2350}, ["scanner.sensor is 2350; it must be text in quotes"]),
        ({"fan_deg": 30.0}, ["scanner.fan_deg is an unknown key of laser-area; did you mean 'fov_deg'? valid are: "]),
        (
            {"type": "laser-line", "fov_deg": [60.0, 60.0], "sweep_mn": 3.0, "fan_deg": 200.0},
            [
                "scanner.fov_deg is an unknown key of laser-line; did you mean 'fan_deg'? valid are: type, sensor,",
                "scanner.sweep_mn is an unknown key of laser-line; did you mean 'sweep_mm'?",
                "scanner.fan_deg is 200.0; it must be below 180",
            ],
        ),
        ({"type": "laser-line", "planning_resolution_deg": 1.0}, ["scanner.planning_resolution_deg is an unknown key"]),
        ({"type": "laser-line", "sweep_steps": 2.5}, ["scanner.sweep_steps is 2.5; it must be a whole number"]),
    ],
)
def test_all_problems_of_the_scanner_table_are_reported_at_once(scanner: dict, lines: list[str]) -> None:
    """A key of another type, a missing figure and a value out of range give one line each."""
    problems = _problems(**scanner)
    assert len(problems) == len(lines), problems
    for problem, start in zip(problems, lines, strict=True):
        assert problem.startswith(start), problem


def test_laser_area_has_no_keys_of_the_line_sensor() -> None:
    """The default table passes no key of the line sensor to the plug-in."""
    settings = settle(Scene(), load_part("mseke", None)).settings
    assert "fan_deg" not in settings.scanner
    assert "sweep_steps" not in settings.scanner
    assert settings.planning_scanner["resolution_deg"] == (1.0, 1.0)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("depth_mm = 400.0", "depth_mm = -400.0", "depth_mm is -400.0; it must be above 0"),
        ("depth_mm = 400.0", "depth_mm = true", "depth_mm is true"),
        ("depth_mm = 400.0", 'depth_mm = "400"', "depth_mm is '400'; it must be a number"),
        ("depth_mm = 400.0", "detph_mm = 400.0", "detph_mm is an unknown key"),
        ("depth_mm = 400.0", "baseline_mm = 3.0", "a source for each figure"),
        ("width_near_mm = 158.0", "width_near_mm = 365.0", "must be larger than width_near_mm"),
        ('maker = "LMI Technologies"', "", "maker is missing"),
        ("[figures]", "[figure]", r"figures is missing"),
        ("[figures]", "[figures", "cannot be read"),
    ],
)
def test_a_damaged_sensor_file_is_refused(tmp_path: Path, old: str, new: str, words: str) -> None:
    """The message has the file, the key and the rule."""
    from cell.files import model_file

    text = model_file("sensors/gocator-2350.toml").read_text(encoding="utf-8")
    assert old in text
    path = tmp_path / "gocator-2350.toml"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(FileError, match=words):
        sensors.read(path)


def test_a_sensor_file_does_not_name_itself(tmp_path: Path) -> None:
    """The name of the file is the name of the sensor."""
    from cell.files import model_file

    path = tmp_path / "own.toml"
    text = model_file("sensors/gocator-2350.toml").read_text(encoding="utf-8")
    path.write_text('name = "paper"\n' + text, encoding="utf-8")
    with pytest.raises(FileError, match="name is an unknown key"):
        sensors.read(path)


def test_a_stated_range_replaces_the_derived_one() -> None:
    """The fan still follows from the widths of the line."""
    widths = {"depth_mm": 80.0, "width_near_mm": 47.0, "width_far_mm": 85.0}

    def keys(**more: tuple[float, float]) -> dict[str, object]:
        figures = sensors.Figures.model_validate(widths | more)
        return dict(sensors.Sensor.model_construct(figures=figures).keys)

    stated = keys(range_mm=(200.0, 280.0))
    assert stated["range_mm"] == (200.0, 280.0)
    assert stated["fan_deg"] == keys()["fan_deg"]
    assert keys()["range_mm"] != stated["range_mm"]
