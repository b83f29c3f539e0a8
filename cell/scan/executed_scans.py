"""The scans of an execution that can be used: whole, unchanged and of the plan."""

import hashlib
from collections.abc import Sequence

from cell.errors import FileError
from cell.runs.run import ExecutedScan, RecordedExecution, file_bytes
from cell.runs.schema import PlanView
from planner.ports import Rejection


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
            scans.append(_of_the_plan(recorded, scan, planned))
        except FileError as error:
            left_out.append(str(error))
    here = f"{recorded.folder}/"
    return tuple(scans), tuple(sentence.replace(here, "") for sentence in left_out)


def _of_the_plan(recorded: RecordedExecution, scan: ExecutedScan, planned: Sequence[PlanView]) -> ExecutedScan:
    """The scan, if it is that of the view that its file is named after; a stop has one file name, so none repeats."""
    path = recorded.folder / "scans" / scan.name
    if not 1 <= scan.stop <= len(planned):
        raise FileError(f"{path} is of view {scan.stop}, and the plan has the views 1 to {len(planned)}")
    if scan.name != scan_name(scan.stop):
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


def _require_unchanged(recorded: RecordedExecution, scan: ExecutedScan, expected: str | None) -> None:
    path = recorded.folder / "scans" / scan.name
    if expected is not None and hashlib.sha256(file_bytes(path)).hexdigest() != expected:
        raise FileError(f"{path} is not what the execution wrote (its sha256 is not the manifest's); scan again")


def source_of(scans: Sequence[ExecutedScan]) -> str:
    """Where the points of scans come from, in words; "no points" without any."""
    return "; ".join(dict.fromkeys(scan.source for scan in scans)) or "no points"


def counts_by_reason(counts: Sequence[int]) -> dict[str, int]:
    """Rays by the name of what became of them."""
    return {reason.name.lower(): int(counts[reason]) for reason in Rejection}
