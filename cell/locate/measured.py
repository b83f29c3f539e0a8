"""Measured points for `cell locate`: files of points, scans of an execution, named points. Metres."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cell.acquisition import SIMULATED, point_files
from cell.acquisition.files import file_of_view
from cell.acquisition.sources import Frame
from cell.errors import FileError, UsageError
from cell.locate.options import Locating
from cell.part.workpiece import UNITS
from cell.reconstruction.cloud import ScanCloud
from cell.runs.run import Run, read_execution
from planner.values import Floats


@dataclass(frozen=True, slots=True, eq=False)
class Clouds:
    """Points of views.

    Attributes:
        source: where they come from, in words.
        views: their numbers.
        clouds: one a view, object frame as if the part stood where it was planned.
        simulated: whether no scanner measured them.
    """

    source: str
    views: tuple[int, ...]
    clouds: Sequence[ScanCloud]
    simulated: bool = False


def of_files(run: Run, wanted: Locating) -> Clouds:
    """Points of a file, or of a folder's files.

    Raises:
        UsageError: if a view is not there, or several are named for one file.
        FileError: if a file is missing or cannot be read.
    """
    assert wanted.points is not None
    assert wanted.points_frame is not None
    path, views = Path(wanted.points).expanduser(), wanted.view or (1,)
    if not path.is_dir() and len(views) > 1:
        raise UsageError(f"{path} is one file, and {len(views)} views are named; give one view, or a folder of files")
    clouds = []
    for view in views:
        file = file_of_view(path, view) if path.is_dir() else path
        if file is None:
            raise FileError(f"{path} has no file of view {view}; name it by that number, such as {view:04d}.ply")
        points = _moved(_T_object(run, wanted.points_frame, view), point_files.read(file) * _metres(wanted))
        clouds.append(ScanCloud(points, run.plan.views[view - 1].T_object_scanner[:3, 3]))
    return Clouds(f"{path} ({wanted.points_frame} frame, {wanted.points_units})", views, clouds)


def of_execution(run: Run, wanted: Locating) -> Clouds:
    """Scans of an execution.

    Raises:
        FileError: if there is no execution, or it has no scan of a view.
    """
    recorded = read_execution(run, wanted.execution or "latest")
    known = {scan.stop: scan for scan in recorded.scans}
    views = wanted.view or tuple(sorted(known))[:1]
    missing = [view for view in views if view not in known]
    if missing or not views:
        there = ", ".join(map(str, sorted(known))) or "none"
        raise FileError(f"{recorded.folder} has no scan of view {(*missing, 1)[0]}; it has {there}")
    clouds = [ScanCloud(known[view].points, known[view].T_reported[:3, 3]) for view in views]
    sources = [known[view].source for view in views]
    simulated = SIMULATED in sources
    return Clouds(f"execution {recorded.folder.name} ({'; '.join(dict.fromkeys(sources))})", views, clouds, simulated)


def of_pairs(run: Run, wanted: Locating, file: str) -> tuple[tuple[str, ...], Floats, Floats]:
    """Named points: their names, (N, 3) where they are on the part (object frame), (N, 3) measured (base).

    Raises:
        UsageError: if a view is not there, or several are named.
        FileError: if the file cannot be read, a line is none of a point, or a name stands there twice.
    """
    assert wanted.points_frame is not None
    path, views = Path(file).expanduser(), wanted.view or (1,)
    if len(views) > 1:
        raise UsageError(f"named points are measured from one view, and {len(views)} are named; give one of them")
    try:
        lines = path.read_text(encoding="utf-8-sig").replace(",", " ").replace(";", " ").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(f"{path} cannot be read: {getattr(error, 'strerror', None) or error}") from error
    names, rows = [], []
    for number, words in ((n, line.split()) for n, line in enumerate(lines, 1)):
        if not words or words[0].startswith("#"):
            continue
        try:
            numbers = [float(word) for word in words[1:]]
        except ValueError:
            numbers = []
        if len(numbers) != 6 or not np.isfinite(numbers).all():
            raise FileError(
                f"{path}, line {number}: it must be a name and six numbers: x y z on the part, x y z measured"
            )
        if words[0] in names:
            raise FileError(f"{path}, line {number}: the point '{words[0]}' stands there twice; name each once")
        names.append(words[0])
        rows.append(numbers)
    table = np.array(rows, dtype=np.float64).reshape(-1, 6) * _metres(wanted)
    T_base = run.T_base_object @ _T_object(run, wanted.points_frame, views[0])
    return tuple(names), table[:, :3], _moved(T_base, table[:, 3:])


def _T_object(run: Run, frame: Frame, number: int) -> Floats:
    """(4, 4) from a frame to the object's where the part was planned [m]; scanner and flange at a view of the plan.

    Raises:
        UsageError: if there is no such view.
    """
    if not 1 <= number <= len(run.plan.views):
        raise UsageError(f"there is no view {number}; the plan has the views 1 to {len(run.plan.views)}")
    view = run.plan.views[number - 1]
    T_object_base = np.linalg.inv(run.T_base_object if view.T_base_object is None else view.T_base_object)
    T = {"scanner": view.T_object_scanner, "flange": T_object_base @ view.T_base_flange, "base": T_object_base}[frame]
    return np.asarray(T, dtype=np.float64)


def _metres(wanted: Locating) -> float:
    return UNITS[str(wanted.points_units)]


def _moved(T: Floats, points: Floats) -> Floats:
    return np.asarray(points @ T[:3, :3].T + T[:3, 3], dtype=np.float64)
