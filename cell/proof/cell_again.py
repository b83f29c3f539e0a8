"""The cell compiled again from scene.resolved.json, the part and this version's robot model, against what was checked.

What the files say twice must agree: the scene's transforms, sizes and limits with the model that they give, and that
model, shape by shape, with `cell.xml`. So neither file can be changed alone, and a plan of another robot model is told.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cell.proof.artefacts import refuse
from cell.proof.compare import difference
from cell.robot import model as robot
from cell.run.plan_facts import limits_deg, resolved_table, standing_fixtures
from cell.runs.cell import scene_of_run, world_of
from cell.runs.run import Run, reading
from cell.runs.schema import ResolvedScene
from cell.world.model import World
from cell.world.shapes import quaternion
from planner.ports import ARM_AXES
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco

_NEAR = 1e-8  # m, and of a quaternion's entries
_DIRECTIONS = np.random.default_rng(0).standard_normal((64, 3))  # in which hulls are compared


def compiled(run: Run, resolved: ResolvedScene) -> World:
    """The cell of a run, compiled again and found to be the one that was checked.

    Raises:
        FileError: if the run's files do not describe one and the same cell.
    """
    path = run.folder / "scene.resolved.json"
    with reading(path):
        scene = scene_of_run(run)
        world = world_of(run, run.mesh("reference.ply"))
        occluding = {fixture.name: fixture.occludes for fixture in resolved.fixtures}
        standing = [
            each.model_copy(update={"occludes": occluding.get(each.name, True)})
            for each in standing_fixtures(scene, world)
        ]
        due = resolved.model_copy(
            update={
                "T_base_object": world.T_base_object,
                "T_object_centre": world.T_object_centre,
                "T_flange_scanner": world.T_flange_scanner,
                "housing": resolved.housing.model_copy(update={"T_flange_housing": world.T_flange_housing}),
                "fixtures": tuple(standing),
                "table": resolved_table(scene, world),
                "joint_limits_deg": tuple((low, high) for low, high in limits_deg(world.limits)["joint_limits_deg"]),
            }
        )
        if key := difference(resolved, due):
            refuse(path, f"contradicts itself, or the part, at {key}")
        fastest = np.asarray(limits_deg(robot.limits(world.model))["joint_velocity_limits_deg_s"])
        if (np.asarray(resolved.joint_velocity_limits_deg_s) > fastest + 1e-6).any():
            refuse(path, "has joint_velocity_limits_deg_s above those of the robot model")
    if what := _other_shape(run.cell_model(), world):
        refuse(
            run.folder / "cell.xml", f"is not the cell of scene.resolved.json with this version's robot model: {what}"
        )
    return world


def _other_shape(checked: mujoco.MjModel, world: World) -> str:
    """What differs between the model that was checked and the one compiled again; "" for nothing."""
    again = world.model
    placed = {"object": world.T_base_object, "post": world.T_base_post(world.T_base_object)}
    if (checked.nbody, checked.ngeom, checked.njnt) != (again.nbody, again.ngeom, again.njnt):
        return "it has other bodies, shapes or axes"
    if not np.array_equal(np.sort(checked.exclude_signature), np.sort(again.exclude_signature)):
        return "it guards other pairs"
    for number in range(again.nbody):
        one, two = checked.body(number), again.body(number)
        pos, turned = two.pos, _at_reference(checked, again, number)
        if (T := placed.get(two.name)) is not None:  # mocap bodies stand at their placement in the file
            pos, turned = T[:3, 3], quaternion(T[:3, :3])
        if one.name != two.name or one.parentid != two.parentid or _apart(one.pos, pos) or _turned(one.quat, turned):
            return f"the body '{two.name}' is elsewhere"
    for number in range(again.njnt):
        one, two = checked.joint(number), again.joint(number)
        values = (one.axis, two.axis), (one.pos, two.pos), (one.range, two.range)
        if one.name != two.name or one.bodyid != two.bodyid or any(_apart(*pair) for pair in values):
            return f"the axis '{two.name}' is another"
    for number in range(again.ngeom):
        one, two = checked.geom(number), again.geom(number)
        kinds = [(each.name, *each.type, *each.bodyid, *each.contype, *each.conaffinity) for each in (one, two)]
        if kinds[0] != kinds[1] or _apart(one.margin, two.margin):
            return f"the shape '{two.name}' is another"
        same = not (_apart(one.pos, two.pos) or _turned(one.quat, two.quat) or _apart(one.size, two.size))
        if two.dataid[0] >= 0:
            same = not _apart(_support(checked, number), _support(again, number), 1e-6)
        if not same:
            return f"the shape '{two.name}' has another place or size"
    home = checked.key("home").qpos
    return "home is elsewhere" if _apart(home, world.followers.qpos(world.home[:ARM_AXES])) else ""


def _apart(one: Floats, two: Floats, near: float = _NEAR) -> bool:
    return bool((np.abs(np.asarray(one) - np.asarray(two)) > near).any())


def _turned(one: Floats, two: Floats) -> bool:
    return bool(abs(abs(float(np.dot(one, two))) - 1.0) > _NEAR)


def _at_reference(checked: mujoco.MjModel, again: mujoco.MjModel, body: int) -> Floats:
    """(4,) how a body of `again` is turned at the reference angle of its joint in `checked`: home."""
    import mujoco

    quat = np.array(again.body_quat[body])
    if again.body_jntnum[body]:
        joint = again.body_jntadr[body]
        turn, turned = np.empty(4), np.empty(4)
        mujoco.mju_axisAngle2Quat(turn, again.jnt_axis[joint], float(checked.qpos0[joint] - again.qpos0[joint]))
        mujoco.mju_mulQuat(turned, quat, turn)
        quat = turned
    return quat


def _support(model: mujoco.MjModel, geom: int) -> Floats:
    """How far a mesh's hull reaches in each of some directions, in the frame of its body [m]."""
    import mujoco

    mesh = model.geom(geom).dataid[0]
    begin, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    R = np.empty(9)
    mujoco.mju_quat2Mat(R, model.geom_quat[geom])
    vertices = model.mesh_vert[begin : begin + count] @ R.reshape(3, 3).T + model.geom_pos[geom]
    return np.asarray((vertices @ _DIRECTIONS.T).max(axis=0))
