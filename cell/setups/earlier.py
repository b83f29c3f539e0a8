"""Set-ups that are planned already: the part that they share, and what their views measure of it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from cell.errors import UsageError
from cell.runs.cell import RunCell, read_cell
from cell.runs.run import Run
from cell.setups.contact import touching
from planner.geometry.sampling import SurfaceSamples
from planner.measurability.visibility import find_measured
from planner.values import Bools, Floats


@dataclass(frozen=True, slots=True, eq=False)
class EarlierSetup:
    """One of them.

    Attributes:
        run: its plan.
        cell: what is measured in.
        T_object_poses: (n, K, 4, 4) its views as they are executed [m].
    """

    run: Run
    cell: RunCell
    T_object_poses: Floats

    @classmethod
    def of(cls, run: Run) -> Self:
        """Read a finished plan.

        Raises:
            FileError: if an artefact is missing, changed or damaged.
        """
        return cls(run, read_cell(run), np.stack([view.T_object_poses for view in run.plan.views]))

    def measures(self, samples: SurfaceSamples) -> Bools:
        """(S,) samples that a view measures and that touch no support."""
        casters = (self.cell.part_caster, self.cell.occluder_caster)
        seen = find_measured(self.T_object_poses, samples, self.cell.scanner, casters)
        return seen & ~touching(samples, self.cell.occluders)


def measured_by(setups: Sequence[EarlierSetup], samples: SurfaceSamples) -> Bools:
    """(S,) samples that a view of any set-up measures."""
    found = np.zeros(len(samples), dtype=np.bool_)
    for setup in setups:
        found |= setup.measures(samples)
    return found


def require_one_part(setups: Sequence[EarlierSetup]) -> None:
    """Refuse set-ups that do not belong together.

    Raises:
        UsageError: if they are of different parts, or one is named twice.
    """
    first = setups[0]
    for setup in setups[1:]:
        if setup.cell.scene.part.sha256 != first.cell.scene.part.sha256:
            raise UsageError(
                f"{setup.run.folder} is of the part {setup.cell.scene.part.name} and {first.run.folder} of "
                f"{first.cell.scene.part.name}; set-ups that go together have the same part"
            )
    digests = [setup.run.digest for setup in setups]
    if len(set(digests)) < len(digests):
        raise UsageError("a run is named twice as one to go on from; name each set-up once")
