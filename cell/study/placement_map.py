"""`cell study placement`: a map of where the part can stand (the paper's Table 5 and Fig. 7, on a grid).

Four heat maps over the positions: candidates that the robot reaches, surface that they measure, views, and the cycle
time estimated from straight joint moves. One set of maps for each height and turn.
"""

import math
from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from cell.scene.model import Scene
from cell.study.placement_trial import WHOLE, placement
from cell.study.scenes import scene_settings
from cell.study.study import Row, Study
from cell.study.trial import JsonTable, Outcome, Trial
from cell.view.palette import VERMILION

AXES = ("x mm", "y mm", "z mm", "yaw deg")
_TILT = ("B deg", "C deg")

REACH_MM = 1611.0
"""Of the wrist centre from the A2 axis, KUKA's data sheet; the circle about the base on the maps has this radius."""

_MAPS = (
    ("reachable %", "candidates reached [%]", "viridis"),
    ("coverable %", "surface measured at best [%]", "viridis"),
    ("views", "views (greedy)", "magma_r"),
    ("cycle s", "cycle time, estimate from straight moves [s]", "magma_r"),
)


def placement_study(
    scene: Scene, x: Sequence[float], y: Sequence[float], z: Sequence[float], yaw: Sequence[float]
) -> Study:
    """The study of a grid of placements.

    Args:
        scene: part, scanner and cell; its own placement gives the turns B and C.
        x: positions of the part's centre [mm].
        y: the same [mm].
        z: the same [mm].
        yaw: turns A about the vertical [deg].
    """
    base = scene_settings(scene)
    _, b, c = scene.placement.abc_deg
    grid = [
        (
            place,
            Trial.of(
                placement,
                {**base, "position_mm": place[:3], "abc_deg": (place[3], b, c), "what": WHOLE, "solver": "greedy",
                 "candidates": None},
            ),
        )
        for place in product(x, y, z, yaw)
    ]  # fmt: skip

    def rows(outcomes: Sequence[Outcome]) -> list[Row]:
        values = {outcome.trial: outcome.values for outcome in outcomes}
        return [
            row_of(place, (b, c), values[trial]) | {"home free": values[trial]["home_free"]}
            for place, trial in grid
            if trial in values
        ]

    name = scene.part.name if scene.part.path is None else "the part"
    return Study(
        "placement", f"Where {name} can stand: {len(grid)} placements", [trial for _, trial in grid], rows, pictures,
        sentences, options=place_option, best=best_of,
    )  # fmt: skip


def row_of(place: tuple[float, ...], tilt: tuple[float, float], values: JsonTable) -> Row:
    """The row of a place (values of `AXES`), tilted by the scene's B and C [deg], from the values of its trial."""
    return {
        **dict(zip(AXES, place, strict=True)),
        **(dict(zip(_TILT, tilt, strict=True)) if any(tilt) else {}),
        "reachable %": 100 * values["reachable"],
        "coverable %": 100 * values["coverable"],
        "views": values.get("views"),
        "fewest views": values.get("lower_bound"),
        "visible %": None if "visible" not in values else 100 * values["visible"],
        "cycle s": values.get("cycle_s"),
    }


def best_of(rows: Sequence[Row]) -> Row:
    """Most coverage (to a tenth of a point), then fewest views, then the shortest cycle."""
    return min(
        rows, key=lambda row: (-round(row["coverable %"], 1), row["views"] or math.inf, row["cycle s"] or math.inf)
    )


def place_option(row: Row) -> str:
    """The option that puts the part there."""
    return f"--place {','.join(f'{row.get(axis, 0.0):g}' for axis in (*AXES, *_TILT))}"


def time_of(row: Row) -> str:
    """The cycle time as the end of a sentence; "" where there is none."""
    return "" if row["cycle s"] is None else f" in about {row['cycle s']:.0f} s (estimate from straight joint moves)"


def sentences(rows: Sequence[Row]) -> list[str]:
    """Where it is best, and how much of the map is empty."""
    best = best_of(rows)
    if not best["coverable %"]:
        return ["Nothing is measured at any of these placements; move the range nearer to the robot."]
    without = sum(not row["reachable %"] for row in rows)
    return [
        f"Best of these placements is `{place_option(best)}`: the robot reaches {best['reachable %']:.0f} % of the "
        f"candidates, which measure {best['coverable %']:.1f} % of the surface; {best['views']} views do it (greedy; "
        f"no fewer than {best['fewest views']}){time_of(best)}.",
        f"At {without} of {len(rows)} placements nothing can be reached.",
    ]


def pictures(rows: Sequence[Row]) -> Iterator[tuple[str, Figure]]:
    """One set of four maps for each height and turn."""
    for z, yaw in dict.fromkeys((row["z mm"], row["yaw deg"]) for row in rows):
        yield (
            f"map_z{z:g}_yaw{yaw:g}",
            _picture([row for row in rows if (row["z mm"], row["yaw deg"]) == (z, yaw)], z, yaw, best_of(rows)),
        )


def _picture(rows: Sequence[Row], z: float, yaw: float, best: Row) -> Figure:
    x, y = (np.array(sorted({row[axis] for row in rows})) for axis in ("x mm", "y mm"))
    figure = Figure(figsize=(12.0, 10.0), dpi=100, layout="constrained")
    for axes, (column, title, colours) in zip(figure.subplots(2, 2).flat, _MAPS, strict=True):
        values = np.full((len(y), len(x)), np.nan)
        for row in rows:
            if row[column] is not None:
                values[np.searchsorted(y, row["y mm"]), np.searchsorted(x, row["x mm"])] = row[column]
        image = axes.pcolormesh(x, y, np.ma.masked_invalid(values), cmap=colours, shading="nearest")
        figure.colorbar(image, ax=axes, shrink=0.9)
        axes.set_facecolor("#dddddd")  # where there is no number: nothing reached, or no move
        axes.add_patch(Circle((0.0, 0.0), REACH_MM, fill=False, linestyle="--", color=VERMILION))
        if (best["z mm"], best["yaw deg"]) == (z, yaw):
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
