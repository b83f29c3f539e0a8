"""Replay as numbered PNG frames, drawn off-screen, no display needed."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cell.errors import FileError
from cell.replay.offscreen import Image, OffScreen
from cell.replay.show import Show, show_what_is_seen
from planner.ports import Progress


def frame_times(duration: float, start: float, fps: float, speed: float, every: int) -> list[tuple[int, float]]:
    """Number (from 1) and time of the show [s] of each frame; the last one shows the end.

    Args:
        duration: of the show [s].
        start: first moment [s].
        fps: frames for each second of film.
        speed: seconds of the show for each second of film.
        every: of so many frames one is drawn; numbers stay those of the full film.
    """
    step = speed / fps
    count = int(np.ceil(max(duration - start, 0.0) / step - 1e-9)) + 1
    return [(n + 1, min(start + n * step, duration)) for n in range(count) if n % every == 0 or n == count - 1]


def require_empty(folder: Path) -> None:
    """Refuse a folder that holds frames.

    Raises:
        FileError: if it does.
    """
    if any(folder.glob("frame_*.png")):
        raise FileError(f"{folder} holds frames already, and a shorter film would leave some; choose another folder")


def write_frames(
    show: Show,
    folder: Path,
    size: tuple[int, int],
    *,
    start: float = 0.0,
    fps: float = 25.0,
    speed: float = 1.0,
    every: int = 1,
    progress: Progress | None = None,
) -> int:
    """Draw the show as `frame_00001.png`, ... into a folder.

    Args:
        show: what is played.
        folder: is made; must hold no frames yet.
        size: (width, height) [pixels].
        start: first moment [s].
        fps: frames for each second of film.
        speed: seconds of the show for each second of film.
        every: of so many frames one is drawn.
        progress: told how far it is.

    Returns:
        The number of frames.

    Raises:
        UsageError: if neither EGL nor OSMesa is there.
        FileError: if the folder holds frames or cannot be written.
    """
    require_empty(folder)
    with OffScreen(show.theatre.model, size) as screen:
        show_what_is_seen(screen.option)
        camera = show.camera(size[0] / size[1])
        frames = frame_times(show.timeline.duration, start, fps, speed, every)
        for done, (number, t) in enumerate(frames, start=1):
            show.pose(t)
            touching = show.touches()

            def decorate(scene: object, t: float = t, touching: object = touching) -> None:
                show.draw_still(scene)
                show.draw_moment(scene, t, touching)  # type: ignore[arg-type] # bound above

            _save(
                screen.picture(show.data, camera, decorate, show.caption(t, touching)),
                folder / f"frame_{number:05d}.png",
            )
            if progress is not None:
                progress(done, len(frames))
    return len(frames)


def _save(picture: Image, path: Path) -> None:
    from PIL import Image as Picture

    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        Picture.fromarray(picture).save(path, optimize=False, compress_level=6)
    except OSError as error:
        raise FileError(f"{path} cannot be written: {(error.strerror or str(error)).lower()}") from error
