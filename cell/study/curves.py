"""`cell study standoff` and `cell study scanner`: views and coverage over one number of the scanner, the best marked.

The study of the standoff has the scanner `paper`, whose range and baseline follow it, unless the scene names a scanner.
The paper's "optimum scanning zone" and "optimum scanner configuration". Best is the value whose plan measures most of
the surface (within half a point of the most, which nobody would pay for) with the fewest views.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence

from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from cell.scene import sensors
from cell.scene.file import Tables
from cell.scene.model import Scene
from cell.study.plan_command import options
from cell.study.scenes import scene_settings
from cell.study.study import Row, Study
from cell.study.trial import JsonTable, Outcome, Trial
from cell.study.views import views
from cell.view.palette import BLACK, BLUE, GREEN, GREY, VERMILION

WITHIN_POINTS = 0.5
"""Coverages that differ by less than this count as equal when the best value is chosen [points]."""

_FOLLOWING = "paper"
_FOLLOWING_TOLD = (
    "The scanner is `paper`, which no device is: its range (0.5 to 1.5 times) and its baseline (a quarter) follow the "
    "standoff. Name a scanner in the scene to see what its own range allows."
)

SceneWith = Callable[[Mapping[str, Mapping[str, object]]], Scene]
"""Makes the scene with some keys changed; raises SceneError, in one sentence, where a scene cannot have them."""

Setting = float | str | tuple[float, float]
"""A number, the name of a sensor, or the near and far limit of a range [mm]."""

KNOBS: Mapping[str, tuple[str, Callable[..., Tables]]] = {
    "standoff": ("standoff distance [mm]", lambda value: {"plan": {"standoffs_mm": [value]}}),
    "fov": ("field of view, both ways [deg]", lambda value: {"scanner": {"fov_deg": [value, value]}}),
    "resolution": ("angle between rays [deg]", lambda value: {"scanner": {"resolution_deg": [value, value]}}),
    "baseline": ("baseline [mm]", lambda value: {"scanner": {"baseline_mm": value}}),
    "grazing": ("grazing limit [deg from the normal]", lambda value: {"scanner": {"grazing_max_deg": value}}),
    "range": (
        "range [mm]",  # the standoff is in its middle
        lambda ends: {"scanner": {"range_mm": list(ends)}, "plan": {"standoffs_mm": [sum(ends) / 2]}},
    ),
    "sensors": ("sensor", lambda name: {"scanner": {"sensor": name}}),
}
"""What of the scanner a study varies: for people with its unit; and the keys of the scene for a setting."""


def knob_study(scene_with: SceneWith, knob: str, values: Sequence[Setting], *, robot: bool) -> Study:
    """The study of one knob.

    Args:
        scene_with: part, scanner and plan; the robot's cell counts only with `robot`.
        knob: a name of `KNOBS`.
        values: of the knob.
        robot: whether only views that the robot reaches at the scene's placement may be used.

    Raises:
        SceneError: if the scene cannot have one of the values.
    """
    title, tables = KNOBS[knob]
    own = scene_with({}).scanner
    follows = knob == "standoff" and own.sensor is None and own.type == sensors.load(_FOLLOWING).type
    scanner: Tables = {"scanner": {"sensor": _FOLLOWING}} if follows else {}
    keys = {
        f"{value[0]:g}-{value[1]:g}" if isinstance(value, tuple) else value: {**scanner, **tables(value)}
        for value in values
    }
    asked = [
        (value, Trial.of(views, {**scene_settings(scene_with(of_value)), "robot": robot}))
        for value, of_value in keys.items()
    ]

    def rows(outcomes: Sequence[Outcome]) -> list[Row]:
        found = {outcome.trial: outcome.values for outcome in outcomes}
        return [_row(title, value, found[trial]) for value, trial in asked if trial in found]

    return Study(
        knob, f"Views and coverage over {title}", [trial for _, trial in asked], rows,
        lambda rows: pictures(knob, title, rows),
        lambda rows: [*sentences(title, rows), *([_FOLLOWING_TOLD] if follows else [])],
        options=lambda row: options(keys[row[title]]), best=best_of,
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


def best_of(rows: Sequence[Row]) -> Row:
    """Fewest views among those that measure within half a point of the most; of equals the one that measures more."""
    most = max(row["visible %"] for row in rows)
    return min(
        (row for row in rows if row["visible %"] >= most - WITHIN_POINTS),
        key=lambda row: (row["views"], -row["visible %"]),
    )


def sentences(title: str, rows: Sequence[Row]) -> list[str]:
    """What a buyer of a scanner, or whoever sets it up, needs to know."""
    best, most = best_of(rows), max(rows, key=lambda row: row["visible %"])
    said = [
        f"Best {title}: **{_value(best[title])}**. {best['views']} views measure {best['visible %']:.2f} % of the "
        f"surface (no fewer than {best['fewest views']} can), {best['sampled %']:.1f} % of it lies within 1 % of the "
        "diagonal of a scan point."
    ]
    enough = most["visible %"] - 2 * WITHIN_POINTS
    near = [row for row in rows if row["views"] <= best["views"] + 1 and row["visible %"] >= enough and row is not best]
    if near:
        said.append(f"Nearly as good (one view more at most): {', '.join(_value(row[title]) for row in near)}.")
    worst = min(rows, key=lambda row: row["visible %"])
    if worst["visible %"] < best["visible %"] - WITHIN_POINTS:
        said.append(
            f"Worst is {_value(worst[title])}: {worst['views']} views and {worst['visible %']:.1f} %. Views and "
            "coverage are those of the best plan at each value, not of one plan that is used at all of them."
        )
    return said


def _value(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:g}"


def pictures(name: str, title: str, rows: Sequence[Row]) -> Iterator[tuple[str, Figure]]:
    """Coverage and views over the knob; the best is marked."""
    figure = Figure(figsize=(8.0, 6.0), dpi=110, layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    named = isinstance(rows[0][title], str)
    x = list(range(len(rows))) if named else [row[title] for row in rows]
    best = best_of(rows)
    at = x[[row is best for row in rows].index(True)]
    above.plot(x, [row["visible %"] for row in rows], "o-", color=BLUE, label="visible")
    above.plot(x, [row["sampled %"] for row in rows], "s--", color=GREY, label="sampled, within 1 % of the diagonal")
    above.set_ylabel("surface [%]")
    below.plot(x, [row["views"] for row in rows], "o-", color=VERMILION, label="views")
    below.plot(x, [row["fewest views"] for row in rows], "_", color=BLACK, markersize=12, label="fewest provable")
    below.set_ylabel("views")
    below.yaxis.set_major_locator(MaxNLocator(integer=True))
    below.set_ylim(bottom=0)
    below.set_xlabel(title)
    if named:
        below.set_xticks(x, [row[title] for row in rows], rotation=30, ha="right")
    for axes in (above, below):
        axes.axvline(at, color=GREEN, linewidth=1, linestyle=":", label=f"best: {_value(best[title])}")
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    yield name, figure
