"""A robot's compiled model: what it says about axes, home pose, dimensions and what follows the axes; the KR 16's file.

Every number is read from the *compiled* model, that of `models/kr16.xml` or of an arm that was brought into its form
(`cell.robot.normalised`), so that it stands in one place. World of `kr16.xml` is the robot's base frame (KUKA
$ROBROOT). MuJoCo is imported when a model is asked for, not with this module.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import NDArray

from cell.errors import FileError, SceneError
from planner.ports import JointLimits
from planner.values import Floats, Ints, Value

if TYPE_CHECKING:
    import mujoco

KR16 = "kr16"
"""Name of the robot that is built in."""

AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
LINKS = ("base", "link_1", "link_2", "link_3", "link_4", "link_5", "link_6")
FLANGE = "flange"


# Axis directions at A1..A6 = 0, base frame, in KUKA's signs: what cell.robot.kinematics is derived for.
_DIRECTIONS = np.array([[0, 0, -1], [0, 1, 0], [0, 1, 0], [-1, 0, 0], [0, 1, 0], [-1, 0, 0]], dtype=np.float64)
# Flange axes at A1..A6 = 0: z out of the face along +x of the base, x down.
_FLANGE_AT_ZERO = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], dtype=np.float64)
# How far a model's axes may be off before the closed form, exact for ideal axes only, would be wrong [m and -].
_TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Followers(Value):
    """Joints that the axes drive along (levers, pistons): angle = ratio * the axis'.

    Attributes:
        axis: (k,) index of the axis that drives each, in the order of the joint values.
        ratio: (k,) -.
    """

    axis: Annotated[Ints, "k"]
    ratio: Annotated[Floats, "k"]

    @classmethod
    def of(cls, model: mujoco.MjModel) -> Followers:
        """Those of a compiled model, whose joint values come after A1..A6.

        Raises:
            SceneError: if a joint is none of A1..A6 and nothing says what drives it.
        """
        rows = []
        for joint in range(len(AXES), model.njnt):
            numeric = f"follower_{model.body(model.jnt_bodyid[joint]).name}"
            try:
                axis, ratio = model.numeric(numeric).data
            except (KeyError, ValueError):
                raise SceneError(
                    f"the robot model's joint '{model.joint(joint).name}' is none of A1..A6; give a numeric named "
                    f"'{numeric}' with the number of the axis that drives it, from 0, and the ratio"
                ) from None
            rows.append((int(axis), float(ratio)))
        return cls(np.array([axis for axis, _ in rows], dtype=np.int64), np.array([ratio for _, ratio in rows]))

    def qpos(self, q: Floats) -> Floats:
        """(..., nq) all joint values for (..., 6) angles of the axes [rad]."""
        return np.concatenate([q, q[..., self.axis] * self.ratio], axis=-1) if len(self.axis) else q


@dataclass(frozen=True, slots=True)
class Dimensions:
    """The six lengths of a KUKA arm with a spherical wrist [m], all in the plane y = 0 at A1..A6 = 0.

    Attributes:
        d1: foot to A2 axis, up.
        a1: A1 axis to A2 axis, forward.
        a2: A2 axis to A3 axis.
        a3: A3 axis to A4 axis, up when the forearm is level (negative: A4 runs below A3).
        d4: A3 axis to wrist centre, along A4.
        d6: wrist centre to flange face.
        b: sideways offset of forearm and wrist, along y.
    """

    d1: float
    a1: float
    a2: float
    a3: float
    d4: float
    d6: float
    b: float = 0.0


def bodies(model: mujoco.MjModel) -> tuple[str, ...]:
    """Names of the robot's bodies: base, links, and what is driven along."""
    driven = (model.body(model.jnt_bodyid[joint]).name for joint in range(len(AXES), model.njnt))
    return (*LINKS, *driven)


def model_file(name: str = "kr16.xml") -> Path:
    """Path of a file of `models/`: inside the installed package, or beside the package in a development tree.

    Args:
        name: file name inside models/.

    Raises:
        FileError: if it is in neither place.
    """
    package = Path(str(resources.files("cell")))
    candidates = (package / "models" / name, package.parent / "models" / name)
    for path in candidates:
        if path.is_file():
            return path
    raise FileError(
        f"the file {name} is missing: neither {candidates[0]} nor {candidates[1]} exists; install scan-cell again"
    )


def spec() -> mujoco.MjSpec:
    """The robot alone, editable: attach it to a cell, then compile.

    Raises:
        FileError: if the model file is missing or is not an MJCF.
    """
    import mujoco

    path = model_file()
    try:
        return mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        raise FileError(f"{path} cannot be read as an MJCF: {error}; install scan-cell again") from error


def load() -> mujoco.MjModel:
    """The robot alone, compiled.

    Raises:
        FileError: if the model file is missing or does not compile.
    """
    try:
        return spec().compile()
    except ValueError as error:
        raise FileError(f"{model_file()} does not compile: {error}; install scan-cell again") from error


def limits(model: mujoco.MjModel) -> JointLimits:
    """Ranges, speeds, accelerations and jerks of A1..A6.

    Args:
        model: compiled model whose joints are named A1..A6 and whose <custom> holds `axis_velocity_limit_deg_s`,
            `axis_acceleration_limit_deg_s2` and `axis_jerk_limit_deg_s3`.

    Raises:
        SceneError: if a joint, its range or one of the three numerics is missing.
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
    """The `home` key.

    Args:
        model: compiled model of the robot alone.

    Returns:
        (6,) joint angles [rad], KUKA signs.

    Raises:
        SceneError: if the model has no key of that name.
    """
    import mujoco

    key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, "home")
    if key < 0:
        raise SceneError("the robot model has no key named home; give robot.home_deg")
    return np.array(model.key_qpos[key][model.jnt_qposadr[_joints(model)]])


def dimensions(model: mujoco.MjModel) -> Dimensions | None:
    """Lengths of an arm that stands and turns as the KR 16 does, read off the compiled model at A1..A6 = 0.

    Args:
        model: compiled model with joints A1..A6 and a site `flange`, the robot's base in its world's origin.

    Returns:
        None where the closed form of `cell.robot.kinematics` is not for it: other signs, zeros or offsets.

    Raises:
        SceneError: if a joint or the flange is missing.
    """
    import mujoco

    joints = _joints(model)
    if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, FLANGE) < 0:
        raise SceneError(f"the robot model has no site named {FLANGE}; give it one")
    data = mujoco.MjData(model)
    data.qpos[model.jnt_qposadr[joints]] = 0.0
    mujoco.mj_kinematics(model, data)
    anchors, site = data.xanchor[joints], data.site(FLANGE)
    shoulder, elbow, forearm, wrist = anchors[1], anchors[2], anchors[3], anchors[4]
    misses = (
        np.abs(anchors[0, :2]).max(),  # A1 runs through the origin
        np.abs(data.xaxis[joints] - _DIRECTIONS).max(),
        np.abs([shoulder[1], elbow[1], forearm[1], wrist[1], site.xpos[1]]).max(),  # all in the plane y = 0
        abs(elbow[2] - shoulder[2]),
        max(abs(forearm[2] - wrist[2]), np.abs(anchors[5, 1:] - wrist[1:]).max()),  # A4, A5 and A6 meet in one point
        abs(site.xpos[2] - wrist[2]),  # the flange is on A6, its z along it
        np.abs(site.xmat.reshape(3, 3) - _FLANGE_AT_ZERO).max(),
    )
    if max(misses) > _TOLERANCE:
        return None
    return Dimensions(
        d1=float(shoulder[2]),
        a1=float(shoulder[0]),
        a2=float(elbow[0] - shoulder[0]),
        a3=float(forearm[2] - elbow[2]),
        d4=float(wrist[0] - elbow[0]),
        d6=float(site.xpos[0] - wrist[0]),
    )


def _joints(model: mujoco.MjModel) -> NDArray[Any]:
    """(6,) ids of A1..A6."""
    import mujoco

    ids = np.array([mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, axis) for axis in AXES])
    missing = [axis for axis, joint in zip(AXES, ids, strict=True) if joint < 0]
    if missing:
        raise SceneError(f"the robot model has no joint named {missing[0]}; its six hinges must be named A1..A6")
    if (model.jnt_type[ids] != mujoco.mjtJoint.mjJNT_HINGE).any():
        raise SceneError("a joint of the robot model is not a hinge; A1..A6 must be six hinges")
    return ids


def _numeric(model: mujoco.MjModel, name: str) -> Floats:
    """(6,) values of a <custom><numeric>."""
    import mujoco

    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, name)
    if index < 0 or model.numeric_size[index] != len(AXES):
        raise SceneError(f"the robot model has no <custom><numeric> named {name} with six values; add it")
    start = model.numeric_adr[index]
    return np.array(model.numeric_data[start : start + len(AXES)])
