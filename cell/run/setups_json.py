"""setups.json and scanned/report.json: set-ups of one part planned as one cover, and what their scans are together.

Shares are fractions of the surface, on the held-out samples that all set-ups have.
"""

from pydantic import Field

from cell.run.execution_json import ExecutedDeviation, ExecutedPlace, ExecutedRegistration, ExecutedSurface
from cell.run.json_table import JsonTable, Triple, optional
from cell.run.report_json import Curve


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
