"""Chart of the excess over the best known cost: a panel for each family of instances, a line for each solver."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from benchmarks.covers.instances import best_known

_COLOURS = {"ours": "#1e8449", "textbook": "#2471a3", "HiGHS": "#c0392b", "CP-SAT": "#ca6f1e"}
_MAX_PERCENT = 60.0  # upper limit of the chart


def draw(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Draw the chart.

    Args:
        rows: ours at several budgets, the rivals with their traces.
        path: the PNG to write.
    """
    families = list(dict.fromkeys(family(row["name"]) for row in rows))
    across = min(4, len(families))
    figure = Figure(figsize=(3.1 * across, 2.6 * -(-len(families) // across) + 0.6), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    panels = list(figure.subplots(-(-len(families) // across), across, squeeze=False).flat)
    best = {row["instance"]: _best(rows, row) for row in rows}
    for axis, name in zip(panels, families, strict=False):
        mine = [row for row in rows if family(row["name"]) == name]
        for solver in dict.fromkeys(row["solver"] for row in mine):
            times, excess = curve([row for row in mine if row["solver"] == solver], best)
            axis.step(times, excess, where="post", color=_COLOURS[solver], lw=1.5, label=solver)
            axis.plot(times[-1:], excess[-1:], "o", color=_COLOURS[solver], ms=3)
        count = len({row["instance"] for row in mine})
        axis.set_title(f"{name} ({count})" if count > 1 else name, fontsize=9.5, loc="left")
        axis.set(xscale="log", xlim=(0.01, 1.6 * max(row["seconds"] or 1 for row in rows)))
        axis.set_yscale("symlog", linthresh=1.0)
        axis.set_ylim(-0.05, _MAX_PERCENT)
        axis.set_yticks([0, 1, 3, 10, 30], ["0", "1", "3", "10", "30"])
        axis.grid(color="0.92", lw=0.6)
        axis.tick_params(labelsize=8)
        axis.spines[["top", "right"]].set_visible(False)
    for axis in panels[len(families) :]:
        axis.set_visible(False)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=4, frameon=False)
    figure.supxlabel("processor time [s]", fontsize=9.5)
    figure.supylabel("over the best known [%]", fontsize=9.5)
    figure.savefig(path, metadata={"Software": "scan-cell"})


def curve(rows: Sequence[dict[str, Any]], best: dict[str, float]) -> tuple[list[float], list[float]]:
    """Return times [s] and the mean excess over the instances [%]; `_MAX_PERCENT` for one without an answer."""
    by_instance = []
    for instance in dict.fromkeys(row["instance"] for row in rows):
        same = [row for row in rows if row["instance"] == instance]
        answered = [row for row in same if row["views"]]
        points = sorted(point for row in answered for point in row["trace"] or [(row["cpu_s"], row["cost"])])
        by_instance.append([(at, 100 * (cost / best[instance] - 1)) for at, cost in points])
    times = sorted(
        {at for points in by_instance for at, _ in points} | {row["seconds"] for row in rows if row["trace"]}
    )
    means = [
        float(np.mean([min([value for at, value in points if at <= time] + [_MAX_PERCENT]) for points in by_instance]))
        for time in times
    ]
    return times, means


def family(name: str) -> str:
    """Return the family of an instance: scp4 of scp41, scpclr of scpclr10, rail of rail:500x20000:1."""
    stem = name.split(":")[0]
    letters = stem.rstrip("0123456789")
    return stem[:4] if letters == "scp" else letters


def _best(rows: Sequence[dict[str, Any]], row: dict[str, Any]) -> float:
    """Return the best known cost, or the best of these rows."""
    known = None if row["weighted"] or row["coverage"] < 1 else best_known(row["instance"])
    costs = [other["cost"] for other in rows if other["instance"] == row["instance"] and other["views"]]
    return min(costs + ([] if known is None else [known]))
