"""An exploration as Python gets it: its folder, explore.json, and the explored surface to go on with."""

from dataclasses import dataclass
from pathlib import Path

from cell.runs import ply
from cell.runs.run import Run, file_bytes, open_finished
from cell.runs.schema import ExploreFile
from planner.geometry.mesh import TriangleMesh


@dataclass(frozen=True, slots=True)
class Exploration:
    """What was explored.

    Attributes:
        folder: of it.
        file: explore.json: batches, what stays open and why.
    """

    folder: Path
    file: ExploreFile

    @property
    def stages(self) -> tuple[Run, ...]:
        """The plan of each batch, in the explored frame: middle of the cylinder, axes of the base frame."""
        return tuple(open_finished(self.folder / stage.folder) for stage in self.file.stages)

    @property
    def model(self) -> Path | None:
        """The mesh file of all scans, mm; None where the points describe no surface."""
        return self.folder / self.file.model if self.file.model else None

    @property
    def mesh(self) -> TriangleMesh | None:
        """The same in metres, explored frame."""
        return None if self.model is None else ply.mesh(file_bytes(self.model))

    @property
    def place(self) -> tuple[float, float, float] | None:
        """Where `plan(exploration.model, units="mm", place=...)` finds it again: its middle, base frame [mm]."""
        return self.file.model_middle_mm
