"""Placements of the part: `cell study placement`, a grid of them (the paper's Table 5).

The best by the estimates (`cell.study.placement_trial`) and the placement of the scene are planned
(`cell.study.planned_placement`); the best plan wins.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator

from cell.robot.arm import wrist_positions
from cell.scene.model import Robot, Scene
from cell.study.placement_trial import WITH_VIEWS, evaluate_placement
from cell.study.planned_placement import (
    N_PLANNED,
    best_place,
    finalist_trials,
    is_within,
    place_of,
    planned_columns,
    planned_of,
)
from cell.study.prepared_part import scene_settings
from cell.study.study import Row, Study
from cell.study.trials import JsonTable, Outcome, Trial
from cell.view.palette import VERMILION
from cell.view.study_page import colour_limits
from cell.world.robot_spec import robot_spec

AXES = ("x mm", "y mm", "z mm", "yaw deg")
_TILT = ("B deg", "C deg")
_ENVELOPE_STEP = np.radians(1.0)  # of the axes, for the reach of the wrist

_MAPS = (
    ("reachable %", "candidates reached [%]", "viridis"),
    ("coverable %", "coverable surface [%]", "viridis"),
    ("views", "views (greedy)", "magma_r"),
    ("cycle s", "cycle time, estimate from straight moves [s]", "magma_r"),
)


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
    of_default = finalist_trials(scene, [default] if is_within(default, (x, y, z, yaw)) else []).values()

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
        begun = set(of_default)
        trials = finalist_trials(scene, best_places[:N_PLANNED]).values()
        return [trial for trial in trials if trial not in begun]

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
        "placement", f"Placements of {name}: {len(grid)}", [*of_default, *grid.values()], rows,
        lambda rows: pictures(rows, reach_circle(scene.robot)), sentences, options=place_option, best=best_row,
        finalists=finalists,
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


@dataclass(frozen=True, slots=True)
class ReachCircle:
    """Reach of a robot from above.

    Attributes:
        centre_mm: (x, y) of its base in the frame of the cell.
        radius_mm: largest distance of the wrist from the A1 axis.
    """

    centre_mm: tuple[float, float]
    radius_mm: float


def reach_circle(robot: Robot) -> ReachCircle:
    """Return the reach of the robot of a scene."""
    distances, _ = wrist_positions(robot_spec(robot).compile(), robot.T_base, _ENVELOPE_STEP)
    x, y = (1000 * robot.T_base[:2, 3]).tolist()
    return ReachCircle((x, y), 1000 * float(np.abs(distances).max()))


def pictures(rows: Sequence[Row], reach: ReachCircle) -> Iterator[tuple[str, Figure]]:
    """Draw four maps for each height and yaw, with the reach of the robot."""
    gridded = [row for row in rows if row["reachable %"] is not None]
    for z, yaw in dict.fromkeys((row["z mm"], row["yaw deg"]) for row in gridded):
        yield (
            f"map_z{z:g}_yaw{yaw:g}",
            _picture(
                [row for row in gridded if (row["z mm"], row["yaw deg"]) == (z, yaw)], z, yaw, best_row(rows), reach
            ),
        )


def _picture(rows: Sequence[Row], z: float, yaw: float, best: Row | None, reach: ReachCircle) -> Figure:
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
        axes.add_patch(Circle(reach.centre_mm, reach.radius_mm, fill=False, linestyle="--", color=VERMILION))
        if best is not None and (best["z mm"], best["yaw deg"]) == (z, yaw):
            axes.plot(best["x mm"], best["y mm"], marker="*", color="white", markeredgecolor="black", markersize=15)
        axes.set_title(title, fontsize=10)
        axes.set_xlabel("x of the part's centre, base frame [mm]")
        axes.set_ylabel("y [mm]")
        axes.set_aspect("equal")
        axes.autoscale_view()
        axes.set_xlim(x[0] - 60, x[-1] + 60)
        axes.set_ylim(y[0] - 60, y[-1] + 60)
    figure.suptitle(f"z = {z:g} mm, yaw = {yaw:g} deg; star: best of all; dashed: reach of the wrist from the A1 axis")
    return figure
