"""An exploration on disk and in memory: what is kept after each stage, and taken up again by the same command.

    explore.json               what was done (`cell.runs.schema`); a stage that it names is finished
    stages/0001/               run folder of the batch: plan, and its execution
    stages/0001.unseen.ply     what arm and housing kept away from
    stages/0001.measured.ply   the surface of all points before it and where it leads, where it was planned on that
    stages/0001.voxels.npz     the voxels after it

explore.json is written last, so a stage is in it whole or not at all. A plan whose stage is not in it is gone on with.
"""

import hashlib
import json
import os
import shutil
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from cell.errors import FileError, UsageError
from cell.explore import belief
from cell.explore.execution import scans_of_stage
from cell.runs import schema
from cell.runs.folder import json_text
from cell.runs.run import ExecutedScan, npz_arrays, open_finished, reading
from cell.runs.schema import ExploredStage, ExploreFile
from planner.explore.gain import GainRecord
from planner.explore.space import VoxelSpace
from planner.geometry.mesh import TriangleMesh
from planner.values import Bools


@dataclass(frozen=True, eq=False)
class Known:
    """What is known.

    Attributes:
        space: about the part.
        record: what became of what was open.
        scans: all of them, in driving order.
    """

    space: VoxelSpace
    record: GainRecord
    scans: tuple[ExecutedScan, ...] = ()

    @cached_property
    def solid(self) -> Bools:
        """(X, Y, Z) the voxels that the part is believed to fill."""
        return self.space.belief_voxels()

    @cached_property
    def believed(self) -> TriangleMesh:
        """The surface about them [m]."""
        return belief.surface_about(self.space, self.solid)


@dataclass(frozen=True, slots=True)
class Paths:
    """Where everything of an exploration is."""

    root: Path

    @property
    def file(self) -> Path:
        """explore.json."""
        return self.root / schema.EXPLORE_FILE

    def stage(self, number: int) -> Path:
        """The run folder of a stage, from 1."""
        return self.root / "stages" / f"{number:04d}"

    def unseen(self, number: int) -> Path:
        """What was not seen before a stage."""
        return self.root / "stages" / f"{number:04d}.unseen.ply"

    def measured(self, number: int) -> Path:
        """The surface of all points, and where it leads, that a stage was planned on; there where it was."""
        return self.root / "stages" / f"{number:04d}.measured.ply"

    def voxels(self, number: int) -> Path:
        """What was known after a stage."""
        return self.root / "stages" / f"{number:04d}.voxels.npz"

    def begin(self, file: ExploreFile) -> ExploreFile:
        """The exploration as it is on disk; one that is not there yet is begun.

        Raises:
            UsageError: if what is there is another exploration.
            FileError: if the folder cannot be made, or is none of an exploration.
        """
        if self.file.is_file():
            known = schema.read_explore_file(self.file)
            if known.inputs != file.inputs:
                raise UsageError(
                    f"{self.root} is an exploration with other options, another part or another scene; repeat its own "
                    "command to go on with it, or choose another --out"
                )
            return known
        if self.root.exists() and not self._only_made():
            raise FileError(f"{self.root} exists and is no exploration; choose another --out")
        try:
            (self.root / "stages").mkdir(parents=True, exist_ok=True)
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            raise FileError(f"{self.root} cannot be made: {reason}; choose a writable --out") from error
        self.write(file)
        return file

    def _only_made(self) -> bool:
        """Whether the folder is one that was stopped between its making and its first explore.json."""
        try:
            found = {path.name for path in self.root.rglob("*")}
        except OSError:
            return False
        return found == {"stages"} or found == {"stages", self._temporary.name}

    @property
    def _temporary(self) -> Path:
        return self.file.with_name(f"{schema.EXPLORE_FILE}.tmp")

    def write(self, file: ExploreFile) -> None:
        """Write explore.json: whole or not at all."""
        temporary = self._temporary
        try:
            with temporary.open("w", encoding="utf-8") as stream:
                stream.write(json_text(file.as_json()))
                stream.flush()
                os.fsync(stream.fileno())
            temporary.replace(self.file)
        except OSError as error:
            raise FileError(f"{self.file} cannot be written: {error.strerror or error}") from error

    def keep(self, number: int, known: Known) -> None:
        """Write what is known after a stage."""
        space, record = known.space, known.record
        np.savez_compressed(
            self.voxels(number), allow_pickle=False, state=space.state, votes=space.votes, tries=space.tries,
            points=space.points, between=space.between, expected=record.expected, found=record.found,
        )  # fmt: skip

    def known(self, number: int, unknown: VoxelSpace) -> Known:
        """What was known after a stage, without the scans; `unknown` is before the first.

        Raises:
            FileError: if it is missing or damaged.
        """
        if number == 0:
            return Known(unknown, GainRecord.empty())
        path = self.voxels(number)
        if not path.is_file():
            raise FileError(f"{path} is missing; explore anew")
        stored = npz_arrays(path, path.read_bytes())
        with reading(path):
            state, votes, tries = (stored[name] for name in ("state", "votes", "tries"))
            points, between = (stored[name] for name in ("points", "between"))
            space = replace(unknown, state=state, votes=votes, tries=tries, points=points, between=between)
            return Known(space, GainRecord(stored["expected"], stored["found"]))

    def clear(self, number: int) -> None:
        """Take away what is left of a stage's plan that did not finish."""
        for path in self.root.glob(f"{self.stage(number).relative_to(self.root)}.part*"):
            shutil.rmtree(path)
        self.unseen(number).unlink(missing_ok=True)
        self.measured(number).unlink(missing_ok=True)


def scans_of(paths: Paths, stages: tuple[ExploredStage, ...]) -> tuple[ExecutedScan, ...]:
    """The scans of all stages, in driving order.

    Raises:
        FileError: if one is missing or damaged.
    """
    return tuple(scan for stage in stages for scan in scans_of_stage(open_finished(paths.root / stage.folder)))


def digest_of(*said: object) -> str:
    """sha256 of JSON values."""
    return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()
