"""The arm as a dynamic model: its file, with its drives and a tool, and without what dynamics does not need.

The same model is compiled twice: for planning as it is (`cell.robot.model`), and here with gravity, the drives'
reflected rotor inertia, friction and torque limits, and without collision shapes: whether a path is free is decided
when it is planned. Hard stops are left out, since they lie beyond the limits that the controller checks. World of the
model = the robot's base frame (KUKA $ROBROOT), the foot on level ground; SI units.

Of the KR 16 the masses of the links, and all four figures of the drives, are estimates: models/README.md says how they
were made. A file that lacks them is no dynamic model.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from cell.errors import FileError
from cell.plant.tool import Tool
from cell.plant.turned import Turned
from cell.robot import model as robot
from planner.ports import axis_name
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco

_INSTEAD = "add what it lacks, or let the ideal arm move: sim://"

Integrator = Literal["Euler", "implicitfast"]


def arm(
    tool: Tool,
    spec: mujoco.MjSpec | None = None,
    *,
    turned: Turned | None = None,
    mass_scale: float = 1.0,
    friction_scale: float = 1.0,
    stiffness: Floats | None = None,
    damping: Floats | None = None,
    time_step: float = 1e-3,
    integrator: Integrator = "implicitfast",
) -> mujoco.MjModel:
    """Compile the dynamic arm.

    Its actuators, one an axis, give the torque `ctrl - stiffness q - damping qd`, held within the torque limits; a
    proportional and derivative servo is then a matter of `ctrl`, and the implicit integrator knows its damping.

    Args:
        tool: what the flange carries.
        spec: of the robot alone; None: the built-in one.
        turned: by a rotary table, its hinge the last axis; None: there is none.
        mass_scale: factor on the masses and inertias of links, tool and what is turned, not on the rotors'.
        friction_scale: factor on the friction that does not depend on speed.
        stiffness: (axes,) position gain of the actuators [Nm/rad]; None: torque alone.
        damping: (axes,) speed gain of the actuators [Nm s/rad]; None: torque alone.
        time_step: of the simulation [s].
        integrator: MuJoCo's name of it.

    Raises:
        FileError: if the model is missing, damaged or lacks masses or the figures of the drives.
    """
    import mujoco

    spec = robot.spec() if spec is None else spec.copy()
    flange = _compiled(spec.copy()).site(robot.FLANGE)
    rotor_inertia, torque_limit = _numbers(spec, "axis_rotor_inertia_kg_m2"), _numbers(spec, "axis_torque_limit_Nm")
    coulomb, viscous = _numbers(spec, "axis_coulomb_friction_Nm"), _numbers(spec, "axis_viscous_friction_Nm_s_rad")
    for element in [*spec.excludes, *spec.geoms]:
        spec.delete(element)
    last = spec.body(robot.LINKS[-1])
    for piece in tool.pieces:
        carried = last.add_body(name=piece.name, pos=flange.pos, quat=flange.quat)
        carried.explicitinertial, carried.mass, carried.inertia = True, piece.mass, piece.inertia
        carried.ipos, carried.iquat = piece.position, piece.quaternion
    names = list(robot.AXES)
    if turned is not None:
        names.append(_add_table(spec, turned))
        rotor_inertia = np.append(rotor_inertia, turned.rotor_inertia)
        torque_limit = np.append(torque_limit, turned.torque)
        coulomb, viscous = np.append(coulomb, turned.coulomb), np.append(viscous, turned.viscous)
    for i, axis in enumerate(names):
        joint = spec.joint(axis)
        joint.limited = False
        joint.armature, joint.damping[0] = rotor_inertia[i], viscous[i]
        joint.frictionloss = friction_scale * coulomb[i]
        actuator = spec.add_actuator(name=axis, target=axis, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        actuator.gainprm[0], actuator.biastype = 1.0, mujoco.mjtBias.mjBIAS_AFFINE
        actuator.biasprm[1] = 0.0 if stiffness is None else -stiffness[i]
        actuator.biasprm[2] = 0.0 if damping is None else -damping[i]
        actuator.forcelimited, actuator.forcerange = True, [-torque_limit[i], torque_limit[i]]
    spec.option.timestep = time_step
    spec.option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator.upper()}")
    # What went wrong has to be seen, not replaced by a fresh state.
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET | mujoco.mjtDisableBit.mjDSBL_CONTACT)
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE  # MuJoCo 4.0.0 has a bug in its sparse Cholesky
    model = _compiled(spec)
    if mass_scale != 1.0:
        model.body_mass[:] *= mass_scale
        model.body_inertia[:] *= mass_scale
        mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def _add_table(spec: mujoco.MjSpec, turned: Turned) -> str:
    """An upright hinge beside the arm, and its name; home has it at 0."""
    import mujoco

    name = axis_name(len(robot.AXES))
    body = spec.worldbody.add_body(name=name)
    body.explicitinertial, body.mass, body.ipos = True, 1.0, np.zeros(3)
    body.inertia = np.full(3, turned.inertia)  # it turns about one axis only
    body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])
    home = spec.key("home")
    home.qpos = np.append(home.qpos, 0.0)
    return name


def mass_matrix(model: mujoco.MjModel, q: Floats) -> Floats:
    """(axes, axes) joint-space inertia [kg m^2] at (axes,) joint angles [rad], rotors included."""
    import mujoco

    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    return M


def levers(model: mujoco.MjModel, tool: Tool, turned: Turned | None = None) -> Floats:
    """(axes,) how far any point of tool or part moves at most when an axis turns by one radian, in any pose [m/rad].

    The links' lengths from the axis to the tool's farthest point, added up: no pose stretches the arm more than that.
    """
    import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    anchors = np.vstack([data.xanchor[: len(robot.AXES)], data.site(robot.FLANGE).xpos])
    lengths = np.linalg.norm(np.diff(anchors, axis=0), axis=1)
    reached: Floats = np.cumsum(lengths[::-1])[::-1] + tool.reach
    return reached if turned is None else np.append(reached, turned.reach)


def _compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    try:
        return spec.compile()
    except ValueError as error:  # of several lines
        raise FileError(f"the arm's model has no dynamics ({' '.join(str(error).split())}); {_INSTEAD}") from error


def _numbers(spec: mujoco.MjSpec, name: str) -> Floats:
    """(6,) values of a <custom><numeric>."""
    numeric = spec.numeric(name)
    values = np.array([] if numeric is None else numeric.data, dtype=np.float64)
    if len(values) != len(robot.AXES) or not (values >= 0.0).all():
        raise FileError(f"the arm's model has no <numeric> named {name} with six values of at least 0; {_INSTEAD}")
    return values
