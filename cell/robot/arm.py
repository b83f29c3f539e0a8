"""Kinematics of a compiled robot model, and the positions of its wrist."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cell.errors import SceneError, errors_as
from cell.robot.model import AXES, FLANGE, dimensions, frame_of, limits, load
from planner.errors import PlannerError
from planner.geometry.rigid import inverse_rigid
from planner.kinematics.closed_form import KukaKinematics
from planner.kinematics.fit import ArmKinematics, Chain, axis_rotations, nearest_point
from planner.ports import Kinematics
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco


def kr16_kinematics() -> KukaKinematics:
    """Return the kinematics of models/kr16.xml."""
    model = load()
    arm = dimensions(model)
    assert arm is not None, "models/kr16.xml is not a KR 16"
    return KukaKinematics(arm, limits(model))


def kinematics_of(model: mujoco.MjModel) -> Kinematics:
    """Return the kinematics of a compiled model of the robot, alone or in its cell.

    Args:
        model: joints A1 to A6, a site `flange` and the axes' limits.

    Raises:
        SceneError: if a joint, a limit or the flange is missing, or no closed form solves the arm.
    """
    arm = dimensions(model)
    if arm is not None:
        return KukaKinematics(arm, limits(model))
    with errors_as(SceneError, PlannerError):
        return ArmKinematics(chain_of(model), limits(model))


def chain_of(model: mujoco.MjModel) -> Chain:
    """Return the axes of a compiled model and its flange at all angles zero."""
    import mujoco

    data = mujoco.MjData(model)
    data.qpos[:] = 0.0  # a cell.xml opens at home
    mujoco.mj_kinematics(model, data)
    joints = [model.joint(axis).id for axis in AXES]
    return Chain(data.xaxis[joints].copy(), data.xanchor[joints].copy(), frame_of(data.site(FLANGE)))


def wrist_positions(model: mujoco.MjModel, T_base: Floats, step: float) -> tuple[Floats, Floats]:
    """Return sampled wrist positions: distances from the A1 axis, negative behind it, and heights above the base [m].

    The wrist is the intersection of axes 5 and 6. Axes 2 and 3 pass through their ranges, and axis 4 if it moves the
    wrist.

    Args:
        model: the compiled robot, alone or in its cell.
        T_base: (4, 4) pose of its base [m].
        step: between angles [rad].
    """
    chain, joint_limits = chain_of(model), limits(model)
    wrist = nearest_point(chain.directions[4:], chain.points[4:])
    offset = np.cross(wrist - chain.points[3], chain.directions[3])
    swept = [1, 2] if float(np.linalg.norm(offset)) < 1e-6 else [1, 2, 3]
    span = np.minimum(joint_limits.upper - joint_limits.lower, 2 * np.pi)[swept]
    step = step if len(swept) == 2 else 4 * step
    low = joint_limits.lower[swept]
    grid = np.meshgrid(*(np.linspace(a, a + s, int(s / step) + 1) for a, s in zip(low, span, strict=True)))
    positions = np.broadcast_to(wrist, (grid[0].size, 3))
    for axis, angles in reversed(list(zip(swept, grid, strict=True))):
        relative = positions - chain.points[axis]
        rotations = axis_rotations(chain.directions[axis], angles.ravel())
        positions = (rotations @ relative[..., None])[..., 0] + chain.points[axis]
    up = chain.directions[0] if chain.directions[0] @ T_base[:3, 2] > 0 else -chain.directions[0]
    ahead = np.cross(chain.directions[1], up)
    ahead /= np.linalg.norm(ahead)
    relative = positions - chain.points[0]
    forward, aside = relative @ ahead, relative @ np.cross(up, ahead)  # aside: of an arm beside its A1 axis
    return np.copysign(np.hypot(forward, aside), forward), (positions - T_base[:3, 3]) @ T_base[:3, 2]


def wrist_in_flange(model: mujoco.MjModel) -> Floats:
    """Return the intersection (3,) of axes 5 and 6 in the flange frame [m]; no joint moves it there."""
    chain = chain_of(model)
    wrist = np.append(nearest_point(chain.directions[4:], chain.points[4:]), 1.0)
    return np.asarray((inverse_rigid(chain.T_zero) @ wrist)[:3])
