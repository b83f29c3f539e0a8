"""Fewer views by moving the chosen ones (`planner.viewpoints.refinement`): poses that were no candidates become some.

The views that were chosen without it are where it begins, and what comes out has fewer of them and measures no less of
the held-out samples; else nothing is changed. Views that moved are appended to candidates, reach and matrix, so that
every candidate keeps its number, and the views are chosen again among all.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from cell.errors import UnreachableError
from cell.plan.candidates import GROWN, arm_of
from cell.plan.connected_plan import ConnectedPlan
from cell.plan.problem import Problem
from cell.plan.request import WORK, Selected
from cell.plan.view_exchange import of_views
from cell.plan.view_plan import first_choice
from planner.cover import CoverStatus
from planner.viewpoints.lines_of_sight import RayTargets
from planner.viewpoints.refinement import ViewState, reduce_views
from planner.viewpoints.viewpoints import Viewpoints, viewpoints_from_poses

BEYOND = 0.0005
"""Beyond the coverage asked for, a share of what is coverable: a plan whose views stay has as much on average."""
MARGIN = 0.0002
"""Beyond what the views measured that did not move: as much as a shorter motion may cost."""

Append = Callable[[Problem, Viewpoints], Problem]
"""A problem with further viewpoints behind its candidates: all of them known as well as those there."""

Choice = tuple[Problem, Selected]
"""What is asked, and the views that were chosen for it."""


def movable(problem: Problem) -> bool:
    """Whether views may be moved: their number counts, they are at rest and grown, and none is named by the user."""
    request, plan = problem.request, problem.request.plan
    free = not (plan.pinned or plan.banned) and plan.candidates == GROWN
    return free and request.exchangeable and request.goals is None and request.brief and problem.at_rest


def with_fewer(problem: Problem, selected: Selected, append: Append, rng: np.random.Generator) -> Choice:
    """Fewer views that measure as much of the held-out samples, as candidates of the problem; or what was given.

    Args:
        problem: what is asked.
        selected: views that were chosen for it.
        append: makes candidates of poses.
        rng: randomness of the selection among candidates of which some are the views that were moved.
    """
    if not selected.keeps(problem.request.asked):
        return problem, selected
    after = _moved(problem, selected)
    if len(after) == len(selected.cover.views):
        return problem, selected
    more, moved = _appended(problem, selected, after, append)
    # Where all can be chosen from, fewer still may do; what measures less than the views before does not.
    found = first_choice(more, rng, looked=moved, look=WORK)
    fewer_still = len(found.cover.views) < len(after) and found.shares[0] >= _least(problem, selected)
    return more, found if fewer_still else moved.bounded(found)


def connected(
    moved: Choice, unmoved: Choice, connect: Callable[[Problem, Selected], ConnectedPlan]
) -> tuple[Problem, ConnectedPlan]:
    """The choice with views that moved, connected, and the problem that it answers; or the one without.

    Where a view that moved cannot be connected, what is chosen in its place may be worse than what was chosen before
    any moved: then that is connected as well, and taken where it has fewer views or measures more.
    """
    problem, selected = moved
    plan = connect(problem, selected)
    if selected is unmoved[1] or plan.selected is selected:
        return problem, plan
    try:
        before = connect(*unmoved)
    except UnreachableError:  # what moved is all that can be connected
        return problem, plan
    worse = len(plan.cover.views) > len(before.cover.views) or plan.visible.area < before.visible.area
    return (unmoved[0], before) if worse else (problem, plan)


def _least(problem: Problem, selected: Selected) -> float:
    """Share of what is coverable that moved views have to measure of the held-out samples."""
    return max(problem.request.plan.coverage + BEYOND, float(selected.shares[0]) + MARGIN)


def _moved(problem: Problem, selected: Selected) -> ViewState:
    """The views where they stand, or fewer of them elsewhere."""
    candidates, known, chosen = problem.candidates, problem.prediction, selected.cover.views
    M, features = problem.M.matrix().tocsc(), problem.M.samples
    rows, least = np.diff(problem.M.indptr) > 0, _least(problem, selected)
    areas = np.where(rows, features.areas, 0.0) / max(float(features.areas[rows].sum()), 1e-300)
    before = ViewState(
        candidates.T_object_scanner[chosen, 0], candidates.standoff[chosen], np.arange(len(chosen)),
        np.zeros(len(chosen), dtype=np.bool_), M[:, chosen].toarray(),
    )  # fmt: skip
    arm = arm_of(problem.world, problem.kinematics, problem.checker, known.scanner, known.casters)
    return reduce_views(
        before, RayTargets.of(features.points, features.normals), areas, lambda view: arm,
        goal=min(selected.target, float(areas[before.measured.any(axis=1)].sum())),
        shortfall=lambda views: least - known.share_of_coverable(views.T_object_scanner[:, None]),
    )  # fmt: skip


def _appended(problem: Problem, selected: Selected, after: ViewState, append: Append) -> Choice:
    """The problem with the views that moved behind its candidates, and all views as an answer to it."""
    candidates, chosen = problem.candidates, selected.cover.views
    T = after.T_object_scanner[after.moved]
    aim = T[:, :3, 3] + after.distance[after.moved, None] * T[:, :3, 2]
    more = append(problem, viewpoints_from_poses(T, aim, candidates.face[chosen[after.origin[after.moved]]]))
    views = chosen[after.origin]
    views[after.moved] = len(candidates) + np.arange(len(T))
    coverable = np.diff(more.M.indptr) > 0
    free = replace(
        selected.cover, lower_bound=1, status=CoverStatus.BOUNDED, uncoverable_rows=np.flatnonzero(~coverable),
        coverable_area=float(more.M.samples.areas[coverable].sum()),
    )  # fmt: skip
    cover, _ = of_views(free, more.M, views)
    share = more.prediction.share_of_coverable(more.candidates.T_object_scanner[cover.views])
    moved = replace(selected, cover=cover, shares=np.array([share]), sentence=cover.sentence)
    return more, replace(moved, targets=np.minimum(selected.targets, moved.claimed))
