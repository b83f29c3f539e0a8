"""Remaining motion of a stopped execution, with an approach path from the current position of the arm.

A view is confirmed by its scan on disk, complete and unchanged. The segments from the first unconfirmed view on are
driven as planned. If the arm is not at the end of the segment before it, a new collision-free path to that view is
planned in the cell that the plan was checked in.
"""

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from cell.errors import DriverFailureError
from cell.scan.execution import ExecutionPlan, Segment, is_at
from cell.world.clearance import MotionClearance, motion_clearance
from cell.world.collision import MujocoCollisionChecker
from drivers.contract import RobotState
from drivers.setpoints import format_axes
from planner.path import path
from planner.ports import CollisionChecker, JointLimits
from planner.values import Floats

_N_LISTED = 10  # views named in a note


@dataclass(frozen=True, slots=True, eq=False)
class RemainingMotion:
    """Remaining segments of an execution.

    Attributes:
        plan: from the current position of the arm to home.
        approach_path: (m, axes) newly planned path to the first segment [rad]; None if the arm is already there.
    """

    plan: ExecutionPlan
    approach_path: Floats | None

    def clearance(self, checker: MujocoCollisionChecker) -> MotionClearance | None:
        """Return the smallest distances of the approach path; None without one."""
        if self.approach_path is None:
            return None
        return motion_clearance(checker, self.approach_path, np.zeros(len(self.approach_path), dtype=np.int64), 1)

    def notes(self, n_scanned: int, clearance: MotionClearance | None) -> list[str]:
        """Return notes about the views and the approach path with its clearance; `n_scanned` views are confirmed."""
        stops = self.plan.stops
        stop_list = ", ".join(str(stop) for stop in stops[:_N_LISTED]) + (", ..." if len(stops) > _N_LISTED else "")
        notes = [
            f"{n_scanned} views are scanned already; {len(stops)} remain" + (f" ({stop_list})" if stop_list else "")
        ]
        if self.approach_path is not None and clearance is not None:
            goal = f"view {stops[0]}" if stops else "home"
            moves = len(self.approach_path) - 1
            notes.append(
                f"the arm is not where the plan continues; a new path to {goal} was planned: {moves} moves, nearest "
                f"{1000 * clearance.distance[0]:.1f} mm ({clearance.between[0] or 'nothing near'})"
            )
        return notes


def plan_resume(
    plan: ExecutionPlan,
    scanned_stops: Collection[int],
    state: RobotState,
    checker: CollisionChecker,
    limits: JointLimits,
    seed: int,
) -> RemainingMotion:
    """Plan the remaining motion of an execution.

    Args:
        plan: the segments of the execution.
        scanned_stops: numbers of the confirmed views.
        state: of the controller; the arm is at rest.
        checker: of the cell that the plan was checked in.
        limits: of the plan.
        seed: of the path search.

    Raises:
        DriverFailureError: if no path is found from the current position.
    """
    segments = plan.segments
    # A sweep has several segments and is repeated from the first.
    first = next(
        (index for index, segment in enumerate(segments) if segment.stop and segment.stop not in scanned_stops),
        next((index for index, segment in enumerate(segments) if not segment.stop), len(segments)),
    )
    # Later confirmed views (the scan of an earlier one is damaged) are passed without a scan.
    remaining_segments = tuple(
        replace(segment, stop=0, view=-1, pose=0) if segment.stop in scanned_stops else segment
        for segment in segments[first:]
    )
    if not remaining_segments:
        return RemainingMotion(ExecutionPlan(state.q, (), 0.0), None)
    before = segments[first - 1].via[-1] if first else plan.start
    approach: Floats | None = None
    if not is_at(before, state):
        segment = remaining_segments[0]
        if is_at(segment.via[-1], state):  # it arrived, and the scan was lost
            remaining_segments = (replace(segment, via=segment.via[-1:]), *remaining_segments[1:])
        else:
            approach = _approach_path(segment, state, checker, limits, seed)
            remaining_segments = (replace(segment, via=approach[1:]), *remaining_segments[1:])
    return RemainingMotion(ExecutionPlan(state.q, remaining_segments, plan.planned_seconds), approach)


def _approach_path(
    segment: Segment, state: RobotState, checker: CollisionChecker, limits: JointLimits, seed: int
) -> Floats:
    """Plan a certified path (m, axes) from the current position to the end of a segment [rad]."""
    here = np.clip(state.q, limits.lower, limits.upper)  # a count beyond a limit is a rounded limit
    if not is_at(here, state):
        raise DriverFailureError(
            f"the arm is at {format_axes(state.axes)}, outside the joint range of the plan, where no path is checked; "
            "nothing was moved: drive the arm by hand to a collision-free position, or home, and resume again"
        )
    result = path.connect(here, segment.via[-1], checker, limits, np.random.default_rng([seed, segment.stop]))
    if result.via is None:
        blocker = next(iter((*checker.contacts(here), *checker.contacts(segment.via[-1]))), "")
        near = f" ({blocker})" if blocker else ""
        raise DriverFailureError(
            f"no path from the current position {format_axes(state.axes)} to {segment.goal}: "
            f"{result.status.sentence}{near}; nothing was moved: drive the arm by hand to a collision-free "
            "position, or home, and resume again"
        )
    return result.via
