"""Write model.ply, report.md, curve.png and view.html of an exploration, and evaluate limits of sigma and spacing.

A rough stage is planned without these limits (Scott's specification). At the end the model is evaluated: the share of
the measured surface that no view measures within the limits.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cell.explore.belief import reconstruct_scans
from cell.part import workpiece
from cell.plan.candidates import limited_scanner
from cell.runs import ply
from cell.runs.run import ExecutedScan
from cell.runs.schema import ExploreFile
from cell.scene.model import Scene
from cell.scene.settle import settle
from cell.view import coverage_curve, explore_page
from cell.view.run_pages import PAGE_FILE as PAGE
from cell.world.embree import EmbreeRayCaster
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import draw_samples
from planner.measurability.visibility import find_measured
from planner.ports import Scanner
from planner.values import Floats

MODEL, REPORT, PICTURE = "model.ply", "report.md", "curve.png"


def write_model(folder: Path, scans: Sequence[ExecutedScan]) -> TriangleMesh | None:
    """Write and return the surface of all scans."""
    if (mesh := reconstruct_scans(scans)) is not None:
        (folder / MODEL).write_bytes(ply.mesh_bytes(mesh))
    return mesh


def middle_of(model: TriangleMesh, place_mm: Floats) -> tuple[float, float, float]:
    """Return the centre of a model's bounding box in base [mm]; `place_mm` is the centre of the cylinder."""
    x, y, z = (place_mm + 500 * (model.vertices.min(axis=0) + model.vertices.max(axis=0))).round(4).tolist()
    return x, y, z


def write(folder: Path, file: ExploreFile) -> None:
    """Write report.md, curve.png and view.html."""
    lines = [f"# Exploration of {file.part} ([view]({PAGE}))", ""]
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


_SAMPLES = 10_000


def has_limits(scene: Scene) -> bool:
    """Return whether the scene limits sigma or spacing."""
    return scene.plan.max_sigma_mm is not None or scene.scanner.max_spacing_mm is not None


def without_limits(scene: Scene) -> Scene:
    """Return the scene without these limits."""
    plan = scene.plan.model_copy(update={"max_sigma_mm": None})
    return scene.model_copy(update={"plan": plan, "scanner": scene.scanner.model_copy(update={"max_spacing_mm": None})})


def share_beyond_limits(scene: Scene, model: TriangleMesh, poses: Floats) -> float:
    """Return the share of the measured surface that no view measures within the limits of the scene.

    Args:
        scene: with settled scanner.
        model: explored frame [m].
        poses: (V, 4, 4) T_explored_scanner of the executed views [m].
    """
    samples = draw_samples(model, model, _SAMPLES, np.random.default_rng(scene.plan.seed))
    casters = (EmbreeRayCaster(model.vertices, model.faces),)
    at_all, within = (
        find_measured(poses[:, None], samples, _limited_scanner(each, model), casters)
        for each in (without_limits(scene), scene)
    )
    total = float(samples.areas[at_all].sum())
    return float(samples.areas[at_all & ~within].sum()) / total if total else 0.0


def _limited_scanner(scene: Scene, model: TriangleMesh) -> Scanner:
    """Return the scanner with the limits of a scene."""
    part = workpiece.from_arrays("model", model.vertices, model.faces, "m")
    return limited_scanner(scene, settle(scene, part).scanner)
