"""The part, the cell and the page, drawn by the process for pictures while the plan goes on (`cell.plan.drawing`).

What does not depend on the views is made ready as soon as the cell is compiled, from the files of the unfinished run.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cell.plan.pictures import warm_up
from cell.rays.prediction import held_out
from cell.run.cell import RunCell, read_cell
from cell.run.record import open_run
from cell.view import pictures, rays
from cell.view.cell_picture import best_view, draw_cell
from cell.view.contents import HALF_PAGE, of_views, part_of
from cell.view.page import Stage, first_half, three
from cell.view.pieces import Cell, cell_of_run
from cell.view.surface import Canvas, canvas_of
from planner.values import Bools, Floats

_STILL = (800, 600)


@dataclass(frozen=True, slots=True, eq=False)
class _Ready:
    """What is known once the cell is compiled."""

    cell: RunCell
    shown: Cell
    canvas: Canvas


_READY: dict[Path, _Ready] = {}  # of the run that is drawn: one


def make_ready(folder: Path) -> None:
    """Read the part and the cell of an unfinished run, and what every picture needs, so that forks have it."""
    run = open_run(folder)
    cell = read_cell(run)
    cell.scanner.reject(np.ones((1, 3)), np.ones((1, 3)))  # loads its kernel
    three()
    warm_up()
    samples = held_out(cell.reference, cell.planning, run.seed)
    _READY.clear()
    _READY[folder] = _Ready(cell, cell_of_run(run, cell.scene), canvas_of(cell.reference, samples))


def part_and_views(path: Path, *, T_object_poses: Floats, T_object_scanner: Floats, seen: Bools) -> None:
    """views.png, and beside it the first half of the page, for they colour the same surface.

    Args:
        path: of views.png in the run folder.
        T_object_poses: (n, K, 4, 4) views in visiting order, all their poses [m].
        T_object_scanner: (n, 4, 4) the middle pose of each [m].
        seen: (S, n) which held-out samples each view measures.
    """
    ready = _READY[path.parent]
    surface = of_views(ready.cell, ready.canvas.samples, list(T_object_poses), seen)
    opening = np.radians(ready.cell.scanner_keys.opening_deg)
    pictures.part_and_views(path, ready.canvas, surface, T_object_scanner, opening)
    stage = Stage(f"View plan of {ready.cell.scene.part.name}", ready.shown, [part_of(ready.canvas, surface)])
    (path.parent / HALF_PAGE).write_text(first_half(stage), encoding="utf-8")


def cell_with_arm(path: Path, *, q: Floats, T_base_scanner: Floats, way_q: Floats) -> None:
    """cell.png: the arm at one of its views beside the part.

    Args:
        path: PNG to write, in the run folder.
        q: (n, 6) joint angles of the views [rad].
        T_base_scanner: (n, 4, 4) the views [m].
        way_q: (M, 6) joint angles on the way [rad].
    """
    ready = _READY[path.parent]
    arm, part = ready.shown.arm, ready.canvas.mesh
    way = np.stack([(arm.links(each)[-1] @ arm.T_link_scanner)[:3, 3] for each in way_q])
    stands = q[best_view(ready.shown, part, T_base_scanner)]
    drawn, _ = draw_cell(ready.shown, part, stands, views=T_base_scanner, way=way, size=_STILL)
    rays.save(drawn, path)
