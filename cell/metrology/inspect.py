"""`cell inspect`: measured points, a mesh or an execution compared with the tolerances of a part."""

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from cell.errors import FileError, UsageError, errors_as
from cell.files import atomic_write, file_errors
from cell.inspect.features import InspectionPlan
from cell.inspect.inspection import Inspected, inspect_points, plan_inspection, qif_of_run, qif_source, read_plan
from cell.inspect.measured import MeasuredPoints
from cell.metrology import point_files
from cell.metrology.options import InspectOptions
from cell.part import mesh_files, workpiece
from cell.part.formats import STEP, UNITS
from cell.part.ply_elements import PlyError, read_elements
from cell.runs.run import RecordedExecution, Run, execution_of, open_finished, read_execution
from cell.scene.model import Scene
from cell.session import ProgressReporter, Stream, random_stream
from planner.errors import PlannerError
from planner.geometry.closest import ClosestPointQuery
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import draw_samples
from planner.registration.cloud import ScanCloud
from planner.registration.localisation import SearchRange, fit_surface
from planner.registration.rigid import transform_points
from planner.values import Floats, Ints

_FINE_MESH = 20_000  # vertices of a mesh that was reconstructed from points; a coarser one is sampled
_MESH_SAMPLES = 200_000
REGISTERED = "errors that the registration leaves in the poses are not in U"
_FAR = 10.0  # diagonals of the part: distance of an assumed scanner


def inspect(
    source: Path, scene: Scene | None, options: InspectOptions, reporter: ProgressReporter, out: Path | None
) -> tuple[Path, Inspected]:
    """Inspect points, and write the results.

    Args:
        source: file of points or a mesh, or folder of an execution.
        scene: with the part and its characteristics; None takes those of the run of an execution.
        options: of the points of a file.
        reporter: of the progress.
        out: folder of the results; None makes one below sim_runs/.

    Returns:
        The folder, and the results.

    Raises:
        CellError: with an exit code.
    """
    run, execution = None, ""
    if source.is_dir():
        if (found := execution_of(source)) is None:
            raise FileError(f"{source} is no folder of an execution; give executions/<id> of a run, or a file")
        if options != InspectOptions():
            raise UsageError(
                f"--points-units, --search and --point-sd are for points of a file, and {source} is an execution with "
                "a unit, a place and errors of its own; omit them"
            )
        run, execution = open_finished(found[0]), found[1]
    with reporter.stage("read the characteristics"):
        plan, reference, qif, name = _characteristics(run, scene)
    with reporter.stage("read the points"):
        if run is None:
            measured, words = _file_points(source, options)
            measured, alignment, T_located = located(measured, reference, options)
    for sentence in (*plan.notes, *plan.unsupported):
        reporter.note(sentence)
    with reporter.stage("inspect"):
        if run is None:
            outcome = inspect_points(
                plan, reference, measured, part=name, source=words, is_simulated=False, alignment=alignment,
                T_located=T_located,
            )  # fmt: skip
        else:
            outcome = inspect_execution(plan, reference, run, read_execution(run, execution))
        for each in outcome.result.characteristics:
            if "nearly not determined" in each.note:
                reporter.note(f"{each.name}: {each.note}")
        folder = Path("sim_runs") / f"inspect-{datetime.now(UTC):%Y%m%dT%H%M%SZ}" if out is None else out
        write_results(folder, outcome, qif)
    return folder, outcome


def write_results(folder: Path, outcome: Inspected, qif: bytes | None) -> None:
    """Write the results of an inspection to a folder.

    Raises:
        FileError: if it cannot be written.
    """
    from cell.inspect.pictures import features_picture, report_pdf

    def write(name: str, content: bytes) -> None:
        with atomic_write(folder / name) as path:
            path.write_bytes(content)

    with file_errors(f"{folder} cannot be written", "choose another --out"):
        outcome.write(write, qif)
        title = f"# Inspection of {outcome.result.part} ([view](features.html))"
        text = "\n".join([title, "", "![The features](features.png)", "", *outcome.section()])
        write("report.md", text.encode())
        with atomic_write(folder / "features.png") as path:
            features_picture(path, outcome.reference, outcome.plan, outcome.result)
        with atomic_write(folder / "report.pdf") as path:
            report_pdf(path, folder / "features.png", outcome.result)


def _characteristics(run: Run | None, scene: Scene | None) -> tuple[InspectionPlan, TriangleMesh, bytes | None, str]:
    """Return the characteristics, the part, the QIF file and the name of the part."""
    if scene is not None:
        part = workpiece.load(scene.part.source, scene.part.units)
        plan = plan_inspection(scene, part)
        if plan is None:
            raise UsageError("the scene has no [[feature]] and no QIF file; give --qif, or --scene with features")
        return plan, part.reference, qif_source(scene), part.name
    assert run is not None, "a file needs a scene"
    plan = read_plan(run)
    if plan is None:
        raise UsageError(f"{run.folder} was planned without characteristics; give --part and --qif, or --scene")
    return plan, run.reference, qif_of_run(run), run.scene.part.name


def inspect_execution(
    plan: InspectionPlan, reference: TriangleMesh, run: Run, recorded: RecordedExecution
) -> Inspected:
    """Inspect the merged points of an execution.

    Raises:
        FileError: if they are missing or damaged.
    """
    path = recorded.folder / "cloud.ply"
    try:
        vertex = read_elements(path.read_bytes())["vertex"]
    except (OSError, KeyError, PlyError) as error:
        raise FileError(
            f"{path} is missing or damaged; write it again with cell scan --report {recorded.folder.name}"
        ) from error
    views = vertex.columns("view")[:, 0].astype(np.int64) - 1
    sigma = vertex.columns("scalar_sigma_mm")[:, 0] / 1000
    points, normals = vertex.columns("x", "y", "z") / 1000, vertex.columns("nx", "ny", "nz")
    measured = execution_points(run, recorded, points, normals, sigma, views)
    simulated, options = all(scan.T_true is not None for scan in recorded.scans), recorded.manifest.options or {}
    registered = bool(options.get("register"))
    return inspect_points(
        plan,
        reference,
        measured,
        part=run.scene.part.name,
        source="; ".join(dict.fromkeys(scan.source for scan in recorded.scans)),
        is_simulated=simulated,
        on_reference=simulated and not options.get("actual"),
        alignment="scans registered to each other and to the part" if registered else "scans by their reported poses",
        notes=(REGISTERED,) if registered else (),
    )


def execution_points(
    run: Run, recorded: RecordedExecution, points: Floats, normals: Floats, sigma: Floats, views: Ints
) -> MeasuredPoints:
    """Return the points of an execution with their errors.

    Args:
        run: its plan.
        recorded: the execution.
        points: (N, 3) merged, object frame [m].
        normals: (N, 3) of the surface.
        sigma: (N,) by the scanner's model along the ray [m].
        views: (N,) index of the view.
    """
    options = recorded.manifest.options or {}
    simulated = all(scan.T_true is not None for scan in recorded.scans)
    pose_error = tuple(float(str(options.get(key) or 0.0)) for key in ("pose_error_mm", "pose_error_deg"))
    noise = float(str(options.get("range_noise_mm") or 0.0)) / 1000
    if simulated:
        sigma = np.hypot(sigma if options.get("noise") == "model" else 0.0, np.full(len(points), noise))
    else:
        pose_error = run.scene.plan.pose_sd_mm, run.scene.plan.pose_sd_deg
    pose = (0.0, 0.0) if options.get("register") else pose_error
    return points_of_views(points, normals, sigma, views, run.T_object_scanner[:, :3, 3], pose)


def points_of_setups(setups: Sequence[MeasuredPoints], placements: Sequence[tuple[float, float]]) -> MeasuredPoints:
    """Return the points of several set-ups, whose registrations are errors in common.

    Args:
        setups: points of each set-up.
        placements: standard deviations of the registration of each [m, rad], about the mean of its points.
    """
    first = np.cumsum([0, *(len(each.origins) for each in setups)])
    return MeasuredPoints(
        np.concatenate([each.points for each in setups]),
        np.concatenate([each.sigma for each in setups]),
        np.concatenate([each.view + start for each, start in zip(setups, first[:-1], strict=True)]),
        np.concatenate([*(each.origins for each in setups), [each.points.mean(axis=0) for each in setups]]),
        np.concatenate([*(each.pose_sd for each in setups), np.array(placements)]),
        setup=np.repeat(first[-1] + np.arange(len(setups)), [len(each.points) for each in setups]),
    )


def points_of_views(
    points: Floats, normals: Floats, sigma: Floats, view: Ints, origins: Floats, pose: tuple[float, ...]
) -> MeasuredPoints:
    """Return points with the errors of their views.

    Args:
        points: (N, 3) [m].
        normals: (N, 3) of the surface.
        sigma: (N,) standard deviation along the ray [m]; NaN if it is not known.
        view: (N,) index of the view.
        origins: (V, 3) scanner of each view [m].
        pose: standard deviations of the pose of a view [mm, deg].
    """
    rays = points - origins[view]
    rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), np.finfo(float).tiny)
    across = np.abs(np.einsum("nj,nj->n", rays, normals)) * np.nan_to_num(sigma)
    sd = np.tile([pose[0] / 1000, np.radians(pose[1])], (len(origins), 1))
    return MeasuredPoints(points, across, np.asarray(view, dtype=np.int64), origins, sd)


def _file_points(source: Path, options: InspectOptions) -> tuple[MeasuredPoints, str]:
    """Return the points of a file, and their source; a mesh with few vertices is sampled."""
    suffix, units, words = source.suffix.lower(), options.points_units, f"points of {source.name}"
    if units is None and suffix not in (*STEP, ".3mf"):
        raise UsageError(f"{source} does not state its unit; give --points-units mm, cm, m, um or in")
    if units not in (None, "m") and suffix == ".3mf":
        raise UsageError(f"{source} states its unit; omit --points-units")
    mesh = _mesh_of(source, units or "m")
    if mesh is None:
        points = UNITS[units or "m"] * point_files.read(source)
    elif len(mesh.vertices) >= _FINE_MESH:
        points, words = mesh.vertices, f"vertices of {source.name}"
    else:
        rng = random_stream(0, Stream.DEVIATION_SAMPLES)
        points = draw_samples(mesh, mesh, _MESH_SAMPLES, rng).points
        words = f"surface of {source.name}, {_MESH_SAMPLES:,} samples on {len(mesh.faces):,} triangles"
    if not len(points):
        raise FileError(f"{source} has no points")
    sd = (options.point_sd_mm or 0.0) / 1000
    return _single_view(points, sd), words


def _single_view(points: Floats, sd: float) -> MeasuredPoints:
    return MeasuredPoints(
        points, np.full(len(points), sd), np.zeros(len(points), np.int64), points.mean(axis=0)[None], np.zeros((1, 2))
    )


def _mesh_of(source: Path, units: str) -> TriangleMesh | None:
    """Return the triangles of a file [m], as `mesh_files.parse_metres`; None for a file of points."""
    suffix = source.suffix.lower()
    if suffix != ".ply" and suffix in point_files.SUFFIXES:
        return None
    content = mesh_files.read_bytes(source)
    if suffix == ".ply":
        try:
            face = read_elements(content).get("face")
        except PlyError as error:
            raise FileError(f"{source} {error}") from error
        if face is None or not face.count:
            return None
    vertices, faces = mesh_files.parse_metres(source, content, units)
    return TriangleMesh(vertices, faces.astype(np.int32))


def located(
    measured: MeasuredPoints, reference: TriangleMesh, options: InspectOptions
) -> tuple[MeasuredPoints, str, Floats]:
    """Return points of a file after a search for the place of the part, the search in words, and their motion.

    Raises:
        FileError: if too few points lie near the part.
    """
    if options.search_mm == 0 == options.search_deg:
        return measured, "", np.eye(4)
    centre = (reference.vertices.min(axis=0) + reference.vertices.max(axis=0)) / 2
    search = SearchRange(options.search_mm / 1000, float(np.radians(options.search_deg)))
    rng = random_stream(0, Stream.LOCALISATION_STARTS)
    # No scanner is known: points are taken as seen from outside, in the direction of their octant.
    middle = measured.points.mean(axis=0)
    octant = (measured.points > middle) @ np.array([1, 2, 4])
    clouds = [
        ScanCloud(own, middle + _FAR * reference.diagonal * np.where(np.array([k & 1, k & 2, k & 4]) > 0, 1.0, -1.0))
        for k in range(8)
        if len(own := measured.points[octant == k])
    ]
    with errors_as(FileError, PlannerError):
        fit = fit_surface(clouds, ClosestPointQuery(reference), centre, search, rng)
    sd = float(measured.sigma[0])
    doubts = (*fit.doubts, *fit.alternatives)
    words = "; ".join([f"located within {options.search_mm:g} mm, {options.search_deg:g} deg", *doubts])
    return _single_view(transform_points(fit.T, measured.points), sd), words, fit.T
