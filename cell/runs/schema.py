"""The pieces of which the values of a run folder's JSON files are made.

`plan_json`, `report_json` and `scene_json` define one file each: what a key is called, what it holds, in which unit.
Who writes a file makes such a value, who reads one gets it, and docs/internals/run_folder.md lists its keys.
"""

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

from cell.errors import FileError
from cell.scene.fields import sentences
from cell.scene.model import PlanKeys, RegionWishes
from planner.values import Floats, readonly


def _transform(values: Any) -> NDArray[np.float64]:
    try:
        return readonly("as a transform", values, (4, 4))
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError("is no transform: it must be four rows of four finite numbers") from error


Transform = Annotated[NDArray[np.float64], PlainValidator(_transform), PlainSerializer(lambda T: T.tolist())]
"""(4, 4) read-only [m]; rows in the file."""

JointAngles = tuple[float, float, float, float, float, float]
Triple = tuple[float, float, float]


class JsonTable(BaseModel):
    """An object of a JSON file: frozen, its numbers finite; keys that this version does not know are passed over.

    Values are made in the order in which their keys are written. Nothing is compiled before the first value is made.
    """

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False, defer_build=True)

    def as_json(self) -> dict[str, JsonValue]:
        """The object as JSON types, in the order in which it is written."""
        return self.model_dump(mode="json")


class OpenTable(JsonTable):
    """A table in which the keys of a scanner plug-in stand beside known ones, whatever that plug-in calls them."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, JsonValue] = Field(init=False)

    @property
    def own(self) -> Mapping[str, JsonValue]:
        """The plug-in's keys, in the plug-in's order."""
        return MappingProxyType(self.__pydantic_extra__)

    def number(self, key: str) -> float | None:
        """One of the plug-in's keys, where it has it as a number."""
        value = self.own.get(key)
        return float(value) if isinstance(value, int | float) else None

    def pair(self, key: str) -> tuple[float, float] | None:
        """One of the plug-in's keys, where it has it as two numbers."""
        match self.own.get(key):
            case [int() | float() as first, int() | float() as second]:
                return float(first), float(second)
        return None


def optional(description: str = "") -> Any:
    """A field that is left out of the file where it is None."""
    return Field(default=None, exclude_if=lambda value: value is None, description=description or None)


Table = TypeVar("Table", bound=JsonTable)


def parsed(kind: type[Table], content: bytes, path: Path) -> Table:
    """A JSON file as the value that defines it.

    Args:
        kind: the definition.
        content: of the file.
        path: for the sentence.

    Raises:
        FileError: if it is not JSON, lacks a key, or a key holds another kind of value.
    """
    try:
        return kind.model_validate_json(content, strict=True)
    except ValidationError as error:
        problem = error.errors(include_url=False)[0]
        if problem["type"] == "json_invalid":
            said = "it is not JSON, or nested too deep"
        else:
            said = sentences(error, kind)[0] if problem["loc"] else "it must hold one JSON object"
        raise FileError(f"{path} is damaged: {said}; plan or scan again") from error


class Resumed(JsonTable):
    """Once that a stopped execution was taken up again."""

    at: str = Field(description="time (UTC)")
    argv: tuple[str, ...] = Field(description="the command line")
    driver: str = Field(description="URL of the controller")
    after: str = Field(description="status that it had")
    way: str | None = optional("digest of the way that was planned to go on")
    way_deg: tuple[tuple[float, ...], ...] | None = optional("its set-points of all axes, from where the arm stood")


class NamedFile(JsonTable):
    """A file of the user's that a plan was made of."""

    what: str = Field(description="scene, part, or fixture:NAME")
    path: str = Field(description="where it was")
    sha256: str = Field(description="of its bytes")


class Manifest(JsonTable):
    """The file; a key that is not set is not written."""

    model_config = ConfigDict(serialize_by_alias=True)

    schema_version: str | None = Field(default=None, alias="schema", description="of the folder's layout")
    status: str | None = Field(
        default=None,
        description="running, finished, failed, interrupted, or incomplete: reported without having ended",
    )
    stage: str | None = Field(default=None, description="that was begun last")
    started: str | None = Field(default=None, description="time (UTC)")
    argv: tuple[str, ...] = Field(default=(), description="the command line")
    seed: int | None = Field(default=None, ge=0, description="of every random choice")
    inputs: dict[str, str] = Field(default_factory=dict, description="sha256 of what the plan depends on")
    files: tuple[NamedFile, ...] = Field(default=(), description="that the user named; none of a built-in cell")
    options: dict[str, JsonValue] = Field(default_factory=dict, description="of an execution: what was asked for")
    source: str | None = Field(default=None, description="of an execution: where its points come from")
    plan: str | None = Field(default=None, description="of an execution: sha256 of the plan.json that was executed")
    digest: str | None = Field(
        default=None, description="of all that drives; of an execution: of the plan that was executed"
    )
    way: str | None = Field(
        default=None, description="of an execution: digest of what was driven, where that is not the plan's motion"
    )
    versions: dict[str, str] = Field(default_factory=dict, description="of what results depend on")
    seconds: dict[str, float] = Field(default_factory=dict, description="of each stage")
    pid: int | None = Field(default=None, description="of an execution, while it runs: its process")
    pid_began: int | None = Field(default=None, description="when that began, in ticks of its machine")
    machine: str | None = Field(default=None, description="where it runs")
    controller: str | None = Field(default=None, description="of an execution: who drove")
    speed_fraction: float | None = Field(default=None, description="of the axis speeds")
    moving_s: float | None = Field(default=None, description="time that the controller took for the moves")
    simulated_time: bool | None = Field(default=None, description="whether its clock was a simulated one")
    time_scale: float | None = Field(default=None, description="of an emulator whose clock is not real time")
    resumed: tuple[Resumed, ...] = Field(default=(), description="each time that it was taken up again")
    reason: str = Field(default="", description="why it failed, a sentence")
    exit_code: int | None = Field(default=None, description="of the command; null where it was killed")
    artefacts: dict[str, str] = Field(default_factory=dict, description="sha256 of every file")

    def as_json(self) -> dict[str, JsonValue]:
        """The object as JSON types, of what is set."""
        return self.model_dump(mode="json", exclude_unset=True)

    def but(self, **entries: object) -> Self:
        """A copy with other entries."""
        return self.model_copy(update=entries)

    def without(self, *names: str) -> Self:
        """A copy without some entries."""
        return type(self).model_validate(self.model_dump(exclude_unset=True, exclude=set(names)))

    def require_seed(self, folder: Path) -> int:
        """The seed.

        Args:
            folder: for the sentence.

        Raises:
            FileError: if there is none.
        """
        if self.seed is None:
            raise FileError(f"{folder / 'manifest.json'} is damaged: it has no seed; plan or scan again")
        return self.seed


class Coverage(JsonTable):
    """What the views measure, and what could be measured; fractions."""

    visible: float = Field(description="visible coverage of the views")
    coverable: float = Field(description="what all reachable candidates together measure")
    visible_of_coverable: float = Field(description="the first as a fraction of the second")
    visible_with_arm: float | None = Field(
        default=None,
        description="`visible` where each view's own arm hides as well; null for views that sweep, whose arm's shadow "
        "is not judged; older runs do not say it",
    )
    target_on_features: float | None = Field(
        default=None,
        description="share of the coverable samples that had to be covered; null where regions have their own",
    )
    planned_on_features: float = Field(description="what the views measure of the matrix' samples")
    coverable_on_features: float = Field(description="what all reachable candidates measure of them")


class Verdicts(JsonTable):
    """How many candidates the arm reaches, and what keeps it from the others."""

    reachable: int = Field(description="with a joint solution that is free of collision")
    out_of_reach: int = Field(description="too far or too near for the arm")
    joint_limit: int = Field(description="every solution is outside the joint limits")
    collision: int = Field(description="every solution within them is nearer to something than the clearance")

    @property
    def total(self) -> int:
        """Number of candidates."""
        return self.reachable + self.out_of_reach + self.joint_limit + self.collision


class Dropped(JsonTable):
    """A candidate that was chosen and is not in the plan."""

    id: int = Field(description="row of viewpoints.npz")
    reason: str = Field(description="why, one sentence")


class SegmentClearance(JsonTable):
    """How near things come on the way between two stops."""

    minimum_mm: float = Field(description="smallest distance measured on the motion; farther than 300 mm is 300")
    at_least_mm: float = Field(
        description="proven: nothing is nearer on the segment; links built near each other count as farther"
    )
    between: str = Field(description='what is that near, "housing with part"; "" where all is farther than 300 mm')


class Tightest(JsonTable):
    """The moment at which two things are nearest in all of the motion."""

    segment: int = Field(description="of the motion, from 0")
    time_s: float = Field(description="of motion.npz")
    distance_mm: float = Field(description="between the two")
    between: str = Field(description="what they are")
    points_in_base_mm: tuple[Triple, Triple] = Field(description="the nearest points, of the first and of the second")
    q_deg: JointAngles = Field(description="joint angles there")
    e_deg: tuple[float, ...] | None = optional("angles of the external axes there")


class Clearance(JsonTable):
    """How near the motion comes to anything."""

    collision: Literal["hull", "decomposed", "exact"] = Field(
        description="what the part was: hull, or exact, its triangles; of older runs also decomposed"
    )
    segments: tuple[SegmentClearance, ...] = Field(description="on the way between two stops, in the motion's order")
    tightest: Tightest | None = Field(description="its nearest moment; null where everything is farther than 300 mm")


class MostCoverage(JsonTable):
    """With `--max-views`: the most coverage for a number of views."""

    max_views: int = Field(description="that were allowed")
    covered: float = Field(description="what the views measure, fraction")
    upper_bound: float = Field(description="what no so many candidates exceed, fraction")
    gap_points: float = Field(description="between the two, in points of what can be measured")


class OverlapPart(JsonTable):
    """Views whose scans hang together."""

    views: int = Field(description="how many")
    covered: float = Field(description="what they measure, fraction")


class Overlap(JsonTable):
    """With `--overlap`: whether the scans hang together, and what that costs."""

    connected: bool = Field(description="whether all do")
    extra_views: int = Field(description="price in views")
    views_without: int = Field(description="views of the plan without this wish")
    without_earlier: int = Field(description="views that overlap none before them, but for the first")
    parts: tuple[OverlapPart, ...] = Field(description="groups that hang together, the one that measures most first")


class RobustSelection(JsonTable):
    """With `--pose-sd`: what the selection was to hold although poses are off."""

    alpha: float = Field(description="probability with which a sample may be missed")
    members: int = Field(description="drawn pose errors from which probabilities are known")
    views_needed: int = Field(description="views that measure a sample in all members, for it to be promised")
    robust_on_features: float = Field(description="samples that the views measure with 1 - alpha or more, fraction")
    robust_coverable_on_features: float = Field(description="the same of all reachable candidates together, fraction")


class Promise(RobustSelection):
    """With `--pose-sd`: what is promised although poses are off, and what simulated executions say."""

    executions: int = Field(description="simulated executions, each with fresh errors of every view")
    samples: int = Field(description="held-out samples that they look at")
    promised: float = Field(description="measured with 1 - alpha or more, by an ensemble as in planning, fraction")
    achieved: float = Field(description="measured in a share of 1 - alpha of the executions or more, fraction")
    kept: float = Field(description="share of the promised area that was")
    frequency: float = Field(description="share of the executions in which promised area was measured, on average")
    coverage_mean: float = Field(description="what one execution measures on average, fraction")
    coverage_worst: float = Field(description="what the worst of them measures, fraction")


class Multiplicity(JsonTable):
    """With `--k-fold`: each sample measured from several views."""

    views_per_sample: int = Field(description="that were asked for")
    samples_with_fewer_candidates: int = Field(description="these are measured from all that they have")


class Cost(JsonTable):
    """With `--cost time`: seconds in place of the number of views."""

    seconds: float = Field(description="scan and settling at all views, and the motion over them")
    bound_seconds: float = Field(description="no selection and no motion over it need less")


class OpenOf(JsonTable):
    """Of a further set-up: what all measure together, fractions of the surface.

    Surface that a support touches in a set-up counts as not measured in it.
    """

    digests: tuple[str, ...] = Field(
        description="of the plans of the set-ups before; all have the samples of the first"
    )
    before: float = Field(description="what their views measure")
    together: float = Field(description="what they and the views of this plan measure")
    coverable: float = Field(description="what they and all candidates that are reached here measure")
    in_contact: float = Field(description="what they leave open and a support touches here: no view here has it")

    @property
    def share(self) -> float:
        """What this plan measures of what was open and can be measured here."""
        most = self.coverable - self.before
        return (self.together - self.before) / most if most > 0 else 1.0


class Sweep(JsonTable):
    """At a view of a line sensor: a straight line at constant speed through its K poses."""

    T_object_scanner: tuple[Transform, ...] = Field(description="(K, 4, 4), the view's own is number K // 2")
    q_deg: tuple[JointAngles, ...] = Field(description="of these poses, in the column's order")
    from_q_deg: JointAngles = Field(description="where the line begins, at rest")
    to_q_deg: JointAngles = Field(description="where it ends, at rest")
    backwards: bool = Field(description="whether the last pose is driven first")
    length_mm: float = Field(description="from the first pose to the last")
    angle_deg: float = Field(description="from the first pose to the last")
    speed_mm_s: float = Field(description="between them")
    speed_deg_s: float = Field(description="between them")
    duration_s: float = Field(description="from rest to rest")


class PlanView(JsonTable):
    """A view as it will be executed: of the rounded joint angles through forward kinematics."""

    id: int = Field(description="candidate, row of viewpoints.npz")
    roll_deg: float = Field(description="about the viewing axis")
    T_object_scanner: Transform = Field(description="scanner in the object frame; of a sweep its middle pose")
    T_base_scanner: Transform = Field(description="the same in base")
    T_base_flange: Transform = Field(description="the flange there")
    q_deg: JointAngles = Field(description="set-points A1 to A6, multiples of 1e-4")
    e_deg: tuple[float, ...] | None = optional("set-points of the external axes, likewise: the rotary table's angle")
    T_base_object: Transform | None = optional("where the rotary table has turned the part to")
    sweep: Sweep | None = optional()

    @property
    def q(self) -> Floats:
        """(axes,) set-points [rad], KUKA signs."""
        return np.radians([*self.q_deg, *(self.e_deg or ())])

    @property
    def T_object_poses(self) -> Floats:
        """(K, 4, 4) all poses of a sweep [m]; of a view at rest the one that it has."""
        return np.stack((self.T_object_scanner,) if self.sweep is None else self.sweep.T_object_scanner)


class PlanFile(JsonTable):
    """The file."""

    units: str = "transforms are 4x4 in metres, angles in deg; coverage and gap are fractions"
    coverage: Coverage
    solver: str = Field(description="that chose the views")
    status: str = Field(description="what is proven of the selection, in words")
    lower_bound: int = Field(description="no plan of these candidates has fewer views for target_on_features")
    gap: float = Field(description="of the number of views over its bound, as a fraction of the former")
    verdicts: Verdicts
    dropped: tuple[Dropped, ...] = Field(description="candidates that could not be connected, or that the arm shades")
    clearance: Clearance | None = optional("how near the motion comes to anything")
    most_coverage: MostCoverage | None = optional()
    overlap: Overlap | None = optional()
    promise: Promise | None = optional()
    multiplicity: Multiplicity | None = optional()
    cost: Cost | None = optional()
    open_of: OpenOf | None = optional()
    views: tuple[PlanView, ...] = Field(description="as they will be executed, in visiting order")


class ReportPart(JsonTable):
    """The part as it was measured out."""

    name: str = Field(description="of the built-in part or of the file")
    faces: int = Field(description="of reference.ply")
    planning_faces: int = Field(description="of planning.ply")
    extents_mm: Triple = Field(description="of its bounding box along the axes of the object frame")
    area_mm2: float = Field(description="of its surface")
    findings: tuple[str, ...] = Field(description="what the mesh check found, a sentence each")


class ReportSettings(OpenTable):
    """What was asked for; the keys of the scanner's type stand beside these (docs/scanners.md)."""

    placement_mm: Triple = Field(description="of the part's centre in base")
    placement_abc_deg: Triple = Field(description="how it is turned, KUKA A B C")
    scanner: str = Field(description="type of the scanner")
    sensor: str | None = optional("real sensor by name")
    sweep_poses: int | None = optional("poses of each view, of a scanner that sweeps")
    sweep_in_motion: bool | None = optional("whether the motion drives the sweeps")
    sweep_s: tuple[float, float] | None = optional("of the fastest and of the slowest sweep")
    standoffs_mm: tuple[float, ...] = Field(description="from the surface to the laser source")
    rolls_deg: tuple[float, ...] = Field(description="about the viewing axis")
    candidates: str = Field(description="how viewpoints were made")
    fill: str = Field(description="how the matrix was filled")
    coverage: float = Field(description="asked for, as a fraction of what can be measured")
    required_visible: float = Field(description="visible coverage below which `cell plan` ends with exit code 3")
    seed: int = Field(description="of every random choice")
    max_views: int | None = optional("views allowed")
    multiplicity: int | None = optional("views for each sample")
    pinned: tuple[int, ...] | None = optional("candidates that had to be in the plan")
    banned: tuple[int, ...] | None = optional("candidates that must not be")
    cost: str | None = optional("what was made small in place of the number of views")
    overlap_mm2: float | None = optional("two views are joined where they share this area")
    overlap_share: float | None = optional("two views are joined where they share this fraction of the smaller one")
    overlap_in_order: bool | None = optional("whether each view has to overlap an earlier one")
    scan_s: float | None = optional("taken for a scan, with cost 'time'")
    settle_s: float | None = optional("taken for settling, with cost 'time'")
    pose_sd_mm: float | None = optional("standard deviation of executed poses along each axis of the scanner")
    pose_sd_deg: float | None = optional("standard deviation of executed poses about each axis of the scanner")
    alpha: float | None = optional("probability with which a promised sample may be missed")
    ensemble: int | None = optional("drawn pose errors")

    @model_serializer(mode="wrap")
    def _scanners_keys_behind_its_name(self, serialize: SerializerFunctionWrapHandler) -> dict[str, JsonValue]:
        content: dict[str, JsonValue] = serialize(self)
        first = ("placement_mm", "placement_abc_deg", "scanner", "sensor", *self.own)
        return {key: content[key] for key in first if key in content} | content


class Attainable(JsonTable):
    """What any pose would measure that this robot takes up here; fractions of the surface."""

    share: float = Field(description="of the held-out samples, measured by some pose")
    standard_error: float = Field(description="of it: not all of those were searched for")
    asked: int = Field(description="samples that were searched for")
    out_of_reach: float = Field(
        description="seen past part and occluders, but only from poses that the arm does not take up"
    )
    out_of_sight: float = Field(description="seen from no pose that was tried")


class Sigma(JsonTable):
    """With `--max-sigma`: expected standard deviation, over the samples of the matrix."""

    median_mm: float = Field(description="of the samples that the views measure, each from its best view")
    quantile_95_mm: float = Field(description="95 % of them are below")
    limit_mm: float = Field(description="that was asked for")


class Spacing(JsonTable):
    """Distance of neighbouring points, from the densest view of each place."""

    median_mm: float = Field(description="half of what is measured has points at most so far apart")
    quantile_95_mm: float = Field(description="95 % of it")
    quantile_99_mm: float = Field(description="99 % of it")
    limit_mm: float | None = Field(description="that was asked for; null: none")


class RegionResult(JsonTable):
    """What the plan gives a region; fractions of its area, on the held-out samples."""

    name: str = Field(description="of the scene; `the rest` is what no region selects")
    area_mm2: float = Field(description="of its surface")
    asked: float = Field(description="share of what is coverable that was asked for")
    shared: bool = Field(description="whether it is asked of all such regions together, by area and weight")
    views: int = Field(description="from which each sample of the matrix was to be measured")
    max_sigma_mm: float | None = Field(description="limit of its own; null: none")
    max_spacing_mm: float | None = Field(description="limit of its own; null: none")
    weight: float = Field(description="of its area")
    visible: float = Field(description="that the views measure")
    coverable: float = Field(description="that reachable candidates measure")
    visible_of_coverable: float = Field(description="the first as a fraction of the second")
    from_enough_views: float = Field(description="that as many views as were asked for measure")
    reason: str = Field(description='why less than what was asked for is coverable; "" where it is not less')


class ReportView(JsonTable):
    """A view for a person's table."""

    id: int = Field(description="candidate, row of viewpoints.npz")
    adds: float = Field(description="what it measures that the views before it do not, fraction of the surface")
    source_in_base_mm: Triple = Field(description="place of the laser source")
    q_deg: JointAngles = Field(description="set-points A1 to A6, multiples of 1e-4")
    e_deg: tuple[float, ...] | None = optional("set-points of the external axes, likewise: the rotary table's angle")
    roll_deg: float = Field(description="about the viewing axis")
    clearance_on_the_way_mm: float | None = Field(description="on the segment that leads to it")


class ReportMotion(JsonTable):
    """The motion, from home to home."""

    duration_s: float = Field(description="of the motion")
    jerk_free_bound_s: float = Field(
        default=0.0, description="time-optimal for the same stops without a limit of jerk; 0: not known"
    )
    baseline_duration_s: float = Field(description="of the same views in task-space order (Christofides)")
    lower_bound_s: float = Field(description="no order and joint solutions of these views take less")
    via_points: int = Field(description="of the motion, home at both ends among them")
    detours: int = Field(description="segments on which the arm makes more than one straight move")
    speed_fraction: float = Field(description="of the axis speeds")
    minimum_clearance_mm: float | None = Field(description="the smallest on the way")
    between: str = Field(description="what is that near")


class Fewest(JsonTable):
    """How many views a share of what can be measured takes."""

    of_coverable: float = Field(description="share of what can be measured, fraction")
    views: int | None = Field(description="that suffice; null where none were found")
    at_least: int | None = Field(description="no fewer do; null where no number is known")


class Curve(JsonTable):
    """With `--curve`: the fewest views for round shares; curve.json has all of the curve."""

    fewest: tuple[Fewest, ...] = Field(description="how many views a share takes, from little to much")


class Report(JsonTable):
    """The file."""

    part: ReportPart
    settings: ReportSettings
    n_views: int = Field(description="views of the plan")
    n_features: int = Field(description="samples of the matrix")
    coverage: Coverage
    attainable: Attainable | None = optional("none in older runs")
    sigma: Sigma | None = optional()
    spacing: Spacing | None = optional()
    regions: tuple[RegionResult, ...] | None = optional()
    solver: str = Field(description="that chose the views")
    status: str = Field(description="what is proven of the selection, in words")
    lower_bound: int = Field(description="no plan of these candidates has fewer views for target_on_features")
    gap: float = Field(description="of the number of views over its bound, as a fraction of the former")
    verdicts: Verdicts
    blockers: dict[str, int] = Field(description="with what candidates collide, and how many with each")
    dropped: tuple[Dropped, ...] = Field(description="candidates that could not be connected, or that the arm shades")
    views: tuple[ReportView, ...] = Field(description="in visiting order; plan.json has all of them")
    motion: ReportMotion
    most_coverage: MostCoverage | None = optional()
    overlap: Overlap | None = optional()
    promise: Promise | None = optional()
    multiplicity: Multiplicity | None = optional()
    cost: Cost | None = optional()
    open_of: OpenOf | None = optional()
    of_several: bool | None = optional(
        "true of one of several set-ups that one cover was planned for, and of what is edited from it"
    )
    curve: Curve | None = optional()
    clearance: Clearance | None = optional("how near the motion comes to anything")

    @property
    def is_single_setup(self) -> bool:
        """Whether its coverage was asked of it alone."""
        return self.open_of is None and not self.of_several


class ResolvedPart(JsonTable):
    """The part as it was given."""

    name: str = Field(description="of the built-in part or of the file")
    units: str | None = Field(description="of the file; null for a built-in part")
    sha256: str = Field(description="of the file")


class ScannerKeys(OpenTable):
    """The scanner: calling the class of its type with the other keys makes it again (docs/scanners.md)."""

    type: str = Field(description="name of the plug-in")

    @property
    def opening_deg(self) -> tuple[float, float]:
        """Angles (across, along) that stand for it in pictures [deg]: its field of view, or a line's thin fan.

        A scanner that states neither is drawn 10 degrees wide.
        """
        fan = self.number("fan_deg")
        return self.pair("fov_deg") or ((10.0, 10.0) if fan is None else (0.5, fan))

    @property
    def drawn_range_mm(self) -> tuple[float, float]:
        """Smallest and largest distance in pictures [mm]; 100 to 300 of a scanner that states none."""
        return self.pair("range_mm") or (100.0, 300.0)


class ResolvedRobot(JsonTable):
    """A robot that is not built in, or that does not stand in the origin."""

    model: Literal["kr16", "robot.xml"] = Field(description="the built-in robot, or the run's own file of another")
    name: str = Field(description="of the file that the scene names, or kr16")
    T_base: Transform = Field(description="where its base stands in the cell's frame")


class ResolvedTable(JsonTable):
    """The rotary table that turns the part, a cylinder below its face; E1 is its angle, 0 the placement."""

    T_base_table: Transform = Field(description="the middle of its face; it turns about z, right-handed")
    diameter_mm: float = Field(description="of the cylinder")
    height_mm: float = Field(description="of the cylinder")
    swing_mm: float = Field(description="diameter of the circle that the part may swing through")
    limits_deg: tuple[float, float] | None = Field(description="smallest and largest angle; null: endless")
    turn_deg: tuple[float, float] | None = optional("of these, as far as the part keeps clear of what stands beside it")
    velocity_deg_s: float = Field(description="at full speed")
    acceleration_deg_s2: float = Field(description="at full acceleration")
    jerk_deg_s3: float = Field(description="at full acceleration")
    moves: Literal["synchronised", "indexed"] = Field(
        default="synchronised", description="together with the arm, or while the arm stands clear of all that is turned"
    )
    angles: int = Field(description="over a turn, at which views were looked for")
    post_mm: float | None = optional("of a table under the part: how far its face is below the part's lowest point")


class ResolvedHousing(JsonTable):
    """The scanner's body and the bracket between it and the flange."""

    shape: Literal["box"] = "box"
    size_mm: Triple = Field(description="along x, y, z of its own frame")
    T_flange_housing: Transform = Field(description="its middle")
    bracket_diameter_mm: float = Field(description="of the round bracket")


class StandingFixture(JsonTable):
    """Something fixed that stands in the cell: of the scene, or post, pedestal and floor."""

    name: str = Field(description="of its own")
    shape: Literal["box", "cylinder", "mesh", "plane"] = Field(description="what it is; a plane is endless")
    size_mm: tuple[float, ...] = Field(description="box and mesh x, y, z; cylinder diameter and height; plane nothing")
    pose: Transform = Field(description="of its middle in the frame it is attached to; of a mesh that of its file")
    attached_to: Literal["base", "object"] = Field(description="frame that it moves with")
    occludes: bool = Field(description="whether it stands in the way of rays")
    built_in: bool = Field(description="whether it is post, pedestal or floor")
    file: str | None = optional("the triangles of a mesh, mm, in the frame that it is attached to")
    collision: Literal["hull", "exact"] | None = optional(
        "what a mesh was to the collision check: exact or hull; not said: its hull"
    )


class ResolvedPlan(PlanKeys):
    """The scene's `[plan]`, its keys settled; what an older run lacks is the default now."""

    model_config = ConfigDict(extra="ignore", defer_build=True)

    collision: Literal["hull", "decomposed", "exact"] = Field(  # type: ignore[assignment] # runs of earlier versions
        default="hull", description="what the part was to the collision check; not said: its hull"
    )
    planning_faces: int | None = Field(default=None, description="of planning.ply, what came out for `faces`")
    sphere_radius_mm: float | None = Field(default=None, description="of the view sphere")


class ResolvedRegion(RegionWishes):
    """What was asked of a region; faces of reference.ply have its number, from 0, as `region` (-1: nobody cares)."""

    model_config = ConfigDict(extra="ignore", defer_build=True)


class ResolvedScene(JsonTable):
    """The file."""

    units: str = "transforms are 4x4 in metres; the rest as names say"
    part: ResolvedPart
    T_base_object: Transform = Field(description="the part's file in base")
    T_object_centre: Transform = Field(description="the middle of its bounding box in the object frame")
    T_flange_scanner: Transform = Field(description="the scanner frame in the flange frame")
    scanner: ScannerKeys
    planning_resolution_deg: float = Field(description="between rays that fill the matrix, with `fill` 'rays'")
    housing: ResolvedHousing
    robot: ResolvedRobot | None = optional(
        "which robot, and where its base stands; else the built-in one in the origin"
    )
    table: ResolvedTable | None = optional("turns part, post and the part's fixtures")
    fixtures: tuple[StandingFixture, ...] = Field(description="of the scene, and post, pedestal and floor")
    # The built-in home is whole numbers, and the file keeps what the scene has.
    home_deg: tuple[int | float, ...] = Field(description="joint angles at which the motion begins and ends")
    joint_limits_deg: tuple[tuple[float, float], ...] = Field(description="lower and upper of each axis")
    joint_velocity_limits_deg_s: tuple[float, ...] = Field(description="of each axis at full speed")
    joint_acceleration_limits_deg_s2: tuple[float, ...] = Field(description="of each axis")
    joint_jerk_limits_deg_s3: tuple[float | None, ...] | None = Field(
        default=None, description="of each axis; null, or not there: not limited"
    )
    speed_scaling: float = Field(description="fraction of the speeds that the motion was timed with")
    acceleration_scaling: float = Field(description="fraction of the accelerations and jerks")
    clearance_mm: float = Field(description="that everything keeps from everything else")
    arrival_mm: float | None = optional("how far a point of arm or tool may stand from where a move ends")
    plan: ResolvedPlan
    regions: tuple[ResolvedRegion, ...] | None = optional()

    @property
    def table_is_endless(self) -> bool:
        """Whether a rotary table turns round and round."""
        return self.table is not None and self.table.limits_deg is None


class ExecutedPart(JsonTable):
    """The part that was scanned."""

    name: str = Field(description="of the built-in part or of the file")
    faces: int = Field(description="of reference.ply")


class ExecutedSettings(JsonTable):
    """What was asked for; null where the manifest of the execution does not say it."""

    model_config = ConfigDict(serialize_by_alias=True)

    driver: str | None = Field(description="URL of the controller")
    view: int | None = Field(description="the one view that was asked for; null: all")
    range_noise_mm: float | None = Field(description="one sigma along each ray")
    pose_error_mm: float | None = Field(description="one sigma of the executed position along each axis")
    pose_error_deg: float | None = Field(description="one sigma of the executed rotation about each axis")
    registers: bool | None = Field(alias="register", description="whether poses were corrected by registration")
    close_holes: bool | None = Field(description="whether the holes of the surface were closed")
    noise: str = Field(description="'model': noise by the scanner's own law as well; or 'none'")
    scanner: str = Field(description="type of the scanner")
    resolution_deg: tuple[float, ...] = Field(description="between rays; empty of a scanner without")
    rays_per_scan: int = Field(description="of a view at rest, or of one line of a sweep")
    seed: int = Field(description="of noise and pose error")


class ExecutedCoverage(JsonTable):
    """What the executed poses measure; fractions of the surface."""

    kind: str = Field(
        default="simulated",
        description="of `visible`: 'simulated' by the true poses, or 'model': computed from registered poses",
    )
    visible: float = Field(description="visible coverage of the executed poses")
    predicted: float = Field(description="the same of the planned poses of the views that were scanned")
    predicted_all_views: float = Field(description="the same of all views of the plan")
    coverable: float = Field(description="what all reachable candidates together measure")
    visible_of_coverable: float = Field(description="`visible` as a fraction of `coverable`")
    sampled: float = Field(description="sampled coverage")
    dense: float | None = Field(
        default=None,
        description="dense coverage; null where it is not known",
    )
    sampled_radius_mm: float = Field(description="1 % of the diagonal of the part's bounding box")


class ExecutedView(JsonTable):
    """One scan, in driving order."""

    stop: int = Field(description="number of the view, from 1 in visiting order")
    id: int = Field(description="candidate, row of viewpoints.npz")
    points: int = Field(description="that it gave")
    rays: dict[str, int] | None = Field(description="by what became of them; null where points are not simulated")
    adds: float = Field(description="what it measures that the scans before it do not, fraction of the surface")
    reported_minus_commanded_deg: float = Field(description="of the axis that differs most")
    pose_error_mm: float | None = Field(
        description="distance of the true pose from the reported one; null where points are not simulated, as the next"
    )
    pose_error_deg: float | None = Field(description="angle between the two")
    pose_error_after_mm: float | None = Field(description="distance of the true pose from the registered one")
    pose_error_after_deg: float | None = Field(description="angle between the two")
    registration: str | None = Field(description="how it went; null where it was not asked for")
    free_directions: int = Field(description="along which registration could not tell the pose")


class ExecutedCloud(JsonTable):
    """The merged points; null without any."""

    rms_to_reference_mm: float | None = Field(description="root mean square of their distances to the reference")
    rms_to_reference_as_reported_mm: float | None = Field(description="the same before registration")
    outliers: int = Field(
        default=0, description="off the part, borne out by no neighbour, left out; none where simulated"
    )


class ExecutedRegistration(JsonTable):
    """How the reported poses were corrected."""

    rms_before_mm: float | None = Field(description="of matched points along the normals, as reported")
    rms_after_mm: float | None = Field(description="the same afterwards")
    iterations: int = Field(description="steps")
    overlapping_pairs: int = Field(description="of scans")
    left_as_reported: int = Field(description="scans whose pose was not corrected")


class ExecutedPlace(JsonTable):
    """Where the part of a set-up was found to stand."""

    moved_mm: float = Field(description="of its centre, from its place")
    turned_deg: float = Field(description="from how it should lie")
    worst_point_mm: float | None = Field(description="standard deviation of the point of the part that is known least")
    undetermined: tuple[str, ...] = Field(
        description="motions that these points do not tell to 0.05 mm, in words: along them the part stays as planned, "
        "and moves only where set-ups are registered to each other afterwards"
    )
    off_mm: float | None = Field(
        description="of the centre from the truth, along what is determined; null where points are not simulated"
    )
    off_deg: float | None = Field(description="angle to the truth, about what is determined")


class ExecutedSurface(JsonTable):
    """The surface made of the points; lengths are null without any."""

    status: str = Field(description="how it went, a sentence")
    vertices: int = Field(description="of mesh.ply")
    faces: int = Field(description="of mesh.ply")
    closed_faces: int = Field(description="of these, how many close holes")
    spacing_mm: float | None = Field(description="between points")
    reach_mm: float | None = Field(description="no surface is farther from a point")
    diagonal_mm: float = Field(description="of the part's bounding box")
    grid_mm: float | None = Field(description="edge of a cell")
    outliers: int = Field(description="points left out")
    holes: int = Field(description="open boundary loops of what was measured")


class SurfaceDeviation(JsonTable):
    """Signed distance of a surface from the reference, positive outside the part, over its area."""

    rms_mm: float = Field(description="root mean square")
    mean_mm: float = Field(description="with its sign")
    quantile_95_mm: float = Field(description="95 % of the area deviate by no more")
    largest_mm: float = Field(description="without its sign")
    samples: int = Field(description="that stand for the area")


class ExecutedDeviation(SurfaceDeviation):
    """Of the measured area of the mesh."""

    closed: SurfaceDeviation | None = Field(description="of the faces that close holes; null without any")


class ExecutedMotion(JsonTable):
    """The moves."""

    planned_s: float = Field(description="the plan's time for them")
    executed_s: float | None = Field(description="the controller's; null where its clock was no simulated one")


class ExecutedRegion(JsonTable):
    """What the scans measure of a region; fractions of its area."""

    name: str = Field(description="of the scene")
    visible: float = Field(description="that they measure")
    views: int = Field(description="from which its samples were to be measured")
    from_enough_views: float = Field(description="that so many of them measure")


class ExecutionReport(JsonTable):
    """The file."""

    part: ExecutedPart
    source: str = Field(default="simulated", description="where the points come from: 'simulated', or what was named")
    doubts: tuple[str, ...] = Field(default=(), description="what the points contradict, a sentence each")
    complete: bool = Field(description="whether every view is there and no file was left out")
    missing_views: tuple[int, ...] = Field(description="numbers of the views without a usable scan")
    left_out: tuple[str, ...] = Field(description="a sentence for each file that could not be used")
    settings: ExecutedSettings
    n_views: int = Field(description="scans")
    n_views_planned: int = Field(description="views of the plan")
    n_points: int = Field(description="of all scans")
    coverage: ExecutedCoverage
    regions: tuple[ExecutedRegion, ...] | None = optional()
    views: tuple[ExecutedView, ...] = Field(description="in driving order")
    cloud: ExecutedCloud
    place: ExecutedPlace | None = optional()
    registration: ExecutedRegistration | None = Field(description="null where it was not asked for")
    model: ExecutedSurface
    deviation: ExecutedDeviation | None = Field(description="null without a surface")
    motion: ExecutedMotion


class OfferedSetup(JsonTable):
    """A pose of the part that was looked at."""

    name: str = Field(description="in words")
    placement_mm: Triple = Field(description="of the part's centre in base")
    placement_abc_deg: Triple = Field(description="how it is turned, KUKA A B C")
    reachable: int = Field(description="candidates that the arm reaches")
    coverable: float = Field(description="what these measure")
    in_contact: float = Field(description="what a support touches: no view of this set-up measures it")
    left_out: str = Field(description='why it is not possible, a sentence; "" where it is')


class ChosenSetup(JsonTable):
    """A set-up of the cover."""

    folder: str = Field(description="its run folder, from this file's")
    digest: str = Field(description="of the plan in it")
    offered: int = Field(description="row of `offered`")
    views: int = Field(description="of its plan")
    visible: float = Field(description="what they measure")
    adds: float = Field(description="what they measure that the set-ups before do not")


class SetupsCoverage(JsonTable):
    """What all set-ups measure together, on the same held-out samples."""

    visible: float = Field(description="measured by a view of any of them")
    coverable: float = Field(description="measured by a reachable candidate of any set-up that was offered")
    visible_of_coverable: float = Field(description="the first as a fraction of the second")
    asked: float = Field(description="of that fraction")
    required: float = Field(default=0.0, description="of the whole surface: less is exit code 3")


class SetupsRegion(JsonTable):
    """A region of the part, measured in all set-ups together; shares are of the region."""

    name: str = Field(description="of its own")
    asked: float = Field(description="of what is coverable; regions without a coverage of their own share one")
    visible: float = Field(description="measured by a view of any set-up")
    coverable: float = Field(description="measured by a reachable candidate of any set-up that was offered")
    visible_of_coverable: float = Field(description="the first as a fraction of the second")


class PlannedOpen(JsonTable):
    """What no view of any set-up measures, by the first reason that holds; fractions of the surface."""

    not_asked: float = Field(description="a candidate of a set-up that was offered measures it: less was asked for")
    in_contact: float = Field(description="a support touches it in every set-up that was chosen")
    out_of_reach: float = Field(description="poses see it in a chosen set-up, and the arm takes up none of them")
    other_poses: float = Field(description="the arm takes up a pose that measures it, and none of the candidates does")
    out_of_sight: float = Field(description="no pose sees it past the part and what stands about it")
    standard_error: float = Field(description="at most, of the last three: they are told of samples")


class SharedSurface(JsonTable):
    """What two set-ups both measure, by which their scans are held together."""

    setups: tuple[int, int] = Field(description="their numbers")
    share: float = Field(description="of the surface that both measure")
    free: tuple[str, ...] = Field(description="motions that it leaves open although the part would show them, in words")


class ViewsFirst(JsonTable):
    """A cover of fewer views in more set-ups, of the same candidates and samples; no motion was planned for it."""

    setups: int = Field(description="that it takes")
    views: int = Field(description="of all of them")


class SetupsFile(JsonTable):
    """The file."""

    part: str = Field(description="of the built-in part or of the file")
    seed: int = Field(description="of every random choice")
    coverage: SetupsCoverage
    status: str = Field(description="what is proven of the number of set-ups, and of views, in words")
    setups_bound: int = Field(description="no fewer of the set-ups offered reach what was asked of these samples")
    views: int = Field(description="of all set-ups")
    views_bound: int = Field(
        description="no cover by so many of the set-ups offered, of the share of the samples that status names, has "
        "fewer views"
    )
    views_first: ViewsFirst | None = optional("where fewer views would do if they came before set-ups")
    curve: Curve | None = optional(
        "with `--curve`: the fewest views of these set-ups for round shares of what they can"
    )
    seconds: float | None = Field(
        default=None, description="that views cost, and set-ups where they do; null where views were counted"
    )
    seconds_bound: float | None = Field(default=None, description="no cover that was asked for costs less")
    kept: float | None = Field(
        default=None,
        description="of what can be: share of the matrix' samples that has as many views, or the promise, asked for",
    )
    regions: tuple[SetupsRegion, ...] = Field(default=(), description="of the part; none where it has none")
    chosen: tuple[ChosenSetup, ...] = Field(description="in the order in which they are numbered")
    offered: tuple[OfferedSetup, ...] = Field(description="all that were looked at")
    shared: tuple[SharedSurface, ...] = Field(default=(), description="by pairs of chosen set-ups")
    open: PlannedOpen | None = Field(default=None, description="what no view measures; older folders do not say it")


class ScannedSetup(JsonTable):
    """A set-up that is scanned."""

    number: int = Field(description="from 1, of its folder in setups/")
    execution: str = Field(description="of its run folder")
    digest: str = Field(description="of the plan that was executed")
    views: int = Field(description="scans that are used")
    points: int = Field(description="of them")
    visible: float = Field(description="what they measure, and no support touches")
    adds: float = Field(description="of that, what the set-ups before do not measure")
    place: ExecutedPlace | None = Field(
        description="where the part was found to stand; null where it was not looked for"
    )


class OpenShares(JsonTable):
    """What no scan measures, by the first reason that holds."""

    to_come: float = Field(description="views of set-ups that are not scanned yet measure it, as planned")
    lost: float = Field(description="a view was planned to measure it, and the executed one does not")
    in_contact: float = Field(description="a support touches it in every set-up")
    not_planned: float = Field(description="no view was planned for it")


class ScannedSetups(JsonTable):
    """The file."""

    part: str = Field(description="of the built-in part or of the file")
    source: str = Field(description="where the points come from")
    setups: tuple[ScannedSetup, ...] = Field(description="that are scanned, in order of their numbers")
    missing: tuple[int, ...] = Field(description="numbers of the others")
    visible: float = Field(description="measured in any set-up")
    planned: float = Field(description="the same of all set-ups as planned")
    sampled: float = Field(description="within 1 % of the diagonal of a point")
    open: OpenShares
    shared: tuple[SharedSurface, ...] = Field(description="by pairs of scanned set-ups")
    registration: ExecutedRegistration | None = Field(
        description="of whole set-ups to the reference and to each other; null where all parts stood in their places"
    )
    doubts: tuple[str, ...] = Field(description="a sentence each")
    surface: ExecutedSurface
    deviation: ExecutedDeviation | None = Field(description="of the surface; null without one")


NAME = "explore.json"

UNSEEN = "unseen"
"""The fixture of a stage that is the space not seen free: it collides, and hides nothing."""


SurfaceName = Literal["believed", "measured"]
BELIEVED: SurfaceName = "believed"
MEASURED: SurfaceName = "measured"


class ExploredCylinder(JsonTable):
    """The upright cylinder that holds the part; its middle is the origin of the explored frame."""

    diameter_mm: float = Field(description="of it")
    height_mm: float = Field(description="of it")
    middle_mm: Triple = Field(description="in the base frame")
    given: bool = Field(description="whether a person gave it; else it is that of the simulated part, a little wider")


class ExploredStage(JsonTable):
    """A batch that was planned and executed."""

    folder: str = Field(description="its run folder, below this one")
    digest: str = Field(description="of what was driven")
    views: int = Field(description="that were scanned")
    planned_on: SurfaceName = Field(description="surface about what was not seen free, or where all points lead")
    points: int = Field(description="that came back")
    seconds: float = Field(description="of the planned motion, from home to home")
    expected_mm2: float = Field(description="of the surface that it was planned on, what it was to measure first")
    too_near_mm2: float = Field(
        default=0.0, description="of that, what gave no point where the part may begin before the scanner's range"
    )
    new_mm2: float = Field(description="of the surface believed after it, what it measured and no batch before")
    surface_mm2: float = Field(description="of the surface that was believed after it")
    open_mm2: float = Field(description="of that, without a measured point beside it")
    never_entered_mm3: float = Field(description="of the cylinder, by any ray; the part's inside is of it")

    @property
    def measured_mm2(self) -> float:
        """Of the surface that was believed after it, with a measured point beside it."""
        return self.surface_mm2 - self.open_mm2


class OpenReason(JsonTable):
    """Believed surface that stays open for one reason."""

    reason: str = Field(description="at which the closest candidate view fails")
    area_mm2: float = Field(description="of the surface of all that the part may be")


class BoundAt(JsonTable):
    """A point of the curve that nothing exceeds."""

    views: int = Field(description="how many")
    found: float = Field(description="share of the surface that the best views found measure")
    at_most: float = Field(description="share that no so many of the candidates measure")


class Truth(JsonTable):
    """What a simulation knows of the true part; shares of its surface."""

    visible: float = Field(description="visible coverage of the executed views")
    by_views: tuple[float, ...] = Field(description="the same after the first, second, ... view in driving order")
    known_model_visible: float = Field(description="of the plan that knows the model (truth/)")
    known_model_views: int = Field(description="of that plan")
    coverable: float = Field(description="what its reachable candidates measure")
    fewest: int = Field(
        description="views that its candidates need at least for the coverage reached, or for all that they measure"
    )
    fewest_found: int = Field(description="of its candidates that measure as much: the best cover found")
    bound: tuple[BoundAt, ...] = Field(description="over the number of views, for the true model's candidates")
    nearest_mm: float = Field(description="smallest distance of arm or tool to anything, the true part in place")
    nearest: str = Field(description="between what")

    @property
    def fewest_words(self) -> str:
        """The fewest views for the coverage that was reached, in a line."""
        least = f"{self.fewest} at least" if self.fewest < self.fewest_found else f"{self.fewest}, proven,"
        return f"{least} for this coverage, for the true model's candidates and samples"


class ExploreFile(JsonTable):
    """The file."""

    model_config = ConfigDict(serialize_by_alias=True)

    schema_version: str = Field(alias="schema", description="of the folder's layout")
    units: str = "mm, mm2, s; the explored frame: middle of the cylinder, axes of the base frame"
    part: str = Field(description="what it is called")
    status: str = Field(description="running, or finished")
    ended: str = Field(description='why no further batch was begun, a sentence; "" while it runs')
    inputs: str = Field(description="sha256 of all that the exploration depends on")
    seed: int = Field(description="of every random choice")
    policy: str = Field(description="how batches are chosen")
    source: str = Field(description="where points come from")
    options: dict[str, JsonValue] = Field(description="of the exploration")
    cylinder: ExploredCylinder
    voxel_mm: float = Field(description="edge of a voxel")
    stages: tuple[ExploredStage, ...] = Field(description="in order")
    open: tuple[OpenReason, ...] = Field(default=(), description="what stays open, largest area first")
    model: str = Field(default="", description='the mesh of all scans, explored frame; "" where there is none yet')
    model_middle_mm: Triple | None = optional("middle of its bounding box, base frame: where cell plan places it")
    misses_limits: float | None = optional(
        "where sigma or spacing is limited: share of what was measured that does not keep it"
    )
    truth: Truth | None = optional()

    @property
    def views(self) -> int:
        """Views that were scanned."""
        return sum(stage.views for stage in self.stages)

    def rows(self) -> list[tuple[str, str]]:
        """What the command, the report and the page show of it, once a stage is finished."""
        last = self.stages[-1]
        rows = [
            ("views", f"{self.views} in {len(self.stages)} batches ({self.policy})"),
            ("motion", f"{sum(stage.seconds for stage in self.stages):.1f} s"),
            ("ended", self.ended),
            ("measured", f"{last.measured_mm2 / 100:.1f} cm2 of surface"),
            ("stays open", f"{sum(reason.area_mm2 for reason in self.open) / 100:.1f} cm2 of all that the part may be"),
        ]
        rows.append(("never entered", f"{last.never_entered_mm3 / 1000:.1f} cm3 of the cylinder, by any ray"))
        rows += [("", f"{reason.area_mm2:.0f} mm2: {reason.reason}") for reason in self.open[:4]]
        if self.misses_limits is not None:
            share = f"{100 * self.misses_limits:.2f} % of what was measured, worse than the sigma or spacing asked for"
            rows.append(("beyond limits", share))
        if (known := self.truth) is not None:
            rows += [
                (
                    "visible coverage",
                    f"{100 * known.visible:.2f} % of the true surface, of which reachable candidates of the true model "
                    f"measure {100 * known.coverable:.2f} %",
                ),
                (
                    "with the model",
                    f"{known.known_model_views} views would have measured {100 * known.known_model_visible:.2f} %",
                ),
                ("fewest views", known.fewest_words),
                ("nearest", f"{known.nearest_mm:.1f} mm ({known.nearest}), the true part in place"),
            ]
        return rows


def read(path: Path) -> ExploreFile:
    """An explore.json as the value that defines it.

    Raises:
        FileError: if it is damaged.
    """
    return parsed(ExploreFile, path.read_bytes(), path)


class Change(JsonTable):
    """A single change of cell, scanner or plan."""

    kind: str = Field(description="what is changed")
    change: str = Field(description="in words")
    setting: str = Field(description='option or key that makes it; "" where it is none')


class TriedChange(Change):
    """A change that was tried."""

    gains_estimated: float = Field(description="share of what no candidate measures, from representatives")


class NamedChange(Change):
    """A change that is named; every sample that it is named for was asked."""

    gains: float = Field(description="share of what it is named for")
    gains_mm2: float = Field(description="the area of that")


class OpenPatch(JsonTable):
    """Connected samples of one group."""

    area_mm2: float = Field(description="that they stand for")
    centre_mm: Triple = Field(description="the sample nearest to the middle of all, object frame")
    change: NamedChange | None = optional()


class OpenSamples(JsonTable):
    """Samples that stay open for one reason."""

    group: int = Field(description="number in why.ply, from 1")
    reason: str = Field(description="at which the closest candidate fails")
    code: int = Field(description="of the reason in why.ply")
    what: str = Field(description='in the way, or in collision with what; "" where the reason has none')
    title: str = Field(description="reason and what, in words")
    detail: str = Field(description="what there is to add about the closest candidates")
    share: float = Field(description="of the surface")
    area_mm2: float = Field(description="that they stand for")
    n_patches: int = Field(description="connected pieces, of which `patches` has the largest")
    changes: tuple[NamedChange, ...] = Field(description="the one to prefer first")
    patches: tuple[OpenPatch, ...] = Field(description="the largest first")


class WhyReport(JsonTable):
    """The file."""

    units: str = "share, visible, open and gains are fractions of area; mm and mm2, object frame"
    part: str = Field(description="name of the part")
    plan: str = Field(description="sha256 of plan.json")
    samples: int = Field(description="held-out samples")
    area_mm2: float = Field(description="of the surface")
    visible: float = Field(description="what the plan measures")
    open: float = Field(description="what it does not")
    groups: tuple[OpenSamples, ...] = Field(description="largest area first")
    not_measurable: float = Field(description="what no reachable candidate measures")
    overall: tuple[NamedChange, ...] = Field(description="changes that gain most of that")
    tried: tuple[TriedChange, ...] = Field(description="all that was tried")
