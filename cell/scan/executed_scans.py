"""The scans that an execution left: each read as a value, if it is whole and of the plan. Object frame, metres."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

from cell.acquisition import SIMULATED
from cell.errors import FileError
from cell.reconstruction.cloud import ScanCloud
from cell.run.executions import RecordedExecution, RecordedScan
from cell.run.plan_json import PlanView
from cell.run.record import file_bytes, understood
from planner.ports import Rejection
from planner.values import Floats, readonly


@dataclass(frozen=True, slots=True, eq=False)
class ExecutedScan:
    """One readable scan of an execution.

    Attributes:
        stop: number of the view, from 1 in visiting order.
        view: its candidate, row of viewpoints.npz.
        q_commanded: (axes,) [rad].
        q_reported: (axes,) [rad].
        T_reported: (4, 4) T_object_scanner by the controller's report [m].
        T_reported_poses: (K, 4, 4) all poses of a sweep [m], of which `T_reported` is the middle one; at rest it alone.
        T_true: (4, 4) from where the rays were traced [m]; None where the points are not simulated.
        T_true_poses: (K, 4, 4) likewise [m].
        points: (P, 3) as the data tell them [m].
        counts: rays by `Rejection`; None where the points are not simulated.
        source: where the points come from.
        frame: that they came in.
    """

    stop: int
    view: int
    q_commanded: Floats
    q_reported: Floats
    T_reported: Floats
    T_reported_poses: Floats
    T_true: Floats | None
    T_true_poses: Floats | None
    points: Floats
    counts: tuple[int, ...] | None
    source: str
    frame: str

    def __post_init__(self) -> None:
        # A sentence names the array as the file does.
        for name, stored, shape in (
            ("T_reported", "T_object_scanner", (4, 4)),
            ("T_reported_poses", "sweep_T_object_scanner", (None, 4, 4)),
            ("T_true", "T_object_scanner_true", (4, 4)),
            ("T_true_poses", "sweep_T_object_scanner_true", (None, 4, 4)),
        ):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, readonly(stored, getattr(self, name), shape))
        if self.counts is None:
            return
        if not 0 < len(self.counts) <= len(Rejection):  # reasons are appended: an older scan has fewer
            raise ValueError(f"it has {len(self.counts)} counts of rays; there must be 1 to {len(Rejection)}")
        object.__setattr__(self, "counts", (*self.counts, *[0] * (len(Rejection) - len(self.counts))))

    @property
    def cloud(self) -> ScanCloud:
        """The points, seen from the reported source."""
        return ScanCloud(self.points, self.T_reported[:3, 3])


def usable(
    recorded: RecordedExecution, planned: Sequence[PlanView]
) -> tuple[tuple[ExecutedScan, ...], tuple[str, ...]]:
    """The scans that can be used, in driving order, and a sentence about each file that cannot.

    Args:
        recorded: what the execution left.
        planned: the plan's views in visiting order.
    """
    left_out = list(recorded.unreadable)
    scans: list[ExecutedScan] = []
    known = recorded.manifest.artefacts
    for scan in recorded.scans:
        try:
            _require_unchanged(recorded, scan, known.get(f"scans/{scan.name}"))
            scans.append(_of_the_plan(recorded, _executed(recorded, scan), scan.name, planned))
        except FileError as error:
            left_out.append(str(error))
    here = f"{recorded.folder}/"
    return tuple(scans), tuple(sentence.replace(here, "") for sentence in left_out)


def _executed(recorded: RecordedExecution, scan: RecordedScan) -> ExecutedScan:
    with understood(recorded.folder / "scans" / scan.name):
        stored = scan.stored
        source = str(stored.get("source", SIMULATED))  # earlier scans do not say it
        T, is_simulated = stored["T_object_scanner"], source == SIMULATED
        T_true = stored["T_object_scanner_true"] if is_simulated else None
        poses = None if T_true is None else stored.get("sweep_T_object_scanner_true", T_true[None])
        counts = tuple(int(count) for count in stored["counts"]) if is_simulated else None
        return ExecutedScan(
            int(stored["stop"]), scan.view, scan.q_commanded, scan.q_reported, T,
            stored.get("sweep_T_object_scanner", T[None]), T_true, poses, scan.points, counts, source,
            str(stored.get("frame", "object")),
        )  # fmt: skip


def _of_the_plan(
    recorded: RecordedExecution, scan: ExecutedScan, name: str, planned: Sequence[PlanView]
) -> ExecutedScan:
    """The scan, if it is that of the view that its file is named after; a stop has one file name, so none repeats."""
    path = recorded.folder / "scans" / name
    if not 1 <= scan.stop <= len(planned):
        raise FileError(f"{path} is of view {scan.stop}, and the plan has the views 1 to {len(planned)}")
    if name != scan_name(scan.stop):
        raise FileError(f"{path} is of view {scan.stop}, whose file is {scan_name(scan.stop)}")
    if scan.view != planned[scan.stop - 1].id:
        raise FileError(
            f"{path} is of candidate {scan.view}, and view {scan.stop} of the plan is candidate "
            f"{planned[scan.stop - 1].id}"
        )
    return scan


def scan_name(stop: int) -> str:
    """Name of the file of a view, by its number from 1 in visiting order."""
    return f"{stop:04d}.npz"


def _require_unchanged(recorded: RecordedExecution, scan: RecordedScan, expected: str | None) -> None:
    path = recorded.folder / "scans" / scan.name
    if expected is not None and hashlib.sha256(file_bytes(path)).hexdigest() != expected:
        raise FileError(f"{path} is not what the execution wrote (its sha256 is not the manifest's); scan again")


def source_of(scans: Sequence[ExecutedScan]) -> str:
    """Where the points of scans come from, in words; "no points" without any."""
    return "; ".join(dict.fromkeys(scan.source for scan in scans)) or "no points"


def counts_by_reason(counts: Sequence[int]) -> dict[str, int]:
    """Rays by the name of what became of them."""
    return {reason.name.lower(): int(counts[reason]) for reason in Rejection}
