"""`cell scan`, step 11, and `cell scan --report`: merge, make the surface, measure, report.

`results` shows what is made of the scans on one screen. It reads them from disk, so a report that is made later, or of
an execution that was stopped, is made by the same lines.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cell.errors import FileError
from cell.metrology import point_files
from cell.metrology.reconstruct import reconstruct
from cell.runs import folder as process
from cell.runs.cell import RunCell, read_cell
from cell.runs.run import ExecutedScan, Execution, RecordedExecution, Run, open_finished, read_execution, reading
from cell.runs.schema import ExecutedMotion, ExecutionReport, Manifest, PlanFile
from cell.scan import causes, execution_page
from cell.scan.achieved import achieved
from cell.scan.executed_scans import scan_name, source_of, usable
from cell.scan.execution_folder import ExecutionFolder
from cell.scan.execution_page import short
from cell.scan.execution_summary import Results, execution_report, settings_of
from cell.scan.legs import legs_of
from cell.scan.merging import executed_poses, merged, sigma_of
from cell.scan.options import ScanOptions
from cell.session import Session, Stream, random_stream
from cell.view import contents
from cell.view.contents import NAME
from cell.view.pictures import part_and_views
from cell.view.surface import canvas_of
from planner.geometry.closest import ClosestPointQuery
from planner.registration.localisation import SearchRange
from planner.registration.surface import measure_deviation
from planner.timing.motion import Motion


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


def report(session: Session[None], run_folder: Path, execution: str) -> ScanOutcome:
    """Make the report of an execution anew from what is there; what is missing is said.

    Args:
        session: of the command.
        run_folder: of a finished plan.
        execution: its id, or "latest".

    Raises:
        CellError: with one sentence and the exit code.
    """
    run = open_finished(run_folder)
    recorded = read_execution(run, execution)
    ended = recorded.manifest.status or "running"
    if ended == "running" and process.is_running(recorded.manifest):
        raise FileError(
            f"execution {recorded.folder.name} is still running (process {recorded.manifest.pid}); wait until it "
            "ends, or stop it with Ctrl-C"
        )
    if ended != "finished":
        session.note(
            f"execution {recorded.folder.name} did not finish (its status is '{ended}'); what is there is used"
        )
    folder = ExecutionFolder.reopen(recorded.folder, recorded.manifest)
    cell = read_cell(run, options_of(recorded).resolution_deg)
    # The status tells how the execution ended, not how its report did.
    status, exit_code = ("incomplete" if ended == "running" else ended), folder.manifest.exit_code
    summary = results(session.opened(folder, run.seed), run, cell, run.motion, recorded)
    for sentence in summary.left_out:
        session.note(sentence)
    if summary.missing_views:
        here = summary.n_views
        session.note(
            f"the execution is incomplete: {here} of {here + len(summary.missing_views)} views are there; "
            "the report says what is there; cell scan --resume takes the others"
        )
        return ScanOutcome(folder.finish(exit_code, status), FileError.exit_code, summary)
    code = exit_code_of(summary, cell)
    return ScanOutcome(folder.finish(code if ended == "finished" else exit_code, status), code, summary)


def results(
    session: Session[ExecutionFolder], run: Run, cell: RunCell, motion: Motion, recorded: RecordedExecution
) -> ExecutionReport:
    """Merge, reconstruct, measure and report what the execution has on disk."""
    folder = session.folder
    options, manifest = options_of(recorded), folder.manifest
    seed = run.seed if manifest.seed is None else manifest.seed

    with session.stage("merge"):
        plan = run.plan
        scans, left_out = usable(recorded, plan.views)
        _adopt(folder, scans)
        nearest = ClosestPointQuery(cell.reference)
        doubts = causes.doubts(scans, cell, nearest, options.points_units)
        for doubt in doubts:
            session.note(doubt)
        search = None if options.search is None else SearchRange(*options.search)
        rng = random_stream(seed, Stream.REGISTRATION_STARTS)
        cloud = merged(scans, nearest, registered=options.registers, search=search, rng=rng)
        if cloud.fit is not None:
            cell = cell.about_part(cloud.fit.T)
        source, sigma = source_of(scans), sigma_of(cloud, scans, cell.scanner)
        folder.write_bytes("cloud.ply", point_files.cloud_ply(cloud.cloud, cloud.stop, sigma, source))

    with session.stage("reconstruct"):
        model = reconstruct(cloud.cloud, close=options.close_holes)
        for doubt in model.doubts:
            session.note(doubt)

    with session.stage("measure"):
        reached = achieved(scans, plan, cloud, cell, run.seed)
        off = None
        if model.mesh is None:
            folder.remove("mesh.ply")
        else:
            rng = random_stream(seed, Stream.DEVIATION_SAMPLES)
            count = session.effort.deviation_samples
            off = measure_deviation(model.mesh, nearest, rng, closed=model.closed, count=count)
            folder.write_bytes("mesh.ply", point_files.mesh_ply(model.mesh, model.closed, off.at_vertices, source))

    with session.stage("report"):
        legs = legs_of(motion, options.view)
        # Of a resumed execution only the time of the last part is known.
        timed = bool(manifest.simulated_time) and not manifest.resumed
        times = ExecutedMotion(planned_s=legs.planned_seconds, executed_s=manifest.moving_s if timed else None)
        found = Results(scans, left_out, cloud, reached, model, off, doubts)
        stops = [leg.stop for leg in legs.legs if leg.stop]
        summary = execution_report(cell, plan, settings_of(cell, recorded.manifest.options, seed), found, stops, times)
        folder.write_json("report.json", summary.as_json())
        folder.write_text("report.md", execution_page.markdown(summary))
        _draw(run, folder, cell, plan, recorded, summary, found)
    return summary


def options_of(recorded: RecordedExecution) -> ScanOptions:
    """What the execution was asked for; the defaults where its manifest does not say it."""
    with reading(recorded.folder / "manifest.json"):
        return ScanOptions.begun(recorded.manifest.options)


def _draw(
    run: Run,
    folder: ExecutionFolder,
    cell: RunCell,
    plan: PlanFile,
    recorded: RecordedExecution,
    summary: ExecutionReport,
    found: Results,
) -> None:
    """The page, part and views, the cover curve, the deviation: as far as there is a scan and a surface."""
    from cell.report import deviation_picture

    if found.model.mesh is None or found.deviation is None:
        folder.remove("deviation.png")
    else:
        deviation_picture.draw(folder.path / "deviation.png", found.model.mesh, found.deviation, short(summary.source))
        folder.adopt("deviation.png")
    scans, reached = found.scans, found.achieved
    canvas = canvas_of(cell.reference, reached.surface.samples)
    used = replace(recorded, scans=tuple(scan for scan in recorded.scans if scan.name in _names(scans)))
    done = Execution(folder.path, Manifest(), summary)  # its manifest is not written yet
    folder.write_text(NAME, contents.execution_page(run, used, done, (canvas, reached.surface)))
    if not scans:
        folder.remove("views.png")
        folder.remove("cover.png")
        return
    from cell.plan import pictures

    part_and_views(
        folder.path / "views.png", canvas, reached.surface,
        np.stack([poses[len(poses) // 2] for poses in executed_poses(scans, found.merged)]),
        cell.scanner_keys.opening_deg, [scan.stop for scan in scans], short(summary.source),
    )  # fmt: skip
    pictures.cover_curve(
        folder.path / "cover.png", marginal_area=reached.largest_first, coverable=plan.coverage.coverable, total=1.0,
        lower_bound=plan.lower_bound,
    )  # fmt: skip
    folder.adopt("views.png")
    folder.adopt("cover.png")


def _names(scans: Sequence[ExecutedScan]) -> set[str]:
    """Files of scans."""
    return {scan_name(scan.stop) for scan in scans}


def _adopt(folder: ExecutionFolder, scans: Sequence[ExecutedScan]) -> None:
    """Scans of a killed execution get their sha256 in the manifest, as those of a finished one have."""
    for name in sorted(_names(scans)):
        folder.adopt(f"scans/{name}")


def exit_code_of(summary: ExecutionReport, cell: RunCell) -> int:
    """3 where a whole execution stays below the coverage that the plan requires, else 0."""
    whole = summary.settings.view is None
    return 3 if whole and summary.coverage.visible < cell.scene.plan.required_visible else 0
