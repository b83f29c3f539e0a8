"""The meshes of a robot file are found and recorded in a run, so that a change is detected."""

from pathlib import Path

import pytest

from cell.errors import FileError
from cell.plan.files import named_files
from cell.robot.robot_file import mesh_files
from cell.scene.file import load_scene

URDF = """<robot name="r"><link name="a">
  <visual><geometry><mesh filename="seen.stl"/></geometry></visual>
  <collision><geometry><mesh filename="package://acme/meshes/a.stl"/></geometry></collision>
  <collision><geometry><mesh filename="b.stl"/></geometry></collision>
  <collision><geometry><mesh filename="b.stl"/></geometry></collision>
</link></robot>"""
MJCF = """<mujoco><compiler meshdir="parts"/><asset><mesh name="m" file="c.stl"/><mesh name="v" vertex="0 0 0"/>
</asset></mujoco>"""


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    """Return a robot file with two collision meshes, one of them in a package."""
    for name in ("acme/meshes/a.stl", "here/b.stl", "here/parts/c.stl"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(name.encode())
    path = tmp_path / "here" / "r.urdf"
    path.write_text(URDF)
    return path


def test_collision_meshes_are_found_once_each(urdf: Path, tmp_path: Path) -> None:
    """Visual meshes are skipped, the mesh folder of an MJCF is used, and a missing mesh is an error."""
    assert mesh_files(urdf, {"acme": tmp_path / "acme"}) == [tmp_path / "acme/meshes/a.stl", tmp_path / "here/b.stl"]
    mjcf = urdf.with_name("r.xml")
    mjcf.write_text(MJCF)
    assert mesh_files(mjcf, {}) == [tmp_path / "here/parts/c.stl"]
    (tmp_path / "here/b.stl").unlink()
    with pytest.raises(FileError, match="does not exist"):
        mesh_files(urdf, {})


@pytest.mark.parametrize(
    ("compiler", "file"),
    [
        ('<compiler assetdir="parts"/>', "c.stl"),
        ('<compiler angle="radian"/><compiler meshdir="parts"/>', "c.stl"),
        ('<compiler meshdir="parts" strippath="true"/>', "elsewhere/c.stl"),
        ("", "parts/c.stl"),
    ],
)
def test_meshes_and_included_files_of_an_mjcf_are_found(urdf: Path, compiler: str, file: str) -> None:
    """The files are those that MuJoCo reads."""
    arm, scene = urdf.with_name("arm.xml"), urdf.with_name("scene.xml")
    arm.write_text(f'<mujoco>{compiler}<asset><mesh name="m" file="{file}"/></asset></mujoco>')
    scene.write_text('<mujoco><include file="arm.xml"/></mujoco>')
    assert mesh_files(arm, {}) == [urdf.with_name("parts") / "c.stl"]
    assert mesh_files(scene, {}) == [arm, urdf.with_name("parts") / "c.stl"]


def test_a_run_records_the_hashes_of_the_meshes(urdf: Path) -> None:
    """A changed mesh has another hash, which a scan compares. The built-in robot has no meshes."""
    scene = load_scene(None, {"robot": {"model": str(urdf)}})
    before = named_files(scene, None)
    assert [each.role for each in before] == ["robot"] * 3
    urdf.with_name("b.stl").write_bytes(b"another")
    after = named_files(scene, None)
    assert [a.sha256 == b.sha256 for a, b in zip(before, after, strict=True)] == [True, True, False]
    assert named_files(load_scene(None, {}), None) == ()
