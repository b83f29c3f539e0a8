"""The page of an exploration: the explored mesh, the views in order, the measured surface over the views."""

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
from cell.view.page import Play, Shown, Stage, View, html_of, thinned
from cell.view.pieces import cell_of_run
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats

_BESIDE = 2.0  # edges of a voxel from a point of a view to surface that counts as measured by it
_SIDE = (-60, 35)  # from where the part is seen at first: azimuth and elevation [deg]


def explore_page(folder: Path, file: ExploreFile | None = None) -> str:
    """The page of an exploration, finished or not.

    Args:
        folder: of it.
        file: its explore.json; None reads it.

    Raises:
        FileError: if no stage was finished yet, or a file is missing or damaged.
    """
    file = read_explore_file(folder / EXPLORE_FILE) if file is None else file
    if not file.stages:
        raise FileError(f"{folder} has no finished batch yet; the command that began it goes on there")
    runs = [open_finished(folder / stage.folder) for stage in file.stages]
    scans = [scan for run in runs for scan in read_execution(run, "latest").scans]
    cell = cell_of_run(runs[-1], runs[-1].scene)
    cell = replace(cell, pieces=tuple(piece for piece in cell.pieces if piece.name != UNSEEN))
    surfaces = []
    if file.model:
        mesh = thinned(ply.mesh(file_bytes(folder / file.model)))
        surfaces.append(Shown("part", mesh, [_views_of(mesh, scans, _BESIDE * file.voxel_mm / 1000)]))
    views, motion = _views(file, runs, scans)
    curve = coverage_curve.data_url(file)
    play = Play(views, motion, rows=file.rows(), notes=_notes(file), next=_next(file), inside=0, curve=curve)
    return html_of(Stage(f"Exploration of {file.part}", cell, surfaces, rays.direction(*_SIDE)), play)


def _views(file: ExploreFile, runs: list[Run], scans: list[ExecutedScan]) -> tuple[list[View], tuple[Floats, Floats]]:
    """The views of all batches in order, and the motions of the batches one after the other."""
    said: list[View] = []
    times, angles, begin = [], [], 0.0
    for batch, run in enumerate(runs, start=1):
        timeline = timelines.plan_timeline(run.motion, rest=0.0)
        planned = {view.id: view for view in run.plan.views}
        for stop in timeline.stops:
            number = len(said) + 1
            rows = [("view", f"{number}, batch {batch}"), ("points", f"{len(scans[number - 1].points):,}")]
            said.append(View(str(number), planned[stop.candidate].T_base_scanner, begin + stop.begin, rows))
        times.append(begin + timeline.t)
        angles.append(timeline.q)
        begin += timeline.duration
    return said, (np.concatenate(times), np.concatenate(angles))


def _views_of(mesh: TriangleMesh, scans: list[ExecutedScan], beside: float) -> Layer:
    """By which views each vertex of the explored surface has a point beside it."""
    seen = np.zeros((len(mesh.vertices), len(scans)), dtype=np.bool_)
    for view, scan in enumerate(scans):
        if len(scan.points):
            seen[:, view] = np.isfinite(cKDTree(scan.points).query(mesh.vertices, distance_upper_bound=beside)[0])
    bits = np.packbits(seen, axis=1, bitorder="little")
    return Layer("Number of views", "views", bits, f"a view with a point within {1000 * beside:.2g} mm counts")


def _notes(file: ExploreFile) -> list[str]:
    if file.status != "finished":
        return ["this exploration goes on; the page shows its finished batches"]
    ends = accumulate(stage.views for stage in file.stages)
    return [f"batches end with the views {', '.join(map(str, ends))}"]


def _next(file: ExploreFile) -> list[str]:
    if file.model_middle_mm is None:
        return []
    place = ",".join(f"{value:g}" for value in file.model_middle_mm)
    return [f"cell plan RUN/{file.model} --units mm --place {place}"]
