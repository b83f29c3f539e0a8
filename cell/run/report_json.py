"""report.json of a plan: what its page, its table and `--json` say. It holds no clock value."""

from pydantic import Field, JsonValue, SerializerFunctionWrapHandler, model_serializer

from cell.run.json_table import JointAngles, JsonTable, OpenTable, Triple, optional
from cell.run.plan_json import (
    Clearance,
    Cost,
    Coverage,
    Dropped,
    MostCoverage,
    Multiplicity,
    OpenOf,
    Overlap,
    Promise,
    Verdicts,
)


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
    def alone(self) -> bool:
        """Whether its coverage was asked of it alone."""
        return self.open_of is None and not self.of_several
