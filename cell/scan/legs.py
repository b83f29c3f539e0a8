"""What an execution drives: the legs of a plan's motion from view to view, all of them or those to one view and back.

A leg is driven in one move through its via points, as set-points of 1e-4 deg; the plan checked exactly these. A sweep
has a leg for each of its poses.
"""

from dataclasses import dataclass

import numpy as np

from cell.errors import UsageError
from drivers.setpoints import SetPoints, from_rad
from planner.timing.motion import Motion, retime
from planner.values import Floats

AT_START = 100
"""Counts by which the arm may stand off where a leg begins: 0.01 deg."""


@dataclass(frozen=True, slots=True, eq=False)
class Leg:
    """One move of the execution.

    Attributes:
        via: (n, 6) via points [rad], n at least 1; the last is where the arm stands afterwards.
        stop: number of the view that is scanned there, from 1 in visiting order; 0 for none.
        view: its candidate, row of viewpoints.npz; -1 for none.
        pose: pose of the view's column; 0 of a view at rest.
    """

    via: Floats
    stop: int
    view: int
    pose: int = 0

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
        view, pose = np.full(len(via), -1), np.full(len(via), -1)
        view[np.cumsum(counts)] = [leg.view for leg in self.legs]
        pose[np.cumsum(counts)] = [leg.pose if leg.stop else -1 for leg in self.legs]
        return retime(via, np.repeat(np.arange(len(counts) + 1), [1, *counts]), view, planned.limits, pose=pose)


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
    rows = np.flatnonzero(motion.view >= 0)
    number = np.cumsum(np.diff(motion.view[rows], prepend=-1) != 0)  # of the view at each of these via points
    if stop is None:
        legs = [
            Leg(motion.via_q[begin + 1 : end + 1], count, int(motion.view[end]), int(motion.pose[end]))
            for begin, end, count in zip([0, *rows.tolist()], rows.tolist(), number.tolist(), strict=False)
        ]
        last = int(rows[-1]) if len(rows) else 0
        if len(motion.via_q) - 1 > last:
            legs.append(Leg(motion.via_q[last + 1 :], 0, -1))
        return Legs(motion.via_q[0], tuple(legs), motion.duration)
    if not 1 <= stop <= number.max(initial=0):
        raise UsageError(f"--view {stop} does not exist; the plan has the views 1 to {number.max(initial=0)}")
    at = rows[number == stop]
    forward = bool(motion.via_t[at[-1]] <= motion.duration - motion.via_t[at[0]])
    way, t = (motion.via_q, motion.via_t) if forward else (motion.via_q[::-1], motion.duration - motion.via_t[::-1])
    taken = at if forward else (len(way) - 1 - at)[::-1]
    poses = motion.pose[at] if forward else motion.pose[at][::-1]
    there = [
        Leg(way[begin + 1 : end + 1], stop, int(motion.view[at[0]]), pose)
        for begin, end, pose in zip([0, *taken.tolist()], taken.tolist(), poses.tolist(), strict=False)
    ]
    back = Leg(way[: taken[-1]][::-1], 0, -1)
    return Legs(way[0], (*there, back), 2 * float(t[taken[-1]]))
