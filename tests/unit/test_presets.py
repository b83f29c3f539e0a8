"""Presets: what they fill in, what goes before them, and that `balanced` is the defaults."""

from pathlib import Path
from typing import Any, get_args

import pytest

from cell.errors import SceneError
from cell.part import workpiece
from cell.part.workpiece import Workpiece
from cell.scene.plan_settings import PlanSettings
from cell.scene.presets import DEFAULT, PRESETS, beneath, line
from cell.scene.resolve import resolve
from cell.scene.scene import Scene, load_scene


@pytest.fixture(scope="module")
def mug() -> Workpiece:
    """A built-in part with its own defaults."""
    return workpiece.load("mug", None)


def _scene(preset: str, tmp_path: Path, text: str = "", **options: dict[str, Any]) -> Scene:
    path = tmp_path / "scene.toml"
    path.write_text(text, encoding="utf-8")
    return load_scene(path, {**options, "plan": {"preset": preset, **options.get("plan", {})}})


def test_the_scene_knows_the_same_names() -> None:
    """The key's values are the table's."""
    assert get_args(PlanSettings.model_fields["preset"].annotation) == tuple(PRESETS)
    assert PlanSettings.model_fields["preset"].default == DEFAULT


def test_balanced_is_the_defaults(tmp_path: Path) -> None:
    """It fills in nothing and multiplies by one."""
    assert _scene("balanced", tmp_path) == Scene()
    content = {"plan": {"preset": "balanced", "seed": 3}, "placement": {}}
    assert beneath(content) == content
    assert PRESETS["balanced"].faces_factor == 1.0


@pytest.mark.parametrize("name", [name for name in PRESETS if name != DEFAULT])
def test_a_preset_fills_in_what_nobody_gives(name: str, tmp_path: Path, mug: Workpiece) -> None:
    """Each of its keys arrives, is another value than the default, and nothing else changes."""
    preset, scene = PRESETS[name], _scene(name, tmp_path)
    for table, keys in (("plan", preset.plan), ("scanner", preset.scanner)):
        got, usual = getattr(scene, table).model_dump(mode="json"), getattr(Scene(), table).model_dump(mode="json")
        assert keys
        for key, value in keys.items():
            assert got[key] == value != usual[key], key
        assert {key for key in got if got[key] != usual[key]} - {"preset"} == set(keys)
    assert resolve(scene, mug).faces == round(preset.faces_factor * resolve(Scene(), mug).faces)


@pytest.mark.parametrize("name", list(PRESETS))
def test_scene_file_and_options_go_before_a_preset(name: str, tmp_path: Path, mug: Workpiece) -> None:
    """Even where they say the default."""
    text = "[scanner]\nresolution_deg = [0.25, 0.25]\n[plan]\nfaces = 200\n"
    scene = _scene(name, tmp_path, text, plan={"samples_per_face": 4})
    assert scene.scanner.resolution_deg == (0.25, 0.25)
    assert scene.plan.samples_per_face == 4
    assert resolve(scene, mug).faces == 200


def test_the_option_goes_before_the_file(tmp_path: Path) -> None:
    """A scene file may name a preset of its own."""
    text = "[plan]\npreset = 'fast'\n"
    assert _scene("accurate", tmp_path, text).plan.samples_per_face == PRESETS["accurate"].plan["samples_per_face"]
    path = tmp_path / "scene.toml"
    assert load_scene(path).plan.samples_per_face == PRESETS["fast"].plan["samples_per_face"]


@pytest.mark.parametrize("scanner", [{"sensor": "gocator-2350", "baseline_mm": 100.0}, {"type": "laser-line"}])
def test_a_scanner_without_a_ray_grid_keeps_its_own_numbers(scanner: dict[str, Any], tmp_path: Path) -> None:
    """What a real sensor resolves is no choice, and a line has no angle between rays."""
    for name in PRESETS:
        assert _scene(name, tmp_path, scanner=scanner).scanner == _scene(DEFAULT, tmp_path, scanner=scanner).scanner


@pytest.mark.parametrize("bad", ["quick", "", 3, None, ["fast"]])
def test_an_unknown_preset_is_refused_with_the_names_of_all(bad: object, tmp_path: Path) -> None:
    """One problem, whatever it is."""
    with pytest.raises(SceneError, match=r"1 problem") as caught:
        load_scene(None, {"plan": {"preset": bad}})
    assert "plan.preset is" in str(caught.value)


def test_tables_that_are_none_are_left_to_the_scene(tmp_path: Path) -> None:
    """A preset does not hide that the file is wrong."""
    path = tmp_path / "scene.toml"
    path.write_text("plan = 3\n", encoding="utf-8")
    with pytest.raises(SceneError, match="plan"):
        load_scene(path)


def test_each_preset_has_a_price_and_the_help_says_all() -> None:
    """One line; the page has the same prices."""
    page = (Path(__file__).parents[2] / "docs" / "speed_accuracy.md").read_text(encoding="utf-8")
    assert all(f"`{name}`" in page and preset.price in page for name, preset in PRESETS.items())
    assert all(preset.price and "\n" not in preset.price and preset.price in line() for preset in PRESETS.values())
