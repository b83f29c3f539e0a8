"""Replay by ray casting (`cell.view.cell_picture`): a picture of the tour, or numbered frames; needs no OpenGL."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from cell.errors import FileError
from cell.view import overlays, rays
from cell.view.appearance import MAX_FACES
from cell.view.cell_picture import best_view, draw_cell, tour_camera
from cell.view.palette import GREEN, VERMILION
from cell.view.pieces import CellGeometry, Piece
from cell.view.playback import Playback
from cell.view.replay_model import point_marks
from cell.view.replay_options import ReplayOptions
from cell.view.tightest_moment import TightestMoment, closeup_camera
from planner.geometry.decimation import decimate
from planner.geometry.mesh import TriangleMesh
from planner.ports import Progress
from planner.values import Floats

_CANDIDATE = 0.05  # m; length of the stroke of a candidate viewpoint, from its source along the viewing axis
_CAPTION = 20  # height of a caption [pixels]


@dataclass(frozen=True, slots=True, eq=False)
class PictureInputs:
    """Contents of a picture.

    Attributes:
        playback: model, timeline and marks.
        cell: robot and surroundings.
        part: object frame.
        clouds: (P, 3) points of each scan, object frame [m].
    """

    playback: Playback
    cell: CellGeometry
    part: TriangleMesh
    clouds: Sequence[Floats]


def write_picture(inputs: PictureInputs, path: Path, options: ReplayOptions, t: float | None = None) -> None:
    """Draw one moment, with the tightest pair if the arm is there; at another pose its points would be in mid-air.

    Args:
        inputs: contents of the picture.
        path: PNG file to write.
        options: size, camera and hidden pieces.
        t: the moment [s]; None takes the view at which arm and part are side by side.

    Raises:
        UsageError: if a name is unknown.
        FileError: if the file cannot be written.
    """
    playback, timeline = inputs.playback, inputs.playback.timeline
    best = best_view(inputs.cell, inputs.part, playback.T_base_scanner)
    moment = t if t is not None else timeline.stops[best].begin if best >= 0 else 0.0
    tightest = playback.tightest if playback.tightest is not None and moment == playback.tightest.time else None
    camera: rays.Camera | tuple[float, float] | None = options.camera_deg
    if tightest is not None and camera is None:
        playback.pose(moment)
        camera = closeup_camera(playback.replay_model.model, playback.data, tightest, options.size)
    points = _points(inputs, moment, len(inputs.clouds), None)
    rays.save_png(_draw(inputs, moment, options.size, camera, points, tightest, options.hide)[0], path)


def write_frames(inputs: PictureInputs, folder: Path, options: ReplayOptions, start: float, progress: Progress) -> int:
    """Draw the playback as `frame_00001.png`, ... into a folder; the last frame shows its end.

    Args:
        inputs: contents of the pictures.
        folder: is created; must hold no frames.
        options: size, frames per second of film and rate of the replay.
        start: first moment [s].
        progress: is called with the number of frames drawn and their total.

    Returns:
        The number of frames.

    Raises:
        FileError: if the folder holds frames or cannot be written.
    """
    require_empty(folder)
    if len(inputs.part.faces) > MAX_FACES:
        inputs = replace(inputs, part=decimate(inputs.part, MAX_FACES))
    playback, timeline = inputs.playback, inputs.playback.timeline
    poses = [timeline.at(t) for t in (0.0, *(stop.begin for stop in timeline.stops), timeline.duration)]
    sources = np.concatenate([playback.path, playback.T_base_candidate[:, :3, 3]])
    camera = tour_camera(inputs.cell, inputs.part, poses, sources, options.size)
    times = frame_times(timeline.duration, start, options.fps, options.rate)
    for number, t in enumerate(times, start=1):
        playback.pose(t)
        violations, stop = playback.violations(), timeline.stop_at(t)
        newest = None if stop is None else timeline.stops.index(stop)
        points = _points(inputs, t, timeline.reached(t), newest)
        tightest = playback.tightest if playback.tightest is not None and playback.tightest.is_shown_at(t) else None
        image, depth = _draw(inputs, t, options.size, camera, points, tightest)
        positions = np.array([violation.position for violation in violations]).reshape(-1, 3)
        rays.draw_dots(image, depth.camera.project(positions)[:, :2], VERMILION, 6.0)
        ImageDraw.Draw(image).text(
            (8, 4), playback.caption(t, violations), "#111111", rays.font(_CAPTION), stroke_width=2, stroke_fill="white"
        )
        rays.save_png(image, folder / f"frame_{number:05d}.png")
        progress(number, len(times))
    return len(times)


def frame_times(duration: float, start: float, fps: float, speed: float) -> list[float]:
    """Return the playback time [s] of each frame; the last frame shows the end. Arguments as in `write_frames`."""
    step = speed / fps
    count = int(np.ceil(max(duration - start, 0.0) / step - 1e-9)) + 1
    return [min(start + n * step, duration) for n in range(count)]


def require_empty(folder: Path) -> None:
    """Require a folder without frames.

    Raises:
        FileError: if it holds frames.
    """
    if any(folder.glob("frame_*.png")):
        raise FileError(f"{folder} holds frames already; a shorter film would not replace all; choose another folder")


def _draw(
    inputs: PictureInputs,
    t: float,
    size: tuple[int, int],
    camera: rays.Camera | tuple[float, float] | None,
    points: Sequence[Piece],
    tightest: TightestMoment | None,
    hide: Collection[str] = (),
) -> tuple[Image.Image, rays.DepthImage]:
    """Return the picture of a moment [s] and the depth seen by its camera."""
    playback, candidates = inputs.playback, inputs.playback.T_base_candidate
    strokes = np.stack([candidates[:, :3, 3], candidates[:, :3, 3] + _CANDIDATE * candidates[:, :3, 2]], axis=1)
    image, depth = draw_cell(
        inputs.cell, inputs.part, playback.timeline.at(t), views=playback.T_base_scanner, path=playback.path, size=size,
        camera=camera, hide=hide, extra=points,
    )  # fmt: skip
    reachable = np.zeros(len(strokes), dtype=np.bool_) if playback.reachable is None else playback.reachable
    rays.draw_lines(image, depth, strokes[reachable], GREEN, width=2)
    rays.draw_lines(image, depth, strokes[~reachable], VERMILION, width=2)
    if tightest is not None:
        rays.draw_lines(image, depth, tightest.points[None], VERMILION, width=4, hidden=VERMILION)
        at = depth.camera.project(tightest.points)[:, :2]
        rays.draw_dots(image, at, VERMILION)
        rays.draw_labels(image, at.mean(axis=0)[None] + [0.0, 18.0], [tightest.sentence])
    return image, depth


def _points(inputs: PictureInputs, t: float, n_scans: int, newest: int | None) -> list[Piece]:
    """Return marks at the points of the first `n_scans` scans at a moment [s]; the newest scan is brighter."""
    T = inputs.cell.table_motion(inputs.playback.timeline.at(t)) @ inputs.cell.T_base_object
    pieces = []
    for scan, points in enumerate(inputs.clouds[:n_scans]):
        if len(points):
            mesh = point_marks(points, 0.010 * inputs.part.diagonal / 2)
            colour = np.array((overlays.NEWEST if scan == newest else overlays.EARLIER)[:3])
            pieces.append(Piece("points", 0, mesh.vertices @ T[:3, :3].T + T[:3, 3], np.array(mesh.faces), colour))
    return pieces
