"""Refine candidates of a batch towards more uncovered surface.

A candidate is aimed at one patch. The search starts from the best candidates and finds views of several patches, which
adds 8 to 25 %. Each is refined as if it were the only view; the selection then uses all candidates. The search is
evaluated on the scouts, the selection on the rows of the matrix. It is a pattern search (Kolda, Lewis, Torczon 2003,
doi:10.1137/S003614450242889): nothing is random, and the measured area never falls.
"""

import numpy as np

from cell.plan.candidates import GROWN, view_evaluator
from cell.plan.pose_search import Append
from cell.plan.selection import SelectionProblem
from planner.values import Bools, Floats, Ints
from planner.viewpoints.growth import ViewEvaluator
from planner.viewpoints.lines_of_sight import RayTargets
from planner.viewpoints.pose_sampling import perturb_pose
from planner.viewpoints.viewpoints import viewpoints_from_poses

_SCALES = (1.0, 0.5, 0.25)  # largest steps of the rounds, as shares of those of `perturb_pose`
_POSES = 48  # alternatives of a view in a round
_TESTED = 6  # best alternatives that are tested for reachability


def with_refined_candidates(problem: SelectionProblem, views: Ints, append: Append) -> SelectionProblem:
    """Return the problem with refined poses appended to its candidates, if candidates may be grown.

    Args:
        problem: whose held-out samples are the scouts of the batch.
        views: (n,) candidates to start from.
        append: makes candidates of poses.
    """
    if problem.request.plan.candidates != GROWN:
        return problem
    known, candidates = problem.prediction, problem.candidates.pick(views)
    scouts, distance = known.samples, candidates.standoff
    arm = view_evaluator(problem.cell, known.scanner, known.casters)
    targets = RayTargets.of(scouts.points, scouts.normals)
    T, moved = improve_views(candidates.T_object_scanner[:, 0], distance, targets, scouts.areas, arm)
    if not moved.any():
        return problem
    aim = T[:, :3, 3] + distance[:, None] * T[:, :3, 2]
    return append(problem, viewpoints_from_poses(T[moved], aim[moved], candidates.face[moved]))


def improve_views(
    T_object_scanner: Floats, distance: Floats, targets: RayTargets, areas: Floats, evaluator: ViewEvaluator
) -> tuple[Floats, Bools]:
    """Move each viewpoint to a pose that measures a larger area, regardless of the others, or keep it.

    Args:
        T_object_scanner: (n, 4, 4) initial viewpoints [m].
        distance: (n,) to the point at which each is aimed [m].
        targets: the S samples.
        areas: (S,) area of each in any unit; 0 if it does not count.
        evaluator: scanner, occluders and reachability.

    Returns:
        (n, 4, 4) viewpoints and (n,) whether each moved.
    """
    poses, rows = T_object_scanner.copy(), np.flatnonzero(areas > 0)
    measured = areas[rows] @ evaluator.measured(poses, targets, rows)
    moved = np.zeros(len(poses), dtype=np.bool_)
    for view in range(len(poses)):
        for number, scale in enumerate(_SCALES):
            elements = (number * _POSES, (number + 1) * _POSES)
            T = perturb_pose(poses[view], float(distance[view]), scale, elements, 0)
            threshold = float(measured[view]) * (1 + 1e-9)
            there = areas[rows] @ evaluator.measured(T, targets, rows, (areas[rows], threshold))
            best = np.argsort(-there, kind="stable")[:_TESTED]
            best = best[there[best] > threshold]
            if len(best):
                best = best[evaluator.are_reachable(T[best, None] @ evaluator.T_view_scanner)]
            if len(best):
                poses[view], measured[view], moved[view] = T[best[0]], there[best[0]], True
    return poses, moved
