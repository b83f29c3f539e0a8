"""Prepare an exploration: the part in simulation, the cylinder, the scanner, the voxels."""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

from cell import scanners
from cell.errors import SceneError, UsageError
from cell.explore.belief import Cylinder, GroundTruth, enclosing_cylinder
from cell.explore.frustum import SensorFrustum
from cell.explore.options import MAX_VOXELS, VOXEL_SPACINGS, ExploreOptions
from cell.explore.state import ExplorationFolder
from cell.part import workpiece
from cell.part.workpiece import Workpiece
from cell.runs.folder import SCHEMA
from cell.runs.schema import ExploredCylinder, ExploreFile
from cell.scan.options import RESUME_OPTIONS, ScanOptions
from cell.scene.model import Scene
from cell.scene.settle import Settings, settle
from cell.session import Session
from planner.errors import PlannerError
from planner.explore.space import VoxelSpace

_WAIT_OPTIONS = ("acquire_wait_s", "acquire_timeout_s")
"""Options of an execution that change no point."""


@dataclass(frozen=True, slots=True, eq=False)
class ExplorationContext:
    """Inputs of an exploration.

    Attributes:
        scene: validated, with settled scanner.
        options: of the exploration.
        scanning: of each execution.
        part: the part in simulation, where its mesh is read.
        ground_truth: the same in the explored frame.
        cylinder: about the part.
        unknown: voxels of the whole cylinder.
        frustum: of the scanner.
        paths: the folder.
        session: of the command.
    """

    scene: Scene
    options: ExploreOptions
    scanning: ScanOptions
    part: Workpiece | None
    ground_truth: GroundTruth | None
    cylinder: Cylinder
    unknown: VoxelSpace
    frustum: SensorFrustum
    paths: ExplorationFolder
    session: Session[None]

    @property
    def name(self) -> str:
        """Name of the part."""
        return self.part.name if self.part is not None else Path(self.scene.part.source).stem


def prepare_exploration(
    session: Session[None], scene: Scene, options: ExploreOptions, scanning: ScanOptions
) -> ExplorationContext:
    """Return the inputs of an exploration; raise UsageError if options or scanner are not supported."""
    _require_supported(scene)
    if options.policy == "two-stage" and options.batch != ExploreOptions().batch:
        raise UsageError("--batch applies to stepwise only; two-stage determines the number of views. Omit --batch")
    scene.require_fixed_part("an exploration")
    part = hidden = None
    if scanning.is_simulated:
        with session.stage("load the part"):
            part = workpiece.load(scene.part.source, scene.part.units)
            hidden = GroundTruth.of(scene, part)
    if options.cylinder_mm is not None:
        diameter, height = options.cylinder_mm
        cylinder = Cylinder(diameter / 2000, height / 1000, is_given=True)
    elif hidden is not None:
        cylinder = enclosing_cylinder(hidden)
    else:
        raise UsageError(
            "the part has no known size; give --cylinder DIAMETER,HEIGHT in mm, about --place, that contains the part"
        )
    known = _as_workpiece(cylinder) if part is None or cylinder.is_given else part
    settled = settle(scene, known)
    scene, settings, scanner = settled.scene, settled.settings, settled.scanner
    if getattr(scanner, "T_view_scanner", np.eye(4)[None]).shape[0] > 1:
        raise SceneError(
            f"exploration does not support the sweeping scanner {scene.scanner.type}: its points have no individual "
            "viewpoints; use a scanner that is at rest in each view, such as laser-area"
        )
    if scanning.resolution_deg is not None and "resolution_deg" in settings.scanner:
        resolution = {"resolution_deg": (scanning.resolution_deg, scanning.resolution_deg)}
        scanner = scanners.make(scene.scanner.type, {**settings.scanner, **resolution})
    unknown = _unknown_space(options, scanning, settings, cylinder)
    return ExplorationContext(
        scene, options, scanning, part, hidden, cylinder, unknown, SensorFrustum.of(scanner, scene),
        ExplorationFolder(session.out or Path()), session,
    )  # fmt: skip


def _require_supported(scene: Scene) -> None:
    """Refuse options that need a known part."""
    plan = scene.plan
    request = {
        "--fill rays": plan.fill == "rays",
        "--multiplicity": plan.multiplicity > 1,
        "--overlap": plan.overlap_mm2 is not None or plan.overlap_share is not None,
        "--pose-sd": plan.pose_sd_mm > 0 or plan.pose_sd_deg > 0,
        "--cost time": plan.cost == "time",
        "--curve": plan.curve,
        "--require": plan.required_visible > 0,
        "--solver": plan.solver != "auto",
        "--pin and --ban": bool(plan.pinned or plan.banned),
        "a region of the part": bool(scene.region),
    }
    if option := next((name for name, is_set in request.items() if is_set), None):
        raise UsageError(f"{option} needs a model of the part; omit it here, and use it in cell plan with model.ply")
    if scene.setup:
        raise UsageError("set-ups need a model of the part; remove [[setup]] here, and plan them with model.ply")
    if scene.placement.origin_mm is not None:
        raise UsageError("--place-origin needs a file of the part; give --place, the middle of the cylinder")
    if on := [fixture.name for fixture in scene.fixtures if fixture.attached_to == "object"]:
        raise UsageError(f"the fixture '{on[0]}' is attached to the part's frame, which is unknown; attach it to base")


def _as_workpiece(cylinder: Cylinder) -> Workpiece:
    """Return the cylinder as a part, for the choice of the scanner."""
    mesh = trimesh.creation.cylinder(cylinder.radius, cylinder.height)
    return workpiece.from_arrays("cylinder", mesh.vertices, mesh.faces, "m")


def _unknown_space(
    options: ExploreOptions, scanning: ScanOptions, settings: Settings, cylinder: Cylinder
) -> VoxelSpace:
    """Return the voxels of the cylinder, by default large enough for one point each at normal incidence."""
    resolution = scanning.resolution_deg or float(np.max(settings.scanner.get("resolution_deg", 0.0)))
    spacing = max(settings.standoffs) * float(np.tan(np.radians(resolution)))
    usual = max(2 * cylinder.radius / MAX_VOXELS, cylinder.height / MAX_VOXELS, VOXEL_SPACINGS * spacing)
    try:
        edge = usual if options.voxel_mm is None else options.voxel_mm / 1000
        return VoxelSpace.from_cylinder(cylinder.radius, cylinder.height, edge, spacing)
    except PlannerError as error:
        raise UsageError(f"--voxel or --cylinder: {error}") from error


def initial_file(work: ExplorationContext) -> ExploreFile:
    """Return explore.json before the first batch."""
    options = work.options.model_dump(mode="json", exclude={"confirm_motion"})
    scanning = work.scanning.model_dump(mode="json", exclude={*RESUME_OPTIONS, *_WAIT_OPTIONS})
    part_sha256 = None if work.part is None else work.part.sha256
    inputs = work.scene.model_dump(mode="json"), scanning, options, part_sha256
    cylinder = work.cylinder
    return ExploreFile(
        schema=SCHEMA,
        part=work.name,
        status="running",
        stop_reason="",
        inputs=hashlib.sha256(json.dumps(inputs, sort_keys=True).encode()).hexdigest(),
        seed=work.scene.plan.seed,
        policy=work.options.policy,
        source=work.scanning.acquire,
        options=options,
        cylinder=ExploredCylinder(
            diameter_mm=round(2000 * cylinder.radius, 6), height_mm=round(1000 * cylinder.height, 6),
            centre_mm=work.scene.placement.position_mm, user_defined=cylinder.is_given,
        ),
        voxel_mm=round(1000 * work.unknown.edge, 6),
        batches=(),
    )  # fmt: skip
