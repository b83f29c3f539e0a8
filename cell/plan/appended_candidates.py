"""Further candidates behind those that there are, so that every candidate keeps its number (`id` of plan.json).

Poses that a person gives (`cell.edit`) and views that were moved (`cell.plan.refined`) become rows of viewpoints and
reach and columns of the matrix, made by the functions that made the others.
"""

from collections.abc import Sequence
from dataclasses import replace

from cell import scanners
from cell.plan import steps
from cell.plan.problem import Problem
from cell.plan.refined import Append
from cell.plan.steps import Cell, Job, PlanSession
from cell.world.measurability import PartSurface
from planner.kinematics.reach import join_reach
from planner.measurability.matrix import Measurability, join_measurability
from planner.ports import Progress, RayCaster, Scanner
from planner.viewpoints.viewpoints import Viewpoints, join_viewpoints


def _quiet(done: int, total: int) -> None:
    """A few poses take no time worth telling."""


def appended(
    session: PlanSession, job: Job, surface: PartSurface, casters: Sequence[RayCaster],
    known: tuple[Viewpoints, Measurability],
    views: Viewpoints, progress: Progress = _quiet,
) -> tuple[Viewpoints, Measurability, Scanner]:  # fmt: skip
    """Candidates and their matrix with further ones behind them, so that every candidate keeps its number.

    Returns:
        Both, and the scanner that keeps the limit on sigma.
    """
    more, scanner = steps.columns(session, job, surface, casters, views, progress, may_be_empty=True)
    candidates = join_viewpoints([known[0], scanners.sweep_columns(job.scanner, views)])
    return candidates, join_measurability([known[1], more]), scanner


def behind(session: PlanSession, job: Job, cell: Cell, surface: PartSurface) -> Append:
    """Makes candidates of further viewpoints of a problem; the cache keeps no matrix of theirs."""

    def append(problem: Problem, views: Viewpoints) -> Problem:
        rows, known = replace(surface, samples=problem.M.samples), problem.prediction
        reached = join_reach([problem.reached, steps.reach_of(job, cell, views)])
        candidates, M, _ = appended(
            replace(session, use_cache=False), job, rows, known.casters, (problem.candidates, problem.M), views
        )
        known = known.with_more(candidates.T_object_scanner[len(problem.candidates) :])
        return replace(problem, candidates=candidates, reached=reached, M=M, prediction=known)

    return append
