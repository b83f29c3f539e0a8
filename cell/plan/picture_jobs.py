"""The part, the cell and the page, drawn by the process for pictures while the plan goes on (`cell.plan.drawing`).

What does not depend on the views is made ready from the files of the unfinished run, as soon as they are there.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cell.runs.cell import scanner_of
from cell.runs.run import open_run
from cell.runs.schema import ResolvedScene
from cell.view import pictures, rays
from cell.view.cell_picture import best_view, draw_cell
from cell.view.contents import HALF_PAGE, part_of
from cell.view.page import Stage, first_half, three
from cell.view.pieces import Cell, beside, cell_of_run
from cell.view.surface import Canvas, canvas_of, surface_of
from cell.world.prediction import held_out_samples
from planner.ports import Scanner
from planner.values import Bools, Floats

_STILL = (800, 600)


def part_ready(folder: Path) -> None:
    """Make the part of an unfinished run ready to be coloured, and read what takes long, so that forks have it."""
    _part.cache_clear()
    _part(folder)
    three()


def cell_ready(folder: Path) -> None:
    """Read the cell of an unfinished run, so that forks have it."""
    _cell.cache_clear()
    _, _, scanner = _cell(folder)
    if hasattr(scanner, "T_view_scanner"):  # of a sweep, which poses see a sample is asked here
        scanner.reject(np.ones((1, 3)), np.ones((1, 3)))  # loads its kernel


@lru_cache(maxsize=1)
def _part(folder: Path) -> Canvas:
    run = open_run(folder)
    reference = run.mesh("reference.ply")
    return canvas_of(reference, held_out_samples(reference, run.mesh("planning.ply"), run.seed))


@lru_cache(maxsize=1)
def _cell(folder: Path) -> tuple[ResolvedScene, Cell, Scanner]:
    """The scene of a run, its cell, and its scanner."""
    run = open_run(folder)
    scene = run.scene
    return scene, cell_of_run(run, scene), scanner_of(scene, scene.scanner)


def part_and_views(path: Path, *, T_object_poses: Floats, T_object_scanner: Floats, seen: Bools) -> None:
    """views.png, and beside it the first half of the page, for they colour the same surface.

    Args:
        path: of views.png in the run folder.
        T_object_poses: (n, K, 4, 4) views in visiting order, all their poses [m].
        T_object_scanner: (n, 4, 4) the middle pose of each [m].
        seen: (S, n) which held-out samples each view measures.
    """
    canvas, (scene, cell, scanner) = _part(path.parent), _cell(path.parent)
    surface = surface_of(canvas.samples, T_object_poses, scanner, (), seen)
    pictures.part_and_views(path, canvas, surface, T_object_scanner, scene.scanner.opening_deg)
    shown = part_of(canvas, surface, regions=scene.regions)
    stage = Stage(f"View plan of {scene.part.name}", beside(cell, canvas.mesh, canvas.aside), [shown])
    (path.parent / HALF_PAGE).write_text(first_half(stage), encoding="utf-8")


def cell_with_arm(
    path: Path,
    *,
    q: Floats,
    T_base_scanner: Floats,
    way: Floats,
    camera_deg: Floats,
    hide: NDArray[np.str_],
) -> None:
    """cell.png: the arm at one of its views beside the part.

    Args:
        path: PNG to write, in the run folder.
        q: (n, 6) joint angles of the views [rad].
        T_base_scanner: (n, 4, 4) the views [m].
        way: (M, 3) places of the scanner's source on the way [m].
        camera_deg: (2,) azimuth and elevation of the camera as seen from the part; (0,) chooses.
        hide: (n,) names of what is left out, where it is there.
    """
    part, (_, cell, _) = _part(path.parent).mesh, _cell(path.parent)
    stands = q[best_view(cell, part, T_base_scanner)]
    hidden = {piece.name for piece in cell.pieces} & set(hide)
    camera = (float(camera_deg[0]), float(camera_deg[1])) if len(camera_deg) else None
    drawn, _ = draw_cell(cell, part, stands, views=T_base_scanner, way=way, size=_STILL, camera=camera, hide=hidden)
    rays.save(drawn, path)
