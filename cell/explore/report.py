"""model.ply, report.md, curve.png and view.html of an exploration."""

from collections.abc import Sequence
from pathlib import Path

from cell.explore.measured_surface import surface_of
from cell.runs import ply
from cell.runs.run import ExecutedScan
from cell.runs.schema import ExploreFile
from cell.view import coverage_curve, explore_page
from cell.view.contents import PAGE_FILE as PAGE
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats

MODEL, REPORT, PICTURE = "model.ply", "report.md", "curve.png"


def write_model(folder: Path, scans: Sequence[ExecutedScan]) -> TriangleMesh | None:
    """Write the surface of all scans, and give it."""
    if (mesh := surface_of(scans)) is not None:
        (folder / MODEL).write_bytes(ply.mesh_bytes(mesh))
    return mesh


def middle_of(model: TriangleMesh, place_mm: Floats) -> tuple[float, float, float]:
    """Middle of a model's bounding box, base frame [mm]; `place_mm` is the cylinder's."""
    x, y, z = (place_mm + 500 * (model.vertices.min(axis=0) + model.vertices.max(axis=0))).round(4).tolist()
    return x, y, z


def write(folder: Path, file: ExploreFile) -> None:
    """report.md, curve.png and view.html."""
    lines = [f"# Exploration of {file.part} ([look at it]({PAGE}))", ""]
    lines += [f"- {name or 'open'}: {value}" for name, value in file.rows()]
    lines += [
        "", "## Stages", "",
        "| stage | views | planned on | points | motion s | expected mm2 | new mm2 | believed mm2 | of it open mm2 |",
        "|---|---|---|---|---|---|---|---|---|",
        *(
            f"| {stage.folder} | {stage.views} | {stage.planned_on} | {stage.points} | {stage.seconds:.1f} | "
            f"{stage.expected_mm2:.0f} | {stage.new_mm2:.0f} | {stage.surface_mm2:.0f} | {stage.open_mm2:.0f} |"
            for stage in file.stages
        ),
    ]  # fmt: skip
    lines += ["", "## Measured surface over views", "", f"![Measured surface over views]({PICTURE})"]
    coverage_curve.draw(folder / PICTURE, file)
    (folder / PAGE).write_text(explore_page.explore_page(folder, file), encoding="utf-8")
    (folder / REPORT).write_text("\n".join(lines) + "\n", encoding="utf-8")
