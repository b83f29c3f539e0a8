"""The scene that a run was planned in, as `Scene` again: from scene.resolved.json and the run's own files alone."""

from collections.abc import Collection, Mapping

import numpy as np

from cell.robot.frames import kuka_abc_from_pose
from cell.robot.model import KR16
from cell.run import reader as run_reader
from cell.run.record import RunRecord, artefact, understood
from cell.run.scene_json import ResolvedScene, StandingFixture
from cell.scene.options import BUILT_IN
from cell.scene.plan_settings import PlanKeys
from cell.scene.posed import Placement
from cell.scene.regions import Region
from cell.scene.scene import Scene
from planner.values import Floats


def scene_of_run(run: RunRecord, without: Collection[str] = ()) -> Scene:
    """The scene that a run was planned in, what it left open settled; its part is the run's own reference.ply.

    Args:
        run: a run folder.
        without: names of fixtures to leave out; "post" leaves out the post.

    Raises:
        FileError: if the run's files are damaged.
    """
    resolved = run_reader.scene(run)
    T_scanner_housing = np.linalg.inv(resolved.T_flange_scanner) @ resolved.housing.T_flange_housing
    left = [fixture for fixture in resolved.fixtures if fixture.name not in without]
    built_in = {fixture.name: fixture for fixture in left if fixture.built_in}
    pedestal, post = built_in.get("pedestal"), built_in.get("post")
    with understood(run.folder / "scene.resolved.json"):
        scene = Scene.model_validate(
            {
                "clearance_mm": resolved.clearance_mm,
                "plan": _plan(resolved),
                "robot": {
                    **_robot(run, resolved),
                    **_limits(resolved),
                    "home_deg": resolved.home_deg,
                    "pedestal_height_mm": round(-1000 * built_in["floor"].pose[2, 3], 9),
                    **({} if pedestal is None else {"pedestal_size_mm": pedestal.size_mm[:2]}),
                },
                "scanner": {"type": resolved.scanner.type, **resolved.scanner.own},
                "mount": _pose(resolved.T_flange_scanner),
                "housing": {
                    **_pose(T_scanner_housing),
                    "size_mm": resolved.housing.size_mm,
                    "bracket_diameter_mm": resolved.housing.bracket_diameter_mm,
                },
                "part": _part(run, resolved),
                "placement": _pose(resolved.T_base_object @ resolved.T_object_centre),
                "post": {"enabled": False} if post is None else {"diameter_mm": post.size_mm[0]},
                "table": _table(resolved),
                "fixtures": [
                    {**fixture.model_dump(include={"name", "shape", "attached_to", "occludes"}), **_place(run, fixture)}
                    for fixture in left
                    if not fixture.built_in
                ],
            }
        )
    # What the tables would not take beside what is settled: the resolution of planning is no key of every scanner, and
    # a percentage of the faces stands in no table beside their number.
    asked: dict[str, object] = {"planning_resolution_deg": resolved.planning_resolution_deg}
    if run.has("report.json"):
        asked["sensor"] = run_reader.report(run).settings.sensor
    return scene.model_copy(
        update={
            "part": scene.part.model_copy(update={"units": resolved.part.units}),
            "scanner": scene.scanner.model_copy(update=asked),
            "plan": scene.plan.model_copy(update={"percent_kept": resolved.plan.percent_kept}),
            # What they select by is in the run's mesh.
            "region": tuple(Region.model_construct(**dict(region)) for region in resolved.regions or ()),
        }
    )


def placed(scene: Scene, T_base_object: Floats, resolved: ResolvedScene) -> Scene:
    """A scene whose part stands elsewhere; what it stands on stays where it is.

    Args:
        scene: of a run.
        T_base_object: (4, 4) [m].
        resolved: what the run used.
    """
    update: dict[str, object] = {"placement": Placement.at(T_base_object @ resolved.T_object_centre)}
    if resolved.table is not None:
        update["table"] = scene.table.model_copy(update=_pose(resolved.table.T_base_table))
    return scene.model_copy(update=update)


def _plan(resolved: ResolvedScene) -> dict[str, object]:
    """The keys of `[plan]` that go together; what earlier versions took convex pieces for is taken as triangles."""
    left_out = {"percent_kept", "coverage" if resolved.plan.max_views is not None else ""}
    keys = {name: getattr(resolved.plan, name) for name in PlanKeys.model_fields if name not in left_out}
    return keys | {"collision": "hull" if resolved.plan.collision == "hull" else "exact"}


def _robot(run: RunRecord, resolved: ResolvedScene) -> dict[str, object]:
    """The keys of `[robot]` that say which one it is and where it stands."""
    if resolved.robot is None:
        return {}
    model: str = resolved.robot.model
    if model != KR16:
        artefact(run, model)  # checks that it is what the run wrote
        model = str((run.folder / model).absolute())
    upright = np.array_equal(resolved.robot.T_base, np.eye(4))
    return {"model": model, **({} if upright else {"base": _pose(resolved.robot.T_base)})}


def _table(resolved: ResolvedScene) -> Mapping[str, object]:
    """The keys of `[table]`; none where the part stands."""
    if resolved.table is None:
        return {}
    said = resolved.table.model_dump(exclude={"T_base_table", "post_mm", "turn_deg"})
    stands = _pose(resolved.table.T_base_table)
    if resolved.table.post_mm is not None:
        return {**said, "post_mm": resolved.table.post_mm, "abc_deg": stands["abc_deg"]}
    return {**said, **stands}


def _limits(resolved: ResolvedScene) -> dict[str, object]:
    """The keys of `[robot]` that say how fast the axes may be."""
    jerk = resolved.joint_jerk_limits_deg_s3 or (None,) * len(resolved.joint_limits_deg)
    return {
        "velocity_deg_s": resolved.joint_velocity_limits_deg_s,
        "acceleration_deg_s2": resolved.joint_acceleration_limits_deg_s2,
        "jerk_deg_s3": tuple(float("inf") if limit is None else limit for limit in jerk),
        "speed_scaling": resolved.speed_scaling,
        "acceleration_scaling": resolved.acceleration_scaling,
    }


def _part(run: RunRecord, resolved: ResolvedScene) -> dict[str, object]:
    """The keys of `[part]`: a built-in one by its name, another by the run's own mesh."""
    if resolved.part.units is None and resolved.part.name in BUILT_IN:
        return {"name": resolved.part.name}
    return {"path": str((run.folder / "reference.ply").absolute()), "units": resolved.part.units or "mm"}


def _place(run: RunRecord, fixture: StandingFixture) -> Mapping[str, object]:
    """The keys of a fixture that its shape has."""
    if fixture.file is None:
        return {**_pose(fixture.pose), "size_mm": fixture.size_mm}
    artefact(run, fixture.file)  # checks that it is what the run wrote
    # The file holds the mesh in the frame that it is attached to: the pose is in its vertices.
    return {"path": str((run.folder / fixture.file).absolute()), "units": "mm"}


def _pose(T: Floats) -> Mapping[str, tuple[float, ...]]:
    """The numbers of a pose without the dust of the conversion: those that a person gave come back."""
    position, abc = kuka_abc_from_pose(T)
    numbers = {"position_mm": (position * 1000).round(9) + 0.0, "abc_deg": np.degrees(abc).round(9) + 0.0}
    return {key: tuple(values.tolist()) for key, values in numbers.items()}
