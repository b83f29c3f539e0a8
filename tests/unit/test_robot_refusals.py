"""Faulty descriptions of arms are refused with place, cause and cure, and not in the words of MuJoCo."""

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

from cell.errors import CellError
from cell.robot.arm import chain_of
from cell.robot.normalise import normalise
from cell.robot.refusals import describe_refusal
from cell.robot.robot_file import read_robot

AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
PLACES = ("0 0 0.4", "0.1 0 0.2", "0 0 0.6", "0.1 0 0.1", "0.5 0 0", "0.1 0 0")


def mjcf(
    geom: str = 'type="box" size=".05 .05 .05"', joint: str = 'name="j3" range="-2 2"', more: str = "", body: str = ""
) -> str:
    """Return an arm as MJCF with another shape, joint and element on its third link."""
    links = [
        f'<body name="l{k}" pos="{place}">{body if k == 3 else ""}'
        + (f'<joint axis="{axis}" {joint}/><geom {geom}/>' if k == 3 else
           f'<joint name="j{k}" axis="{axis}" range="-2 2"/><geom type="box" size=".05 .05 .05"/>')
        for k, (axis, place) in enumerate(zip(AXES, PLACES, strict=True), start=1)
    ]  # fmt: skip
    inside = '<body name="base">' + "".join(links) + '<site name="flange" pos=".1 0 0"/>' + "</body>" * 7
    return f'<mujoco>\n<compiler angle="radian"/>{more}\n<worldbody>\n{inside}</worldbody></mujoco>'


def urdf(shape: str = '<box size=".1 .1 .1"/>', name: str = "j3", origin: str = PLACES[2], inertial: str = "") -> str:
    """Return an arm as URDF with another third link or joint."""
    rows = ['<link name="l0"/><link name="flange"/>']
    for k, (axis, place) in enumerate(zip(AXES, PLACES, strict=True), start=1):
        own = k == 3
        rows += [
            f'<link name="l{k}">{inertial if own else ""}<collision><geometry>',
            shape if own else '<box size=".1 .1 .1"/>',
            f'</geometry></collision></link><joint name="{name if own else f"j{k}"}" type="revolute">',
            f'<parent link="l{k - 1}"/><child link="l{k}"/><origin xyz="{origin if own else place}"/>',
            f'<axis xyz="{axis}"/><limit lower="-2" upper="2" effort="1" velocity="3"/></joint>',
        ]
    rows.append('<joint name="end" type="fixed"><parent link="l6"/><child link="flange"/></joint>')
    return '<robot name="r">' + "\n".join(rows) + "</robot>"


INERTIA = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="nan" ixz="0" iyz="0"/></inertial>'

FAULTY = {
    "a mass of NaN": (urdf(inertial=INERTIA), "<inertia> has NaN in 'ixy'; give a number"),
    "a place of NaN": (urdf(origin="nan 0 0"), "<origin> has NaN in 'xyz'; give a number"),
    "a place of NaN in an MJCF": (mjcf('type="box" size="1 1 1" pos="0 NaN 0"'), "<geom> has NaN in 'pos'"),
    "a distant joint": (urdf(origin="1e300 0 0"), "joints are 1e+300 m apart"),
    "a name twice": (urdf(name="j2"), "has two joints named 'j2'; give each joint its own name"),
    "a name twice in an MJCF": (mjcf(joint='name="j2" range="-2 2"'), "line 4: the name 'j2' is given twice"),
    "a reversed range": (mjcf(joint='name="j3" range="2 -2"'), "<joint> 'j3' has the reversed range 2 to -2"),
    "an empty range": (mjcf(joint='name="j3" range="1 1" limited="true"'), "joint 'j3', line 4: the range of a joint"),
    "no size": (mjcf('type="box" size="0 1 1"'), "geom number 3, line 4: a shape has a size that is missing"),
    "an unknown shape": (urdf("<torus/>"), "<geometry>: a shape is unknown; valid are box"),
    "two sizes": (urdf('<box size="1 1"/>'), "<box>: 'size' has too few numbers; add them"),
    "text as size": (urdf('<sphere radius="big"/>'), "<sphere>: 'radius' is not a valid number"),
    "a flat mesh": (urdf('<mesh filename="flat.stl"/>'), "'flat': a mesh is flat; use a thin box"),
    "a mesh without faces": (urdf('<mesh filename="empty.obj"/>'), "empty.obj is empty (0 bytes)"),
    "an undefined mesh": (mjcf('type="mesh" mesh="nope"'), "it refers to 'nope', which it does not define"),
    "an undefined joint": (
        mjcf(more='<actuator><motor joint="nope"/></actuator>'),
        "it refers to 'nope', which it does not define",
    ),
    "a missing file": (mjcf(more='<include file="nope.xml"/>'), "<include>, line 2: 'nope.xml' cannot be opened"),
    "a free joint": (mjcf(body="<freejoint/>"), "a link within the arm has a free joint"),
    "an unknown attribute": (mjcf('type="sphere" size="1" colour="red"'), "'colour' is an unknown attribute"),
    "an unknown element": (mjcf(more="<wheel/>"), "<wheel>, line 2: this element is unknown here"),
    "an infinite axis": (
        urdf().replace('<axis xyz="0 0 1"/>', '<axis xyz="0 0 inf"/>'),
        "xyz of <axis> is 'inf', which is not a number",
    ),
    "an infinite ratio": (
        urdf().replace('<axis xyz="0 0 1"/>', '<mimic joint="j2" multiplier="1e999"/>'),
        "multiplier of <mimic> is '1e999', which is not a number",
    ),
    "a flange in millimetres": (
        urdf().replace('<child link="flange"/>', '<child link="flange"/><origin xyz="0 0 80"/>'),
        "joints are 80 m apart; a URDF is in metres",
    ),
    "a shape displaced in millimetres": (
        urdf().replace("<collision>", '<collision><origin xyz="0 0 40"/>', 1),
        "a shape of the link 'l1' is 0.173 m wide, 40 m from its frame, but the links of the arm",
    ),
    "a speed of one axis": (urdf().replace('velocity="3"', 'velocity="1e9"', 1), "an axis has the speed 1e+09 rad/s"),
    "a sliding joint": (urdf().replace('"revolute"', '"prismatic"', 1), "six revolute joints; make j1 fixed"),
    "a cycle": (
        urdf().replace(
            "</robot>", '<joint name="c" type="fixed"><parent link="l6"/><child link="l0"/></joint></robot>'
        ),
        "form a cycle; links must form one tree",
    ),
    "a cycle beside the arm": (
        urdf().replace(
            "</robot>",
            '<link name="a"/><link name="b"/>'
            '<joint name="c" type="fixed"><parent link="a"/><child link="b"/></joint>'
            '<joint name="d" type="fixed"><parent link="b"/><child link="a"/></joint></robot>',
        ),
        "the links a, b, a form a cycle",
    ),
    "an element twice": (urdf().replace('<axis xyz="0 0 1"/>', '<axis xyz="0 0 1"/>' * 2), "<axis> is given twice"),
    "a box without height": (urdf('<box size=".1 .1 0"/>'), "geom 'shape 1 of l3': a shape has a size that is missing"),
    "a converted mesh of one face": (
        urdf('<mesh filename="face.obj"/>'),
        "element 'face_0': a mesh has fewer than four",
    ),
    "an element of xacro": (
        urdf().replace('name="r">', 'name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:tool/>'),
        "has the xacro element <tool>; expand it first: xacro arm.urdf > robot.urdf",
    ),
    "soft limits of zero": (
        urdf().replace("</joint>", '<safety_controller soft_lower_limit="0" soft_upper_limit="0"/></joint>', 1),
        "empty range 0 to 0; correct its <safety_controller soft_lower_limit soft_upper_limit>",
    ),
    "a file included twice": (
        mjcf(more='<include file="more.xml"/><include file="more.xml"/>'),
        "<include>, line 2: 'more.xml' is included twice, or includes itself",
    ),
    "coupled joints": (
        mjcf(more='<equality><joint joint1="j3" joint2="j2"/></equality>'),
        "the joint 'j3' is one of the six and mimics 'j2'",
    ),
    "a second tree with a joint": (
        mjcf().replace("</worldbody>", "<body><freejoint/><geom size='.1'/></body></worldbody>"),
        "the joint 'joint 6' is none of the six and mimics none; make it fixed",
    ),
    "a range that is off": (
        mjcf(more='<compiler autolimits="false"/>'),
        "element 'j1', line 4: it has a range, but is not limited",
    ),
    "a cause without own words": (
        mjcf('type="box" size="1 1 1" condim="7"'),
        "geom number 3, line 4: MuJoCo's compiler reports 'invalid condim in geom'; correct or remove this element",
    ),
}


@pytest.mark.parametrize("case", FAULTY)
def test_a_faulty_arm_is_refused_with_place_cause_and_cure(case: str, tmp_path: Path) -> None:
    """The sentence begins with the file or its mesh, names the element and the cause, and is one line."""
    trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], [[0, 1, 2], [1, 3, 2]]).export(tmp_path / "flat.stl")
    (tmp_path / "empty.obj").write_text("")
    (tmp_path / "face.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "more.xml").write_text("<mujoco><worldbody/></mujoco>")
    text, words = FAULTY[case]
    file = tmp_path / ("arm.urdf" if text.startswith("<robot") else "arm.xml")
    file.write_text(text)
    with pytest.raises(CellError) as refusal:
        read_robot(file)
    message = str(refusal.value)
    assert message.startswith(str(tmp_path / "empty.obj" if case == "a mesh without faces" else file))
    assert words in message
    assert "\n" not in message
    assert "Error" not in message


def test_the_arms_without_a_fault_are_read(tmp_path: Path) -> None:
    """The descriptions above are refused for their fault alone. A property of xacro that nothing uses is no fault."""
    xacro = 'name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:property name="w" value="1"/>'
    for name, text in (("arm.urdf", urdf().replace('name="r">', xacro)), ("arm.xml", mjcf())):
        (tmp_path / name).write_text(text)
        assert read_robot(tmp_path / name).joints == ("j1", "j2", "j3", "j4", "j5", "j6")


def test_an_included_file_is_checked(tmp_path: Path) -> None:
    """The message names the included file. A file that includes itself is refused."""
    (tmp_path / "arm.xml").write_text(mjcf(joint='name="j3" range="2 -2"'))
    scene = tmp_path / "scene.xml"
    scene.write_text('<mujoco><include file="arm.xml"/></mujoco>')
    with pytest.raises(CellError, match=r"arm\.xml: <joint> 'j3' has the reversed range 2 to -2"):
        read_robot(scene)
    scene.write_text('<mujoco><include file="scene.xml"/></mujoco>')
    with pytest.raises(CellError, match=r"scene\.xml' is included twice, or includes itself"):
        read_robot(scene)


def test_a_repeated_name_of_a_shape_prints_nothing(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Names of collision shapes have no meaning, and programs repeat them."""
    (tmp_path / "arm.urdf").write_text(urdf().replace("<collision>", '<collision name="hull">'))
    assert len(read_robot(tmp_path / "arm.urdf").joints) == 6
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("change", ["nothing", "no base", "table", "names"])
def test_base_joints_and_flange_of_an_mjcf_are_found(change: str, tmp_path: Path) -> None:
    """The arm may stand in the world, beside a table, or be without names; MuJoCo gives its pose."""
    text = mjcf().replace('site name="flange"', 'site name="attachment_site"')
    if change == "no base":
        text = text.replace('<body name="base">', "").replace("</body>" * 7, "</body>" * 6)
    elif change == "table":
        text = text.replace("<worldbody>", '<worldbody><body name="table" pos="0 0 -1"><geom size=".1"/></body>')
    elif change == "names":
        text = re.sub(r'<(body|joint) name="\w+"', r"<\1", text)
    (tmp_path / "arm.xml").write_text(text)
    q = np.array([0.3, -0.4, 0.5, -0.6, 0.7, -0.8])
    spec = normalise(read_robot(tmp_path / "arm.xml"), (90.0,) * 6)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    data = mujoco.MjData(model)
    data.qpos = q
    mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose(
        chain_of(spec.compile()).forward(q[None])[0, :3, 3], data.site("attachment_site").xpos, atol=1e-12
    )


def test_a_lever_of_an_mjcf_is_driven(tmp_path: Path) -> None:
    """An equality of two joints is a mimic joint, with its reference angles."""
    lever = '<body name="lever"><joint name="m" axis="0 1 0" ref=".1"/><geom size=".05"/></body>'
    equality = '<equality><joint joint1="m" joint2="j3" polycoef=".2 -.5 0 0 0"/></equality>'
    text = mjcf(more=equality).replace('<body name="l3"', f'{lever}<body name="l3"')
    (tmp_path / "arm.xml").write_text(text.replace('name="j3"', 'name="j3" ref=".4"'))
    (mimic,) = read_robot(tmp_path / "arm.xml").mimic_joints
    assert (mimic.joint, mimic.axis, mimic.ratio) == ("m", 2, -0.5)
    assert mimic.offset == pytest.approx(0.2 + 0.1 + 0.5 * 0.4)  # angle - 0.1 = 0.2 - 0.5 (q - 0.4)
    (tmp_path / "arm.xml").write_text(text.replace('joint1="m"', 'active="false" joint1="m"'))
    with pytest.raises(CellError, match="the joint 'm' is none of the six and mimics none"):
        read_robot(tmp_path / "arm.xml")


def test_the_name_of_a_missing_file_is_not_cut(tmp_path: Path) -> None:
    """Of a long path the end is quoted."""
    (tmp_path / "arm.xml").write_text(mjcf(more=f'<asset><mesh file="{"folder/" * 12}hand.stl"/></asset>'))
    with pytest.raises(CellError, match=r"'\.\.\.[a-z/]{48}/hand\.stl' cannot be opened"):
        read_robot(tmp_path / "arm.xml")


def test_unknown_words_are_introduced_and_cut() -> None:
    """A sentence of the library that has no own words is quoted in ours."""
    message = describe_refusal(ValueError("Error: " + "x" * 500 + "\nElement 'geom', line 7"))
    assert message == f"<geom>, line 7: MuJoCo's compiler reports '{'x' * 120}'; correct or remove this element"
