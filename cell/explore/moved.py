"""Candidates moved to where they measure more of what is open (`planner.viewpoints.refinement`).

A candidate looks at one patch of what is open, along its normal or however the arm gets there. The view that measures
most of several is searched for from the best of them: what a view adds grows by a tenth to a quarter. Each is moved as
if it were the only one; which of them stand together is chosen among all, those that did not move included. The search
asks the scouts, the choice the rows of the matrix, which it has not seen.
"""

from cell.plan.candidates import GROWN, view_evaluator
from cell.plan.improvement import Append
from cell.plan.selection import SelectionProblem
from planner.values import Ints
from planner.viewpoints.lines_of_sight import RayTargets
from planner.viewpoints.refinement import improve_views
from planner.viewpoints.viewpoints import pick_viewpoints, viewpoints_from_poses


def with_better(problem: SelectionProblem, views: Ints, append: Append) -> SelectionProblem:
    """The problem with poses behind its candidates at which these measure more of what is open, if any may be grown.

    Args:
        problem: what is asked; its held-out samples are a stage's scouts.
        views: (n,) candidates from which is searched.
        append: makes candidates of poses.
    """
    if problem.request.plan.candidates != GROWN:
        return problem
    known, candidates = problem.prediction, pick_viewpoints(problem.candidates, views)
    scouts, distance = known.samples, candidates.standoff
    arm = view_evaluator(problem.cell, known.scanner, known.casters)
    targets = RayTargets.of(scouts.points, scouts.normals)
    T, moved = improve_views(candidates.T_object_scanner[:, 0], distance, targets, scouts.areas, arm)
    if not moved.any():
        return problem
    aim = T[:, :3, 3] + distance[:, None] * T[:, :3, 2]
    return append(problem, viewpoints_from_poses(T[moved], aim[moved], candidates.face[moved]))
