"""What every way of `cell scan` works on: a finished plan and an execution's folder; and what it leaves."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from cell.narrator import Narrator
from cell.runs.run import Run
from cell.runs.schema import ExecutionReport
from cell.scan.execution_folder import ExecutionFolder
from planner.ports import Progress


@dataclass(frozen=True, slots=True, eq=False)
class ScanOutcome:
    """What `cell scan` leaves.

    Attributes:
        folder: of the execution.
        exit_code: 0; 3 where a whole execution stays below the coverage that the plan requires; 6 where a report was
            made of an execution that lacks views.
        summary: its report.json.
    """

    folder: Path
    exit_code: int
    summary: ExecutionReport


@dataclass(frozen=True, slots=True)
class Work:
    """What is worked on, and who is told."""

    run: Run
    folder: ExecutionFolder
    narrator: Narrator

    @contextmanager
    def step(self, name: str) -> Iterator[Progress]:
        """Name the step to the person and to the manifest."""
        with self.narrator.stage(name) as progress, self.folder.stage(name):
            yield progress
