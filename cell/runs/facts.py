"""Values of a run folder that follow from scene and motion: written with a plan, recomputed by its verification.

Millimetres and degrees, as the names of the keys state.
"""

from collections.abc import Sequence
from typing import Literal, TypedDict

import numpy as np

from cell.robot.model import KR16
from cell.runs.schema import ResolvedRobot, ResolvedTable, StandingFixture, Sweep
from cell.scene.model import BoxFixture, CylinderFixture, Fixture, Scene
from cell.world.model import World
from cell.world.shapes import TABLE
from planner.geometry.rigid import translation
from planner.path.sweeps import SweepPath
from planner.ports import ARM_AXES, JointLimits
from planner.values import Floats


class LimitsDeg(TypedDict):
    """Keys of scene.resolved.json for the limits of the axes."""

    joint_limits_deg: Sequence[tuple[float, float]]
    joint_velocity_limits_deg_s: Sequence[float]
    joint_acceleration_limits_deg_s2: Sequence[float]
    joint_jerk_limits_deg_s3: Sequence[float | None]


def limits_deg(limits: JointLimits) -> LimitsDeg:
    """Return the limits of the arm's axes [rad] in degrees, rounded to 1e-9."""
    lower, upper, velocity, acceleration, jerks = (
        values[:ARM_AXES] for values in (limits.lower, limits.upper, limits.velocity, limits.acceleration, limits.jerk)
    )
    return {
        "joint_limits_deg": np.degrees(np.stack([lower, upper], axis=1)).round(9).tolist(),
        "joint_velocity_limits_deg_s": np.degrees(velocity).round(9).tolist(),
        "joint_acceleration_limits_deg_s2": np.degrees(acceleration).round(9).tolist(),
        "joint_jerk_limits_deg_s3": [
            round(float(jerk), 9) if np.isfinite(jerk) else None for jerk in np.degrees(jerks)
        ],
    }


def resolved_fixtures(scene: Scene, world: World) -> list[StandingFixture]:
    """Return the obstacles of the cell: the fixtures of the scene, then post, pedestal and floor."""
    return [*(_fixture(fixture, world) for fixture in scene.fixtures), *_built_in(scene, world)]


def resolved_robot(scene: Scene) -> ResolvedRobot | None:
    """Return the robot of a scene; None for the built-in one at the origin."""
    model = scene.robot.model
    if model == KR16 and scene.robot.base is None:
        return None
    return ResolvedRobot(
        model="kr16" if model == KR16 else "robot.xml", name=scene.robot.name, T_base=scene.robot.T_base
    )


def resolved_table(scene: Scene, world: World) -> ResolvedTable | None:
    """Return the rotary table of a scene; None without one."""
    if world.table is None:
        return None
    fixed = {"post_mm"} if scene.table.position_mm is not None else set[str]()
    values = scene.table.model_dump(include=set(ResolvedTable.model_fields) - fixed)
    low, high = np.degrees([world.table.lower, world.table.upper]).round(9).tolist()
    return ResolvedTable(T_base_table=world.table.T_base_table, free_range_deg=(low, high), **values)


class TableValues(TypedDict, total=False):
    """Keys of a view that a rotary table adds."""

    e_deg: tuple[float, ...]
    T_base_object: Floats


def table_values(world: World, q: Floats) -> TableValues:
    """Return the table values of a view at (axes,) joint angles [rad]; empty without a table."""
    if world.table is None:
        return {}
    return {"e_deg": tuple(degrees(q[ARM_AXES:])), "T_base_object": world.T_base_part(q)}


def sweep_values(T_object_poses: Floats, path: SweepPath) -> Sweep:
    """Return the sweep of a line sensor at a view.

    Args:
        T_object_poses: (K, 4, 4) of the driven set-points [m], in the order of the candidate's poses.
        path: the driven line.
    """
    steady = float(path.profile.cruise)
    return Sweep(
        T_object_scanner=list(T_object_poses),
        q_deg=[degrees(q) for q in path.measured_q],
        from_q_deg=degrees(path.q[0]),
        to_q_deg=degrees(path.q[-1]),
        backwards=path.pose[path.pose >= 0][0] > 0,
        length_mm=mm(path.line.length),
        angle_deg=round(float(np.degrees(path.line.angle)), 9),
        speed_mm_s=round(mm(path.line.length / steady), 6) if steady > 0 else 0.0,
        speed_deg_s=round(float(np.degrees(path.line.angle / steady)), 6) if steady > 0 else 0.0,
        duration_s=path.duration,
    )


def degrees(q: Floats) -> list[float]:
    """Return set-points [rad] in degrees, as exact multiples of 1e-4."""
    return [float(round(value * 1e4) / 1e4) for value in np.degrees(q)]


def _built_in(scene: Scene, world: World) -> list[StandingFixture]:
    """Return post, table, pedestal and floor in the form of the scene's fixtures."""
    floor_mm = -scene.robot.pedestal_height_mm

    def standing(
        name: str, shape: Literal["box", "cylinder", "plane"], size_mm: list[float], middle_mm: list[float]
    ) -> StandingFixture:
        T = translation(np.array(middle_mm) / 1000)
        if name in ("post", TABLE) and world.table is not None:
            T[:3, :3] = world.table.T_base_table[:3, :3]
        return StandingFixture(
            name=name, shape=shape, size_mm=size_mm, pose=T, attached_to="base", occludes=True, built_in=True
        )

    fixtures = []
    if scene.post.enabled:
        T = world.T_base_post(world.T_base_object)
        x, y, top = (mm(value) for value in T[:3, 3])
        height, centre = top - floor_mm, [x, y, floor_mm + (top - floor_mm) / 2]
        if world.table is not None:
            height = mm(world.table.to_table_frame(T[:3, 3])[2])
            centre = [mm(value) for value in T[:3, 3] - T[:3, 2] * (height / 2000)]
        fixtures.append(standing("post", "cylinder", [scene.post.diameter_mm, height], centre))
    if world.table is not None:
        T, size_mm = world.table.T_base_table, [scene.table.diameter_mm, scene.table.height_mm]
        centre = [mm(value) for value in T[:3, 3] - T[:3, 2] * (size_mm[1] / 2000)]
        fixtures.append(standing(TABLE, "cylinder", size_mm, centre))
    if scene.robot.pedestal_mm is not None:
        size, middle = scene.robot.pedestal_mm
        fixtures.append(standing("pedestal", "box", list(size), list(middle)))
    fixtures.append(standing("floor", "plane", [], [0.0, 0.0, floor_mm]))
    return fixtures


def _fixture(fixture: Fixture, world: World) -> StandingFixture:
    if isinstance(fixture, BoxFixture | CylinderFixture):
        size_mm, pose, file, collision = list(fixture.size_mm), fixture.T, None, None
    else:  # its file has the triangles after the pose in the scene
        sides = np.ptp(world.fixture_meshes[fixture.name].vertices, axis=0)
        size_mm, pose, file = [mm(side) for side in sides], np.eye(4), fixture_file(fixture.name)
        collision = world.scene.plan.collision
    return StandingFixture(
        name=fixture.name,
        shape=fixture.shape,
        size_mm=size_mm,
        pose=pose,
        attached_to=fixture.attached_to,
        occludes=fixture.occludes,
        built_in=False,
        file=file,
        collision=collision,
    )


def fixture_file(name: str) -> str:
    """Return the name of the file with the triangles of a mesh fixture, in the frame that it is attached to."""
    return f"fixture_{name}.ply"


def mm(metres: float) -> float:
    """Return a length [m] in millimetres, rounded to 1e-9."""
    return round(float(metres) * 1000, 9)
