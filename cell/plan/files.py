"""Artefacts and plots of the run folder of a plan, one function each; see docs/internals/run_folder.md."""

import hashlib
import json
import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cell import scanners
from cell.errors import SceneError
from cell.files import file_errors, model_file
from cell.inspect.artefacts import FEATURES, QIF_SOURCE
from cell.part.workpiece import Workpiece
from cell.plan.candidates import CandidateSet, MeasuredSet, PlanSession
from cell.plan.motion import ConnectedPlan
from cell.plan.selection import SelectionProblem
from cell.report.plan_report import markdown
from cell.robot import model as robot
from cell.robot.arm import wrist_positions
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
from cell.runs.run import Run, split_axes
from cell.runs.schema import (
    NamedFile,
    PlanFile,
    PlanResult,
    PlanView,
    Report,
    ResolvedHousing,
    ResolvedPart,
    ResolvedPlan,
    ResolvedRegion,
    ResolvedScene,
    ScannerKeys,
)
from cell.scene.features import Inspection
from cell.scene.fields import Table
from cell.scene.file import load_scene
from cell.scene.model import MeshFixture, Scene, with_rest
from cell.scene.settle import SettledScene
from cell.world.clearance import MotionClearance
from cell.world.files import write_mjcf
from cell.world.model import World
from planner.geometry.mesh import TriangleMesh
from planner.kinematics.reach import Reach
from planner.measurability.matrix import Measurability
from planner.ports import ARM_AXES
from planner.timing.motion import Motion
from planner.viewpoints.viewpoints import Viewpoints

_ENVELOPE_STEP = np.radians(2.0)  # of the axes, for the envelope of the wrist
_PATH_STEPS = 12  # of the scanner's path between two via points


def input_hashes(scene: Scene, part: Workpiece) -> dict[str, str]:
    """Return the sha256 of the inputs of a plan: the part, and the scene with files by their content."""
    optional = {"region": scene.region, "setup": scene.setup, "table": scene.table.enabled}
    optional |= {"feature": scene.feature, "inspection": scene.inspection != Inspection()}
    content = scene.model_dump(mode="json", exclude={key for key, value in optional.items() if not value})
    for region in content.get("region", ()):
        if region["painted"] is not None:
            region["painted"] = hashlib.sha256(Path(region["painted"]).read_bytes()).hexdigest()
    if scene.inspection.qif is not None:
        content["inspection"]["qif"] = hashlib.sha256(Path(scene.inspection.qif).read_bytes()).hexdigest()
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
    """Return the files that the user named: scene, part, robot with its meshes, meshes of fixtures."""
    files = [("scene", scene_path), ("part", scene.part.path), ("qif", scene.inspection.qif)]
    files += [("robot", path) for path in _robot_files(scene)]
    files += [
        (f"fixture:{fixture.name}", fixture.path) for fixture in scene.fixtures if isinstance(fixture, MeshFixture)
    ]
    paths = [(what, Path(path).absolute()) for what, path in files if path is not None]
    return tuple(
        NamedFile(role=what, path=str(path), sha256=hashlib.sha256(path.read_bytes()).hexdigest())
        for what, path in paths
    )


def overridden_keys(scene: Scene, path: Path | None) -> tuple[str, ...] | None:
    """Return the keys of a scene that differ from its file, such as "placement.position_mm", in the order of the scene.

    Keys of `[plan]` and `[picture]` are left out: no verification depends on them. None if the file alone is no valid
    scene, as the copy in a run folder whose part is elsewhere.

    Args:
        scene: with the options of the command.
        path: the scene file; None: the built-in scene.
    """
    try:
        stated, keys = load_scene(path), list[str]()
    except SceneError:
        return None
    for name in Scene.model_fields:
        one, other = getattr(scene, name), getattr(stated, name)
        if isinstance(one, Table) and name not in ("plan", "picture"):
            fields = type(one).model_fields
            keys += [f"{name}.{key}" for key in fields if getattr(one, key) != getattr(other, key)]
        elif not isinstance(one, Table) and one != other:
            keys.append(name)
    return tuple(keys)


def _robot_files(scene: Scene) -> list[Path]:
    """Return the robot's description and its meshes; none for the built-in robot."""
    if scene.robot.model == robot.KR16:
        return []
    path, packages = Path(scene.robot.model), scene.robot.packages or {}
    return [path, *mesh_files(path, {name: Path(folder) for name, folder in packages.items()})]


def write_scene(folder: RunFolder, scene_path: Path | None) -> None:
    """Write `scene.toml`: the scene file verbatim, or the built-in one."""
    path = scene_path if scene_path is not None else model_file("scene.toml")
    with file_errors(f"the scene {path} cannot be read"):
        text = path.read_text(encoding="utf-8")
    folder.write_text("scene.toml", text)


def write_meshes(folder: RunFolder, reference: TriangleMesh, planning: TriangleMesh) -> None:
    """Write `reference.ply` and `planning.ply`: the meshes exactly as used."""
    folder.write_mesh("reference.ply", reference)
    folder.write_mesh("planning.ply", planning)


def write_viewpoints(folder: RunFolder, candidates: Viewpoints) -> None:
    """Write `viewpoints.npz`: the candidates."""
    folder.write_arrays(
        "viewpoints.npz",
        T_object_scanner=candidates.T_object_scanner,
        face=candidates.face,
        standoff=candidates.standoff,
        roll=candidates.roll,
    )


def write_cell(folder: RunFolder, settled: SettledScene, planning: TriangleMesh, world: World) -> None:
    """Write `scene.resolved.json` and the MuJoCo model of the collision checker."""
    scene, settings, part = settled.scene, settled.settings, settled.part
    resolved = ResolvedScene(
        part=ResolvedPart(name=part.name, units=scene.part.units, sha256=part.sha256),
        T_base_object=world.T_base_object,
        T_object_centre=world.T_object_centre,
        T_flange_scanner=world.T_flange_scanner,
        scanner=ScannerKeys(**scanners.describe(scene.scanner.type, settled.scanner)),
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
        path_tolerance_mm=scene.path_tolerance_mm,
        plan=ResolvedPlan.model_validate(
            dict(scene.plan)
            | {
                "faces": settings.faces,
                "planning_faces": len(planning.faces),
                "standoffs_mm": [mm(standoff) for standoff in settings.standoffs],
                "sphere_radius_mm": mm(settings.sphere_radius),
            }
        ),
        regions=tuple(ResolvedRegion.model_validate(dict(region)) for region in with_rest(scene.region)) or None,
    )
    folder.write_json("scene.resolved.json", resolved.as_json())
    with file_errors(f"the model of the cell cannot be written to {folder.path}"):
        names = write_mjcf(world, folder.path)
    for name in names:
        folder.adopt(name)
    for name, mesh in world.fixture_meshes.items():
        folder.write_mesh(fixture_file(name), mesh)


def write_reach(folder: RunFolder, reached: Reach) -> None:
    """Write `reach.npz`: verdicts and configurations."""
    folder.write_arrays(
        "reach.npz",
        verdict=reached.verdict,
        **split_axes(q=reached.q),
        offsets=reached.offsets,
        blocker=np.array(reached.blocker, dtype=np.str_),
    )


def write_measurability(folder: RunFolder, M: Measurability) -> None:
    """Write `measurability.npz`: the matrix with occluders applied, and its samples."""
    samples = M.samples
    folder.write_arrays(
        "measurability.npz",
        indptr=M.indptr,
        indices=M.indices,
        shape=np.array(M.shape, dtype=np.int64),
        points=samples.points,
        normals=samples.normals,
        areas=samples.areas,
        face=samples.face,
        planning_face=samples.planning_face,
        **({} if M.sigma is None else {"sigma": M.sigma}),
        **({} if samples.region is None else {"region": samples.region}),
    )


def write_motion(folder: RunFolder, motion: Motion, measured: MotionClearance) -> None:
    """Write `motion.npz`: via points, samples, limits and the clearance of each segment."""
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
        clearance_lower_bound=measured.lower_bound,
        between=np.array(measured.between, dtype=np.str_),
    )


def write_plan(
    folder: RunFolder, report: Report, plan: ConnectedPlan, candidates: Viewpoints, world: World
) -> PlanFile:
    """Write `plan.json`: the views in visiting order and the selection; return its content."""
    views = [
        PlanView(
            id=candidate,
            roll_deg=np.degrees(candidates.roll[candidate]).round(9),
            T_object_scanner=plan.T_object_scanner[stop],
            T_base_scanner=plan.T_base_scanner[stop],
            T_base_flange=plan.T_base_flange[stop],
            q_deg=degrees(plan.tour.q[stop][:ARM_AXES]),
            **table_values(world, plan.tour.q[stop]),
            sweep=sweep_values(plan.driven.T_object_poses[stop], plan.driven.sweeps[stop])
            if plan.driven.sweeps
            else None,
        )
        for stop, candidate in enumerate(plan.candidate.tolist())
    ]
    file = PlanFile(**{key: value for key, value in report if key in PlanResult.model_fields}, views=views)
    folder.write_json("plan.json", file.as_json())
    return file


def write_report(folder: RunFolder, report: Report, section: Sequence[str] = ()) -> None:
    """Write `report.json` and `report.md`, with a further section if there is one."""
    folder.write_json("report.json", report.as_json())
    folder.write_text("report.md", "\n".join([markdown(report), *section]))


def write_candidates(folder: RunFolder, settled: SettledScene, candidates: CandidateSet) -> None:
    """Write viewpoints and reach of candidates that are not measured yet."""
    write_viewpoints(folder, scanners.sweep_columns(settled.scanner, candidates.viewpoints))
    write_reach(folder, candidates.reached)


def write_measured(folder: RunFolder, measured: MeasuredSet, before: MeasuredSet | None = None) -> None:
    """Write candidates, reach and matrix; only those that differ from earlier ones if these are given."""
    if before is None or measured.candidates is not before.candidates:
        write_viewpoints(folder, measured.candidates)
    if before is None or measured.reached is not before.reached:
        write_reach(folder, measured.reached)
    if before is None or measured.M is not before.M:
        write_measurability(folder, measured.M)


def copy_meshes(folder: RunFolder, run: Run) -> None:
    """Copy the meshes of another run, and the features of its part, to the byte."""
    for name in ("reference.ply", "planning.ply", *filter(run.has, (FEATURES, QIF_SOURCE))):
        shutil.copyfile(run.folder / name, folder.path / name)
        folder.adopt(name)


def queue_views(session: PlanSession, settled: SettledScene, problem: SelectionProblem, plan: ConnectedPlan) -> None:
    """Queue the plots that need no timed motion: part and views, cell, cover curve, candidates by verdict."""
    plots, folder, cover, world = session.plots, session.folder.path, plan.cover, problem.world
    picture = settled.scene.picture
    plots.send(
        "part_and_views", folder / "views.png", T_object_poses=plan.driven.T_object_poses,
        T_object_scanner=plan.T_object_scanner, seen=plan.driven.seen,
    )  # fmt: skip
    via, steps = plan.tour.via, np.linspace(0, 1, _PATH_STEPS)[None, :, None]
    q = (via[:-1, None] + steps * np.diff(via, axis=0)[:, None]).reshape(-1, via.shape[1])
    plots.send(
        "cell_with_arm", folder / "cell.png", q=plan.tour.q, T_base_scanner=plan.T_base_scanner,
        source_path=(world.in_base(q, problem.cell.kinematics.forward(q)) @ world.T_flange_scanner)[:, :3, 3],
        camera_deg=picture.camera_deg or (), hide=picture.hide,
    )  # fmt: skip
    plots.send(
        "cover_curve", folder / "cover.png", marginal_area=cover.marginal_area, coverable=cover.coverable_area,
        total=cover.total_area, lower_bound=cover.lower_bound,
    )  # fmt: skip
    corners = np.array(np.meshgrid(*settled.part.bounds.T)).reshape(3, -1).T
    T = np.linalg.inv(world.scene.robot.T_base) @ world.T_base_object  # the plot is in the frame of the robot
    plots.send(
        "reach_map", folder / "reach.png", T_base_scanner=T @ problem.candidates.T_object_scanner[:, 0],
        verdict=problem.reached.verdict, part_corners=corners @ T[:3, :3].T + T[:3, 3], views=plan.candidate,
        envelope=np.stack(wrist_positions(world.model, world.scene.robot.T_base, _ENVELOPE_STEP), axis=1),
    )  # fmt: skip


def queue_motion(session: PlanSession, motion: Motion) -> None:
    """Queue the plot of joint angles and speeds."""
    session.plots.send(
        "joint_motion", session.folder.path / "motion.png", t=motion.t, q=motion.q, qd=motion.qd,
        limit=motion.limits.velocity, stops=motion.via_t[motion.stops],
    )  # fmt: skip


def finish_page(session: PlanSession, report: Report, plan: PlanFile, motion: Motion, world: World) -> None:
    """Wait for the plots, and complete the page with views, motion and numbers."""
    # The page's modules are kept out of the start-up.
    from cell.runs.next_commands import commands_of
    from cell.view.page import second_half
    from cell.view.run_pages import PAGE_FILE, PARTIAL_PAGE_FILE, plan_contents

    commands = commands_of(report, world, world.scene.robot.name)
    second = second_half(plan_contents(report, plan.views, motion, world.T_base_object, commands))
    adopt_plots(session)
    half = session.folder.path / PARTIAL_PAGE_FILE
    session.folder.write_text(PAGE_FILE, half.read_text(encoding="utf-8") + second)
    half.unlink()


def adopt_plots(session: PlanSession) -> None:
    """Wait for the plots, and record them in the run folder."""
    for path in session.plots.finish():
        session.folder.adopt(path.name)
