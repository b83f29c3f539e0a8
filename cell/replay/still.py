"""Replay as one still, by rays (`cell.view.cell_picture`): the whole tour with every view, the arm at one moment."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cell.replay import marks
from cell.replay.closest import Closest, close_camera
from cell.replay.model import specks
from cell.replay.show import Show
from cell.view import rays
from cell.view.cell_picture import best_view, draw_cell
from cell.view.palette import GREEN, VERMILION
from cell.view.pieces import Cell, Piece
from planner.surface.mesh import TriangleMesh
from planner.values import Floats

_CANDIDATE = 0.05  # m; a candidate viewpoint is a stroke of this length, from its source along its view


@dataclass(frozen=True, slots=True, eq=False)
class Still:
    """What a still is drawn of.

    Attributes:
        show: what is played.
        cell: robot and surroundings.
        part: object frame.
        clouds: (P, 3) points of each scan, object frame [m].
    """

    show: Show
    cell: Cell
    part: TriangleMesh
    clouds: Sequence[Floats]


def write_picture(
    still: Still,
    path: Path,
    size: tuple[int, int],
    t: float | None = None,
    camera_deg: tuple[float, float] | None = None,
    hide: Collection[str] = (),
) -> None:
    """Draw it; the tightest pair where the arm stands there, elsewhere it would hang in the air.

    Args:
        still: what is drawn.
        path: PNG file to write.
        size: (width, height) [pixels].
        t: the moment [s]; None takes a stop at which arm and part stand side by side.
        camera_deg: azimuth and elevation of the camera as seen from the part; None chooses.
        hide: names of what is left out.

    Raises:
        UsageError: if what is to be left out is not there.
        FileError: if the file cannot be written.
    """
    show, timeline = still.show, still.show.timeline
    best = best_view(still.cell, still.part, show.T_base_scanner)
    moment = t if t is not None else timeline.stops[best].begin if best >= 0 else 0.0
    closest = show.closest if show.closest is not None and moment == show.closest.time else None
    show.pose(moment)
    camera = camera_deg if closest is None or camera_deg is not None else _near(show, closest, size)
    candidates = show.T_base_candidate
    strokes = np.stack([candidates[:, :3, 3], candidates[:, :3, 3] + _CANDIDATE * candidates[:, :3, 2]], axis=1)
    drawn, seen = draw_cell(
        still.cell, still.part, timeline.at(moment), views=show.T_base_scanner, way=show.path, size=size,
        camera=camera, hide=hide, extra=_points(still),
    )  # fmt: skip
    for reachable, colour in ((True, GREEN), (False, VERMILION)):
        known = np.zeros(len(strokes), dtype=np.bool_) if show.reachable is None else show.reachable
        rays.lines(drawn, seen, strokes[known == reachable], colour, width=2)
    if closest is not None:
        rays.lines(drawn, seen, closest.points[None], VERMILION, width=4, hidden=VERMILION)
        at = seen.camera.project(closest.points)[:, :2]
        rays.dots(drawn, at, VERMILION)
        rays.labels(drawn, at.mean(axis=0)[None] + [0.0, 18.0], [closest.sentence])
    rays.save(drawn, path)


def _near(show: Show, closest: Closest, size: tuple[int, int]) -> rays.Camera:
    """The camera that looks at the tightest pair from near by."""
    seen = close_camera(show.theatre.model, show.data, closest)
    forward = rays.direction(seen.azimuth, seen.elevation)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    half = np.tan(np.radians(show.theatre.model.vis.global_.fovy) / 2) * np.array([size[0] / size[1], 1.0])
    eye = np.array(seen.lookat) - seen.distance * forward
    return rays.Camera(eye, forward, right / np.linalg.norm(right), half, size, False)


def _points(still: Still) -> list[Piece]:
    """The points of an execution as specks."""
    T, radius, colour = still.cell.T_base_object, still.part.diagonal / 2, np.array(marks.EARLIER[:3])
    found = [specks(points, 0.010 * radius) for points in still.clouds if len(points)]
    return [Piece("points", 0, mesh.vertices @ T[:3, :3].T + T[:3, 3], np.array(mesh.faces), colour) for mesh in found]
