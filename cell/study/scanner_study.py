"""`cell study standoff` and `cell study scanner`: views and coverage over one number of the scanner.

The study of the standoff uses the scanner `paper`, whose range and baseline follow it, unless the scene names a scanner
(the paper's "optimum scanning zone" and "optimum scanner configuration"). The best value has the plan with the fewest
views among those within half a percentage point of the highest coverage.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from cell.scene import sensors
from cell.scene.file import Tables
from cell.study.prepared_part import Bench, scene_from_settings, scene_settings, solve_reach
from cell.study.study import Row, SceneWith, Study, plan_options
from cell.study.trials import JsonTable, Outcome, Trial
from cell.view.palette import BLACK, BLUE, GREEN, GREY, VERMILION
from planner.kinematics.frames import pose_from_kuka_abc

TOLERANCE_POINTS = 0.5
"""Coverages that differ by less count as equal in the choice of the best value [percentage points]."""

_FOLLOWING = "paper"
_FOLLOWING_NOTE = (
    "The scanner is `paper`, which is no device: its range (0.5 to 1.5 times) and its baseline (a quarter) follow the "
    "standoff. Name a scanner in the scene to see the limits of its own range."
)

Setting = float | str | tuple[float, float]
"""A number, the name of a sensor, or the near and far limit of a range [mm]."""

PARAMETERS: Mapping[str, tuple[str, Callable[..., Tables]]] = {
    "standoff": ("standoff distance [mm]", lambda value: {"plan": {"standoffs_mm": [value]}}),
    "fov": ("field of view, both ways [deg]", lambda value: {"scanner": {"fov_deg": [value, value]}}),
    "resolution": ("angle between rays [deg]", lambda value: {"scanner": {"resolution_deg": [value, value]}}),
    "baseline": ("baseline [mm]", lambda value: {"scanner": {"baseline_mm": value}}),
    "grazing": ("grazing limit [deg from the normal]", lambda value: {"scanner": {"grazing_max_deg": value}}),
    "range": (
        "range [mm]",  # with the standoff in its middle
        lambda ends: {"scanner": {"range_mm": list(ends)}, "plan": {"standoffs_mm": [sum(ends) / 2]}},
    ),
    "sensors": ("sensor", lambda name: {"scanner": {"sensor": name}}),
}
"""Varied parameters: title with unit, and the keys of the scene for a setting."""


def select_views(settings: JsonTable) -> dict[str, object]:
    """Select views for a scene's part and scanner, without a motion: the trial of these studies.

    Args:
        settings: scene and files (`cell.study.prepared_part`), and robot: whether the views must be reachable at the
            scene's placement.
    """
    scene = scene_from_settings(settings)
    bench = Bench(scene)
    candidates, allowed = bench.candidates, None
    if settings["robot"]:
        place = scene.placement
        centre = pose_from_kuka_abc(np.array(place.position_mm) / 1000, np.deg2rad(place.abc_deg))
        allowed = solve_reach(bench.world.with_placement(centre), candidates).reachable
    plan = bench.select(scene.plan.fill, candidates, allowed, solver=scene.plan.solver, share=scene.plan.coverage)
    return {
        "standoff_mm": 1000 * bench.settings.standoffs[0],
        "candidates": len(candidates) if allowed is None else int(allowed.sum()),
        **plan.values(),
        "sampled": bench.sampled_coverage(plan.T_object_scanner) if len(plan.cover.views) else 0.0,
    }


def scanner_study(scene_with: SceneWith, parameter: str, values: Sequence[Setting], *, robot: bool) -> Study:
    """Return the study of a parameter.

    Args:
        scene_with: part, scanner and plan; the cell counts only with `robot`.
        parameter: a name of `PARAMETERS`.
        values: of the parameter.
        robot: whether the views must be reachable at the scene's placement.

    Raises:
        SceneError: if the scene cannot have one of the values.
    """
    title, tables = PARAMETERS[parameter]
    default = scene_with({}).scanner
    follows = parameter == "standoff" and default.sensor is None and default.type == sensors.load(_FOLLOWING).type
    scanner: Tables = {"scanner": {"sensor": _FOLLOWING}} if follows else {}
    keys = {
        f"{value[0]:g}-{value[1]:g}" if isinstance(value, tuple) else value: {**scanner, **tables(value)}
        for value in values
    }
    trials = {
        value: Trial.of(select_views, {**scene_settings(scene_with(changes)), "robot": robot})
        for value, changes in keys.items()
    }

    def rows(outcomes: Sequence[Outcome]) -> list[Row]:
        values_of = {outcome.trial: outcome.values for outcome in outcomes}
        return [_row(title, value, values_of[trial]) for value, trial in trials.items() if trial in values_of]

    return Study(
        parameter, f"Views and coverage over {title}", list(trials.values()), rows,
        lambda rows: pictures(parameter, title, rows),
        lambda rows: [*sentences(title, rows), *([_FOLLOWING_NOTE] if follows else [])],
        options=lambda row: plan_options(keys[row[title]]), best=best_row,
    )  # fmt: skip


def _row(title: str, value: float | str, values: JsonTable) -> Row:
    return {
        title: value,
        "standoff mm": values["standoff_mm"],
        "candidates": values["candidates"],
        "views": values["views"],
        "fewest views": values["lower_bound"],
        "visible %": 100 * values["visible"],
        "sampled %": 100 * values["sampled"],
    }


def best_row(rows: Sequence[Row]) -> Row:
    """Return the row with the fewest views among those near the highest coverage; of equal ones the highest."""
    limit = max(row["visible %"] for row in rows) - TOLERANCE_POINTS
    return min((row for row in rows if row["visible %"] >= limit), key=lambda row: (row["views"], -row["visible %"]))


def sentences(title: str, rows: Sequence[Row]) -> list[str]:
    """Summarise the best, the similar and the worst values."""
    best, highest = best_row(rows), max(row["visible %"] for row in rows)
    texts = [
        f"Best {title}: **{_text(best[title])}**. {best['views']} views measure {best['visible %']:.2f} % of the "
        f"surface (lower bound {best['fewest views']} views); {best['sampled %']:.1f} % of it lies within 1 % of the "
        "diagonal of a scan point."
    ]
    similar = [
        row
        for row in rows
        if row is not best and row["views"] <= best["views"] + 1 and row["visible %"] >= highest - 2 * TOLERANCE_POINTS
    ]
    if similar:
        texts.append(f"Nearly as good (at most one view more): {', '.join(_text(row[title]) for row in similar)}.")
    worst = min(rows, key=lambda row: row["visible %"])
    if worst["visible %"] < best["visible %"] - TOLERANCE_POINTS:
        texts.append(
            f"Worst is {_text(worst[title])}: {worst['views']} views and {worst['visible %']:.1f} %. Each value has "
            "its own best plan."
        )
    return texts


def _text(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:g}"


def pictures(name: str, title: str, rows: Sequence[Row]) -> Iterator[tuple[str, Figure]]:
    """Draw coverage and views over the parameter, with the best value marked."""
    figure = Figure(figsize=(8.0, 6.0), dpi=110, layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    has_names = isinstance(rows[0][title], str)
    x = list(range(len(rows))) if has_names else [row[title] for row in rows]
    best = best_row(rows)
    at = x[[row is best for row in rows].index(True)]
    above.plot(x, [row["visible %"] for row in rows], "o-", color=BLUE, label="visible")
    above.plot(x, [row["sampled %"] for row in rows], "s--", color=GREY, label="sampled, within 1 % of the diagonal")
    above.set_ylabel("surface [%]")
    below.plot(x, [row["views"] for row in rows], "o-", color=VERMILION, label="views")
    below.plot(x, [row["fewest views"] for row in rows], "_", color=BLACK, markersize=12, label="lower bound")
    below.set_ylabel("views")
    below.yaxis.set_major_locator(MaxNLocator(integer=True))
    below.set_ylim(bottom=0)
    below.set_xlabel(title)
    if has_names:
        below.set_xticks(x, [row[title] for row in rows], rotation=30, ha="right")
    for axes in (above, below):
        axes.axvline(at, color=GREEN, linewidth=1, linestyle=":", label=f"best: {_text(best[title])}")
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    yield name, figure
