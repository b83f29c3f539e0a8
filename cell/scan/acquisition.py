"""Sources of points: plug-ins of the entry-point group `cell.acquisition`, imported only when chosen.

A plug-in is a class that is called with the text after its name in `--acquire NAME:ARGUMENT` and a `Context`, and
implements `Acquisition`. Another distribution adds one with

    [project.entry-points."cell.acquisition"]
    acme = "acme_scanner.points:Acme"       # then --acquire acme:192.168.0.7

docs/internals/plug_ins.md shows how to write one. `Files` and `Command` are two of them; `cell.scan.genicam` reads
cameras, `cell.scan.simulated` is the virtual scanner.
"""

import hashlib
import json
import logging
import os
import shlex
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated, Any, Literal, Protocol, get_args

import numpy as np
from numpy.typing import NDArray

from cell.errors import FileError, UsageError
from cell.files import file_errors
from cell.metrology import point_files
from cell.part.workpiece import UNITS
from cell.runs.run import file_bytes
from planner.ports import ARM_AXES
from planner.values import Floats, Ints, Value

if TYPE_CHECKING:
    from pydantic import JsonValue

    from cell.runs.cell import RunCell

log = logging.getLogger(__name__)

GROUP = "cell.acquisition"

Frame = Literal["scanner", "flange", "base", "object"]
FRAMES: tuple[Frame, ...] = get_args(Frame)

_POLL_S = 0.2  # between two checks of a folder
_TRIES = 3  # calls of a command
_MAX_OUTPUT = 65536  # bytes of a command's output, the last ones
_SHOWN_OUTPUT = 200  # characters of it in a message
_FAR = 10.0  # times the largest range: farther points are no outliers


@dataclass(frozen=True, slots=True, eq=False)
class View(Value):
    """Reported configuration and poses at a view; for a sweep all its poses.

    Attributes:
        stop: number of the view, from 1 in visiting order.
        candidate: row of viewpoints.npz.
        q: (K, axes) joint angles [rad], KUKA signs, in driving order as all poses.
        T_base_flange: (K, 4, 4) [m].
        T_object_scanner: (K, 4, 4) [m].
        T_base_object: (4, 4) the placement [m].
        order: (K,) indices of the poses in the order of the plan.
    """

    stop: int
    candidate: int
    q: Annotated[Floats, "K axes"]
    T_base_flange: Annotated[Floats, "K 4 4"]
    T_object_scanner: Annotated[Floats, "K 4 4"]
    T_base_object: Annotated[Floats, "4 4"]
    order: Annotated[Ints, "K"]

    @property
    def middle(self) -> int:
        """Index of the pose that represents a sweep; 0 for a view at rest."""
        return int(self.order[len(self.order) // 2])

    def T_object(self, frame: Frame) -> Floats:
        """Return the pose (4, 4) of a frame in the object frame [m]; for a sweep at its middle pose."""
        to_object = np.asarray(np.linalg.inv(self.T_base_object), dtype=np.float64)
        frames: dict[Frame, Floats] = {
            "scanner": self.T_object_scanner[self.middle],
            "flange": to_object @ self.T_base_flange[self.middle],
            "base": to_object,
            "object": np.eye(4),
        }
        return frames[frame]


@dataclass(frozen=True, slots=True, eq=False)
class Acquired:
    """Points of one view.

    Attributes:
        points: (P, 3) [m].
        frame: of the points.
        arrays: further arrays for the scan's file by name, such as the true poses of a simulation.
        details: JSON values for the event of the scan.
    """

    points: Floats
    frame: Frame
    arrays: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    details: "Mapping[str, JsonValue]" = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Context:
    """Values that a plug-in may use.

    Attributes:
        cell: part, occluders and scanner.
        options: of `cell scan`, as its manifest stores them.
        seed: of the execution.
        folder: of the execution; its subfolder `raw` may store received data.
        notify: receives one sentence about a wait or a failure.
    """

    cell: "RunCell"
    options: Mapping[str, Any]
    seed: int
    folder: Path
    notify: Callable[[str], None]


class Acquisition(Protocol):
    """Source of the points of a view, called while the arm is at rest there.

    Attributes:
        source: name of the source in reports: "simulated", or "files of /data/scans".
    """

    source: str

    def take(self, view: View) -> Acquired | None:
        """Return the points; None if there are none: the view is then missing, and a later resume scans it."""


class AcquisitionClass(Protocol):
    """Object that an entry point of the group names."""

    def __call__(self, argument: str, context: Context) -> Acquisition:
        """Make a source; raise `cell.errors.UsageError` if the argument is invalid."""


def names() -> tuple[str, ...]:
    """Return the sorted names of all installed plug-ins without importing them."""
    return tuple(sorted({point.name for point in entry_points(group=GROUP)}))


def load(text: str) -> tuple[AcquisitionClass, str]:
    """Return the class that `--acquire` names, and its argument.

    Args:
        text: "simulated", "files:DIR", "command:CMD", "genicam:DEVICE" or "NAME:ARGUMENT".

    Raises:
        UsageError: if no installed distribution has the name, two have it, or the class cannot be imported.
    """
    name, _, argument = text.partition(":")
    points: list[EntryPoint] = [point for point in entry_points(group=GROUP) if point.name == name]
    if not points:
        hint = "" if names() else " (this installation of scan-cell is older than the sources: install it again)"
        raise UsageError(
            f"--acquire {text} is not a source of points; installed are: {', '.join(names()) or 'none'}{hint}"
        )
    if len({point.value for point in points}) > 1:
        values = " and ".join(point.value for point in points)
        raise UsageError(f"--acquire {name} is defined by {values}; uninstall all but one")
    try:
        kind: AcquisitionClass = points[0].load()
    except Exception as error:  # a foreign plug-in may fail in any way at import
        raise UsageError(
            f"--acquire {name} cannot be imported from {points[0].value}: {type(error).__name__}: {error}; repair or "
            "uninstall that distribution"
        ) from error
    return kind, argument


def frame_and_unit(context: Context) -> tuple[Frame, str]:
    """Return frame and unit of the points from the options.

    Raises:
        UsageError: if one of them is missing.
    """
    frame, unit = context.options.get("points_frame"), context.options.get("points_units")
    if frame is None or unit is None:
        raise UsageError(
            "frame and unit of points that are not simulated are never guessed; give --points-frame scanner, flange or "
            "base, and --points-units mm, cm, m, um or in"
        )
    return frame, str(unit)


class Files:
    """`--acquire files:DIR`: for view 3 the one file whose name ends in the number 3 (`3.ply`, `scan_0003.xyz`).

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
        """Check folder, frame and unit; raise UsageError if one is missing."""
        self._folder = Path(argument).expanduser()
        if not argument or not self._folder.is_dir():
            raise UsageError(
                f"--acquire files:{argument} is not a folder; create it, and put one file of points per view in it"
            )
        self._frame, self._unit = frame_and_unit(context)
        self._wait, self._notify = float(context.options["acquire_wait_s"]), context.notify
        self._now, self._sleep = now, sleep
        there = [path for path in self._folder.iterdir() if path.is_file()] if self._wait else []
        self._earlier = {path: _state_of(path) for path in there}
        self.source = f"files of {self._folder.absolute()} ({self._frame} frame, {self._unit})"

    def take(self, view: View) -> Acquired | None:
        """Return the points of a view's file once it is complete; None if it does not appear in time.

        With time to wait, a file that was there before the execution is none: it may be of an earlier one.
        """
        until, is_notified, size = self._now() + self._wait, False, -1
        while True:
            try:
                path = point_files.file_of_view(self._folder, view.stop)
                problem = f"{path} is not complete"
                if path is None:
                    problem = point_files.missing_file(self._folder, view.stop)
                elif self._earlier.get(path) == _state_of(path):
                    problem = f"{path} is older than this execution; remove it, or omit --acquire-wait-s to use it"
                    path = None
                # A file that is still being written grows: with time to wait, its size must be equal in two checks.
                before, size = size, -1 if path is None else path.stat().st_size
            except OSError as error:  # a network folder can be away for a moment, and a file can be replaced
                path, problem = None, f"{self._folder} cannot be read: {error.strerror or error}"
            if path is not None and (self._wait == 0 or before == size):
                try:
                    points = point_files.read(path) * UNITS[self._unit]
                    digest = hashlib.sha256(file_bytes(path)).hexdigest()
                except FileError as error:
                    problem = str(error)
                else:
                    return Acquired(points, self._frame, details={"points_of": str(path), "sha256": digest})
            if self._now() >= until:
                self._notify(f"view {view.stop} is missing: {problem}; cell scan --resume scans it")
                return None
            if not is_notified:
                self._notify(f"the arm is at view {view.stop}; waiting for its points in {self._folder}")
                is_notified = True
            self._sleep(_POLL_S)


def _state_of(path: Path) -> tuple[int, int]:
    """Return size [bytes] and time of change [ns] of a file."""
    status = path.stat()
    return status.st_size, status.st_mtime_ns


class Command:
    """`--acquire command:CMD`: call `CMD VIEW POSE OUT` with the view's number, a JSON pose file and the PLY to write.

    Attributes:
        source: the command, frame and unit.
    """

    def __init__(self, argument: str, context: Context) -> None:
        """Split the command into words, as a shell would; raise UsageError if it, frame or unit is missing."""
        try:
            self._words = shlex.split(argument)
        except ValueError as error:
            raise UsageError(f"--acquire command:{argument} cannot be read: {error}") from error
        if not self._words:
            raise UsageError("--acquire command: names no command; give --acquire 'command:my_scanner --fast'")
        if shutil.which(self._words[0]) is None:
            cause = "is not executable" if Path(self._words[0]).is_file() else "is not found; give its path"
            raise UsageError(f"--acquire command:{argument}: the program {self._words[0]} {cause}")
        self._frame, self._unit = frame_and_unit(context)
        self._timeout, self._notify = float(context.options["acquire_timeout_s"]), context.notify
        self._raw = context.folder / "raw"
        self.source = f"command {argument} ({self._frame} frame, {self._unit})"

    def take(self, view: View) -> Acquired | None:
        """Return the points that the command wrote; None if all calls failed."""
        out, pose = self._raw / f"{view.stop:04d}.ply", self._raw / f"{view.stop:04d}.json"
        with file_errors(f"{pose} cannot be written"):
            self._raw.mkdir(exist_ok=True)
            pose.write_text(json.dumps(_pose_values(view), indent=1), encoding="utf-8")
        problem = ""
        for number in range(1, _TRIES + 1):
            out.unlink(missing_ok=True)
            ending, output = self._call(view, pose, out)
            log.info("view %d, call %d of %s: %s\n%s", view.stop, number, self._words[0], ending, output)
            last_line = output.strip().rpartition("\n")[2][-_SHOWN_OUTPUT:]
            problem = f"{self._words[0]} {ending}{f', its last line is: {last_line}' if last_line else ''}"
            if ending == "ended with code 0":
                try:
                    points = point_files.read(out) * UNITS[self._unit]
                except FileError as error:
                    problem = str(error)
                else:
                    return Acquired(points, self._frame, details={"calls": number, "said": output[-2000:]})
        self._notify(f"view {view.stop} is missing: {problem} ({_TRIES} calls); cell scan --resume scans it")
        return None

    def _call(self, view: View, pose: Path, out: Path) -> tuple[str, str]:
        """Call the command; return its ending and its output."""
        command = [*self._words, str(view.stop), str(pose), str(out)]
        try:
            # A group of its own: a time-out or Ctrl-C also ends what the command has started.
            process = subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True
            )
        except OSError as error:
            return f"cannot be started: {(error.strerror or 'the system refuses it').lower()}", ""
        output = bytearray()
        reader = threading.Thread(target=_keep_end, args=(process.stdout, output), daemon=True)
        reader.start()
        try:
            ending = f"ended with code {process.wait(self._timeout)}"
        except subprocess.TimeoutExpired:
            ending = f"took longer than {self._timeout:g} s"
        finally:
            if process.poll() is None:
                _kill_group(process)
            reader.join(_POLL_S)  # a process in the background may keep the pipe open
        return ending, bytes(output).decode("utf-8", "replace")


def _keep_end(stream: IO[bytes], output: bytearray) -> None:
    """Read a stream to its end, and keep its last `_MAX_OUTPUT` bytes."""
    with stream:
        while chunk := os.read(stream.fileno(), 65536):
            output += chunk
            del output[:-_MAX_OUTPUT]


def _kill_group(process: subprocess.Popen[bytes]) -> None:
    """End a process and all that it has started."""
    if hasattr(os, "killpg"):
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    process.kill()
    process.wait()


def require_scan(acquired: Acquired, view: View, range_mm: object) -> None:
    """Refuse points that no scanner measures: of another shape, not finite, beyond its range, outside their grid.

    Args:
        acquired: the points.
        view: where they were measured.
        range_mm: the scanner's smallest and largest range, if it has them.

    Raises:
        FileError: with the cause; the view is then not scanned.
    """
    points, problem = np.asarray(acquired.points), ""
    cure = "nothing was kept of it; correct the source of the points, then cell scan --resume takes the view"
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind not in "fiu":
        problem = f"are an array of type {points.dtype} and shape {points.shape} instead of (P, 3) numbers"
    elif not np.isfinite(points).all():
        n_bad = int((~np.isfinite(points)).any(axis=1).sum())
        problem = f"have coordinates that are not finite in {n_bad} of {len(points)} rows"
    elif isinstance(range_mm, list) and len(range_mm) == 2 and len(points):
        T = np.linalg.inv(view.T_object("scanner")) @ view.T_object(acquired.frame)
        limit = _FAR * float(range_mm[1]) / 1000.0
        distance = np.linalg.norm(points @ T[:3, :3].T + T[:3, 3], axis=1)
        if not (distance <= limit).all():
            problem = (
                f"are up to {distance.max():.3g} m away from the scanner, whose range ends at {range_mm[1]} mm (values "
                "of rays without an echo, another unit, or another frame)"
            )
    if not problem and not _has_valid_grid(acquired.arrays, len(points)):
        problem = (
            "have an invalid grid: grid_shape must be two positive integers, rows and columns, and pixel an integer "
            "in 0 ... rows * columns - 1 for each point"
        )
    if problem:
        raise FileError(f"the points of view {view.stop} {problem}; {cure}")


def _has_valid_grid(arrays: Mapping[str, NDArray[Any]], n_points: int) -> bool:
    """Return whether `pixel` and `grid_shape` of a scan are a grid; also if it has neither."""
    if not {"pixel", "grid_shape"} & arrays.keys():
        return True
    pixel, shape = np.asarray(arrays.get("pixel")), np.asarray(arrays.get("grid_shape"))
    if pixel.shape != (n_points,) or shape.shape != (2,) or {pixel.dtype.kind, shape.dtype.kind} - set("iu"):
        return False
    rows, columns = (int(size) for size in shape)
    return min(rows, columns) > 0 and bool(((pixel >= 0) & (pixel < rows * columns)).all())


def _pose_values(view: View) -> dict[str, object]:
    """Return the content of a pose file: for each pose its 4 x 4 matrices [m] and angles [deg]."""
    T_base_scanner = view.T_base_object @ view.T_object_scanner
    return {
        "view": view.stop,
        "candidate": view.candidate,
        "units": "m, deg",
        "q_deg": np.rad2deg(view.q[:, :ARM_AXES]).tolist(),
        **({"e_deg": np.rad2deg(view.q[:, ARM_AXES:]).tolist()} if view.q.shape[1] > ARM_AXES else {}),
        "T_base_flange": view.T_base_flange.tolist(),
        "T_base_scanner": T_base_scanner.tolist(),
        "T_object_scanner": view.T_object_scanner.tolist(),
    }
