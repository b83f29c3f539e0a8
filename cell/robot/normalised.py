"""An arm from a file in the form of `models/kr16.xml`, so that all that reads that one reads it too.

Bodies `base`, `link_1` to `link_6`, hinges `A1` to `A6` in the file's own signs and zeros, a site `flange`, speeds,
accelerations and jerks as numerics. At all angles zero every frame is parallel to the base's, its origin on its joint's
axis. What else the file has between links that do not move against each other is joined; what has no shape is left out.
Boxes and cylinders stay what they are; every other shape becomes its triangles, whose convex hull MuJoCo collides.

A joint that is driven along is a hinge too, after the six, its zero where the arm's zero puts it; the numeric
`follower_<body>` holds the number of the axis that drives it and their ratio (`cell.robot.model.Followers`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cell.errors import SceneError
from cell.robot.model import AXES, FLANGE, LINKS
from cell.robot.robot_file import RobotFile
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco

ACCELERATION_TIME, JERK_TIME = 0.5, 0.1
"""In which an axis reaches its speed, and its acceleration [s], where nothing says it: as the KR 16's."""

_ROUND = 24  # points around a capsule, sphere or ellipsoid


def normalised(file: RobotFile, velocity_deg_s: tuple[float, ...] | None = None) -> mujoco.MjSpec:
    """The arm of a file; it has no key `home` yet, and of the pairs of links only neighbours are excluded.

    Args:
        file: the arm as it was read.
        velocity_deg_s: (6,) speeds of the axes for those of which the file says none [deg/s].

    Raises:
        SceneError: if an axis has no speed, or no link a shape.
    """
    import mujoco

    data = _at_zero(file)
    velocity = np.degrees(file.velocity)
    if not np.isfinite(velocity).all():
        if velocity_deg_s is None:
            slow = file.joints[int(np.argmin(np.isfinite(velocity)))]
            raise SceneError(
                f"{file.path} says no speed of the joint '{slow}'; give the six axes' as robot.velocity_deg_s"
            )
        velocity = np.where(np.isfinite(velocity), velocity, velocity_deg_s)
    base = data.body(file.base)
    R, origin = base.xmat.reshape(3, 3), base.xpos
    spec = mujoco.MjSpec()
    spec.modelname, spec.compiler.degree = file.path.stem, False
    bodies = _bodies(spec, file, data, R, origin)
    for name, values in (
        ("axis_velocity_limit_deg_s", velocity),
        ("axis_acceleration_limit_deg_s2", velocity / ACCELERATION_TIME),
        ("axis_jerk_limit_deg_s3", velocity / ACCELERATION_TIME / JERK_TIME),
    ):
        spec.add_numeric(name=name, data=values.round(9), size=6)
    shaped = _add_shapes(spec, file, data, bodies, R)
    if not shaped:
        raise SceneError(f"{file.path} has no collision shapes; give its links <collision> geometry")
    for child, parent in _joined_by_a_bearing(spec):
        spec.add_exclude(name=f"bearing_{child}", bodyname1=parent, bodyname2=child)
    return spec


def _at_zero(file: RobotFile) -> mujoco.MjData:
    """The file's model with all axes at zero, and what follows them where that puts it."""
    import mujoco

    data = mujoco.MjData(file.model)
    data.qpos[:] = 0.0
    for follower in file.followers:
        data.qpos[file.model.joint(follower.joint).qposadr[0]] = follower.offset
    mujoco.mj_kinematics(file.model, data)
    return data


def _bodies(
    spec: mujoco.MjSpec, file: RobotFile, data: mujoco.MjData, R: Floats, origin: Floats
) -> dict[int, tuple[str, Floats]]:
    """Add the bodies with their joints and the flange; for each moving body of the file its name and origin here.

    Args:
        spec: an empty specification.
        file: the arm.
        data: at zero.
        R: (3, 3) axes of the base in the file's world.
        origin: (3,) its origin there [m].
    """
    import mujoco

    model = file.model
    ids = [model.joint(name).id for name in file.joints]
    body = spec.worldbody.add_body(name="base")
    found: dict[int, tuple[str, Floats]] = {model.body(file.base).id: ("base", origin)}
    for number, joint in enumerate(ids):
        anchor, above = data.xanchor[joint], found[int(model.jnt_bodyid[ids[number - 1]])] if number else ("", origin)
        body = body.add_body(name=LINKS[number + 1], pos=R.T @ (anchor - above[1]))
        body.add_joint(
            name=AXES[number],
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=R.T @ data.xaxis[joint],
            range=[file.lower[number], file.upper[number]],
            limited=mujoco.mjtLimited.mjLIMITED_TRUE,
        )
        found[int(model.jnt_bodyid[joint])] = (LINKS[number + 1], anchor.copy())
    frame = data.body(file.flange) if file.flange_is_body else data.site(file.flange)
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(R.T @ frame.xmat.reshape(3, 3)).ravel())
    body.add_site(name=FLANGE, pos=R.T @ (frame.xpos - found[int(model.jnt_bodyid[ids[-1]])][1]), quat=quat)
    # After the six, each after what carries it.
    taken = {*LINKS, *AXES, FLANGE, "world", "bracket", "housing", "part", "object", "post", "pedestal", "floor"}
    for follower in sorted(file.followers, key=lambda each: int(model.joint(each.joint).bodyid[0])):
        joint = model.joint(follower.joint).id
        own = int(model.jnt_bodyid[joint])
        carrier, at = found[_moving(model, int(model.body_parentid[own]), found)]
        name = model.body(own).name
        name = f"{name} of the robot" if name in taken or not name else name
        added = spec.body(carrier).add_body(name=name, pos=R.T @ (data.xanchor[joint] - at))
        added.add_joint(
            name=f"drives_{name}",
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=R.T @ data.xaxis[joint],
            limited=mujoco.mjtLimited.mjLIMITED_FALSE,
        )
        spec.add_numeric(name=f"follower_{name}", data=[float(follower.axis), follower.ratio], size=2)
        found[own] = (name, data.xanchor[joint].copy())
    return found


def _moving(model: mujoco.MjModel, body: int, found: dict[int, tuple[str, Floats]]) -> int:
    """The body that carries this one rigidly, or itself; -1 where it is none of the arm."""
    while body not in found:
        if body == 0:
            return -1
        body = int(model.body_parentid[body])
    return body


def _add_shapes(
    spec: mujoco.MjSpec, file: RobotFile, data: mujoco.MjData, bodies: dict[int, tuple[str, Floats]], R: Floats
) -> int:
    """Add what collides of the arm to its links; how many shapes there are."""
    import mujoco

    model, kinds = file.model, mujoco.mjtGeom
    counts: dict[str, int] = {}
    for geom in range(model.ngeom):
        if not (model.geom_contype[geom] or model.geom_conaffinity[geom]):
            continue
        carrier = _moving(model, int(model.geom_bodyid[geom]), bodies)
        if carrier < 0 and model.geom_type[geom] == kinds.mjGEOM_PLANE:
            continue  # the file's floor; a cell has its own
        # Nothing but the six and what follows them moves: what stands beside or under the base stands with it.
        link, at = bodies[carrier if carrier >= 0 else model.body(file.base).id]
        name = f"{link}_{counts.get(link, 0)}"
        counts[link] = counts.get(link, 0) + 1
        turn, middle = R.T @ data.geom_xmat[geom].reshape(3, 3), R.T @ (data.geom_xpos[geom] - at)
        look = {"name": name, "group": 3, "rgba": [1.0, 0.35, 0.0, 1.0], "contype": 1, "conaffinity": 1}
        if int(model.geom_type[geom]) in (kinds.mjGEOM_BOX, kinds.mjGEOM_CYLINDER):
            quat = np.empty(4)
            mujoco.mju_mat2Quat(quat, np.ascontiguousarray(turn).ravel())
            kind = kinds(int(model.geom_type[geom]))
            spec.body(link).add_geom(type=kind, size=model.geom_size[geom], pos=middle, quat=quat, **look)
            continue
        vertices, faces = _triangles(file, geom)
        spec.add_mesh(
            name=name,
            uservert=(vertices @ turn.T + middle).ravel(),
            userface=faces.ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX,
        )
        spec.body(link).add_geom(type=kinds.mjGEOM_MESH, meshname=name, **look)
    return sum(counts.values())


def _triangles(file: RobotFile, geom: int) -> tuple[Floats, NDArray[np.int32]]:
    """A shape's vertices in its own frame [m], and faces; of a round one a polyhedron about it.

    Raises:
        SceneError: if it is of a kind that has none.
    """
    import mujoco
    from scipy.spatial import ConvexHull  # kept out of the start-up

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
        raise SceneError(
            f"{file.path} has a collision shape '{model.geom(geom).name}' of a kind that is no solid; use a mesh"
        )
    around, up = np.meshgrid(np.arange(_ROUND) * (2 * np.pi / _ROUND), np.linspace(-np.pi / 2, np.pi / 2, 13))
    points = np.stack([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)], axis=-1).reshape(-1, 3)
    points = np.unique(points.round(12), axis=0)
    points /= -ConvexHull(points).equations[:, 3].max()  # its faces touch the ball from outside
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


def _joined_by_a_bearing(spec: mujoco.MjSpec) -> list[tuple[str, str]]:
    """Each moving body with what carries it."""
    return [(body.name, body.parent.name) for body in spec.bodies if body.name not in ("world", "base")]
