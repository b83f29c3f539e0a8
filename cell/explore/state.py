"""State of an exploration in memory and on disk, for continuation by the same command.

    explore.json               finished batches (`cell.runs.schema`)
    stages/0001/               run folder of a batch with its execution
    stages/0001.unseen.ply     obstacle for arm and housing
    stages/0001.measured.ply   measured surface and its continuation, if the batch was planned on it
    stages/0001.voxels.npz     voxels after the batch

explore.json is written last, so it contains complete batches only. A plan of a batch that is not in it is continued.
"""

import os
import shutil
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from cell.errors import FileError, UsageError
from cell.explore import belief
from cell.explore.execution import read_batch_scans
from cell.files import file_errors
from cell.runs import schema
from cell.runs.folder import json_text
from cell.runs.run import ExecutedScan, npz_arrays, open_finished, reading
from cell.runs.schema import ExploredBatch, ExploreFile
from planner.explore.gain import GainRecord
from planner.explore.space import VoxelSpace
from planner.geometry.mesh import TriangleMesh
from planner.values import Bools


@dataclass(frozen=True, eq=False)
class Belief:
    """Knowledge about the part.

    Attributes:
        space: voxels.
        record: realised gains.
        scans: all scans in execution order.
    """

    space: VoxelSpace
    record: GainRecord
    scans: tuple[ExecutedScan, ...] = ()

    @cached_property
    def solid(self) -> Bools:
        """(X, Y, Z) voxels of the belief."""
        return self.space.belief_voxels()

    @cached_property
    def surface(self) -> TriangleMesh:
        """The belief surface [m]."""
        return belief.surface_about(self.space, self.solid)


@dataclass(frozen=True, slots=True)
class ExplorationFolder:
    """Paths of an exploration."""

    root: Path

    @property
    def file(self) -> Path:
        """explore.json."""
        return self.root / schema.EXPLORE_FILE

    def stage(self, number: int) -> Path:
        """Return the run folder of a batch, from 1."""
        return self.root / "stages" / f"{number:04d}"

    def unseen(self, number: int) -> Path:
        """Return the file of the unseen space before a batch."""
        return self.root / "stages" / f"{number:04d}.unseen.ply"

    def measured(self, number: int) -> Path:
        """Return the file of the measured surface of a batch; it exists if the batch was planned on it."""
        return self.root / "stages" / f"{number:04d}.measured.ply"

    def voxels(self, number: int) -> Path:
        """Return the file of the voxels after a batch."""
        return self.root / "stages" / f"{number:04d}.voxels.npz"

    def begin(self, file: ExploreFile) -> ExploreFile:
        """Return the exploration on disk, or create it; raise if the folder holds something else."""
        if self.file.is_file():
            known = schema.read_explore_file(self.file)
            if known.inputs != file.inputs:
                raise UsageError(
                    f"{self.root} is an exploration with other options, another part or another scene; repeat its "
                    "command to resume it, or choose another --out"
                )
            return known
        if self.root.exists() and not self._only_made():
            raise FileError(f"{self.root} exists and is not an exploration; choose another --out")
        with file_errors(f"{self.root} cannot be made", "choose a writable --out"):
            (self.root / "stages").mkdir(parents=True, exist_ok=True)
        self.write(file)
        return file

    def _only_made(self) -> bool:
        """Return whether the folder was created without a first explore.json."""
        try:
            names = {path.name for path in self.root.rglob("*")}
        except OSError:
            return False
        return names == {"stages"} or names == {"stages", self._temporary.name}

    @property
    def _temporary(self) -> Path:
        return self.file.with_name(f"{schema.EXPLORE_FILE}.tmp")

    def write(self, file: ExploreFile) -> None:
        """Write explore.json atomically."""
        temporary = self._temporary
        with file_errors(f"{self.file} cannot be written"):
            with temporary.open("w", encoding="utf-8") as stream:
                stream.write(json_text(file.as_json()))
                stream.flush()
                os.fsync(stream.fileno())
            temporary.replace(self.file)

    def keep(self, number: int, known: Belief) -> None:
        """Write the belief after a batch."""
        space, record = known.space, known.record
        np.savez_compressed(
            self.voxels(number), allow_pickle=False, state=space.state, votes=space.votes, tries=space.tries,
            points=space.points, between=space.between, expected=record.expected, found=record.found,
        )  # fmt: skip

    def known(self, number: int, unknown: VoxelSpace) -> Belief:
        """Return the belief after a batch without the scans; `unknown` is that before the first."""
        if number == 0:
            return Belief(unknown, GainRecord.empty())
        path = self.voxels(number)
        if not path.is_file():
            raise FileError(f"{path} is missing; start a new exploration")
        stored = npz_arrays(path, path.read_bytes())
        with reading(path):
            state, votes, tries = (stored[name] for name in ("state", "votes", "tries"))
            points, between = (stored[name] for name in ("points", "between"))
            space = replace(unknown, state=state, votes=votes, tries=tries, points=points, between=between)
            return Belief(space, GainRecord(stored["expected"], stored["found"]))

    def clear(self, number: int) -> None:
        """Remove the files of an unfinished batch."""
        for path in self.root.glob(f"{self.stage(number).relative_to(self.root)}.part*"):
            shutil.rmtree(path)
        self.unseen(number).unlink(missing_ok=True)
        self.measured(number).unlink(missing_ok=True)


def read_scans(paths: ExplorationFolder, stages: tuple[ExploredBatch, ...]) -> tuple[ExecutedScan, ...]:
    """Return the scans of all batches in execution order."""
    return tuple(scan for stage in stages for scan in read_batch_scans(open_finished(paths.root / stage.folder)))
