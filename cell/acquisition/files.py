"""`--acquire files:DIR`: one file of points a view, taken when it is there."""

import hashlib
import re
import time
from collections.abc import Callable
from pathlib import Path

from cell.acquisition.sources import Acquired, Context, Frame, View
from cell.errors import FileError, UsageError
from cell.metrology import point_files
from cell.part.workpiece import UNITS

_LOOK_S = 0.2  # between two looks at a folder that is waited for


class Files:
    """Points of a folder: of view 3 the one file whose name ends in the number 3 (`3.ply`, `scan_0003.xyz`).

    Attributes:
        source: the folder, frame and unit.
    """

    def __init__(
        self,
        argument: str,
        context: Context,
        *,
        now: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Look whether the folder is there and frame and units are said.

        Raises:
            UsageError: if they are not.
        """
        self._folder = Path(argument).expanduser()
        if not argument or not self._folder.is_dir():
            raise UsageError(
                f"--acquire files:{argument} is no folder; make it, and put one file of points a view in it"
            )
        self._frame, self._unit, self._metres = frame_and_units(context)
        self._wait, self._say, self._now, self._sleep = (
            float(context.options["acquire_wait_s"]),
            context.say,
            now,
            sleep,
        )
        self.source = f"files of {self._folder.absolute()} ({self._frame} frame, {self._unit})"

    def take(self, view: View) -> Acquired | None:
        """The points of a view's file, as soon as it is whole; None where it does not come."""
        until, told, size = self._now() + self._wait, False, -1
        why = f"{self._folder} has no file of view {view.stop}"
        while True:
            path = file_of_view(self._folder, view.stop)
            if path is not None:
                # A file that is still being written grows: with time to wait it has to keep its size for one look.
                before, size = size, path.stat().st_size
                if self._wait == 0 or before == size:
                    try:
                        points = point_files.read(path) * self._metres
                    except FileError as error:
                        why = str(error)
                    else:
                        digest = hashlib.sha256(path.read_bytes()).hexdigest()
                        return Acquired(points, self._frame, told={"points_of": str(path), "sha256": digest})
            if self._now() >= until:
                self._say(f"view {view.stop} is missing: {why}; cell scan --resume takes it")
                return None
            if not told:
                self._say(f"the arm stands at view {view.stop}; its points are waited for in {self._folder}")
                told = True
            self._sleep(_LOOK_S)


def file_of_view(folder: Path, stop: int) -> Path | None:
    """The file of a folder whose name ends in the number of a view; None where it is not there.

    Raises:
        FileError: if there are several.
    """
    found = [
        path
        for path in sorted(folder.iterdir())
        if path.suffix.lower() in point_files.SUFFIXES
        and (number := re.search(r"(\d+)$", path.stem)) is not None
        and int(number[1]) == stop
    ]
    if len(found) > 1:
        raise FileError(f"{found[0]} and {found[1].name} are both of view {stop}; leave one of them")
    return found[0] if found else None


def frame_and_units(context: Context) -> tuple[Frame, str, float]:
    """Frame and unit of the points, and metres in one unit.

    Raises:
        UsageError: if they are not said.
    """
    frame, unit = context.options.get("points_frame"), context.options.get("points_units")
    if frame is None or unit is None:
        raise UsageError(
            "points that are not simulated have a frame and a unit, which are never guessed; give --points-frame "
            "scanner, flange or base, and --points-units mm, cm, m, um or in"
        )
    return frame, str(unit), UNITS[str(unit)]
