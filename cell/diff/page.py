"""The page of `cell diff`: the part coloured by what is gained and lost from A to B, in B's cell, with B's motion.

B's views can be clicked as on its own page, and say what became of A's; those of A alone stand where they were to the
part.
"""

import shlex
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cell.diff.difference import Difference, shown
from cell.diff.side import Side
from cell.runs.run import read_execution
from cell.view.contents import execution_play, named_layer, plan_play
from cell.view.page import Play, Shown, Stage, View, html_of
from cell.view.palette import BLUE, GREEN, GREY, MEASURED, VERMILION
from cell.view.pieces import Cell, beside, cell_of_run
from cell.view.surface import canvas_of, sides
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples
from planner.values import Bools

_NAMES = (("measured by both", MEASURED), ("by neither", GREY), ("lost: by A alone", VERMILION),
          ("gained: by B alone", BLUE))  # fmt: skip


def page(
    found: Difference, sides_of: tuple[Side, Side], part: TriangleMesh, samples: SurfaceSamples, a: Bools, b: Bools
) -> str:
    """The whole file.

    Args:
        found: what differs.
        sides_of: A and B.
        part: reference mesh, object frame [m].
        samples: of it.
        a: (S,) which of them A measures.
        b: the same for B.
    """
    A, B = sides_of
    scene = B.run.scene
    cell, canvas = cell_of_run(B.run, scene), canvas_of(part, samples)
    which = np.where(a, np.where(b, 0, 2), np.where(b, 3, 1))
    layer = named_layer("Gained and lost", which, _NAMES, canvas)
    stage = Stage(
        f"{scene.part.name}: {found.b} (B) against {found.a} (A)", beside(cell, canvas.mesh, canvas.aside),
        [Shown("part", canvas.counted, [layer])],
        sides(canvas, a != b, 1)[0],
    )  # fmt: skip
    if B.execution is None:
        play = plan_play(B.run.report, B.run.plan.views, B.run.motion, scene.T_base_object)
    else:
        recorded = read_execution(B.run, B.folder.name)
        play = execution_play(B.run, recorded, B.execution, cell)
    views = [*_with_fates(play.views, found), *_of_a_alone(A, found, cell)]
    figures = [(each.name, f"{shown(each.a)} → {shown(each.b)}") for each in found.numbers]
    settings = [(each.key, f"{shown(each.a)} → {shown(each.b)}") for each in found.settings]
    return html_of(stage, _of_run(replace(play, views=views, rows=[*figures, *settings], inside=None), B))


def _with_fates(views: Sequence[View], found: Difference) -> list[View]:
    """B's views, each with the one of A that it was."""
    kept = {str(b): (f"the same, {a} there", MEASURED) for a, b in found.views.kept}
    moved = {
        str(each.b): (f"{each.a} there, moved by {each.distance_mm:.1f} mm and {each.angle_deg:.1f} deg", GREEN)
        for each in found.views.moved
    }
    fates = {**kept, **moved}
    told = []
    for view in views:
        fate, colour = fates.get(view.number, ("new", BLUE))
        told.append(replace(view, rows=[*view.rows, ("in A", fate)], colour=GREY if colour == MEASURED else colour))
    return told


def _of_a_alone(A: Side, found: Difference, cell: Cell) -> list[View]:
    """Views that only A has, relative to the part where it stands in B's cell."""
    middle = {int(n): poses[len(poses) // 2] for n, poses in zip(A.number, A.poses, strict=True)}
    return [
        View(f"A{n}", cell.T_base_object @ middle[n], None, [("view", f"{n} of A, not in B")], colour=VERMILION)
        for n in found.views.lost
    ]


def _of_run(play: Play, B: Side) -> Play:
    """Commands with the folder that they are about: this page lies in none."""
    folder = shlex.quote(str(B.run.folder))

    def named(commands: Sequence[str]) -> list[str]:
        return [each.replace("EXECUTION", B.folder.name).replace("RUN", folder) for each in commands]

    views = [replace(view, commands=named(view.commands)) for view in play.views]
    return replace(play, views=views, next=named(play.next))
