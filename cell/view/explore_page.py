"""Page of an exploration: the explored mesh, the views in order, the measured surface over the number of views."""

from __future__ import annotations

from dataclasses import replace
from itertools import accumulate
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from cell.errors import FileError
from cell.runs import ply
from cell.runs import timeline as timelines
from cell.runs.run import ExecutedScan, Run, file_bytes, open_finished, read_execution
from cell.runs.schema import EXPLORE_FILE, UNSEEN, ExploreFile, read_explore_file
from cell.view import coverage_curve, rays
from cell.view.packed import Layer
from cell.view.page import PageContents, PageScene, PageSurface, PageView, render_page, thin_mesh
from cell.view.pieces import cell_of_run
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats

_MAX_DISTANCE_VOXELS = 2.0  # a view measures surface within this distance of its points [voxel edges]
_CAMERA_DEG = (-60, 35)  # azimuth and elevation of the initial camera


def explore_page(folder: Path, file: ExploreFile | None = None) -> str:
    """Return the page of an exploration, finished or not.

    Args:
        folder: of the exploration.
        file: its explore.json; None reads it.

    Raises:
        FileError: if no batch is finished, or a file is missing or damaged.
    """
    file = read_explore_file(folder / EXPLORE_FILE) if file is None else file
    if not file.batches:
        raise FileError(f"{folder} has no finished batch yet; repeat its command to continue")
    runs = [open_finished(folder / stage.folder) for stage in file.batches]
    scans = [scan for run in runs for scan in read_execution(run, "latest").scans]
    cell = cell_of_run(runs[-1], runs[-1].scene)
    cell = replace(cell, pieces=tuple(piece for piece in cell.pieces if piece.name != UNSEEN))
    surfaces = []
    if file.model:
        mesh = thin_mesh(ply.mesh(file_bytes(folder / file.model)))
        layer = _views_layer(mesh, scans, _MAX_DISTANCE_VOXELS * file.voxel_mm / 1000)
        surfaces.append(PageSurface("part", mesh, [layer]))
    views, motion = _views(runs, scans)
    curve = coverage_curve.data_url(file)
    contents = PageContents(
        views,
        motion,
        rows=file.rows(),
        notes=_notes(file),
        next_commands=_next_commands(file),
        folder_depth=0,
        curve=curve,
    )
    return render_page(PageScene(f"Exploration of {file.part}", cell, surfaces, rays.direction(*_CAMERA_DEG)), contents)


def _views(runs: list[Run], scans: list[ExecutedScan]) -> tuple[list[PageView], tuple[Floats, Floats]]:
    """Return the views of all batches in order, and the motions of the batches one after the other."""
    views: list[PageView] = []
    times, angles, begin = [], [], 0.0
    for batch, run in enumerate(runs, start=1):
        timeline = timelines.plan_timeline(run.motion, rest=0.0)
        planned = {view.id: view for view in run.plan.views}
        for stop in timeline.stops:
            number = len(views) + 1
            rows = [("view", f"{number}, batch {batch}"), ("points", f"{len(scans[number - 1].points):,}")]
            views.append(PageView(str(number), planned[stop.candidate].T_base_scanner, begin + stop.begin, rows))
        times.append(begin + timeline.t)
        angles.append(timeline.q)
        begin += timeline.duration
    return views, (np.concatenate(times), np.concatenate(angles))


def _views_layer(mesh: TriangleMesh, scans: list[ExecutedScan], radius: float) -> Layer:
    """Return the layer of the views that have a point within a radius [m] of each vertex."""
    seen = np.zeros((len(mesh.vertices), len(scans)), dtype=np.bool_)
    for view, scan in enumerate(scans):
        if len(scan.points):
            seen[:, view] = np.isfinite(cKDTree(scan.points).query(mesh.vertices, distance_upper_bound=radius)[0])
    bits = np.packbits(seen, axis=1, bitorder="little")
    return Layer("Number of views", "views", bits, f"views with a point within {1000 * radius:.2g} mm")


def _notes(file: ExploreFile) -> list[str]:
    if file.status != "finished":
        return ["this exploration is not finished; the page shows its finished batches"]
    ends = accumulate(stage.views for stage in file.batches)
    return [f"last views of the batches: {', '.join(map(str, ends))}"]


def _next_commands(file: ExploreFile) -> list[str]:
    if file.model_centre_mm is None:
        return []
    place = ",".join(f"{value:g}" for value in file.model_centre_mm)
    return [f"cell plan RUN/{file.model} --units mm --place {place}"]
