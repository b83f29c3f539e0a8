"""Refine candidates of a batch towards more uncovered surface (`planner.viewpoints.refinement`).

A candidate is aimed at one patch. The search starts from the best candidates and finds views of several patches, which
adds 10 to 25 %. Each is refined as if it were the only view; the selection then uses all candidates. The search is
evaluated on the scouts, the selection on the rows of the matrix.
"""

from cell.plan.candidates import GROWN, view_evaluator
from cell.plan.pose_search import Append
from cell.plan.selection import SelectionProblem
from planner.values import Ints
from planner.viewpoints.lines_of_sight import RayTargets
from planner.viewpoints.refinement import improve_views
from planner.viewpoints.viewpoints import pick_viewpoints, viewpoints_from_poses


def with_refined_candidates(problem: SelectionProblem, views: Ints, append: Append) -> SelectionProblem:
    """Return the problem with refined poses appended to its candidates, if candidates may be grown.

    Args:
        problem: whose held-out samples are the scouts of the batch.
        views: (n,) candidates to start from.
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
