"""The mount as matrix or quaternion, and the placement by the file's origin: equal cells."""

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cell.errors import SceneError
from cell.part import workpiece
from cell.scene.file import load_scene, scene_from_options
from cell.scene.settle import settle_scene
from cell.world.model import compile_world
from planner.kinematics.frames import pose_from_kuka_abc

POSITION, ABC = (12.0, -7.5, 131.0), (31.0, -12.0, 95.0)
T_MOUNT = pose_from_kuka_abc(np.array(POSITION) / 1000, np.radians(ABC))
W = Rotation.from_matrix(T_MOUNT[:3, :3]).as_quat()[[3, 0, 1, 2]]


def _scene(tmp_path: Path, text: str) -> Any:
    path = tmp_path / "scene.toml"
    path.write_text(text)
    return load_scene(path)


def _rows(digits: int) -> str:
    T = T_MOUNT.copy()
    T[:3, 3] *= 1000
    return str(T.round(digits).tolist())


@pytest.mark.parametrize(
    ("text", "near"),
    [
        (f"position_mm = {list(POSITION)}\nquaternion = {W.tolist()}", 1e-12),
        (f"position_mm = {list(POSITION)}\nquaternion = {(-W).tolist()}", 1e-12),
        (f"matrix_mm = {_rows(17)}", 1e-12),
        (f"matrix_mm = {_rows(4)}", 1e-4),
    ],
    ids=["quaternion", "its opposite", "matrix", "a matrix of four decimals"],
)
def test_equivalent_mounts(text: str, near: float, tmp_path: Path) -> None:
    """Matrix and quaternion give the transform of position and ABC, and a rounded rotation is made exact."""
    T = _scene(tmp_path, f"[mount]\n{text}").mount.T
    np.testing.assert_allclose(T, T_MOUNT, atol=near)
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("quaternion = [1.0, 0.0, 0.0, 0.1]", "mount.quaternion has the length 1.005"),
        ("quaternion = [1.0, 0.0, 0.0]", "mount.quaternion has 3 values"),
        ("quaternion = [1.0, 0.0, 0.0, 0.0]\nabc_deg = [0.0, 0.0, 0.0]", "quaternion is given together with abc_deg"),
        (f"matrix_mm = {_rows(9)}\nposition_mm = [0.0, 0.0, 1.0]", "matrix_mm is given together with position_mm"),
        ("matrix_mm = [[1.0,0,0,0],[0.0,1,0,0],[0.0,0,-1,0],[0.0,0,0,1]]", "matrix_mm"),
        ("matrix_mm = [[2.0,0.0,0.0,0.0],[0.0,1.0,0.0,0.0],[0.0,0.0,1.0,0.0],[0.0,0.0,0.0,1.0]]", "holds no rotation"),
        ("matrix_mm = [[1.0,0.0,0.0,0.0],[0.0,1.0,0.0,0.0],[0.0,0.0,1.0,0.0],[0.0,5.0,0.0,1.0]]", "last row"),
    ],
)
def test_invalid_mounts(text: str, message: str, tmp_path: Path) -> None:
    """The message has the key and the rule."""
    with pytest.raises(SceneError, match=message):
        _scene(tmp_path, f"[mount]\n{text}")


def test_the_built_in_scene_file_shows_both_forms() -> None:
    """The commented lines of models/scene.toml are the default mount."""
    lines = (Path(__file__).parents[2] / "models" / "scene.toml").read_text().splitlines()
    toml_lines = [
        line.lstrip("# ").partition(" #")[0] for line in lines if line.startswith(("# quaternion", "# matrix_mm"))
    ]
    output = tomllib.loads("\n".join(toml_lines))
    assert output["quaternion"] == [1.0, 0.0, 0.0, 0.0]
    assert output["matrix_mm"][2] == [0.0, 0.0, 1.0, 120.0]


def test_a_placement_by_the_origin_is_one_by_the_centre(tmp_path: Path) -> None:
    """The file's origin has the given pose, and the cell is that of the equivalent centre."""
    part = workpiece.load("mug")
    by_origin = _scene(
        tmp_path, "[part]\nname='mug'\n[placement]\norigin_mm=[1100.0,300.0,50.0]\nabc_deg=[20.0,0.0,5.0]"
    )
    world = compile_world(by_origin, part.reference.vertices)
    expected = pose_from_kuka_abc(np.array([1.1, 0.3, 0.05]), np.radians([20.0, 0.0, 5.0]))
    np.testing.assert_allclose(world.T_base_object, expected, atol=1e-11)
    settled = settle_scene(by_origin, part)
    assert settled.placement.origin_mm is None
    np.testing.assert_allclose(settled.placement.T, expected @ part.T_object_centre, atol=1e-11)
    assert settle_scene(settled, part) == settled


def test_options_replace_the_files_placement(tmp_path: Path) -> None:
    """--place replaces the file's origin, --place-origin its centre; a file with both is refused."""
    path = tmp_path / "scene.toml"
    path.write_text("[placement]\norigin_mm = [1.0, 2.0, 3.0]\nabc_deg = [9.0, 0.0, 0.0]")
    placed = scene_from_options(path, {"place": "1200,500,0"}).placement
    assert (placed.position_mm, placed.origin_mm, placed.abc_deg) == ((1200, 500, 0), None, (9, 0, 0))
    path.write_text("[placement]\nposition_mm = [1.0, 2.0, 3.0]")
    placed = scene_from_options(path, {"place_origin": "1200,500,-80,90,0,0"}).placement
    assert (placed.origin_mm, placed.abc_deg) == ((1200, 500, -80), (90, 0, 0))
    path.write_text("[placement]\nposition_mm = [1.0, 2.0, 3.0]\norigin_mm = [1.0, 2.0, 3.0]")
    with pytest.raises(SceneError, match="origin_mm is given together with position_mm"):
        load_scene(path)
