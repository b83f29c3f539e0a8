"""Robot files as programs write them: encodings, mesh formats, links without mass, and numbers that no arm has."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

from cell.errors import CellError
from cell.robot.normalise import normalise
from cell.robot.robot_file import RobotFile, read_robot

JOINTS = (
    ((0, 0, 0.2), (0, 0, 1)),
    ((0.15, 0, 0.2), (0, 1, 0)),
    ((0, 0, 0.6), (0, 1, 0)),
    ((0.3, 0, 0.1), (1, 0, 0)),
    ((0.3, 0, 0), (0, 1, 0)),
    ((0.1, 0, 0), (1, 0, 0)),
)
LIMIT = '<limit lower="-2.5" upper="2.5" velocity="3" effort="0"/>'
BOX = '<collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision>'
MESH = '<collision><geometry><mesh filename="{}"/></geometry></collision>'


def urdf(*, link_2: str = BOX, link_5: str = BOX, limit: str = LIMIT, comment: str = "", extra: str = "") -> str:
    """Return an arm of boxes; arguments replace the content of two links and the limits of all joints."""
    shapes = {2: link_2, 5: link_5}
    text = f'<robot name="arm" xmlns:x="http://www.ros.org">{comment}<link name="base_link">{BOX}</link>'
    for number, (origin, axis) in enumerate(JOINTS, 1):
        parent = "base_link" if number == 1 else f"link_{number - 1}"
        text += (
            f'<link name="link_{number}">{shapes.get(number, BOX)}</link><joint name="j{number}" type="revolute">'
            f'<parent link="{parent}"/><child link="link_{number}"/><origin xyz="{" ".join(map(str, origin))}"/>'
            f'<axis xyz="{" ".join(map(str, axis))}"/>{limit}</joint>'
        )
    tool = '<link name="tool0"/><joint name="t" type="fixed"><parent link="link_6"/><child link="tool0"/></joint>'
    return text + tool + extra + "</robot>"


def read(folder: Path, text: str | bytes) -> RobotFile:
    """Return the arm of a URDF, which MuJoCo also accepts after the conversion."""
    path = folder / "arm.urdf"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    file = read_robot(path)
    normalise(file).compile()
    return file


@pytest.mark.parametrize("encoding", ["ISO-8859-1", "UTF-16", "utf-8-sig"])
def test_the_declared_encoding_is_used(tmp_path: Path, encoding: str) -> None:
    """An umlaut in a comment is legal in any declared encoding."""
    declaration = "" if encoding == "utf-8-sig" else f'<?xml version="1.0" encoding="{encoding}"?>'
    file = read(tmp_path, (declaration + urdf(comment="<!-- Größe -->")).encode(encoding))
    assert file.joints == tuple(f"j{k}" for k in range(1, 7))


@pytest.mark.parametrize(("suffix", "kind"), [(".stl", "stl"), (".stl", "stl_ascii"), (".ply", "ply"), (".off", "off")])
def test_meshes_of_every_format_give_the_same_shape(tmp_path: Path, suffix: str, kind: str) -> None:
    """The corners of a box are those of its file."""
    box = trimesh.creation.box(extents=(0.12, 0.14, 0.5))
    content = box.export(file_type=kind)
    (tmp_path / f"link{suffix}").write_bytes(content.encode() if isinstance(content, str) else content)
    model = read(tmp_path, urdf(link_2=MESH.format(f"link{suffix}"))).model
    corners = model.mesh_vert[: model.mesh_vertnum[0]]
    assert np.sort(np.ptp(corners, axis=0)) == pytest.approx([0.12, 0.14, 0.5], abs=1e-6)


def test_a_mesh_with_more_triangles_than_mujoco_reads_from_stl(tmp_path: Path) -> None:
    """More than 200,000 triangles are read."""
    rod = trimesh.creation.cylinder(0.1, 0.1, sections=13)
    for _ in range(6):  # with few corners: MuJoCo computes the hull
        rod = rod.subdivide()
    rod.export(tmp_path / "rod.stl")
    assert read(tmp_path, urdf(link_2=MESH.format("rod.stl"))).model.mesh_facenum[0] > 200_000


def test_links_without_shape_or_mass_are_accepted(tmp_path: Path) -> None:
    """Kinematics needs neither mass nor inertia, and a link may have no shape."""
    zero = '<inertial><mass value="0"/><inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial>'
    for content in (
        "",
        zero,
        '<inertial><mass value="5"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial>',
    ):
        assert isinstance(read(tmp_path, urdf(link_5=content)).model, mujoco.MjModel)


def test_a_mimic_joint_needs_no_limits(tmp_path: Path) -> None:
    """Its range follows from its driving joint."""
    extra = (
        f'<link name="rod">{BOX}</link><joint name="m" type="revolute"><parent link="link_2"/><child link="rod"/>'
        '<axis xyz="0 1 0"/><mimic joint="j3" multiplier="-1"/></joint>'
    )
    assert [mimic.joint for mimic in read(tmp_path, urdf(extra=extra)).mimic_joints] == ["m"]


def test_soft_limits_are_used_and_reported(tmp_path: Path) -> None:
    """The range is the intersection of hard and soft limits."""
    soft = '<safety_controller soft_lower_limit="-1" soft_upper_limit="9" k_velocity="1"/>'
    file = read(tmp_path, urdf(limit=LIMIT + soft))
    assert (file.lower[0], file.upper[0]) == pytest.approx((-1, 2.5))
    assert "soft limits" in file.warnings[0]


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"limit": LIMIT.replace("2.5", "166.2")}, "53 turns; limits are in radians"),
        ({"limit": LIMIT.replace('velocity="3"', 'velocity="156"')}, "156 rad/s; .*deg/s"),
        (
            {"limit": LIMIT.replace("2.5", "2,5")},
            "lower of <limit> is '-2,5', which is not a number; write a decimal point",
        ),
        ({"limit": LIMIT.replace("-2.5", "${-pi}")}, r"xacro expression '\$\{-pi\}'"),
        ({"link_2": BOX.replace("0.1 0.1 0.1", "0.1 0.1 500")}, "500 m wide.*millimetres"),
        ({"link_2": BOX.replace("0.1 0.1 0.1", "0,1 0.1 0.1")}, "size of <box> is '0,1'"),
        ({"link_2": MESH.format("$(find arm)/a.stl")}, r"xacro expression '\$\(find arm\)"),
    ],
)
def test_numbers_that_no_arm_has_are_refused(tmp_path: Path, options: dict[str, str], sentence: str) -> None:
    """The sentence names the number and the probable cause."""
    with pytest.raises(CellError, match=sentence):
        read(tmp_path, urdf(**options))


@pytest.mark.parametrize(
    ("original", "written", "sentence"),
    [
        ('<link name="link_2">', '<link name="link_1">', "two links named 'link_1'"),
        ('name="j2"', 'name="j1"', "two joints named 'j1'"),
        ('type="revolute"', 'type="Revolute"', "'j1' has the type 'Revolute'; supported are revolute"),
        ('<child link="link_3"/>', '<child link="link_9"/>', "'j3' has the child 'link_9', which is none of the links"),
        ("</robot>", '<link name="table"/></robot>', "2 links without a parent [(]base_link, table[)]"),
        (
            "</robot>",
            '<joint name="q" type="fixed"><parent link="tool0"/><child link="link_1"/></joint></robot>',
            "child of two joints, 'j1' and 'q'",
        ),
        ('<origin xyz="0 0 0.2"/>', '<origin xyz="0 0 0.2" rpy="0 0 90"/>', "seem to be in degrees"),
    ],
)
def test_a_urdf_that_is_no_tree_is_named(tmp_path: Path, original: str, written: str, sentence: str) -> None:
    """The sentence names the link or joint, in place of MuJoCo's words."""
    with pytest.raises(CellError, match=sentence):
        read(tmp_path, urdf().replace(original, written, 1))


def test_impossible_inertias_do_not_matter(tmp_path: Path) -> None:
    """Kinematics uses neither mass nor inertia."""
    inertia = '<inertia ixx="-1" iyy="0" izz="1" ixy="0" ixz="0" iyz="0"/>'
    read(tmp_path, urdf(link_2=f'{BOX}<inertial><mass value="-1"/>{inertia}</inertial>'))


def test_a_concave_polygon_of_a_robots_mesh_covers_its_own_surface(tmp_path: Path) -> None:
    """An OBJ has the triangles of the part's reader, not a fan over its notch."""
    profile = [(0, 0), (0.1, 0), (0.1, 0.03), (0.03, 0.03), (0.03, 0.08), (0, 0.08)]
    rows = [f"v {x} {y} {z}" for z in (0, 0.04) for x, y in profile]
    rows += ["f -7 -8 -9 -10 -11 -12", "f 8 9 10 11 12 7"]
    rows += [f"f {k + 1} {(k + 1) % 6 + 1} {(k + 1) % 6 + 7} {k + 7}" for k in range(6)]
    (tmp_path / "l.obj").write_text("\n".join(rows))
    model = read(tmp_path, urdf(link_2=MESH.format("l.obj"))).model
    corners = model.mesh_vert[model.mesh_face]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.linalg.norm(cross, axis=1).sum() / 2 == pytest.approx(0.0234, rel=1e-6)


@pytest.mark.parametrize(
    ("name", "sentence"),
    [("", "a <mesh> without a file name"), ("A.stl", "there is a.stl: names are case-sensitive"),
     ("m\\a.stl", "write / between folders"), ("b.stl", "copy the file there, or correct the name"),
     ("folder", "copy the file there, or correct the name")],
)  # fmt: skip
def test_a_missing_mesh_is_named_with_the_cure(tmp_path: Path, name: str, sentence: str) -> None:
    """An empty name, another case, a backslash and a missing file have their own sentences."""
    (tmp_path / "a.stl").write_bytes(b"x")
    (tmp_path / "folder").mkdir()
    with pytest.raises(CellError, match=sentence):
        read(tmp_path, urdf(link_2=MESH.format(name)))


def test_an_unsupported_mesh_is_named_with_the_cure(tmp_path: Path) -> None:
    """COLLADA is not read."""
    (tmp_path / "a.dae").write_text("<COLLADA/>")
    with pytest.raises(CellError, match=r"'\.dae', which is not supported; convert it to binary STL"):
        read(tmp_path, urdf(link_2=MESH.format("a.dae")))
