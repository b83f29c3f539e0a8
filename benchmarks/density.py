"""Density of scans compared with the predictions of plans: dense and visible coverage, quantiles of the spacing.

Two rows per part of benchmarks/parts.py, planned with defaults and with `--max-spacing` of `LIMIT_MM`, each scanned at
the resolution of the plan, 0.25 degree: views with their bound, visible coverage predicted and achieved, dense coverage
achieved, and the median and the 99 % quantile of the spacing, from the plan and from the scans alone.

In the scans the spacing at a point is the larger of its distances to its neighbours in the two directions of the ray
grid. In each direction it is the mean over the neighbours on the same stretch of surface, not beyond a step (less than
30 degrees off the face). A measured sample has the spacing of the nearest scan point within one spacing, of the scan in
which it is smallest.
"""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.cell_process import run_cell
from benchmarks.parts import parts, place
from cell.errors import CellError
from cell.runs.cell import read_cell
from cell.runs.run import open_run
from planner.geometry.sampling import draw_samples
from planner.measurability import coverage
from planner.values import Floats, Ints32

LIMIT_MM = 1.5
_SAMPLES = 20_000


def run() -> list[dict[str, Any]]:
    """Return two rows per part."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        return [
            _row(folder, name, arguments, limit)
            for name, arguments in parts(folder)
            for limit in ((), ("--max-spacing", f"{LIMIT_MM:g}"))
        ]


def _row(folder: Path, name: str, arguments: tuple[str, ...], limit: tuple[str, ...]) -> dict[str, Any]:
    out = folder / f"{name}{'-limited' if limit else ''}"
    row: dict[str, Any] = {"part": name, "limit mm": limit[-1] if limit else ""}
    try:
        planned, _ = run_cell(
            folder, "plan", *arguments, *limit, "--place", place(), "--out", str(out), cache=folder / "cache"
        )
        scanned, _ = run_cell(folder, "scan", str(out), cache=folder / "cache")
    except CellError as error:
        return row | {"refused": str(error)}
    prediction, found = planned["spacing"], 1000 * spacing_of_scans(out)
    half, most = np.nanquantile(found, [0.5, 0.99])
    return row | {
        "views": planned["n_views"],
        "bound": planned["lower_bound"],
        "of coverable %": round(100 * planned["coverage"]["visible_of_coverable"], 2),
        **{
            f"{key} %": round(100 * scanned["coverage"][key], 2) for key in ("predicted", "visible", "dense", "sampled")
        },
        "half predicted mm": round(prediction["median_mm"], 3),
        "half scanned mm": round(float(half), 3),
        "99 % predicted mm": round(prediction["quantile_99_mm"], 3),
        "99 % scanned mm": round(float(most), 3),
    }


def spacing_of_scans(folder: Path) -> Floats:
    """Return (S,) spacing of the scans of a run's first execution at samples of its part [m]; NaN if unknown.

    Args:
        folder: the run folder.
    """
    run = open_run(folder)
    cell = read_cell(run)
    samples = draw_samples(cell.reference, cell.planning, _SAMPLES, np.random.default_rng(11))
    poses = np.stack([view.T_object_poses for view in run.plan.views])
    visible = coverage.visible_coverage(poses, samples, cell.scanner, (cell.part_caster, cell.occluder_caster)).covered
    best = np.full(_SAMPLES, np.inf)
    for path in sorted((folder / "executions" / "0001" / "scans").glob("*.npz")):
        with np.load(path) as scan:
            points, across = scan["points"], cell.reference.normals[scan["face"]]
            gap = _gaps(points, across, scan["pixel"], tuple(scan["grid_shape"]))
        known = np.isfinite(gap)
        if known.any():
            distance, nearest = cKDTree(points[known]).query(samples.points)
            here = gap[known][nearest]
            best = np.minimum(best, np.where(distance <= here, here, np.inf))
    return np.where(np.isfinite(best) & visible, best, np.nan)


def _gaps(points: Floats, normals: Floats, pixel: Ints32, shape: tuple[int, ...]) -> Floats:
    """Return (P,) larger distance of each point to its neighbours in both grid directions [m]; NaN without any."""
    grid = np.full((2, *shape, 3), np.nan)
    grid[0].reshape(-1, 3)[pixel], grid[1].reshape(-1, 3)[pixel] = points, normals
    found = []
    for axis in (0, 1):
        way = np.diff(grid[0], axis=axis)
        around = []
        for end in (0, way.shape[axis]):
            to = np.insert(way, end, np.nan, axis=axis)
            length = np.linalg.norm(to, axis=2)
            off = np.abs(np.einsum("ijk,ijk->ij", to, grid[1]))
            around.append(np.where(off <= 0.5 * length, length, np.nan))
        found.append(np.where(np.isnan(around).any(axis=0), np.fmin(*around), np.mean(around, axis=0)))
    return np.asarray(np.maximum(*found).reshape(-1)[pixel])
