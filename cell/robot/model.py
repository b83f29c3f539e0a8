"""The compiled model of a robot: axes, limits, home, dimensions, mimic joints, annotations; the KR 16's file.

Every number has one source, the *compiled* model: that of `models/kr16.xml`, or of an arm converted to its form
(`cell.robot.normalise`). The world frame of `kr16.xml` is the robot's base frame (KUKA $ROBROOT). Annotations are
numerics and texts of the MJCF, so that a run's `robot.xml` and `cell.xml` contain them too. MuJoCo is imported when a
model is needed, not with this module.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import NDArray

from cell.errors import FileError, SceneError
from cell.files import model_file
from planner.geometry.mesh import TriangleMesh
from planner.geometry.rigid import rigid_transform
from planner.kinematics.closed_form import Dimensions
from planner.ports import JointLimits
from planner.values import Floats, Ints, Value

if TYPE_CHECKING:
    import mujoco

KR16 = "kr16"
"""Name of the built-in robot."""

KR16_FILE = "kr16.xml"

AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
LINKS = ("base", "link_1", "link_2", "link_3", "link_4", "link_5", "link_6")
FLANGE = "flange"

WARNING_PREFIX = "doubt_"
"""Prefix of the names of texts with warnings about the robot's file, one sentence each."""

CLEARANCE_PREFIX = "keeps_"
"""Prefix of the names of numerics with the reduced clearance of two bodies."""

SEPARATION_PREFIX = "apart_"
"""Prefix of the names of numerics with the proven distance of two bodies."""

_TOOL = ("bracket", "housing")

# Axis directions at A1..A6 = 0, base frame, KUKA signs: the convention of planner.kinematics.closed_form.
_DIRECTIONS = np.array([[0, 0, -1], [0, 1, 0], [0, 1, 0], [-1, 0, 0], [0, 1, 0], [-1, 0, 0]], dtype=np.float64)
# Flange axes at A1..A6 = 0: z out of the face along +x of the base, x down.
_FLANGE_AT_ZERO = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], dtype=np.float64)
# Largest deviation of a model's axes for which the closed form, exact for ideal axes, is used [m and -].
_TOLERANCE = 1e-9

ROUNDED = 1e-4
"""Largest deviation of the axes of a KUKA arm whose file has rounded angles [m and -]."""


@dataclass(frozen=True, slots=True, eq=False)
class MimicJoints(Value):
    """Joints driven by the axes (levers, pistons): angle = ratio * angle of the axis.

    Attributes:
        axis: (k,) index of the driving axis, in the order of the joint values.
        ratio: (k,) -.
    """

    axis: Annotated[Ints, "k"]
    ratio: Annotated[Floats, "k"]

    @classmethod
    def from_model(cls, model: mujoco.MjModel) -> MimicJoints:
        """Return the mimic joints of a compiled model, whose joint values follow A1..A6."""
        rows = []
        for joint in range(len(AXES), model.njnt):
            numeric = f"follower_{model.body(model.jnt_bodyid[joint]).name}"
            try:
                axis, ratio = model.numeric(numeric).data
            except (KeyError, ValueError):
                raise SceneError(
                    f"the robot model's joint '{model.joint(joint).name}' is none of A1..A6; add a numeric named "
                    f"'{numeric}' with the 0-based number of its driving axis and the ratio"
                ) from None
            rows.append((int(axis), float(ratio)))
        return cls(np.array([axis for axis, _ in rows], dtype=np.int64), np.array([ratio for _, ratio in rows]))

    def qpos(self, q: Floats) -> Floats:
        """Return (..., nq) joint values for axis angles q (..., 6) [rad]."""
        return np.concatenate([q, q[..., self.axis] * self.ratio], axis=-1) if len(self.axis) else q


def bodies(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the names of the robot's bodies: base, links, bodies of mimic joints."""
    driven = (model.body(model.jnt_bodyid[joint]).name for joint in range(len(AXES), model.njnt))
    return (*LINKS, *driven)


def spec() -> mujoco.MjSpec:
    """Return the specification of the KR 16 alone, which can be attached to a cell."""
    import mujoco

    path = model_file(KR16_FILE)
    try:
        return mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        raise FileError(f"{path} cannot be read as an MJCF; install scan-cell again") from error


def load() -> mujoco.MjModel:
    """Return the compiled model of the KR 16 alone."""
    try:
        return spec().compile()
    except ValueError as error:
        raise FileError(f"{model_file(KR16_FILE)} does not compile; install scan-cell again") from error


def limits(model: mujoco.MjModel) -> JointLimits:
    """Return the ranges, speeds, accelerations and jerks of A1..A6.

    Args:
        model: compiled model whose joints are named A1..A6 and whose <custom> holds `axis_velocity_limit_deg_s`,
            `axis_acceleration_limit_deg_s2` and `axis_jerk_limit_deg_s3`.
    """
    joints = _joints(model)
    if not model.jnt_limited[joints].all():
        raise SceneError("a joint of the robot model has no range; give each of A1..A6 its range")
    lower, upper = model.jnt_range[joints].T
    return JointLimits(
        lower=lower,
        upper=upper,
        velocity=np.deg2rad(_numeric(model, "axis_velocity_limit_deg_s")),
        acceleration=np.deg2rad(_numeric(model, "axis_acceleration_limit_deg_s2")),
        jerk=np.deg2rad(_numeric(model, "axis_jerk_limit_deg_s3")),
    )


def home(model: mujoco.MjModel) -> Floats:
    """Return the joint angles (6,) [rad] of the key `home` in a compiled model of the robot alone."""
    import mujoco

    key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, "home")
    if key < 0:
        raise SceneError("the robot model has no key named home; give robot.home_deg")
    return np.array(model.key_qpos[key][model.jnt_qposadr[_joints(model)]])


def dimensions(model: mujoco.MjModel, tolerance: float = _TOLERANCE) -> Dimensions | None:
    """Return the lengths of an arm with the KR 16's axis directions, measured in the compiled model at A1..A6 = 0.

    Args:
        model: compiled model with joints A1..A6 and a site `flange`, the robot's base in its world's origin.
        tolerance: largest deviation of the axes [m and -].

    Returns:
        None if `KukaKinematics` does not apply: other signs, zeros or offsets.
    """
    import mujoco

    joints = _joints(model)
    if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, FLANGE) < 0:
        raise SceneError(f"the robot model has no site named {FLANGE}; add it")
    data = mujoco.MjData(model)
    data.qpos[model.jnt_qposadr[joints]] = 0.0
    mujoco.mj_kinematics(model, data)
    anchors, site = data.xanchor[joints], data.site(FLANGE)
    anchors[[1, 2, 4], 1] = 0.0  # a file may name any point of an axis
    shoulder, elbow, forearm, wrist = anchors[1], anchors[2], anchors[3], anchors[4]
    misses = (
        np.abs(anchors[0, :2]).max(),  # A1 passes through the origin
        np.abs(data.xaxis[joints] - _DIRECTIONS).max(),
        np.abs([forearm[1], site.xpos[1]]).max(),  # all in the plane y = 0
        abs(elbow[2] - shoulder[2]),
        max(abs(forearm[2] - wrist[2]), np.abs(anchors[5, 1:] - wrist[1:]).max()),  # A4, A5 and A6 meet in one point
        abs(site.xpos[2] - wrist[2]),  # the flange is on A6, its z along it
        np.abs(site.xmat.reshape(3, 3) - _FLANGE_AT_ZERO).max(),
    )
    if max(misses) > tolerance:
        return None
    return Dimensions(
        d1=float(shoulder[2]),
        a1=float(shoulder[0]),
        a2=float(elbow[0] - shoulder[0]),
        a3=float(forearm[2] - elbow[2]),
        d4=float(wrist[0] - elbow[0]),
        d6=float(site.xpos[0] - wrist[0]),
    )


def mesh_of(model: mujoco.MjModel, geom: int) -> TriangleMesh:
    """Return the triangles of a mesh geom in the frame of its body [m]."""
    import mujoco

    mesh = int(model.geom_dataid[geom])
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    start, number = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    R = np.empty(9)
    mujoco.mju_quat2Mat(R, model.geom_quat[geom])
    vertices = model.mesh_vert[first : first + count] @ R.reshape(3, 3).T + model.geom_pos[geom]
    return TriangleMesh(vertices, model.mesh_face[start : start + number].astype(np.int32))


def _joints(model: mujoco.MjModel) -> NDArray[Any]:
    """Return the ids (6,) of A1..A6."""
    import mujoco

    ids = np.array([mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, axis) for axis in AXES])
    missing = [axis for axis, joint in zip(AXES, ids, strict=True) if joint < 0]
    if missing:
        raise SceneError(f"the robot model has no joint named {missing[0]}; its six hinges must be named A1..A6")
    if (model.jnt_type[ids] != mujoco.mjtJoint.mjJNT_HINGE).any():
        raise SceneError("a joint of the robot model is not a hinge; A1..A6 must be six hinges")
    return ids


def _numeric(model: mujoco.MjModel, name: str) -> Floats:
    """Return the values (6,) of a <custom><numeric>."""
    import mujoco

    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, name)
    if index < 0 or model.numeric_size[index] != len(AXES):
        raise SceneError(f"the robot model has no <custom><numeric> named {name} with six values; add it")
    start = model.numeric_adr[index]
    return np.array(model.numeric_data[start : start + len(AXES)])


def override_limits(
    model: JointLimits,
    velocity_deg_s: Sequence[float] | None = None,
    acceleration_deg_s2: Sequence[float] | None = None,
    jerk_deg_s3: Sequence[float] | None = None,
) -> JointLimits:
    """Replace limits of the robot model by those of a scene; the joint ranges stay the model's.

    Omitted limits follow the given ones: the acceleration changes with the speed, so that an axis reaches it in the
    same time (0.5 s for the KR 16), and the jerk with the acceleration (0.1 s).

    Args:
        model: limits of the robot model.
        velocity_deg_s: (6,) axis speeds [deg/s]; None: the model's.
        acceleration_deg_s2: (6,) axis accelerations [deg/s^2]; None: follows the speed.
        jerk_deg_s3: (6,) axis jerks [deg/s^3], inf: not limited; None: follows the acceleration.
    """
    velocity = model.velocity if velocity_deg_s is None else np.radians(velocity_deg_s)
    acceleration = (
        model.acceleration * (velocity / model.velocity)
        if acceleration_deg_s2 is None
        else np.radians(acceleration_deg_s2)
    )
    jerk = model.jerk * (acceleration / model.acceleration) if jerk_deg_s3 is None else np.radians(jerk_deg_s3)
    return replace(model, velocity=velocity, acceleration=acceleration, jerk=jerk)


def model_warnings(spec: mujoco.MjSpec) -> list[str]:
    """Return the warnings about the robot's file, one sentence each."""
    return [text.data for text in spec.texts if text.name.startswith(WARNING_PREFIX)]


def reduced_clearances(model: mujoco.MjModel) -> dict[tuple[int, int], float]:
    """Return the pairs of geoms with a smaller clearance than the cell's, and that clearance [m]."""
    clearances = {}
    for number in range(model.nnumeric):
        if not model.numeric(number).name.startswith(CLEARANCE_PREFIX):
            continue
        one, other = (model.body(name) for name in named_pair(model, number))
        for a in range(one.geomadr[0], one.geomadr[0] + one.geomnum[0]):
            for b in range(other.geomadr[0], other.geomadr[0] + other.geomnum[0]):
                clearances[a, b] = clearances[b, a] = float(model.numeric(number).data[0])
    return clearances


def clearance_name(model: mujoco.MjModel, one: str, other: str) -> str:
    """Return the name of the numeric with the clearance [m] of two bodies that are always near each other."""
    return f"{CLEARANCE_PREFIX}{_number(model, one)}_{_number(model, other)}"


def frame_of(element: Any) -> Floats:
    """Return the pose (4, 4) [m] of a body, a shape or a site of a state (`MjData.body(...)`)."""
    return rigid_transform(element.xmat.reshape(3, 3), element.xpos)


def separation_name(model: mujoco.MjModel, one: str, other: str) -> str:
    """Return the name of the numeric with the proven distance [m] at all angles of two unchecked links."""
    return f"{SEPARATION_PREFIX}{_number(model, one)}_{_number(model, other)}"


def named_pair(model: mujoco.MjModel, numeric: int) -> tuple[str, str]:
    """Return the two bodies in the name of a clearance or separation numeric."""
    one, other = model.numeric(numeric).name.split("_")[1:]
    names = (*bodies(model), *_TOOL)
    return names[int(one)], names[int(other)]


def _number(model: mujoco.MjModel, body: str) -> int:
    return (*bodies(model), *_TOOL).index(body)
