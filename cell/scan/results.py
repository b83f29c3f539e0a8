"""Results of an execution: merged cloud, surface, coverage, deviation and their report.

`report_execution` shows all steps. It reads the scans from disk, so a later report, or one of a stopped execution, is
made by the same code. Object frame, metres.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from cell.errors import FileError, errors_as
from cell.inspect.inspection import qif_of_run, read_plan
from cell.metrology import point_files
from cell.metrology.inspect import inspect_execution
from cell.metrology.reconstruct import REACH, Reconstruction, reconstruct
from cell.report import scan_report
from cell.runs.cell import RunCell, read_cell, scanner_of
from cell.runs.folder import RunFolder, is_running
from cell.runs.run import (
    ExecutedScan,
    Execution,
    RecordedExecution,
    Run,
    file_bytes,
    open_finished,
    read_execution,
    reading,
)
from cell.runs.schema import (
    ExecutedCloud,
    ExecutedCoverage,
    ExecutedDeviation,
    ExecutedLocalisation,
    ExecutedMotion,
    ExecutedPart,
    ExecutedRegion,
    ExecutedRegistration,
    ExecutedSettings,
    ExecutedSurface,
    ExecutedView,
    ExecutionReport,
    Manifest,
    PlanFile,
    PlanView,
    SurfaceDeviation,
)
from cell.scan.execution import plan_execution
from cell.scan.execution_folder import ExecutionFolder
from cell.scan.options import ScanOptions
from cell.scan.point_checks import find_contradictions
from cell.session import Session, Stream, random_stream
from cell.view import run_pages
from cell.view.pictures import draw_part_and_views
from cell.view.surface import MeasuredSamples, canvas_of
from cell.world.prediction import held_out_samples
from planner.errors import PlannerError
from planner.geometry.closest import ClosestPointQuery
from planner.geometry.mesh import TriangleMesh
from planner.geometry.rigid import pose_difference
from planner.measurability import coverage
from planner.measurability.quality import best_spacing
from planner.ports import Rejection, Scanner
from planner.registration.cloud import PointCloud, ScanCloud, merge, point_spacing
from planner.registration.localisation import SearchRange, fit_surface
from planner.registration.observability import RigidFit, describe
from planner.registration.registration import Registration, ScanRegistration, register
from planner.registration.surface import EDGE_BAND, Deviation, measure_deviation
from planner.values import Bools, Floats

DETERMINED = 5e-5
"""A direction is determined if two standard deviations move the part by less [m]."""

_NOISE = 5.0  # robust sigma of the distances to the reference, beyond which a point is more than noise
_EXACT = 1e-6  # m; a point nearer to the reference is on it
_NEIGHBOURS = 8  # for the comparison of an outlier with its surroundings
_ISOLATED = 3.0  # spacings: the median neighbour of an isolated point is farther away
_CLOUD_SAMPLES = 40_000  # points that represent all in the rms distance to the reference
_SHOWN_POINTS = 2000  # points of a cloud that represent all in the largest standard deviation


@dataclass(frozen=True, slots=True, eq=False)
class ScanOutcome:
    """Outcome of `cell scan`.

    Attributes:
        folder: of the execution.
        exit_code: 0; 3 if a complete execution does not reach the coverage that the plan requires; 6 for the report of
            an execution with missing views.
        report: its report.json.
    """

    folder: Path
    exit_code: int
    report: ExecutionReport


def make_report(session: Session[None], folder: Path, execution: str) -> ScanOutcome:
    """Report an earlier execution from its scans; missing ones are noted.

    Args:
        session: of the command.
        folder: of a finished plan.
        execution: its id, or "latest".

    Raises:
        CellError: with an exit code.
    """
    run = open_finished(folder)
    recorded = read_execution(run, execution)
    status, name = recorded.manifest.status or "running", recorded.folder.name
    if status == "running" and is_running(recorded.manifest):
        raise FileError(
            f"execution {name} is still running (process {recorded.manifest.pid}); wait until it ends, or stop it with "
            "Ctrl-C"
        )
    if status != "finished":
        session.note(f"execution {name} did not finish (its status is '{status}'); the existing scans are used")
    opened = ExecutionFolder.reopen(recorded.folder, recorded.manifest)
    cell = read_cell(run, options_of(recorded).resolution_deg)
    # Status and exit code describe the end of the execution, not of its report.
    ended, exit_code = ("incomplete" if status == "running" else status), opened.manifest.exit_code
    report = report_execution(session.opened(opened, run.seed), run, cell, recorded)
    for sentence in report.unusable_files:
        session.note(sentence)
    if report.missing_views:
        session.note(
            f"the execution is incomplete: {report.n_views} of {report.n_views + len(report.missing_views)} views are "
            "scanned; the report covers these; cell scan --resume scans the others"
        )
        return ScanOutcome(opened.finish(exit_code, ended), FileError.exit_code, report)
    code = exit_code_of(report, cell)
    return ScanOutcome(opened.finish(code if status == "finished" else exit_code, ended), code, report)


@dataclass(frozen=True, slots=True, eq=False)
class ExecutionResults:
    """Results of an execution.

    Attributes:
        scans: usable scans, in driving order.
        unusable: one sentence for each file that cannot be used.
        merged: cloud and registration.
        achieved: coverage.
        surface: the reconstruction.
        deviation: of the surface from the reference; None without a surface.
        doubts: one sentence for each contradiction in the points.
    """

    scans: Sequence[ExecutedScan]
    unusable: Sequence[str]
    merged: "MergedScans"
    achieved: "AchievedCoverage"
    surface: Reconstruction
    deviation: Deviation | None
    doubts: Sequence[str] = ()


def report_execution(
    session: Session[ExecutionFolder], run: Run, cell: RunCell, recorded: RecordedExecution
) -> ExecutionReport:
    """Merge, reconstruct, measure and report the scans of an execution."""
    folder, options = session.folder, options_of(recorded)
    seed = run.seed if folder.manifest.seed is None else folder.manifest.seed
    results = _measure(session, run, cell, recorded, options, seed)
    with session.stage("report"):
        plan = plan_execution(run.motion, options.view)
        # For a resumed execution only the duration of its last part is known.
        is_timed = bool(folder.manifest.simulated_time) and not folder.manifest.resumptions
        executed_s = folder.manifest.motion_s if is_timed else None
        motion = ExecutedMotion(planned_s=plan.planned_seconds, executed_s=executed_s)
        settings = _settings(cell, recorded.manifest.options, seed)
        report = _execution_report(run, cell, settings, results, plan.stops, motion)
        folder.write_json("report.json", report.as_json())
        section = _inspect(session, run, recorded)
        folder.write_text("report.md", "\n".join([scan_report.markdown(report), *section]))
        _draw(run, folder, cell, recorded, report, results)
    return report


def _measure(
    session: Session[ExecutionFolder],
    run: Run,
    cell: RunCell,
    recorded: RecordedExecution,
    options: ScanOptions,
    seed: int,
) -> ExecutionResults:
    """Compute the results and write cloud and mesh."""
    folder, nearest = session.folder, ClosestPointQuery(cell.reference)
    with session.stage("merge"):
        scans, unusable = usable_scans(recorded, run.plan.views)
        for name in sorted(scan_name(scan.stop) for scan in scans):  # a killed execution recorded no sha256
            folder.adopt(f"scans/{name}")
        doubts = find_contradictions(scans, cell, nearest, options.points_units)
        for doubt in doubts:
            session.note(doubt)
        merged = merge_execution(run, recorded, scans, nearest)
        if merged.fit is not None:
            cell = cell.about_part(merged.fit.T)
        source, sigma = source_of(scans), point_sigma(merged, scans, cell.scanner)
        folder.write_bytes("cloud.ply", point_files.cloud_ply(merged.cloud, merged.stop, sigma, source))

    with session.stage("reconstruct"):
        surface = reconstruct(merged.cloud, close=options.close_holes)
        for doubt in surface.doubts:
            session.note(doubt)

    with session.stage("measure"):
        achieved = achieved_coverage(scans, run.plan, merged, cell, run.seed)
        deviation = None
        if surface.mesh is None:
            folder.remove("mesh.ply")
        else:
            deviation = write_mesh(session, folder, surface.mesh, surface, nearest, seed, source)
    return ExecutionResults(scans, unusable, merged, achieved, surface, deviation, doubts)


def write_mesh(
    session: Session[Any], folder: RunFolder, mesh: TriangleMesh, surface: Reconstruction, nearest: ClosestPointQuery,
    seed: int, source: str,
) -> Deviation:  # fmt: skip
    """Write the mesh of a reconstruction with its deviation from the reference, and return the deviation."""
    rng, count = random_stream(seed, Stream.DEVIATION_SAMPLES), session.effort.deviation_samples
    band = EDGE_BAND * surface.spacing
    deviation = measure_deviation(mesh, nearest, rng, closed=surface.closed, count=count, edge_band=band)
    folder.write_bytes("mesh.ply", point_files.mesh_ply(mesh, surface.closed, deviation.at_vertices, source))
    return deviation


def _inspect(session: Session[ExecutionFolder], run: Run, recorded: RecordedExecution) -> list[str]:
    """Inspect the features of a run, if it has any; return the section of the report."""
    plan, folder = read_plan(run), session.folder
    if plan is None or not recorded.scans:
        return []
    inspection = inspect_execution(plan, run.reference, run, recorded)
    inspection.write(lambda name, content: folder.write_bytes(name, [content]), qif_of_run(run))
    for each in inspection.result.characteristics:
        if each.verdict == "fail":
            session.note(f"{each.name} fails: {each.value:.4f} {each.unit}, U {each.expanded_uncertainty:.4f}")
    return inspection.section()


def options_of(recorded: RecordedExecution) -> ScanOptions:
    """Return the options of an execution; defaults for those that its manifest lacks."""
    with reading(recorded.folder / "manifest.json"):
        return ScanOptions.from_manifest(recorded.manifest.options)


def exit_code_of(report: ExecutionReport, cell: RunCell) -> int:
    """Return 3 if an execution of all views does not reach the coverage that the plan requires, else 0."""
    return 3 if report.settings.view is None and report.coverage.visible < cell.scene.plan.required_visible else 0


def _draw(
    run: Run,
    folder: ExecutionFolder,
    cell: RunCell,
    recorded: RecordedExecution,
    report: ExecutionReport,
    results: ExecutionResults,
) -> None:
    """Write the page and the pictures for which there are data."""
    title = scan_report.source_title(report.source)
    if results.surface.mesh is None or results.deviation is None:
        folder.remove("deviation.png")
    else:
        scan_report.draw_deviation(folder.path / "deviation.png", results.surface.mesh, results.deviation, title)
        folder.adopt("deviation.png")
    scans, achieved = results.scans, results.achieved
    canvas = canvas_of(cell.reference, achieved.surface.samples)
    names = {scan_name(scan.stop) for scan in scans}
    used = replace(recorded, scans=tuple(scan for scan in recorded.scans if scan.name in names))
    execution = Execution(folder.path, Manifest(), report)  # its manifest is not written yet
    folder.write_text(run_pages.PAGE_FILE, run_pages.execution_page(run, used, execution, (canvas, achieved.surface)))
    if not scans:
        folder.remove("views.png")
        folder.remove("cover.png")
        return
    from cell.report import figures  # matplotlib

    poses = np.stack([poses[len(poses) // 2] for poses in executed_poses(scans, results.merged)])
    opening, stops = cell.scanner_keys.opening_deg, [scan.stop for scan in scans]
    draw_part_and_views(folder.path / "views.png", canvas, achieved.surface, poses, opening, stops, title)
    figures.cover_curve(
        folder.path / "cover.png",
        marginal_area=achieved.marginal_sorted,
        coverable=run.plan.coverage.coverable,
        total=1.0,
        lower_bound=run.plan.lower_bound,
    )
    folder.adopt("views.png")
    folder.adopt("cover.png")


# Usable scans


def usable_scans(
    recorded: RecordedExecution, planned: Sequence[PlanView]
) -> tuple[tuple[ExecutedScan, ...], tuple[str, ...]]:
    """Return the complete and unchanged scans of the plan, in driving order, and a sentence about each other file.

    Args:
        recorded: files of the execution.
        planned: the plan's views in visiting order.
    """
    unusable = list(recorded.unreadable)
    scans: list[ExecutedScan] = []
    for scan in recorded.scans:
        try:
            _require_usable(recorded, scan, planned)
            scans.append(scan)
        except FileError as error:
            unusable.append(str(error))
    return tuple(scans), tuple(sentence.replace(f"{recorded.folder}/", "") for sentence in unusable)


def _require_usable(recorded: RecordedExecution, scan: ExecutedScan, planned: Sequence[PlanView]) -> None:
    """Raise FileError unless a scan is unchanged and belongs to the view of its file name, which is unique."""
    path = recorded.folder / "scans" / scan.name
    expected = recorded.manifest.artefacts.get(f"scans/{scan.name}")
    if expected is not None and hashlib.sha256(file_bytes(path)).hexdigest() != expected:
        raise FileError(
            f"{path} is not the file that the execution wrote (its sha256 is not the manifest's); scan again"
        )
    if not 1 <= scan.stop <= len(planned):
        raise FileError(f"{path} belongs to view {scan.stop}, and the plan has the views 1 to {len(planned)}")
    if scan.name != scan_name(scan.stop):
        raise FileError(f"{path} belongs to view {scan.stop}, whose file is {scan_name(scan.stop)}")
    candidate = planned[scan.stop - 1].id
    if scan.view != candidate:
        raise FileError(
            f"{path} belongs to candidate {scan.view}, and view {scan.stop} of the plan is candidate {candidate}"
        )


def scan_name(stop: int) -> str:
    """Return the file name of a view, by its number from 1 in visiting order."""
    return f"{stop:04d}.npz"


def source_of(scans: Sequence[ExecutedScan]) -> str:
    """Return the source of the points in words; "no points" without scans."""
    return "; ".join(dict.fromkeys(scan.source for scan in scans)) or "no points"


# Merged scans


@dataclass(frozen=True, slots=True, eq=False)
class MergedScans:
    """All scans in the object frame.

    Attributes:
        cloud: merged, with normals.
        stop: (N,) number of each point's view.
        poses: one (4, 4) T_object_scanner per scan, after registration [m].
        registration: None if not requested.
        rms_before: rms distance of the points to the reference by the reported poses [m]; NaN without points.
        rms_after: the same after registration [m].
        outliers: number of removed points off the reference without neighbours; 0 for simulated points.
        fit: motion of all scans as one body onto the reference; None if the part is at its planned placement.
    """

    cloud: PointCloud
    stop: NDArray[np.int32]
    poses: tuple[Floats, ...]
    registration: Registration | None
    rms_before: float
    rms_after: float
    outliers: int = 0
    fit: RigidFit | None = None


def merge_execution(
    run: Run,
    recorded: RecordedExecution,
    scans: Sequence[ExecutedScan],
    nearest: ClosestPointQuery,
    search: SearchRange | None = None,
) -> MergedScans:
    """Merge scans of an execution by its own options and seed; `search` counts if it has no set-up error."""
    options, seed = options_of(recorded), recorded.manifest.seed
    search = search if options.search_range is None else SearchRange(*options.search_range)
    rng = random_stream(run.seed if seed is None else seed, Stream.REGISTRATION_STARTS)
    return merge_scans(scans, nearest, registered=options.registers, search=search, rng=rng)


def merge_scans(
    scans: Sequence[ExecutedScan],
    nearest: ClosestPointQuery,
    *,
    registered: bool,
    search: SearchRange | None = None,
    rng: np.random.Generator | None = None,
) -> MergedScans:
    """Transform the scans to the object frame by their reported poses, and correct these if requested.

    Args:
        scans: of one execution.
        nearest: the reference.
        registered: whether to correct the reported poses by registration.
        search: range in which the part is localised first; None for its planned placement.
        rng: of the start motions of the localisation.

    Raises:
        FileError: if too few points lie near the part to localise it.
    """
    clouds = [ScanCloud(scan.points, scan.T_reported[:3, 3]) for scan in scans]
    before = _rms_distance(nearest, clouds)
    after, registration, fit = before, None, None
    poses = [scan.T_reported for scan in scans]
    if search is not None and rng is not None and clouds:
        vertices = nearest.mesh.vertices
        centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
        with errors_as(FileError, PlannerError):
            fit = fit_surface(clouds, nearest, centre, search, rng)
        clouds, poses = [cloud.transformed(fit.T) for cloud in clouds], [fit.T @ pose for pose in poses]
        after = _rms_distance(nearest, clouds)
    if registered and clouds:
        registration = register(clouds, nearest)
        corrections = [result.T_correction for result in registration.scans]
        clouds = [cloud.transformed(T) for cloud, T in zip(clouds, corrections, strict=True)]
        poses = [T @ pose for T, pose in zip(corrections, poses, strict=True)]
        after = _rms_distance(nearest, clouds)
    cloud, count = merge(clouds), sum(map(len, clouds))
    if any(scan.T_true is None for scan in scans) and count:
        keep = ~_is_outlier(nearest, cloud)
        if not keep.all():
            parts = np.split(keep, np.cumsum([len(each) for each in clouds])[:-1])
            clouds = [ScanCloud(each.points[rows], each.sensor) for each, rows in zip(clouds, parts, strict=True)]
            cloud, after = merge(clouds), _rms_distance(nearest, clouds)
    stop = np.array([scan.stop for scan in scans], dtype=np.int32)[cloud.scan]
    return MergedScans(cloud, stop, tuple(poses), registration, before, after, count - len(cloud), fit)


def point_sigma(merged: MergedScans, scans: Sequence[ExecutedScan], scanner: Scanner) -> Floats:
    """Return the expected standard deviation (N,) of each merged point along its ray [m], by the scanner's model.

    The model gets the normals of the cloud and the registered poses. NaN for a scanner without a model, for a sweep
    (the pose of each point is not stored), and for a point that is seen from behind.
    """
    sigma = np.full(len(merged.cloud), np.nan)
    law = getattr(scanner, "sigma", None)
    for number, (scan, T) in enumerate(zip(scans, merged.poses, strict=True)):
        is_of_scan = merged.cloud.scan == number
        if callable(law) and len(scan.T_reported_poses) == 1 and is_of_scan.any():
            R, t = T[:3, :3], T[:3, 3]
            sigma[is_of_scan] = law((merged.cloud.points[is_of_scan] - t) @ R, merged.cloud.normals[is_of_scan] @ R)
    sigma[~np.isfinite(sigma)] = np.nan
    return sigma


def _is_outlier(nearest: ClosestPointQuery, cloud: PointCloud) -> Bools:
    """Return (N,) points off the reference by more than noise that differ from their neighbours.

    A dent is no outlier: its points and their neighbours are off by the same amount.
    """
    points = cloud.points
    distance = nearest.signed_distance(points)
    limit = max(_NOISE * 1.4826 * float(np.median(np.abs(distance))), _EXACT)
    count = min(_NEIGHBOURS + 1, len(points))
    spacing, index = (np.reshape(each, (len(points), count)) for each in cKDTree(points).query(points, count))
    is_isolated = spacing[:, count // 2] > _ISOLATED * point_spacing(points, cloud.scan)
    usual = np.median(distance[index], axis=1)
    return np.asarray((np.abs(distance) > limit) & (is_isolated | (np.abs(distance - usual) > limit)))


def _rms_distance(nearest: ClosestPointQuery, clouds: Sequence[ScanCloud]) -> float:
    points = np.concatenate([np.empty((0, 3)), *(cloud.points for cloud in clouds)])
    if not len(points):
        return float("nan")
    samples = points[np.linspace(0, len(points) - 1, min(len(points), _CLOUD_SAMPLES)).astype(np.int64)]
    return float(np.sqrt(np.mean(nearest.closest(samples).distance ** 2)))


def executed_poses(scans: Sequence[ExecutedScan], merged: MergedScans) -> list[Floats]:
    """Return the (K, 4, 4) poses of each scan [m]: the true ones of a simulation, else the registered ones."""
    return [
        T @ np.linalg.inv(scan.T_reported) @ scan.T_reported_poses if scan.T_true_poses is None else scan.T_true_poses
        for scan, T in zip(scans, merged.poses, strict=True)
    ]


# Coverage


@dataclass(frozen=True, slots=True, eq=False)
class AchievedCoverage:
    """Coverage of an execution on the samples of the plan's prediction.

    Attributes:
        values: for the report. `visible` counts the true poses of a simulation, else the registered ones; `dense` is
            null for a sweep, whose simulated lines are farther apart than the real ones (`cell.scan.simulated`).
        marginal: (n,) marginal coverage of each scan in driving order.
        marginal_sorted: (n,) marginal coverage if the scan with the largest gain comes first each time.
        surface: held-out samples measured by the scans.
    """

    values: ExecutedCoverage
    marginal: Floats
    marginal_sorted: Floats
    surface: MeasuredSamples


def achieved_coverage(
    scans: Sequence[ExecutedScan], plan: PlanFile, merged: MergedScans, cell: RunCell, plan_seed: int
) -> AchievedCoverage:
    """Measure coverage on the held-out samples of the plan, which `plan_seed` reproduces."""
    samples = held_out_samples(cell.reference, cell.planning, plan_seed)
    surface = run_pages.measured_by_views(cell, samples, executed_poses(scans, merged))
    measured, points = surface.seen, merged.cloud.points
    predicted, coverable = plan.coverage.visible, plan.coverage.coverable
    poses = [plan.views[scan.stop - 1].T_object_poses for scan in scans]
    if sorted(scan.stop for scan in scans) != list(range(1, len(plan.views) + 1)):
        predicted = coverage.coverage_of_views(run_pages.measured_by_views(cell, samples, poses).seen, samples).fraction
    radius, spacing = coverage.sampling_radius(cell.reference), None
    if poses and len(poses[0]) == 1:
        # The grid of the plan's scanner counts, whatever the resolution of the scan.
        planned = scanner_of(cell.scene, cell.scene.scanner)
        spacing = best_spacing(np.stack(poses), samples, measured, planned)
    visible = coverage.coverage_of_views(measured, samples).fraction
    values = ExecutedCoverage(
        kind="simulated" if all(scan.T_true is not None for scan in scans) else "model",
        visible=visible,
        predicted=predicted,
        predicted_all_views=plan.coverage.visible,
        coverable=coverable,
        visible_of_coverable=visible / coverable if coverable > 0 else 0.0,
        sampled=coverage.sampled_coverage(points, samples, radius).fraction,
        dense=None if spacing is None else coverage.dense_coverage(points, samples, spacing).fraction,
        sampled_radius_mm=_mm(radius),
    )
    largest_first = coverage.marginal_coverage(measured[:, _largest_gain_first(measured)])
    return AchievedCoverage(values, coverage.marginal_coverage(measured), largest_first, surface)


def _largest_gain_first(measured: Bools) -> list[int]:
    """Return the views in the order in which each has the largest marginal coverage."""
    remaining, order = np.ones(len(measured), dtype=np.bool_), list[int]()
    for _ in range(measured.shape[1]):
        gains = (measured & remaining[:, None]).sum(axis=0)
        gains[order] = -1
        order.append(int(gains.argmax()))
        remaining &= ~measured[:, order[-1]]
    return order


# report.json


def _execution_report(
    run: Run,
    cell: RunCell,
    settings: ExecutedSettings,
    results: ExecutionResults,
    stops: Sequence[int],
    motion: ExecutedMotion,
) -> ExecutionReport:
    """Return the content of report.json; `stops` are the views that were to be scanned."""
    scans, merged = results.scans, results.merged
    scanned = {scan.stop for scan in scans}
    missing = tuple(stop for stop in stops if stop not in scanned)
    return ExecutionReport(
        part=ExecutedPart(name=cell.scene.part.name, faces=len(cell.reference.faces)),
        complete=not missing and not results.unusable,
        missing_views=missing,
        unusable_files=tuple(results.unusable),
        settings=settings,
        n_views=len(scans),
        n_views_planned=len(run.plan.views),
        n_points=len(merged.cloud),
        source=source_of(scans),
        contradictions=tuple(results.doubts),
        coverage=results.achieved.values,
        regions=_region_values(cell, results.achieved),
        views=tuple(_view_values(k, scan, results) for k, scan in enumerate(scans)),
        cloud=ExecutedCloud(
            rms_to_reference_mm=_finite_mm(merged.rms_after),
            rms_to_reference_as_reported_mm=_finite_mm(merged.rms_before),
            outliers=merged.outliers,
        ),
        localisation=localisation_values(merged, scans),
        registration=None if merged.registration is None else registration_values(merged.registration),
        surface=surface_values(cell.reference, results.surface),
        deviation=None if results.deviation is None else deviation_values(results.deviation),
        motion=motion,
    )


def _settings(cell: RunCell, options: Mapping[str, object], seed: int) -> ExecutedSettings:
    """Return the settings of an execution from the options of its manifest; a missing option is null."""
    names = ("driver", "view", "actual", "range_noise_mm", "pose_error_mm", "pose_error_deg", "register", "close_holes")
    return ExecutedSettings.model_validate(
        {
            **{name: options.get(name) for name in names},
            "noise": options.get("noise", "none"),
            "scanner": cell.scanner_keys.type,
            "resolution_deg": cell.scanner_keys.pair("resolution_deg") or (),
            "rays_per_scan": cell.scanner.grid_shape[0] * cell.scanner.grid_shape[1],
            "seed": seed,
        }
    )


def _region_values(cell: RunCell, achieved: AchievedCoverage) -> tuple[ExecutedRegion, ...] | None:
    """Return the coverage of each region; None for a part without regions."""
    of_sample = achieved.surface.samples.region
    if of_sample is None:
        return None
    times, regions = achieved.surface.seen.sum(axis=1), []
    for number, region in enumerate(cell.scene.regions or ()):
        region_times, views = times[of_sample == number], region.views or cell.scene.plan.multiplicity
        if len(region_times):
            visible, enough = float((region_times > 0).mean()), float((region_times >= views).mean())
            regions.append(ExecutedRegion(name=region.name, visible=visible, views=views, satisfied_share=enough))
    return tuple(regions)


def _view_values(k: int, scan: ExecutedScan, results: ExecutionResults) -> ExecutedView:
    before = None if scan.T_true is None else pose_difference(scan.T_true, scan.T_reported)
    after = None if scan.T_true is None else pose_difference(scan.T_true, results.merged.poses[k])
    registration = results.merged.registration
    registered = None if registration is None else registration.scans[k]
    counts = scan.counts
    return ExecutedView(
        number=scan.stop,
        id=scan.view,
        points=len(scan.points),
        rays=None if counts is None else {reason.name.lower(): int(counts[reason]) for reason in Rejection},
        marginal_coverage=float(results.achieved.marginal[k]),
        reported_minus_commanded_deg=float(np.degrees(np.abs(scan.q_reported - scan.q_commanded)).max().round(6)),
        pose_error_mm=None if before is None else _mm(before[0]),
        pose_error_deg=None if before is None else _deg(before[1]),
        pose_error_after_mm=None if after is None else _mm(after[0]),
        pose_error_after_deg=None if after is None else _deg(after[1]),
        **_split_errors(scan, results.merged.poses[k], registered),
        registration=None if registered is None else registered.sentence,
        free_directions=0 if registered is None else len(registered.free),
    )


def _split_errors(scan: ExecutedScan, T_registered: Floats, registered: ScanRegistration | None) -> dict[str, float]:
    """Return the pose errors along determined and undetermined directions; empty if they are not known."""
    if scan.T_true is None or registered is None:
        return {}
    before, _ = registered.split_motion(scan.T_true @ np.linalg.inv(scan.T_reported))
    after, free = registered.split_motion(scan.T_true @ np.linalg.inv(T_registered))
    return {
        "determined_error_mm": _mm(before[0]),
        "determined_error_after_mm": _mm(after[0]),
        "determined_error_deg": _deg(before[1]),
        "determined_error_after_deg": _deg(after[1]),
        "undetermined_error_mm": _mm(free[0]),
        "undetermined_error_deg": _deg(free[1]),
    }


def localisation_values(merged: MergedScans, scans: Sequence[ExecutedScan]) -> ExecutedLocalisation | None:
    """Return the localised placement of the part; None without localisation."""
    if (fit := merged.fit) is None:
        return None
    centre = fit.centre
    moved = fit.T[:3, :3] @ centre + fit.T[:3, 3] - centre
    errors = [
        fit.determined_part(scan.T_true @ np.linalg.inv(T), DETERMINED)
        for scan, T in zip(scans, merged.poses, strict=True)
        if scan.T_true is not None
    ]
    worst = fit.worst_point_sd(merged.cloud.points[:: max(1, len(merged.cloud) // _SHOWN_POINTS)])
    undetermined = fit.undetermined_motions(DETERMINED)
    return ExecutedLocalisation(
        displacement_mm=_mm(float(np.linalg.norm(moved))),
        rotation_deg=_deg(pose_difference(fit.T, np.eye(4))[1]),
        max_point_sd_mm=None if worst is None else _mm(worst),
        free_motions=(*([describe(undetermined)] if undetermined else []), *fit.alternatives),
        error_mm=_mm(max(shift for shift, _ in errors)) if errors else None,
        error_deg=_deg(max(turn for _, turn in errors)) if errors else None,
    )


def registration_values(registration: Registration) -> ExecutedRegistration:
    """Return the numbers of a registration."""
    return ExecutedRegistration(
        rms_before_mm=_finite_mm(registration.rms_before),
        rms_after_mm=_finite_mm(registration.rms_after),
        iterations=registration.iterations,
        overlapping_pairs=len(registration.overlaps),
        uncorrected_scans=sum(not scan.is_corrected for scan in registration.scans),
    )


def surface_values(reference: TriangleMesh, surface: Reconstruction) -> ExecutedSurface:
    """Return the numbers of a reconstructed surface."""
    return ExecutedSurface(
        status=surface.status.value,
        vertices=0 if surface.mesh is None else len(surface.mesh.vertices),
        faces=0 if surface.mesh is None else len(surface.mesh.faces),
        closed_faces=int(surface.closed.sum()),
        spacing_mm=_finite_mm(surface.spacing),
        max_point_distance_mm=_finite_mm(REACH * surface.spacing),
        diagonal_mm=_mm(reference.diagonal),
        grid_mm=_finite_mm(surface.grid),
        outliers=surface.outliers,
        holes=surface.holes,
    )


def deviation_values(deviation: Deviation) -> ExecutedDeviation:
    """Return the numbers of a deviation."""
    closed = None if deviation.closed is None else SurfaceDeviation(**_deviation_numbers(deviation.closed))
    with_edges = deviation.with_edges and SurfaceDeviation(**_deviation_numbers(deviation.with_edges))
    return ExecutedDeviation(
        **_deviation_numbers(deviation),
        closed_holes=closed,
        with_edges=with_edges,
        edge_share=round(deviation.edge_share, 6),
    )


def _deviation_numbers(deviation: Deviation) -> dict[str, float]:
    return {
        "rms_mm": _mm(deviation.rms),
        "mean_mm": _mm(deviation.mean),
        "quantile_95_mm": _mm(deviation.quantile_95),
        "max_mm": _mm(deviation.largest),
        "samples": deviation.sample_count,
    }


def _mm(metres: float) -> float:
    return round(float(metres) * 1000, 6)


def _finite_mm(metres: float) -> float | None:
    return _mm(metres) if np.isfinite(metres) else None


def _deg(radians: float) -> float:
    return round(float(np.degrees(radians)), 6)
