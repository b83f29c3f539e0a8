"""The scene file: defaults, all problems in one report, hints, overrides."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from pydantic import BaseModel, TypeAdapter, ValidationError

from cell.errors import SceneError, UsageError
from cell.files import model_file
from cell.scene.features import CharacteristicTable, FeatureTable
from cell.scene.file import load_scene, scene_from_options
from cell.scene.model import BoxFixture, CylinderFixture, MeshFixture, PlanSettings, Region, Scene, Setup, pose
from cell.scene.settle import with_device


def _load(tmp_path: Path, text: str, **options: dict) -> Scene:
    path = tmp_path / "scene.toml"
    path.write_text(text, encoding="utf-8")
    return load_scene(path, options)


def _problems(tmp_path: Path, text: str, **options: dict) -> list[str]:
    with pytest.raises(SceneError) as caught:
        _load(tmp_path, text, **options)
    first, *lines = str(caught.value).splitlines()
    assert first.endswith(("problem:", "problems:"))
    return [line.strip() for line in lines]


def test_the_documented_scene_is_the_built_in_one() -> None:
    """models/scene.toml states every default correctly."""
    assert load_scene(model_file("scene.toml")) == Scene() == load_scene(None)


def test_the_documented_scene_names_every_key_with_its_default() -> None:
    """Each key of each table is in models/scene.toml: set, or commented out with its default."""
    text = model_file("scene.toml").read_text(encoding="utf-8")
    sections = re.split(r"^(?:# )?\[\[?(\w+)\]", text, flags=re.MULTILINE)
    documented: dict[str, str] = {"": sections[0]}
    for name, section in zip(sections[1::2], sections[2::2], strict=True):
        documented[name] = documented.get(name, "") + section
    tables = {name: [type(table)] for name, table in Scene() if isinstance(table, BaseModel)}
    tables |= {
        "": [Scene],
        "fixtures": [BoxFixture, CylinderFixture, MeshFixture],
        "region": [Region],
        "setup": [Setup],
        "feature": [FeatureTable, CharacteristicTable],
    }
    for name, classes in tables.items():
        lines = [line.lstrip("# ") for line in documented[name].splitlines()]
        for key, field in ((key, field) for table in classes for key, field in table.model_fields.items()):
            if key in tables:
                continue
            line = next((line for line in lines if line.startswith(f"{key} =")), None)
            assert line is not None, f"{name}.{key}"
            if field.default is not None and name not in ("fixtures", "region", "setup", "feature"):
                stated = tomllib.loads(line)[key]
                assert TypeAdapter(field.annotation).validate_python(stated) == field.default, f"{name}.{key}"


def test_all_problems_are_reported_at_once(tmp_path: Path) -> None:
    """A file with a dozen mistakes gives a dozen lines, each with its key and the valid values."""
    problems = _problems(
        tmp_path,
        """
        clearence_mm = 3
        [robot]
        home_deg = [1, 2, 3]
        pedestal_height_mm = "600"
        speed_scaling = 1.5
        [scanner]
        type = "laser-aera"
        range_mm = [450, 150]
        [part]
        path = "nowhere.stl"
        [[fixtures]]
        shape = "box"
        name = "table"
        size_mm = [1, 2]
        [[fixtures]]
        shape = "cylinder"
        name = "floor"
        size_mm = [1, true]
        atached_to = "base"
        [[fixtures]]
        shape = "sphere"
        [plan]
        fill = "aimd"
        seed = 1.5
        faces = 10
        percent_kept = 10.0
        rolls_deg = []
        [placement]
        position_mm = [1.0, nan, 3.0]
        """,
    )
    expected = [
        ("clearence_mm is an unknown key", "did you mean 'clearance_mm'"),
        ("robot.home_deg has 3 values", "must have 6"),
        ("robot.pedestal_height_mm is '600'", "a number"),
        ("robot.speed_scaling is 1.5", "at most 1"),
        ("scanner.type is 'laser-aera'", "did you mean 'laser-area'"),
        ("scanner.range_mm is [450.0, 150.0]", "min < max"),
        ("part.path is 'nowhere.stl'", "relative to the scene file"),
        ("part.units is missing", "mm, cm, m"),
        ("fixtures[0].size_mm has 2 values", "must have 3"),
        ("fixtures[1].name is 'floor'", "choose another"),
        ("fixtures[1].size_mm[1] is true", "a number"),
        ("fixtures[1].atached_to is an unknown key", "did you mean 'attached_to'"),
        ("fixtures[2].shape is 'sphere'", "box, cylinder, mesh"),
        ("plan.fill is 'aimd'", "did you mean 'aimed'? valid are: aimed, rays"),
        ("plan.seed is 1.5", "a whole number"),
        ("plan.percent_kept and plan.faces", "one of them"),
        ("plan.rolls_deg has 0 values", "at least 1"),
        ("placement.position_mm[1] is nan", "finite"),
    ]
    for start, cure in expected:
        assert [p for p in problems if p.startswith(start) and cure in p], (start, cure, problems)
    assert len(problems) == len(expected), problems


@pytest.mark.parametrize(
    ("text", "start"),
    [
        ("robot = 3", "robot is 3; it must be a table"),
        ("fixtures = 3", "fixtures is 3; it must be a list"),
        ("fixtures = [3]", "fixtures[0] is 3; it must be a table"),
        ("[[fixtures]]\nname = 'a'", "fixtures[0].shape is missing"),
        ("[scanner]\nfov_deg = [60, 180]", "scanner.fov_deg[1] is 180; it must be below 180"),
        ("[scanner]\nfov_deg = [60, 60, 60]", "scanner.fov_deg has 3 values; it must have 2"),
        ("[post]\nenabled = 1", "post.enabled is 1; it must be true or false"),
        ("[part]\nunits = 'mm'", "part.units is given for a built-in part"),
        ("clearance_mm = -1", "clearance_mm is -1; it must be at least 0"),
        ("clearance_mm = inf", "clearance_mm is inf; it must be a finite number"),
        ("clearance_mm = true", "clearance_mm is true; it must be a number"),
        ("[plan]\neffort = 'lots'", "plan.effort is 'lots'; it must be low, normal, high, or a number of poses"),
        ("[[region]]\nname = 'a'\ncolour = 'red'", "region[0].colour is 'red'; it must be a colour as '#rrggbb'"),
        (
            "[[feature]]\nname = 'a'\nfaces = [1]\ndatum = 'b'",
            "feature[0].datum is 'b'; it must be one or two capital letters",
        ),
    ],
)
def test_a_wrong_value_is_named_with_the_valid_ones(tmp_path: Path, text: str, start: str) -> None:
    """Every kind of mistake has a separate message."""
    (problem,) = _problems(tmp_path, text)
    assert problem.startswith(start)


def test_set_ups_differ_in_name_and_content(tmp_path: Path) -> None:
    """A repeated name, equal set-ups and a repeated fixture have a sentence each."""
    one, other = (f"[[setup]]\nname = '{name}'\nposition_mm = [1, 2, 3]\n" for name in "ab")
    box = "[[setup.fixtures]]\nname = 'vice'\nshape = 'box'\nsize_mm = [1, 1, 1]\n"
    cases = {
        one + one: "setup has the name 'a' more than once; each set-up needs its own",
        one + other: "setup 'a' and 'b' are equal; omit one of them",
        one + box + box: "setup 'a' has the fixture 'vice' more than once; each needs its own name",
    }
    assert {text: _problems(tmp_path, text) for text in cases} == {text: [each] for text, each in cases.items()}


def test_fixtures_need_distinct_names(tmp_path: Path) -> None:
    """Two fixtures of one name could not be distinguished in a report."""
    one = "[[fixtures]]\nshape='box'\nname='a'\nsize_mm=[1,1,1]\n"
    (problem,) = _problems(tmp_path, one + one)
    assert problem.startswith("fixtures hold the name 'a' more than once")


@pytest.mark.parametrize(
    ("content", "words"), [(b"a = = 2\n", "line 1"), (b"\xff\xfe", "UTF-8"), (None, "No such file")]
)
def test_a_file_that_is_no_toml_has_one_message(tmp_path: Path, content: bytes | None, words: str) -> None:
    """Syntax errors name the line; encodings and missing files are named."""
    path = tmp_path / "scene.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(SceneError, match=words) as caught:
        load_scene(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_part_and_a_scene_in_each_others_place_are_named(tmp_path: Path) -> None:
    """`cell check part.stl` and `cell plan my_cell.toml` are refused with the right place of the file."""
    with pytest.raises(SceneError, match="is a part, not a scene"):
        load_scene(tmp_path / "part.STL")
    with pytest.raises(UsageError, match=r"is a scene file, not a part; give it with --scene"):
        scene_from_options(None, {}, str(tmp_path / "my_cell.toml"))


def test_options_take_precedence_over_the_file(tmp_path: Path) -> None:
    """Options replace keys of the file, a part as a whole, and keep the others."""
    mesh = tmp_path / "part.stl"
    mesh.touch()
    text = "[part]\npath = 'part.stl'\nunits = 'mm'\n[plan]\nseed = 3\ncoverage = 0.5"
    scene = _load(tmp_path, text, part={"name": "mug"}, plan={"seed": 4}, placement={})
    assert (scene.part.source, scene.part.units) == ("mug", None)
    assert (scene.plan.seed, scene.plan.coverage) == (4, 0.5)
    assert _load(tmp_path, text).part.source == str(mesh)
    assert _load(tmp_path, text, part={"units": "in"}).part.units == "in"
    assert _problems(tmp_path, text, plan={"seed": -1}) == ["plan.seed is -1; it must be at least 0"]


def test_paths_are_relative_to_the_scene_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A scene is the same from every working folder."""
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "vice.stl").touch()
    monkeypatch.chdir("/")
    scene = _load(tmp_path, "[[fixtures]]\nshape='mesh'\nname='vice'\npath='parts/vice.stl'\nunits='mm'")
    assert scene.fixtures[0].path == str(tmp_path / "parts" / "vice.stl")


def test_a_scene_cannot_be_changed() -> None:
    """A scene is a value."""
    with pytest.raises(ValidationError):
        Scene().plan.seed = 1
    with pytest.raises(ValidationError):
        PlanSettings(seed=True)


def test_a_pose_is_millimetres_and_kuka_abc() -> None:
    """x, y, z in mm, then Rz(A) Ry(B) Rx(C): A = 90 turns x to y."""
    T = pose((1000.0, 0.0, -500.0), (90.0, 0.0, 0.0))
    np.testing.assert_allclose(T @ [1, 0, 0, 1], [1.0, 1.0, -0.5, 1.0], atol=1e-15)


def test_the_housing_follows_the_baseline() -> None:
    """By default the box is centred over the baseline with its front face in the source's plane."""
    T = with_device(Scene(), "mseke", 220.0).housing.T_scanner_housing(75.0)
    np.testing.assert_allclose(T[:3, 3], [0.0375, 0.0, -0.03], atol=1e-15)
