"""Execute a plan: drive its segments, scan at every view from the reported pose, and record scans and events.

A segment is driven in one move through its via points, as set-points of 1e-4 deg, which are exactly those that the plan
was checked with. A sweep has one segment for each of its poses: the arm stops at each pose, where a controller that
drives the line would pass. The driver's `move` returns when the arm is at rest. A scan is on disk before the next
segment begins (that of a sweep at its last pose), and every event when it happens. Arm and housing are no occluders, as
in the plan's prediction.
"""

import dataclasses
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import parse_qsl, urlsplit

import numpy as np
from pydantic import JsonValue

from cell import signals
from cell.errors import DriverFailureError, FileError, UsageError, errors_as
from cell.runs.cell import RunCell
from cell.runs.run import split_axes
from cell.scan import acquisition as sources
from cell.scan.acquisition import Acquisition, View
from cell.scan.execution_folder import EXECUTING, MOTION, ExecutionFolder
from cell.scan.options import ScanOptions
from cell.scan.table_turns import TurnOffsetDriver
from cell.session import Session
from drivers.clock import Clock, RealTimeClock, SimulatedClock
from drivers.contract import Driver, Move, Result, RobotState
from drivers.errors import DriverError
from drivers.limits import Limits, check_move
from drivers.registry import Context, open_driver
from drivers.setpoints import PER_DEGREE, SetPoints, format_axes, from_rad, to_deg, to_rad
from drivers.sim import SimDriver
from drivers.simulated_controller import PlantFactory
from planner.ports import Progress, no_progress
from planner.timing.motion import Motion, retime
from planner.values import Floats

START_TOLERANCE = 100
"""Largest distance of the arm from the start of a segment, in counts: 0.01 deg."""

_WATCH_S = 0.1  # between two readings of the state during a scan

_SMALL_REACH = 0.1
"""Distances of points from an axis below this [m] count as this: a flange needs no tolerance of many degrees."""

_DYNAMIC = ("velocity", "acceleration", "jerk")
_LIMITS = ("lower", "upper", *_DYNAMIC)


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """One move of an execution.

    Attributes:
        via: (n, axes) via points [rad], n at least 1; the arm is at rest at the last one.
        stop: number of the view that is scanned at the end, from 1 in visiting order; 0 for none.
        view: its candidate, row of viewpoints.npz; -1 for none.
        pose: pose of the view in its column of the sweep; 0 for a view at rest.
    """

    via: Floats
    stop: int
    view: int
    pose: int = 0

    @property
    def set_points(self) -> SetPoints:
        """(n, axes) int32 counts of 1e-4 deg."""
        return from_rad(self.via)

    @property
    def goal(self) -> str:
        """End of the segment, for messages."""
        return f"view {self.stop}" if self.stop else "home"


@dataclass(frozen=True, slots=True, eq=False)
class ExecutionPlan:
    """Segments to execute.

    Attributes:
        start: (axes,) configuration at the start [rad].
        segments: in driving order; the last ends at home.
        planned_seconds: their planned duration [s].
    """

    start: Floats
    segments: tuple[Segment, ...]
    planned_seconds: float

    @property
    def stops(self) -> tuple[int, ...]:
        """Numbers of the views to scan, in driving order."""
        return tuple(dict.fromkeys(segment.stop for segment in self.segments if segment.stop))

    def to_motion(self, planned: Motion) -> Motion:
        """Return the segments as a timed motion with the limits of the planned one."""
        via = np.concatenate([self.start[None], *(segment.via for segment in self.segments)])
        counts = [len(segment.via) for segment in self.segments]
        view, pose = np.full(len(via), -1), np.full(len(via), -1)
        view[np.cumsum(counts)] = [segment.view for segment in self.segments]
        pose[np.cumsum(counts)] = [segment.pose if segment.stop else -1 for segment in self.segments]
        return retime(via, np.repeat(np.arange(len(counts) + 1), [1, *counts]), view, planned.limits, pose=pose)


def plan_execution(motion: Motion, stop: int | None = None) -> ExecutionPlan:
    """Return the segments of a plan, or those to one view and back.

    For one view the arm follows the plan from the end that is nearer in time and returns on the same path: only paths
    that the plan checked.

    Args:
        motion: of the plan, home to home.
        stop: number of the only view, from 1 in visiting order; None for all views.

    Raises:
        UsageError: if the plan has no such view.
    """
    rows = np.flatnonzero(motion.view >= 0)
    number = np.cumsum(np.diff(motion.view[rows], prepend=-1) != 0)  # view of each of these via points
    if stop is None:
        segments = [
            Segment(motion.via_q[begin + 1 : end + 1], count, int(motion.view[end]), int(motion.pose[end]))
            for begin, end, count in zip([0, *rows.tolist()], rows.tolist(), number.tolist(), strict=False)
        ]
        last = int(rows[-1]) if len(rows) else 0
        if len(motion.via_q) - 1 > last:
            segments.append(Segment(motion.via_q[last + 1 :], 0, -1))
        return ExecutionPlan(motion.via_q[0], tuple(segments), motion.duration)
    if not 1 <= stop <= number.max(initial=0):
        raise UsageError(f"--view {stop} does not exist; the plan has the views 1 to {number.max(initial=0)}")
    at = rows[number == stop]
    forward = bool(motion.via_t[at[-1]] <= motion.duration - motion.via_t[at[0]])
    path, t = (motion.via_q, motion.via_t) if forward else (motion.via_q[::-1], motion.duration - motion.via_t[::-1])
    ends = at if forward else (len(path) - 1 - at)[::-1]
    poses = motion.pose[at] if forward else motion.pose[at][::-1]
    there = [
        Segment(path[begin + 1 : end + 1], stop, int(motion.view[at[0]]), pose)
        for begin, end, pose in zip([0, *ends.tolist()], ends.tolist(), poses.tolist(), strict=False)
    ]
    back = Segment(path[: ends[-1]][::-1], 0, -1)
    return ExecutionPlan(path[0], (*there, back), 2 * float(t[ends[-1]]))


def make_driver(
    options: ScanOptions,
    motion: Motion,
    cell: RunCell,
    plants: Mapping[str, PlantFactory] | None = None,
    notify: Callable[[str], None] | None = None,
    proven_clearance: float = np.inf,
) -> tuple[Driver, Clock]:
    """Return the driver, not yet connected, and the clock of its events.

    The simulated controller gets the limits and accelerations of the plan, starts where the plan starts, and jumps in
    time unless real time is requested. The same limits judge the arrivals of a real one. But it does not know the
    scaling of the plan's limits, so there the limits of the robot model count if they are larger.

    Args:
        options: URL and real time.
        motion: of the plan, with the limits of its timing.
        cell: of the run, with the arm's limits and the speed scaling of the plan.
        plants: further plants of a simulated controller by name.
        notify: receives messages about long waits.
        proven_clearance: lower bound on the clearance of the motion [m], for the tolerance of its path.

    Raises:
        UsageError: if real time is requested of a controller that is not simulated.
        DriverFailureError: if the URL names no driver, or has an unknown option.
    """
    try:
        parts = urlsplit(options.driver)
        query = dict(parse_qsl(parts.query, keep_blank_values=True))
    except ValueError as error:
        raise DriverFailureError(f"driver URL '{options.driver}' cannot be read: {error}") from error
    url, is_simulated = options.driver, parts.scheme == "sim"
    if options.realtime and not is_simulated:
        raise UsageError(f"--realtime is for sim://; {options.driver} always runs in its own time")
    own_clock = not is_simulated or query.get("realtime", "0").lower() not in ("0", "false", "no", "off")
    if is_simulated and "start" not in query and "://" in url:
        start = ",".join(f"{angle:.4f}" for angle in to_deg(from_rad(motion.via_q[0])))
        url += ("&" if "?" in url else "?") + f"start={start}"
    arm = dataclasses.replace(motion.limits, velocity=motion.limits.velocity / cell.scene.speed_scaling)
    if not is_simulated:
        able = cell.kinematics.limits
        arm = dataclasses.replace(
            arm, **{name: np.maximum(getattr(arm, name), getattr(able, name)) for name in _DYNAMIC}
        )
    clock: Clock | None = None if own_clock else RealTimeClock() if options.realtime else SimulatedClock()
    with driver_errors():
        limits = Limits.from_rad(arm)
        limits = limits.with_endless_axis() if cell.scene.table_is_endless else limits
        reach = cell.travel.reach(len(limits.lower))
        tolerance = np.degrees(cell.path_tolerance(proven_clearance) / np.maximum(reach, _SMALL_REACH)) * PER_DEGREE
        limits = dataclasses.replace(limits, path_tolerance=np.maximum(tolerance, 1))
        driver = open_driver(url, Context(limits, clock, plants or {}, notify))
        # A simulated controller has one clock, with its time scale; of another one only real time is known.
        return driver, driver.clock if isinstance(driver, SimDriver) else RealTimeClock()


def driver_errors() -> AbstractContextManager[None]:
    """Convert a driver's error in the block to one that ends the command with its exit code."""
    return errors_as(DriverFailureError, DriverError)


def make_acquisition(
    options: Mapping[str, JsonValue], cell: RunCell, seed: int, folder: Path, notify: Callable[[str], None]
) -> Acquisition:
    """Return the source of the points from the options of an execution's manifest."""
    kind, argument = sources.load(str(options.get("acquire", "simulated")))
    return kind(argument, sources.Context(cell, options, seed, folder, notify))


def execute_plan(
    session: Session[ExecutionFolder], plan: ExecutionPlan, driver: Driver, clock: Clock, cell: RunCell, speed: float
) -> None:
    """Execute and scan; the folder keeps everything that was recorded before a failure."""
    folder, able = session.folder, driver.capabilities
    with session.stage(EXECUTING) as progress, driver:
        scale = {} if able.time_scale == 1 else {"time_scale": able.time_scale}
        folder.note(controller=able.controller, speed_fraction=round(speed, 6), **scale)
        seed = folder.manifest.require_seed(folder.path)
        source = make_acquisition(folder.manifest.options, cell, seed, folder.path, session.note)
        folder.note(source=source.source)
        seconds = drive(plan, driver, cell, source, folder, speed=speed, clock=clock, progress=progress)
        folder.note(motion_s=round(seconds, 6), simulated_time=able.simulated_time)


def drive(
    plan: ExecutionPlan,
    driver: Driver,
    cell: RunCell,
    acquisition: Acquisition,
    folder: ExecutionFolder,
    *,
    speed: float,
    clock: Clock,
    progress: Progress = no_progress,
) -> float:
    """Drive the segments, scan and record.

    Args:
        plan: the segments.
        driver: connected.
        cell: part, occluders and scanner.
        acquisition: source of the points.
        folder: of scans and events.
        speed: fraction of the axis speeds.
        clock: the controller's, for the times of events.
        progress: receives the number of driven segments.

    Returns:
        Duration of the moves by the controller's clock [s].

    Raises:
        DriverFailureError: if the arm is not at the start of the plan or at the end of a segment, also during a scan,
            or the controller would refuse a segment.
        FileError: if an event or a scan cannot be written; the arm is at rest.
        DriverError: from the driver.
    """
    began = clock.now()
    moving = 0.0
    reached: list[tuple[Segment, Floats]] = []  # segments of the current view with the reported joint angles

    def record(name: str, **details: object) -> None:
        folder.event(clock.now() - began, name, **details)

    try:
        state = driver.state()
        turns = {"whole_turns": driver.turns} if isinstance(driver, TurnOffsetDriver) else {}
        record("connected", controller=driver.capabilities.controller, axes_deg=to_deg(state.axes).tolist(), **turns)
        require_drivable(plan, driver, speed)
        for number, segment in enumerate(plan.segments, start=1):
            set_points = segment.set_points
            if number > 1:  # during a scan somebody may drive the arm by hand
                _require_arrived(plan.segments[number - 2], driver.require_ready(), cell)
            record("move", segment=number, number=segment.stop, via_points=len(set_points))
            left = clock.now()
            state = _move(driver, set_points, speed)
            moving += clock.now() - left
            record("arrival", segment=number, number=segment.stop, axes_deg=to_deg(state.axes).tolist())
            _require_arrived(segment, state, cell)
            if segment.stop:
                reached.append((segment, state.q))
                following = plan.segments[number].stop if number < len(plan.segments) else 0
                if following != segment.stop:
                    name = f"{segment.stop:04d}.npz"
                    points, details = scan_view(reached, cell, acquisition, folder, name, driver)
                    reached = []
                    if points is None:
                        record("missing", number=segment.stop, view=segment.view)
                    else:
                        file = f"scans/{name}"
                        record("scan", number=segment.stop, view=segment.view, file=file, points=points, **details)
            progress(number, len(plan.segments))
    except BaseException as error:
        with suppress(FileError):  # a full disk must not hide the cause
            if signals.is_interruption(error):
                record("interrupted", reason=f"stopped by {signals.last_signal()}")
            else:
                record("failed", reason=str(error))
        raise
    record("done")
    return moving


def scan_view(
    reached: Sequence[tuple[Segment, Floats]],
    cell: RunCell,
    acquisition: Acquisition,
    folder: ExecutionFolder,
    name: str,
    driver: Driver,
) -> tuple[int | None, Mapping[str, JsonValue]]:
    """Scan at the current pose and write the scan.

    Args:
        reached: the view's segments in driving order (several for a sweep), each with the (axes,) reported joint angles
            at its end [rad].
        cell: part, occluders and scanner.
        acquisition: source of the points.
        folder: of the scan.
        name: file of the scan.
        driver: its arm must still be at the end of the segment when all points are there.

    Returns:
        Number of points, None for a missing view; and details for the event.
    """
    segment, q = reached[-1][0], np.stack([q for _, q in reached])
    commanded = np.stack([to_rad(each.set_points[-1]) for each, _ in reached])
    view = View(
        segment.stop,
        segment.view,
        q,
        cell.in_base(q, cell.kinematics.forward(q)),
        np.stack([cell.scanner_pose(each) for each in q]),
        cell.in_base(q[0], cell.scene.T_base_object),
        np.argsort([each.pose for each, _ in reached]),
    )
    with _watch_at_rest(driver):
        acquired = acquisition.take(view)
    _require_arrived(segment, driver.require_ready(), cell)
    if acquired is None:
        return None, {}
    sources.require_scan(acquired, view, cell.scanner_keys.own.get("range_mm"))
    T = view.T_object(acquired.frame)
    points = acquired.points if acquired.frame == "object" else acquired.points @ T[:3, :3].T + T[:3, 3]
    sweep = {
        "sweep_q_commanded": commanded[view.order],
        "sweep_q_reported": q[view.order],
        "sweep_T_object_scanner": view.T_object_scanner[view.order],
    }
    folder.write_scan(
        name,
        number=np.array(segment.stop),
        view=np.array(segment.view),
        source=np.array(acquisition.source),
        frame=np.array(acquired.frame),
        **split_axes(q_commanded=commanded[view.middle], q_reported=q[view.middle]),
        T_object_scanner=view.T_object_scanner[view.middle],
        points=points,
        **acquired.arrays,
        **(sweep if len(reached) > 1 else {}),
    )
    return len(points), acquired.details


@contextmanager
def _watch_at_rest(driver: Driver) -> Iterator[None]:
    """Read the state of a controller in real time while the block scans, and raise what `require_ready` refuses.

    A fault, a motion or a loss of the session is so found also if it is over at the end of the scan.
    """
    if driver.capabilities.simulated_time:  # nothing happens while its time stands still
        yield
        return
    errors: list[Exception] = []
    ended = threading.Event()

    def watch() -> None:
        while not errors and not ended.wait(_WATCH_S):
            try:
                driver.require_ready()
            except Exception as error:  # raised in the thread of the scan
                errors.append(error)

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
    if errors:
        raise errors[0]


def _chunks(set_points: SetPoints, max_via: int | None) -> Iterator[SetPoints]:
    """Split a segment into moves if the controller limits the via points of a move."""
    size = max_via or len(set_points)
    for first in range(0, len(set_points), size):
        yield set_points[first : first + size]


def _move(driver: Driver, set_points: SetPoints, speed: float) -> RobotState:
    """Drive one segment."""
    able = driver.capabilities
    for chunk in _chunks(set_points, able.max_via):
        state = driver.move(chunk, min(speed, able.max_speed))
    return state


def require_drivable(plan: ExecutionPlan, driver: Driver, speed: float) -> None:
    """Check start, limits, steps and speed of all segments against the controller, before anything moves.

    Raises:
        DriverFailureError: if the arm is not at the start, or the controller would refuse a segment.
        DriverError: if the state cannot be read.
    """
    able, state = driver.capabilities, driver.state()
    if not is_at(plan.start, state):
        raise DriverFailureError(
            f"the arm is at {format_axes(state.axes)} and the plan begins at {format_axes(from_rad(plan.start))}; "
            "nothing was moved, because no path between them was checked: drive the arm to the start first"
        )
    position = state.axes
    for number, segment in enumerate(plan.segments, start=1):
        for chunk in _chunks(segment.set_points, able.max_via):
            move = Move(chunk, min(speed, able.max_speed))
            result, detail = check_move(move, position, able)
            if result is not Result.OK:
                goal = f"to {segment.goal}" if segment.stop else "home"
                raise DriverFailureError(f"the controller refuses move {number} ({goal}): {detail}; nothing was moved")
            position = move.set_points[-1]


def is_at(q: Floats, state: RobotState) -> bool:
    """Return whether the arm is at joint angles (axes,) [rad], within a hundredth of a degree."""
    return int(np.abs(from_rad(q).astype(np.int64) - state.axes).max()) <= START_TOLERANCE


def _require_arrived(segment: Segment, state: RobotState, cell: RunCell) -> None:
    """Refuse to drive on or to scan unless the arm is at the end of the segment."""
    due = segment.set_points[-1]
    distance = float(cell.travel(to_rad(due)[None], state.q[None])[0]) if (due != state.axes).any() else 0.0
    if not distance <= cell.arrival:
        raise DriverFailureError(
            f"the arm is at {format_axes(state.axes)} and its move ended at {format_axes(due)}: a point of arm or tool "
            f"may deviate by {1000 * distance:.2f} mm, and {1000 * cell.arrival:g} mm are allowed (arrival_mm); it did "
            "not arrive, or was moved since; nothing more was moved or scanned, and --resume plans a path from the "
            "current position"
        )


def write_motion(folder: ExecutionFolder, motion: Motion) -> None:
    """Write the driven motion of an execution that does not drive the plan's motion, for a replay."""
    names = ("via_q", "segment", "view", "via_t", "t", "q", "qd", "qdd", "segment_of_sample")
    arrays = {name: getattr(motion, name) for name in names}
    arrays |= split_axes(via_q=motion.via_q, q=motion.q, qd=motion.qd, qdd=motion.qdd)
    limits = {f"limit_{name}": getattr(motion.limits, name) for name in _LIMITS}
    folder.write_arrays(MOTION, **arrays, pose=motion.pose, line=motion.line, **limits)
