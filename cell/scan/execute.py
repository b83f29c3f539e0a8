"""Step 10: drive the plan leg by leg, scan at every stop from the pose that the controller reports, record, go on.

The driver's `move` returns when the arm stands; a scan is on disk before the next leg begins, and every event when it
happens. Of a sweep the arm stops at each pose, where a controller that drives the line passes; its scan is written at
the last one.

Arm and housing are not among the occluders, as in the plan's prediction.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial

import numpy as np
from pydantic import JsonValue

from cell import signals
from cell.acquisition.sources import Acquisition, View
from cell.errors import DriverFailureError, FileError
from cell.runs.cell import RunCell
from cell.runs.run import split_axes
from cell.scan.execution_folder import ExecutionFolder
from cell.scan.legs import AT_START, Leg, Legs
from cell.scan.whole_turns import WholeTurnsOff
from drivers.clock import Clock
from drivers.contract import Driver, Move, Result, RobotState
from drivers.limits import check_move
from drivers.setpoints import SetPoints, format_axes, from_rad, to_deg, to_rad
from planner.ports import Progress
from planner.values import Floats


def run(
    legs: Legs,
    driver: Driver,
    cell: RunCell,
    acquisition: Acquisition,
    folder: ExecutionFolder,
    *,
    speed: float,
    clock: Clock,
    progress: Progress | None = None,
) -> float:
    """Execute and record.

    Args:
        legs: what to drive.
        driver: connected.
        cell: part, surroundings and scanner.
        acquisition: gives the points.
        folder: where scans and events go.
        speed: fraction of the axis speeds at which to drive.
        clock: the controller's, for the times of events.
        progress: told about the legs.

    Returns:
        Time that the controller took for the moves [s].

    Raises:
        DriverFailureError: if the arm does not stand where the plan begins or a leg ended, or did not stand there while
            it was scanned, or the controller would refuse a leg.
        FileError: if an event or a scan cannot be written; the arm stands.
        DriverError: whatever the driver raises.
    """
    began = clock.now()
    moving = 0.0
    looks: list[tuple[Leg, Floats]] = []  # poses of the view under work: leg, and joint angles that were reported

    def say(name: str, **details: object) -> None:
        folder.event(clock.now() - began, name, **details)

    try:
        state = driver.state()
        turned = {"whole_turns": driver.turns} if isinstance(driver, WholeTurnsOff) else {}
        say("connected", controller=driver.capabilities.controller, axes_deg=to_deg(state.axes).tolist(), **turned)
        require_drivable(legs, driver, speed)
        for number, leg in enumerate(legs.legs, start=1):
            set_points = leg.set_points
            if number > 1:  # a scan takes long enough for somebody to drive the arm by hand meanwhile
                _require_near(legs.legs[number - 2], driver.require_ready(), cell)
            say("move", leg=number, stop=leg.stop, via_points=len(set_points))
            left = clock.now()
            state = _drive(driver, set_points, speed)
            moving += clock.now() - left
            say("standing", leg=number, stop=leg.stop, axes_deg=to_deg(state.axes).tolist())
            _require_near(leg, state, cell)
            if leg.stop:
                looks.append((leg, state.q))
                after = legs.legs[number].stop if number < len(legs.legs) else 0
                if after != leg.stop:
                    name = f"{leg.stop:04d}.npz"
                    still = partial(_require_still, leg, driver, cell)
                    points, told = scan_and_write(looks, cell, acquisition, folder, name, still=still)
                    looks = []
                    if points is None:
                        say("missing", stop=leg.stop, view=leg.view)
                    else:
                        say("scan", stop=leg.stop, view=leg.view, file=f"scans/{name}", points=points, **told)
            if progress:
                progress(number, len(legs.legs))
    except BaseException as error:
        with suppress(FileError):  # a full disk must not hide why it ended
            if isinstance(error, KeyboardInterrupt):
                say("interrupted", reason=f"stopped by {signals.last_signal()}")
            else:
                say("failed", reason=str(error))
        raise
    say("done")
    return moving


def scan_and_write(
    looks: Sequence[tuple[Leg, Floats]],
    cell: RunCell,
    acquisition: Acquisition,
    folder: ExecutionFolder,
    name: str,
    still: Callable[[], None] = lambda: None,
) -> tuple[int | None, Mapping[str, JsonValue]]:
    """Scan from where the arm stands and put the scan on disk.

    Args:
        looks: the view's leg, or those of all poses of its sweep in driving order, and the (axes,) joint angles that
            the controller reported at the end of each [rad].
        cell: part, surroundings and scanner.
        acquisition: gives the points.
        folder: where the scan goes.
        name: its file.
        still: looks, once all points are there, whether the arm still stands where it was scanned; raises if not.

    Returns:
        The number of points, None where the view stays missing; and what the event says of them.
    """
    leg, reported = looks[0][0], np.stack([q for _, q in looks])
    commanded = np.stack([to_rad(each.set_points[-1]) for each, _ in looks])
    view = View(
        leg.stop, leg.view, reported, cell.in_base(reported, cell.kinematics.forward(reported)),
        np.stack([cell.scanner_pose(q) for q in reported]), cell.in_base(reported[0], cell.scene.T_base_object),
        np.argsort([each.pose for each, _ in looks]),
    )  # fmt: skip
    acquired = acquisition.take(view)
    if acquired is None:
        return None, {}
    still()
    T = view.T_object(acquired.frame)
    points = acquired.points if acquired.frame == "object" else acquired.points @ T[:3, :3].T + T[:3, 3]
    sweep = {} if len(looks) == 1 else {
        "sweep_q_commanded": commanded[view.order],
        "sweep_q_reported": reported[view.order],
        "sweep_T_object_scanner": view.T_object_scanner[view.order],
    }  # fmt: skip
    folder.write_scan(
        name,
        stop=np.array(leg.stop),
        view=np.array(leg.view),
        source=np.array(acquisition.source),
        frame=np.array(acquired.frame),
        **split_axes(q_commanded=commanded[view.middle], q_reported=reported[view.middle]),
        T_object_scanner=view.T_object_scanner[view.middle],
        points=points,
        **acquired.kept,
        **sweep,
    )
    return len(points), acquired.told


def _drive(driver: Driver, set_points: SetPoints, speed: float) -> RobotState:
    """One leg, in several moves where the controller does not take so many via points at once."""
    most = driver.capabilities.max_via or len(set_points)
    for first in range(0, len(set_points), most):
        state = driver.move(set_points[first : first + most], min(speed, driver.capabilities.max_speed))
    return state


def require_drivable(legs: Legs, driver: Driver, speed: float) -> None:
    """Check start, limits, steps and speed of all legs against the controller, before anything moves.

    Args:
        legs: what is to be driven.
        driver: connected.
        speed: fraction of the axis speeds.

    Raises:
        DriverFailureError: if the arm stands elsewhere, or the controller would refuse a leg.
        DriverError: if the state cannot be read.
    """
    able, state = driver.capabilities, driver.state()
    _require_at(legs.start, state)
    stands = state.axes
    for number, leg in enumerate(legs.legs, start=1):
        points = leg.set_points
        most = able.max_via or len(points)
        for first in range(0, len(points), most):
            move = Move(points[first : first + most], min(speed, able.max_speed))
            result, detail = check_move(move, stands, able)
            if result is not Result.OK:
                goal = f"to view {leg.stop}" if leg.stop else "home"
                raise DriverFailureError(f"the controller refuses move {number} ({goal}): {detail}; nothing was moved")
            stands = move.set_points[-1]


def stands_at(q: Floats, state: RobotState) -> bool:
    """Whether the arm stands at joint angles (axes,) [rad], to a hundredth of a degree."""
    return int(np.abs(from_rad(q).astype(np.int64) - state.axes).max()) <= AT_START


def _require_still(leg: Leg, driver: Driver, cell: RunCell) -> None:
    _require_near(leg, driver.require_ready(), cell)


def _require_near(leg: Leg, state: RobotState, cell: RunCell) -> None:
    """No path is checked from anywhere but where a leg ended, and nothing is scanned from elsewhere."""
    due = leg.set_points[-1]
    off = float(cell.travel(to_rad(due)[None], state.q[None])[0]) if (due != state.axes).any() else 0.0
    if off > cell.arrival:
        raise DriverFailureError(
            f"the arm stands at {format_axes(state.axes)} and its move ended at {format_axes(due)}: a point of arm or "
            f"tool is up to {1000 * off:.2f} mm off, where {1000 * cell.arrival:g} mm are allowed (arrival_mm); it "
            "did not arrive, or was moved since; nothing more was moved or scanned, and --resume "
            "plans a way from where it stands"
        )


def _require_at(start: Floats, state: RobotState) -> None:
    if not stands_at(start, state):
        raise DriverFailureError(
            f"the arm stands at {format_axes(state.axes)} and the plan begins at {format_axes(from_rad(start))}; "
            "nothing was moved, because no path between them was checked: bring the arm there first"
        )
