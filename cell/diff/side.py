"""One of the two runs that are compared, read: its views, and what each of them measures in its own cell."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from cell.errors import FileError
from cell.runs.run import EXECUTIONS, Execution, Run, open_finished, read_execution, reading
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
    run: Run
    execution: Execution | None
    number: Annotated[Ints, "n"]
    poses: Annotated[Floats, "n _ 4 4"]


def read_side(folder: Path) -> Side:
    """A plan's folder or an execution's, read.

    Raises:
        FileError: if an artefact is missing, changed or damaged, or an execution has no scan.
    """
    if folder.parent.name != EXECUTIONS:
        run = open_finished(folder)
        poses = np.stack([view.T_object_poses for view in run.plan.views])
        return Side(folder, run, None, np.arange(1, len(poses) + 1), poses)
    run = open_finished(folder.parent.parent)
    recorded = read_execution(run, folder.name)
    if not recorded.scans:
        raise FileError(f"{folder} holds no scan that can be read; give another execution")
    number = np.array([scan.stop for scan in recorded.scans])
    with reading(folder / "scans"):
        poses = np.stack([scan.T_reported_poses for scan in recorded.scans])
    order = np.argsort(number)
    return Side(folder, run, Execution.open(folder), number[order], poses[order])
