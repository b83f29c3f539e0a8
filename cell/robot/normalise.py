"""Conversion of an arm from a file into the form of `models/kr16.xml`, which all other modules expect.

Bodies `base`, `link_1` to `link_6`, hinges `A1` to `A6` in the file's own signs and zeros, a site `flange`, speeds,
accelerations and jerks as numerics. At all angles zero every frame is parallel to the base's, with its origin on its
joint's axis. Links without relative motion are merged; links without shape are omitted. Boxes and cylinders stay as
they are; every other shape becomes its triangles, whose convex hull MuJoCo uses for collision.

A mimic joint is a hinge after the six, with zero at the arm's zero; the numeric `follower_<body>` has the number of its
driving axis and the ratio (`cell.robot.model.MimicJoints`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cell.errors import SceneError
from cell.robot.model import AXES, FLANGE, LINKS
from cell.robot.robot_file import MIN_INERTIA, MIN_MASS, RobotFile
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco

ACCELERATION_TIME, JERK_TIME = 0.5, 0.1
"""Default times in which an axis reaches its speed and its acceleration [s]: those of the KR 16."""

_N_AROUND = 24  # points around a capsule, sphere or ellipsoid


def normalise(file: RobotFile, velocity_deg_s: tuple[float, ...] | None = None) -> mujoco.MjSpec:
    """Convert an arm; the result has no key `home`, and collision is excluded only for neighbouring links.

    Args:
        file: the arm.
        velocity_deg_s: (6,) speeds [deg/s] for axes without a speed in the file.
    """
    import mujoco

    data = _at_zero(file)
    velocity = np.degrees(file.velocity)
    if not np.isfinite(velocity).all():
        if velocity_deg_s is None:
            joint = file.joints[int(np.argmin(np.isfinite(velocity)))]
            raise SceneError(
                f"{file.path} has no speed of the joint '{joint}'; give the speeds of the six axes as "
                "robot.velocity_deg_s"
            )
        velocity = np.where(np.isfinite(velocity), velocity, velocity_deg_s)
    base = data.body(file.base)
    R, origin = base.xmat.reshape(3, 3), base.xpos
    spec = mujoco.MjSpec()
    spec.modelname, spec.compiler.degree = file.path.stem, False
    spec.compiler.boundmass, spec.compiler.boundinertia = MIN_MASS, MIN_INERTIA
    bodies = _bodies(spec, file, data, R, origin)
    for name, values in (
        ("axis_velocity_limit_deg_s", velocity),
        ("axis_acceleration_limit_deg_s2", velocity / ACCELERATION_TIME),
        ("axis_jerk_limit_deg_s3", velocity / ACCELERATION_TIME / JERK_TIME),
    ):
        spec.add_numeric(name=name, data=values.round(9), size=6)
    if not _add_shapes(spec, file, data, bodies, R):
        raise SceneError(f"{file.path} has no collision shapes; add <collision> geometry to its links")
    for body in spec.bodies:
        if body.name not in ("world", "base"):
            spec.add_exclude(name=f"bearing_{body.name}", bodyname1=body.parent.name, bodyname2=body.name)
    return spec


def _at_zero(file: RobotFile) -> mujoco.MjData:
    """Return the file's model with all axes at zero and mimic joints accordingly."""
    import mujoco

    data = mujoco.MjData(file.model)
    data.qpos[:] = 0.0
    for mimic in file.mimic_joints:
        data.qpos[file.model.joint(mimic.joint).qposadr[0]] = mimic.offset
    mujoco.mj_kinematics(file.model, data)
    return data


def _bodies(
    spec: mujoco.MjSpec, file: RobotFile, data: mujoco.MjData, R: Floats, origin: Floats
) -> dict[int, tuple[str, Floats]]:
    """Add the bodies with their joints and the flange; return new name and origin of each moving body of the file.

    Args:
        spec: an empty specification.
        file: the arm.
        data: state at zero.
        R: (3, 3) axes of the base in the file's world.
        origin: (3,) its origin there [m].
    """
    import mujoco

    model = file.model
    ids = [model.joint(name).id for name in file.joints]
    body = spec.worldbody.add_body(name="base")
    added: dict[int, tuple[str, Floats]] = {model.body(file.base).id: ("base", origin)}
    for number, joint in enumerate(ids):
        anchor = data.xanchor[joint]
        parent_origin = added[int(model.jnt_bodyid[ids[number - 1]])][1] if number else origin
        body = body.add_body(name=LINKS[number + 1], pos=R.T @ (anchor - parent_origin))
        body.add_joint(
            name=AXES[number],
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=R.T @ data.xaxis[joint],
            range=[file.lower[number], file.upper[number]],
            limited=mujoco.mjtLimited.mjLIMITED_TRUE,
        )
        added[int(model.jnt_bodyid[joint])] = (LINKS[number + 1], anchor.copy())
    frame = data.body(file.flange) if file.flange_is_body else data.site(file.flange)
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(R.T @ frame.xmat.reshape(3, 3)).ravel())
    body.add_site(name=FLANGE, pos=R.T @ (frame.xpos - added[int(model.jnt_bodyid[ids[-1]])][1]), quat=quat)
    # Mimic joints after the six, each after its carrier.
    names = {*LINKS, *AXES, FLANGE, "world", "bracket", "housing", "part", "object", "post", "pedestal", "floor"}
    names |= {"rotary table", "tool of a home"}
    for mimic in sorted(file.mimic_joints, key=lambda each: int(model.joint(each.joint).bodyid[0])):
        joint = model.joint(mimic.joint).id
        mimic_body = int(model.jnt_bodyid[joint])
        carrier, at = added[_carrier(model, int(model.body_parentid[mimic_body]), added)]
        name = model.body(mimic_body).name
        name = f"{name} of the robot" if name in names or not name else name
        new = spec.body(carrier).add_body(name=name, pos=R.T @ (data.xanchor[joint] - at))
        new.add_joint(
            name=f"drives_{name}",
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=R.T @ data.xaxis[joint],
            limited=mujoco.mjtLimited.mjLIMITED_FALSE,
        )
        spec.add_numeric(name=f"follower_{name}", data=[float(mimic.axis), mimic.ratio], size=2)
        added[mimic_body] = (name, data.xanchor[joint].copy())
    return added


def _carrier(model: mujoco.MjModel, body: int, added: dict[int, tuple[str, Floats]]) -> int:
    """Return the moving body that carries this one rigidly, or itself; -1 if it is not part of the arm."""
    while body not in added:
        if body == 0:
            return -1
        body = int(model.body_parentid[body])
    return body


def _add_shapes(
    spec: mujoco.MjSpec, file: RobotFile, data: mujoco.MjData, bodies: dict[int, tuple[str, Floats]], R: Floats
) -> int:
    """Add the collision shapes of the arm to its links; return their number."""
    import mujoco

    model, kinds = file.model, mujoco.mjtGeom
    counts: dict[str, int] = {}
    for geom in range(model.ngeom):
        if not (model.geom_contype[geom] or model.geom_conaffinity[geom]):
            continue
        carrier = _carrier(model, int(model.geom_bodyid[geom]), bodies)
        if carrier < 0 and model.geom_type[geom] == kinds.mjGEOM_PLANE:
            continue  # the file's floor; a cell has its own floor
        # Only the six and the mimic joints move: shapes beside or below the base belong to it.
        link, at = bodies[carrier if carrier >= 0 else model.body(file.base).id]
        name = f"{link}_{counts.get(link, 0)}"
        counts[link] = counts.get(link, 0) + 1
        rotation, middle = R.T @ data.geom_xmat[geom].reshape(3, 3), R.T @ (data.geom_xpos[geom] - at)
        attributes = {"name": name, "group": 3, "rgba": [1.0, 0.35, 0.0, 1.0], "contype": 1, "conaffinity": 1}
        if int(model.geom_type[geom]) in (kinds.mjGEOM_BOX, kinds.mjGEOM_CYLINDER):
            quat = np.empty(4)
            mujoco.mju_mat2Quat(quat, np.ascontiguousarray(rotation).ravel())
            kind = kinds(int(model.geom_type[geom]))
            spec.body(link).add_geom(type=kind, size=model.geom_size[geom], pos=middle, quat=quat, **attributes)
            continue
        vertices, faces = _triangles(file, geom)
        spec.add_mesh(
            name=name,
            uservert=(vertices @ rotation.T + middle).ravel(),
            userface=faces.ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX,
        )
        spec.body(link).add_geom(type=kinds.mjGEOM_MESH, meshname=name, **attributes)
    return sum(counts.values())


def _triangles(file: RobotFile, geom: int) -> tuple[Floats, NDArray[np.int32]]:
    """Return a shape's vertices in its own frame [m] and its faces; a round shape becomes a polyhedron around it."""
    import mujoco
    from scipy.spatial import ConvexHull  # slow to import

    model, kinds = file.model, mujoco.mjtGeom
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    if kind == kinds.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        start, number = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
        return np.array(model.mesh_vert[first : first + count], dtype=np.float64), model.mesh_face[
            start : start + number
        ].astype(np.int32)
    if kind not in (kinds.mjGEOM_SPHERE, kinds.mjGEOM_CAPSULE, kinds.mjGEOM_ELLIPSOID):
        link = model.body(model.geom_bodyid[geom]).name
        raise SceneError(f"{file.path}: the link '{link}' has a collision shape that is not solid; use a mesh")
    around, up = np.meshgrid(np.arange(_N_AROUND) * (2 * np.pi / _N_AROUND), np.linspace(-np.pi / 2, np.pi / 2, 13))
    points = np.stack([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)], axis=-1).reshape(-1, 3)
    points = np.unique(points.round(12), axis=0)
    points /= -ConvexHull(points).equations[:, 3].max()  # its faces touch the sphere from outside
    if kind == kinds.mjGEOM_CAPSULE:
        shift = np.array([0.0, 0.0, size[1]])
        points = np.concatenate([points * size[0] + shift, points * size[0] - shift])
    else:
        points = points * (size if kind == kinds.mjGEOM_ELLIPSOID else size[0])
    hull = ConvexHull(points)
    corners = points[hull.simplices]
    outward = np.einsum(
        "fj,fj->f", np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), hull.equations[:, :3]
    )
    used, faces = np.unique(
        np.where(outward[:, None] < 0, hull.simplices[:, ::-1], hull.simplices), return_inverse=True
    )
    return points[used], faces.reshape(-1, 3).astype(np.int32)
