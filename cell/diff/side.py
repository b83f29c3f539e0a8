"""One of the two runs that are compared, read: its views, and what each of them measures in its own cell."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from cell.errors import FileError
from cell.run.executed import ExecutedRun, open_execution
from cell.run.executions import FOLDER, read_execution
from cell.run.planned import PlannedRun, open_run
from cell.run.record import understood
from planner.values import Floats, Ints, Value


@dataclass(frozen=True, slots=True, eq=False)
class Side(Value):
    """A run that is compared.

    Attributes:
        folder: of the plan, or of the execution.
        run: the plan, or that of the execution.
        execution: None for a plan.
        number: (n,) of the views, from 1 in visiting order.
        poses: (n, K, 4, 4) T_object_scanner.
    """

    folder: Path
    run: PlannedRun
    execution: ExecutedRun | None
    number: Annotated[Ints, "n"]
    poses: Annotated[Floats, "n _ 4 4"]


def read_side(folder: Path) -> Side:
    """A plan's folder or an execution's, read.

    Raises:
        FileError: if an artefact is missing, changed or damaged, or an execution has no scan.
    """
    if folder.parent.name != FOLDER:
        run = open_run(folder)
        poses = np.stack([view.T_object_poses for view in run.plan.views])
        return Side(folder, run, None, np.arange(1, len(poses) + 1), poses)
    run = open_run(folder.parent.parent)
    recorded = read_execution(run.record, folder.name)
    if not recorded.scans:
        raise FileError(f"{folder} holds no scan that can be read; give another execution")
    number = np.array([scan.stop for scan in recorded.scans])
    with understood(folder / "scans"):
        poses = np.stack([scan.T_reported_poses for scan in recorded.scans])
    order = np.argsort(number)
    return Side(folder, run, open_execution(folder), number[order], poses[order])
