"""What the page of a run, of an execution and of `cell why` holds, read from their folders. Metres, radians.

A plan's page is made of the same pieces while the plan is made (`cell.plan.drawing`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from cell.runs import timeline as timelines
from cell.runs.cell import RunCell, read_cell
from cell.runs.run import Execution, RecordedExecution, Run
from cell.runs.schema import PlanView, Report
from cell.scene.model import RegionTargets
from cell.view.packed import POINTS, Layer, stepped
from cell.view.page import Play, Shown, Stage, View, html_of, thinned
from cell.view.palette import MEASURED, REASONS
from cell.view.pictures import group_names, group_numbers
from cell.view.pieces import Cell, beside, cell_of_run
from cell.view.surface import Canvas, Surface, canvas_of, sides, surface_of
from cell.world.prediction import held_out_samples
from planner.geometry.closest import ClosestPointQuery
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples
from planner.kinematics.frames import kuka_abc_from_pose
from planner.ports import ARM_AXES
from planner.timing.motion import Motion
from planner.values import Floats, Ints

NAME = "view.html"
"""The page's file beside a report.md."""

HALF_PAGE = "view.html.half"
"""The page of an unfinished plan, without what is known at the end."""

_OF_VIEWS = {
    "sigma": ("Expected standard deviation", "of a point along its ray, of the view in which it is smallest"),
    "spacing": ("Spacing of points", "the larger distance between neighbours, of the view in which it is smallest"),
}


def run_page(run: Run) -> str:
    """The page of a plan; a run that did not finish is shown as far as it got: the cell, the arm at home."""
    scene, title = run.scene, "View plan of {}"
    cell = cell_of_run(run, scene)
    if not run.is_finished:
        part = Shown("part", thinned(run.mesh("reference.ply")))
        stage = Stage(title.format(scene.part.name), cell, [part])
        return html_of(stage, Play(problems=[f"this run {run.ending}"], inside=0))
    plan = run.plan
    canvas, surface = measured(run, read_cell(run), [view.T_object_poses for view in plan.views])
    cell = beside(cell, canvas.mesh, canvas.aside)
    stage = Stage(f"View plan of {scene.part.name}", cell, [part_of(canvas, surface, regions=scene.regions)])
    return html_of(stage, plan_play(run.report, plan.views, run.motion, scene.T_base_object))


def why_page(run: Run, canvas: Canvas, surface: Surface, groups: Sequence[tuple[Ints, str]]) -> str:
    """The page of `cell why`: the plan's, the part coloured by the reasons why it stays open.

    Args:
        run: the plan's folder.
        canvas: the part.
        surface: what the plan measures of it.
        groups: rows of the surface's samples that stay open for a reason, and its name; largest first.
    """
    scene, plan = run.scene, run.plan
    number = group_numbers(len(surface.samples), [rows for rows, _ in groups])
    named = [("measured", MEASURED), *zip(group_names([name for _, name in groups]), REASONS, strict=False)]
    why = named_layer("Why it stays open", number, named, canvas)
    part, cell = part_of(canvas, surface, [why], scene.regions), cell_of_run(run, scene)
    toward = sides(canvas, number > 0, 1)[0]
    stage = Stage(f"Why {scene.part.name} stays open", beside(cell, canvas.mesh, canvas.aside), [part], toward)
    return html_of(stage, plan_play(run.report, plan.views, run.motion, scene.T_base_object, inside=1))


def named_layer(title: str, which: Ints, named: Iterable[tuple[str, str]], canvas: Canvas) -> Layer:
    """A colouring by names, each with its share of the surface.

    Args:
        title: in the list of colourings.
        which: (S,) name of each sample.
        named: names with their colours.
        canvas: of the samples.
    """
    share = np.bincount(which, canvas.samples.areas) / canvas.samples.areas.sum()
    told = [(f"{name} ({_percent(part)})", colour) for (name, colour), part in zip(named, share, strict=False)]
    return Layer(title, "named", which.astype(np.uint8)[canvas.at_vertices()], canvas.note, named=told)


def execution_page(
    run: Run, recorded: RecordedExecution, done: Execution, known: tuple[Canvas, Surface] | None = None
) -> str:
    """The page of an execution: what it measured, by how much that deviates, its points, the arm as it was reported.

    Args:
        run: the run that was executed.
        recorded: the scans.
        done: the report on them.
        known: the part, and what the scans measure of it, in their order; None measures it.
    """
    scene = run.scene
    cell = cell_of_run(run, scene)
    if known is None:
        poses = [scan.poses for scan in recorded.scans]
        grid = done.report.settings.resolution_deg
        known = measured(run, read_cell(run, grid[0] if grid else None), poses)
    shown = [part_of(*known, regions=scene.regions)]
    if done.mesh is not None:
        shown.append(_deviating(done.mesh, run.mesh("reference.ply"), done))
    points = done.points if recorded.scans else None
    play = replace(execution_play(run, recorded, done, cell), cloud=points)
    cell = beside(cell, known[0].mesh, known[0].aside)
    return html_of(Stage(f"Scan of {scene.part.name}, points: {done.report.source}", cell, shown), play)


def measured(run: Run, cell: RunCell, poses: Sequence[Floats]) -> tuple[Canvas, Surface]:
    """The part, and what some views measure of its held-out samples.

    Args:
        run: the plan.
        cell: its part and surroundings.
        poses: (K, 4, 4) of each view [m], object frame.
    """
    samples = held_out_samples(cell.reference, cell.planning, run.seed)
    return canvas_of(cell.reference, samples), of_views(cell, samples, poses)


def of_views(cell: RunCell, samples: SurfaceSamples, poses: Sequence[Floats]) -> Surface:
    """What some views measure of samples; arguments as in `measured`."""
    stacked = np.stack(poses) if len(poses) else np.zeros((0, 1, 4, 4))
    return surface_of(samples, stacked, cell.scanner, (cell.part_caster, cell.occluder_caster))


def part_of(
    canvas: Canvas, surface: Surface, first: Sequence[Layer] = (), regions: Sequence[RegionTargets] | None = None
) -> Shown:
    """The part with its colourings.

    Args:
        canvas: the part.
        surface: what views measure of it.
        first: colourings that come before the others.
        regions: of the part, by their numbers; None: it has none.
    """
    own = canvas.at_vertices()
    layers = list(first)
    bits = np.packbits(surface.seen[own], axis=1, bitorder="little")
    layers.append(Layer("Number of views", "views", bits.reshape(len(own), -1), canvas.note))
    for name, (title, note) in _OF_VIEWS.items():
        if (values := surface.layers.get(name)) is None:
            continue
        known = values[np.isfinite(values)]
        limits = (0.0, round(float(np.quantile(known, 0.98)), 6) if len(known) else 1.0)
        layers.append(stepped(values[own], title, "length", limits, note))
    if regions and (which := canvas.samples.region) is not None:
        named = [(region.name, REASONS[1:][k % (len(REASONS) - 1)]) for k, region in enumerate(regions)]
        layers.append(named_layer("Regions", which.astype(np.int64), named, canvas))
    return Shown("part", canvas.counted, layers)


def plan_play(
    report: Report, views: Sequence[PlanView], motion: Motion, T_base_object: Floats, inside: int = 0
) -> Play:
    """Views, motion and numbers of a plan.

    Args:
        report: report.json.
        views: in visiting order.
        motion: the plan's.
        T_base_object: (4, 4) placement, where a rotary table at 0 has the part [m].
        inside: as in `Play`.
    """
    timeline = timelines.plan_timeline(motion, rest=0.0)
    at = {stop.candidate: stop.begin for stop in timeline.stops}
    said = [
        View(str(number), _beside_part(view, T_base_object), at.get(view.id), [
            ("view", f"{number}, candidate {view.id}"),
            ("adds", f"{_percent(own.adds)} of the surface"),
            ("A1 to A6", f"{', '.join(f'{angle:g}' for angle in view.q_deg)} deg"),
            *(("E1", f"{angle:g} deg") for angle in view.e_deg or ()),
            ("roll", f"{view.roll_deg:g} deg"),
            ("clearance", _mm(own.clearance_on_the_way_mm) + " on the way"),
        ], _commands(number, view.T_base_scanner, alone=report.is_single_setup))
        for number, (view, own) in enumerate(zip(views, report.views, strict=True), start=1)
    ]  # fmt: skip
    coverage, moves = report.coverage, report.motion
    rows = [
        ("views", f"{report.n_views} ({report.status})"),
        ("lower bound", f"{report.lower_bound} for these candidates and samples"),
        ("visible coverage", f"{_percent(coverage.visible)} of the surface"),
        ("coverable", f"{_percent(coverage.coverable)} by reachable candidates"),
        *((f"region {each.name}", f"{_percent(each.visible)} measured") for each in report.regions or ()),
        ("motion", f"{moves.duration_s:.1f} s from home to home"),
        ("nearest", f"{_mm(moves.minimum_clearance_mm)} ({moves.between})" if moves.between else "nothing near"),
        ("candidates", f"{report.verdicts.reachable:,} of {report.verdicts.total:,} reachable"),
    ]
    turned = any(view.e_deg for view in views)  # which `cell why` does not know yet
    then = ["cell scan RUN", *([] if turned else ["cell why RUN"]), "cell export RUN"]
    return Play(said, (timeline.t, timeline.q), rows=rows, next=then, inside=inside)


def _beside_part(view: PlanView, T_base_object: Floats) -> Floats:
    """(4, 4) pose of a view [m], base frame with a rotary table turned back to 0."""
    return view.T_base_scanner if view.T_base_object is None else T_base_object @ view.T_object_scanner


def _commands(number: int, T_base_scanner: Floats, *, alone: bool) -> list[str]:
    """What can be done with a view of a plan, to be pasted; the pose is the one that it has."""
    position, abc = kuka_abc_from_pose(T_base_scanner)
    pose = ",".join(f"{value:.3f}".rstrip("0").rstrip(".") for value in (*1000 * position, *np.degrees(abc)))
    drop = f"--drop {number}" + (" --repair" if alone else "")
    edits = drop, f"--turn {number}:90", f"--move {number}:{pose}"
    return [f"cell replay RUN --view {number}", *(f"cell edit RUN {edit}" for edit in edits)]


def execution_play(run: Run, recorded: RecordedExecution, done: Execution, cell: Cell) -> Play:
    """Scans, motion and numbers of an execution."""
    planned = run.motion if run.has("motion.npz") else None
    timeline = timelines.execution_timeline(recorded, planned, cell.arm.home, rest=0.0)
    report, deviation = done.report, done.report.deviation
    of_stop = {view.stop: view for view in report.views}
    said = []
    for stop, scan in zip(timeline.stops, recorded.scans, strict=True):
        pose = cell.arm.links(scan.q_reported)[6] @ cell.arm.T_link_scanner
        pose, own = np.linalg.inv(cell.turn(scan.q_reported)) @ pose, of_stop.get(stop.number)
        told = [("view", f"{stop.number}, candidate {stop.candidate}")]
        if own is not None:
            told += [("adds", f"{_percent(own.adds)} of the surface"), ("points", f"{own.points:,}")]
        angles = [f"{angle:.4f}" for angle in np.degrees(scan.q_reported)]
        told.append(("A1 to A6", f"{', '.join(angles[:ARM_AXES])} deg"))
        told += [("E1", f"{angle} deg") for angle in angles[ARM_AXES:]]
        replayed = f"cell replay RUN --execution EXECUTION --view {stop.number}"
        said.append(View(str(stop.number), pose, stop.begin, told, [replayed]))
    rows = [
        ("views", f"{report.n_views} of {report.n_views_planned}"),
        ("points", f"{report.n_points:,}"),
        ("visible coverage", f"{_percent(report.coverage.visible)}, predicted {_percent(report.coverage.predicted)}"),
        ("sampled coverage", _percent(report.coverage.sampled)),
        *([("dense coverage", _percent(dense))] if (dense := report.coverage.dense) is not None else []),
    ]
    if deviation is not None:
        rows += [("deviation", f"{deviation.rms_mm:.3f} mm rms, 95 % within {deviation.quantile_95_mm:.3f} mm")]
    notes = list(timeline.notes)
    if report.n_points > POINTS:
        notes.append(_thinned(POINTS, report.n_points, "points"))
    then = ["cell replay RUN --execution EXECUTION", "cell scan RUN"]
    return Play(said, (timeline.t, timeline.q), rows=rows, notes=notes, next=then, inside=2)


def _deviating(mesh: TriangleMesh, reference: TriangleMesh, done: Execution) -> Shown:
    """The measured surface by its distance from the part."""
    small = thinned(mesh)
    values = 1000 * ClosestPointQuery(reference).signed_distance(small.vertices)
    note = "outside the part is positive"
    if small is mesh:
        values[np.setdiff1d(mesh.faces[done.is_closed_hole], mesh.faces[~done.is_closed_hole])] = np.nan
    else:
        note += f"; {_thinned(len(small.faces), len(mesh.faces), 'faces')}, those that close holes not marked"
    told = done.report.deviation
    limit = 1.0 if told is None else 1.5 * max(told.quantile_95_mm, 1e-3)  # as in deviation.png
    return Shown("surface", small, [stepped(values, "Deviation", "signed", (-limit, limit), note)])


def _thinned(shown: int, of: int, what: str) -> str:
    return f"drawn with {shown:,} of {of:,} {what}"


def _percent(share: float) -> str:
    return f"{100 * share:.2f}\u00a0%"


def _mm(length: float | None) -> str:
    return "more than 300 mm" if length is None else f"{length:.1f} mm"
