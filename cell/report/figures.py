"""Figures of a plan: matplotlib plots without display or global state, and ray-traced pictures of part and cell.

Each function takes arrays in SI units and writes one PNG; labels have units. Equal input gives equal bytes. Pictures
that do not depend on the views are prepared from the files of the unfinished run as soon as they exist.
"""

from functools import lru_cache
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from cell.runs.cell import scanner_of
from cell.runs.run import open_run
from cell.runs.schema import ResolvedScene
from cell.view import pictures, rays
from cell.view.cell_picture import best_view, draw_cell
from cell.view.page import PageScene, first_half, three_js
from cell.view.palette import AXES, BETWEEN, BLUE, ORANGE, PURPLE, VERMILION
from cell.view.pieces import CellGeometry, cell_of_run, with_ignored_faces
from cell.view.run_pages import PARTIAL_PAGE_FILE, VIEWS_LAYER, part_surface
from cell.view.surface import Canvas, canvas_of, measure_samples
from cell.world.prediction import held_out_samples
from planner.kinematics.reach import Verdict
from planner.ports import ARM_AXES, Scanner, axis_name
from planner.values import Bools, Floats

_VERDICT_COLOURS = {
    Verdict.REACHABLE: BLUE,
    Verdict.OUT_OF_REACH: VERMILION,
    Verdict.JOINT_LIMIT: ORANGE,
    Verdict.COLLISION: PURPLE,
}


def cover_curve(path: Path, *, marginal_area: Floats, coverable: float, total: float, lower_bound: int) -> None:
    """Plot the covered share over the number of views, with the lower bound on that number.

    Args:
        path: PNG to write.
        marginal_area: (n,) marginal area of each view in order of selection [m^2].
        coverable: coverable area [m^2].
        total: area of the surface [m^2].
        lower_bound: on the number of views.
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
    views: NDArray[np.int64],
    envelope: Floats,
) -> None:
    """Plot the candidates from above and from the side, coloured by verdict, with part, robot and envelope.

    Args:
        path: PNG to write.
        T_base_scanner: (V, 4, 4) candidates in the base frame [m].
        verdict: (V,) `Verdict` values.
        part_corners: (8, 3) corners of the part's bounding box in base [m].
        views: (n,) indices of the views of the plan.
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
        axes.scatter(places[views, a], places[views, b], s=46, facecolors="none", edgecolors="k", label="chosen")
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
    """Plot joint angles and joint speeds over time; vertical lines are the stops at the views.

    Args:
        path: PNG to write.
        t: (M,) [s].
        q: (M, axes) [rad].
        qd: (M, axes) [rad/s].
        limit: (axes,) speeds drawn as 100 % [rad/s].
        stops: (n,) times of the views [s].
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
    path: Path, *, n_views: NDArray[np.int64], covered: Floats, bound: Floats, plan_views: int, plan: float
) -> None:
    """Plot the covered share of the coverable area over the number of views, its upper bound, and the plan.

    The lower half shows the missing share on a logarithmic scale, where the last views differ.

    Args:
        path: PNG to write.
        n_views: (n,) numbers of views.
        covered: (n,) coverage of the best views found, % of the coverable area.
        bound: (n,) upper bound on the coverage, %.
        plan_views: number of views of the plan.
        plan: coverage of the plan, %.
    """
    figure = _figure(7.2, 6.4, left=0.95, bottom=0.55)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    n = n_views
    upper.fill_between(n, covered, bound, color=BETWEEN, lw=0, label="not excluded by the bound")
    upper.plot(n, bound, "-", color=VERMILION, lw=1, label="upper bound for this number of views")
    upper.plot(n, covered, "o-", color=BLUE, ms=4, lw=1.2, label="best views found")
    upper.plot([plan_views], [plan], "*", color="#111111", ms=11, label="the plan")
    upper.set(ylabel="measured [% of coverable]", ylim=(0, 103), xlim=(float(n[0]), float(max(n[-1], 1))))
    upper.legend(loc="lower right", fontsize=8)
    floor = 100 * _smallest(1 - np.concatenate((covered, bound)) / 100)
    missing, least = np.maximum(100 - covered, floor), np.maximum(100 - bound, floor)
    lower.semilogy(n, missing, "o-", color=BLUE, ms=4, lw=1.2)
    lower.semilogy(n, least, "-", color=VERMILION, lw=1)
    lower.fill_between(n, least, missing, color=BETWEEN, lw=0)
    lower.semilogy([plan_views], [max(100 - plan, floor)], "*", color="#111111", ms=11)
    lower.set(xlabel="number of views", ylabel=f"not measured [%]\n(all measured: {floor:.2g})")
    lower.xaxis.set_major_locator(MaxNLocator(integer=True))
    for axes in (upper, lower):
        axes.grid(alpha=0.3)
    _save(figure, path)


def _smallest(missing: Floats) -> float:
    """Return half of the smallest missing share, where the logarithmic axis ends; 0.1 % without any."""
    missing = missing[missing > 1e-9]
    return float(missing.min()) / 2 if len(missing) else 1e-3


def _figure(width: float, height: float, *, left: float, bottom: float, top: float = 0.1) -> Figure:
    """Return an empty figure with margins in inches: matplotlib's layouts draw every figure twice more to find them."""
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
    """Write a figure as PNG without metadata that changes from run to run."""
    FigureCanvasAgg(figure)
    figure.savefig(path, format="png", metadata={"Software": "scan-cell"})


_STILL = (800, 600)


def part_ready(folder: Path) -> None:
    """Prepare the part of an unfinished run for colouring, so that forks have it."""
    _part.cache_clear()
    _part(folder)
    three_js()


def cell_ready(folder: Path) -> None:
    """Read the cell of an unfinished run, so that forks have it."""
    _cell.cache_clear()
    _, _, scanner = _cell(folder)
    if hasattr(scanner, "T_view_scanner"):  # figures of sweeps evaluate the poses that see a sample
        scanner.reject(np.ones((1, 3)), np.ones((1, 3)))  # compiles its kernel


@lru_cache(maxsize=1)
def _part(folder: Path) -> Canvas:
    run = open_run(folder)
    reference = run.mesh("reference.ply")
    return canvas_of(reference, held_out_samples(reference, run.mesh("planning.ply"), run.seed))


@lru_cache(maxsize=1)
def _cell(folder: Path) -> tuple[ResolvedScene, CellGeometry, Scanner]:
    """Return the scene of a run, its cell, and its scanner."""
    run = open_run(folder)
    scene = run.scene
    return scene, cell_of_run(run, scene), scanner_of(scene, scene.scanner)


def part_and_views(path: Path, *, T_object_poses: Floats, T_object_scanner: Floats, seen: Bools) -> None:
    """Draw views.png, and write the first half of the page, which colours the same surface.

    Args:
        path: of views.png in the run folder.
        T_object_poses: (n, K, 4, 4) views in visiting order, all their poses [m].
        T_object_scanner: (n, 4, 4) the middle pose of each [m].
        seen: (S, n) which held-out samples each view measures.
    """
    canvas, (scene, cell, scanner) = _part(path.parent), _cell(path.parent)
    surface = measure_samples(canvas.samples, T_object_poses, scanner, (), seen)
    pictures.draw_part_and_views(path, canvas, surface, T_object_scanner, scene.scanner.opening_deg)
    page_surface = part_surface(canvas, surface, regions=scene.regions)
    counted = with_ignored_faces(cell, canvas.mesh, canvas.ignored)
    stage = PageScene(f"View plan of {scene.part.name}", counted, [page_surface], opens_on=VIEWS_LAYER)
    (path.parent / PARTIAL_PAGE_FILE).write_text(first_half(stage), encoding="utf-8")


def cell_with_arm(
    path: Path, *, q: Floats, T_base_scanner: Floats, source_path: Floats, camera_deg: Floats, hide: NDArray[np.str_]
) -> None:
    """Draw cell.png: the arm at one of its views beside the part.

    Args:
        path: PNG to write, in the run folder.
        q: (n, 6) joint angles of the views [rad].
        T_base_scanner: (n, 4, 4) the views [m].
        source_path: (M, 3) positions of the scanner's source along the motion [m].
        camera_deg: (2,) azimuth and elevation of the camera seen from the part; empty: automatic.
        hide: (n,) names of objects that are left out.
    """
    part, (_, cell, _) = _part(path.parent).mesh, _cell(path.parent)
    q_shown = q[best_view(cell, part, T_base_scanner)]
    hidden = {piece.name for piece in cell.pieces} & set(hide)
    camera = (float(camera_deg[0]), float(camera_deg[1])) if len(camera_deg) else None
    image, _ = draw_cell(
        cell, part, q_shown, views=T_base_scanner, path=source_path, size=_STILL, camera=camera, hide=hidden
    )
    rays.save_png(image, path)
