"""Held-out samples that the views of a finished run measure, for tests of set-ups."""

from pathlib import Path

import numpy as np

from cell.runs.cell import read_cell
from cell.runs.run import open_finished
from cell.world.prediction import held_out_samples
from cell.world.support_contact import in_contact
from planner.measurability.visibility import find_measured
from planner.values import Bools


def seen_and_touching(run: Path) -> tuple[Bools, Bools]:
    """Return (S,) samples that a view measures, at the view's table angle, and (S,) samples that a support touches."""
    planned = open_finished(run)
    cell = read_cell(planned)
    samples = held_out_samples(cell.reference, cell.planning, planned.seed)
    poses = np.stack([view.T_object_poses for view in planned.plan.views])
    seen = find_measured(poses, samples, cell.scanner, (cell.part_caster, cell.occluder_caster), each=True).any(axis=1)
    return seen, in_contact(samples, cell.occluders)


def seen_samples(run: Path) -> Bools:
    """Return (S,) samples that a view measures and no support touches."""
    measured_there, touched = seen_and_touching(run)
    return measured_there & ~touched
