"""An execution of a run folder read back: what stands in `executions/<id>/`, whether it finished or was stopped.

Each scan is on disk before the next move, so a stopped execution is read up to its last whole scan; what cannot be
read is told beside what can. Lengths in metres, angles in radians.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
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
from planner.ports import Rejection
from planner.timing.motion import Motion
from planner.values import Floats, Value, freeze

FOLDER = "executions"

_OF_EARLIER = "simulated"  # where earlier scans, which do not say it, have their points from


@dataclass(frozen=True, slots=True, eq=False)
class ExecutedScan(Value):
    """One readable scan of an execution.

    Attributes:
        stop: number of the view, from 1 in visiting order.
        view: its candidate, row of viewpoints.npz.
        q_commanded: (axes,) set-points sent [rad], KUKA signs.
        q_reported: (axes,) joint angles that the controller reported at the stop [rad].
        T_reported: (4, 4) T_object_scanner by the controller's report [m].
        T_reported_poses: (K, 4, 4) all poses of a sweep [m], of which `T_reported` is the middle one; at rest it alone.
        T_true: (4, 4) from where the rays were traced [m]; None where the points are not simulated.
        T_true_poses: (K, 4, 4) likewise [m].
        points: (P, 3) as the data tell them [m], object frame.
        counts: rays by `Rejection`; None where the points are not simulated.
        source: where the points come from.
        frame: that they came in.
        name: of the file below `scans/`.
        stored: every array of the file by name.
    """

    stop: int
    view: int
    q_commanded: Annotated[Floats, "axes"]
    q_reported: Annotated[Floats, "axes"]
    T_reported: Annotated[Floats, "4 4"]
    T_reported_poses: Annotated[Floats, "K 4 4"]
    T_true: Annotated[Floats, "4 4"] | None
    T_true_poses: Annotated[Floats, "K 4 4"] | None
    points: Annotated[Floats, "P 3"]
    counts: tuple[int, ...] | None
    source: str
    frame: str
    name: str = ""
    stored: Mapping[str, NDArray[Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        freeze(self)
        for name in ("q_commanded", "q_reported", "points"):
            if not np.isfinite(getattr(self, name)).all():
                raise PlannerError(f"{name} contains infinity; every value must be finite")
        if self.counts is None:
            return
        if not 0 < len(self.counts) <= len(Rejection):  # reasons are appended: an older scan has fewer
            raise ValueError(f"it has {len(self.counts)} counts of rays; there must be 1 to {len(Rejection)}")
        object.__setattr__(self, "counts", (*self.counts, *[0] * (len(Rejection) - len(self.counts))))

    @property
    def poses(self) -> Floats:
        """(K, 4, 4) true poses [m], those reported where the points are not simulated."""
        return self.T_reported_poses if self.T_true_poses is None else self.T_true_poses


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
    scans: tuple[ExecutedScan, ...]
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
    scans: list[ExecutedScan] = []
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


def read_scan(path: Path) -> ExecutedScan:
    """Read one scan.

    Raises:
        FileError: if it cannot be read, an array is missing, or a number is not finite.
    """
    stored = npz(path, file_bytes(path))
    with understood(path):
        T, source = stored["T_object_scanner"], str(stored.get("source", _OF_EARLIER))
        T_true = stored["T_object_scanner_true"] if source == _OF_EARLIER else None
        return ExecutedScan(
            int(stored["stop"]), int(stored["view"]), joined(stored, "q_commanded"), joined(stored, "q_reported"), T,
            stored.get("sweep_T_object_scanner", T[None]), T_true,
            None if T_true is None else stored.get("sweep_T_object_scanner_true", T_true[None]), stored["points"],
            None if T_true is None else tuple(int(count) for count in stored["counts"]), source,
            str(stored.get("frame", "object")), path.name, stored,
        )  # fmt: skip
