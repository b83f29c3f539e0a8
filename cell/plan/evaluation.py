"""Evaluation of a connected plan: values of report.json and plan.json, verdict on the requested coverage."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from pydantic import JsonValue

from cell.formatting import percent
from cell.part.workpiece import Workpiece
from cell.plan.candidates import view_evaluator
from cell.plan.motion import ConnectedPlan
from cell.plan.selection import Selection, SelectionProblem, pose_error
from cell.runs import schema
from cell.runs.facts import degrees
from cell.scene.model import PlanSettings, RegionTargets, with_rest
from cell.scene.settle import SettledScene
from cell.world.clearance import MotionClearance, time_of_tightest
from cell.world.occluders import fixed_occluders
from cell.world.support_contact import in_contact
from planner.cover import Cover
from planner.cover.overlap import OverlapGraph
from planner.cover.robust import RobustCover, min_views_at_confidence
from planner.errors import PlannerError
from planner.geometry.mesh import TriangleMesh
from planner.measurability import coverage
from planner.measurability.quality import LimitedScanner, best_sigma, best_spacing, best_values
from planner.ports import ARM_AXES
from planner.timing.motion import Motion, jerk_free_duration
from planner.values import Bools, Ints
from planner.viewpoints.attainable import probe_attainable
from planner.viewpoints.lines_of_sight import RayTargets
from planner.why.why import REASON_OF_VERDICT, Reason, diagnose

_ATTAINABLE_ERROR = 1e-3  # largest standard error of the attainable coverage, as a share of the surface
_LEAST_SEARCHED = 200  # least number of samples for which a pose is searched, as far as there are open ones
_N_DIAGNOSED = 300  # unmeasured samples of a region for which the reason is determined
_LISTED_OPTIONS = (
    "max_views", "multiplicity", "pinned", "banned", "cost", "overlap_mm2", "overlap_share", "overlap_in_order",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class OptionalResults:
    """Results beyond a plain plan; None if they were not requested.

    Attributes:
        attainable: coverage by any pose of the robot.
        robust: coverage under pose errors.
        curve: coverage over the number of views.
    """

    attainable: schema.Attainable | None = None
    robust: schema.RobustCoverage | None = None
    curve: schema.Curve | None = None


@dataclass(frozen=True, slots=True)
class Verdict:
    """Requested coverages that are missed, one sentence each; none if all are met."""

    missed: tuple[str, ...] = ()

    @property
    def exit_code(self) -> int:
        """0, or 3 if a requested coverage is missed."""
        return 3 if self.missed else 0


def judge(
    subject: str,
    shares: tuple[float, float] | None,
    visible: tuple[float, float],
    remedies: tuple[str, str],
    regions: Sequence[str] = (),
) -> Verdict:
    """Compare reached with requested coverages.

    Args:
        subject: of the sentences, with a verb.
        shares: measured share of the coverable surface, and the requested share below 1; None without a request. A
            request of 1 refers to the samples of the matrix, which a plan always covers.
        visible: measured share of the surface, and the required share.
        remedies: for each of the two.
        regions: sentences on regions that miss their coverage.
    """
    missed = list(regions)
    if shares is not None and shares[1] < 1 and shares[0] < shares[1]:
        missed.insert(
            0,
            f"{subject} {100 * shares[0]:.2f} % of the coverable surface, less than the requested "
            f"{100 * shares[1]:g} %: {remedies[0]}",
        )
    if visible[0] < visible[1]:
        missed.append(
            f"{subject} {100 * visible[0]:.2f} % of the surface, less than the required {100 * visible[1]:g} %; "
            f"{remedies[1]}"
        )
    return Verdict(tuple(missed))


def judge_plan(report: schema.Report, remedies: tuple[str, str], *, has_target: bool) -> Verdict:
    """Judge a plan.

    Args:
        report: of the plan.
        remedies: for the coverage of the coverable surface, and of the whole surface.
        has_target: whether a coverage was requested once a sample. A coverage that is requested k times a sample, for k
            views, or with a probability refers to the samples of the matrix, and is not judged here.
    """
    reached = report.coverage
    return judge(
        "the plan measures",
        (reached.visible_of_coverable, report.settings.coverage) if has_target and report.regions is None else None,
        (reached.visible, report.settings.required_visible),
        remedies,
        [*(missed_regions(report) if has_target else ()), *unmeasured_regions(report)],
    )


def unmeasured_regions(report: schema.Report) -> list[str]:
    """Return a sentence for each region of which nothing can be measured, and for each without samples."""
    closed = [each for each in report.regions or () if each.coverable == 0]
    return [f"the region '{each.name}' cannot be measured: {each.cause}" for each in closed]


def missed_regions(report: schema.Report) -> list[str]:
    """Return a sentence for each coverage below 1 that regions miss on held-out samples."""
    regions = report.regions or ()
    groups = [[each] for each in regions if not each.common_target] + [[each for each in regions if each.common_target]]
    sentences = []
    for group in groups:
        coverable = sum(each.coverable * each.area_mm2 * each.weight for each in group)
        seen = sum(each.visible * each.area_mm2 * each.weight for each in group)
        if coverable > 0 and group[0].target < 1 and seen < group[0].target * coverable:
            names = " and ".join(f"'{each.name}'" for each in group)
            sentences.append(
                f"the plan measures {percent(seen / coverable)} of the coverable surface of {names}, less than the "
                f"requested {100 * group[0].target:g} %; see cell why"
            )
    return sentences


def plan_report(
    settled: SettledScene,
    planning: TriangleMesh,
    problem: SelectionProblem,
    plan: ConnectedPlan,
    clearance: MotionClearance,
    motion: Motion,
    optional: OptionalResults,
) -> schema.Report:
    """Return the content of report.json."""
    cover, options = plan.cover, settled.scene.plan
    return schema.Report(
        part=_part(settled.part, planning),
        settings=_settings(settled, plan),
        n_views=len(cover.views),
        n_samples=problem.M.shape[0],
        coverage=_coverage(problem, plan),
        attainable=optional.attainable,
        sigma=None if options.max_sigma_mm is None else _sigma(problem, plan, options.max_sigma_mm),
        spacing=_spacing(settled, problem, plan),
        regions=_regions(with_rest(settled.scene.region), settled.part.reference, problem, plan),
        solver=cover.solver,
        status=_status(plan, options.coverage),
        lower_bound=cover.lower_bound,
        gap=cover.gap,
        verdicts=schema.Verdicts(
            **{verdict.name.lower(): count for verdict, count in problem.reached.counts().items()}
        ),
        blockers=problem.reached.blockers(),
        exclusions=[schema.Exclusion(id=view.candidate, cause=view.reason) for view in plan.dropped],
        views=_views(problem, plan, clearance),
        motion=_motion(plan, clearance, motion, settled.scene.robot.speed_scaling),
        max_coverage=_max_coverage(cover),
        overlap=_overlap(plan),
        robust=optional.robust,
        multiplicity=_multiplicity(cover),
        cost=_cost(cover),
        curve=optional.curve,
        clearance=clearance_of(clearance, motion, problem.world.collision),
    )


def _part(part: Workpiece, planning: TriangleMesh) -> schema.ReportPart:
    return schema.ReportPart(
        name=part.name,
        faces=len(part.reference.faces),
        planning_faces=len(planning.faces),
        extents_mm=(part.size * 1000).round(6).tolist(),
        area_mm2=round(float(part.reference.areas.sum()) * 1e6, 3),
        findings=[finding.sentence for finding in part.findings],
    )


def _settings(settled: SettledScene, plan: ConnectedPlan) -> schema.ReportSettings:
    scene, settings, sweeps = settled.scene, settled.settings, plan.driven.sweeps
    seconds = sorted(path.duration for path in sweeps)
    scanner_keys = {
        key: value for key, value in settings.scanner.items() if key not in schema.ReportSettings.model_fields
    }
    return schema.ReportSettings(
        placement_mm=scene.placement.position_mm,
        placement_abc_deg=scene.placement.abc_deg,
        scanner=scene.scanner.type,
        sensor=scene.scanner.sensor,
        sweep_poses=plan.driven.T_object_poses.shape[1] if sweeps else None,
        sweep_in_motion=True if sweeps else None,
        sweep_s=(round(seconds[0], 6), round(seconds[-1], 6)) if sweeps else None,
        standoffs_mm=[round(standoff * 1000, 9) for standoff in settings.standoffs],
        rolls_deg=scene.plan.rolls_deg,
        candidates=scene.plan.candidates,
        fill=scene.plan.fill,
        coverage=scene.plan.coverage,
        required_visible=scene.plan.required_visible,
        seed=scene.plan.seed,
        **_options(scene.plan),
        **{key: list(value) if isinstance(value, tuple) else value for key, value in scanner_keys.items()},
    )


def _options(plan: PlanSettings) -> dict[str, JsonValue]:
    """Return the options that differ from their defaults."""
    keys = [key for key in _LISTED_OPTIONS if getattr(plan, key) != PlanSettings.model_fields[key].default]
    keys += ["scan_s", "settle_s"] if plan.cost == "time" else []
    keys += ["pose_sd_mm", "pose_sd_deg", "alpha", "ensemble"] if not pose_error(plan).is_exact else []
    values = {key: getattr(plan, key) for key in keys}
    return {key: list(value) if isinstance(value, tuple) else value for key, value in values.items()}


def _coverage(problem: SelectionProblem, plan: ConnectedPlan) -> schema.Coverage:
    cover = plan.cover
    visible, coverable = plan.visible.fraction, problem.prediction.coverable_with(plan.visible)
    return schema.Coverage(
        visible=visible,
        coverable=coverable,
        visible_of_coverable=visible / coverable if coverable > 0 else 0.0,
        visible_with_arm=plan.driven.visible_with_arm,
        target_on_samples=plan.target if len(plan.selection.targets) == 1 else None,
        planned_on_samples=cover.covered_area / cover.total_area,
        coverable_on_samples=cover.coverable_area / cover.total_area,
    )


def _views(problem: SelectionProblem, plan: ConnectedPlan, clearance: MotionClearance) -> list[schema.ReportView]:
    tour, marginal = plan.tour, coverage.marginal_coverage(plan.driven.seen)
    return [
        schema.ReportView(
            id=candidate,
            marginal_coverage=float(marginal[stop]),
            source_in_base_mm=(plan.T_base_scanner[stop, :3, 3] * 1000).round(3).tolist(),
            q_deg=degrees(tour.q[stop][:ARM_AXES]),
            e_deg=degrees(tour.q[stop][ARM_AXES:]) or None,
            roll_deg=np.degrees(problem.candidates.roll[candidate]).round(9),
            segment_clearance_mm=round(1000 * float(clearance.distance[stop]), 6),
        )
        for stop, candidate in enumerate(plan.candidate.tolist())
    ]


def _motion(plan: ConnectedPlan, clearance: MotionClearance, motion: Motion, speed: float) -> schema.ReportMotion:
    tour, nearest = plan.tour, int(np.argmin(clearance.distance))
    return schema.ReportMotion(
        duration_s=motion.duration,
        jerk_free_bound_s=jerk_free_duration(motion),
        baseline_duration_s=tour.baseline_duration,
        lower_bound_s=tour.lower_bound,
        via_points=len(motion.via_q),
        detours=tour.detour.sum(),
        speed_fraction=speed,
        minimum_clearance_mm=round(float(clearance.distance[nearest]) * 1000, 6),
        between=clearance.between[nearest],
    )


def _sigma(problem: SelectionProblem, plan: ConnectedPlan, limit_mm: float) -> schema.Sigma:
    """Return the expected standard deviation of the plan's points."""
    best = 1000 * best_sigma(problem.M, plan.cover.views)
    median, most = np.quantile(best[np.isfinite(best)], [0.5, 0.95]).round(6)
    return schema.Sigma(median_mm=median, quantile_95_mm=most, limit_mm=limit_mm)


def _spacing(settled: SettledScene, problem: SelectionProblem, plan: ConnectedPlan) -> schema.Spacing | None:
    """Return the spacing of the plan's points; None if the scanner does not know it or nothing is measured."""
    scanner, samples = problem.prediction.scanner, problem.prediction.samples
    best = best_spacing(plan.driven.T_object_poses, samples, plan.driven.seen, scanner)
    if best is None or not plan.driven.seen.any():
        return None
    median, most, nearly_all = (1000 * np.nanquantile(best, [0.5, 0.95, 0.99])).round(6).tolist()
    limit_mm = settled.scene.scanner.max_spacing_mm
    return schema.Spacing(median_mm=median, quantile_95_mm=most, quantile_99_mm=nearly_all, limit_mm=limit_mm)


def _status(plan: ConnectedPlan, requested: float) -> str:
    """Return the status of the selection, with its target if that was raised above the requested coverage."""
    status = plan.cover.sentence if plan.selection.details is None else plan.selection.sentence
    has_target = len(plan.selection.targets) <= 1 and plan.cover.max_views is None  # regions have their own
    if has_target and plan.target != requested:
        status += f", at {100 * plan.target:.2f} % of the coverable samples for the requested {100 * requested:g} %"
    status = status[:1].upper() + status[1:]
    return f"{status}. {plan.searched}" if plan.searched else status


def _max_coverage(cover: Cover) -> schema.MaxCoverage | None:
    if cover.max_views is None:
        return None
    return schema.MaxCoverage(
        max_views=cover.max_views,
        coverage=cover.covered_area / cover.total_area,
        upper_bound=cover.upper_area / cover.total_area,
        gap_points=cover.gap_percent,
    )


def _overlap(plan: ConnectedPlan) -> schema.Overlap | None:
    graph, order = plan.selection.details, plan.tour.order
    if not isinstance(graph, OverlapGraph):
        return None
    without = plan.selection.cover.n_views_without_overlap or 0
    return schema.Overlap(
        connected=graph.is_connected,
        extra_views=len(plan.selection.cover.views) - without,
        views_without_overlap=without,
        # The first view overlaps no earlier one and does not count.
        views_without_earlier_overlap=sum(not graph.adjacent[order[k], order[:k]].any() for k in range(1, len(order))),
        components=[
            schema.OverlapComponent(views=(graph.component == k).sum(), coverage=area / plan.cover.total_area)
            for k, area in enumerate(graph.component_area)
        ],
    )


def robust_selection(selection: Selection, total_area: float) -> schema.RobustSelection | None:
    """Return the numbers of a selection under pose errors; None if poses are exact."""
    robust = selection.details
    if not isinstance(robust, RobustCover):
        return None
    return schema.RobustSelection(
        alpha=robust.alpha,
        members=robust.ensemble_size,
        required_views=min_views_at_confidence(robust.alpha, robust.ensemble_size),
        robust_on_samples=robust.robust_area / total_area,
        robust_coverable_on_samples=robust.robust_coverable_area / total_area,
    )


def _multiplicity(cover: Cover) -> schema.Multiplicity | None:
    if cover.demand == 1:
        return None
    return schema.Multiplicity(
        views_per_sample=cover.demand, samples_with_fewer_candidates=len(cover.unsatisfiable_rows)
    )


def _cost(cover: Cover) -> schema.Cost | None:
    return None if cover.cost_and_bound is None else schema.Cost(seconds=cover.cost, seconds_bound=cover.cost_bound)


def _regions(
    regions: Sequence[RegionTargets], reference: TriangleMesh, problem: SelectionProblem, plan: ConnectedPlan
) -> tuple[schema.RegionResult, ...] | None:
    """Return the results of each region that counts, on held-out samples; None for a part without regions."""
    if not regions:
        return None
    samples, options = problem.prediction.samples, problem.request.plan
    assert samples.region is not None
    assert reference.region is not None
    coverable: Bools = problem.prediction.coverable.covered | plan.visible.covered
    times = plan.driven.seen.sum(axis=1)
    results = []
    for number, region in enumerate(regions):
        rows = np.flatnonzero(samples.region == number)
        area_mm2 = round(1e6 * float(reference.areas[reference.region == number].sum()), 3)
        if not region.is_measured or not (len(rows) or area_mm2):
            continue
        share, seen = _mean(coverable[rows]), _mean(times[rows] > 0)
        views = region.views or options.multiplicity
        requested = options.coverage if region.coverage is None else region.coverage
        uncoverable_rows = rows[~coverable[rows]]
        results.append(
            schema.RegionResult(
                name=region.name,
                area_mm2=area_mm2,
                target=requested,
                common_target=region.coverage is None,
                views=views,
                max_sigma_mm=region.max_sigma_mm,
                max_spacing_mm=region.max_spacing_mm,
                weight=region.weight,
                visible=seen,
                coverable=share,
                visible_of_coverable=seen / share if share > 0 else 0.0,
                satisfied_share=_mean(times[rows] >= views),
                cause=(
                    _reason(region, uncoverable_rows, 1 - share, problem)
                    if len(uncoverable_rows) and share < requested
                    else ""
                    if len(rows)
                    else no_samples(area_mm2, len(samples))
                ),
            )
        )
    return tuple(results)


def _mean(values: Bools) -> float:
    """Return the share of true values, 0 without values."""
    return float(values.mean()) if len(values) else 0.0


def no_samples(area_mm2: float, n_samples: int) -> str:
    """Return the cause for which the coverage of a region with an area is not known."""
    return (
        f'none of the {n_samples:,} samples of the surface lies in its {area_mm2:g} mm2; enlarge it, or set care = "no"'
    )


def _reason(region: RegionTargets, uncoverable: Ints, share: float, problem: SelectionProblem) -> str:
    """Return the most frequent cause for which no reachable candidate measures a share of a region."""
    known = problem.prediction
    samples, scanner = known.samples, known.scanner
    some = uncoverable[
        np.linspace(0, len(uncoverable) - 1, min(_N_DIAGNOSED, len(uncoverable))).round().astype(np.int64)
    ]
    targets = RayTargets.of(samples.points, samples.normals, samples.region)
    fails = REASON_OF_VERDICT[problem.reached.verdict]
    why = diagnose(targets, some, problem.candidates, scanner, known.casters, fails)
    number = int(np.argmax(np.bincount(why.reason)))
    sentence = (
        f"no reachable candidate measures {100 * share:.1f} % of it; most frequent cause: {Reason(number).sentence}"
    )
    if number != Reason.TOO_SPARSE or region.max_spacing_mm is None:
        return sentence
    sparse = np.flatnonzero(why.reason == Reason.TOO_SPARSE)
    poses = problem.candidates.T_object_scanner.reshape(-1, 1, 4, 4)[why.pose[sparse]]
    law, rows = cast(LimitedScanner, scanner), samples.pick(some[sparse])
    spacing = 1000 * best_values([law.spacing], poses, rows, np.eye(len(sparse), dtype=np.bool_), law.scanner)[0]
    near, far = 1000 * np.quantile(why.distance[sparse], [0.1, 0.9])
    return (
        f"{sentence} ({np.nanmedian(spacing):.3g} mm from {near:.0f} to {far:.0f} mm away, limit "
        f"{region.max_spacing_mm:g} mm); use a finer scanner.resolution_deg, or a device with a nearer range"
    )


@dataclass(frozen=True, slots=True)
class Share:
    """Share of a finite population, estimated from a sample of it."""

    value: float
    standard_error: float


def estimated_share(hits: Bools, population: int) -> Share:
    """Estimate a share from (n,) hits of samples drawn without replacement."""
    value = float(hits.mean()) if len(hits) else 0.0
    missing = 1 - (len(hits) - 1) / (population - 1) if population > 1 else 0.0
    return Share(value, float(np.sqrt(value * (1 - value) / max(len(hits), 1) * missing)))


def attainable_coverage(
    problem: SelectionProblem, visible: coverage.Coverage, rng: np.random.Generator
) -> schema.Attainable:
    """Estimate the coverage by any pose of this robot, on the held-out samples.

    Coverage by the plan and by reachable candidates is known for all samples. Of the others, as many are drawn as a
    standard error of `_ATTAINABLE_ERROR` needs at most, up to `Effort.searched_samples`; a measuring pose is searched
    for each.
    """
    known, samples = problem.prediction, problem.prediction.samples
    is_known = np.asarray(known.coverable.covered | visible.covered)
    unknown_rows = np.flatnonzero(~is_known)
    total = float(samples.areas.sum())
    left = float(samples.areas[unknown_rows].sum()) / total
    # A share that is estimated from n samples has a standard error of at most 1 / (2 sqrt(n)).
    count = max(_LEAST_SEARCHED, int(np.ceil((left / (2 * _ATTAINABLE_ERROR)) ** 2)))
    sample_rows = np.sort(rng.permutation(unknown_rows)[: min(count, problem.request.effort.searched_samples)])
    searched = samples.pick(sample_rows)
    probe = probe_attainable(
        RayTargets.of(searched.points, searched.normals, searched.region),
        view_evaluator(problem.cell, known.scanner, known.casters),
    )
    share = estimated_share(probe.measured, len(unknown_rows))
    # A pose inside a support sees the surface that it touches.
    is_seen = probe.visible & ~in_contact(searched, fixed_occluders(problem.cell.world))
    out_of_reach = estimated_share(is_seen & ~probe.measured, len(unknown_rows)).value
    return schema.Attainable(
        share=float(samples.areas[is_known].sum()) / total + left * share.value,
        standard_error=left * share.standard_error,
        samples=len(sample_rows),
        out_of_reach=left * out_of_reach,
        out_of_sight=left * (1 - share.value - out_of_reach),
    )


def clearance_of(measured: MotionClearance, motion: Motion, collision: str) -> schema.Clearance:
    """Return the clearance of each segment and the tightest moment.

    Args:
        measured: clearance of the motion.
        motion: timed.
        collision: model of the part, hull or exact.
    """
    tightest = measured.tightest
    angles = [] if tightest is None else np.degrees(tightest.q).round(6).tolist()
    return schema.Clearance(
        collision=collision,
        segments=[
            schema.SegmentClearance(minimum_mm=_mm(nearest), lower_bound_mm=_mm(proven), between=between)
            for nearest, proven, between in zip(measured.distance, measured.lower_bound, measured.between, strict=True)
        ],
        tightest=None
        if tightest is None
        else schema.Tightest(
            segment=tightest.segment,
            time_s=round(time_of_tightest(motion.t, motion.q, motion.segment_of_sample, tightest), 6),
            distance_mm=_mm(tightest.distance),
            between=tightest.between,
            points_in_base_mm=(1000 * tightest.points).round(4).tolist(),
            q_deg=angles[:ARM_AXES],
            e_deg=angles[ARM_AXES:] or None,
        ),
    )


def _mm(metres: float) -> float:
    return round(1000 * float(metres), 4)


def require_no_contact(measured: MotionClearance) -> None:
    """Check a motion a last time before it is written. Certified segments pass; a failure is a bug.

    Raises:
        PlannerError: if a segment is not proven to be free of contact.
    """
    for number, (proven, between) in enumerate(zip(measured.lower_bound, measured.between, strict=True), start=1):
        if proven <= 0:
            raise PlannerError(
                f"segment {number} of the motion is not proven to be free of contact ({between}, "
                f"{1000 * measured.distance[number - 1]:.3f} mm measured); every segment must be"
            )
