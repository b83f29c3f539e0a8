"""Angles of a rotary table between those at which views were looked for: the same views, a shorter motion.

A candidate stands in the part's frame, so that turning the table changes the joint solution that takes it, and not what
it measures, as long as its arm hides no more. To the solutions of each view of a plan those of its branch are added
that lie a little to either side of where it is taken.
"""

from collections.abc import Sequence

import numpy as np

from cell.plan.problem import Problem
from cell.plan.views import Groups
from cell.world.self_occlusion import SelfOcclusion
from planner.kinematics.rotary_table import ArmOnTable
from planner.kinematics.setpoints import from_steps, setpoints, to_steps
from planner.ports import ARM_AXES
from planner.tour.tour import Tour
from planner.values import Floats

STEPS = (1 / 2, 1 / 4), (1 / 8, 1 / 16)
"""Shares of the step between the angles of the scene: to either side of where a view is taken, first and then."""


def beside(
    problem: Problem, arm: SelfOcclusion, groups: Groups, motion: Tour, shares: Sequence[float]
) -> Groups | None:
    """The views of a motion, each with solutions beside the one that is taken; None where no table turns.

    Args:
        problem: candidates and cell.
        arm: what is left of each candidate's joint solutions.
        groups: the motion picked from.
        motion: through all of them.
        shares: of the step between the scene's angles, to either side.
    """
    chain = problem.kinematics
    if not isinstance(chain, ArmOnTable):
        return None
    step = 2 * np.pi / problem.world.scene.table.angles
    aside = step * np.concatenate([shares, np.negative(shares)])
    picks, found = groups.picked(motion), []
    for view, q in sorted(zip(motion.order.tolist(), motion.q, strict=True), key=lambda stop: stop[0]):
        own = groups.configurations[view][groups.owner[view] == picks[view]]
        found.append(np.concatenate([own, _solutions(problem, arm, chain, int(picks[view]), q, aside)]))
    return Groups(
        tuple(picks[k : k + 1] for k in range(len(picks))),
        tuple(np.full(len(q), pick) for q, pick in zip(found, picks, strict=True)),
        tuple(found),
    )


def _solutions(problem: Problem, arm: SelfOcclusion, chain: ArmOnTable, view: int, q: Floats, aside: Floats) -> Floats:
    """(m, 7) free joint solutions of a candidate nearest to q (7,), the table (n,) aside; they hide no more [rad]."""
    world = problem.world
    T_part_scanner = world.T_base_object @ problem.candidates.T_object_scanner[view, 0]
    angles = from_steps(to_steps(q[ARM_AXES] + aside))
    branches = chain.inverse_at(T_part_scanner @ np.linalg.inv(world.T_flange_scanner), angles)
    solved = setpoints(branches, chain.limits)
    found = []
    for side in range(len(angles)):
        own = solved.q[solved.pose == side]
        if len(own):
            found.append(own[np.argmin(np.abs(own - q).max(axis=1))])
    near = np.array(found).reshape(-1, len(q))
    near = near[problem.checker.free(near)]
    return near[arm.occludes_no_more(view, q, near)] if len(near) else near
