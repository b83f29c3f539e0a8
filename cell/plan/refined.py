"""Fewer views by moving the chosen ones (`planner.viewpoints.refine`): poses that were no candidates become some.

Views that moved are appended to candidates, reach and matrix, so that every candidate keeps its number, and the views
are chosen again among all. Where no view can be left out nothing is appended.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from cell.plan.candidates import GROWN, arm_of
from cell.plan.problem import Problem
from cell.plan.request import Selected
from cell.plan.view_exchange import of_views
from planner.cover import CoverStatus
from planner.viewpoints.lines_of_sight import Targets
from planner.viewpoints.refine import Standing, fewer
from planner.viewpoints.viewpoints import Viewpoints, standing_at

BEYOND = 0.0005
"""Beyond the coverage asked for, a share of what is coverable: a plan whose views stay has as much on average."""

Append = Callable[[Problem, Viewpoints], Problem]
"""A problem with further viewpoints behind its candidates: all of them known as well as those there."""


def movable(problem: Problem) -> bool:
    """Whether views may be moved: their number counts, they are at rest and grown, and none is named by the user."""
    request, plan = problem.request, problem.request.plan
    free = not (plan.pinned or plan.banned) and plan.candidates == GROWN
    return free and request.exchangeable and request.goals is None and request.brief and problem.at_rest


def with_fewer(problem: Problem, selected: Selected, append: Append) -> tuple[Problem, Selected]:
    """Fewer views that measure as much of the held-out samples, as candidates of the problem; or what was given.

    Args:
        problem: what is asked.
        selected: views that were chosen for it.
        append: makes candidates of poses.
    """
    candidates, known, chosen = problem.candidates, problem.prediction, selected.cover.views
    M, features = problem.M.matrix().tocsc(), problem.M.features
    rows = np.diff(problem.M.indptr) > 0
    areas = np.where(rows, features.areas, 0.0) / max(float(features.areas[rows].sum()), 1e-300)
    least = max(problem.request.plan.coverage + BEYOND, float(selected.shares[0]))
    before = Standing(
        candidates.T_object_scanner[chosen, 0], candidates.standoff[chosen], np.arange(len(chosen)),
        np.zeros(len(chosen), dtype=np.bool_), M[:, chosen].toarray(),
    )  # fmt: skip
    arm = arm_of(problem.world, problem.kinematics, problem.checker, known.scanner, known.casters)
    after = fewer(
        before, Targets.of(features.points, features.normals), areas, lambda view: arm,
        goal=min(selected.target, float(areas[before.measured.any(axis=1)].sum())),
        short=lambda views: least - known.share_of_coverable(views.T_object_scanner[:, None]),
    )  # fmt: skip
    if len(after) == len(before):
        return problem, selected
    T = after.T_object_scanner[after.moved]
    aim = T[:, :3, 3] + after.distance[after.moved, None] * T[:, :3, 2]
    more = append(problem, standing_at(T, aim, candidates.face[chosen[after.origin[after.moved]]]))
    views = chosen[after.origin]
    views[after.moved] = len(candidates) + np.arange(len(T))
    coverable = np.diff(more.M.indptr) > 0
    free = replace(
        selected.cover, lower_bound=1, status=CoverStatus.BOUNDED, uncoverable_rows=np.flatnonzero(~coverable),
        coverable_area=float(features.areas[coverable].sum()),
    )  # fmt: skip
    cover, _ = of_views(free, more.M, views)
    share = more.prediction.share_of_coverable(more.candidates.T_object_scanner[cover.views])
    return more, replace(selected, cover=cover, shares=np.array([share]), sentence=cover.sentence)
