"""Charts of `speed`: error over processor time, a panel for each knob."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from textwrap import fill
from typing import Any

from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from benchmarks.methods.knobs import KNOBS, Knob
from cell.study.study import Row

_LINE, _DEFAULT = "#2471a3", {"marker": "*", "color": "#1e8449", "markersize": 14}
_BESIDE = 0.4  # points whose log seconds and log errors differ by less than this: the label of the second goes below


def by_knob(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Return the rows of each knob."""
    found: dict[str, list[Row]] = {}
    for row in rows:
        found.setdefault(row["knob"], []).append(row)
    return found


def label(knob: Knob, row: Mapping[str, Any]) -> str:
    """Return the value of a row with its unit."""
    return f"{row['value']:g} {knob.unit}".rstrip()


def pictures(rows: Sequence[Row]) -> Iterator[tuple[str, Figure]]:
    """Yield all fronts on one page."""
    if lines := by_knob(rows):
        yield "speed_fronts", _fronts(lines)


def _fronts(lines: Mapping[str, Sequence[Row]]) -> Figure:
    figure = Figure(figsize=(4.9 * len(lines), 4.2), dpi=110, layout="constrained")
    for axes, (name, line) in zip(figure.subplots(1, len(lines), squeeze=False).flat, lines.items(), strict=True):
        _front(axes, name, line)
    handles = figure.axes[0].plot([], [], linestyle="", label="the default", **_DEFAULT)
    figure.legend(handles=handles, loc="outside lower center", frameon=False, fontsize=9)
    figure.suptitle("Processor time against error, one knob at a time", fontsize=11)
    return figure


def _front(axes: Axes, name: str, line: Sequence[Row]) -> None:
    """Draw one knob: points with their values as labels, and numbers of views in brackets."""
    knob = KNOBS[name]
    height = _with_floor(axes, [row["error"] for row in line])
    seconds = [max(row["processor s"], 1e-4) for row in line]
    axes.plot(seconds, [height(row["error"]) for row in line], "o-", color=_LINE, markersize=4, linewidth=1.2)
    labelled: list[tuple[float, float]] = []
    for row, x in zip(line, seconds, strict=True):
        y = height(row["error"])
        below = any(abs(math.log(x / x0)) < _BESIDE and abs(math.log(y / y0)) < _BESIDE for x0, y0 in labelled)
        labelled.append((x, y))
        if row["value"] == knob.default:
            axes.plot(x, y, zorder=3, **_DEFAULT)
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


def _with_floor(axes: Axes, errors: Sequence[float]) -> Callable[[float], float]:
    """Set up a logarithmic axis with an error of zero at its lower edge.

    Returns the function from an error to its place on the axis.
    """
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
    """Set plain numbers as labels at multiples of the powers of ten."""
    axis.set_major_locator(LogLocator(subs=between))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _plain(axes: Axes) -> None:
    axes.grid(color="0.9", linewidth=0.6, which="both")
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)
