"""What a plan amounts to: the summary that report.json, the page and the table are made of, and its pictures."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.part.workpiece import Workpiece
from cell.plan import request as requests
from cell.plan.files import degrees
from cell.plan.view_plan import ConnectedPlan
from cell.scene.resolve import Settings
from cell.scene.scene import Scene
from planner.measurability.matrix import Measurability
from planner.reach.reach import Reach
from planner.surface.mesh import TriangleMesh, face_areas
from planner.timing.motion import Motion, jerk_free_duration
from planner.viewpoints.viewpoints import Viewpoints


def plan_summary(
    scene: Scene,
    settings: Settings,
    part: Workpiece,
    planning: TriangleMesh,
    candidates: Viewpoints,
    reached: Reach,
    M: Measurability,
    chosen: ConnectedPlan,
    motion: Motion,
    visible: float,
    coverable: float,
) -> dict[str, Any]:
    """Everything that the report says, as JSON types; fractions of area, mm and deg as the names say.

    Args:
        scene: for the settings that were asked for.
        settings: what they were settled to.
        part: the part.
        planning: its decimated copy.
        candidates: the viewpoints.
        reached: verdicts.
        M: the matrix that the cover was solved on.
        chosen: views and motion.
        motion: timed.
        visible: predicted visible coverage, fraction of the surface.
        coverable: what reachable candidates can measure, fraction of the surface.
    """
    cover, tour = chosen.cover, chosen.tour
    adds = dict(zip(cover.views.tolist(), (cover.marginal_area / cover.total_area).tolist(), strict=True))
    leg = int(np.nanargmin(tour.clearance)) if len(tour.clearance) and np.isfinite(tour.clearance).any() else None
    return {
        "part": {
            "name": part.name,
            "faces": len(part.reference.faces),
            "planning_faces": len(planning.faces),
            "extents_mm": (part.size * 1000).round(6).tolist(),
            "area_mm2": round(float(face_areas(part.reference).sum()) * 1e6, 3),
            "findings": [finding.sentence for finding in part.findings],
        },
        "settings": {
            "placement_mm": list(scene.placement.position_mm),
            "placement_abc_deg": list(scene.placement.abc_deg),
            "scanner": scene.scanner.type,
            **({} if scene.scanner.sensor is None else {"sensor": scene.scanner.sensor}),
            **{key: _plain(value) for key, value in settings.scanner.items()},
            **sweep_summary(chosen),
            "standoffs_mm": [round(standoff * 1000, 9) for standoff in settings.standoffs],
            "rolls_deg": list(scene.plan.rolls_deg),
            "candidates": scene.plan.candidates,
            "fill": scene.plan.fill,
            "coverage": scene.plan.coverage,
            "required_visible": scene.plan.required_visible,
            "seed": scene.plan.seed,
            **requests.settings(scene.plan),
        },
        "n_views": len(cover.views),
        "n_features": M.shape[0],
        "coverage": {
            "visible": visible,
            "coverable": coverable,
            "visible_of_coverable": visible / coverable if coverable > 0 else 0.0,
            "visible_with_arm": chosen.visible_with_arm,
            "target_on_features": chosen.target,
            "planned_on_features": cover.covered_area / cover.total_area,
            "coverable_on_features": cover.coverable_area / cover.total_area,
        },
        **({} if M.sigma is None else {"sigma": _sigma(M, cover.views, scene.plan.max_sigma_mm)}),
        "solver": cover.solver,
        "status": _sentence(chosen) + _at_target(chosen.target, scene.plan.coverage),
        "lower_bound": cover.lower_bound,
        "gap": cover.gap,
        "verdicts": {verdict.name.lower(): count for verdict, count in reached.counts().items()},
        "blockers": reached.blockers(),
        "dropped": [{"id": lost.candidate, "reason": lost.reason} for lost in chosen.dropped],
        "views": [
            {
                "id": int(candidate),
                "adds": adds[int(candidate)],
                "source_in_base_mm": (chosen.T_base_scanner[stop, :3, 3] * 1000).round(3).tolist(),
                "q_deg": degrees(tour.q[stop]),
                "roll_deg": float(np.degrees(candidates.roll[candidate]).round(9)),
                "clearance_on_the_way_mm": _mm_or_none(tour.clearance[stop]),
            }
            for stop, candidate in enumerate(chosen.candidate)
        ],
        "motion": {
            "duration_s": motion.duration,
            "jerk_free_bound_s": jerk_free_duration(motion),
            "baseline_duration_s": tour.baseline_duration,
            "lower_bound_s": tour.lower_bound,
            "via_points": len(motion.via_q),
            "detours": int(tour.detour.sum()),
            "speed_fraction": scene.robot.speed_scaling,
            "minimum_clearance_mm": None if leg is None else _mm_or_none(tour.clearance[leg]),
            "between": "" if leg is None else tour.between[leg],
        },
    }


def _sentence(chosen: ConnectedPlan) -> str:
    """The status of the selection: of the views as they were exchanged, where the request allows that."""
    return chosen.cover.sentence if chosen.selected.answer is None else chosen.selected.sentence


def _at_target(target: float, asked: float) -> str:
    """What the status is about where the target on the matrix was raised above the coverage that was asked for."""
    return (
        "" if target == asked else f", at {100 * target:.2f} % of the coverable samples for the {100 * asked:g} % asked"
    )


def _sigma(M: Measurability, views: NDArray[np.int64], limit_mm: float | None) -> dict[str, Any]:
    """Expected standard deviation of the plan's points, over the samples of the matrix that it measures [mm]."""
    from planner.measurability.quality import best_sigma

    best = 1000 * best_sigma(M, views)
    median, most = np.quantile(best[np.isfinite(best)], [0.5, 0.95])
    return {"median_mm": round(float(median), 6), "quantile_95_mm": round(float(most), 6), "limit_mm": limit_mm}


def sweep_summary(chosen: ConnectedPlan) -> dict[str, Any]:
    """What is said of views that sweep: how many poses, and how fast the slowest sweep is driven; else nothing."""
    if not chosen.sweeps:
        return {}
    seconds = [path.duration for path in chosen.sweeps]
    return {
        "sweep_poses": chosen.T_object_poses.shape[1],
        "sweep_in_motion": True,
        "sweep_s": [round(min(seconds), 6), round(max(seconds), 6)],
    }


def _mm_or_none(metres: float) -> float | None:
    return round(float(metres) * 1000, 6) if np.isfinite(metres) else None


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value
