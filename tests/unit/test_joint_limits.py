"""Joint limits of a scene that replace those of the robot model."""

from pathlib import Path

import numpy as np
import pytest

from cell.errors import SceneError
from cell.robot import model as robot
from cell.scene.file import load_scene

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
