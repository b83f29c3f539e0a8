"""An execution as one value: what `cell.api.scan` returns. Object frame, metres where no name says otherwise."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from pydantic import Field, JsonValue

from cell.run import ply
from cell.run.json_table import JsonTable, parsed
from cell.run.record import RunRecord, artefact, read_json, read_manifest, understood
from planner.surface.mesh import TriangleMesh
from planner.values import Floats, readonly


class AchievedCoverage(JsonTable):
    """What the executed views measured, beside what was predicted; fractions of the surface's area."""

    visible: float = Field(description="measured by at least one executed pose")
    predicted: float = Field(description="what the plan predicted of the views that were executed")
    sampled: float = Field(description="with a scan point near by")
    sampled_radius_mm: float = Field(description="how near")


class Deviation(JsonTable):
    """Distance of the measured surface from the part, positive outside."""

    rms_mm: float = Field(description="root mean square over the measured area")
    mean_mm: float = Field(description="mean over the measured area")
    quantile_95_mm: float = Field(description="95 % of the measured area is not farther off")
    largest_mm: float = Field(description="largest distance")


class ExecutionReport(JsonTable):
    """What the Python API gives of an execution's report.json."""

    complete: bool = Field(description="whether every view that was asked for has a scan")
    n_views: int = Field(description="scans")
    n_points: int = Field(description="points of all scans")
    coverage: AchievedCoverage
    deviation: Deviation | None = Field(description="of the surface from the part; null where there is none")


@dataclass(frozen=True, eq=False)  # no slots: what is read later is kept
class ExecutedRun:
    """An execution with its report.

    Attributes:
        record: its folder below the run's.
        report: of its report.json.
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
        return int(self.record.manifest["exit_code"])

    @property
    def coverage(self) -> AchievedCoverage:
        """What was measured."""
        return self.report.coverage

    @property
    def deviation(self) -> Deviation | None:
        """Distance of the measured surface from the part; None where there is no surface."""
        return self.report.deviation

    def as_json(self) -> dict[str, JsonValue]:
        """The object that `cell scan --json` prints: all of report.json but its schema."""
        content = read_json(self.folder / "report.json")
        return {key: value for key, value in content.items() if key != "schema"}

    @cached_property
    def mesh(self) -> TriangleMesh | None:
        """The surface made from the points; None where there is none."""
        if not self.record.has("mesh.ply"):
            return None
        with understood(self.folder / "mesh.ply"):
            return ply.mesh(artefact(self.record, "mesh.ply"))

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
