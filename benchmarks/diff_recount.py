"""Recount the result of `cell diff` from the artefacts of two runs: other rays, other conditions, a k-d tree.

The samples are those on which the difference is defined (the held-out ones of the first run). `benchmarks.checks`
determines which of them the views measure; it reads only the run folders. Areas in mm2.
"""

import json
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.checks import independently_measured
from cell.report.diff import Difference
from cell.runs import ply
from cell.runs.run import Run, open_finished
from cell.world.prediction import held_out_samples

BORDERLINE = 12
"""Samples that lie on the border of a condition to the last digits: largest number of different samples per run."""

_MOSTLY = 0.5


def recounted(found: Difference) -> tuple[list[str], float]:
    """Return the faults of a difference, and the largest deviation of its areas as a number of samples."""
    folders = Path(found.a), Path(found.b)
    runs = [open_finished(folder if found.kind == "plan" else folder.parent.parent) for folder in folders]
    reference = runs[0].mesh("reference.ply")
    samples = held_out_samples(reference, runs[0].mesh("planning.ply"), runs[0].seed)
    each = [independently_measured(run.folder, samples.points, samples.normals) for run in runs]
    wrong = [*_views(found, runs, each, samples.areas), *_numbers(found, folders)]
    if found.kind == "plan":
        a, b = (measured.any(axis=1) for measured in each)
    else:
        extent = 0.01 * float(np.linalg.norm(np.ptp(reference.vertices, axis=0)))
        a, b = (_near_points(folder, samples.points) <= extent for folder in folders)
    surface, off = found.surface, 0.0
    if surface is None:
        return [*wrong, "no areas of one part"], off
    sample_mm2 = 1e6 * float(samples.areas.mean())
    for stated, mask in (
        (surface.a_mm2, a), (surface.b_mm2, b), (surface.gained_mm2, b & ~a), (surface.lost_mm2, a & ~b),
    ):  # fmt: skip
        off = max(off, abs(stated - 1e6 * float(samples.areas[mask].sum())) / sample_mm2)
    if off > 2 * BORDERLINE:
        wrong.append(f"an area is off by {off:.0f} samples")
    return wrong, off


def _near_points(execution: Path, points: np.ndarray) -> np.ndarray:
    cloud = ply.positions(ply.elements((execution / "cloud.ply").read_bytes())["vertex"])
    return np.asarray(cKDTree(cloud).query(points)[0])


def _views(found: Difference, runs: list[Run], each: list[np.ndarray], areas: np.ndarray) -> list[str]:
    """Check the views of a difference.

    Each view is listed once on its side. Kept views have equal poses. Moved views share mostly the same samples, lost
    and new views do not.
    """
    views, wrong = found.views, []
    if found.kind == "plan":
        for side, run in enumerate(runs):
            pairs = [pair[side] for pair in (*views.kept, *((move.a, move.b) for move in views.moved))]
            if sorted([*pairs, *(views.new if side else views.lost)]) != list(range(1, len(run.plan.views) + 1)):
                wrong.append("views are not told once each")
    poses = [run.T_object_scanner for run in runs]
    for a, b in views.kept:
        if np.abs(poses[0][a - 1] - poses[1][b - 1]).max() > 2e-4:
            wrong.append(f"view {a} is not kept")

    def shared(a: int, b: int) -> float:
        one, other = each[0][:, a - 1], each[1][:, b - 1]
        return float(areas[one & other].sum() / max(areas[one | other].sum(), 1e-30))

    wrong += [f"view {move.a} shares {shared(move.a, move.b):.3f}, not {move.shared:.3f}" for move in views.moved
              if abs(shared(move.a, move.b) - move.shared) > 0.002]  # fmt: skip
    wrong += [f"view {a} moved to {b}" for a in views.lost for b in views.new if shared(a, b) > _MOSTLY + 0.002]
    return wrong


def _numbers(found: Difference, folders: tuple[Path, Path]) -> list[str]:
    """Check that the figures are those of the two reports."""
    reports = [json.loads((folder / "report.json").read_text()) for folder in folders]
    wrong = []
    for number in found.numbers:
        key = {"visible %": "visible", "coverable %": "coverable", "sampled %": "sampled"}.get(number.name)
        if key is not None and [number.a, number.b] != [100 * report["coverage"][key] for report in reports]:
            wrong.append(f"{number.name} is another")
    return wrong
