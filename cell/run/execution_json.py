"""report.json of an execution: what its page, its table and `--json` say. It holds no clock value."""

from pydantic import ConfigDict, Field

from cell.run.json_table import JsonTable, optional


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
        description="motions that the points do not tell to 0.05 mm, in words: the part stays as planned along them"
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
