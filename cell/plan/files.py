"""The artefacts of a plan's run folder, one function each. docs/internals/run_folder.md is their contract."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from pydantic import JsonValue

from cell.errors import FileError
from cell.files import model_file
from cell.part.workpiece import Workpiece
from cell.plan.connected_plan import ConnectedPlan
from cell.plan.report import markdown
from cell.robot import model as robot
from cell.robot.robot_file import mesh_files
from cell.runs.facts import (
    degrees,
    fixture_file,
    limits_deg,
    mm,
    resolved_fixtures,
    resolved_robot,
    resolved_table,
    sweep_values,
    table_values,
)
from cell.runs.folder import RunFolder
from cell.runs.run import split_axes
from cell.runs.schema import (
    NamedFile,
    PlanFile,
    PlanView,
    Report,
    ResolvedHousing,
    ResolvedPart,
    ResolvedPlan,
    ResolvedRegion,
    ResolvedScene,
    ScannerKeys,
)
from cell.scene.model import MeshFixture, Scene, with_rest
from cell.scene.settle import Settings
from cell.world.clearance import MotionClearance
from cell.world.files import write_mjcf
from cell.world.model import World
from planner.geometry.mesh import TriangleMesh
from planner.kinematics.reach import Reach
from planner.measurability.matrix import Measurability
from planner.ports import ARM_AXES
from planner.timing.motion import Motion
from planner.viewpoints.viewpoints import Viewpoints


def input_hashes(scene: Scene, part: Workpiece) -> dict[str, str]:
    """sha256 of what the plan depends on: the part and everything that the scene says (paths by their content)."""
    there = {"region": scene.region, "setup": scene.setup, "table": scene.table.enabled}
    content = scene.model_dump(mode="json", exclude={key for key, given in there.items() if not given})
    for region in content.get("region", ()):
        if region["painted"] is not None:
            region["painted"] = hashlib.sha256(Path(region["painted"]).read_bytes()).hexdigest()
    content["part"] = {"sha256": part.sha256, "units": scene.part.units}
    if scene.robot.model != robot.KR16:
        shas = [hashlib.sha256(path.read_bytes()).hexdigest() for path in _robot_files(scene)]
        content["robot"]["model"] = shas
    content["robot"]["packages"] = sorted(scene.robot.packages or ())
    for fixture in content["fixtures"]:
        if "path" in fixture:
            fixture["path"] = hashlib.sha256(Path(fixture["path"]).read_bytes()).hexdigest()
    text = json.dumps(content, sort_keys=True)
    return {"part": part.sha256, "scene": hashlib.sha256(text.encode()).hexdigest()}


def named_files(scene: Scene, scene_path: Path | None) -> tuple[NamedFile, ...]:
    """The files that the user named: the scene, the part, the robot with its meshes, meshes of fixtures."""
    named = [("scene", scene_path), ("part", scene.part.path)]
    named += [("robot", path) for path in _robot_files(scene)]
    named += [
        (f"fixture:{fixture.name}", fixture.path) for fixture in scene.fixtures if isinstance(fixture, MeshFixture)
    ]
    found = [(what, Path(path).absolute()) for what, path in named if path is not None]
    return tuple(
        NamedFile(what=what, path=str(path), sha256=hashlib.sha256(path.read_bytes()).hexdigest())
        for what, path in found
    )


def _robot_files(scene: Scene) -> list[Path]:
    """The robot's description and the meshes that it names; none of the robot that is built in."""
    if scene.robot.model == robot.KR16:
        return []
    path, packages = Path(scene.robot.model), scene.robot.packages or {}
    return [path, *mesh_files(path, {name: Path(folder) for name, folder in packages.items()})]


def write_scene(folder: RunFolder, scene_path: Path | None) -> None:
    """`scene.toml`: the scene file verbatim (the built-in one where none was given)."""
    path = scene_path if scene_path is not None else model_file("scene.toml")
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise FileError(f"the scene {path} cannot be read: {error.strerror or error}") from error
    folder.write_text("scene.toml", text)


def write_meshes(folder: RunFolder, reference: TriangleMesh, planning: TriangleMesh) -> None:
    """`reference.ply` and `planning.ply`: the meshes exactly as used."""
    folder.write_mesh("reference.ply", reference)
    folder.write_mesh("planning.ply", planning)


def write_viewpoints(folder: RunFolder, candidates: Viewpoints) -> None:
    """`viewpoints.npz`: the candidates."""
    folder.write_arrays(
        "viewpoints.npz",
        T_object_scanner=candidates.T_object_scanner,
        face=candidates.face,
        standoff=candidates.standoff,
        roll=candidates.roll,
    )


def write_cell(
    folder: RunFolder,
    scene: Scene,
    settings: Settings,
    part: Workpiece,
    planning_faces: int,
    world: World,
    scanner_parameters: Mapping[str, JsonValue],
) -> None:
    """`scene.resolved.json` and the MuJoCo model that is checked."""
    resolved = ResolvedScene(
        part=ResolvedPart(name=part.name, units=scene.part.units, sha256=part.sha256),
        T_base_object=world.T_base_object,
        T_object_centre=world.T_object_centre,
        T_flange_scanner=world.T_flange_scanner,
        scanner=ScannerKeys(**scanner_parameters),
        planning_resolution_deg=scene.scanner.planning_resolution_deg,
        housing=ResolvedHousing(
            size_mm=scene.housing.sides_mm,
            T_flange_housing=world.T_flange_housing,
            bracket_diameter_mm=scene.housing.bracket_mm,
        ),
        robot=resolved_robot(scene),
        table=resolved_table(scene, world),
        fixtures=resolved_fixtures(scene, world),
        home_deg=world.scene.robot.settled_home_deg,
        **limits_deg(world.limits),
        speed_scaling=scene.robot.speed_scaling,
        acceleration_scaling=scene.robot.acceleration_scaling,
        clearance_mm=scene.clearance_mm,
        arrival_mm=scene.arrival_mm,
        plan=ResolvedPlan.model_validate(
            dict(scene.plan)
            | {
                "faces": settings.faces,
                "planning_faces": planning_faces,
                "standoffs_mm": [mm(standoff) for standoff in settings.standoffs],
                "sphere_radius_mm": mm(settings.sphere_radius),
            }
        ),
        regions=tuple(ResolvedRegion.model_validate(dict(region)) for region in with_rest(scene.region)) or None,
    )
    folder.write_json("scene.resolved.json", resolved.as_json())
    for name in write_mjcf(world, folder.path):
        folder.adopt(name)
    for name, mesh in world.fixture_meshes.items():
        folder.write_mesh(fixture_file(name), mesh)


def write_reach(folder: RunFolder, reached: Reach) -> None:
    """`reach.npz`: verdicts and joint solutions."""
    folder.write_arrays(
        "reach.npz",
        verdict=reached.verdict,
        **split_axes(q=reached.q),
        offsets=reached.offsets,
        blocker=np.array(reached.blocker, dtype=np.str_),
    )


def write_measurability(folder: RunFolder, M: Measurability) -> None:
    """`measurability.npz`: the matrix with occluders applied, and its features."""
    features = M.samples
    folder.write_arrays(
        "measurability.npz",
        indptr=M.indptr,
        indices=M.indices,
        shape=np.array(M.shape, dtype=np.int64),
        points=features.points,
        normals=features.normals,
        areas=features.areas,
        face=features.face,
        planning_face=features.planning_face,
        **({} if M.sigma is None else {"sigma": M.sigma}),
        **({} if features.region is None else {"region": features.region}),
    )


def write_motion(folder: RunFolder, motion: Motion, measured: MotionClearance) -> None:
    """`motion.npz`: via points, samples, the limits used and the clearance of each segment."""
    folder.write_arrays(
        "motion.npz",
        **split_axes(via_q=motion.via_q),
        segment=motion.segment,
        view=motion.view,
        pose=motion.pose,
        line=motion.line,
        via_t=motion.via_t,
        t=motion.t,
        **split_axes(q=motion.q, qd=motion.qd, qdd=motion.qdd),
        segment_of_sample=motion.segment_of_sample,
        limit_lower=motion.limits.lower,
        limit_upper=motion.limits.upper,
        limit_velocity=motion.limits.velocity,
        limit_acceleration=motion.limits.acceleration,
        limit_jerk=motion.limits.jerk,
        minimum_clearance=measured.distance,
        clearance_at_least=measured.lower_bound,
        between=np.array(measured.between, dtype=np.str_),
    )


def write_plan(
    folder: RunFolder, report: Report, chosen: ConnectedPlan, candidates: Viewpoints, world: World
) -> PlanFile:
    """`plan.json`: the views in visiting order, with what is known about the selection; returns its content."""
    views = [
        PlanView(
            id=candidate,
            roll_deg=np.degrees(candidates.roll[candidate]).round(9),
            T_object_scanner=chosen.T_object_scanner[stop],
            T_base_scanner=chosen.T_base_scanner[stop],
            T_base_flange=chosen.T_base_flange[stop],
            q_deg=degrees(chosen.tour.q[stop][:ARM_AXES]),
            **table_values(world, chosen.tour.q[stop]),
            sweep=sweep_values(chosen.T_object_poses[stop], chosen.sweeps[stop]) if chosen.sweeps else None,
        )
        for stop, candidate in enumerate(chosen.candidate.tolist())
    ]
    said = {key: value for key, value in report if key in PlanFile.model_fields}
    plan = PlanFile(**said | {"views": views})
    folder.write_json("plan.json", plan.as_json())
    return plan


def write_report(folder: RunFolder, report: Report) -> None:
    """`report.json` and `report.md`."""
    folder.write_json("report.json", report.as_json())
    folder.write_text("report.md", markdown(report))
