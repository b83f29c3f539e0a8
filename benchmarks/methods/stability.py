"""`python -m benchmarks stability`: success and error of each method over the number that limits it; its safe region.

A map runs a method at values of one number, some of them far beyond practical use, and evaluates it with a truth that
is independent of the method. At each value it records the message of the program to its user: none, a note, a warning
or a refusal. The safe region of a map is the region without a message; if its end is a number, it is the number that
the program itself compares with. A map is correct if the method is good wherever the program has no message.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from textwrap import fill
from typing import Annotated, Any

import typer
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.methods import arm_maps, planning_maps, reconstruction_maps
from benchmarks.methods.stability_map import Map
from cell.cli.options import from_fields
from cell.cli.study import run_and_print
from cell.errors import UsageError
from cell.study.options import StudyRun
from cell.study.study import Row, Study
from cell.study.trials import Outcome, Trial

MAPS: Mapping[str, Map] = {**arm_maps.MAPS, **planning_maps.MAPS, **reconstruction_maps.MAPS}


app = typer.Typer(add_completion=False)


@app.command()
@from_fields
def stability(
    *,
    run: StudyRun,
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[MAP ...]", help=f"{', '.join(MAPS)}. Default: all.")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Few values, small problems: whether it still works.")] = False,
) -> None:
    """Map the limits of each method: success and error over the varied number, and the messages of the program."""
    run_and_print(lambda: stability_study(names or [], quick=quick), run, as_json=False)


def at(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Run one method at one value: the trial.

    Args:
        settings: map, line, value and size.
    """
    point = MAPS[settings["map"]].method(settings["line"], settings["value"], settings["size"])
    return {"success": point.success, "error": point.error, "says": point.says, "more": dict(point.more)}


def stability_study(names: Sequence[str], *, quick: bool = False) -> Study:
    """Return the study of the requested maps.

    Args:
        names: names in `MAPS`; empty: all.
        quick: few values and small problems, as a check that all maps work.

    Raises:
        UsageError: if a name is unknown.
    """
    for name in names:
        if name not in MAPS:
            raise UsageError(f"there is no stability map {name}; there are {', '.join(MAPS)}")
    requests = [
        (
            name,
            line,
            value,
            Trial.of(at, {"map": name, "line": line, "value": value, "size": each.sizes[quick]}),
        )
        for name, each in MAPS.items()
        if name in names or not names
        for line in (each.lines[: each.quick_lines] if quick else each.lines)
        for value in (each.quick if quick else each.values)
    ]

    def rows(outcomes: Sequence[Outcome]) -> list[Row]:
        found = {outcome.trial: outcome.values for outcome in outcomes}
        return [_row(name, line, value, found[trial]) for name, line, value, trial in requests if trial in found]

    return Study(
        "stability", "Where each method breaks", [trial for *_, trial in requests], rows, pictures, sentences,
        ("map", "line", "value", "success %", "error", "says"),
    )  # fmt: skip


def _row(name: str, line: str, value: float, values: Mapping[str, Any]) -> Row:
    each = MAPS[name]
    good = values["success"] >= each.enough and (values["error"] is None or values["error"] <= each.tolerated)
    return {
        "map": name,
        "line": line,
        "value": value,
        "success %": 100 * values["success"],
        "error": values["error"],
        "good": good,
        "says": values["says"],
        **values["more"],
    }


def by_map(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Return the rows of each map, maps in the order of the rows."""
    found: dict[str, list[Row]] = {}
    for row in rows:
        found.setdefault(row["map"], []).append(row)
    return found


def broken_promises(rows: Sequence[Row]) -> list[Row]:
    """Return the rows at which a method of the program is not good and the program has no message."""
    return [row for row in rows if not (row["good"] or row["says"] or row["line"] in MAPS[row["map"]].compared)]


def sentences(rows: Sequence[Row]) -> list[str]:
    """Return for each map the values at which the method is good, and the messages of the program."""
    summaries = []
    for name, map_rows in by_map(rows).items():
        each = MAPS[name]
        points = [row for row in map_rows if row["line"] not in each.compared]
        values = list(dict.fromkeys(row["value"] for row in points))
        bad = [value for value in values if not all(row["good"] for row in points if row["value"] == value)]
        spoken = [row for row in points if row["says"]]
        text = f"**{name}** ({each.parameter}): "
        text += "good at all values" if not bad else f"not good at {_listed(bad)}"
        if spoken:
            warned = [value for value in values if any(row["value"] == value for row in spoken)]
            text += f"; the program speaks at {_listed(warned)}, for instance: {spoken[0]['says']}"
        silent = sorted({row["value"] for row in broken_promises(points)})
        if silent:
            text += f"; **silent although not good at {_listed(silent)}**"
        summaries.append(text if text.endswith((".", "?")) else f"{text}.")
    return summaries


def _listed(values: Sequence[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)


def pictures(rows: Sequence[Row]) -> Iterator[tuple[str, Figure]]:
    """Yield one picture for each map: success above, error below, the safe region shaded."""
    for name, points in by_map(rows).items():
        yield f"stability_{name}", _picture(MAPS[name], points)


_COLOURS = ("#2471a3", "#ca6f1e", "#7d3c98", "#1e8449")
_MARKS = ("o", "s", "^", "v")


def _picture(each: Map, rows: Sequence[Row]) -> Figure:
    figure = Figure(figsize=(7.2, 5.8), dpi=110, layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    _scaled(above, each, [row["value"] for row in rows])
    for index, line in enumerate(each.lines):
        points = sorted((row for row in rows if row["line"] == line), key=lambda row: row["value"])
        if not points:
            continue
        x = [row["value"] for row in points]
        style = {"color": _COLOURS[index], "marker": _MARKS[index], "markersize": 5, "linewidth": 1.3}
        above.plot(x, [row["success %"] for row in points], label=line or None, **style)
        known = [row for row in points if row["error"] is not None]
        floor = each.tolerated * 1e-9
        below.plot(
            [row["value"] for row in known], [max(row["error"], floor) for row in known], label=line or None, **style
        )
    spoken = [row for row in rows if row["says"]]
    for axes in (above, below):
        for low, high in [] if each.judged_by_error else _safe(each, rows):
            axes.axvspan(low, high, color="#d5f0da", zorder=0, linewidth=0)
        axes.grid(color="0.88", linewidth=0.6)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    above.set_ylim(-5, 108)
    above.set_ylabel(fill(f"{each.success} [%]", 34), fontsize=8.5)
    if any(row["error"] for row in rows):
        positive = [row["error"] for row in rows if row["error"]]
        below.set_yscale("symlog", linthresh=min(each.tolerated or max(positive), max(positive)) / 1e3)
        below.set_ylim(0, 3 * max(each.tolerated, *positive))
    if each.judged_by_error:
        below.axhspan(0, each.tolerated, color="#d5f0da", zorder=0, linewidth=0)
    below.axhline(each.tolerated, color="0.35", linewidth=0.9, linestyle="--")
    below.annotate(
        "good below", (0.01, each.tolerated), xycoords=("axes fraction", "data"), fontsize=7.5, va="bottom", color="0.3"
    )
    below.set_ylabel(fill(each.error, 34), fontsize=8.5)
    below.set_xlabel(f"{each.parameter}; green: the program says nothing", fontsize=9)
    if each.scale == "symlog":
        below.tick_params(axis="x", labelrotation=60, labelsize=8)
    if len(each.lines) > 1:
        above.legend(fontsize=8, frameon=False, loc="best")
    if spoken:
        edge = _nearest_to_safe(each, rows, spoken)
        figure.suptitle(f"{each.title}\n" + fill(f"beyond the green: “{edge['says']}”", 105), fontsize=9, ha="center")
    else:
        figure.suptitle(each.title, fontsize=9.5)
    return figure


def _nearest_to_safe(each: Map, rows: Sequence[Row], spoken: Sequence[Row]) -> Row:
    """Return the row with a message that is nearest to one without, in the order of the values."""
    values = sorted({row["value"] for row in rows})
    silent = [values.index(row["value"]) for row in rows if not row["says"]]
    if not silent:
        return spoken[0]
    return min(spoken, key=lambda row: min(abs(values.index(row["value"]) - other) for other in silent))


def _safe(each: Map, rows: Sequence[Row]) -> list[tuple[float, float]]:
    """Return the shaded intervals: between the program's numbers, else between values without a message."""
    values = sorted({row["value"] for row in rows})
    silent = [not any(row["says"] for row in rows if row["value"] == value) for value in values]
    low, high = each.borders
    if low is not None or high is not None:
        return [
            (values[0] if low is None else max(low, values[0]), values[-1] if high is None else min(high, values[-1]))
        ]
    return [(values[index], values[index + 1]) for index, (one, other) in enumerate(pairwise(silent)) if one and other]


def _scaled(axes: Axes, each: Map, values: Sequence[float]) -> None:
    if each.scale == "symlog":
        axes.set_xscale("symlog", linthresh=each.linear_below)
        axes.set_xticks(sorted(set(values)), [f"{value:g}" for value in sorted(set(values))])
        axes.minorticks_off()
    else:
        axes.set_xscale(each.scale)
    if each.towards_small:
        axes.invert_xaxis()
