"""What goes on from a finished run has its part and its samples: values and files as they are, to the byte."""

import shutil

from cell.part.workpiece import Workpiece
from cell.plan.steps import Job, Run
from cell.rays.embree import EmbreeRayCaster
from cell.rays.matrix import PartSurface
from cell.run import reader
from cell.run.planned import PlannedRun

_KEPT = ("reference.ply", "planning.ply")


def part_of(before: PlannedRun) -> Workpiece:
    """The part of a run."""
    part = reader.scene(before.record).part
    return Workpiece(part.name, reader.mesh(before.record, "reference.ply"), part.sha256)


def surface_of(before: PlannedRun, run: Run, job: Job) -> PartSurface:
    """Its planning mesh and the rows of its matrix; the files of the meshes are copied into the open run."""
    with run.step("read the plan"):
        for name in _KEPT:
            shutil.copyfile(before.folder / name, run.folder.path / name)
            run.folder.adopt(name)
        reference = job.part.reference
        return PartSurface(
            reference, reader.mesh(before.record, "planning.ply"), reader.measurability(before.record).features,
            EmbreeRayCaster(reference.vertices, reference.faces),
        )  # fmt: skip
