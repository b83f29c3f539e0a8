"""The artefacts of a plan's run folder, one function each. docs/run_folder.md is their contract."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import JsonValue

from cell.errors import FileError
from cell.part.workpiece import Workpiece
from cell.plan.report import markdown
from cell.plan.view_plan import ConnectedPlan
from cell.robot import model as robot
from cell.run.folder import RunFolder
from cell.run.plan_json import PlanFile, PlanView, Sweep
from cell.run.report_json import Report
from cell.run.scene_json import (
    ResolvedHousing,
    ResolvedPart,
    ResolvedPlan,
    ResolvedScene,
    ScannerKeys,
    StandingFixture,
)
from cell.scene.resolve import Settings
from cell.scene.scene import BoxFixture, CylinderFixture, Fixture, Scene
from cell.world.clearance import MotionClearance
from cell.world.files import write_mjcf
from cell.world.model import World
from planner.measurability.matrix import Measurability
from planner.order.tour import Tour
from planner.reach.reach import Reach
from planner.surface.mesh import TriangleMesh
from planner.timing.motion import Motion
from planner.values import Floats
from planner.viewpoints.viewpoints import Viewpoints


def input_hashes(scene: Scene, part: Workpiece) -> dict[str, str]:
    """sha256 of what the plan depends on: the part and everything that the scene says (paths by their content)."""
    content = scene.model_dump(mode="json")
    content["part"] = {"sha256": part.sha256, "units": scene.part.units}
    for fixture in content["fixtures"]:
        if "path" in fixture:
            fixture["path"] = hashlib.sha256(Path(fixture["path"]).read_bytes()).hexdigest()
    text = json.dumps(content, sort_keys=True)
    return {"part": part.sha256, "scene": hashlib.sha256(text.encode()).hexdigest()}


def write_scene(folder: RunFolder, scene_path: Path | None) -> None:
    """`scene.toml`: the scene file verbatim (the built-in one where none was given)."""
    path = scene_path if scene_path is not None else robot.model_file("scene.toml")
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
    limits = world.limits
    resolved = ResolvedScene(
        part=ResolvedPart(name=part.name, units=scene.part.units, sha256=part.sha256),
        T_base_object=world.T_base_object,
        T_object_centre=world.T_object_centre,
        T_flange_scanner=world.T_flange_scanner,
        scanner=ScannerKeys(**scanner_parameters),
        planning_resolution_deg=scene.scanner.planning_resolution_deg,
        housing=ResolvedHousing(
            size_mm=scene.housing.size_mm,
            T_flange_housing=world.T_flange_housing,
            bracket_diameter_mm=scene.housing.bracket_diameter_mm,
        ),
        fixtures=[*(_fixture(fixture, world) for fixture in scene.fixtures), *_built_in(scene, world)],
        home_deg=scene.robot.home_deg,
        joint_limits_deg=np.degrees(np.stack([limits.lower, limits.upper], axis=1)).round(9).tolist(),
        joint_velocity_limits_deg_s=np.degrees(limits.velocity).round(9).tolist(),
        joint_acceleration_limits_deg_s2=np.degrees(limits.acceleration).round(9).tolist(),
        joint_jerk_limits_deg_s3=[
            round(float(jerk), 9) if np.isfinite(jerk) else None for jerk in np.degrees(limits.jerk)
        ],
        speed_scaling=scene.robot.speed_scaling,
        acceleration_scaling=scene.robot.acceleration_scaling,
        clearance_mm=scene.clearance_mm,
        arrival_mm=scene.arrival_mm,
        plan=ResolvedPlan.model_validate(
            dict(scene.plan)
            | {
                "faces": settings.faces,
                "planning_faces": planning_faces,
                "standoffs_mm": [_mm(standoff) for standoff in settings.standoffs],
                "sphere_radius_mm": _mm(settings.sphere_radius),
            }
        ),
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
        q=reached.q,
        offsets=reached.offsets,
        blocker=np.array(reached.blocker, dtype=np.str_),
    )


def write_measurability(folder: RunFolder, M: Measurability) -> None:
    """`measurability.npz`: the matrix with occluders applied, and its features."""
    features = M.features
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
    )


def write_motion(folder: RunFolder, motion: Motion, tour: Tour, measured: MotionClearance) -> None:
    """`motion.npz`: via points, samples, the limits used and the clearance of each segment."""
    folder.write_arrays(
        "motion.npz",
        via_q=motion.via_q,
        segment=motion.segment,
        view=motion.view,
        pose=motion.pose,
        line=motion.line,
        via_t=motion.via_t,
        t=motion.t,
        q=motion.q,
        qd=motion.qd,
        qdd=motion.qdd,
        segment_of_sample=motion.segment_of_sample,
        limit_lower=motion.limits.lower,
        limit_upper=motion.limits.upper,
        limit_velocity=motion.limits.velocity,
        limit_acceleration=motion.limits.acceleration,
        limit_jerk=motion.limits.jerk,
        minimum_clearance=tour.clearance,
        clearance_at_least=measured.at_least,
        between=np.array(tour.between, dtype=np.str_),
    )


def write_plan(folder: RunFolder, report: Report, chosen: ConnectedPlan, candidates: Viewpoints) -> None:
    """`plan.json`: the views in visiting order, with what is known about the selection."""
    views = [
        PlanView(
            id=candidate,
            roll_deg=np.degrees(candidates.roll[candidate]).round(9),
            T_object_scanner=chosen.T_object_scanner[stop],
            T_base_scanner=chosen.T_base_scanner[stop],
            T_base_flange=chosen.T_base_flange[stop],
            q_deg=degrees(chosen.tour.q[stop]),
            sweep=_sweep(chosen, stop) if chosen.sweeps else None,
        )
        for stop, candidate in enumerate(chosen.candidate.tolist())
    ]
    said = {key: value for key, value in report if key in PlanFile.model_fields}
    folder.write_json("plan.json", PlanFile(**said | {"views": views}).as_json())


def _sweep(chosen: ConnectedPlan, stop: int) -> Sweep:
    """What is driven at a view of a line sensor."""
    path = chosen.sweeps[stop]
    steady = float(path.profile.cruise)
    return Sweep(
        T_object_scanner=list(chosen.T_object_poses[stop]),
        q_deg=[degrees(q) for q in path.measured_q],
        from_q_deg=degrees(path.q[0]),
        to_q_deg=degrees(path.q[-1]),
        backwards=path.pose[path.pose >= 0][0] > 0,
        length_mm=_mm(path.line.length),
        angle_deg=round(float(np.degrees(path.line.angle)), 9),
        speed_mm_s=round(_mm(path.line.length / steady), 6) if steady > 0 else 0.0,
        speed_deg_s=round(float(np.degrees(path.line.angle / steady)), 6) if steady > 0 else 0.0,
        duration_s=path.duration,
    )


def write_report(folder: RunFolder, report: Report) -> None:
    """`report.json` and `report.md`."""
    folder.write_json("report.json", report.as_json())
    folder.write_text("report.md", markdown(report))


def degrees(q: Floats) -> list[float]:
    """Set-points in degrees as the multiples of 1e-4 that they are."""
    return [float(round(value * 1e4) / 1e4) for value in np.degrees(q)]


def _built_in(scene: Scene, world: World) -> list[StandingFixture]:
    """Post, pedestal and floor, in the form of the scene's fixtures."""
    floor_mm = -scene.robot.pedestal_height_mm

    def standing(
        name: str, shape: Literal["box", "cylinder", "plane"], size_mm: list[float], middle_mm: list[float]
    ) -> StandingFixture:
        T = np.eye(4)
        T[:3, 3] = np.array(middle_mm) / 1000
        return StandingFixture(
            name=name, shape=shape, size_mm=size_mm, pose=T, attached_to="base", occludes=True, built_in=True
        )

    listed = []
    if scene.post.enabled:
        x, y, top = (_mm(value) for value in world.post_top(world.T_base_object))
        height = top - floor_mm
        listed.append(standing("post", "cylinder", [scene.post.diameter_mm, height], [x, y, floor_mm + height / 2]))
    if scene.robot.pedestal_height_mm > 0:
        size = [*scene.robot.pedestal_size_mm, scene.robot.pedestal_height_mm]
        listed.append(standing("pedestal", "box", size, [0.0, 0.0, floor_mm / 2]))
    listed.append(standing("floor", "plane", [], [0.0, 0.0, floor_mm]))
    return listed


def _fixture(fixture: Fixture, world: World) -> StandingFixture:
    if isinstance(fixture, BoxFixture | CylinderFixture):
        size_mm, pose, file, collision = list(fixture.size_mm), fixture.T, None, None
    else:  # its file holds the triangles where the scene's pose has put them
        sides = np.ptp(world.fixture_meshes[fixture.name].vertices, axis=0)
        size_mm, pose, file = [_mm(side) for side in sides], np.eye(4), fixture_file(fixture.name)
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
    """The file that holds the true triangles of a mesh fixture, in the frame that it is attached to."""
    return f"fixture_{name}.ply"


def _mm(metres: float) -> float:
    """Millimetres without the dust of the conversion."""
    return round(float(metres) * 1000, 9)
