"""The report's pictures, drawn with matplotlib's Agg canvas: no display, no pyplot, no global state.

Every function takes arrays in SI units and writes one PNG; labels carry units. Equal input gives equal bytes.
"""

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from cell.view.palette import AXES, BETWEEN, BLUE, ORANGE, PURPLE, VERMILION
from planner.kinematics.reach import Verdict
from planner.ports import ARM_AXES, axis_name
from planner.values import Floats

_VERDICT_COLOURS = {
    Verdict.REACHABLE: BLUE,
    Verdict.OUT_OF_REACH: VERMILION,
    Verdict.JOINT_LIMIT: ORANGE,
    Verdict.COLLISION: PURPLE,
}


def cover_curve(path: Path, *, marginal_area: Floats, coverable: float, total: float, lower_bound: int) -> None:
    """Covered share over number of views, with the lower bound on the number of views.

    Args:
        path: PNG to write.
        marginal_area: (n,) area that each view adds [m^2], in order of selection.
        coverable: area that reachable candidates can measure [m^2].
        total: area of the surface [m^2].
        lower_bound: no plan of these candidates and samples needs fewer views.
    """
    figure = _figure(6.4, 4.2, left=0.65, bottom=0.55)
    axes = figure.add_subplot()
    share = 100.0 * np.concatenate([[0.0], np.cumsum(marginal_area)]) / total
    axes.plot(range(len(share)), share, "o-", color=BLUE, label="covered by the first n views")
    axes.axhline(100.0 * coverable / total, color=ORANGE, ls="--", lw=1, label="coverable by reachable candidates")
    axes.axvline(lower_bound, color=PURPLE, ls=":", lw=1.5, label=f"lower bound: {lower_bound} views")
    axes.set(xlabel="number of views", ylabel="covered area [% of surface]", ylim=(0, 103), xlim=(0, None))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right", fontsize=8)
    _save(figure, path)


def reach_map(
    path: Path,
    *,
    T_base_scanner: Floats,
    verdict: NDArray[np.uint8],
    part_corners: Floats,
    chosen: NDArray[np.int64],
    envelope: Floats,
) -> None:
    """Candidate viewpoints from above and from the side, coloured by verdict, with part, robot and envelope.

    Args:
        path: PNG to write.
        T_base_scanner: (V, 4, 4) candidates in the base frame [m].
        verdict: (V,) `Verdict` values.
        part_corners: (8, 3) corners of the part's bounding box in base [m].
        chosen: (n,) indices of the views of the plan.
        envelope: (E, 2) places that the wrist centre reaches in the plane of the arm, radius and height [m].
    """
    figure = _figure(12.0, 5.6, left=0.7, bottom=0.55, top=0.3)
    places = T_base_scanner[:, :3, 3] * 1000.0
    corners = part_corners * 1000.0
    within = envelope * 1000.0
    for index, (a, b, labels) in enumerate(((0, 1, "xy"), (0, 2, "xz"))):
        axes = figure.add_subplot(1, 2, index + 1)
        for kind in Verdict:
            here = verdict == kind
            if here.any():
                axes.scatter(
                    places[here, a], places[here, b], s=7, lw=0, color=_VERDICT_COLOURS[kind],
                    label=f"{kind.name.lower().replace('_', ' ')} ({here.sum()})",
                )  # fmt: skip
        axes.scatter(places[chosen, a], places[chosen, b], s=46, facecolors="none", edgecolors="k", label="chosen")
        low, high = corners[:, (a, b)].min(axis=0), corners[:, (a, b)].max(axis=0)
        axes.fill([low[0], high[0], high[0], low[0]], [low[1], low[1], high[1], high[1]], color="#999999", alpha=0.6)
        if labels == "xy":
            turn = np.linspace(0, 2 * np.pi, 181)
            reach = np.abs(within[:, 0]).max()
            axes.plot(reach * np.cos(turn), reach * np.sin(turn), color="#bbbbbb", lw=1)
        else:
            axes.scatter(within[:, 0], within[:, 1], s=9, lw=0, color="#f0f0f0", zorder=0, label="wrist reaches")
        axes.plot(0, 0, "k+", ms=12)
        axes.annotate("robot base", (0, 0), textcoords="offset points", xytext=(6, 6), fontsize=8)
        axes.set(xlabel=f"{labels[0]} in base [mm]", ylabel=f"{labels[1]} in base [mm]", aspect="equal")
        axes.set_title("from above" if labels == "xy" else "from the side (y projected)", fontsize=10)
        axes.grid(alpha=0.25)
    figure.axes[0].legend(loc="upper left", fontsize=8)
    _save(figure, path)


def joint_motion(path: Path, *, t: Floats, q: Floats, qd: Floats, limit: Floats, stops: Floats) -> None:
    """Joint angles and joint speeds over time; vertical lines are the stops at the views.

    Args:
        path: PNG to write.
        t: (M,) [s].
        q: (M, axes) [rad].
        qd: (M, axes) [rad/s].
        limit: (axes,) speeds that are drawn as 100 % [rad/s].
        stops: (n,) times at which the arm stands at a view [s].
    """
    figure = _figure(10.5, 6.0, left=0.75, bottom=0.55, top=0.4)
    upper, lower = figure.subplots(2, 1, sharex=True)
    for joint in range(q.shape[1]):
        colour = AXES[joint % len(AXES)] if joint < ARM_AXES else "#444444"
        upper.plot(t, np.degrees(q[:, joint]), lw=1.2, color=colour, label=axis_name(joint))
        lower.plot(t, 100.0 * qd[:, joint] / limit[joint], lw=1.0, color=colour)
    for axes in (upper, lower):
        for stop in stops:
            axes.axvline(stop, color="#bbbbbb", lw=0.8, zorder=0)
        axes.grid(alpha=0.25)
    upper.set_ylabel("joint angle [deg]")
    upper.legend(ncols=q.shape[1], fontsize=8, loc="upper center", bbox_to_anchor=(0.5, 1.14), frameon=False)
    lower.set(ylabel="joint speed [% of limit]", xlabel="time [s]", ylim=(-108, 108))
    _save(figure, path)


def coverage_over_views(
    path: Path,
    *,
    n_views: NDArray[np.int64],
    covered: Floats,
    bound: Floats,
    plan_views: int,
    plan: float,
) -> None:
    """Covered share of what can be measured over the number of views, the bound above it, and the plan.

    The lower half shows what is missing on a logarithmic scale, where the last views differ.

    Args:
        path: PNG to write.
        n_views: (n,) numbers of views.
        covered: (n,) what the best views found cover, % of what can be measured.
        bound: (n,) what no views of this number exceed, %.
        plan_views: number of views of the plan.
        plan: what it covers, %.
    """
    figure = _figure(7.2, 6.4, left=0.95, bottom=0.55)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    n = n_views
    upper.fill_between(n, covered, bound, color=BETWEEN, lw=0, label="not excluded by the bound")
    upper.plot(n, bound, "-", color=VERMILION, lw=1, label="no views of this number measure more")
    upper.plot(n, covered, "o-", color=BLUE, ms=4, lw=1.2, label="best views found")
    upper.plot([plan_views], [plan], "*", color="#111111", ms=11, label="the plan")
    upper.set(ylabel="measured [% of what can be measured]", ylim=(0, 103), xlim=(float(n[0]), float(max(n[-1], 1))))
    upper.legend(loc="lower right", fontsize=8)
    floor = 100 * _smallest(1 - np.concatenate((covered, bound)) / 100)
    missing, open_still = np.maximum(100 - covered, floor), np.maximum(100 - bound, floor)
    lower.semilogy(n, missing, "o-", color=BLUE, ms=4, lw=1.2)
    lower.semilogy(n, open_still, "-", color=VERMILION, lw=1)
    lower.fill_between(n, open_still, missing, color=BETWEEN, lw=0)
    lower.semilogy([plan_views], [max(100 - plan, floor)], "*", color="#111111", ms=11)
    lower.set(xlabel="number of views", ylabel=f"not measured [%]\n(all measured: {floor:.2g})")
    lower.xaxis.set_major_locator(MaxNLocator(integer=True))
    for axes in (upper, lower):
        axes.grid(alpha=0.3)
    _save(figure, path)


def _smallest(missing: Floats) -> float:
    """Half of the smallest share that is missing anywhere, where the logarithmic axis ends; 0.1 % without any."""
    missing = missing[missing > 1e-9]
    return float(missing.min()) / 2 if len(missing) else 1e-3


def _figure(width: float, height: float, *, left: float, bottom: float, top: float = 0.1) -> Figure:
    """An empty figure with margins in inches: matplotlib's own layouts draw every figure twice more to find them."""
    figure = Figure(figsize=(width, height), dpi=110)
    figure.subplots_adjust(
        left=left / width,
        right=1 - 0.15 / width,
        bottom=bottom / height,
        top=1 - top / height,
        wspace=0.14,
        hspace=0.06,
    )
    return figure


def _save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG without anything that changes from run to run."""
    FigureCanvasAgg(figure)
    figure.savefig(path, format="png", metadata={"Software": "scan-cell"})
