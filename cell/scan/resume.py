"""Going on with an execution that was stopped: what is left of it, and the way from where the arm stands now.

A view is confirmed by its scan on disk, whole and unchanged; the rest is driven as planned, from the first view that
is not confirmed. Where the arm does not stand at the end of the leg before it, a new collision-free way to that view
is planned in the cell that the plan was checked in.
"""

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from cell.errors import DriverFailureError
from cell.scan.execute import stands_at
from cell.scan.legs import Leg, Legs
from drivers.contract import RobotState
from drivers.setpoints import format_axes
from planner.path import path
from planner.ports import CollisionChecker, JointLimits
from planner.values import Floats


@dataclass(frozen=True, slots=True, eq=False)
class Rest:
    """What is left to be driven.

    Attributes:
        legs: from where the arm stands, home at the end.
        way: (m, 6) the newly planned way to the first of them [rad]; None where the arm stands where the plan goes on.
        stops: numbers of the views that are still to be scanned.
    """

    legs: Legs
    way: Floats | None
    stops: tuple[int, ...]


def rest_of(
    legs: Legs, done: Collection[int], state: RobotState, checker: CollisionChecker, limits: JointLimits, seed: int
) -> Rest:
    """What is left of an execution.

    Args:
        legs: all that was to be driven.
        done: numbers of the views whose scans are confirmed.
        state: of the controller; the arm stands.
        checker: of the cell that the plan was checked in.
        limits: of the plan.
        seed: of the search for a way.

    Raises:
        DriverFailureError: if no way is found from where the arm stands.
    """
    # A view that sweeps has several legs; it is begun anew from the first.
    first = next(
        (index for index, leg in enumerate(legs.legs) if leg.stop and leg.stop not in done),
        next((index for index, leg in enumerate(legs.legs) if not leg.stop), len(legs.legs)),
    )
    # Views behind it that are confirmed (its own scan was damaged) are driven through and not scanned again.
    left = tuple(replace(leg, stop=0, view=-1, pose=0) if leg.stop in done else leg for leg in legs.legs[first:])
    stops = tuple(dict.fromkeys(leg.stop for leg in left if leg.stop))
    if not left:
        return Rest(Legs(state.q, (), 0.0), None, ())
    before = legs.legs[first - 1].via[-1] if first else legs.start
    way: Floats | None = None
    if not stands_at(before, state):
        leg = left[0]
        if stands_at(leg.via[-1], state):  # it arrived, and the scan was not kept
            left = (replace(leg, via=leg.via[-1:]), *left[1:])
        else:
            way = _way(leg, state, checker, limits, seed)
            left = (replace(leg, via=way[1:]), *left[1:])
    return Rest(Legs(state.q, left, legs.planned_seconds), way, stops)


def _way(leg: Leg, state: RobotState, checker: CollisionChecker, limits: JointLimits, seed: int) -> Floats:
    """A certified way from where the arm stands to the end of a leg, (m, 6) [rad]."""
    here = np.clip(state.q, limits.lower, limits.upper)  # a count beyond a limit is a rounded limit
    if not stands_at(here, state):
        raise DriverFailureError(
            f"the arm stands at {format_axes(state.axes)}, outside the joint range of the plan, where no way is "
            "checked; nothing was moved: drive the arm by hand to a free place, or home, and resume again"
        )
    goal = f"view {leg.stop}" if leg.stop else "home"
    found = path.connect(here, leg.via[-1], checker, limits, np.random.default_rng([seed, leg.stop]))
    if found.via is None:
        blocker = next(iter((*checker.contacts(here), *checker.contacts(leg.via[-1]))), "")
        near = f" ({blocker})" if blocker else ""
        raise DriverFailureError(
            f"no way from where the arm stands, {format_axes(state.axes)}, to {goal}: {found.status.sentence}{near}; "
            "nothing was moved: drive the arm by hand to a free place, or home, and resume again"
        )
    return found.via
