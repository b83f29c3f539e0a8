"""Motion and cell for ROS, without a dependency on it: `<name>_trajectory.json` and `<name>.urdf` with its meshes.

The trajectory has the field names of trajectory_msgs/JointTrajectory: every sample of the planned motion with its
positions, velocities and accelerations [rad, s]. The URDF holds the arm, the scanner, the fixtures, and the part where
it is in the plan. It is built from the compiled model of the run, so both have the same frames. Names of joints are
those of the axes.
"""

import json
from xml.etree import ElementTree

import mujoco
import numpy as np

from cell.export.program import Program
from cell.robot.model import AXES, MimicJoints, mesh_of
from cell.runs.folder import SCHEMA
from cell.runs.run import Run
from planner.geometry.rigid import inverse_rigid, rigid_transform
from planner.kinematics.frames import kuka_abc_from_pose
from planner.values import Floats, Ints32

_NANO = 10**9
_EFFORT = "1000"  # URDF requires a limit of torque; no maker states one


def files(program: Program, run: Run) -> dict[str, bytes]:
    """Return the files of the motion and the cell of a run."""
    name = program.info.name
    meshes, urdf = _urdf(name, run.cell_model(), run)
    return {f"{name}_trajectory.json": _trajectory(program, run), f"{name}.urdf": urdf, **meshes}


def _trajectory(program: Program, run: Run) -> bytes:
    """Return the samples of the motion, with the number of each view, from 1 in visiting order, and its time."""
    motion = run.motion
    points = [
        {
            "positions": q,
            "velocities": qd,
            "accelerations": qdd,
            "effort": [],
            "time_from_start": dict(zip(("sec", "nanosec"), divmod(round(t * _NANO), _NANO), strict=True)),
        }
        for t, q, qd, qdd in zip(
            motion.t.tolist(), motion.q.tolist(), motion.qd.tolist(), motion.qdd.tolist(), strict=True
        )
    ]
    content = {
        "schema": SCHEMA,
        "name": program.info.name,
        "digest": run.digest,
        "views": [
            {"view": int(view), "time_s": float(t)} for view, t in zip(program.view, program.t, strict=True) if view
        ],
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "base"},
        "joint_names": run.joint_names(),
        "points": points,
    }
    return (json.dumps(content, allow_nan=False) + "\n").encode()


def _urdf(name: str, model: mujoco.MjModel, run: Run) -> tuple[dict[str, bytes], bytes]:
    """Return the meshes and the URDF of a model; a body without a joint is fixed to its parent."""
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0  # the poses of links in a URDF are those at zero
    mujoco.mj_kinematics(model, data)
    root = ElementTree.Element("robot", name=name)
    meshes: dict[str, bytes] = {}
    links = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, body) for body in range(model.nbody)]
    for body in range(model.nbody):
        link = ElementTree.SubElement(root, "link", name=links[body])
        for geom in range(model.body_geomadr[body], model.body_geomadr[body] + model.body_geomnum[body]):
            _add_geom(link, model, geom, f"{name}_meshes", meshes)
        if body:
            T = _pose(data, body, int(model.body_parentid[body]))
            _add_joint(root, model, body, links, T, run.motion.limits.velocity)
    part = ElementTree.SubElement(root, "link", name="planned_part")
    meshes[f"{name}_meshes/part.stl"] = _stl(run.reference.vertices, run.reference.faces)
    _add_shape(part, np.eye(4), "mesh", {"filename": f"{name}_meshes/part.stl"})
    base = links.index("base") if "base" in links else 0
    joint = ElementTree.SubElement(root, "joint", name="base_to_planned_part", type="fixed")
    ElementTree.SubElement(joint, "parent", link=links[base])
    ElementTree.SubElement(joint, "child", link="planned_part")
    _add_origin(joint, run.T_base_object)
    ElementTree.indent(root)
    return meshes, ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _pose(data: mujoco.MjData, body: int, parent: int) -> Floats:
    """Return the pose (4, 4) of a body in its parent."""
    T = np.tile(np.eye(4), (2, 1, 1))
    for k, number in enumerate((parent, body)):
        T[k, :3, :3], T[k, :3, 3] = data.xmat[number].reshape(3, 3), data.xpos[number]
    return np.asarray(inverse_rigid(T[0]) @ T[1])


def _add_joint(
    root: ElementTree.Element, model: mujoco.MjModel, body: int, links: list[str], T: Floats, velocity: Floats
) -> None:
    """Add the joint that carries a body: an axis with its speed [rad/s], a joint that mimics one, or a fixed joint."""
    is_hinge = model.body_jntnum[body] == 1
    first = int(model.body_jntadr[body])
    name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, first) if is_hinge else f"{links[body]}_fixed"
    kind = ("revolute" if first < len(AXES) else "continuous") if is_hinge else "fixed"
    joint = ElementTree.SubElement(root, "joint", name=name, type=kind)
    ElementTree.SubElement(joint, "parent", link=links[int(model.body_parentid[body])])
    ElementTree.SubElement(joint, "child", link=links[body])
    _add_origin(joint, T)
    if is_hinge:
        ElementTree.SubElement(joint, "axis", xyz=_words(model.jnt_axis[first]))
    if kind == "revolute":
        low, high, speed = (f"{value:.12g}" for value in (*model.jnt_range[first], velocity[first]))
        ElementTree.SubElement(joint, "limit", lower=low, upper=high, effort=_EFFORT, velocity=speed)
    elif kind == "continuous":
        mimics, driven = MimicJoints.from_model(model), first - len(AXES)
        multiplier = f"{mimics.ratio[driven]:.12g}"
        ElementTree.SubElement(joint, "mimic", joint=AXES[mimics.axis[driven]], multiplier=multiplier)


def _add_geom(
    link: ElementTree.Element, model: mujoco.MjModel, geom: int, folder: str, meshes: dict[str, bytes]
) -> None:
    """Add a shape of MuJoCo; a capsule is a cylinder with two spheres, a plane has no shape."""
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
    T = rigid_transform(rotation.reshape(3, 3), model.geom_pos[geom])
    size, kinds = model.geom_size[geom], mujoco.mjtGeom
    match model.geom_type[geom]:
        case kinds.mjGEOM_BOX:
            _add_shape(link, T, "box", {"size": _words(2.0 * size)})
        case kinds.mjGEOM_SPHERE:
            _add_shape(link, T, "sphere", {"radius": f"{size[0]:.9g}"})
        case kinds.mjGEOM_CYLINDER | kinds.mjGEOM_CAPSULE:
            _add_shape(link, T, "cylinder", {"radius": f"{size[0]:.9g}", "length": f"{2.0 * size[1]:.9g}"})
            if model.geom_type[geom] == kinds.mjGEOM_CAPSULE:
                for end in (-1.0, 1.0):
                    at = T.copy()
                    at[:3, 3] += end * size[1] * T[:3, 2]
                    _add_shape(link, at, "sphere", {"radius": f"{size[0]:.9g}"})
        case kinds.mjGEOM_MESH:
            mesh = mesh_of(model, geom)
            path = f"{folder}/{geom}.stl"
            meshes[path] = _stl(mesh.vertices, mesh.faces)
            _add_shape(link, np.eye(4), "mesh", {"filename": path})


def _add_shape(link: ElementTree.Element, T: Floats, kind: str, values: dict[str, str]) -> None:
    for tag in ("visual", "collision"):
        element = ElementTree.SubElement(link, tag)
        _add_origin(element, T)
        ElementTree.SubElement(ElementTree.SubElement(element, "geometry"), kind, values)


def _add_origin(element: ElementTree.Element, T: Floats) -> None:
    """Add a pose: position [m] and fixed-axis angles roll, pitch, yaw [rad]."""
    position, abc = kuka_abc_from_pose(T)
    ElementTree.SubElement(element, "origin", xyz=_words(position), rpy=_words(abc[::-1]))


def _words(values: Floats) -> str:
    return " ".join(f"{value + 0.0:.12g}" for value in np.round(values, 15))


def _stl(vertices: Floats, faces: Ints32) -> bytes:
    import trimesh

    content: bytes = trimesh.Trimesh(vertices, faces, process=False).export(file_type="stl")
    return content
