"""Views at which the arm stands still: what their own arm leaves of them, and the views that may stand in for them.

Arm, bracket and housing hide as well, differently at every configuration: a view that its own arm shades is taken with
other joint solutions; where all of them do it, views are chosen again with what they leave of the view
(`cell.world.self_occlusion`). Views are exchanged for others that measure as much and make the motion shorter
(`cell.plan.view_exchange`).
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from cell.plan import finer_angles, view_exchange
from cell.plan.problem import Problem
from cell.plan.request import Selected
from cell.plan.views import Driven, Groups, Next
from cell.world.self_occlusion import OcclusionUpdate, SelfOcclusion, arm_caster, coverage_with_arm
from planner.measurability.coverage import coverage_of_views
from planner.measurability.matrix import Measurability
from planner.tour.tour import Tour

_AFTER = {
    OcclusionUpdate.CLEAR: Next.DONE,
    OcclusionUpdate.OTHER_CONFIGURATIONS: Next.CONNECT,
    OcclusionUpdate.LESS_MEASURED: Next.CHOOSE,
}


class ViewsAtRest:
    """Candidates of one pose, with what their own arm leaves of them; see `cell.plan.views.Views`."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._arm = SelfOcclusion(
            problem.M, problem.reached, problem.candidates, problem.world, problem.prediction.scanner
        )

    @property
    def M(self) -> Measurability:
        """Measurability as the arms leave it."""
        return self._arm.M

    @property
    def shaded(self) -> Mapping[int, str]:
        """Candidates from which an arm took samples, each with a sentence."""
        return self._arm.reasons

    def refusals(self, views: NDArray[np.int64]) -> Mapping[int, str]:
        """None: a reachable view at rest is refused by its paths alone."""
        return {}

    def still_measure(self, views: NDArray[np.int64]) -> bool:
        """A first look at the arms, before a motion is planned for nothing."""
        first = np.stack([self._arm.configurations(int(view))[0] for view in views])
        return self._arm.update(views, first) is not OcclusionUpdate.LESS_MEASURED

    def groups(self, selected: Selected, usable: NDArray[np.bool_], rng: np.random.Generator) -> Groups:
        """Each view with those that may stand in for it, where the request allows it."""
        if not self._problem.request.exchangeable:
            return self.alone(selected.cover.views)
        return view_exchange.groups(self._problem, self._arm, selected, usable, rng)

    def alone(self, views: NDArray[np.int64]) -> Groups:
        """Each view in a group of its own."""
        return view_exchange.alone(self._arm, views)

    def traversals(self, views: NDArray[np.int64]) -> None:
        """The arm stands still."""
        return

    def judge(self, views: NDArray[np.int64], motion: Tour) -> Next:
        """Look at the arms where the motion stops."""
        return _AFTER[self._arm.update(views[motion.order], motion.q)]

    def finer(self, groups: Groups, motion: Tour, shares: Sequence[float]) -> Groups | None:
        """The views of the motion with solutions at further angles of a rotary table; None where there is none."""
        return finer_angles.beside(self._problem, self._arm, groups, motion, shares)

    def hides_no_more(self, views: NDArray[np.int64], before: Tour, motion: Tour) -> bool:
        """Whether at each of (n,) candidates the arm hides nothing that it showed in the motion before."""
        taken = dict(zip(before.order.tolist(), before.q, strict=True))
        stops = zip(motion.order.tolist(), motion.q, strict=True)
        return all(self._arm.occludes_no_more(int(views[k]), taken[k], q[None])[0] for k, q in stops)

    def driven(self, views: NDArray[np.int64], motion: Tour) -> Driven:
        """The stops, and what they measure with the arm in the way."""
        world, prediction = self._problem.world, self._problem.prediction
        T_base_flange = self._problem.kinematics.forward(motion.q)
        T_object_scanner = np.linalg.inv(world.T_base_object) @ T_base_flange @ world.T_flange_scanner
        poses = T_object_scanner[:, None]
        seen = prediction.seen(poses)
        visible = coverage_of_views(seen, prediction.samples)
        arms = [arm_caster(world, q, T, prediction.scanner) for q, T in zip(motion.q, T_object_scanner, strict=True)]
        near = any(caster is not None for caster in arms)
        with_arm = coverage_with_arm(prediction, poses, arms, visible.covered) if near else visible.fraction
        return Driven(poses, (), {}, seen, with_arm)
