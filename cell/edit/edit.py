"""`cell edit`: a plan whose views are changed by hand, as a new run made by the plan's own steps.

The cell is read back from the run's files, and so are candidates, reach and matrix, bit for bit; poses that were no
candidates become further rows of all three, made by the functions that made the others. From there on everything is
asked again: own arm, motion, clearance, timing, coverage.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from cell import scanners
from cell.edit.moved import Before, measured_anew, still_reached
from cell.edit.options import Edit, Pose
from cell.edit.views import EditedViews, check, edited_views, require_repairable
from cell.errors import UnreachableError, UsageError
from cell.plan import files as plan_files
from cell.plan import pipeline, region_report, steps
from cell.plan.appended_candidates import appended
from cell.plan.candidates import limited
from cell.plan.connected_plan import ConnectedPlan
from cell.plan.of_run import part_of, surface_of
from cell.plan.problem import PinnedOutError, Problem
from cell.plan.steps import Cell, Job, Measured, PlanSession
from cell.runs.cell import scene_of_run, with_placement
from cell.runs.run import Run
from cell.runs.schema import Report
from cell.scene.model import PlanSettings, Scene, pose
from cell.session import ProgressReporter, Session
from cell.world.measurability import PartSurface
from cell.world.prediction import Prediction
from planner.cover import CoverStatus
from planner.kinematics.reach import Reach, Verdict, join_reach
from planner.ports import ARM_AXES
from planner.values import Floats

_ROUNDING = 1e-9  # of shares that were summed in another order


def edit(session: Session[None], run: Run, wanted: Edit, *, T_base_object: Floats | None = None) -> Path:
    """Make a new run of an edited plan.

    Args:
        session: without a folder; this function makes it.
        run: a finished plan; nothing in its folder changes.
        wanted: what changes.
        T_base_object: (4, 4) where the part stands now, its views with it [m]; None: where it stood. With `repair`,
            views that the arm cannot take there are left out.

    Returns:
        The new run folder.

    Raises:
        UsageError: if the edit names what is not there, or cannot be.
        UnreachableError: if the arm cannot take an edited view or cannot get there, with the condition and what is in
            the way.
        FileError: if the run is damaged, or the new folder cannot be written.
    """
    if wanted.repair:
        require_repairable(run)
    check(wanted, len(run.candidate), run.report.verdicts.total)
    resolved, moved = run.scene, T_base_object is not None
    if wanted.table_angle_deg and resolved.table is None:
        raise UsageError(f"{run.folder} has no rotary table; leave table_angle out")
    before = Before(run, run.candidates, run.reach, moved)
    scene = scene_of_run(run)
    if T_base_object is not None:
        scene = with_placement(scene, T_base_object, resolved)
    session = replace(session, origin=replace(session.origin, scene_path=run.folder / "scene.toml"))
    return pipeline.plan(session, scene, part=part_of(run), steps_of=partial(_steps, before, wanted))


def _steps(before: Before, wanted: Edit, session: PlanSession, job: Job) -> int:
    """The steps of an edit; returns 0, or 3 where the plan stays below a coverage that was asked for."""
    surface = surface_of(before.run, session, job)
    session.plots.part_ready(session.folder.path)
    cell = steps.compile_cell(session, job, surface)
    session.plots.cell_ready(session.folder.path)
    edited = _views(before, wanted, job, cell, surface)
    if before.moved:
        measured = measured_anew(before, session, job, surface, cell)
        edited = still_reached(before, edited, measured.reached, session.reporter, leave_out=wanted.repair)
    else:
        measured = _measured(before, edited, session, job, surface, cell)
    job = replace(job, scene=_without_dropped(job, edited))
    with session.stage("held-out samples") as progress:
        prediction = steps.predicted(session, surface, measured, progress)
    while True:
        problem = _problem(before, wanted, edited, session, job, cell, measured, prediction)
        try:
            problem, chosen = steps.connect(session, problem, surface)
            break
        except PinnedOutError as error:
            edited = _without(error, edited, session, leave_out=before.moved and wanted.repair)
    holds, chosen = _bounded(before, edited, problem, chosen)
    told: dict[str, object] = {"part": before.run.report.part, "of_several": before.run.is_setup_of_group or None}
    if not holds:
        told["status"] = "edited by hand; how few views would do is not known"
    for view in edited.views:
        if not (chosen.matrix.indices == view).any():
            session.note(f"{edited.called[view]} measures none of the samples")
    added = [f"{view}" for view in chosen.candidate.tolist() if view not in edited.views]
    if wanted.repair:
        session.note(f"repaired by adding candidate {', '.join(added)}" if added else "there is nothing to repair")
    report = pipeline.finish(session, job, surface.planning, problem, chosen, told)
    if before.run.is_setup_of_group:
        session.note("coverage was asked of several set-ups: what they measure together now is not known")
        return 0
    return 3 if _below(session.reporter, report, job.scene.plan) else 0


def _views(before: Before, wanted: Edit, job: Job, cell: Cell, surface: PartSurface) -> EditedViews:
    """The views that are asked for; of a sensor that sweeps they are named by the middle poses of their sweeps."""
    views, T_scanner_view = scanners.viewpoints_of_columns(job.scanner, before.candidates)
    meant = np.append(cell.world.home[:ARM_AXES], np.radians(wanted.table_angle_deg))
    T_object_base = np.linalg.inv(cell.world.T_base_part(meant))

    def T_object_view(given: Pose) -> Floats:
        T: Floats = T_object_base @ pose(given[:3], given[3:]) @ T_scanner_view
        return T

    def standoff(T: Floats) -> float:
        hit = surface.caster.first_hit(T[None, :3, 3], T[None, :3, 2]).distance[0]
        return float(hit) if np.isfinite(hit) else float(np.linalg.norm(T[:3, 3] - job.part.centre))

    return edited_views(wanted, before.run.candidate.tolist(), views, T_object_view, standoff)


def _measured(
    before: Before, edited: EditedViews, session: PlanSession, job: Job, surface: PartSurface, cell: Cell
) -> Measured:
    """Candidates, reach and matrix of the run, and further rows for the poses that were no candidates.

    Raises:
        UnreachableError: if the arm cannot take a view.
    """
    candidates, reached, M = before.candidates, before.reached, before.run.measurability
    casters, scanner = steps.casters_of(surface, cell), limited(job.scene, job.scanner)
    if len(edited.appended):
        with session.stage("reach of new poses") as progress:
            reached = join_reach([reached, steps.reach_of(job, cell, edited.appended, progress)])
    _require_reached(edited, reached)
    if len(edited.appended):
        with session.stage("measurability of new poses") as progress:
            candidates, M, scanner = appended(
                session, job, surface, casters, (candidates, M), edited.appended, progress
            )
    plan_files.write_viewpoints(session.folder, candidates)
    plan_files.write_reach(session.folder, reached)
    plan_files.write_measurability(session.folder, M)
    return Measured(candidates, reached, M, scanner, casters)


def _require_reached(edited: EditedViews, reached: Reach) -> None:
    for view in edited.views:
        if not reached.reachable[view]:
            verdict, blocker = Verdict(int(reached.verdict[view])), reached.blocker[view]
            of_run = edited.called[view].startswith("view")
            raise UnreachableError(
                f"{edited.called[view]} cannot be taken: "
                + ("" if verdict is Verdict.COLLISION else "it is ")
                + verdict.sentence
                + (f" ({blocker})" if blocker else "")
                + ("; move it elsewhere, or drop it" if of_run else "; give another, or leave it out")
            )


def _without_dropped(job: Job, edited: EditedViews) -> Scene:
    """The scene; a pinned view that is dropped is pinned no more."""
    plan = job.scene.plan
    pinned = tuple(candidate for candidate in plan.pinned if candidate not in edited.dropped)
    return job.scene.model_copy(update={"plan": plan.model_copy(update={"pinned": pinned})})


def _asked(wanted: Edit, edited: EditedViews, job: Job, measured: Measured) -> PlanSettings:
    """What selection is asked: these views and, to repair, the fewest beside them; otherwise no other."""
    plan = job.scene.plan
    if wanted.repair:
        pinned = dict.fromkeys((*edited.views, *plan.pinned))
        return plan.model_copy(update={"pinned": tuple(pinned), "banned": (*plan.banned, *edited.dropped)})
    return plan.of_views(edited.views, len(measured.reached))


def _problem(
    before: Before, wanted: Edit, edited: EditedViews, session: PlanSession, job: Job, cell: Cell, measured: Measured,
    prediction: Prediction,
) -> Problem:  # fmt: skip
    """What is asked of selection and motion; where views and placement are what they were, so is the order."""
    asked = replace(job, scene=job.scene.model_copy(update={"plan": _asked(wanted, edited, job, measured)}))
    problem = steps.ask(session, asked, cell, measured, prediction)
    same = edited.views == tuple(before.run.candidate.tolist()) and edited.order in (None, edited.views)
    same &= not before.moved
    order = edited.views if same else edited.order
    return replace(problem, request=replace(problem.request, order=order))


def _without(error: PinnedOutError, edited: EditedViews, session: PlanSession, *, leave_out: bool) -> EditedViews:
    """The views without one that no motion leads through.

    Raises:
        UnreachableError: if it may not be left out, with the reason.
    """
    called = edited.called.get(error.candidate, f"pinned candidate {error.candidate}")
    if not leave_out or error.candidate not in edited.views:
        raise UnreachableError(
            f"{called} cannot be part of a motion: {error.reason}; move it elsewhere, or drop it"
        ) from error
    session.note(f"{called} is left out: it cannot be part of a motion ({error.reason})")
    return edited.without([error.candidate])


def _bounded(
    before: Before, edited: EditedViews, problem: Problem, chosen: ConnectedPlan
) -> tuple[bool, ConnectedPlan]:
    """Whether the run's bound on the number of views still holds, and the plan with that bound, or with none (1).

    It holds where there is one (of more than 1) and the same candidates were asked for as much: none is new, none that
    was pinned is left out, and what the run was asked to cover is covered.
    """
    cover, M, said = chosen.cover, chosen.matrix, before.run.plan
    coverable = float(M.samples.areas[M.matrix() @ problem.reached.reachable.astype(np.int32) > 0].sum())
    target = said.coverage.target_on_features or 1.0
    holds = not len(edited.appended) and cover.covered_area >= (target - _ROUNDING) * coverable
    holds &= not set(edited.dropped) & set(before.run.scene.plan.pinned)
    holds &= said.lower_bound > 1 or len(cover.views) == 1
    holds &= said.most_coverage is None and problem.request.goals is None and not before.moved
    bound = min(said.lower_bound, len(cover.views)) if holds else 1
    proven = bound == len(cover.views)
    status = CoverStatus.PROVEN if proven else CoverStatus.BOUNDED
    cover = replace(cover, lower_bound=bound, status=status, solver="edited", coverable_area=coverable)
    return holds, replace(chosen, cover=cover, selected=replace(chosen.selected, targets=np.array([target])))


def _below(reporter: ProgressReporter, report: Report, asked: PlanSettings) -> bool:
    """Whether the plan stays below a coverage that was asked for; says which, and what would help.

    Args:
        reporter: is told.
        report: of the plan.
        asked: wishes of the first of the runs that this one came from.
    """
    coverage, settings = report.coverage, report.settings
    share, visible = coverage.visible_of_coverable, coverage.visible
    plain = asked.max_views is None and asked.multiplicity == 1 and asked.pose_sd_mm == asked.pose_sd_deg == 0
    told = region_report.missed(report) if plain else []
    if plain and report.regions is None and settings.coverage < 1 and share < settings.coverage:
        told.append(
            f"the plan measures {100 * share:.2f} % of what can be measured, less than the "
            f"{100 * settings.coverage:g} % asked for; repair adds the fewest views that restore it"
        )
    if visible < settings.required_visible:
        told.append(
            f"the plan measures {100 * visible:.2f} % of the surface, less than the "
            f"{100 * settings.required_visible:g} % required; repair adds the fewest views that restore it"
        )
    for sentence in told:
        reporter.note(sentence)
    return bool(told)
