"""Checks before an execution moves an arm: confirmation by a person, slow start, latched faults, memory and disk space.

A controller that is simulated in this process needs no confirmation. These checks replace no emergency stop and no
safety controller; they keep a mistyped command from moving 235 kg.
"""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import parse_qsl, urlsplit

import numpy as np

from cell.errors import DriverFailureError, FileError, UsageError
from cell.files import file_errors
from cell.runs.cell import RunCell
from cell.runs.digest import SHORT_DIGEST, path_digest
from cell.runs.run import EXECUTIONS
from cell.runs.verification import VerifiedPlan
from cell.scan.execution import ExecutionPlan
from cell.scan.options import ScanOptions
from cell.scan.simulated import lines_per_step
from cell.session import Confirm
from drivers.contract import Driver, RobotState
from drivers.setpoints import from_rad
from drivers.status import latched_fault
from drivers.wire import Timeouts
from planner.timing.motion import Motion

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

HARDWARE_SPEED = 0.1
"""Default fraction of the axis speeds on a real arm."""

ANY_MOTION = "every motion"
"""Value of a confirmation for every motion of a larger task, whatever path it takes."""

_REPORT_AGE = 0.04  # s, of the axes that a controller reports (docs/internals/protocol.md)
_RAY_BYTES = 250  # memory for each ray while a view is scanned: directions, hits, normals and their copies
_POINT_BYTES = 60  # memory for each ray of all views when their points are merged
_STORED_BYTES = 66  # disk for each ray of all views: point, face, pixel and code, and the point in the merged cloud
_REPORT_BYTES = 50e6  # disk for the report, its pictures and the surface


@dataclass(frozen=True, slots=True)
class ApprovedMotion:
    """A verified motion that may be driven after confirmation.

    A path that differs from the plan's motion has its own digest: to one view and back (`--view`), or from the
    current position of the arm to the remaining segments (`--resume`). `cell.runs.digest` defines the digest.

    Attributes:
        description: "the plan", "the path to view 3 and back".
        digest: of the motion.
        is_own_path: whether it differs from the plan's motion.
    """

    description: str
    digest: str
    is_own_path: bool = False

    @property
    def short_digest(self) -> str:
        """First characters of the digest."""
        return self.digest[:SHORT_DIGEST]


def approve_path(verified: VerifiedPlan, plan: ExecutionPlan, description: str) -> ApprovedMotion:
    """Verify that a path other than the plan's motion keeps the limits and is free of collision.

    Raises:
        FileError: if it does not.
    """
    limits = verified.motion.limits
    start = np.clip(plan.start, limits.lower, limits.upper)  # a count beyond a limit is a rounded limit
    verified.require_path_free(np.concatenate([start[None], *(segment.via for segment in plan.segments)]))
    rows = [[0, 0, -1, *from_rad(plan.start).tolist()]]
    for number, segment in enumerate(plan.segments, start=1):
        last = len(segment.via) - 1
        for row, set_points in enumerate(segment.set_points.tolist()):
            scanned = [segment.stop, segment.pose if segment.stop else -1] if row == last else [0, -1]
            rows.append([number, *scanned, *set_points])
    return ApprovedMotion(description, path_digest(verified.digest, rows), is_own_path=True)


def speed_fraction(requested: float | None, planned: float, *, hardware: bool) -> float:
    """Return the fraction of the axis speeds.

    Args:
        requested: `--speed`, share of the planned speed; None if not given.
        planned: the plan's fraction of the axis speeds.
        hardware: whether a real arm moves.
    """
    if requested is not None:
        return planned * requested
    return min(planned, HARDWARE_SPEED) if hardware else planned


def require_confirmation(
    driver: Driver, speed: float, motion: ApprovedMotion, *, confirmation: str | None, confirm: Confirm | None
) -> None:
    """Require that a person confirms a motion of a real arm.

    Args:
        driver: connected.
        speed: fraction of the axis speeds.
        motion: to be driven.
        confirmation: digest from an option, or its first characters; or `ANY_MOTION`.
        confirm: asks the user; None without a user.

    Raises:
        UsageError: without a confirmation, or if it is for another motion.
    """
    able = driver.capabilities
    if (
        not able.hardware
        or confirmation == ANY_MOTION
        or (confirmation is not None and motion.digest.startswith(confirmation))
    ):
        return
    name, digest = motion.description, motion.short_digest
    danger = f"{able.controller} moves an arm at {100 * speed:g} % of its axis speeds along {name} {digest}"
    danger += f"; it does not report {able.not_reported}" if able.not_reported else ""
    if confirmation is not None and not (motion.is_own_path and confirm is not None):
        raise UsageError(
            f"--confirm-motion {confirmation} is not the digest of {name}, which is {digest}; nothing was moved: check "
            "that this motion is intended, and give its digest"
        )
    if confirm is None:
        raise UsageError(
            f"{danger}; check that no person is within its reach and the emergency stop is at hand, then give "
            f"--confirm-motion {digest}"
        )
    question = (
        f"{danger}. Check that no person is within its reach and the emergency stop is at hand. Type yes to move: "
    )
    if confirm(question).strip().lower() != "yes":
        raise UsageError("not confirmed; nothing was moved")


def require_time_scale(driver: Driver, accepted: float | None) -> None:
    """Refuse a controller on a wire whose clock is not real time, unless a person accepts it as an emulator.

    Raises:
        UsageError: if its clock rate differs from the accepted one, or from real time.
    """
    able = driver.capabilities
    if not able.hardware or able.time_scale == (1.0 if accepted is None else accepted):
        return
    if able.time_scale == 1.0:
        raise UsageError(
            f"{able.controller} reports a clock in real time, not {accepted:g} times as fast; nothing was moved: omit "
            "--accept-time-scale"
        )
    raise UsageError(
        f"{able.controller} reports a clock {able.time_scale:g} times as fast as real time, which only an emulator "
        f"has; nothing was moved: if it is an emulator, give --accept-time-scale {able.time_scale:g}"
    )


def prepare_controller(driver: Driver, options: ScanOptions, *, stop_first: bool) -> RobotState:
    """Become the only client of a controller and return its state, ready for a move.

    Args:
        driver: connected.
        options: accepted time scale, and whether a latched fault may be cleared.
        stop_first: whether a moving arm may be stopped, as after a client that was killed.

    Raises:
        UsageError: if its clock is not accepted.
        DriverFailureError: if a fault is latched and may not be cleared, or the arm moves.
        DriverError: from the driver.
    """
    require_time_scale(driver, options.accept_time_scale)
    state = driver.state()
    if state.is_busy:
        if not stop_first:
            raise DriverFailureError("the arm is moving already, driven by another client; stop it first")
        state = driver.stop()
    driver.take()
    if fault := latched_fault(state):
        if not options.reset:
            raise DriverFailureError(
                f"the controller has latched a fault ({fault}); nothing was moved: find its cause, then give --reset "
                "to clear it"
            )
        driver.reset()
    return driver.require_ready()


def placement_warning(options: ScanOptions, cell: RunCell, clearance: float) -> str:
    """Return a warning if the placement error of the part may exceed the clearance of the motion [m], else ""."""
    if options.search_range is None:
        return ""
    distance, angle = options.search_range
    vertices, centre = cell.reference.vertices, cell.scene.T_object_centre[:3, 3]
    radius = float(np.linalg.norm(vertices - centre, axis=1).max())
    moved = distance + 2 * float(np.sin(angle / 2)) * radius
    if not moved > clearance:  # older runs store no clearance
        return ""
    return (
        f"the part may be displaced by up to {1000 * moved:.1f} mm, and the smallest clearance of the motion is "
        f"{1000 * clearance:.1f} mm: locate the part with cell locate first, or plan with a larger clearance"
    )


def watch_warning(
    plan: ExecutionPlan, motion: Motion, cell: RunCell, options: ScanOptions, speed: float, reserve: float
) -> str:
    """Return a warning if the path watch may stop a deviating arm only after contact, else "".

    An arm that is farther from its path than the tolerance keeps its speed until the next poll of a state with delay.

    Args:
        plan: segments to drive.
        motion: of the plan, with the limits of its timing.
        cell: of the run.
        options: URL of the driver.
        speed: fraction of the axis speeds.
        reserve: proven clearance of the segments without the tolerance of their path [m].
    """
    via = np.concatenate([plan.start[None], *(segment.via for segment in plan.segments)])
    steps, share = np.linspace(via[:-1], via[1:], 33), speed / cell.scene.speed_scaling
    q_from, q_to = (each.reshape(-1, via.shape[1]) for each in (steps[:-1], steps[1:]))
    seconds = (np.abs(q_to - q_from) / (share * motion.limits.velocity)).max(axis=1)
    moved = cell.travel.displacement(q_from, q_to)[seconds > 0] / seconds[seconds > 0]
    reached = float(moved.max(initial=0.0))
    poll = float(dict(parse_qsl(urlsplit(options.driver).query)).get("poll_ms", 1000 * Timeouts.poll)) / 1000
    covered = reserve / (poll + _REPORT_AGE)
    if reached <= covered:
        return ""
    return (
        f"the path watch stops a deviating arm before contact up to {1000 * covered:.0f} mm/s, without its braking "
        f"distance; a point of arm or scanner reaches {1000 * reached:.0f} mm/s "
        f"(--speed {0.95 * share * covered / reached:.2g} keeps below)"
    )


def require_room(cell: RunCell, plan: ExecutionPlan, folder: Path) -> None:
    """Require memory and disk space for all scans of an execution, counting each ray as a point.

    Args:
        cell: with the scanner at its resolution.
        plan: segments to scan.
        folder: of the run, on the disk of the scans.

    Raises:
        UsageError: if there is too little memory.
        FileError: if there is too little disk space.
    """
    rows, columns = cell.scanner.grid_shape
    views: dict[int, list[np.ndarray]] = {}
    for segment in plan.segments:
        if segment.stop:
            views.setdefault(segment.stop, []).append(segment.via[-1])
    lines = [
        1 if len(poses) == 1 else len(poses) * lines_per_step(np.stack([cell.scanner_pose(q) for q in poses]))
        for poses in views.values()
    ]
    largest, total = (rows * columns * count for count in (max(lines, default=0), sum(lines)))
    needed, available = largest * _RAY_BYTES + total * _POINT_BYTES, _available_memory()
    if needed > available:
        raise UsageError(
            f"{largest:.3g} rays in a view and {total:.3g} in all need up to {needed / 1e9:.3g} GB of memory, and "
            f"{available / 1e9:.3g} GB are available; nothing was moved: give a coarser --resolution"
        )
    stored = total * _STORED_BYTES + _REPORT_BYTES
    with file_errors(f"the free space on the disk of {folder} cannot be read"):
        free = shutil.disk_usage(folder).free
    if stored > free:
        raise FileError(
            f"the scans need up to {stored / 1e9:.3g} GB on the disk of {folder}, and {free / 1e9:.3g} GB are free; "
            "nothing was moved: free some space, or give a coarser --resolution"
        )


def _available_memory() -> float:
    """Return the memory that is free or can be freed [bytes]; the address space if the system does not report it."""
    try:
        for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return float(line.split()[1]) * 1024
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (OSError, ValueError, AttributeError):
        return 2.0**47


@contextmanager
def exclusive(folder: Path) -> Iterator[None]:
    """Lock the folder of an execution against other processes; the system releases the lock when the process ends.

    The lock is on the folder itself and leaves no file. On systems without such locks (Windows, some network disks)
    only the process number in the manifest tells of another process.

    Args:
        folder: a missing folder is not locked.

    Raises:
        FileError: if another process has locked it.
    """
    if fcntl is None or not folder.is_dir():
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise FileError(
                f"another process uses execution {folder.name}; wait for its end, or stop it with Ctrl-C"
            ) from error
        except OSError:
            pass  # no locks on this file system
        yield
    finally:
        os.close(handle)


def execution_path(run: Path, execution: str) -> Path:
    """Return the folder of an execution of a run, by its id or "latest"; it may not exist."""
    root = run / EXECUTIONS
    if execution == "latest" and root.is_dir():
        execution = max((path.name for path in root.iterdir() if path.name.isdecimal()), key=int, default=execution)
    return root / execution
