"""The paper's Mug at 300 mm (Tables 2 and 4) on the built-in Mug: effect of the ray grid on the plan.

At 300 mm and 1 degree the paper's Mug takes 58 views for 53 %; at 0.1 degree 5 views for 98 %. Here the matrix is
filled by `rays` at resolutions from 4 to 0.2 degrees, and once by `aimed`, which has no grid; no robot, one roll, one
standoff as in the paper. Each plan (fewest views that the cover solver finds) is then evaluated twice on 10^5 samples
outside the matrix: visible coverage, and sampled coverage of scans at the resolution of the row.
"""

from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from cell.part import workpiece
from cell.scanners.laser_area import LaserArea
from cell.world.embree import EmbreeRayCaster
from cell.world.virtual_scan import scan
from planner import cover
from planner.geometry.closest import closest_facing_faces
from planner.geometry.decimation import decimate
from planner.geometry.sampling import draw_samples, samples_at_face_centres
from planner.measurability import coverage
from planner.measurability.matrix import Measurability
from planner.measurability.visibility import fill_matrix
from planner.viewpoints.viewpoints import optimal_scanning_zone

RESOLUTIONS_DEG = (4.0, 2.0, 1.0, 0.5, 0.25, 0.2)
STANDOFF = 0.3
FACES = 748
_SAMPLES_PER_FACE = 4
_PAPER = {1.0: (58, 53.07), 0.1: (5, 98.38)}
"""Resolution [deg] to views and cover [%] of the paper's Tables 2 and 4 at 300 mm."""


def run() -> list[dict[str, Any]]:
    """Return two rows per resolution: `rays`, and the same `aimed` matrix evaluated at this resolution."""
    part = workpiece.load("mug")
    reference = part.reference
    planning = decimate(reference, FACES)
    views = optimal_scanning_zone(planning, (STANDOFF,), (0.0,))
    caster = EmbreeRayCaster(reference.vertices, reference.faces)
    rng = np.random.default_rng(0)
    features = draw_samples(reference, planning, _SAMPLES_PER_FACE * len(planning.faces), rng)
    held_out = draw_samples(reference, planning, coverage.N_SAMPLES, rng)
    row_of_face = closest_facing_faces(reference.centres, reference.normals, planning)
    rows = samples_at_face_centres(reference, planning)

    def evaluate(name: str, step: float, M: Measurability, seconds: float) -> dict[str, Any]:
        scanner = _scanner(step)
        plan = cover.solve(cover.CoverProblem(M.matrix(), M.samples.areas), rng=np.random.default_rng(0))
        T = views.T_object_scanner[plan.views]
        points = np.concatenate([scan(scanner, pose, caster, reference).points for pose in T[:, 0]])
        sampled = coverage.sampled_coverage(points, held_out, coverage.sampling_radius(reference)).fraction
        return {
            "fill": name,
            "resolution deg": step,
            "fill s": round(seconds, 3),
            "views": len(plan.views),
            "lower bound": plan.lower_bound,
            "predicted %": round(100 * plan.covered_area / plan.total_area, 2),
            "visible %": round(100 * coverage.visible_coverage(T, held_out, scanner, [caster]).fraction, 2),
            "sampled %": round(100 * sampled, 2),
            "paper views": _PAPER.get(step, (None, None))[0],
            "paper cover %": _PAPER.get(step, (None, None))[1],
        }

    start = perf_counter()
    aimed = fill_matrix(views, features, _scanner(1.0), caster)
    aimed_seconds = perf_counter() - start
    found = []
    for step in RESOLUTIONS_DEG:
        start = perf_counter()
        M = fill_matrix(views, rows, _scanner(step), caster, method="rays", part=reference, row_of_face=row_of_face)
        found.append(evaluate("rays", step, M, perf_counter() - start))
        found.append(evaluate("aimed", step, aimed, aimed_seconds))
    return found


def chart(rows: list[dict[str, Any]], folder: Path) -> None:
    """Draw `mug_resolution.png`: views, visible and sampled coverage over the resolution, for both methods."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.5, 3.6), dpi=120, layout="constrained")
    panels = figure.subplots(1, 3, sharex=True)
    titles = (
        ("views", "views of the plan"),
        ("visible %", "visible coverage [%]"),
        ("sampled %", "sampled coverage [%]"),
    )
    for axis, (column, title) in zip(panels, titles, strict=True):
        for name, marker, colour in (("rays", "s", "#c4622d"), ("aimed", "o", "#2a6f97")):
            points = [row for row in rows if row["fill"] == name]
            axis.plot(
                [row["resolution deg"] for row in points], [row[column] for row in points],
                marker=marker, color=colour, linewidth=1.4, markersize=5, label=name,
            )  # fmt: skip
        paper_column = {"views": 0, "sampled %": 1}.get(column)
        if paper_column is not None:
            paper = [values[paper_column] for values in _PAPER.values()]
            axis.plot(list(_PAPER), paper, "x", color="0.3", markersize=7, label="the paper's Mug")
        axis.set_xscale("log")
        axis.invert_xaxis()
        ticks = (4.0, 2.0, 1.0, 0.5, 0.2, 0.1)
        axis.set_xticks(ticks, [f"{step:g}" for step in ticks])
        axis.minorticks_off()
        axis.set_title(title, fontsize=10, loc="left")
        axis.set_ylim((95.0, 100.2) if column == "visible %" else (0.0, None))
        axis.grid(color="0.92", linewidth=0.6)
        axis.set_axisbelow(True)
        for side in ("top", "right"):
            axis.spines[side].set_visible(False)
    panels[0].legend(frameon=False, fontsize=9)
    figure.supxlabel("angle between rays of the matrix (rays) and of the scan (sampled coverage) [deg]", fontsize=9.5)
    FigureCanvasAgg(figure)
    figure.savefig(folder / "mug_resolution.png", format="png", metadata={"Software": "scan-cell"})


def _scanner(step: float) -> LaserArea:
    return LaserArea(resolution_deg=(step, step), range_mm=(150, 450), baseline_mm=25)
