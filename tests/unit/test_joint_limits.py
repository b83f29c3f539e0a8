"""Joint limits of a scene that replace those of the robot model."""

from pathlib import Path

import numpy as np
import pytest

from cell.errors import SceneError
from cell.robot import model as robot
from cell.scene.file import load_scene
from cell.scene.model import Scene
from cell.world.checks import find_problems
from cell.world.model import compile_world

CUBE = np.array([[x, y, z] for x in (-0.03, 0.03) for y in (-0.03, 0.03) for z in (-0.03, 0.03)])
MODEL = robot.limits(robot.load())


def test_omitted_limits_follow_the_given_ones() -> None:
    """Half the speed halves acceleration and jerk, and half the acceleration halves the jerk."""
    slow = robot.override_limits(MODEL, np.degrees(MODEL.velocity) / 2)
    np.testing.assert_allclose(slow.acceleration, MODEL.acceleration / 2)
    np.testing.assert_allclose(slow.jerk, MODEL.jerk / 2)
    soft = robot.override_limits(MODEL, acceleration_deg_s2=np.degrees(MODEL.acceleration) / 2)
    np.testing.assert_array_equal(soft.velocity, MODEL.velocity)
    np.testing.assert_allclose(soft.jerk, MODEL.jerk / 2)
    assert np.isinf(robot.override_limits(MODEL, jerk_deg_s3=[np.inf] * 6).jerk).all()


def test_a_scene_gives_limits(tmp_path: Path) -> None:
    """A scene gives six limits of each kind; a jerk may be infinite."""
    path = tmp_path / "scene.toml"
    path.write_text("[robot]\nvelocity_deg_s = [100, 100, 100, 200, 200, 300]\njerk_deg_s3 = [inf, 1, 1, 1, 1, 1]\n")
    scene = load_scene(path)
    assert scene.robot.velocity_deg_s == (100, 100, 100, 200, 200, 300)
    assert scene.robot.jerk_deg_s3 is not None
    assert scene.robot.jerk_deg_s3[0] == np.inf


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("velocity_deg_s = [0, 100, 100, 200, 200, 300]", r"robot.velocity_deg_s\[0\] is 0"),
        ("acceleration_deg_s2 = [inf, 1, 1, 1, 1, 1]", r"robot.acceleration_deg_s2\[0\] is inf"),
        ("jerk_deg_s3 = [nan, 1, 1, 1, 1, 1]", r"robot.jerk_deg_s3\[0\] is nan"),
        ("jerk_deg_s3 = [-1, 1, 1, 1, 1, 1]", r"robot.jerk_deg_s3\[0\] is -1"),
        ("velocity_deg_s = [100, 100]", "robot.velocity_deg_s"),
    ],
)
def test_invalid_limits_are_refused_by_key(line: str, words: str, tmp_path: Path) -> None:
    """Zero, negative, missing and NaN values and an infinite acceleration are refused with their key."""
    path = tmp_path / "scene.toml"
    path.write_text(f"[robot]\n{line}\n")
    with pytest.raises(SceneError, match=words):
        load_scene(path)


@pytest.mark.parametrize(
    ("settings", "sentences"),
    [
        ({"velocity_deg_s": (156.0, 157.0, 156.0, 330.0, 330.0, 615.0)}, ["157 for A2, above the 156 deg/s"]),
        ({"velocity_deg_s": (156.0, 156.0, 0.01, 330.0, 330.0, 615.0)}, ["A3 takes 5.73e+03 s for 1 rad"]),
        (
            {"speed_scaling": 1e-7},
            ["A1 takes 3.67e+06 s for 1 rad, and the limit is 1000 s; raise robot.speed_scaling"],
        ),
        ({"acceleration_scaling": 1e-9}, ["s for 1 rad"]),
        ({"speed_scaling": 0.001}, []),
    ],
)
def test_speeds_that_no_controller_drives_are_problems(settings: dict[str, object], sentences: list[str]) -> None:
    """An axis is at most as fast as the robot, and its motion has no billions of samples."""
    problems = find_problems(compile_world(Scene.model_validate({"robot": settings}), CUBE))
    assert len(problems) == len(sentences)
    assert all(words in problem for words, problem in zip(sentences, problems, strict=True))
