"""Faulty descriptions of arms are refused with place, cause and cure, and not in the words of MuJoCo."""

from pathlib import Path

import pytest
import trimesh

from cell.errors import CellError
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
    """The descriptions above are refused for their fault alone."""
    for name, text in (("arm.urdf", urdf()), ("arm.xml", mjcf())):
        (tmp_path / name).write_text(text)
        assert read_robot(tmp_path / name).joints == ("j1", "j2", "j3", "j4", "j5", "j6")


def test_unknown_words_are_introduced_and_cut() -> None:
    """A sentence of the library that has no own words is quoted in ours."""
    message = describe_refusal(ValueError("Error: " + "x" * 500 + "\nElement 'geom', line 7"))
    assert message == f"<geom>, line 7: MuJoCo's compiler reports '{'x' * 120}'; correct or remove this element"
