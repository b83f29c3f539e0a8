"""Execute the batches of an exploration, or resume them, and read their scans."""

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


def execute_batch(
    session: Session[None], stage: Path, options: ScanOptions, *, true_part: TriangleMesh | None
) -> tuple[ExecutedScan, ...]:
    """Return the scans of a batch; scan the views that are not on disk yet.

    Args:
        session: of the exploration.
        stage: run folder of the batch.
        options: of the execution.
        true_part: the true part, explored frame; None if points are not simulated.
    """
    run = open_finished(stage)
    _remove_unstarted(run)
    known = run.execution_ids
    if known and read_execution(run, known[-1]).manifest.status != "finished":
        scan.resume_run(session, _finish_scans, stage, known[-1], options, true_part=true_part)
    elif not known:
        scan.execute_run(session, _finish_scans, stage, options, true_part=true_part)
    return read_batch_scans(run)


def read_batch_scans(run: Run) -> tuple[ExecutedScan, ...]:
    """Return the scans of an executed batch in execution order."""
    planned = run.plan.views
    scans, left_out = usable_scans(read_execution(run, "latest"), planned)
    if left_out or len(scans) < len(planned):
        why = left_out[0] if left_out else f"{len(planned) - len(scans)} of its {len(planned)} scans are missing"
        raise FileError(f"{run.folder}: {why}; start a new exploration, or restore the missing files")
    return scans


def _remove_unstarted(run: Run) -> None:
    """Remove an execution that ended before its manifest was written; nothing was driven in it."""
    for name in run.execution_ids[-1:]:
        folder = run.folder / EXECUTIONS / name
        left = {path.name for path in folder.rglob("*")} - {"scans"}
        if all(each.startswith("manifest.json.") for each in left):  # what writing it leaves
            shutil.rmtree(folder)


def _finish_scans(session: Session[ExecutionFolder], run: Run, cell: RunCell) -> None:
    """Finish an execution that consists of scans only, since there is no reference to report on."""
    folder, planned = session.folder, run.plan.views
    scans, _ = usable_scans(read_execution(run, folder.path.name), planned)
    for number in range(1, len(planned) + 1):
        if number in {scan.stop for scan in scans}:
            folder.adopt(f"scans/{number:04d}.npz")
    missing = sorted({*range(1, len(planned) + 1)} - {scan.stop for scan in scans})
    if missing:
        folder.finish(FileError.exit_code, "incomplete")
        raise FileError(
            f"view {missing[0]} of {folder.path} has no points; provide them and repeat the command to continue"
        )
    folder.finish(0)
