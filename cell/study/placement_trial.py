"""One placement of the part: what the robot reaches there, what that measures, how many views and how long they take.

The trial of placement maps and of the search for the best placement. Coverage is that of the matrix's samples, with
post, floor and fixtures in the way; views are greedy with their lower bound; the cycle time is an estimate from
straight joint moves, which ignores what the arm has to go round.
"""

import numpy as np

from cell import scanners
from cell.errors import SceneError
from cell.plan.candidates import GROWN, Cell, view_evaluator
from cell.study.bench import Bench, reach_in
from cell.study.scenes import bench_of
from cell.study.trial import JsonTable
from cell.world.occluders import fixed_occluders, make_caster
from planner import cover
from planner.kinematics.frames import pose_from_kuka_abc
from planner.kinematics.reach import Reach, join_reach, pick_reach
from planner.measurability import coverage
from planner.measurability.matrix import Measurability, join_measurability, pick_measurability
from planner.measurability.visibility import apply_occluders, fill_matrix
from planner.ports import RayCaster
from planner.timing.limits import scale_limits
from planner.tour.orderings import order_views
from planner.tour.visits import TourProblem
from planner.viewpoints import growth
from planner.viewpoints.lines_of_sight import RayTargets
from planner.viewpoints.viewpoints import Viewpoints, join_viewpoints, pick_viewpoints, viewpoints_from_poses

COVERAGE_ONLY, WHOLE = "coverage", "whole"


def placement(settings: JsonTable) -> dict[str, object]:
    """A placement's numbers.

    Args:
        settings: scene and files (`cell.study.scenes`), position_mm (3), abc_deg (3), what ("coverage" or "whole"),
            solver of the views, and candidates (number of them that are looked at, drawn once by the scene's seed;
            null: all).

    Returns:
        reachable (share of the candidates), coverable (share of the surface), and where the whole is asked for views,
        lower_bound, visible (share of the surface, held-out samples) and cycle_s (null where a view has no move).
    """
    bench = bench_of(settings)
    place = pose_from_kuka_abc(np.array(settings["position_mm"]) / 1000, np.deg2rad(settings["abc_deg"]))
    try:
        world = bench.world.with_placement(place)
    except SceneError:  # a table that stands where it stands does not carry the part there
        return {"reachable": 0.0, "coverable": 0.0, "home_free": False}
    candidates, M = bench.some(settings["candidates"])
    cell = Cell.of(world)
    if not cell.checker.free(world.home[None])[0]:
        return {"reachable": 0.0, "coverable": 0.0, "home_free": False}
    reached = reach_in(world, candidates)
    allowed = reached.reachable
    values: dict[str, object] = {"reachable": float(allowed.mean()), "coverable": 0.0, "home_free": True}
    which = np.flatnonzero(allowed)
    if not len(which):
        return values
    in_the_way = make_caster(fixed_occluders(world))
    M, views = pick_measurability(M, which), pick_viewpoints(candidates, which)
    M = apply_occluders(M, views, bench.scanner, in_the_way, ray_caster=bench.caster)
    reached = pick_reach(reached, which)
    if bench.scene.plan.candidates == GROWN and settings["candidates"] is None:
        views, reached, M = _grown(bench, cell, (bench.caster, in_the_way), (views, reached, M))
    measured = np.diff(M.indptr) > 0
    values["coverable"] = float(M.samples.areas[measured].sum() / M.samples.areas.sum())
    if settings["what"] == COVERAGE_ONLY or not measured.any():
        return values
    rng = np.random.default_rng(bench.scene.plan.seed)
    share, solver = bench.scene.plan.coverage, settings["solver"]
    found = cover.solve(cover.CoverProblem(M.matrix(), M.samples.areas, coverage=share), rng=rng, solver=solver)
    poses = views.T_object_scanner[found.views]
    configurations = [reached.configurations_of(int(view)) for view in found.views]
    limits = scale_limits(world.limits, bench.scene.robot.speed_scaling, bench.scene.robot.acceleration_scaling)
    moves = TourProblem.straight(configurations, world.home, limits)
    tour = order_views(moves, world.T_base_object @ poses[:, 0], rng, bound_effort=0)
    return {
        **values,
        "views": len(found.views),
        "lower_bound": found.lower_bound,
        "visible": coverage.visible_coverage(poses, bench.samples, bench.scanner, (bench.caster, in_the_way)).fraction,
        "cycle_s": tour.duration if np.isfinite(tour.duration) else None,
    }


def _grown(
    bench: Bench,
    cell: Cell,
    casters: tuple[RayCaster, RayCaster],
    known: tuple[Viewpoints, Reach, Measurability],
) -> tuple[Viewpoints, Reach, Measurability]:
    """Reachable candidates with those grown at this placement; the rows of the matrix are the scouts here.

    Args:
        bench: the part and the scanner.
        cell: with the part at this placement.
        casters: the part's and the occluders'.
        known: reachable candidates, their reach, and what they measure.
    """
    views, reached, M = known
    scanner, features = bench.scanner, M.samples
    arm = view_evaluator(cell, scanner, casters)
    found = growth.grow(RayTargets.of(features.points, features.normals, features.region), np.diff(M.indptr) > 0, arm)
    if not len(found):
        return known
    added = viewpoints_from_poses(found.T_object_scanner, features.points[found.row], features.planning_face[found.row])
    added = scanners.sweep_columns(scanner, added)
    measured = apply_occluders(
        fill_matrix(added, features, scanner, casters[0]), added, scanner, casters[1], ray_caster=casters[0]
    )  # fmt: skip
    of_added = reach_in(cell.world, added)
    return join_viewpoints([views, added]), join_reach([reached, of_added]), join_measurability([M, measured])
