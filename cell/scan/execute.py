"""Step 10: drive the plan leg by leg, scan at every stop from the pose that the controller reports, record, go on.

A leg is driven in one move through its via points, as set-points of 1e-4 deg; the plan checked exactly these. The
driver's `move` returns when the arm stands; a scan is on disk before the next leg begins, and every event when it
happens. Arm and housing are not among the occluders, as in the plan's prediction.
"""

from dataclasses import dataclass

import numpy as np

from cell.commands.narrator import ProgressCallback
from cell.errors import DriverFailureError, UsageError
from cell.rays import virtual_scan
from cell.scan.execution_folder import ExecutionFolder
from cell.scan.pose_error import Disturbance
from cell.scan.scene import ScanScene
from drivers.clock import Clock
from drivers.commands import Move, Result
from drivers.contract import Driver, RobotState
from drivers.limits import refuse
from drivers.setpoints import SetPoints, from_rad, text, to_deg, to_rad
from planner.ports import Floats
from planner.timing import Motion, retime

POSE, NOISE = 10, 11
"""Streams of randomness; a stop has its own of each, so that one view alone is disturbed as in the whole execution."""

_AT_START = 100  # counts: so far the arm may stand from the start of the plan, 0.01 deg


@dataclass(frozen=True, slots=True, eq=False)
class Leg:
    """One move of the execution.

    Attributes:
        via: (n, 6) via points [rad], n at least 1; the last is where the arm stands afterwards.
        stop: number of the view that is scanned there, from 1 in visiting order; 0 for none.
        view: its candidate, row of viewpoints.npz; -1 for none.
    """

    via: Floats
    stop: int
    view: int

    @property
    def set_points(self) -> SetPoints:
        """(n, 6) int32 counts of 1e-4 deg."""
        return from_rad(self.via)


@dataclass(frozen=True, slots=True, eq=False)
class Legs:
    """What an execution drives.

    Attributes:
        start: (6,) where the arm has to stand at the beginning [rad].
        legs: in driving order; the last brings the arm home.
        planned_seconds: the plan's time for them [s].
    """

    start: Floats
    legs: tuple[Leg, ...]
    planned_seconds: float

    def motion(self, planned: Motion) -> Motion:
        """These legs as a timed motion with the plan's limits."""
        via = np.concatenate([self.start[None], *(leg.via for leg in self.legs)])
        counts = [len(leg.via) for leg in self.legs]
        view = np.full(len(via), -1)
        view[np.cumsum(counts)] = [leg.view for leg in self.legs]
        return retime(via, np.repeat(np.arange(len(counts) + 1), [1, *counts]), view, planned.limits)


def legs_of(motion: Motion, stop: int | None = None) -> Legs:
    """The legs of the whole plan, or those to one view and back.

    For one view the arm goes along the plan, from the end that is nearer in time, and returns the same way: only paths
    that the plan checked.

    Args:
        motion: of the plan, home to home.
        stop: number of the one view, from 1 in visiting order; None takes all.

    Raises:
        UsageError: if the plan has no such view.
    """
    stops = np.flatnonzero(motion.view >= 0)
    if stop is None:
        ends = [*stops.tolist(), len(motion.via_q) - 1]
        begins = [0, *stops.tolist()]
        legs = [
            Leg(motion.via_q[begin + 1 : end + 1], number if end in stops else 0, int(motion.view[end]))
            for number, (begin, end) in enumerate(zip(begins, ends, strict=True), start=1)
            if end > begin
        ]
        return Legs(motion.via_q[0], tuple(legs), motion.duration)
    if not 1 <= stop <= len(stops):
        raise UsageError(f"--view {stop} does not exist; the plan has the views 1 to {len(stops)}")
    at = int(stops[stop - 1])
    forward = bool(motion.via_t[at] <= motion.duration - motion.via_t[at])
    way = motion.via_q[: at + 1] if forward else motion.via_q[at:][::-1]
    seconds = float(motion.via_t[at] if forward else motion.duration - motion.via_t[at])
    there, back = Leg(way[1:], stop, int(motion.view[at])), Leg(way[::-1][1:], 0, -1)
    return Legs(way[0], (there, back), 2 * seconds)


def run(
    legs: Legs,
    driver: Driver,
    scene: ScanScene,
    disturbance: Disturbance,
    folder: ExecutionFolder,
    *,
    seed: int,
    clock: Clock,
    progress: ProgressCallback | None = None,
) -> float:
    """Execute and record.

    Args:
        legs: what to drive.
        driver: connected.
        scene: part, surroundings and scanner.
        disturbance: noise and pose error.
        folder: where scans and events go.
        seed: of the disturbance.
        clock: the controller's, for the times of events.
        progress: told about the legs.

    Returns:
        Time that the controller took for the moves [s].

    Raises:
        DriverFailureError: if the arm does not stand where the plan begins, or the controller would refuse a leg.
        DriverError: whatever the driver raises.
    """
    began = clock.now()
    moving = 0.0

    def say(name: str, **details: object) -> None:
        folder.event(clock.now() - began, name, **details)

    try:
        state = driver.state()
        say("connected", controller=driver.capabilities.controller, axes_deg=to_deg(state.axes).tolist())
        require_drivable(legs, driver, scene.speed)
        for number, leg in enumerate(legs.legs, start=1):
            set_points = leg.set_points
            say("move", leg=number, stop=leg.stop, via_points=len(set_points))
            left = clock.now()
            state = _drive(driver, set_points, scene.speed)
            moving += clock.now() - left
            say("standing", leg=number, stop=leg.stop, axes_deg=to_deg(state.axes).tolist())
            if leg.stop:
                name = f"{leg.stop:04d}.npz"
                points = scan_and_write(leg, state.q, scene, disturbance, folder, name, seed)
                say("scan", stop=leg.stop, view=leg.view, file=f"scans/{name}", points=points)
            if progress:
                progress(number, len(legs.legs))
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            say("interrupted", reason="stopped by Ctrl-C")
        else:
            say("failed", reason=str(error))
        raise
    say("done")
    return moving


def scan_and_write(
    leg: Leg,
    q_reported: Floats,
    scene: ScanScene,
    disturbance: Disturbance,
    folder: ExecutionFolder,
    name: str,
    seed: int,
) -> int:
    """Scan from where the arm stands and put the scan on disk; returns the number of points.

    Args:
        leg: that ended here.
        q_reported: (6,) joint angles that the controller reports [rad].
        scene: part, surroundings and scanner.
        disturbance: noise and pose error.
        folder: where the scan goes.
        name: its file.
        seed: of the disturbance.
    """
    T_reported = scene.scanner_pose(q_reported)
    T_true = disturbance.true_pose(T_reported, np.random.default_rng([seed, POSE, leg.stop]))
    seen = virtual_scan.scan(scene.scanner, T_true, scene.part_caster, scene.reference, scene.occluder_caster)
    points = disturbance.as_reported(
        seen.points, T_true, T_reported, scene.scanner.source, np.random.default_rng([seed, NOISE, leg.stop]),
        seen.sigma(scene.scanner, scene.reference) if disturbance.by_model else None,
    )  # fmt: skip
    folder.write_scan(
        name,
        stop=np.array(leg.stop),
        view=np.array(leg.view),
        q_commanded=to_rad(leg.set_points[-1]),
        q_reported=q_reported,
        T_object_scanner=T_reported,
        T_object_scanner_true=T_true,
        points=points,
        face=seen.face,
        pixel=seen.pixel,
        grid_shape=np.array(seen.grid_shape, dtype=np.int64),
        codes=seen.codes,
        counts=np.array(list(seen.counts().values()), dtype=np.int64),
    )
    return len(points)


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
            result, detail = refuse(move, stands, able)
            if result is not Result.OK:
                goal = f"to view {leg.stop}" if leg.stop else "home"
                raise DriverFailureError(f"the controller refuses move {number} ({goal}): {detail}; nothing was moved")
            stands = move.set_points[-1]


def _require_at(start: Floats, state: RobotState) -> None:
    wanted = from_rad(start)
    if np.abs(wanted.astype(np.int64) - state.axes).max() > _AT_START:
        raise DriverFailureError(
            f"the arm stands at {text(state.axes)} and the plan begins at {text(wanted)}; nothing was moved, because "
            "no path between them was checked: bring the arm there first"
        )
