"""Coverage over views and over seconds of motion: a column for each part, a line for each policy, a band over seeds."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from cell.view.palette import BETWEEN, BLUE, GREEN, GREY, ORANGE, PURPLE, VERMILION

_COLOURS = {"stepwise": BLUE, "uniform": GREEN, "random": GREY, "volumetric": ORANGE, "density": PURPLE}


def draw(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Draw the picture.

    Args:
        rows: rows of the benchmark.
        path: the PNG to write.
    """
    names = list(dict.fromkeys(row["part"] for row in rows))
    timed = any(row["seconds"] for row in rows)
    figure = Figure(figsize=(3.1 * len(names) + 0.6, 5.6 if timed else 3.3), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(2 if timed else 1, len(names), squeeze=False, sharey=True)
    for column, name in enumerate(names):
        mine = [row for row in rows if row["part"] == name]
        for over, axes in enumerate(panels[:, column]):
            _panel(axes, mine, over == 1)
        panels[0, column].set_title(name, fontsize=9.5, loc="left")
    panels[0, 0].set_ylim(0, 102)
    for row, label in zip(panels, ("views", "seconds of motion"), strict=False):
        row[0].set_ylabel("visible coverage [%]", fontsize=8.5)
        for axes in row:
            axes.set_xlabel(label, fontsize=8.5)
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=6, frameon=False)
    figure.savefig(path, metadata={"Software": "scan-cell"})


def draw_evaluations(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Draw the coverage of explorations over their views, and what the model's candidates reach, a panel each."""
    figure = Figure(figsize=(7.2, 4.0 * len(rows)), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    for axes, row in zip(figure.subplots(len(rows), 1, squeeze=False)[:, 0], rows, strict=True):
        n, found, at_most = np.array(row["bound"]).T
        axes.fill_between(n, 100 * found, 100 * at_most, color=BETWEEN, lw=0, label="not excluded by the bound")
        axes.plot(n, 100 * at_most, "-", color=VERMILION, lw=1, label="upper bound for the model's candidates")
        axes.plot(n, 100 * found, "-", color=ORANGE, lw=1, label="best selection found with the model")
        shares = 100 * np.array([0.0, *row["by views"]])
        axes.plot(range(len(shares)), shares, "o-", color=BLUE, ms=4, lw=1.2, label="explored")
        axes.set(ylabel="visible coverage [% of the true surface]", xlabel="number of views", ylim=(0, 103))
        axes.set_xlim(0, len(shares) - 1)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.grid(alpha=0.3)
        axes.set_title(f"{row['part']}, {row['policy']}, seed {row['seed']}", fontsize=9.5, loc="left")
        axes.legend(fontsize=8, loc="lower right")
    figure.savefig(path, metadata={"Software": "scan-cell"})


def _panel(axes: Axes, rows: Sequence[dict[str, Any]], timed: bool) -> None:
    for policy in dict.fromkeys(row["policy"] for row in rows):
        mine = [row for row in rows if row["policy"] == policy]
        most = max(len(row["by views"]) for row in mine)
        x = np.linspace(0, max(row["seconds"][-1] for row in rows), 200) if timed else np.arange(1, most + 1)
        curves = [
            np.concatenate([[0.0], row["by views"]])[np.searchsorted(row["seconds"], x, side="right")]
            if timed else np.pad(row["by views"], (0, most - len(row["by views"])), mode="edge")
            for row in mine
        ]  # fmt: skip
        colour = _COLOURS.get(policy.split(":")[0], GREY)
        axes.fill_between(x, np.min(curves, axis=0), np.max(curves, axis=0), color=colour, alpha=0.15, lw=0)
        axes.plot(x, np.mean(curves, axis=0), color=colour, lw=1.6, label=policy)
    axes.axhline(rows[0]["ceiling %"], color="0.5", lw=0.8, ls=":", label="what some pose measures")
    axes.grid(color="0.92", lw=0.6)
    axes.tick_params(labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)
