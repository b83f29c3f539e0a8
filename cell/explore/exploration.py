"""The result of an exploration for Python: its folder, explore.json, and the explored surface."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from cell.formatting import Summary
from cell.runs import ply
from cell.runs.run import Run, file_bytes, open_finished
from cell.runs.schema import ExploreFile

if TYPE_CHECKING:
    import trimesh


@dataclass(frozen=True, slots=True, repr=False)
class Exploration(Summary):
    """An exploration.

    Attributes:
        folder: its folder.
        file: explore.json: batches, and uncovered surface by cause.
    """

    folder: Path
    file: ExploreFile

    def facts(self) -> list[tuple[str, str]]:
        """Return folder, number of views, and duration of the motion."""
        duration = sum(stage.seconds for stage in self.file.stages)
        return [("folder", str(self.folder)), ("views", str(self.file.views)), ("motion", f"{duration:.1f} s")]

    @property
    def stages(self) -> tuple[Run, ...]:
        """Plans of the batches in the explored frame: centre of the cylinder, axes of base."""
        return tuple(open_finished(self.folder / stage.folder) for stage in self.file.stages)

    @property
    def model(self) -> Path | None:
        """Mesh file of all scans, mm; None without a surface."""
        return self.folder / self.file.model if self.file.model else None

    @property
    def mesh(self) -> "trimesh.Trimesh | None":
        """The same in metres, explored frame."""
        return None if self.model is None else ply.to_trimesh(ply.mesh(file_bytes(self.model)))

    @property
    def place_mm(self) -> tuple[float, float, float] | None:
        """Centre of the model in base [mm], for `plan(exploration.model, units="mm", place=exploration.place_mm)`."""
        return self.file.model_middle_mm
