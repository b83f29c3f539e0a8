"""A stage is driven and scanned, or gone on with where it was stopped; its points are read back from disk."""

import shutil
from pathlib import Path

from cell.errors import FileError
from cell.runs.cell import RunCell
from cell.runs.run import EXECUTIONS, ExecutedScan, Run, open_finished, read_execution
from cell.scan import scan
from cell.scan.execution_folder import ExecutionFolder
from cell.scan.options import ScanOptions
from cell.scan.results import usable_scans
from cell.session import Session
from planner.geometry.mesh import TriangleMesh


def executed(
    session: Session[None], stage: Path, options: ScanOptions, *, stands: TriangleMesh | None
) -> tuple[ExecutedScan, ...]:
    """The scans of a stage, taken now as far as they are not on disk.

    Args:
        session: of the exploration.
        stage: its run folder.
        options: of the execution.
        stands: the hidden part, explored frame; None where points are not simulated.

    Raises:
        FileError: if a view has no points.
        CellError: as `cell scan`.
    """
    run = open_finished(stage)
    _clear_unbegun(run)
    known = run.execution_ids
    if known and read_execution(run, known[-1]).manifest.status != "finished":
        scan.resume_run(session, _taken, stage, known[-1], options, true_part=stands)
    elif not known:
        scan.execute_run(session, _taken, stage, options, true_part=stands)
    return scans_of_stage(run)


def scans_of_stage(run: Run) -> tuple[ExecutedScan, ...]:
    """The scans of a stage that was executed, in driving order.

    Raises:
        FileError: if one is missing or damaged.
    """
    planned = run.plan.views
    scans, left_out = usable_scans(read_execution(run, "latest"), planned)
    if left_out or len(scans) < len(planned):
        why = left_out[0] if left_out else f"{len(planned) - len(scans)} of its {len(planned)} scans are missing"
        raise FileError(f"{run.folder}: {why}; explore anew, or put back what was there")
    return scans


def _clear_unbegun(run: Run) -> None:
    """Take away an execution that was stopped before its manifest was written: nothing was driven in it."""
    for name in run.execution_ids[-1:]:
        folder = run.folder / EXECUTIONS / name
        left = {path.name for path in folder.rglob("*")} - {"scans"}
        if all(each.startswith("manifest.json.") for each in left):  # what writing it leaves
            shutil.rmtree(folder)


def _taken(session: Session[ExecutionFolder], run: Run, cell: RunCell) -> None:
    """Finish an execution that only has to have its scans; nothing is reported, as there is no reference."""
    folder, planned = session.folder, run.plan.views
    scans, _ = usable_scans(read_execution(run, folder.path.name), planned)
    for number in range(1, len(planned) + 1):
        if number in {scan.stop for scan in scans}:
            folder.adopt(f"scans/{number:04d}.npz")
    missing = sorted({*range(1, len(planned) + 1)} - {scan.stop for scan in scans})
    if missing:
        folder.finish(FileError.exit_code, "incomplete")
        raise FileError(
            f"view {missing[0]} of {folder.path} has no points; the same command goes on there once they can be had"
        )
    folder.finish(0)
