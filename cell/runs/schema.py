"""Definitions of the JSON files of a run folder.

Each file is one class: its keys, their types, units and meaning. A writer makes such a value and a reader returns one.
docs/internals/run_folder.md lists the keys. Shares of coverage are fractions of the area of the surface. The keys that
end in `_on_samples` and bounds refer to the samples of measurability.npz; other coverage refers to the
held-out samples. Only manifest.json contains clock values.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    JsonValue,
    PlainSerializer,
    PlainValidator,
    SerializerFunctionWrapHandler,
    ValidationError,
    model_serializer,
)
from pydantic_core import from_json

from cell.errors import FileError
from cell.formatting import percent
from cell.runs.former_keys import FORMER_SCHEMAS, with_present_keys
from cell.scene.model import PlanKeys, RegionTargets
from cell.scene.validation import error_messages
from planner.values import Floats, readonly


def _transform(values: Any) -> NDArray[np.float64]:
    try:
        return readonly("as a transform", values, (4, 4))
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError("is no transform: it must be four rows of four finite numbers") from error


Transform = Annotated[NDArray[np.float64], PlainValidator(_transform), PlainSerializer(lambda T: T.tolist())]
"""(4, 4) read-only [m]; four rows in the file."""

JointAngles = tuple[float, float, float, float, float, float]
Triple = tuple[float, float, float]


class JsonTable(BaseModel):
    """An object of a JSON file: frozen, with finite numbers; unknown keys are refused.

    Keys are written in the order of the fields. Validators are built when the first value is made.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)

    def as_json(self) -> dict[str, JsonValue]:
        """Return the object as JSON types, in the order of the file."""
        return self.model_dump(mode="json")


class OpenTable(JsonTable):
    """An object with the keys of a scanner plug-in in addition to its own."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, JsonValue] = Field(init=False)

    @property
    def own(self) -> Mapping[str, JsonValue]:
        """The plug-in's keys, in the plug-in's order."""
        return MappingProxyType(self.__pydantic_extra__)

    def number(self, key: str) -> float | None:
        """Return a key of the plug-in if it is a number."""
        value = self.own.get(key)
        return float(value) if isinstance(value, int | float) else None

    def pair(self, key: str) -> tuple[float, float] | None:
        """Return a key of the plug-in if it is a list of two numbers."""
        match self.own.get(key):
            case [int() | float() as first, int() | float() as second]:
                return float(first), float(second)
        return None


def optional(description: str = "") -> Any:
    """Return a field that is omitted from the file if it is None."""
    return Field(default=None, exclude_if=lambda value: value is None, description=description or None)


Table = TypeVar("Table", bound=JsonTable)


def parsed(kind: type[Table], content: bytes, path: Path) -> Table:
    """Return the content of a JSON file of the present or a former schema as a value of its class.

    Args:
        kind: the class.
        content: bytes of the file.
        path: for the error message.
    """
    try:
        tree = from_json(content)
        if isinstance(tree, dict):
            has_field = any(field.alias == "schema" for field in kind.model_fields.values())
            schema = tree.get("schema") if has_field else tree.pop("schema", None)
            if schema in FORMER_SCHEMAS:
                tree = with_present_keys(tree, kind)
        return kind.model_validate_json(json.dumps(tree), strict=True)
    except ValidationError as error:
        has_object = bool(error.errors(include_url=False)[0]["loc"])
        cause = error_messages(error, kind)[0] if has_object else "it must hold one JSON object"
        raise FileError(f"{path} is damaged: {cause}; plan or scan again") from error
    except ValueError as error:
        raise FileError(f"{path} is damaged: it is not JSON, or nested too deep; plan or scan again") from error


# manifest.json


class Resumption(JsonTable):
    """A continuation of a stopped execution."""

    time: str = Field(description="time (UTC)")
    argv: tuple[str, ...] = Field(description="command line")
    driver: str = Field(description="URL of the controller")
    previous_status: str = Field(description="status of the execution before")
    path_digest: str | None = optional("digest of the remaining path")
    path_deg: tuple[tuple[float, ...], ...] | None = optional(
        "set-points of all axes on the remaining path, from the position of the arm"
    )


class NamedFile(JsonTable):
    """A file of the user that the plan depends on."""

    role: str = Field(description="scene, part, robot, or fixture:NAME")
    path: str = Field(description="its path")
    sha256: str = Field(description="sha256 of its bytes")


class Manifest(JsonTable):
    """manifest.json of a run or an execution: how it was made and how far it got.

    It is the only file that changes while the folder is written. Any key may be missing or unknown, since a manifest
    may be cut short or belong to a foreign folder. A key that is not set is not written.
    """

    model_config = ConfigDict(extra="ignore", serialize_by_alias=True)

    schema_version: str | None = Field(default=None, alias="schema", description="version of the folder's layout")
    status: str | None = Field(
        default=None, description="running, finished, failed, interrupted, or incomplete (reported before its end)"
    )
    stage: str | None = Field(default=None, description="last stage begun")
    start_time: str | None = Field(default=None, description="time of the start (UTC)")
    argv: tuple[str, ...] = Field(default=(), description="command line")
    seed: int | None = Field(default=None, ge=0, description="seed of every random choice")
    inputs: dict[str, str] = Field(default_factory=dict, description="sha256 of each input of the plan")
    files: tuple[NamedFile, ...] = Field(default=(), description="files named by the user; absent for a built-in cell")
    overrides: tuple[str, ...] | None = Field(
        default=None, description="keys of the scene that differ from the scene file, by options or by the command"
    )
    options: dict[str, JsonValue] = Field(default_factory=dict, description="execution: its options")
    source: str | None = Field(default=None, description="execution: source of the points")
    plan: str | None = Field(default=None, description="execution: sha256 of the executed plan.json")
    digest: str | None = Field(
        default=None, description="digest of the driving artefacts; execution: that of the executed plan"
    )
    path_digest: str | None = Field(
        default=None, description="execution: digest of the driven path if it is not the plan's motion"
    )
    versions: dict[str, str] = Field(default_factory=dict, description="versions of the packages that affect results")
    seconds: dict[str, float] = Field(default_factory=dict, description="duration of each stage")
    pid: int | None = Field(default=None, description="running execution: its process")
    pid_start: int | None = Field(default=None, description="start of the process, in ticks of its machine")
    machine: str | None = Field(default=None, description="name of the machine")
    controller: str | None = Field(default=None, description="execution: name of the controller")
    speed_fraction: float | None = Field(default=None, description="share of the axis speeds")
    motion_s: float | None = Field(default=None, description="duration of the moves by the controller's clock")
    simulated_time: bool | None = Field(default=None, description="whether that clock was simulated")
    time_scale: float | None = Field(default=None, description="clock rate of an emulator, if it is not real time")
    resumptions: tuple[Resumption, ...] = Field(default=(), description="continuations of the execution")
    reason: str = Field(default="", description="cause of the failure, one sentence")
    exit_code: int | None = Field(default=None, description="exit code of the command; null if it was killed")
    artefacts: dict[str, str] = Field(default_factory=dict, description="sha256 of every file")

    def as_json(self) -> dict[str, JsonValue]:
        """Return the keys that are set, as JSON types."""
        return self.model_dump(mode="json", exclude_unset=True)

    def but(self, **entries: object) -> Self:
        """Return a copy with changed entries."""
        return self.model_copy(update=entries)

    def without(self, *names: str) -> Self:
        """Return a copy without some entries."""
        return type(self).model_validate(self.model_dump(exclude_unset=True, exclude=set(names)))

    def require_seed(self, folder: Path) -> int:
        """Return the seed, or raise FileError if there is none; `folder` is for the message."""
        if self.seed is None:
            raise FileError(f"{folder / 'manifest.json'} is damaged: it has no seed; plan or scan again")
        return self.seed


# plan.json


class Coverage(JsonTable):
    """Coverage of the views and of all reachable candidates."""

    visible: float = Field(description="visible coverage of the views")
    coverable: float = Field(description="coverage of all reachable candidates together")
    visible_of_coverable: float = Field(description="visible / coverable")
    visible_with_arm: float | None = Field(
        default=None,
        description="visible coverage with self-occlusion by the arm; null for sweeping views, for which it is not "
        "computed, and in older runs",
    )
    target_on_samples: float | None = Field(
        default=None, description="target: share of the coverable samples; null if regions have their own targets"
    )
    planned_on_samples: float = Field(description="coverage of the views on the samples of the matrix")
    coverable_on_samples: float = Field(description="coverage of all reachable candidates on these samples")


class Verdicts(JsonTable):
    """Number of candidates by the result of the reach check."""

    reachable: int = Field(description="with a collision-free configuration")
    out_of_reach: int = Field(description="without an inverse kinematics solution")
    joint_limit: int = Field(description="all configurations violate joint limits")
    collision: int = Field(description="all other configurations are closer to an object than the clearance")

    @property
    def total(self) -> int:
        """Number of candidates."""
        return self.reachable + self.out_of_reach + self.joint_limit + self.collision


class Exclusion(JsonTable):
    """A selected candidate that is not in the plan."""

    id: int = Field(description="candidate, row of viewpoints.npz")
    cause: str = Field(description="cause, one sentence")


class SegmentClearance(JsonTable):
    """Clearance of the motion between two views."""

    minimum_mm: float = Field(description="smallest measured distance on the segment; values above 300 mm are cut off")
    lower_bound_mm: float = Field(
        description="proven lower bound of the clearance on the segment; pairs that are built close count as farther"
    )
    between: str = Field(description='closest pair of objects, "housing with part"; "" beyond 300 mm')


class Tightest(JsonTable):
    """The moment of the smallest distance in the motion."""

    segment: int = Field(description="segment of the motion, from 0")
    time_s: float = Field(description="time in motion.npz")
    distance_mm: float = Field(description="distance of the two objects")
    between: str = Field(description="the two objects")
    points_in_base_mm: tuple[Triple, Triple] = Field(description="closest point of each object, base frame")
    q_deg: JointAngles = Field(description="joint angles at this moment")
    e_deg: tuple[float, ...] | None = optional("angles of the external axes at this moment")


class Clearance(JsonTable):
    """Clearance of the motion."""

    collision: Literal["hull", "decomposed", "exact"] = Field(
        description="collision shape of the part: hull, exact (triangles), or decomposed (older runs)"
    )
    segments: tuple[SegmentClearance, ...] = Field(description="one for each segment between views, in motion order")
    tightest: Tightest | None = Field(description="moment of the smallest distance; null if all exceed 300 mm")


class MaxCoverage(JsonTable):
    """With `--max-views`: maximum coverage for a number of views."""

    max_views: int = Field(description="allowed number of views")
    coverage: float = Field(description="coverage of the views")
    upper_bound: float = Field(description="proven upper bound on the coverage of any `max_views` candidates")
    gap_points: float = Field(description="upper bound minus coverage, in percentage points of the coverable samples")


class OverlapComponent(JsonTable):
    """A connected component of the overlap graph."""

    views: int = Field(description="number of views")
    coverage: float = Field(description="coverage of these views")


class Overlap(JsonTable):
    """With `--overlap`: connectivity of the overlap graph and its cost."""

    connected: bool = Field(description="whether the overlap graph is connected")
    extra_views: int = Field(description="number of views added for the overlap")
    views_without_overlap: int = Field(description="number of views without the overlap constraint")
    views_without_earlier_overlap: int = Field(
        description="views without overlap with an earlier view, except the first"
    )
    components: tuple[OverlapComponent, ...] = Field(description="connected components, largest coverage first")


class RobustSelection(JsonTable):
    """With `--pose-sd`: parameters and result of the selection under pose error."""

    alpha: float = Field(description="accepted probability of missing a sample")
    members: int = Field(description="number of drawn pose errors")
    required_views: int = Field(description="views that measure a sample in all members, for confidence 1 - alpha")
    robust_on_samples: float = Field(description="share of samples that the views measure at confidence 1 - alpha")
    robust_coverable_on_samples: float = Field(description="the same for all reachable candidates together")


class RobustCoverage(RobustSelection):
    """With `--pose-sd`: coverage at confidence 1 - alpha, and its check by simulated executions."""

    executions: int = Field(description="number of simulated executions, each with new pose errors")
    samples: int = Field(description="number of held-out samples")
    coverage: float = Field(description="coverage at confidence 1 - alpha, by an ensemble as in planning")
    simulated_coverage: float = Field(description="share measured in at least 1 - alpha of the executions")
    confirmed_share: float = Field(description="share of this coverage that the executions confirm")
    mean_frequency: float = Field(description="mean share of the executions that measure this coverage")
    coverage_mean: float = Field(description="mean coverage of an execution")
    coverage_min: float = Field(description="smallest coverage of an execution")


class Multiplicity(JsonTable):
    """With `--multiplicity`: number of views for each sample."""

    views_per_sample: int = Field(description="requested number of views per sample")
    samples_with_fewer_candidates: int = Field(
        description="samples with fewer candidates; they are measured from all of them"
    )


class Cost(JsonTable):
    """With `--cost time`: cost in seconds."""

    seconds: float = Field(description="dwell time at all views plus the motion")
    seconds_bound: float = Field(description="lower bound over all selections and motions")


class FurtherSetup(JsonTable):
    """Further set-up: coverage together with the set-ups before.

    Surface in contact with a support counts as not measured in that set-up.
    """

    digests: tuple[str, ...] = Field(
        description="digests of the plans of the set-ups before; all use the samples of the first"
    )
    visible_before: float = Field(description="coverage of the set-ups before")
    visible_together: float = Field(description="coverage of all set-ups, this one included")
    coverable: float = Field(description="coverage of the set-ups before and of all reachable candidates here")
    in_contact: float = Field(description="share not measured before and in contact with a support here")

    @property
    def share(self) -> float:
        """Share of the open, coverable surface that this plan measures."""
        most = self.coverable - self.visible_before
        return (self.visible_together - self.visible_before) / most if most > 0 else 1.0


class Sweep(JsonTable):
    """Line of a sweeping view: a straight line at constant speed through K poses."""

    T_object_scanner: tuple[Transform, ...] = Field(description="(K, 4, 4) poses; that of the view is number K // 2")
    q_deg: tuple[JointAngles, ...] = Field(description="joint angles of the poses")
    from_q_deg: JointAngles = Field(description="start of the line, at rest")
    to_q_deg: JointAngles = Field(description="end of the line, at rest")
    backwards: bool = Field(description="whether the poses are passed in reverse order")
    length_mm: float = Field(description="distance from the first pose to the last")
    angle_deg: float = Field(description="rotation from the first pose to the last")
    speed_mm_s: float = Field(description="speed between them")
    speed_deg_s: float = Field(description="rotational speed between them")
    duration_s: float = Field(description="duration from rest to rest")


class PlanView(JsonTable):
    """A view as it is executed: poses follow from the rounded joint angles by forward kinematics."""

    id: int = Field(description="candidate, row of viewpoints.npz")
    roll_deg: float = Field(description="rotation about the viewing axis")
    T_object_scanner: Transform = Field(description="scanner in the object frame; for a sweep the middle pose")
    T_base_scanner: Transform = Field(description="scanner in base")
    T_base_flange: Transform = Field(description="flange in base")
    q_deg: JointAngles = Field(description="set-points A1 to A6, multiples of 1e-4")
    e_deg: tuple[float, ...] | None = optional("set-points of the external axes (angle of the rotary table)")
    T_base_object: Transform | None = optional("pose of the part as turned by the rotary table")
    sweep: Sweep | None = optional()

    @property
    def q(self) -> Floats:
        """(axes,) set-points [rad], KUKA signs."""
        return np.radians([*self.q_deg, *(self.e_deg or ())])

    @property
    def T_object_poses(self) -> Floats:
        """(K, 4, 4) all poses of a sweep [m]; K is 1 for a view at rest."""
        return np.stack((self.T_object_scanner,) if self.sweep is None else self.sweep.T_object_scanner)


class PlanResult(JsonTable):
    """Selection and motion of a plan, in plan.json and report.json."""

    coverage: Coverage
    solver: str = Field(description="solver that selected the views")
    status: str = Field(description="what is proven about the selection, in words")
    lower_bound: int = Field(description="lower bound on the number of views, over these candidates and the target")
    gap: float = Field(description="(views - lower bound) / views")
    verdicts: Verdicts
    exclusions: tuple[Exclusion, ...] = Field(
        description="selected candidates that could not be connected or are occluded by the arm"
    )
    clearance: Clearance | None = optional("clearance of the motion")
    max_coverage: MaxCoverage | None = optional()
    overlap: Overlap | None = optional()
    robust: RobustCoverage | None = optional()
    multiplicity: Multiplicity | None = optional()
    cost: Cost | None = optional()
    further_setup: FurtherSetup | None = optional()


class PlanFile(PlanResult):
    """plan.json: the views in visiting order and the facts about their selection."""

    units: str = "transforms are 4x4 in metres, angles in deg; coverage and gap are fractions"
    views: tuple[PlanView, ...] = Field(description="views in visiting order")


# report.json of a plan


class ReportPart(JsonTable):
    """The measured part."""

    name: str = Field(description="name of the built-in part or of the file")
    faces: int = Field(description="faces of reference.ply")
    planning_faces: int = Field(description="faces of planning.ply")
    extents_mm: Triple = Field(description="size of the bounding box along the axes of the object frame")
    area_mm2: float = Field(description="area of the surface")
    findings: tuple[str, ...] = Field(description="findings of the mesh check, one sentence each")


class ReportSettings(OpenTable):
    """Options of the plan; the keys of the scanner type stand among them (docs/scanners.md)."""

    placement_mm: Triple = Field(description="position of the part's centre in base")
    placement_abc_deg: Triple = Field(description="orientation of the part, KUKA A B C")
    scanner: str = Field(description="scanner type")
    sensor: str | None = optional("name of the sensor")
    sweep_poses: int | None = optional("poses of each sweeping view")
    sweep_in_motion: bool | None = optional("whether the motion includes the sweeps")
    sweep_s: tuple[float, float] | None = optional("duration of the shortest and the longest sweep")
    standoffs_mm: tuple[float, ...] = Field(description="distances from the surface to the laser source")
    rolls_deg: tuple[float, ...] = Field(description="rotations about the viewing axis")
    candidates: str = Field(description="method of candidate generation")
    fill: str = Field(description="method that fills the matrix")
    coverage: float = Field(description="target, share of the coverable surface")
    required_visible: float = Field(description="visible coverage below which `cell plan` ends with exit code 3")
    seed: int = Field(description="seed of every random choice")
    max_views: int | None = optional("maximum number of views")
    multiplicity: int | None = optional("views per sample")
    pinned: tuple[int, ...] | None = optional("required candidates")
    banned: tuple[int, ...] | None = optional("excluded candidates")
    cost: str | None = optional("minimised cost, if not the number of views")
    overlap_mm2: float | None = optional("common area above which two scans overlap")
    overlap_share: float | None = optional("share of the smaller scan above which two scans overlap")
    overlap_in_order: bool | None = optional("whether each view has to overlap an earlier one")
    scan_s: float | None = optional("duration of a scan, with cost 'time'")
    settle_s: float | None = optional("settling time, with cost 'time'")
    pose_sd_mm: float | None = optional("standard deviation of the executed position along each axis of the scanner")
    pose_sd_deg: float | None = optional("standard deviation of the executed rotation about each axis of the scanner")
    alpha: float | None = optional("accepted probability of missing a sample")
    ensemble: int | None = optional("number of drawn pose errors")

    @model_serializer(mode="wrap")
    def _put_scanner_keys_after_name(self, serialize: SerializerFunctionWrapHandler) -> dict[str, JsonValue]:
        content: dict[str, JsonValue] = serialize(self)
        first = ("placement_mm", "placement_abc_deg", "scanner", "sensor", *self.own)
        return {key: content[key] for key in first if key in content} | content


class Attainable(JsonTable):
    """Coverage by any pose of this robot, a lower estimate found by search."""

    share: float = Field(description="attainable coverage on the held-out samples")
    standard_error: float = Field(description="standard error of the share, since a subset of the samples is searched")
    samples: int = Field(description="number of searched samples")
    out_of_reach: float = Field(description="share that is visible only from tried poses outside the arm's reach")
    out_of_sight: float = Field(description="share that is visible from no tried pose")


class Sigma(JsonTable):
    """With `--max-sigma`: expected standard deviation of the points."""

    median_mm: float = Field(description="median over the measured samples, each from its best view")
    quantile_95_mm: float = Field(description="95 % quantile")
    limit_mm: float = Field(description="limit")


class Spacing(JsonTable):
    """Distance of neighbouring points in the densest view of each sample."""

    median_mm: float = Field(description="median over the measured samples")
    quantile_95_mm: float = Field(description="95 % quantile")
    quantile_99_mm: float = Field(description="99 % quantile")
    limit_mm: float | None = Field(description="limit; null: none")


class RegionResult(JsonTable):
    """Coverage of a region; shares are fractions of its area on the held-out samples."""

    name: str = Field(description="name in the scene; `the rest` is the surface outside all regions")
    area_mm2: float = Field(description="area of the region")
    target: float = Field(description="target, share of the coverable surface")
    common_target: bool = Field(
        description="whether the target applies to all such regions together, by area and weight"
    )
    views: int = Field(description="views per sample")
    max_sigma_mm: float | None = Field(description="own sigma limit; null: none")
    max_spacing_mm: float | None = Field(description="own spacing limit; null: none")
    weight: float = Field(description="weight of its area")
    visible: float = Field(description="coverage of the views")
    coverable: float = Field(description="coverage of the reachable candidates")
    visible_of_coverable: float = Field(description="visible / coverable")
    satisfied_share: float = Field(description="share measured from the requested number of views")
    cause: str = Field(description='cause if less than the target is coverable; else ""')


class ReportView(JsonTable):
    """A row of the table of views."""

    id: int = Field(description="candidate, row of viewpoints.npz")
    marginal_coverage: float = Field(description="marginal coverage over the views before")
    source_in_base_mm: Triple = Field(description="position of the laser source")
    q_deg: JointAngles = Field(description="set-points A1 to A6, multiples of 1e-4")
    e_deg: tuple[float, ...] | None = optional("set-points of the external axes (angle of the rotary table)")
    roll_deg: float = Field(description="rotation about the viewing axis")
    segment_clearance_mm: float | None = Field(description="smallest clearance on the segment to the view")


class ReportMotion(JsonTable):
    """The motion from home to home."""

    duration_s: float = Field(description="duration")
    jerk_free_bound_s: float = Field(
        default=0.0, description="time-optimal duration for the same stops without a jerk limit; 0: unknown"
    )
    baseline_duration_s: float = Field(description="duration for the same views in task-space order (Christofides)")
    lower_bound_s: float = Field(description="lower bound over all orders and configurations of these views")
    via_points: int = Field(description="number of via points, home at both ends included")
    detours: int = Field(description="number of segments with more than one straight joint move")
    speed_fraction: float = Field(description="share of the axis speeds")
    minimum_clearance_mm: float | None = Field(description="smallest clearance")
    between: str = Field(description="pair of objects with the smallest clearance")


class MinimumViews(JsonTable):
    """Fewest views for a share of the coverable surface."""

    share_of_coverable: float = Field(description="share of the coverable samples")
    views: int | None = Field(description="sufficient number of views; null if none was found")
    lower_bound: int | None = Field(description="lower bound on the number of views; null if unknown")


class Curve(JsonTable):
    """With `--curve`: fewest views for round shares; curve.json has the whole curve."""

    minimum_views: tuple[MinimumViews, ...] = Field(description="entries by increasing share")


class Report(PlanResult):
    """report.json: the content of the report page, the terminal table and `--json`."""

    part: ReportPart
    settings: ReportSettings
    n_views: int = Field(description="number of views")
    n_samples: int = Field(description="number of samples of the matrix")
    attainable: Attainable | None = optional("absent in older runs")
    sigma: Sigma | None = optional()
    spacing: Spacing | None = optional()
    regions: tuple[RegionResult, ...] | None = optional()
    blockers: dict[str, int] = Field(description="objects in collision with candidates, and the number of candidates")
    views: tuple[ReportView, ...] = Field(description="views in visiting order; plan.json has all their data")
    motion: ReportMotion
    common_cover: bool | None = optional("true for one of several set-ups with a common cover, and for an edited copy")
    curve: Curve | None = optional()

    @property
    def is_single_setup(self) -> bool:
        """Whether the coverage target applies to this plan alone."""
        return self.further_setup is None and not self.common_cover

    @property
    def is_repairable(self) -> bool:
        """Whether the plan has a coverage target of its own, which a repair can restore."""
        return self.is_single_setup and self.max_coverage is None


# scene.resolved.json


class ResolvedPart(JsonTable):
    """The part file."""

    name: str = Field(description="name of the built-in part or of the file")
    units: str | None = Field(description="unit of the file; null for a built-in part")
    sha256: str = Field(description="sha256 of the file")


class ScannerKeys(OpenTable):
    """The scanner: its type, and the keyword arguments that construct it (docs/scanners.md)."""

    type: str = Field(description="name of the plug-in")

    @property
    def opening_deg(self) -> tuple[float, float]:
        """Angles (across, along) of the frustum in pictures [deg]: the field of view, or the thin fan of a line.

        A scanner that states neither is drawn 10 degrees wide.
        """
        fan = self.number("fan_deg")
        return self.pair("fov_deg") or ((10.0, 10.0) if fan is None else (0.5, fan))

    @property
    def drawn_range_mm(self) -> tuple[float, float]:
        """Smallest and largest distance of the frustum in pictures [mm]; 100 to 300 if the scanner states none."""
        return self.pair("range_mm") or (100.0, 300.0)


class ResolvedRobot(JsonTable):
    """A robot that is not built in, or not placed at the origin."""

    model: Literal["kr16", "robot.xml"] = Field(description="the built-in robot, or the run's copy of another")
    name: str = Field(description="name of the file in the scene, or kr16")
    T_base: Transform = Field(description="its base in the frame of the cell")


class ResolvedTable(JsonTable):
    """The rotary table that turns the part, a cylinder below its face; axis E1, with the placement at angle 0."""

    T_base_table: Transform = Field(description="centre of the face; the axis is z, right-handed")
    diameter_mm: float = Field(description="diameter of the cylinder")
    height_mm: float = Field(description="height of the cylinder")
    swing_mm: float = Field(description="diameter of the free circle for the rotating part")
    limits_deg: tuple[float, float] | None = Field(description="smallest and largest angle; null: endless")
    free_range_deg: tuple[float, float] | None = optional("range within the limits that is free of collisions")
    velocity_deg_s: float = Field(description="speed limit")
    acceleration_deg_s2: float = Field(description="acceleration limit")
    jerk_deg_s3: float = Field(description="jerk limit")
    moves: Literal["synchronised", "indexed"] = Field(
        default="synchronised", description="synchronised with the arm, or indexed while the arm is clear of the table"
    )
    angles: int = Field(description="number of table angles at which views are searched")
    post_mm: float | None = optional("table below the part: distance of its face from the part's lowest point")


class ResolvedHousing(JsonTable):
    """The scanner's housing, and the bracket between it and the flange."""

    shape: Literal["box"] = "box"
    size_mm: Triple = Field(description="size along x, y, z of its own frame")
    T_flange_housing: Transform = Field(description="its centre")
    bracket_diameter_mm: float = Field(description="diameter of the bracket")


class StandingFixture(JsonTable):
    """A fixture of the scene, or post, pedestal and floor."""

    name: str = Field(description="unique name")
    shape: Literal["box", "cylinder", "mesh", "plane"] = Field(description="its shape; a plane is infinite")
    size_mm: tuple[float, ...] = Field(description="box and mesh x, y, z; cylinder diameter, height; plane empty")
    pose: Transform = Field(description="its centre in the frame it is attached to; for a mesh the origin of its file")
    attached_to: Literal["base", "object"] = Field(description="frame that it moves with")
    occludes: bool = Field(description="whether it blocks rays")
    built_in: bool = Field(description="whether it is post, pedestal or floor")
    file: str | None = optional("triangles of a mesh, mm, in the frame it is attached to")
    collision: Literal["hull", "exact"] | None = optional("collision shape of a mesh: exact, or hull (default)")


class ResolvedPlan(PlanKeys):
    """The `[plan]` table of the scene with all values resolved; keys missing in older runs have today's default."""

    model_config = ConfigDict(extra="forbid", defer_build=True)

    collision: Literal["hull", "decomposed", "exact"] = Field(  # type: ignore[assignment] # runs of earlier versions
        default="hull", description="collision shape of the part; hull if absent"
    )
    planning_faces: int | None = Field(default=None, description="faces of planning.ply")
    sphere_radius_mm: float | None = Field(default=None, description="radius of the view sphere")


class ResolvedRegion(RegionTargets):
    """Options of a region; faces of reference.ply carry its number from 0 as `region` (-1: ignored)."""

    model_config = ConfigDict(extra="ignore", defer_build=True)


class ResolvedScene(JsonTable):
    """scene.resolved.json: all settings of the plan, resolved, and every object of the cell."""

    units: str = "transforms are 4x4 in metres; the rest as names say"
    part: ResolvedPart
    T_base_object: Transform = Field(description="pose of the part's file in base")
    T_object_centre: Transform = Field(description="centre of its bounding box in the object frame")
    T_flange_scanner: Transform = Field(description="scanner frame in the flange frame")
    scanner: ScannerKeys
    planning_resolution_deg: float = Field(description="angle between the rays with `fill` 'rays'")
    housing: ResolvedHousing
    robot: ResolvedRobot | None = optional("robot and its base; absent: the built-in one at the origin")
    table: ResolvedTable | None = optional("rotary table that turns part, post and the part's fixtures")
    fixtures: tuple[StandingFixture, ...] = Field(description="fixtures of the scene, post, pedestal and floor")
    # The built-in home is whole numbers, and the file keeps the scene's notation.
    home_deg: tuple[int | float, ...] = Field(description="joint angles at start and end of the motion")
    joint_limits_deg: tuple[tuple[float, float], ...] = Field(description="lower and upper limit of each axis")
    joint_velocity_limits_deg_s: tuple[float, ...] = Field(description="speed limit of each axis")
    joint_acceleration_limits_deg_s2: tuple[float, ...] = Field(description="acceleration limit of each axis")
    joint_jerk_limits_deg_s3: tuple[float | None, ...] | None = Field(
        default=None, description="jerk limit of each axis; null or absent: none"
    )
    speed_scaling: float = Field(description="share of the speed limits used for timing")
    acceleration_scaling: float = Field(description="share of the acceleration and jerk limits used for timing")
    clearance_mm: float = Field(description="required clearance")
    arrival_mm: float | None = optional("tolerance on the position of any point of arm or tool at the end of a move")
    path_tolerance_mm: float | None = optional("tolerance on the position of any point of arm or tool during a move")
    plan: ResolvedPlan
    regions: tuple[ResolvedRegion, ...] | None = optional()

    @property
    def table_is_endless(self) -> bool:
        """Whether there is a rotary table without limits."""
        return self.table is not None and self.table.limits_deg is None


# report.json of an execution


class ExecutedPart(JsonTable):
    """The scanned part."""

    name: str = Field(description="name of the built-in part or of the file")
    faces: int = Field(description="faces of reference.ply")


class ExecutedSettings(JsonTable):
    """Options of the execution; null if its manifest does not contain them."""

    model_config = ConfigDict(serialize_by_alias=True)

    driver: str | None = Field(description="URL of the controller")
    view: int | None = Field(description="the only executed view; null: all")
    actual: str | None = Field(default=None, description="as-built mesh that the simulated rays hit; null: the nominal")
    range_noise_mm: float | None = Field(description="standard deviation along each ray")
    pose_error_mm: float | None = Field(description="standard deviation of the executed position along each axis")
    pose_error_deg: float | None = Field(description="standard deviation of the executed rotation about each axis")
    registers: bool | None = Field(alias="register", description="whether poses were corrected by registration")
    close_holes: bool | None = Field(description="whether the holes of the surface were closed")
    noise: str = Field(description="'model': noise of the scanner's sigma model as well; or 'none'")
    scanner: str = Field(description="scanner type")
    resolution_deg: tuple[float, ...] = Field(description="angle between rays; empty if the scanner has none")
    rays_per_scan: int = Field(description="rays of a view at rest, or of one line of a sweep")
    seed: int = Field(description="seed of noise and pose error")


class ExecutedCoverage(JsonTable):
    """Coverage of the executed poses."""

    kind: str = Field(
        default="simulated",
        description="kind of `visible`: 'simulated' from the true poses, or 'model' from registered poses",
    )
    visible: float = Field(description="visible coverage of the executed poses")
    predicted: float = Field(description="visible coverage of the planned poses of the scanned views")
    predicted_all_views: float = Field(description="visible coverage of all planned views")
    coverable: float = Field(description="coverage of all reachable candidates together")
    visible_of_coverable: float = Field(description="visible / coverable")
    sampled: float = Field(description="sampled coverage")
    dense: float | None = Field(default=None, description="dense coverage; null if unknown")
    sampled_radius_mm: float = Field(description="1 % of the diagonal of the part's bounding box")


class ExecutedView(JsonTable):
    """One scan, in execution order."""

    number: int = Field(description="number of the view, from 1 in visiting order")
    id: int = Field(description="candidate, row of viewpoints.npz")
    points: int = Field(description="number of points")
    rays: dict[str, int] | None = Field(description="number of rays by result; null if points are not simulated")
    marginal_coverage: float = Field(description="marginal coverage over the scans before")
    reported_minus_commanded_deg: float = Field(description="largest difference of an axis")
    pose_error_mm: float | None = Field(
        description="distance of the true pose from the reported one; this and the next three are null if points are "
        "not simulated"
    )
    pose_error_deg: float | None = Field(description="angle between the two")
    pose_error_after_mm: float | None = Field(description="distance of the true pose from the registered one")
    pose_error_after_deg: float | None = Field(description="angle between the two")
    determined_error_mm: float | None = optional(
        "this and the next five split these errors at the centre of the scan's points, if it was registered: "
        "translation along directions that its surface determines, as reported"
    )
    determined_error_after_mm: float | None = optional("the same as registered")
    determined_error_deg: float | None = optional("rotation along these directions, as reported")
    determined_error_after_deg: float | None = optional("the same as registered")
    undetermined_error_mm: float | None = optional("translation along the other directions, which stays")
    undetermined_error_deg: float | None = optional("rotation along these directions")
    registration: str | None = Field(description="result of the registration; null without one")
    free_directions: int = Field(description="directions in which registration could not determine the pose")


class ExecutedCloud(JsonTable):
    """The merged points; values are null without points."""

    rms_to_reference_mm: float | None = Field(description="root mean square distance to the reference")
    rms_to_reference_as_reported_mm: float | None = Field(description="the same before registration")
    outliers: int = Field(
        default=0, description="removed points far from the part and without neighbours; 0 for simulated points"
    )


class ExecutedRegistration(JsonTable):
    """Correction of the reported poses."""

    rms_before_mm: float | None = Field(description="rms distance of matched points along the normals, before")
    rms_after_mm: float | None = Field(description="the same after registration")
    iterations: int = Field(description="number of iterations")
    overlapping_pairs: int = Field(description="number of pairs of overlapping scans")
    uncorrected_scans: int = Field(description="number of scans whose pose was not corrected")


class ExecutedLocalisation(JsonTable):
    """Localised pose of the part in a set-up."""

    displacement_mm: float = Field(description="displacement of the centre from the planned placement")
    rotation_deg: float = Field(description="rotation from the planned placement")
    max_point_sd_mm: float | None = Field(description="standard deviation of the least determined point of the part")
    free_motions: tuple[str, ...] = Field(
        description="motions that the points do not determine to 0.05 mm, in words: along them the part keeps its "
        "planned pose until set-ups are registered to each other"
    )
    error_mm: float | None = Field(
        description="error of the centre along the determined directions; null if points are not simulated"
    )
    error_deg: float | None = Field(description="error of the rotation about the determined directions")


class ExecutedSurface(JsonTable):
    """The reconstructed surface; lengths are null without points."""

    status: str = Field(description="result of the reconstruction, a sentence")
    vertices: int = Field(description="vertices of mesh.ply")
    faces: int = Field(description="faces of mesh.ply")
    closed_faces: int = Field(description="faces that close holes")
    spacing_mm: float | None = Field(description="spacing of the points")
    max_point_distance_mm: float | None = Field(description="largest distance of the surface from a point")
    diagonal_mm: float = Field(description="diagonal of the part's bounding box")
    grid_mm: float | None = Field(description="edge of a grid cell")
    outliers: int = Field(description="removed points")
    holes: int = Field(description="open boundary loops of the measured surface")


class SurfaceDeviation(JsonTable):
    """Signed distance of a surface from the reference over its area, positive outside the part."""

    rms_mm: float = Field(description="root mean square")
    mean_mm: float = Field(description="mean with sign")
    quantile_95_mm: float = Field(description="95 % quantile of the absolute value")
    max_mm: float = Field(description="largest absolute value")
    samples: int = Field(description="number of samples of the area")


class ExecutedDeviation(SurfaceDeviation):
    """Deviation of the measured area of the mesh, without a band of 1.5 point spacings about sharp edges."""

    closed_holes: SurfaceDeviation | None = Field(
        description="deviation of the faces that close holes; null without any"
    )
    with_edges: SurfaceDeviation | None = Field(
        default=None, description="with the band about sharp edges; null if the other numbers include it"
    )
    edge_share: float = Field(default=0.0, description="share of the area in the band about sharp edges")

    @property
    def edge_note(self) -> str:
        """The numbers with the band about sharp edges; "" if there is none."""
        if self.with_edges is None:
            return ""
        rms, largest = self.with_edges.rms_mm, self.with_edges.max_mm
        return f"with the {percent(self.edge_share)} about sharp edges {rms:.3f} mm rms, largest {largest:.3f} mm"


class ExecutedMotion(JsonTable):
    """Duration of the moves."""

    planned_s: float = Field(description="planned duration")
    executed_s: float | None = Field(description="duration by the controller's clock; null unless it is simulated")


class ExecutedRegion(JsonTable):
    """Coverage of a region by the scans; fractions of its area."""

    name: str = Field(description="name in the scene")
    visible: float = Field(description="coverage")
    views: int = Field(description="requested views per sample")
    satisfied_share: float = Field(description="share measured from the requested number of views")


class ExecutionReport(JsonTable):
    """report.json of an execution: the content of its page, the terminal table and `--json`."""

    part: ExecutedPart
    source: str = Field(default="simulated", description="source of the points: 'simulated', or its name")
    contradictions: tuple[str, ...] = Field(
        default=(), description="contradictions found in the points, a sentence each"
    )
    complete: bool = Field(description="whether every view is present and every file was used")
    missing_views: tuple[int, ...] = Field(description="numbers of the views without a usable scan")
    unusable_files: tuple[str, ...] = Field(description="one sentence for each unusable file")
    settings: ExecutedSettings
    n_views: int = Field(description="number of scans")
    n_views_planned: int = Field(description="number of planned views")
    n_points: int = Field(description="number of points of all scans")
    coverage: ExecutedCoverage
    regions: tuple[ExecutedRegion, ...] | None = optional()
    views: tuple[ExecutedView, ...] = Field(description="scans in execution order")
    cloud: ExecutedCloud
    localisation: ExecutedLocalisation | None = optional()
    registration: ExecutedRegistration | None = Field(description="null without registration")
    surface: ExecutedSurface
    deviation: ExecutedDeviation | None = Field(description="null without a surface")
    motion: ExecutedMotion


# setups.json and scanned/report.json: shares are on the held-out samples that all set-ups have in common


class CandidateSetup(JsonTable):
    """A set-up candidate."""

    name: str = Field(description="description in words")
    placement_mm: Triple = Field(description="position of the part's centre in base")
    placement_abc_deg: Triple = Field(description="orientation of the part, KUKA A B C")
    reachable: int = Field(description="number of reachable candidates")
    coverable: float = Field(description="their coverage")
    in_contact: float = Field(description="share in contact with a support, which this set-up cannot measure")
    cause: str = Field(description='cause if the set-up is not possible, a sentence; else ""')


class SelectedSetup(JsonTable):
    """A set-up of the cover."""

    folder: str = Field(description="its run folder, relative to this file")
    digest: str = Field(description="digest of its plan")
    candidate: int = Field(description="row of `candidates`")
    views: int = Field(description="number of views")
    visible: float = Field(description="coverage of the views")
    marginal_coverage: float = Field(description="marginal coverage over the set-ups before")


class SetupsCoverage(JsonTable):
    """Coverage of all set-ups together."""

    visible: float = Field(description="coverage of all views")
    coverable: float = Field(description="coverage of the reachable candidates of all set-up candidates")
    visible_of_coverable: float = Field(description="visible / coverable")
    target: float = Field(description="target, share of the coverable surface")
    required: float = Field(default=0.0, description="required share of the whole surface; below it the exit code is 3")


class SetupsRegion(JsonTable):
    """Coverage of a region by all set-ups together; shares are fractions of the region."""

    name: str = Field(description="name in the scene")
    target: float = Field(description="target, share of the coverable surface; shared by regions without an own target")
    visible: float = Field(description="coverage of all views")
    coverable: float = Field(description="coverage of the reachable candidates of all set-up candidates")
    visible_of_coverable: float = Field(description="visible / coverable")


class UncoveredShares(JsonTable):
    """Uncovered surface of all set-ups by cause, the first that applies."""

    not_selected: float = Field(
        description="measured by a candidate of a set-up candidate, but not needed for the target"
    )
    in_contact: float = Field(description="in contact with a support in every selected set-up")
    out_of_reach: float = Field(description="visible in a used set-up only from tried poses outside the arm's reach")
    other_poses: float = Field(description="measurable from a reachable pose that is not a candidate")
    out_of_sight: float = Field(description="visible from no tried pose past the part and its surroundings")
    standard_error: float = Field(description="largest standard error of the last three, estimated from samples")


class CommonSurface(JsonTable):
    """Surface that two set-ups have in common, for their registration."""

    setups: tuple[int, int] = Field(description="numbers of the set-ups")
    share: float = Field(description="share of the surface measured in both")
    free_motions: tuple[str, ...] = Field(
        description="motions that it does not determine although the part would, in words"
    )


class ViewsFirst(JsonTable):
    """A cover with fewer views in more set-ups, over the same candidates and samples, without a planned motion."""

    setups: int = Field(description="number of set-ups")
    views: int = Field(description="number of views")


class SetupsFile(JsonTable):
    """setups.json: several set-ups of one part, planned as one cover."""

    part: str = Field(description="name of the built-in part or of the file")
    seed: int = Field(description="seed of every random choice")
    coverage: SetupsCoverage
    status: str = Field(description="what is proven about the numbers of set-ups and views, in words")
    setups_bound: int = Field(description="lower bound on the number of set-ups, over the set-up candidates")
    views: int = Field(description="number of views of all set-ups")
    views_bound: int = Field(
        description="lower bound on the number of views, over covers with this number of set-ups and the share of "
        "samples in `status`"
    )
    alternative: ViewsFirst | None = optional("alternative with fewer views in more set-ups")
    curve: Curve | None = optional("with `--curve`: fewest views of these set-ups for round shares of the coverable")
    seconds: float | None = Field(
        default=None, description="cost of views and set-ups in seconds; null if views are counted"
    )
    seconds_bound: float | None = Field(default=None, description="lower bound of the cost over all covers")
    satisfied_share: float | None = Field(
        default=None, description="share of the coverable samples with the requested number of views or confidence"
    )
    regions: tuple[SetupsRegion, ...] = Field(default=(), description="regions of the part")
    selected: tuple[SelectedSetup, ...] = Field(description="selected set-ups in the order of their numbers")
    candidates: tuple[CandidateSetup, ...] = Field(description="all set-up candidates")
    common_surface: tuple[CommonSurface, ...] = Field(
        default=(), description="common surface by pairs of selected set-ups"
    )
    uncovered: UncoveredShares | None = Field(
        default=None, description="uncovered surface by cause; absent in older folders"
    )


class ScannedSetup(JsonTable):
    """A scanned set-up."""

    number: int = Field(description="number from 1, name of its folder in setups/")
    execution: str = Field(description="execution of its run folder")
    digest: str = Field(description="digest of the executed plan")
    views: int = Field(description="number of used scans")
    points: int = Field(description="their points")
    visible: float = Field(description="coverage without surface in contact with a support")
    marginal_coverage: float = Field(description="marginal coverage over the set-ups before")
    localisation: ExecutedLocalisation | None = Field(
        description="localised pose of the part; null without localisation"
    )


class UnmeasuredShares(JsonTable):
    """Surface that no scan measures by cause, the first that applies."""

    not_scanned: float = Field(description="planned for set-ups that are not scanned yet")
    not_measured: float = Field(description="planned for an executed view that does not measure it")
    in_contact: float = Field(description="in contact with a support in every set-up")
    not_planned: float = Field(description="in no planned view")


class ScannedSetups(JsonTable):
    """scanned/report.json: the scans of all set-ups together."""

    part: str = Field(description="name of the built-in part or of the file")
    source: str = Field(description="source of the points")
    setups: tuple[ScannedSetup, ...] = Field(description="scanned set-ups by number")
    missing_setups: tuple[int, ...] = Field(description="numbers of the other set-ups")
    visible: float = Field(description="coverage of all set-ups")
    planned: float = Field(description="the same as planned")
    sampled: float = Field(description="sampled coverage")
    uncovered: UnmeasuredShares
    common_surface: tuple[CommonSurface, ...] = Field(description="common surface by pairs of scanned set-ups")
    registration: ExecutedRegistration | None = Field(
        description="registration of whole set-ups to the reference and each other; null if all parts were in place"
    )
    contradictions: tuple[str, ...] = Field(description="contradictions found in the points, a sentence each")
    surface: ExecutedSurface
    deviation: ExecutedDeviation | None = Field(description="deviation of the surface; null without one")


# explore.json

EXPLORE_FILE = "explore.json"

UNSEEN = "unseen"
"""Name of the fixture of a batch that represents the unseen space: it collides and does not occlude."""

SurfaceName = Literal["believed", "measured"]
BELIEVED: SurfaceName = "believed"
MEASURED: SurfaceName = "measured"


class ExploredCylinder(JsonTable):
    """The upright cylinder that holds the part; its centre is the origin of the explored frame."""

    diameter_mm: float = Field(description="diameter")
    height_mm: float = Field(description="height")
    centre_mm: Triple = Field(description="centre in base")
    user_defined: bool = Field(
        description="whether the user gave it; else it encloses the simulated part with a margin"
    )


class ExploredBatch(JsonTable):
    """A planned and executed batch."""

    folder: str = Field(description="its run folder, relative to this one")
    digest: str = Field(description="digest of the executed plan")
    views: int = Field(description="number of scanned views")
    planning_surface: SurfaceName = Field(
        description="surface it was planned on: believed (boundary of the unseen space) or measured (from all points)"
    )
    points: int = Field(description="number of measured points")
    seconds: float = Field(description="duration of the planned motion from home to home")
    expected_gain_mm2: float = Field(
        description="expected gain: area of the planned surface to be measured first by it"
    )
    below_range_mm2: float = Field(
        default=0.0, description="part of it without points where the part may be closer than the scanner's range"
    )
    realised_gain_mm2: float = Field(
        description="realised gain: area measured first by this batch, on the belief after it"
    )
    surface_mm2: float = Field(description="area of the belief surface after it")
    uncovered_mm2: float = Field(description="part of it without a measured point nearby")
    unseen_mm3: float = Field(description="volume of the cylinder that no ray entered (with the part's inside)")

    @property
    def measured_mm2(self) -> float:
        """Area of the belief surface after the batch with a measured point nearby."""
        return self.surface_mm2 - self.uncovered_mm2


class UncoveredArea(JsonTable):
    """Uncovered belief surface with one cause."""

    cause: str = Field(description="condition that the closest candidate violates")
    area_mm2: float = Field(description="area of the belief surface")


class ExploreFile(JsonTable):
    """explore.json: the exploration of a part without a model, batch by batch."""

    model_config = ConfigDict(serialize_by_alias=True)

    schema_version: str = Field(alias="schema", description="version of the folder's layout")
    units: str = "mm, mm2, s; the explored frame: middle of the cylinder, axes of the base frame"
    part: str = Field(description="name of the part")
    status: str = Field(description="running, or finished")
    stop_reason: str = Field(description='stop reason, a sentence; "" while it runs')
    inputs: str = Field(description="sha256 of all inputs of the exploration")
    seed: int = Field(description="seed of every random choice")
    policy: str = Field(description="policy that selects the batches")
    source: str = Field(description="source of the points")
    options: dict[str, JsonValue] = Field(description="options of the exploration")
    cylinder: ExploredCylinder
    voxel_mm: float = Field(description="edge of a voxel")
    batches: tuple[ExploredBatch, ...] = Field(description="batches in order")
    uncovered: tuple[UncoveredArea, ...] = Field(
        default=(), description="uncovered surface by cause, largest area first"
    )
    model: str = Field(default="", description='mesh of all scans, explored frame; "" if there is none yet')
    model_centre_mm: Triple | None = optional("centre of its bounding box in base, as used by cell plan --place")
    share_beyond_limits: float | None = optional(
        "with a sigma or spacing limit: share of the measured surface beyond it"
    )

    @property
    def views(self) -> int:
        """Number of scanned views."""
        return sum(stage.views for stage in self.batches)

    def rows(self) -> list[tuple[str, str]]:
        """Return the rows of its table, once a batch is finished."""
        last = self.batches[-1]
        rows = [
            ("views", f"{self.views} in {len(self.batches)} batches ({self.policy})"),
            ("motion", f"{sum(stage.seconds for stage in self.batches):.1f} s"),
            ("ended", self.stop_reason),
            ("measured", f"{last.measured_mm2:,.0f} mm² of surface"),
            ("stays open", f"{sum(reason.area_mm2 for reason in self.uncovered):,.0f} mm² of the belief surface"),
            ("never entered", f"{last.unseen_mm3 / 1000:.1f} cm3 of the cylinder, by any ray"),
            *(("", f"{reason.area_mm2:.0f} mm2: {reason.cause}") for reason in self.uncovered[:4]),
        ]
        if self.share_beyond_limits is not None:
            share = f"{100 * self.share_beyond_limits:.2f} % of the measured surface exceeds the sigma or spacing limit"
            rows.append(("beyond limits", share))
        return rows


def read_explore_file(path: Path) -> ExploreFile:
    """Read an explore.json."""
    return parsed(ExploreFile, path.read_bytes(), path)


# why.json


class Change(JsonTable):
    """A single change of cell, scanner or plan."""

    kind: str = Field(description="kind of the change")
    change: str = Field(description="description in words")
    setting: str = Field(description='option or key to set; "" if there is none')


class EstimatedChange(Change):
    """A tried change."""

    estimated_gain: float = Field(description="estimated share of the uncoverable surface that it makes measurable")


class RecommendedChange(Change):
    """A recommended change, evaluated on every sample concerned."""

    gain: float = Field(description="share of the concerned surface that it makes measurable")
    gain_mm2: float = Field(description="area of that share")


class UncoveredPatch(JsonTable):
    """Connected samples of one group."""

    area_mm2: float = Field(description="area of the samples")
    centre_mm: Triple = Field(description="sample closest to the mean, object frame")
    change: RecommendedChange | None = optional()


class UncoveredSamples(JsonTable):
    """Uncovered samples with one cause."""

    group: int = Field(description="number in why.ply, from 1")
    cause: str = Field(description="condition that the closest candidate violates")
    code: int = Field(description="code of the cause in why.ply")
    object: str = Field(description='occluder or collision object; "" if the cause has none')
    title: str = Field(description="cause and object in words")
    detail: str = Field(description="further facts about the closest candidates")
    share: float = Field(description="share of the surface")
    area_mm2: float = Field(description="area of the samples")
    n_patches: int = Field(description="number of connected patches; `patches` has the largest")
    changes: tuple[RecommendedChange, ...] = Field(description="recommended changes, best first")
    patches: tuple[UncoveredPatch, ...] = Field(description="patches, largest first")


class WhyReport(JsonTable):
    """why.json: the uncovered surface of a plan by cause, and single changes that would measure it."""

    units: str = "share, visible, uncovered and gain are fractions of area; mm and mm2, object frame"
    part: str = Field(description="name of the part")
    plan: str = Field(description="sha256 of plan.json")
    samples: int = Field(description="number of held-out samples")
    area_mm2: float = Field(description="area of the surface")
    visible: float = Field(description="visible coverage of the plan")
    uncovered: float = Field(description="uncovered share")
    groups: tuple[UncoveredSamples, ...] = Field(description="groups by cause, largest area first")
    uncoverable: float = Field(description="share that no reachable candidate measures")
    best_changes: tuple[RecommendedChange, ...] = Field(description="changes with the largest gains overall")
    all_changes: tuple[EstimatedChange, ...] = Field(description="all tried changes")
