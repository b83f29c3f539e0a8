"""Writing `cell.xml`, the checked cell as one MJCF with the part at its placement, and `robot.xml`, its arm.

MuJoCo writes six digits, which moves the flange of this arm by micrometres and turns the home pose by 4e-6 rad. So only
the structure of its text is used: every length, angle and mesh is written from the specification with all digits of a
float64.

MuJoCo's viewer shows the cell of the file: the arm's shapes are in a visible group, there is a light, and the arm is at
home. Home is its reference configuration (`ref`), which changes no pose at any joint angles.
"""

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike

from cell.robot.model import KR16
from cell.world.model import World
from cell.world.robot_spec import robot_spec, set_base
from cell.world.shapes import quaternion
from planner.ports import ARM_AXES

FILE_NAME = "cell.xml"
ROBOT = "robot.xml"
_VISIBLE_GROUP = 1


def write_mjcf(world: World, folder: Path) -> tuple[str, ...]:
    """Write `cell.xml`, and `robot.xml` for a robot from a file, to an existing folder; meshes are inside the files.

    Part and post are mocap bodies, as in the checked model, and can be moved.

    Returns:
        The names of the written files.
    """
    T, spec = world.T_base_object, world.spec.copy()
    spec.body("object").pos, spec.body("object").quat = T[:3, 3], quaternion(T[:3, :3])
    post = world.T_base_post(T)
    spec.body("post").pos, spec.body("post").quat = post[:3, 3], quaternion(post[:3, :3])
    _prepare_for_viewer(spec, world)
    home = spec.key("home")
    home.qpos = world.mimic_joints.qpos(world.home[:ARM_AXES])
    home.mpos, home.mquat = [], []  # a key would move the mocap bodies
    _write(spec, folder / FILE_NAME)
    if world.scene.robot.model == KR16:
        return (FILE_NAME,)
    alone = robot_spec(world.scene.robot)
    set_base(alone, np.eye(4))
    _write(alone, folder / ROBOT)
    return (FILE_NAME, ROBOT)


def _write(spec: Any, path: Path) -> None:
    model = spec.compile()
    root = ElementTree.fromstring(spec.to_xml())
    for element in root.iter():
        _write_exactly(element, spec, model)
    for key in root.iter("key"):
        for name in ("mpos", "mquat"):
            key.attrib.pop(name, None)
    ElementTree.indent(root)
    path.write_text(ElementTree.tostring(root, encoding="unicode") + "\n", encoding="utf-8")


def _prepare_for_viewer(spec: Any, world: World) -> None:
    """Make robot shapes visible, add a light from above, and make home the initial configuration of a viewer."""
    import mujoco

    for body in spec.bodies:
        if body.name == "base" or len(body.joints):
            for geom in body.geoms:
                geom.group = _VISIBLE_GROUP
    spec.worldbody.add_light(
        name="lamp", type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, pos=[0, 0, 4], dir=[0.3, 0.4, -0.87]
    )
    qpos = world.mimic_joints.qpos(world.home[:ARM_AXES])
    for joint in spec.joints:
        angle = qpos[world.model.joint(joint.name).qposadr[0]]
        # A body is given at its reference angle: turned about its own joint.
        turned, turn = np.empty(4), np.empty(4)
        mujoco.mju_axisAngle2Quat(turn, np.asarray(joint.axis), float(angle))
        mujoco.mju_mulQuat(turned, np.asarray(joint.parent.quat), turn)
        joint.parent.quat = turned
        joint.ref = np.degrees(angle) if spec.compiler.degree else angle


def _write_exactly(element: ElementTree.Element, spec: Any, model: Any) -> None:
    """Replace the rounded numbers of an element by those of the specification."""
    name = element.get("name")
    exact: dict[str, ArrayLike] = {}
    if name is None:
        return
    if element.tag == "body":
        exact = {"pos": model.body(name).pos, "quat": model.body(name).quat}
    elif element.tag == "geom" and element.get("mesh") is None:
        geom = model.geom(name)
        exact = {"pos": geom.pos, "quat": geom.quat, "margin": geom.margin, "size": geom.size}
    elif element.tag == "geom":  # the compiled pose of a mesh is that of its principal axes
        exact = {"pos": spec.geom(name).pos, "margin": spec.geom(name).margin}
    elif element.tag == "site":
        exact = {"pos": model.site(name).pos, "quat": model.site(name).quat}
    elif element.tag == "joint":
        exact = {
            "ref": model.joint(name).qpos0,
            "range": model.joint(name).range,
            "axis": model.joint(name).axis,
            "pos": model.joint(name).pos,
        }
    elif element.tag == "key":
        exact = {"qpos": spec.key(name).qpos}
    elif element.tag == "mesh":
        exact = {"vertex": spec.mesh(name).uservert}
    elif element.tag == "numeric":
        exact = {"data": spec.numeric(name).data}
    for attribute, values in exact.items():
        present = element.get(attribute)
        if element.tag == "numeric" and np.array_equal(np.array((present or "").split(), dtype=np.float64), values):
            continue  # exact with few digits
        if present is not None:
            count = len(present.split())  # a cylinder's size is written with two numbers, kept with three
            numbers = np.atleast_1d(np.asarray(values, dtype=np.float64)).ravel()[:count]
            element.set(attribute, " ".join(repr(float(number)) for number in numbers))
