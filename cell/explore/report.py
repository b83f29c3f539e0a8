"""model.ply, report.md and curve.png of an exploration."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cell.reconstruction.cloud import merge
from cell.reconstruction.reconstruct import reconstruct
from cell.run import ply
from cell.run.explore_json import ExploreFile, Truth
from cell.scan.executed_scans import ExecutedScan
from planner.surface.mesh import TriangleMesh
from planner.values import Floats

MODEL, REPORT, PICTURE = "model.ply", "report.md", "curve.png"


def write_model(folder: Path, scans: Sequence[ExecutedScan]) -> TriangleMesh | None:
    """The surface of all scans, explored frame [m]; None where the points describe none."""
    mesh = reconstruct(merge([scan.cloud for scan in scans])).mesh
    if mesh is not None:
        (folder / MODEL).write_bytes(ply.written(mesh))
    return mesh


def middle_of(model: TriangleMesh, place_mm: Floats) -> tuple[float, float, float]:
    """Middle of a model's bounding box, base frame [mm]; `place_mm` is the cylinder's."""
    x, y, z = (place_mm + 500 * (model.vertices.min(axis=0) + model.vertices.max(axis=0))).round(4).tolist()
    return x, y, z


def table(file: ExploreFile) -> list[tuple[str, str]]:
    """What the command shows."""
    last = file.stages[-1]
    rows = [
        ("views", f"{file.views} in {len(file.stages)} batches ({file.policy})"),
        ("motion", f"{sum(stage.seconds for stage in file.stages):.1f} s"),
        ("ended", file.ended),
        ("stays open", f"{100 * last.open_mm2 / last.surface_mm2:.2f} % of the believed surface"),
    ]
    volume = last.never_entered_mm3 / 1000
    rows.append(("never entered", f"{volume:.1f} cm3 of the cylinder, by any ray, solid or hollow"))
    rows += [("", f"{reason.area_mm2:.0f} mm2: {reason.reason}") for reason in file.open[:4]]
    if file.misses_limits is not None:
        share = f"{100 * file.misses_limits:.2f} % of what was measured, worse than the sigma or spacing asked for"
        rows.append(("beyond limits", share))
    if (known := file.truth) is not None:
        rows += [
            ("visible coverage", f"{100 * known.visible:.2f} % of the true surface, of which reachable candidates of "
             f"the true model measure {100 * known.coverable:.2f} %"),
            ("with the model", f"{known.known_model_views} views would have measured "
             f"{100 * known.known_model_visible:.2f} %"),
            ("fewest views", f"{known.fewest} at least for this coverage, for these candidates and samples"),
            ("nearest", f"{known.nearest_mm:.1f} mm ({known.nearest}), the true part in place"),
        ]  # fmt: skip
    return rows


def write(folder: Path, file: ExploreFile) -> None:
    """report.md, and curve.png where the truth is known."""
    lines = [f"# Exploration of {file.part}", ""]
    lines += [f"- {name or 'open'}: {value}" for name, value in table(file)]
    lines += [
        "", "## Stages", "",
        "| stage | views | points | motion s | open before, to be measured mm2 | believed mm2 | of it open mm2 |",
        "|---|---|---|---|---|---|---|",
        *(
            f"| {stage.folder} | {stage.views} | {stage.points} | {stage.seconds:.1f} | {stage.expected_mm2:.0f} | "
            f"{stage.surface_mm2:.0f} | {stage.open_mm2:.0f} |"
            for stage in file.stages
        ),
    ]  # fmt: skip
    if file.truth is not None:
        lines += ["", *_curve(file.truth)]
        _draw(folder / PICTURE, file.truth)
    (folder / REPORT).write_text("\n".join(lines) + "\n", encoding="utf-8")


def _curve(known: Truth) -> list[str]:
    at = {point.views: point for point in known.bound}
    return [
        "## Coverage over views", "",
        "The bound: no so many of the true model's candidates measure more (truth/).", "",
        f"![Coverage over views]({PICTURE})", "",
        "| views | explored % | best found with the model % | at most % |", "|---|---|---|---|",
        *(
            f"| {n} | {100 * share:.2f} | "
            + (f"{100 * at[n].found:.2f} | {100 * at[n].at_most:.2f} |" if n in at else "| |")
            for n, share in enumerate(known.by_views, start=1)
        ),
    ]  # fmt: skip


def _draw(path: Path, known: Truth) -> None:
    """Coverage over views, and the bound."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # matplotlib takes a second to import
    from matplotlib.figure import Figure

    from cell.view.palette import BETWEEN, BLUE, ORANGE, VERMILION

    figure = Figure(figsize=(7.2, 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    n = [point.views for point in known.bound]
    found, most = ([100 * getattr(point, key) for point in known.bound] for key in ("found", "at_most"))
    axes.fill_between(n, found, most, color=BETWEEN, lw=0, label="not excluded by the bound")
    axes.plot(n, most, "-", color=VERMILION, lw=1, label="no views of this number measure more")
    axes.plot(n, found, "-", color=ORANGE, lw=1, label="best views found, the model being known")
    shares = 100 * np.array([0.0, *known.by_views])
    axes.plot(range(len(shares)), shares, "o-", color=BLUE, ms=4, lw=1.2, label="explored")
    axes.set(xlabel="number of views", ylabel="visible coverage [% of the true surface]", ylim=(0, 103))
    axes.set_xlim(0, max(len(shares) - 1, 1))
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right", fontsize=8)
    figure.savefig(path, dpi=110, metadata={"Software": None})
