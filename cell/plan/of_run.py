"""What goes on from a finished run has its part and its samples: values and files as they are, to the byte."""

import shutil

from cell.part.workpiece import Workpiece
from cell.plan.steps import Job, PlanSession
from cell.runs.run import Run
from cell.world.embree import EmbreeRayCaster
from cell.world.measurability import PartSurface

_KEPT = ("reference.ply", "planning.ply")


def part_of(before: Run) -> Workpiece:
    """The part of a run."""
    part = before.scene.part
    return Workpiece(part.name, before.mesh("reference.ply"), part.sha256)


def surface_of(before: Run, session: PlanSession, job: Job) -> PartSurface:
    """Its planning mesh and the rows of its matrix; the files of the meshes are copied into the open run."""
    with session.stage("read the plan"):
        for name in _KEPT:
            shutil.copyfile(before.folder / name, session.folder.path / name)
            session.folder.adopt(name)
        reference = job.part.reference
        return PartSurface(
            reference, before.mesh("planning.ply"), before.measurability.samples,
            EmbreeRayCaster(reference.vertices, reference.faces),
        )  # fmt: skip
