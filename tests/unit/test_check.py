"""`cell check`: numbers, contacts and problems of a scene."""

import json
from pathlib import Path

import pytest
import trimesh

from cell.scene.model import Scene
from cell.world.checks import check_scene


@pytest.fixture(scope="module")
def ball(tmp_path_factory: pytest.TempPathFactory) -> dict:
    """Return a part of 200 mm as the scene's [part] table."""
    path = tmp_path_factory.mktemp("part") / "ball.stl"
    trimesh.creation.icosphere(2, 100.0).export(path)
    return {"path": str(path), "units": "mm"}


def test_the_arm_s_envelope_is_the_data_sheet_s(ball: dict) -> None:
    """The reach to the wrist centre is KUKA's 1611 mm. The lowest and highest wrist respect the limits of A2 and A3."""
    envelope = check_scene(Scene.model_validate({"part": ball})).envelope
    assert envelope.wrist_reach_mm == pytest.approx(1610.9, abs=0.1)
    assert envelope.wrist_lowest_mm == pytest.approx(-385.9, abs=0.1)
    assert envelope.wrist_highest_mm == pytest.approx(2025.9, abs=0.1)
    assert envelope.wrist_to_source_mm == pytest.approx(158 + 120)


def test_a_table_is_an_obstacle_and_extends_the_reach(ball: dict) -> None:
    """The table is an obstacle with the range of E1."""
    place = {"placement": {"position_mm": [2600.0, 0.0, 0.0]}}
    assert check_scene(Scene.model_validate({"part": ball} | place)).problems
    table = {"position_mm": [2200.0, 0.0, -400.0], "limits_deg": [-90.0, 170.0], "swing_mm": 1200.0}
    result = check_scene(Scene.model_validate({"part": ball, "table": table} | place))
    assert result.problems == ()
    assert "rotary table" in result.obstacles
    assert result.joint_limits_deg["E1"] == (-90.0, 170.0)


def test_a_good_scene_has_no_problems(ball: dict) -> None:
    """The built-in cell with a ball has no problem and no contact at home. All its values serialise."""
    result = check_scene(Scene.model_validate({"part": ball}))
    assert (result.problems, result.contacts_at_home, result.exit_code) == ((), (), 0)
    assert result.placement_mm == (1200.0, 500.0, 0.0)
    assert result.part_size_mm == (200.0, 200.0, 200.0)
    assert result.housing_mm == (37.5, 0.0, 90.0)
    assert result.bracket_length_mm == pytest.approx(60.0)
    assert set(result.obstacles) == {"floor", "pedestal", "part", "post"}
    assert result.joint_limits_deg["A2"] == (-155.0, 35.0)
    assert result.nearest_at_home_mm > 100
    summary = json.loads(json.dumps(result.summary(), allow_nan=False))
    assert summary["ok"] is True
    assert all(isinstance(name, str) and isinstance(value, str) for name, value in result.rows())


def test_contacts_at_home_are_listed_and_not_raised(ball: dict) -> None:
    """A fixture inside the arm is reported with pair, depth and the key to change. The exit code is 2."""
    wall = {"name": "wall", "shape": "box", "size_mm": [50, 900, 900], "position_mm": [700, 0, 1300]}
    result = check_scene(Scene.model_validate({"part": ball, "fixtures": [wall]}))
    assert result.exit_code == 2
    pairs = {pair: distance for pair, distance in result.contacts_at_home}
    assert any(pair.endswith("with wall") and distance < 0 for pair, distance in pairs.items())
    assert len(result.problems) == 1
    assert "fixtures[0].position_mm" in result.problems[0]
    assert result.summary()["contacts_at_home"][0].keys() == {"pair", "distance_mm"}


def test_the_floor_has_no_end(ball: dict) -> None:
    """A fixture far away is as high above the floor as one in the cell; a floor at 0 has no sign."""
    crate = {"name": "crate", "shape": "box", "size_mm": [100, 100, 100], "position_mm": [50_000, 0, 550]}
    (warning,) = check_scene(Scene.model_validate({"part": ball, "fixtures": [crate]})).warnings
    assert "it is 1100.0 mm above the floor; move fixtures[0].position_mm by (0, 0, -1100) mm" in warning
    (problem, *_) = check_scene(Scene.model_validate({"part": ball, "robot": {"pedestal_height_mm": 0}})).problems
    assert "which is at z = 0 mm" in problem


@pytest.mark.parametrize(
    ("x", "is_outside"), [(2200, False), (2400, False), (2430, False), (2450, True), (9000, True)]
)  # 1610.9 + 278 + the far end of the range, 450, + the ball's radius of 100 = 2438.9
def test_a_part_out_of_reach_is_a_problem(ball: dict, x: float, is_outside: bool) -> None:
    """A part beyond arm, tool and range is reported as out of reach; at 2400 mm a plan measures a tenth of it."""
    result = check_scene(Scene.model_validate({"part": ball, "placement": {"position_mm": [x, 0, 500]}}))
    assert any("out of reach" in problem for problem in result.problems) == is_outside


def test_a_missing_mesh_of_a_fixture_is_an_error_of_the_file(tmp_path: Path) -> None:
    """A missing mesh of a fixture is refused with its key when the scene is read."""
    from cell.errors import SceneError
    from cell.scene.file import load_scene

    path = tmp_path / "scene.toml"
    path.write_text("[[fixtures]]\nname='vice'\nshape='mesh'\npath='vice.stl'\nunits='mm'\n")
    with pytest.raises(SceneError, match=r"fixtures\[0\]\.path is 'vice.stl'"):
        load_scene(path)
