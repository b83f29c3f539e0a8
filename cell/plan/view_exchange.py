"""Views exchanged for others that measure as much, between selection and motion (`planner.order.equivalent_views`).

The cover's views go in; groups of candidates come out, one for each view of the plan. The motion picks one joint
solution of one member of each group, and what it picked becomes the plan. The number of views and the lower bound on it
stay what the cover says.

Less than full coverage is promised on held-out samples too, which the exchange does not see: there its views are looked
at on them, and fewer liberties taken where they fall short.
"""

import logging
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cell.plan.problem import Problem
from cell.plan.request import Selected
from cell.plan.views import Groups
from cell.rays.self_shading import OwnArm
from planner.cover import Cover, CoverStatus
from planner.measurability.matrix import Measurability
from planner.order.equivalent_views import Exchange, Matrix, exchange
from planner.order.tour import Tour
from planner.values import Ints

log = logging.getLogger(__name__)


def alone(arm: OwnArm, views: Ints) -> Groups:
    """Each view in a group of its own."""
    return _groups(arm, tuple(views[k : k + 1] for k in range(len(views))))


def groups(
    problem: Problem, arm: OwnArm, selected: Selected, usable: NDArray[np.bool_], rng: np.random.Generator
) -> Groups:
    """Exchange the cover's views for others with a shorter motion.

    Args:
        problem: the candidates, home and limits.
        arm: what is left of the matrix and of each candidate's joint solutions.
        selected: the cover, and the share of the matrix' coverable samples that it was to meet.
        usable: (V,) candidates that may be used.
        rng: source of randomness.
    """
    chosen, target = selected.cover, selected.target
    matrix = Matrix(arm.M.matrix(), arm.M.features.areas, usable)
    spare = chosen.covered_area - target * chosen.coverable_area if target < 1 else 0.0
    for allowed in (spare, 0.0) if spare > 0 else (0.0,):
        found = exchange(
            matrix, chosen.views, arm.configurations, problem.world.home, problem.limits, rng,
            pinned=chosen.pinned.tolist(), spare=allowed,
        )  # fmt: skip
        if target >= 1:
            _tell(found)
            return replace(_groups(arm, found.groups), straight_before=found.duration_before)
        poses = problem.candidates.T_object_scanner[found.views]
        if problem.prediction.share_of_coverable(poses) >= problem.request.plan.coverage:
            _tell(found)
            return replace(alone(arm, found.views), straight_before=found.duration_before)
    return alone(arm, chosen.views)


def shorter(exchanged: tuple[Groups, Tour], own: tuple[Groups, Tour]) -> tuple[Groups, Tour]:
    """The shorter of two motions; one that visits every view before one that does not."""
    return min(exchanged, own, key=lambda planned: (len(planned[1].dropped), planned[1].duration))


def settled(chosen: Cover, M: Measurability, motion: Tour, picks: Ints) -> tuple[Cover, Tour]:
    """The cover of the candidates that a motion picked, the one that adds the largest area first, and its motion.

    Args:
        chosen: the cover whose views were exchanged.
        M: the matrix.
        motion: its views are indices into `picks`; all are visited.
        picks: (n,) candidates.
    """
    if np.array_equal(picks, chosen.views):
        return chosen, motion
    matrix = Matrix(M.matrix(), M.features.areas, np.ones(M.shape[1], dtype=np.bool_))
    waiting = matrix.areas.copy()
    measured = [matrix.measured_by(int(view)) for view in picks]
    sequence: list[int] = []
    added: list[float] = []
    while len(sequence) < len(picks):
        gains = [-1.0 if k in sequence else float(waiting[rows].sum()) for k, rows in enumerate(measured)]
        best = int(np.argmax(gains))
        sequence.append(best)
        added.append(gains[best])
        waiting[measured[best]] = 0.0
    place = np.empty(len(picks), dtype=np.int64)
    place[sequence] = np.arange(len(picks))
    lower_bound = min(chosen.lower_bound, len(picks))
    cover = replace(
        chosen,
        views=picks[sequence],
        marginal_area=np.array(added),
        covered_area=float(matrix.areas[matrix.counts(picks.tolist()) > 0].sum()),
        lower_bound=lower_bound,
        status=CoverStatus.PROVEN if lower_bound == len(picks) else chosen.status,
    )
    view = np.where(motion.view >= 0, place[np.maximum(motion.view, 0)], -1)
    return cover, replace(motion, order=place[motion.order], view=view)


def _groups(arm: OwnArm, members: tuple[Ints, ...]) -> Groups:
    owner, configurations = [], []
    for group in members:
        solutions = [arm.configurations(int(view)) for view in group]
        owner.append(np.repeat(group, [len(q) for q in solutions]))
        configurations.append(np.concatenate(solutions))
    return Groups(members, tuple(owner), tuple(configurations))


def _tell(found: Exchange) -> None:
    log.info(
        "views exchanged for others that measure as much: straight moves of %.3f s before, %.3f s after; %d orderings",
        found.duration_before,
        found.duration,
        found.orderings,
    )
