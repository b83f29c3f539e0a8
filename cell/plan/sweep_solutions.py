"""The sweeps that can be driven of each candidate that is asked about, looked at once and kept.

Reach asks whether every pose of a column can be taken up; here it is asked whether the way through all of them can be
driven on one joint branch (`planner.path.sweeps.motion`). A candidate whose sweep cannot be driven is no view of the
plan. Base frame, metres, radians.
"""

from collections import Counter
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from cell.plan.view_exchange import Groups
from cell.world.world import World
from planner.order.tour import Tour
from planner.path.sweeps.line import DEFAULT_SPEED
from planner.path.sweeps.motion import sweeps_of
from planner.path.sweeps.passage import Passage
from planner.path.sweeps.path import SweepPath, Sweeps, passages_of
from planner.path.sweeps.timing import DrivenSweep
from planner.ports import CollisionChecker, Floats, JointLimits, Kinematics
from planner.timing.motion import TimedLine
from planner.viewpoints.viewpoints import Viewpoints


class SweepSolutions:
    """The drivable sweeps of candidates.

    Args:
        candidates: columns of poses.
        world: placement and mount.
        kinematics: of the arm.
        checker: of the cell.
        limits: of the axes, scaled to the speed that is wanted.
    """

    def __init__(
        self,
        candidates: Viewpoints,
        world: World,
        kinematics: Kinematics,
        checker: CollisionChecker,
        limits: JointLimits,
    ) -> None:
        self._candidates, self._world, self._kinematics = candidates, world, kinematics
        self._checker, self._limits = checker, limits
        full = world.limits
        self._speed = DEFAULT_SPEED.scaled(
            _fraction(limits.velocity, full.velocity), _fraction(limits.acceleration, full.acceleration)
        )
        self._found: dict[int, Sweeps] = {}

    def paths(self, view: int) -> tuple[SweepPath, ...]:
        """Every way to drive a candidate's sweep; none where it cannot be driven."""
        return self._of(view).paths

    def refusals(self, views: Iterable[int]) -> dict[int, str]:
        """The reason for each of these candidates whose sweep cannot be driven at all: the most frequent one first."""
        told = {}
        for view in views:
            found = self._of(view)
            if not found.paths:
                reasons = Counter(refused.sentence for refused in found.refused)
                told[view] = "its sweep cannot be driven: " + "; ".join(reason for reason, _ in reasons.most_common(2))
        return told

    def groups(self, views: NDArray[np.int64]) -> Groups:
        """Each view in a group of its own, its joint solutions being where its sweeps begin."""
        paths = [self.paths(int(view)) for view in views]
        return Groups(
            tuple(views[k : k + 1] for k in range(len(views))),
            tuple(np.full(len(own), view) for view, own in zip(views, paths, strict=True)),
            tuple(np.stack([path.q[0] for path in own]) for own in paths),
        )

    def passages(self, views: NDArray[np.int64]) -> list[list[Passage]]:
        """The sweeps of each view as the motion takes them."""
        return [passages_of(self.paths(int(view))) for view in views]

    def driven(self, views: NDArray[np.int64], motion: Tour) -> tuple[SweepPath, ...]:
        """The sweeps that a motion drives, in visiting order; its views are indices into `views`."""
        chosen = zip(motion.order.tolist(), motion.choice.tolist(), strict=True)
        return tuple(self.paths(int(views[view]))[choice] for view, choice in chosen)

    def poses(self, driven: tuple[SweepPath, ...]) -> Floats:
        """(n, K, 4, 4) T_object_scanner [m] of the rounded joint angles at the measuring poses of sweeps."""
        q = np.stack([path.measured_q for path in driven])
        T = self._kinematics.forward(q.reshape(-1, 6)) @ self._world.T_flange_scanner
        found: Floats = (np.linalg.inv(self._world.T_base_object) @ T).reshape(*q.shape[:2], 4, 4)
        return found

    def lines(self, driven: tuple[SweepPath, ...], motion: Tour) -> dict[int, TimedLine]:
        """The timing of these sweeps, by the via point at which each begins."""
        return {
            int(row): DrivenSweep(path, self._world.T_flange_scanner, self._kinematics)
            for row, path in zip(motion.entered, driven, strict=True)
        }

    def _of(self, view: int) -> Sweeps:
        if view not in self._found:
            column = self._world.T_base_object @ self._candidates.T_object_scanner[view]
            self._found[view] = sweeps_of(
                column, self._world.T_flange_scanner, self._kinematics, self._limits, self._speed, self._checker
            )
        return self._found[view]


def _fraction(limit: Floats, full: Floats) -> float:
    """The fraction to which limits were scaled; those that are not finite say nothing."""
    known = np.isfinite(limit) & np.isfinite(full)
    return float((limit[known] / full[known]).min(initial=1.0))
