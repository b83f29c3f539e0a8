"""`cell plan`, steps 1 to 9: part in, measured views in collision-free order and a timed motion out.

`_steps` shows the whole on one screen. Every noun is an immutable value; what a step has finished is on disk before the
next one starts.
"""

import logging
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from types import MappingProxyType

from cell import scanners
from cell.errors import FileError, UsageError
from cell.part import workpiece
from cell.part.workpiece import Workpiece
from cell.plan import curve as curves
from cell.plan import files as plan_files
from cell.plan import picture_process, pose_uncertainty, region_report, steps, wish_results
from cell.plan.appended_candidates import behind
from cell.plan.connected_plan import ConnectedPlan
from cell.plan.drawing import draw_motion, draw_views, finish_drawing
from cell.plan.problem import Problem
from cell.plan.steps import Job, PlanSession
from cell.plan.summary import Further, plan_report
from cell.runs.folder import SCHEMA, WITH_TABLE, RunFolder
from cell.runs.schema import Report
from cell.scene.model import Scene
from cell.scene.regions import with_regions
from cell.scene.settle import notes, require_attainable, resolve, settle_scene
from cell.session import PlotQueue, ProgressReporter, Session, Stream
from planner.geometry.mesh import TriangleMesh

log = logging.getLogger(__name__)


def plan(
    session: Session[None],
    scene: Scene,
    *,
    part: Workpiece | None = None,
    steps_of: Callable[[PlanSession, Job], int] | None = None,
    drawn: bool = True,
) -> Path:
    """Plan and write the run folder.

    Args:
        session: without a folder; this function makes it.
        scene: the checked scene, the command line's options in it.
        part: in place of the scene's.
        steps_of: what is done once part, scanner and folder are there, in place of steps 2 to 9.
        drawn: whether `steps_of` draws; else it has nobody to draw for it.

    Returns:
        The run folder.

    Raises:
        CellError: with one sentence and the exit code; the run folder keeps what was finished, its status and stage.
    """
    if scene.setup and steps_of is None:
        raise UsageError(
            f"the scene gives {len(scene.setup)} set-ups, and this plans one: give it to cell setups, or leave its "
            "[[setup]] tables out"
        )
    with picture_process.beside() if drawn else nullcontext(PlotQueue()) as plots:
        with session.stage("load the part"):
            part = workpiece.load(scene.part.source, scene.part.units) if part is None else part
            part = with_regions(part, scene)
        for sentence in (*(finding.sentence for finding in part.findings), *notes(scene, part)):
            session.note(sentence)
        scene = settle_scene(scene, part)
        settings = resolve(scene, part)
        inputs = plan_files.input_hashes(scene, part)
        schema = WITH_TABLE if scene.table.enabled else SCHEMA
        folder = RunFolder.create(
            session.out, list(session.origin.argv), scene.plan.seed, inputs, datetime.now(UTC), schema
        )
        opened = session.opened(folder, scene.plan.seed, plots)
        with folder.keep_on_failure(), _logged(folder.path / "run.log"):
            plan_files.write_scene(folder, session.origin.scene_path)
            folder.named(plan_files.named_files(scene, session.origin.scene_path))
            scanner = scanners.make(scene.scanner.type, settings.scanner)
            settings = replace(settings, scanner=scanners.with_own_parameters(settings.scanner, scanner))
            require_attainable(scene, scanner)
            if hasattr(scanner, "T_view_scanner"):
                scene.require_fixed_part("a scanner that sweeps")
            exit_code = (steps_of or _steps)(opened, Job(scene, part, settings, scanner))
            if (folder.path / "plan.json").is_file():  # of several set-ups each has its own folder and digest
                folder.seal()
        return folder.finish(exit_code)


def _steps(session: PlanSession, job: Job) -> int:
    """Steps 2 to 9 and the report; returns 0, or 3 where the plan stays below a coverage that was asked for."""
    surface, candidates = steps.sample_surface(session, job)
    cell = steps.compile_cell(session, job, surface)
    session.plots.cell_ready(session.folder.path)
    reached = steps.reach_candidates(session, job, cell, candidates)
    candidates, reached = steps.grow_candidates(session, job, surface, cell, candidates, reached)
    measured, prediction = steps.measure(session, job, surface, cell, candidates, reached)
    problem = steps.ask(session, job, cell, measured, prediction)
    problem, chosen = steps.connect(session, problem, surface, behind(session, job, cell, surface))
    return 3 if _below(session.reporter, finish(session, job, surface.planning, problem, chosen)) else 0


def finish(
    session: PlanSession,
    job: Job,
    planning: TriangleMesh,
    problem: Problem,
    chosen: ConnectedPlan,
    told: Mapping[str, object] = MappingProxyType({}),
) -> Report:
    """Prove and time the motion of a connected plan, draw it, and write what is known of it."""
    draw_views(session.plots, session.folder, job.part, problem, chosen, job.scene.picture)
    clearance, motion = steps.prove_and_time(session, problem, chosen)
    draw_motion(session.plots, session.folder, motion)
    further = _further(session, problem, chosen)
    with session.stage("report"):
        report = plan_report(job, planning, problem, chosen, clearance, motion, further)
        report = report.model_copy(update=dict(told))
        plan_file = plan_files.write_plan(session.folder, report, chosen, problem.candidates, problem.world)
        plan_files.write_report(session.folder, report)
        finish_drawing(session.plots, session.folder, report, plan_file, motion, problem.world.T_base_object)
    return report


def _further(session: PlanSession, problem: Problem, chosen: ConnectedPlan) -> Further:
    """What is worked out beyond the plan itself: what is lost, the promise simulated, the curve."""
    selected, wishes = chosen.selected, problem.request.plan
    if selected.note:
        session.note(selected.note)
    promised, fewest = None, None
    if robust := wish_results.robust_of(selected, chosen.cover.total_area):
        with session.stage("simulate executions") as progress:
            rng = session.rng(Stream.SIMULATED_EXECUTIONS)
            promised = pose_uncertainty.simulate(
                wishes, robust, chosen.T_object_poses, problem.prediction, rng, progress
            )
    if wishes.curve:
        with session.stage("coverage over views"):
            curve = curves.curve_of(
                problem.request, selected, chosen.matrix, problem.reached, session.rng(Stream.COVERAGE_CURVE),
                session.effort.curve_work,
            )  # fmt: skip
            curves.write(session.folder, session.plots, curve, len(chosen.cover.views), chosen.cover.covered_area)
        fewest = curves.fewest_of(curve)
    return Further(steps.what_is_lost(session, problem, chosen), promised, fewest)


def _below(reporter: ProgressReporter, report: Report) -> bool:
    """Whether the plan stays below a coverage that was asked for; says which, and what would help.

    A coverage of 1 asks for every coverable sample of the matrix, which a plan always covers; one that is asked several
    times, or with a probability, is of the matrix' samples as well.
    """
    coverage, settings = report.coverage, report.settings
    share, asked = coverage.visible_of_coverable, settings.coverage
    plain = report.most_coverage is None and report.multiplicity is None and report.promise is None
    missed = plain and report.regions is None and asked < 1 and share < asked
    if missed:
        why = (
            f"{len(report.dropped)} views that were chosen could not be connected; move the part, or ask for less"
            if report.dropped
            else "what is left is measured by views that the arm shades, or falls between all samples; see cell why"
        )
        reporter.note(
            f"the plan measures {100 * share:.2f} % of what can be measured, less than the {100 * asked:g} % asked "
            f"for: {why}"
        )
    if plain:
        for sentence in region_report.missed(report):
            reporter.note(sentence)
            missed = True
    if coverage.visible < settings.required_visible:
        reporter.note(
            f"the plan measures {100 * coverage.visible:.2f} % of the surface, less than the "
            f"{100 * settings.required_visible:g} % required; move the part, or allow more standoffs and rolls"
        )
        return True
    return missed


@contextmanager
def _logged(path: Path) -> Iterator[None]:
    """What is logged while the run goes on also stands in its folder."""
    root = logging.getLogger()
    try:
        handler = logging.FileHandler(path, encoding="utf-8")
    except OSError as error:
        raise FileError(f"{path} cannot be written: {error.strerror or error}; choose a writable --out") from error
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    level = root.level
    root.addHandler(handler)
    root.setLevel(logging.INFO)
    try:
        yield
    finally:
        root.setLevel(level)
        root.removeHandler(handler)
        handler.close()
