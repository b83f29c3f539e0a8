"""Views that sweep: the sweeps that can be driven of each candidate that is asked about, looked at once and kept.

Reach asks whether every pose of a column can be taken up; here it is asked whether the way through all of them can be
driven on one joint branch (`planner.path.sweeps`). A candidate whose sweep cannot be driven is no view of the
plan. Base frame, metres, radians.
"""

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from cell.plan.problem import Problem
from cell.plan.request import Selected
from cell.plan.views import Driven, Groups, Next
from planner.measurability.matrix import Measurability
from planner.path.sweep_line import DEFAULT_SPEED
from planner.path.sweeps import DrivableSweeps, SweepTraversal, TimedSweep, find_sweeps, sweep_traversals
from planner.tour.tour import Tour


class SweepingViews:
    """Candidates of several poses, each driven as a line; see `cell.plan.views.Views`."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._speed = DEFAULT_SPEED.slowed(problem.limits, problem.world.limits)
        self._found: dict[int, DrivableSweeps] = {}
        self.shaded: Mapping[int, str] = {}

    @property
    def M(self) -> Measurability:
        """Measurability; the arm's shadow along a sweep is not judged."""
        return self._problem.M

    def still_measure(self, views: NDArray[np.int64]) -> bool:
        """Always: nothing is taken out of M."""
        return True

    def judge(self, views: NDArray[np.int64], motion: Tour) -> Next:
        """Nothing more to look at."""
        return Next.DONE

    def finer(self, groups: Groups, motion: Tour, shares: Sequence[float]) -> Groups | None:
        """None: no table turns a part that is swept."""
        return None

    def hides_no_more(self, views: NDArray[np.int64], before: Tour, motion: Tour) -> bool:
        """True: the arms of sweeps are not looked at."""
        return True

    def refusals(self, views: NDArray[np.int64]) -> Mapping[int, str]:
        """The reason for each of these candidates whose sweep cannot be driven at all: the most frequent one first."""
        told = {}
        for view in views.tolist():
            found = self._of(view)
            if not found.paths:
                reasons = Counter(refused.sentence for refused in found.refused)
                told[view] = "its sweep cannot be driven: " + "; ".join(reason for reason, _ in reasons.most_common(2))
        return told

    def groups(self, selected: Selected, usable: NDArray[np.bool_], rng: np.random.Generator) -> Groups:
        """Each view in a group of its own: where a sweep ends is not where it begins, so none is exchanged."""
        return self.alone(selected.cover.views)

    def alone(self, views: NDArray[np.int64]) -> Groups:
        """Each view in a group of its own, its joint solutions being where its sweeps begin."""
        paths = [self._of(int(view)).paths for view in views]
        return Groups(
            tuple(views[k : k + 1] for k in range(len(views))),
            tuple(np.full(len(own), view) for view, own in zip(views, paths, strict=True)),
            tuple(np.stack([path.q[0] for path in own]) for own in paths),
        )

    def traversals(self, views: NDArray[np.int64]) -> list[list[SweepTraversal]]:
        """The sweeps of each view as the motion takes them."""
        return [sweep_traversals(self._of(int(view)).paths) for view in views]

    def driven(self, views: NDArray[np.int64], motion: Tour) -> Driven:
        """The sweeps that a motion drives, their poses and their timing."""
        problem, world = self._problem, self._problem.world
        chosen = zip(motion.order.tolist(), motion.choice.tolist(), strict=True)
        sweeps = tuple(self._of(int(views[view])).paths[choice] for view, choice in chosen)
        q = np.stack([path.measured_q for path in sweeps])
        T_base_scanner = problem.kinematics.forward(q.reshape(-1, 6)) @ world.T_flange_scanner
        poses = (np.linalg.inv(world.T_base_object) @ T_base_scanner).reshape(*q.shape[:2], 4, 4)
        entered = zip(motion.entered.tolist(), sweeps, strict=True)
        lines = {row: TimedSweep(path, world.T_flange_scanner, problem.kinematics) for row, path in entered}
        return Driven(poses, sweeps, lines, problem.prediction.seen(poses), None)

    def _of(self, view: int) -> DrivableSweeps:
        if view not in self._found:
            problem, world = self._problem, self._problem.world
            column = world.T_base_object @ problem.candidates.T_object_scanner[view]
            self._found[view] = find_sweeps(
                column, world.T_flange_scanner, problem.kinematics, problem.limits, self._speed, problem.checker
            )
        return self._found[view]
