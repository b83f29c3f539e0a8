"""The trial of a placement: reachable candidates, coverage, and optionally a selection of views with its cycle time.

What depends on the part only (meshes, samples, candidates, their matrix without occluders) is computed once in each
process, by its `Bench`. Coverage is that of the matrix's samples, with post, floor and fixtures as occluders. The views
are a selection with its lower bound. The cycle time is an estimate from straight joint moves, without detours around
obstacles. Nothing here imports matplotlib, which takes a worker half a second.
"""

import numpy as np

from cell import scanners
from cell.errors import SceneError
from cell.plan.candidates import GROWN, Cell, view_evaluator
from cell.study.prepared_part import shared_bench
from cell.study.trials import JsonTable
from cell.world.occluders import fixed_occluders, make_caster
from planner import cover
from planner.geometry.sampling import SurfaceSamples
from planner.kinematics import reach
from planner.kinematics.frames import pose_from_kuka_abc
from planner.measurability import coverage
from planner.measurability.matrix import join_measurability, pick_measurability
from planner.measurability.visibility import any_unoccluded, apply_occluders, fill_matrix, find_measured
from planner.timing.limits import scale_limits
from planner.tour.orderings import order_views
from planner.tour.visits import TourProblem
from planner.values import Bools
from planner.viewpoints import growth
from planner.viewpoints.growth import ViewEvaluator
from planner.viewpoints.lines_of_sight import RayTargets
from planner.viewpoints.viewpoints import Viewpoints, viewpoints_from_poses

COVERAGE_ONLY, WITH_VIEWS = "coverage", "whole"


def evaluate_placement(settings: JsonTable) -> dict[str, object]:
    """Evaluate a placement: the trial of placement maps and of the placement search.

    Args:
        settings: scene and files (`cell.study.prepared_part`), position_mm (3), abc_deg (3), what (`COVERAGE_ONLY` or
            `WITH_VIEWS`), solver of the views, and candidates (size of the subset; null: all).

    Returns:
        reachable (share of the candidates), coverable (share of the surface), home_free; with views also views,
        lower_bound, visible (share of the surface, held-out samples) and cycle_s (null if a view has no move).
    """
    bench = shared_bench(settings)
    place = pose_from_kuka_abc(np.array(settings["position_mm"]) / 1000, np.deg2rad(settings["abc_deg"]))
    blocked: dict[str, object] = {"reachable": 0.0, "coverable": 0.0, "home_free": False}
    try:
        world = bench.world.with_placement(place)
    except SceneError:  # a table with a fixed position cannot carry the part there
        return blocked
    candidates, M = bench.candidate_subset(settings["candidates"])
    cell, scanner, samples = Cell.of(world), bench.scanner, M.samples
    if not cell.checker.free(world.home[None])[0]:
        return blocked
    casters = bench.caster, make_caster(fixed_occluders(world))
    arm = view_evaluator(cell, scanner, casters)
    usable = arm.are_reachable(candidates.T_object_scanner)
    values: dict[str, object] = {"reachable": float(usable.mean()), "coverable": 0.0, "home_free": True}
    if not usable.any():
        return values
    is_measured = any_unoccluded(M, candidates, usable, scanner, casters[1], ray_caster=bench.caster)
    grown = None
    if bench.scene.plan.candidates == GROWN and settings["candidates"] is None:
        grown = _grown(arm, samples, is_measured)
        is_measured |= find_measured(grown.T_object_scanner, samples, scanner, casters, among=~is_measured)
    values["coverable"] = float(samples.areas[is_measured].sum() / samples.areas.sum())
    if settings["what"] == COVERAGE_ONLY or not is_measured.any():
        return values
    which = np.flatnonzero(usable)
    views, M = candidates.pick(which), pick_measurability(M, which)
    if grown is not None:
        views = Viewpoints.join([views, grown])
        M = join_measurability([M, fill_matrix(grown, samples, scanner, bench.caster)])
    M = apply_occluders(M, views, scanner, casters[1], ray_caster=bench.caster)
    reached = reach.solve_reach(views, world.T_base_object, world.T_flange_scanner, cell.kinematics, cell.checker)
    rng = np.random.default_rng(bench.scene.plan.seed)
    problem = cover.CoverProblem(M.matrix(), M.samples.areas, coverage=bench.scene.plan.coverage)
    selection = cover.solve(problem, rng=rng, solver=settings["solver"])
    poses = views.T_object_scanner[selection.views]
    configurations = [reached.configurations_of(int(view)) for view in selection.views]
    limits = scale_limits(world.limits, bench.scene.robot.speed_scaling, bench.scene.robot.acceleration_scaling)
    moves = TourProblem.straight(configurations, world.home, limits)
    tour = order_views(moves, world.T_base_object @ poses[:, 0], rng, bound_effort=0)
    return {
        **values,
        "views": len(selection.views),
        "lower_bound": selection.lower_bound,
        "visible": coverage.visible_coverage(poses, bench.samples, scanner, casters).fraction,
        "cycle_s": tour.duration if np.isfinite(tour.duration) else None,
    }


def _grown(arm: ViewEvaluator, samples: SurfaceSamples, is_measured: Bools) -> Viewpoints:
    """Grow candidates at a placement, with the samples of the matrix as scouts; there may be none."""
    grown = growth.grow(RayTargets.of(samples.points, samples.normals, samples.region), is_measured, arm)
    views = viewpoints_from_poses(grown.T_object_scanner, samples.points[grown.row], samples.planning_face[grown.row])
    return scanners.sweep_columns(arm.scanner, views)
