"""Placements of the part: the trial of a placement, and `cell study placement`, a grid of them (the paper's Table 5).

Coverage is that of the matrix's samples, with post, floor and fixtures as occluders. The views are a selection with its
lower bound. The cycle time is an estimate from straight joint moves, without detours around obstacles. The best by
these estimates and the placement of the scene are planned (`cell.study.planned_placement`); the best plan wins.
"""

import math
from collections.abc import Iterator, Sequence
from itertools import product
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator

from cell import scanners
from cell.errors import SceneError
from cell.plan.candidates import GROWN, Cell, view_evaluator
from cell.scene.model import Scene
from cell.study.planned_placement import (
    N_PLANNED,
    best_place,
    finalist_trials,
    is_within,
    place_of,
    planned_columns,
    planned_of,
)
from cell.study.prepared_part import scene_settings, shared_bench
from cell.study.study import Row, Study
from cell.study.trials import JsonTable, Outcome, Trial
from cell.view.palette import VERMILION
from cell.view.study_page import colour_limits
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
from planner.viewpoints.viewpoints import Viewpoints, join_viewpoints, pick_viewpoints, viewpoints_from_poses

COVERAGE_ONLY, WITH_VIEWS = "coverage", "whole"

AXES = ("x mm", "y mm", "z mm", "yaw deg")
_TILT = ("B deg", "C deg")

REACH_MM = 1611.0
"""Reach of the wrist centre from the A2 axis (KUKA's data sheet); radius of the circle about the base on the maps."""

_MAPS = (
    ("reachable %", "candidates reached [%]", "viridis"),
    ("coverable %", "coverable surface [%]", "viridis"),
    ("views", "views (greedy)", "magma_r"),
    ("cycle s", "cycle time, estimate from straight moves [s]", "magma_r"),
)


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
    views, M = pick_viewpoints(candidates, which), pick_measurability(M, which)
    if grown is not None:
        views = join_viewpoints([views, grown])
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
    """Grow candidates at a placement, with the samples of the matrix as scouts; none may be needed."""
    grown = growth.grow(RayTargets.of(samples.points, samples.normals, samples.region), is_measured, arm)
    views = viewpoints_from_poses(grown.T_object_scanner, samples.points[grown.row], samples.planning_face[grown.row])
    return scanners.sweep_columns(arm.scanner, views)


def placement_study(
    scene: Scene, x: Sequence[float], y: Sequence[float], z: Sequence[float], yaw: Sequence[float]
) -> Study:
    """Return the study of a grid of placements.

    Args:
        scene: part, scanner and cell; its own placement gives the rotations B and C.
        x: positions of the part's centre [mm].
        y: likewise [mm].
        z: likewise [mm].
        yaw: rotations A about the vertical [deg].
    """
    base = scene_settings(scene)
    _, b, c = scene.placement.abc_deg
    fixed = {**base, "what": WITH_VIEWS, "solver": "greedy", "candidates": None}
    grid = {
        place: Trial.of(evaluate_placement, {**fixed, "position_mm": place[:3], "abc_deg": (place[3], b, c)})
        for place in product(x, y, z, yaw)
    }

    default = place_of(scene)
    is_in_grid = is_within(default, (x, y, z, yaw))

    def estimates(outcomes: Sequence[Outcome]) -> dict[tuple[float, ...], Row]:
        values = {outcome.trial: outcome.values for outcome in outcomes}
        return {
            place: placement_row(place, (b, c), values[trial]) | {"home free": values[trial]["home_free"]}
            for place, trial in grid.items()
            if trial in values
        }

    def finalists(outcomes: Sequence[Outcome]) -> list[Trial]:
        estimates_of = estimates(outcomes)
        best_places = [
            place
            for place in sorted(estimates_of, key=lambda place: _estimated_rank(estimates_of[place]))
            if estimates_of[place]["views"]
        ]
        return list(finalist_trials(scene, [*best_places[:N_PLANNED], *([default] if is_in_grid else [])]).values())

    def rows(outcomes: Sequence[Outcome]) -> list[Row]:
        values = {outcome.trial: outcome.values for outcome in outcomes}
        estimates_of = estimates(outcomes)
        planned = {
            place: plan
            for place, trial in finalist_trials(scene, [*estimates_of, default]).items()
            if (plan := planned_of(values.get(trial))) is not None
        }
        if default in planned and default not in estimates_of:
            estimates_of[default] = placement_row(default, (b, c), {"reachable": None, "coverable": None}) | {
                "home free": True
            }
        best = best_place(planned, default) if planned else None
        return [
            row | planned_columns(planned.get(place)) | {"best": place == best} for place, row in estimates_of.items()
        ]

    name = scene.part.name if scene.part.path is None else "the part"
    return Study(
        "placement", f"Placements of {name}: {len(grid)}", list(grid.values()), rows, pictures, sentences,
        options=place_option, best=best_row, finalists=finalists,
    )  # fmt: skip


def placement_row(place: tuple[float, ...], tilt: tuple[float, float], values: JsonTable) -> Row:
    """Return the row of a placement (values of `AXES`), tilted by the scene's B and C [deg]."""
    return {
        **dict(zip(AXES, place, strict=True)),
        **(dict(zip(_TILT, tilt, strict=True)) if any(tilt) else {}),
        "reachable %": _percent(values["reachable"]),
        "coverable %": _percent(values["coverable"]),
        "views": values.get("views"),
        "visible %": None if "visible" not in values else 100 * values["visible"],
        "cycle s": values.get("cycle_s"),
    }


def _percent(share: float | None) -> float | None:
    return None if share is None else 100 * share


def _estimated_rank(row: Row) -> tuple[float, float, float]:
    """Return a sort key: most coverage (to 0.1 percentage points), then fewest views, then the shortest cycle."""
    return -round(row["coverable %"], 1), row["views"] or math.inf, row["cycle s"] or math.inf


def best_row(rows: Sequence[Row]) -> Row | None:
    """Return the row of the best plan; None if no placement is planned."""
    return next((row for row in rows if row["best"]), None)


def place_option(row: Row) -> str:
    """Return the option of `cell plan` for the placement of a row."""
    return f"--place {','.join(f'{row.get(axis, 0.0):.10g}' for axis in (*AXES, *_TILT))}"


def planned_text(row: Row) -> str:
    """Return the numbers of a plan as the end of a sentence."""
    proven = ", no fewer are possible with its candidates" if row["planned bound"] == row["planned views"] else ""
    return (
        f"{row['planned views']} views{proven} measure {row['planned %']:.2f} % of the surface in "
        f"{row['planned s']:.1f} s of motion"
    )


def sentences(rows: Sequence[Row]) -> list[str]:
    """Summarise the best placement and the unreachable ones."""
    best, gridded = best_row(rows), [row for row in rows if row["reachable %"] is not None]
    unreachable = sum(not row["reachable %"] for row in gridded)
    nothing = f"At {unreachable} of {len(gridded)} placements nothing is reachable."
    if best is None:
        return ["None of these placements can be planned; move the range nearer to the robot.", nothing]
    planned = sum(row["planned views"] is not None for row in rows)
    return [
        f"Best of {planned} planned placements is `{place_option(best)}`: {planned_text(best)}. Coverable share, views "
        "and cycle of the others are estimates, by which these were chosen.",
        nothing,
    ]


def pictures(rows: Sequence[Row]) -> Iterator[tuple[str, Figure]]:
    """Draw four maps for each height and yaw."""
    gridded = [row for row in rows if row["reachable %"] is not None]
    for z, yaw in dict.fromkeys((row["z mm"], row["yaw deg"]) for row in gridded):
        yield (
            f"map_z{z:g}_yaw{yaw:g}",
            _picture([row for row in gridded if (row["z mm"], row["yaw deg"]) == (z, yaw)], z, yaw, best_row(rows)),
        )


def _picture(rows: Sequence[Row], z: float, yaw: float, best: Row | None) -> Figure:
    x, y = (np.array(sorted({row[axis] for row in rows})) for axis in ("x mm", "y mm"))
    figure = Figure(figsize=(12.0, 10.0), dpi=100, layout="constrained")
    style: dict[str, Any]
    for axes, (column, title, colours) in zip(figure.subplots(2, 2).flat, _MAPS, strict=True):
        values = np.full((len(y), len(x)), np.nan)
        for row in rows:
            if row[column] is not None:
                values[np.searchsorted(y, row["y mm"]), np.searchsorted(x, row["x mm"])] = row[column]
        known = values[np.isfinite(values)]
        low, high = colour_limits(known.tolist() or [0.0], column)
        style = {"vmin": low, "vmax": high, "cmap": colours}
        ticks = None
        if column == "views" and len(known):  # one colour for each number
            ends = np.arange(known.min() - 0.5, known.max() + 1)
            style = {"cmap": colormaps[colours].resampled(len(ends) - 1), "vmin": ends[0], "vmax": ends[-1]}
            ticks = MaxNLocator(integer=True)
        image = axes.pcolormesh(x, y, np.ma.masked_invalid(values), shading="nearest", **style)
        figure.colorbar(image, ax=axes, shrink=0.9, ticks=ticks)
        axes.set_facecolor("#dddddd")  # no value: nothing reached, or no move
        axes.add_patch(Circle((0.0, 0.0), REACH_MM, fill=False, linestyle="--", color=VERMILION))
        if best is not None and (best["z mm"], best["yaw deg"]) == (z, yaw):
            axes.plot(best["x mm"], best["y mm"], marker="*", color="white", markeredgecolor="black", markersize=15)
        axes.set_title(title, fontsize=10)
        axes.set_xlabel("x of the part's centre, base frame [mm]")
        axes.set_ylabel("y [mm]")
        axes.set_aspect("equal")
        axes.autoscale_view()
        axes.set_xlim(x[0] - 60, x[-1] + 60)
        axes.set_ylim(y[0] - 60, y[-1] + 60)
    figure.suptitle(
        f"z = {z:g} mm, yaw = {yaw:g} deg; star: best of all; dashed: reach of the wrist from the base axis"
    )
    return figure
