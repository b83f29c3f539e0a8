"""Pages of a plan, of an execution and of `cell why`, read from their folders. Metres, radians.

`cell.report.figures` writes the page of a new plan with the same functions.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cell.runs import timeline as timelines
from cell.runs.cell import RunCell, read_cell
from cell.runs.next_commands import after_plan, drop_command
from cell.runs.run import Execution, RecordedExecution, Run
from cell.runs.schema import PlanView, Report
from cell.scene.model import RegionTargets
from cell.view.packed import MAX_POINTS, Layer, quantised_layer
from cell.view.page import PageContents, PageScene, PageSurface, PageView, render_page, thin_mesh
from cell.view.palette import MEASURED, REASONS, VERDICTS
from cell.view.pictures import group_names, group_numbers
from cell.view.pieces import CellGeometry, cell_of_run, with_ignored_faces
from cell.view.surface import Canvas, MeasuredSamples, canvas_of, measure_samples, viewing_directions
from cell.world.prediction import held_out_samples
from planner.geometry.closest import ClosestPointQuery
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples
from planner.kinematics.frames import kuka_abc_from_pose
from planner.ports import ARM_AXES
from planner.timing.motion import Motion
from planner.values import Floats, Ints

PAGE_FILE = "view.html"
"""Name of the page beside report.md."""

PARTIAL_PAGE_FILE = "view.html.half"
"""Name of the page's first half while the plan is not finished."""

VIEWS_LAYER = "Number of views"
"""Title of the layer of measuring views."""

_DEVIATION = "Deviation"

_QUALITY_LAYERS = {
    "sigma": ("Expected standard deviation", "of a point along its ray, in the view with the smallest value"),
    "spacing": ("Spacing of points", "larger distance between neighbours, in the view with the smallest value"),
}


def run_page(run: Run) -> str:
    """Return the page of a plan; for an unfinished run, the cell with the arm at home."""
    scene = run.scene
    title = f"View plan of {scene.part.name}"
    cell = cell_of_run(run, scene)
    if not run.is_finished:
        part = PageSurface("part", thin_mesh(run.mesh("reference.ply")))
        contents = PageContents(problems=[f"this run {run.ending}"], folder_depth=0)
        return render_page(PageScene(title, cell, [part]), contents)
    canvas, surface = measure_run(run, read_cell(run), [view.T_object_poses for view in run.plan.views])
    cell = with_ignored_faces(cell, canvas.mesh, canvas.ignored)
    part = part_surface(canvas, surface, regions=scene.regions)
    return render_page(PageScene(title, cell, [part], opens_on=VIEWS_LAYER), run_contents(run))


def why_page(run: Run, canvas: Canvas, surface: MeasuredSamples, groups: Sequence[tuple[Ints, str]]) -> str:
    """Return the page of `cell why`: the plan's page with the part coloured by causes of uncovered surface.

    Args:
        run: the plan.
        canvas: the part.
        surface: samples and the planned views that measure them.
        groups: rows of the uncovered samples of each cause, and its name; largest first.
    """
    scene = run.scene
    number = group_numbers(len(surface.samples), [rows for rows, _ in groups])
    classes = [("measured", MEASURED), *zip(group_names([name for _, name in groups]), REASONS, strict=False)]
    causes = named_layer("Cause", number, classes, canvas)
    part = part_surface(canvas, surface, [causes], scene.regions)
    cell = with_ignored_faces(cell_of_run(run, scene), canvas.mesh, canvas.ignored)
    toward = viewing_directions(canvas, number > 0, 1)[0]
    page_scene = PageScene(f"Uncovered surface of {scene.part.name}", cell, [part], toward)
    return render_page(page_scene, replace(run_contents(run), folder_depth=1))


def named_layer(title: str, which: Ints, classes: Iterable[tuple[str, str]], canvas: Canvas) -> Layer:
    """Return a layer of named classes, each with its share of the surface.

    Args:
        title: in the list of layers.
        which: (S,) class of each sample.
        classes: names with their colours.
        canvas: of the samples.
    """
    shares = np.bincount(which, canvas.samples.areas) / canvas.samples.areas.sum()
    pairs = zip(classes, shares, strict=False)
    legend = [(f"{name} ({_format_percent(share)})", colour) for (name, colour), share in pairs]
    codes = which[canvas.vertex_samples()]
    values = codes.astype(np.uint8) if which.max(initial=0) < 256 else codes.astype(np.uint16)
    return Layer(title, "named", values, canvas.note, named=legend)


def execution_page(
    run: Run, recorded: RecordedExecution, execution: Execution, known: tuple[Canvas, MeasuredSamples] | None = None
) -> str:
    """Return the page of an execution: measured surface, deviation, points, and the arm at its reported angles.

    Args:
        run: the executed run.
        recorded: the scans.
        execution: the report on them.
        known: the part, and the samples that the scans measure, if computed already.
    """
    scene = run.scene
    cell = cell_of_run(run, scene)
    if known is None:
        poses = [scan.poses for scan in recorded.scans]
        grid = execution.report.settings.resolution_deg
        known = measure_run(run, read_cell(run, grid[0] if grid else None), poses)
    surfaces = [part_surface(*known, regions=scene.regions)]
    if execution.surface is not None:
        surfaces.append(_deviation_surface(execution.surface, run.mesh("reference.ply"), execution))
    points = execution.points if recorded.scans else None
    contents = replace(execution_contents(run, recorded, execution, cell), cloud=points)
    cell = with_ignored_faces(cell, known[0].mesh, known[0].ignored)
    title = f"Scan of {scene.part.name}, points: {execution.report.source}"
    has_deviation = execution.surface is not None
    opens_on = _DEVIATION if has_deviation else VIEWS_LAYER
    return render_page(PageScene(title, cell, surfaces, opens_on=opens_on, is_alone=has_deviation), contents)


def measure_run(run: Run, cell: RunCell, poses: Sequence[Floats]) -> tuple[Canvas, MeasuredSamples]:
    """Return the part and its held-out samples with the views that measure them.

    Args:
        run: the plan.
        cell: its part and surroundings.
        poses: (K, 4, 4) of each view [m], object frame.
    """
    samples = held_out_samples(cell.reference, cell.planning, run.seed)
    return canvas_of(cell.reference, samples), measured_by_views(cell, samples, poses)


def measured_by_views(cell: RunCell, samples: SurfaceSamples, poses: Sequence[Floats]) -> MeasuredSamples:
    """Return the samples with the views that measure them; arguments as in `measure_run`."""
    stacked = np.stack(poses) if len(poses) else np.zeros((0, 1, 4, 4))
    return measure_samples(samples, stacked, cell.scanner, cell.casters)


def part_surface(
    canvas: Canvas,
    surface: MeasuredSamples,
    first: Sequence[Layer] = (),
    regions: Sequence[RegionTargets] | None = None,
) -> PageSurface:
    """Return the part with its layers.

    Args:
        canvas: the part.
        surface: samples and the views that measure them.
        first: layers before the others.
        regions: of the part, by their numbers.
    """
    rows = canvas.vertex_samples()
    layers = list(first)
    bits = np.packbits(surface.seen[rows], axis=1, bitorder="little")
    layers.append(Layer(VIEWS_LAYER, "views", bits.reshape(len(rows), -1), canvas.note))
    for name, (title, note) in _QUALITY_LAYERS.items():
        if (values := surface.layers.get(name)) is None:
            continue
        known = values[np.isfinite(values)]
        limits = (0.0, round(float(np.quantile(known, 0.98)), 6) if len(known) else 1.0)
        layers.append(quantised_layer(values[rows], title, "length", limits, note))
    if regions and (which := canvas.samples.region) is not None:
        classes = [(region.name, REASONS[1:][k % (len(REASONS) - 1)]) for k, region in enumerate(regions)]
        layers.append(named_layer("Regions", which.astype(np.int64), classes, canvas))
    return PageSurface("part", canvas.counted_mesh, layers)


def run_contents(run: Run) -> PageContents:
    """Return the views, the motion and the numbers of a run's plan, for a page in the run folder."""
    return plan_contents(run.report, run.plan.views, run.motion, run.scene.T_base_object, after_plan(run))


def plan_contents(
    report: Report, views: Sequence[PlanView], motion: Motion, T_base_object: Floats,
    following: Sequence[Sequence[str]],
) -> PageContents:  # fmt: skip
    """Return the views, the motion and the numbers of a plan, for a page in its run folder.

    Args:
        report: report.json.
        views: in visiting order.
        motion: the plan's.
        T_base_object: (4, 4) placement with a rotary table at 0 [m].
        following: commands for the plan, with RUN for its folder.
    """
    timeline = timelines.plan_timeline(motion, rest=0.0)
    at = {stop.candidate: stop.begin for stop in timeline.stops}
    page_views = [
        PageView(str(number), _pose_at_part(view, T_base_object), at.get(view.id), [
            ("view", f"{number}, candidate {view.id}"),
            ("marginal coverage", f"{_format_percent(entry.marginal_coverage)} of the surface"),
            ("A1 to A6", f"{', '.join(f'{angle:g}' for angle in view.q_deg)} deg"),
            *(("E1", f"{angle:g} deg") for angle in view.e_deg or ()),
            ("roll", f"{view.roll_deg:g} deg"),
            ("clearance", _format_mm(entry.segment_clearance_mm) + " on the path to it"),
        ], _commands(number, view.T_base_scanner, report))
        for number, (view, entry) in enumerate(zip(views, report.views, strict=True), start=1)
    ]  # fmt: skip
    coverage, moves = report.coverage, report.motion
    rows = [
        ("views", f"{report.n_views}. {report.status}"),
        ("lower bound", f"{report.lower_bound} for these candidates and samples"),
        ("visible coverage", f"{_format_percent(coverage.visible)} of the surface"),
        ("coverable", f"{_format_percent(coverage.coverable)} by reachable candidates"),
        *((f"region {each.name}", f"{_format_percent(each.visible)} measured") for each in report.regions or ()),
        ("motion", f"{moves.duration_s:.1f} s from home to home"),
        (
            "smallest clearance",
            f"{_format_mm(moves.minimum_clearance_mm)} ({moves.between})" if moves.between else "nothing near",
        ),
        ("candidates", f"{report.verdicts.reachable:,} of {report.verdicts.total:,} reachable"),
    ]
    commands = [" ".join(words) for words in following]
    return PageContents(page_views, (timeline.t, timeline.q), rows=rows, next_commands=commands, folder_depth=0)


def _pose_at_part(view: PlanView, T_base_object: Floats) -> Floats:
    """Return the (4, 4) pose of a view in base [m] with a rotary table turned back to 0."""
    return view.T_base_scanner if view.T_base_object is None else T_base_object @ view.T_object_scanner


def _commands(number: int, T_base_scanner: Floats, report: Report) -> list[str]:
    """Return commands for a view, to be pasted; `--move` has its current pose."""
    position, abc = kuka_abc_from_pose(T_base_scanner)
    pose = ",".join(f"{value:.3f}".rstrip("0").rstrip(".") for value in (*1000 * position, *np.degrees(abc)))
    drop = drop_command(report, number)
    edits = f"cell edit RUN --turn {number}:90", f"cell edit RUN --move {number}:{pose}"
    return [f"cell replay RUN --view {number}", *([" ".join(drop)] if drop else []), *edits]


def execution_contents(run: Run, recorded: RecordedExecution, execution: Execution, cell: CellGeometry) -> PageContents:
    """Return the scans, the motion and the numbers of an execution."""
    planned = run.motion if run.has("motion.npz") else None
    timeline = timelines.execution_timeline(recorded, planned, cell.arm.home, rest=0.0)
    report = execution.report
    coverage, deviation = report.coverage, report.deviation
    reported = {view.number: view for view in report.views}
    page_views = []
    for stop, scan in zip(timeline.stops, recorded.scans, strict=True):
        pose = cell.arm.link_poses(scan.q_reported)[6] @ cell.arm.T_link_scanner
        pose, view = np.linalg.inv(cell.table_motion(scan.q_reported)) @ pose, reported.get(stop.number)
        details = [("view", f"{stop.number}, candidate {stop.candidate}")]
        if view is not None:
            details += [
                ("marginal coverage", f"{_format_percent(view.marginal_coverage)} of the surface"),
                ("points", f"{view.points:,}"),
            ]
        angles = [f"{angle:.4f}" for angle in np.degrees(scan.q_reported)]
        details.append(("A1 to A6", f"{', '.join(angles[:ARM_AXES])} deg"))
        details += [("E1", f"{angle} deg") for angle in angles[ARM_AXES:]]
        command = f"cell replay RUN --execution EXECUTION --view {stop.number}"
        page_views.append(PageView(str(stop.number), pose, stop.begin, details, [command]))
    rows = [
        ("views", f"{report.n_views} of {report.n_views_planned}"),
        ("points", f"{report.n_points:,}"),
        ("visible coverage", f"{_format_percent(coverage.visible)}, predicted {_format_percent(coverage.predicted)}"),
        ("sampled coverage", _format_percent(coverage.sampled)),
        *([("dense coverage", _format_percent(coverage.dense))] if coverage.dense is not None else []),
    ]
    characteristics = _characteristics(execution.folder) if execution.has("features.json") else ()
    if deviation is not None:
        rows += [("deviation", f"{deviation.rms_mm:.3f} mm rms, 95 % within {deviation.quantile_95_mm:.3f} mm")]
        rows += [("", deviation.edge_note)] if deviation.edge_note else []
    notes = list(timeline.notes)
    if report.n_points > MAX_POINTS:
        notes.append(_thinning_note(MAX_POINTS, report.n_points, "points"))
    commands = ["cell replay RUN --execution EXECUTION", "cell scan RUN"]
    return PageContents(
        page_views, (timeline.t, timeline.q), rows=rows, characteristics=characteristics, notes=notes,
        next_commands=commands, folder_depth=2,
    )  # fmt: skip


def _characteristics(folder: Path) -> list[Mapping[str, object]]:
    """Return the characteristics of features.json for the panel, with the points of their features."""
    results, points = json.loads((folder / "features.json").read_bytes()), dict[str, list[list[float]]]()
    if (table := folder / "feature_points.csv").is_file():  # not of an older execution
        with table.open(newline="", encoding="utf-8") as file:
            for name, *values in list(csv.reader(file))[1:]:
                points.setdefault(name, []).append([float(value) for value in values])
    elements: dict[str, list[Mapping[str, Any]]] = {}
    for element in results["features"]:
        elements.setdefault(element["feature"], []).append(element)
    entries = list[Mapping[str, object]]()
    for each in results["characteristics"]:
        feature_elements, unit = elements[each["feature"]], each["unit"]
        rows = [("verdict", each["verdict"] + (f": {each['cause']}" if each["cause"] else ""))]
        if each["value"] is not None:
            rows.append(("value", f"{each['value']:.4f} ± {each['expanded_uncertainty']:.4f} {unit}"))
            rows.append(("deviation", f"{each['deviation']:+.4f} {unit} from {each['nominal']:.6g} {unit}"))
        limits = [f"{limit:.6g}" for limit in (each["lower"], each["upper"]) if limit is not None]
        rows.append(("limits", f"{' to '.join(limits)} {unit}" if limits else "none"))
        rows += [
            ("points", f"{e['n_points']:,} on {e['share']:.0%} of {e['kind']}, sd {e['sd_mm']:.4f} mm")
            for e in feature_elements
        ]
        means = points.get(each["feature"], [])
        if means:
            off = [row[3] for row in means]
            rows.append(("shown", f"{len(means)} means, {min(off):+.4f} (blue) to {max(off):+.4f} mm (red)"))
        place = feature_elements[0]["point_mm"]
        entries.append({
            "name": f"{each['name']} ({each['kind']})", "colour": VERDICTS[each["verdict"]], "rows": rows,
            "place": None if place is None else [value / 1000 for value in place], "points": means,
        })  # fmt: skip
    return entries


def _deviation_surface(mesh: TriangleMesh, reference: TriangleMesh, execution: Execution) -> PageSurface:
    """Return the measured surface with a layer of its signed distance to the part."""
    small = thin_mesh(mesh)
    values = 1000 * ClosestPointQuery(reference).signed_distance(small.vertices)
    note = "outside the part is positive"
    if small is mesh:
        values[np.setdiff1d(mesh.faces[execution.is_closed_hole], mesh.faces[~execution.is_closed_hole])] = np.nan
    else:
        note += f"; {_thinning_note(len(small.faces), len(mesh.faces), 'faces')}; faces of closed holes are not marked"
    deviation = execution.report.deviation
    limit = 1.0 if deviation is None else 1.5 * max(deviation.quantile_95_mm, 1e-3)  # as in deviation.png
    return PageSurface("surface", small, [quantised_layer(values, _DEVIATION, "signed", (-limit, limit), note)])


def _thinning_note(count: int, total: int, what: str) -> str:
    return f"drawn with {count:,} of {total:,} {what}"


def _format_percent(share: float) -> str:
    return f"{100 * share:.2f}\u00a0%"


def _format_mm(length: float | None) -> str:
    return "more than 300 mm" if length is None else f"{length:.1f} mm"
