"""plan.json: the views of a plan in visiting order, and what is known about their selection.

What is a fraction is one of the surface's area; `_on_features`, `covered` and bounds count the samples of
measurability.npz, the rest of coverage the held-out samples of the prediction.
"""

from typing import Literal

import numpy as np
from pydantic import Field

from cell.run.json_table import JointAngles, JsonTable, Transform, Triple, optional
from planner.values import Floats


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
