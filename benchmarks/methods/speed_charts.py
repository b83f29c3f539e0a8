"""The pictures of `speed`: error over processor time, a panel a knob, and the whole pipeline, a panel a part."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from textwrap import fill
from typing import Any

from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from benchmarks.methods.pipeline_under_presets import PAPER, WHOLE
from benchmarks.methods.preset_knobs import KNOBS, Knob, Value
from cell.scene.presets import DEFAULT, PRESETS
from cell.study.study import Row

_COLOURS = {"fast": "#ca6f1e", "balanced": "#1e8449", "accurate": "#7d3c98", PAPER: "#b03a2e"}
_MARKS = {"fast": "v", "balanced": "*", "accurate": "^", PAPER: "s"}
_SIZES = {"fast": 9, "balanced": 14, "accurate": 9, PAPER: 8}
_LINE = "#2471a3"
_BESIDE = 0.4  # points whose seconds and errors differ by less than this (of e): the second's label goes below


def presets_at(knob: Knob, value: Value) -> list[str]:
    """Presets that have this value."""
    return [name for name in PRESETS if knob.of_preset(name) == value]


def by_knob(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """The rows of each knob, those of the whole pipeline left out."""
    found: dict[str, list[Row]] = {}
    for row in rows:
        if row["knob"] != WHOLE:
            found.setdefault(row["knob"], []).append(row)
    return found


def label(knob: Knob, row: Mapping[str, Any]) -> str:
    """A row's value with its unit."""
    return f"{row['value']:g} {knob.unit}".rstrip()


def pictures(rows: Sequence[Row]) -> Iterator[tuple[str, Figure]]:
    """All fronts on one page, and the whole pipeline."""
    lines = by_knob(rows)
    if lines:
        yield "speed_fronts", _fronts(lines)
    ends = [row for row in rows if row["knob"] == WHOLE]
    if ends:
        yield "speed_whole", _whole(ends)


def _fronts(lines: Mapping[str, Sequence[Row]]) -> Figure:
    figure = Figure(figsize=(4.9 * len(lines), 4.2), dpi=110, layout="constrained")
    for axes, (name, line) in zip(figure.subplots(1, len(lines), squeeze=False).flat, lines.items(), strict=True):
        _front(axes, name, line)
    handles = [
        figure.axes[0].plot([], [], _MARKS[name], color=_COLOURS[name], markersize=_SIZES[name], label=_of(name))[0]
        for name in PRESETS
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    figure.suptitle("Processor time against error, one knob at a time", fontsize=11)
    return figure


def _of(preset: str) -> str:
    return f"{preset} (the default)" if preset == DEFAULT else preset


def _front(axes: Axes, name: str, line: Sequence[Row]) -> None:
    """One knob: points labelled with its value, and with views in brackets where it chooses views."""
    knob = KNOBS[name]
    height = _with_floor(axes, [row["error"] for row in line])
    seconds = [max(row["processor s"], 1e-4) for row in line]
    axes.plot(seconds, [height(row["error"]) for row in line], "o-", color=_LINE, markersize=4, linewidth=1.2)
    labelled: list[tuple[float, float]] = []
    for row, x in zip(line, seconds, strict=True):
        y = height(row["error"])
        below = any(abs(math.log(x / x0)) < _BESIDE and abs(math.log(y / y0)) < _BESIDE for x0, y0 in labelled)
        labelled.append((x, y))
        for preset in presets_at(knob, row["value"]):
            axes.plot(x, y, _MARKS[preset], color=_COLOURS[preset], markersize=_SIZES[preset], zorder=3)
        counted = f" ({row['views']})" if knob.error_unit == "points" and "views" in row else ""
        axes.annotate(
            f"{label(knob, row)}{counted}",
            (x, y),
            xytext=(5, -13 if below else 6),
            textcoords="offset points",
            fontsize=7.5,
        )
    axes.set_xscale("log")
    _decimal(axes.xaxis)
    axes.set_title(f"{name}: {knob.title}\non {line[0]['part']}", fontsize=9, loc="left")
    axes.set_ylabel(fill(knob.measure, 36), fontsize=8)
    axes.set_xlabel("processor time [s]", fontsize=8)
    _plain(axes)
    low, high = min(seconds), max(seconds)
    axes.set_xlim(low / 1.4, high * max(1.6, (high / low) ** 0.3))


def _whole(rows: Sequence[Row]) -> Figure:
    """A panel a part: uncovered surface over seconds, views in brackets."""
    parts = list(dict.fromkeys(row["part"] for row in rows))
    figure = Figure(figsize=(4.6 * len(parts) + 0.6, 4.4), dpi=110, layout="constrained")
    for axes, part in zip(figure.subplots(1, len(parts), squeeze=False).flat, parts, strict=True):
        line = [row for row in rows if row["part"] == part]
        height = _with_floor(axes, [row["error"] for row in line])
        presets = [row for row in line if row["value"] in PRESETS]
        axes.plot(
            [row["processor s"] for row in presets], [height(row["error"]) for row in presets], "-", color="0.6", lw=1
        )
        for row in line:
            method, x, y = row["value"], row["processor s"], height(row["error"])
            axes.plot(x, y, _MARKS[method], color=_COLOURS[method], markersize=_SIZES[method])
            usual = method == DEFAULT  # in the middle of the line that falls to the right: left of it and below is room
            axes.annotate(
                f"{method}\n{row['views']} views", (x, y), xytext=(-8, -22) if usual else (7, 5),
                textcoords="offset points", ha="right" if usual else "left", fontsize=8,
            )  # fmt: skip
        axes.set_xscale("log")
        _decimal(axes.xaxis, (1.0, 1.5, 2.0, 3.0, 5.0, 7.0))  # a plan's seconds span less than a decade
        axes.set_title(part, fontsize=10, loc="left")
        _plain(axes)
        low, high = min(row["processor s"] for row in line), max(row["processor s"] for row in line)
        axes.set_xlim(low / 1.25, high * max(1.5, (high / low) ** 0.4))
        axes.set_xlabel("processor time of cell plan [s]", fontsize=9)
    figure.axes[0].set_ylabel("surface that could be measured and is not\n[points of visible coverage]", fontsize=9)
    figure.suptitle("cell plan under each preset, and by the paper's method", fontsize=11)
    return figure


def _with_floor(axes: Axes, errors: Sequence[float]) -> Callable[[float], float]:
    """A logarithmic axis on which an error of zero has a place, at its lower edge; returns where an error is drawn."""
    positive = [error for error in errors if error > 0]
    axes.set_yscale("log")
    _decimal(axes.yaxis)
    if not positive:
        axes.set_ylim(0.005, 2.0)
        axes.set_yticks([0.01], ["0"])
        axes.minorticks_off()
        return lambda error: 0.01
    low, high = min(positive), max(positive)
    floor = low / 4
    if len(positive) < len(errors):
        axes.axhline(floor, color="0.8", linewidth=0.8, linestyle=":")
        axes.text(0.01, floor, "0", transform=axes.get_yaxis_transform(), fontsize=8, color="0.3", va="bottom")
        low = floor
    axes.set_ylim(low / 1.6, high * 2.5)
    return lambda error: error if error > 0 else floor


def _decimal(axis: Axis, between: Sequence[float] = (1.0, 2.0, 5.0)) -> None:
    """Plain numbers at multiples of the powers of ten."""
    axis.set_major_locator(LogLocator(subs=between))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _plain(axes: Axes) -> None:
    axes.grid(color="0.9", linewidth=0.6, which="both")
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)
