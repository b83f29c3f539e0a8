"""An execution of a run folder read back: what stands in `executions/<id>/`, whether it finished or was stopped.

Each scan is on disk before the next move, so a stopped execution is read up to its last whole scan; what cannot be
read is told beside what can. Lengths in metres, angles in radians.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from cell.errors import FileError
from cell.run.axes import joined
from cell.run.manifest_json import Manifest
from cell.run.reader import motion_of
from cell.run.record import RunRecord, file_bytes, npz, read_manifest, understood
from planner.errors import PlannerError
from planner.timing.motion import Motion
from planner.values import Floats, Value, freeze

FOLDER = "executions"


@dataclass(frozen=True, slots=True, eq=False)
class RecordedScan(Value):
    """One file of `scans/`; its other arrays are in `stored`.

    Attributes:
        name: file name.
        view: candidate that was scanned.
        q_commanded: (axes,) set-points sent [rad], KUKA signs.
        q_reported: (axes,) joint angles that the controller reported at the stop [rad].
        points: (P, 3) [m], object frame.
        stored: every array of the file by name.
    """

    name: str
    view: int
    q_commanded: Annotated[Floats, "n"]
    q_reported: Annotated[Floats, "n"]
    points: Annotated[Floats, "P 3"]
    stored: Mapping[str, NDArray[Any]]

    def __post_init__(self) -> None:
        freeze(self)
        for name in ("q_commanded", "q_reported", "points"):
            if not np.isfinite(getattr(self, name)).all():
                raise PlannerError(f"{name} contains infinity; every value must be finite")


@dataclass(frozen=True, slots=True, eq=False)
class RecordedExecution:
    """What an execution left.

    Attributes:
        folder: executions/<id>.
        manifest: its manifest.json; empty where it has none yet, or a damaged one.
        scans: the scans that can be read, in the order in which they were taken.
        motion: the motion that the execution recorded itself; None where it kept none.
        unreadable: one sentence for each file that cannot be read.
    """

    folder: Path
    manifest: Manifest
    scans: tuple[RecordedScan, ...]
    motion: Motion | None
    unreadable: tuple[str, ...]


def execution_ids(run: RunRecord) -> list[str]:
    """Names of the executions of a run, in order of their numbers; a folder whose name is no number is none."""
    root = run.folder / FOLDER
    if not root.is_dir():
        return []
    return sorted((path.name for path in root.iterdir() if path.is_dir() and path.name.isdecimal()), key=int)


def read_execution(run: RunRecord, execution: str) -> RecordedExecution:
    """Read an execution.

    Args:
        run: the run that was executed.
        execution: its id, or "latest".

    Raises:
        FileError: if the run has no execution of that name.
    """
    known = execution_ids(run)
    if not known:
        raise FileError(f"{run.folder} has no execution yet; make one with cell scan {run.folder}")
    if execution == "latest":
        execution = known[-1]
    if execution not in known:
        raise FileError(f"{run.folder} has no execution {execution}; it has {', '.join(known)}")
    folder = run.folder / FOLDER / execution
    manifest = Manifest()
    scans: list[RecordedScan] = []
    unreadable: list[str] = []
    if (folder / "manifest.json").is_file():
        try:
            manifest = read_manifest(folder / "manifest.json")
        except FileError as error:
            unreadable.append(f"{error}; the report is made without it")
    for path in sorted((folder / "scans").glob("*.npz")):
        try:
            scans.append(read_scan(path))
        except FileError as error:
            unreadable.append(str(error))
    recorded = None
    if (folder / "motion.npz").is_file():
        try:
            recorded = motion_of(
                npz(folder / "motion.npz", (folder / "motion.npz").read_bytes()), folder / "motion.npz"
            )
        except FileError as error:
            unreadable.append(str(error))
    return RecordedExecution(folder, manifest, tuple(scans), recorded, tuple(unreadable))


def read_scan(path: Path) -> RecordedScan:
    """Read one scan.

    Raises:
        FileError: if it cannot be read, an array is missing, or a number is not finite.
    """
    stored = npz(path, file_bytes(path))
    with understood(path):
        return RecordedScan(
            path.name,
            int(stored["view"]),
            joined(stored, "q_commanded"),
            joined(stored, "q_reported"),
            stored["points"],
            stored,
        )
