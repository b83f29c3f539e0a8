"""Candidates of a set-up: shared ones reached where the part lies, and more where none that is reached measures."""

from cell.plan import steps
from cell.plan.candidates import GROWN, arm_of, grow, limited
from cell.plan.steps import Cell, Job
from cell.world.measurability import PartSurface
from planner.geometry.sampling import SurfaceSamples
from planner.kinematics.reach import Reach, join_reach
from planner.ports import Progress
from planner.viewpoints.viewpoints import Viewpoints, join_viewpoints


def with_grown(
    job: Job, surface: PartSurface, cell: Cell, shared: Viewpoints, scouts: SurfaceSamples, progress: Progress | None
) -> tuple[Viewpoints, Reach]:
    """Candidates by the scene's generator, with verdicts and joint solutions; the shared ones keep their numbers.

    Args:
        job: what is planned, in this set-up.
        surface: the part.
        cell: with the part where it lies in this set-up.
        shared: viewpoints of one pose that several set-ups have.
        scouts: points that more are grown for where no reachable one measures them.
        progress: told how far growing is.
    """
    reached = steps.reach_of(job, cell, shared)
    if job.scene.plan.candidates != GROWN or not len(scouts):
        return shared, reached
    scanner, casters = limited(job.scene, job.scanner), steps.casters_of(surface, cell)
    arm = arm_of(cell.world, cell.kinematics, cell.checker, scanner, casters)
    grown = grow(shared, reached.reachable, scouts, arm, progress)
    return join_viewpoints([shared, grown]), join_reach([reached, steps.reach_of(job, cell, grown)])
