"""What a plan amounts to: the value that report.json, the page and the table are made of."""

from dataclasses import dataclass

import numpy as np

from cell.part.workpiece import Workpiece
from cell.plan import wish_results
from cell.plan.clearances import clearance_of
from cell.plan.connected_plan import ConnectedPlan
from cell.plan.problem import Problem
from cell.plan.region_results import results_of
from cell.plan.steps import Job
from cell.runs.facts import degrees
from cell.runs.schema import (
    Attainable,
    Coverage,
    Curve,
    Dropped,
    Promise,
    RegionResult,
    Report,
    ReportMotion,
    ReportPart,
    ReportSettings,
    ReportView,
    Sigma,
    Spacing,
    Verdicts,
)
from cell.scene.model import with_rest
from cell.world.clearance import MotionClearance
from planner.geometry.mesh import TriangleMesh
from planner.measurability import coverage
from planner.measurability.quality import best_sigma, best_spacing
from planner.ports import ARM_AXES
from planner.timing.motion import Motion, jerk_free_duration


@dataclass(frozen=True, slots=True)
class Further:
    """What is worked out beyond a plain plan.

    Attributes:
        lost: what any pose measures that the robot takes up; None: nobody asks.
        promise: under pose errors, where that was asked for.
        curve: over the number of views, where that was asked for.
    """

    lost: Attainable | None = None
    promise: Promise | None = None
    curve: Curve | None = None


def plan_report(
    job: Job,
    planning: TriangleMesh,
    problem: Problem,
    chosen: ConnectedPlan,
    clearance: MotionClearance,
    motion: Motion,
    further: Further,
) -> Report:
    """Everything that the report says."""
    cover, plan = chosen.cover, job.scene.plan
    return Report(
        part=_part(job.part, planning),
        settings=_settings(job, chosen),
        n_views=len(cover.views),
        n_features=problem.M.shape[0],
        coverage=_coverage(problem, chosen),
        attainable=further.lost,
        sigma=None if plan.max_sigma_mm is None else _sigma(problem, chosen, plan.max_sigma_mm),
        spacing=_spacing(job, problem, chosen),
        regions=_regions(job, problem, chosen),
        solver=cover.solver,
        status=_sentence(chosen) + _at_target(chosen, plan.coverage),
        lower_bound=cover.lower_bound,
        gap=cover.gap,
        verdicts=Verdicts(**{verdict.name.lower(): count for verdict, count in problem.reached.counts().items()}),
        blockers=problem.reached.blockers(),
        dropped=[Dropped(id=lost.candidate, reason=lost.reason) for lost in chosen.dropped],
        views=_views(problem, chosen, clearance),
        motion=_motion(chosen, clearance, motion, job.scene.robot.speed_scaling),
        most_coverage=wish_results.most_coverage_of(chosen.selected, cover.total_area),
        overlap=wish_results.overlap_of(chosen.selected, chosen.tour.order, cover.total_area),
        promise=further.promise,
        multiplicity=wish_results.multiplicity_of(chosen.selected),
        cost=wish_results.cost_of(cover),
        curve=further.curve,
        clearance=clearance_of(clearance, motion, problem.world.collision),
    )


def _part(part: Workpiece, planning: TriangleMesh) -> ReportPart:
    return ReportPart(
        name=part.name,
        faces=len(part.reference.faces),
        planning_faces=len(planning.faces),
        extents_mm=(part.size * 1000).round(6).tolist(),
        area_mm2=round(float(part.reference.areas.sum()) * 1e6, 3),
        findings=[finding.sentence for finding in part.findings],
    )


def _settings(job: Job, chosen: ConnectedPlan) -> ReportSettings:
    scene, settings, sweeps = job.scene, job.settings, chosen.sweeps
    seconds = sorted(path.duration for path in sweeps)
    own = {key: value for key, value in settings.scanner.items() if key not in ReportSettings.model_fields}
    return ReportSettings(
        placement_mm=scene.placement.position_mm,
        placement_abc_deg=scene.placement.abc_deg,
        scanner=scene.scanner.type,
        sensor=scene.scanner.sensor,
        sweep_poses=chosen.T_object_poses.shape[1] if sweeps else None,
        sweep_in_motion=True if sweeps else None,
        sweep_s=(round(seconds[0], 6), round(seconds[-1], 6)) if sweeps else None,
        standoffs_mm=[round(standoff * 1000, 9) for standoff in settings.standoffs],
        rolls_deg=scene.plan.rolls_deg,
        candidates=scene.plan.candidates,
        fill=scene.plan.fill,
        coverage=scene.plan.coverage,
        required_visible=scene.plan.required_visible,
        seed=scene.plan.seed,
        **wish_results.settings(scene.plan),
        **{key: list(value) if isinstance(value, tuple) else value for key, value in own.items()},
    )


def _coverage(problem: Problem, chosen: ConnectedPlan) -> Coverage:
    cover = chosen.cover
    visible, coverable = chosen.visible.fraction, problem.prediction.coverable_with(chosen.visible)
    return Coverage(
        visible=visible,
        coverable=coverable,
        visible_of_coverable=visible / coverable if coverable > 0 else 0.0,
        visible_with_arm=chosen.visible_with_arm,
        target_on_features=chosen.target if len(chosen.selected.targets) == 1 else None,
        planned_on_features=cover.covered_area / cover.total_area,
        coverable_on_features=cover.coverable_area / cover.total_area,
    )


def _views(problem: Problem, chosen: ConnectedPlan, clearance: MotionClearance) -> list[ReportView]:
    tour, adds = chosen.tour, coverage.marginal_coverage(chosen.seen)
    return [
        ReportView(
            id=candidate,
            adds=float(adds[stop]),
            source_in_base_mm=(chosen.T_base_scanner[stop, :3, 3] * 1000).round(3).tolist(),
            q_deg=degrees(tour.q[stop][:ARM_AXES]),
            e_deg=degrees(tour.q[stop][ARM_AXES:]) or None,
            roll_deg=np.degrees(problem.candidates.roll[candidate]).round(9),
            clearance_on_the_way_mm=_mm(clearance.distance[stop]),
        )
        for stop, candidate in enumerate(chosen.candidate.tolist())
    ]


def _motion(chosen: ConnectedPlan, clearance: MotionClearance, motion: Motion, speed: float) -> ReportMotion:
    tour, leg = chosen.tour, int(np.argmin(clearance.distance))
    return ReportMotion(
        duration_s=motion.duration,
        jerk_free_bound_s=jerk_free_duration(motion),
        baseline_duration_s=tour.baseline_duration,
        lower_bound_s=tour.lower_bound,
        via_points=len(motion.via_q),
        detours=tour.detour.sum(),
        speed_fraction=speed,
        minimum_clearance_mm=_mm(clearance.distance[leg]),
        between=clearance.between[leg],
    )


def _sigma(problem: Problem, chosen: ConnectedPlan, limit_mm: float) -> Sigma:
    """Expected standard deviation of the plan's points."""
    best = 1000 * best_sigma(problem.M, chosen.cover.views)
    median, most = np.quantile(best[np.isfinite(best)], [0.5, 0.95]).round(6)
    return Sigma(median_mm=median, quantile_95_mm=most, limit_mm=limit_mm)


def _spacing(job: Job, problem: Problem, chosen: ConnectedPlan) -> Spacing | None:
    """How far apart the plan's points lie; None of a scanner that does not know it, or where nothing is measured."""
    scanner, samples = problem.prediction.scanner, problem.prediction.samples
    best = best_spacing(chosen.T_object_poses, samples, chosen.seen, scanner)
    if best is None or not chosen.seen.any():
        return None
    median, most, nearly_all = (1000 * np.nanquantile(best, [0.5, 0.95, 0.99])).round(6).tolist()
    limit_mm = job.scene.scanner.max_spacing_mm
    return Spacing(median_mm=median, quantile_95_mm=most, quantile_99_mm=nearly_all, limit_mm=limit_mm)


def _regions(job: Job, problem: Problem, chosen: ConnectedPlan) -> tuple[RegionResult, ...] | None:
    """What becomes of each region; None of a part without."""
    regions = with_rest(job.scene.region)
    return results_of(regions, job.part.reference, problem, chosen) if regions else None


def _sentence(chosen: ConnectedPlan) -> str:
    """The status of the selection: of the views as they were exchanged, where the request allows that."""
    return chosen.cover.sentence if chosen.selected.answer is None else chosen.selected.sentence


def _at_target(chosen: ConnectedPlan, asked: float) -> str:
    """What the status is about where the target on the matrix was raised above the coverage that was asked for."""
    target = chosen.target
    if len(chosen.selected.targets) > 1:  # regions have targets of their own
        return ""
    return (
        "" if target == asked else f", at {100 * target:.2f} % of the coverable samples for the {100 * asked:g} % asked"
    )


def _mm(metres: float) -> float:
    return round(float(metres) * 1000, 6)
