"""An execution as one value: what `cell.api.scan` returns. Object frame, metres where no name says otherwise."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cell.run import ply
from cell.run.execution_json import ExecutedCoverage, ExecutedDeviation, ExecutionReport
from cell.run.json_table import parsed
from cell.run.record import RunRecord, artefact, read_manifest, understood
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats, readonly


@dataclass(frozen=True, eq=False)  # no slots: what is read later is kept
class ExecutedRun:
    """An execution with its report.

    Attributes:
        record: its folder below the run's.
        report: its report.json.
    """

    record: RunRecord
    report: ExecutionReport

    @property
    def folder(self) -> Path:
        """executions/<id> of the run folder."""
        return self.record.folder

    @property
    def exit_code(self) -> int:
        """0, or 3 where a whole execution stays below the coverage that the plan requires."""
        return self.record.manifest.exit_code or 0

    @property
    def coverage(self) -> ExecutedCoverage:
        """What was measured."""
        return self.report.coverage

    @property
    def deviation(self) -> ExecutedDeviation | None:
        """Distance of the measured surface from the part; None where there is no surface."""
        return self.report.deviation

    @cached_property
    def mesh(self) -> TriangleMesh | None:
        """The surface made from the points; None where there is none."""
        if not self.record.has("mesh.ply"):
            return None
        with understood(self.folder / "mesh.ply"):
            return ply.mesh(artefact(self.record, "mesh.ply"))

    @cached_property
    def closed(self) -> NDArray[np.bool_]:
        """(F,) which faces of the surface close holes: invented, not measured; none without a surface."""
        if not self.record.has("mesh.ply"):
            return np.zeros(0, dtype=np.bool_)
        with understood(self.folder / "mesh.ply"):
            return ply.elements(artefact(self.record, "mesh.ply"))["face"]["closed"] > 0

    @cached_property
    def points(self) -> Floats:
        """(N, 3) points of the merged cloud."""
        with understood(self.folder / "cloud.ply"):
            places = ply.places(ply.elements(artefact(self.record, "cloud.ply"))["vertex"])
            return readonly("points", places, (None, 3))


def open_execution(folder: Path) -> ExecutedRun:
    """An execution's folder.

    Raises:
        FileError: if it is missing or damaged.
    """
    record = RunRecord(folder, read_manifest(folder / "manifest.json"))
    return ExecutedRun(record, parsed(ExecutionReport, artefact(record, "report.json"), folder / "report.json"))
