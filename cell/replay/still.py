"""Replay by rays (`cell.view.cell_picture`): a still of the whole tour, or numbered frames; no OpenGL, no display."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from cell.errors import FileError
from cell.replay import overlays
from cell.replay.appearance import VIEW_FACES
from cell.replay.model import specks
from cell.replay.show import Show
from cell.replay.tightest_moment import Closest, near_camera
from cell.view import rays
from cell.view.cell_picture import best_view, draw_cell, tour_camera
from cell.view.palette import GREEN, VERMILION
from cell.view.pieces import Cell, Piece
from planner.geometry.decimation import decimate
from planner.geometry.mesh import TriangleMesh
from planner.ports import Progress
from planner.values import Floats

_CANDIDATE = 0.05  # m; a candidate viewpoint is a stroke of this length, from its source along its view
_CAPTION = 20  # height of a caption [pixels]


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
    camera: rays.Camera | tuple[float, float] | None = camera_deg
    if closest is not None and camera_deg is None:
        show.pose(moment)
        camera = near_camera(show.theatre.model, show.data, closest, size)
    points = _points(still, moment, len(still.clouds), None)
    rays.save(_drawn(still, moment, size, camera, points, closest, hide)[0], path)


def write_frames(
    still: Still,
    folder: Path,
    size: tuple[int, int],
    *,
    start: float = 0.0,
    fps: float = 25.0,
    speed: float = 1.0,
    progress: Progress | None = None,
) -> int:
    """Draw the show as `frame_00001.png`, ... into a folder; the last frame shows its end.

    Args:
        still: what is drawn.
        folder: is made; must hold no frames yet.
        size: (width, height) [pixels].
        start: first moment [s].
        fps: frames for each second of film.
        speed: seconds of the show for each second of film.
        progress: told how far it is.

    Returns:
        The number of frames.

    Raises:
        FileError: if the folder holds frames or cannot be written.
    """
    require_empty(folder)
    if len(still.part.faces) > VIEW_FACES:
        still = replace(still, part=decimate(still.part, VIEW_FACES))
    show, timeline = still.show, still.show.timeline
    poses = [timeline.at(t) for t in (0.0, *(stop.begin for stop in timeline.stops), timeline.duration)]
    seen_by = [show.path, show.T_base_candidate[:, :3, 3]]
    camera = tour_camera(still.cell, still.part, poses, np.concatenate(seen_by), size)
    times = frame_times(timeline.duration, start, fps, speed)
    for number, t in enumerate(times, start=1):
        show.pose(t)
        touching, stop = show.touches(), timeline.stop_at(t)
        fresh = None if stop is None else timeline.stops.index(stop)
        points = _points(still, t, timeline.reached(t), fresh)
        closest = show.closest if show.closest is not None and show.closest.shown_at(t) else None
        drawn, seen = _drawn(still, t, size, camera, points, closest)
        places = np.array([touch.position for touch in touching]).reshape(-1, 3)
        rays.dots(drawn, seen.camera.project(places)[:, :2], VERMILION, 6.0)
        ImageDraw.Draw(drawn).text(
            (8, 4), show.caption(t, touching), "#111111", rays.font(_CAPTION), stroke_width=2, stroke_fill="white"
        )
        rays.save(drawn, folder / f"frame_{number:05d}.png")
        if progress is not None:
            progress(number, len(times))
    return len(times)


def frame_times(duration: float, start: float, fps: float, speed: float) -> list[float]:
    """Time of the show [s] of each frame; the last one shows the end.

    Args:
        duration: of the show [s].
        start: first moment [s].
        fps: frames for each second of film.
        speed: seconds of the show for each second of film.
    """
    step = speed / fps
    count = int(np.ceil(max(duration - start, 0.0) / step - 1e-9)) + 1
    return [min(start + n * step, duration) for n in range(count)]


def require_empty(folder: Path) -> None:
    """Refuse a folder that holds frames.

    Raises:
        FileError: if it does.
    """
    if any(folder.glob("frame_*.png")):
        raise FileError(f"{folder} holds frames already, and a shorter film would leave some; choose another folder")


def _drawn(
    still: Still,
    t: float,
    size: tuple[int, int],
    camera: rays.Camera | tuple[float, float] | None,
    points: Sequence[Piece],
    closest: Closest | None,
    hide: Collection[str] = (),
) -> tuple[Image.Image, rays.Seen]:
    """The picture of a moment [s], and what its camera saw."""
    show, candidates = still.show, still.show.T_base_candidate
    strokes = np.stack([candidates[:, :3, 3], candidates[:, :3, 3] + _CANDIDATE * candidates[:, :3, 2]], axis=1)
    drawn, seen = draw_cell(
        still.cell, still.part, show.timeline.at(t), views=show.T_base_scanner, way=show.path, size=size,
        camera=camera, hide=hide, extra=points,
    )  # fmt: skip
    for reachable, colour in ((True, GREEN), (False, VERMILION)):
        known = np.zeros(len(strokes), dtype=np.bool_) if show.reachable is None else show.reachable
        rays.lines(drawn, seen, strokes[known == reachable], colour, width=2)
    if closest is not None:
        rays.lines(drawn, seen, closest.points[None], VERMILION, width=4, hidden=VERMILION)
        at = seen.camera.project(closest.points)[:, :2]
        rays.dots(drawn, at, VERMILION)
        rays.labels(drawn, at.mean(axis=0)[None] + [0.0, 18.0], [closest.sentence])
    return drawn, seen


def _points(still: Still, t: float, taken: int, fresh: int | None) -> list[Piece]:
    """The points of the scans taken until a moment [s] as specks, those of the newest brighter."""
    T, radius = still.cell.turn(still.show.timeline.at(t)) @ still.cell.T_base_object, still.part.diagonal / 2
    found = []
    for scan, points in enumerate(still.clouds[:taken]):
        if len(points):
            mesh = specks(points, 0.010 * radius)
            colour = np.array((overlays.FRESH if scan == fresh else overlays.EARLIER)[:3])
            found.append(Piece("points", 0, mesh.vertices @ T[:3, :3].T + T[:3, 3], np.array(mesh.faces), colour))
    return found
