"""The views of a plan where the part stands elsewhere: they move with it, and the arm is asked for them again.

In the part's own frame nothing changes: candidates, samples and what the part itself hides stay what they were. Reach,
and what post, fixtures and table hide, are asked anew for every candidate.
"""

from dataclasses import dataclass

import numpy as np

from cell import scanners
from cell.edit.views import EditedViews
from cell.errors import UnreachableError
from cell.plan import files as plan_files
from cell.plan import steps
from cell.plan.steps import Cell, Job, Measured, PlanSession
from cell.runs.run import Run
from cell.session import ProgressReporter
from cell.world.measurability import PartSurface
from planner.kinematics.reach import Reach, Verdict
from planner.measurability.matrix import spread_measurability
from planner.viewpoints.viewpoints import Viewpoints, pick_viewpoints


@dataclass(frozen=True, slots=True, eq=False)
class Before:
    """The run that is edited, as its files say it.

    Attributes:
        run: a finished plan.
        candidates: its viewpoints.
        reached: their verdicts and joint solutions, where the part stood.
        moved: whether the part stands elsewhere now.
    """

    run: Run
    candidates: Viewpoints
    reached: Reach
    moved: bool


def measured_anew(before: Before, session: PlanSession, job: Job, surface: PartSurface, cell: Cell) -> Measured:
    """Candidates of the run with reach and matrix where the part stands now."""
    views, _ = scanners.viewpoints_of_columns(job.scanner, before.candidates)
    with session.stage("reach") as progress:
        reached = steps.reach_of(job, cell, views, progress)
    with session.stage("measurability") as progress:
        casters, usable = steps.casters_of(surface, cell), np.flatnonzero(reached.reachable)
        M, scanner = steps.columns(
            session, job, surface, casters, pick_viewpoints(views, usable), progress, may_be_empty=True
        )
        M = spread_measurability(M, usable, len(views))
    plan_files.write_viewpoints(session.folder, before.candidates)
    plan_files.write_reach(session.folder, reached)
    plan_files.write_measurability(session.folder, M)
    return Measured(scanners.sweep_columns(job.scanner, views), reached, M, scanner, casters)


def still_reached(
    before: Before, edited: EditedViews, reached: Reach, reporter: ProgressReporter, *, leave_out: bool
) -> EditedViews:
    """The views that the arm takes up where the part stands now.

    Args:
        before: the run.
        edited: all of them.
        reached: of all candidates, there.
        reporter: is told which are left out.
        leave_out: whether views may be.

    Raises:
        UnreachableError: naming each view that it does not take up, if none may be left out, or none is left.
    """
    lost = {view: f"{edited.called[view]} ({_why(reached, view)})" for view in _lost(edited, reached)}
    if lost and (not leave_out or len(lost) == len(edited.views)):
        alone = before.run.is_single_setup
        way = "give repair to leave them out and add the fewest others, or move the part" if alone else "move the part"
        raise UnreachableError(f"where the part stands now the arm cannot take {', '.join(lost.values())}; {way}")
    for sentence in lost.values():
        reporter.note(f"{sentence} is left out")
    return edited.without(list(lost))


def _lost(edited: EditedViews, reached: Reach) -> list[int]:
    return [view for view in edited.views if not reached.reachable[view]]


def _why(reached: Reach, view: int) -> str:
    blocker = reached.blocker[view]
    return Verdict(int(reached.verdict[view])).sentence + (f", {blocker}" if blocker else "")
