"""The arm as a dynamic model: its file with drives, tool and the load of a rotary table (docs/internals/plant.md).

The model file is compiled twice: for planning as it is (`cell.robot.model`), and here with gravity, reflected rotor
inertias, friction and torque limits of the drives, and without collision shapes: collision is checked during planning.
Hard stops are omitted because they lie beyond the limits that the controller checks. World of the model = the robot's
base frame (KUKA $ROBROOT), with the base on level ground; SI units.

The link masses and the four drive parameters of the KR 16 are estimates: models/README.md describes their origin. A
file without them is no dynamic model.

**Tool.** Data sheets give a sensor's mass more often than a scene does, so the masses follow from the collision shapes,
each with one density. Laser line sensors weigh 0.7 to 1.4 kg per litre of their housing (LJ-V7200 0.55 kg in
42 x 230 x 77 mm, Gocator 2350 1.3 kg in 49 x 75 x 272 mm, Gocator 2330 0.74 kg in 49 x 75 x 142 mm); the bracket is an
aluminium bar.

**Load of a rotary table.** The axis is upright: no weight acts on the drive. The table is one hinge beside the arm,
without a connection to it. The inertia is that of the collision shapes (part and mesh fixtures as their hulls) of solid
steel, with a faceplate of the table's diameter: more than that of a hollow part. The drive parameters are assumptions
for the class of positioners of the default table (models/README.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np

from cell.errors import FileError, SceneError
from cell.robot import model as robot
from cell.robot.model import mesh_of
from cell.robot.refusals import describe_refusal
from planner.kinematics.rotary_table import RotaryTable
from planner.ports import axis_name
from planner.values import Floats, Value

if TYPE_CHECKING:
    import mujoco

TOOL_DENSITY = {"housing": 1300.0, "bracket": 2700.0}
"""Mean densities [kg/m^3]."""


@dataclass(frozen=True, slots=True, eq=False)
class ToolBody(Value):
    """A rigid body on the flange.

    Attributes:
        name: for messages.
        mass: [kg].
        inertia: (3,) principal moments about the centre of mass [kg m^2].
        position: (3,) centre of mass, flange frame [m].
        quaternion: (4,) principal axes, flange frame: w, x, y, z.
        reach: largest distance of a point from the centre of mass [m].
    """

    name: str
    mass: float
    inertia: Annotated[Floats, "3"]
    position: Annotated[Floats, "3"]
    quaternion: Annotated[Floats, "4"]
    reach: float


@dataclass(frozen=True, slots=True, eq=False)
class Tool:
    """The bodies on the flange, possibly none."""

    bodies: tuple[ToolBody, ...] = ()

    @property
    def reach(self) -> float:
        """Upper bound on the distance of a point from the flange's centre [m]."""
        return max((float(np.linalg.norm(body.position)) + body.reach for body in self.bodies), default=0.0)


def tool_of(model: mujoco.MjModel) -> Tool:
    """Return the tool of a compiled cell, such as a run's `cell.xml`.

    Args:
        model: with a box `housing` and optionally a cylinder `bracket`, on bodies in the flange frame.
    """
    names = {model.geom(i).name: i for i in range(model.ngeom)}
    if "housing" not in names:
        raise SceneError("the cell's model has no shape named housing; the plant needs it for the scanner's mass")
    return Tool(tuple(_tool_body(model, name, names[name]) for name in TOOL_DENSITY if name in names))


def _tool_body(model: mujoco.MjModel, name: str, geom: int) -> ToolBody:
    import mujoco

    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
        size = 2.0 * model.geom_size[geom]
        mass = TOOL_DENSITY[name] * float(size.prod())
        inertia = mass / 12.0 * ((size**2).sum() - size**2)
        reach = float(np.linalg.norm(size)) / 2.0
    elif model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CYLINDER:
        radius, half = (float(x) for x in model.geom_size[geom][:2])
        mass = TOOL_DENSITY[name] * np.pi * radius**2 * 2.0 * half
        across = mass * (3.0 * radius**2 + 4.0 * half**2) / 12.0
        inertia = np.array([across, across, mass * radius**2 / 2.0])
        reach = float(np.hypot(radius, half))
    else:
        raise SceneError(f"the shape {name} of the cell's model is neither box nor cylinder; its mass is unknown")
    return ToolBody(name, float(mass), inertia, model.geom_pos[geom], model.geom_quat[geom], reach)


STEEL_DENSITY = 7850.0
"""Density of steel [kg/m^3]."""

FACEPLATE_THICKNESS = 0.02
"""Thickness of the faceplate [m]."""


@dataclass(frozen=True, slots=True)
class TableLoad:
    """Load and drive of a rotary table.

    Attributes:
        inertia: of everything on the table, about its axis [kg m^2].
        reach: largest distance of a point from the axis [m].
        rotor_inertia: of the motor, reflected through the gear [kg m^2].
        torque: largest torque [Nm].
        coulomb: friction independent of speed [Nm].
        viscous: friction proportional to speed [Nm s/rad].
    """

    inertia: float
    reach: float
    rotor_inertia: float = 20.0
    torque: float = 1000.0
    coulomb: float = 20.0
    viscous: float = 10.0


def table_load_of(model: mujoco.MjModel, table: RotaryTable, diameter: float) -> TableLoad:
    """Return the load of the table in a compiled cell, such as a run's `cell.xml`.

    Args:
        model: with part, post and the part's fixtures at angle 0.
        table: of the cell.
        diameter: of its face [m].
    """
    import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    bodies = {model.body(name).id for name in ("object", "post")}
    inertia = STEEL_DENSITY * np.pi * FACEPLATE_THICKNESS * (diameter / 2) ** 4 / 2
    reach = diameter / 2
    for geom in np.flatnonzero([int(body) in bodies for body in model.geom_bodyid]):
        points, volume, moment, centre = _solid(model, data, int(geom))
        offset = table.to_table_frame(centre)[:2]
        inertia += STEEL_DENSITY * (moment + volume * float(offset @ offset))
        reach = max(reach, float(np.linalg.norm(table.to_table_frame(points)[:, :2], axis=1).max()))
    return TableLoad(float(inertia), reach)


def _solid(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> tuple[Floats, float, float, Floats]:
    """Return a solid shape in base [m]: points, volume, moment about the vertical through its centre, centre."""
    import mujoco
    import trimesh

    T = robot.frame_of(data.geom(geom))
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
        solid = trimesh.creation.box(2.0 * model.geom_size[geom], T)
    elif model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CYLINDER:
        radius, half = model.geom_size[geom][:2]
        solid = trimesh.creation.cylinder(radius, 2.0 * half, transform=T, sections=64)
    else:
        T = robot.frame_of(data.body(int(model.geom_bodyid[geom])))
        solid = trimesh.convex.convex_hull(mesh_of(model, geom).vertices).apply_transform(T)
    return np.asarray(solid.vertices), float(solid.volume), float(solid.moment_inertia[2, 2]), solid.center_mass


_REMEDY = "add it, or use the ideal arm: sim://"

Integrator = Literal["Euler", "implicitfast"]


def compile_dynamic_arm(
    tool: Tool,
    spec: mujoco.MjSpec | None = None,
    *,
    table: TableLoad | None = None,
    mass_scale: float = 1.0,
    friction_scale: float = 1.0,
    stiffness: Floats | None = None,
    damping: Floats | None = None,
    time_step: float = 1e-3,
    integrator: Integrator = "implicitfast",
) -> mujoco.MjModel:
    """Compile the dynamic arm.

    Each axis has an actuator with the torque `ctrl - stiffness q - damping qd`, within the torque limits; `ctrl` then
    implements a proportional and derivative servo whose damping the implicit integrator knows.

    Args:
        tool: on the flange.
        spec: of the robot alone; None: the built-in one.
        table: rotary table, the last axis; None: none.
        mass_scale: factor on the masses and inertias of links, tool and table load, not of the rotors.
        friction_scale: factor on the friction independent of speed.
        stiffness: (axes,) position gain of the actuators [Nm/rad]; None: torque alone.
        damping: (axes,) speed gain of the actuators [Nm s/rad]; None: torque alone.
        time_step: of the simulation [s].
        integrator: MuJoCo's name.

    Raises:
        FileError: if the model is missing or invalid, or lacks masses or drive parameters.
    """
    import mujoco

    spec = robot.spec() if spec is None else spec.copy()
    flange = _compiled(spec.copy()).site(robot.FLANGE)
    rotor_inertia, torque_limit = _numbers(spec, "axis_rotor_inertia_kg_m2"), _numbers(spec, "axis_torque_limit_Nm")
    coulomb, viscous = _numbers(spec, "axis_coulomb_friction_Nm"), _numbers(spec, "axis_viscous_friction_Nm_s_rad")
    for element in [*spec.excludes, *spec.geoms]:
        spec.delete(element)
    last = spec.body(robot.LINKS[-1])
    for body in tool.bodies:
        added = last.add_body(name=body.name, pos=flange.pos, quat=flange.quat)
        added.explicitinertial, added.mass, added.inertia = True, body.mass, body.inertia
        added.ipos, added.iquat = body.position, body.quaternion
    names = list(robot.AXES)
    if table is not None:
        names.append(_add_table(spec, table))
        rotor_inertia = np.append(rotor_inertia, table.rotor_inertia)
        torque_limit = np.append(torque_limit, table.torque)
        coulomb, viscous = np.append(coulomb, table.coulomb), np.append(viscous, table.viscous)
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
    # An error must be detected, not replaced by a reset state.
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET | mujoco.mjtDisableBit.mjDSBL_CONTACT)
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE  # MuJoCo 4.0.0 has a bug in its sparse Cholesky
    model = _compiled(spec)
    if mass_scale != 1.0:
        model.body_mass[:] *= mass_scale
        model.body_inertia[:] *= mass_scale
        mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def _add_table(spec: mujoco.MjSpec, table: TableLoad) -> str:
    """Add a vertical hinge beside the arm, at 0 in the key home; return its name."""
    import mujoco

    name = axis_name(len(robot.AXES))
    body = spec.worldbody.add_body(name=name)
    body.explicitinertial, body.mass, body.ipos = True, 1.0, np.zeros(3)
    body.inertia = np.full(3, table.inertia)  # it rotates about one axis only
    body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])
    home = spec.key("home")
    home.qpos = np.append(home.qpos, 0.0)
    return name


def mass_matrix(model: mujoco.MjModel, q: Floats) -> Floats:
    """Return the joint-space inertia (axes, axes) [kg m^2] at joint angles q (axes,) [rad], rotors included."""
    import mujoco

    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    return M


def lever_arms(model: mujoco.MjModel, tool: Tool, table: TableLoad | None = None) -> Floats:
    """Return upper bounds (axes,) on the motion of a point of tool or part per radian of each axis [m/rad], any pose.

    The bound is the sum of the link lengths from the axis to the farthest point of the tool.
    """
    import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    anchors = np.vstack([data.xanchor[: len(robot.AXES)], data.site(robot.FLANGE).xpos])
    lengths = np.linalg.norm(np.diff(anchors, axis=0), axis=1)
    bounds: Floats = np.cumsum(lengths[::-1])[::-1] + tool.reach
    return bounds if table is None else np.append(bounds, table.reach)


def _compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    try:
        return spec.compile()
    except ValueError as error:
        raise FileError(f"the arm's model has no dynamics ({describe_refusal(error)}); {_REMEDY}") from error


def _numbers(spec: mujoco.MjSpec, name: str) -> Floats:
    """Return the values (6,) of a <custom><numeric>."""
    numeric = spec.numeric(name)
    values = np.array([] if numeric is None else numeric.data, dtype=np.float64)
    if len(values) != len(robot.AXES) or not (values >= 0.0).all():
        raise FileError(f"the arm's model has no <numeric> named {name} with six values of at least 0; {_REMEDY}")
    return values
