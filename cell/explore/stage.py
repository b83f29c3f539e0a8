"""One stage's plan: steps 2 to 9 of `cell plan` on what is believed of the part, for what is open of it.

The run folder that comes out is proven, driven and read back as any other. Its coverage is that of the believed
surface which the batch is asked for, the rows of its matrix (`cell.explore.asked`).
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from cell import scanners
from cell.errors import UnreachableError
from cell.explore import belief
from cell.explore.asked import Asked, came_of, wanted
from cell.explore.moved import with_better
from cell.explore.reasons import StillOpen, still_open
from cell.explore.too_near import BeyondNear
from cell.part.workpiece import Workpiece
from cell.plan import files as plan_files
from cell.plan import pipeline, steps
from cell.plan.appended_candidates import behind
from cell.plan.candidates import GROWN, arm_of, first, grow, limited
from cell.plan.connected_plan import ConnectedPlan
from cell.plan.problem import Problem
from cell.plan.refined import Append
from cell.plan.request import seconds_of_views
from cell.plan.steps import Cell, Job, Measured, PlanSession
from cell.plan.summary import Further, plan_report
from cell.plan.view_plan import choose_and_connect, first_choice
from cell.scene.model import Scene
from cell.session import Origin, Session, Stream
from cell.world.embree import EmbreeRayCaster
from cell.world.measurability import PartSurface
from cell.world.prediction import Prediction
from planner.explore.gain import select_by_gain_per_second
from planner.geometry.decimation import cluster_vertices, decimate
from planner.geometry.sampling import SurfaceSamples, draw_samples, pick_samples
from planner.kinematics.reach import Reach, join_reach
from planner.measurability.matrix import spread_measurability
from planner.path.path import MAX_CHECKS
from planner.ports import RayCaster, Scanner
from planner.tour.tour_search import DEFAULT_BUDGET
from planner.values import Ints
from planner.viewpoints import growth
from planner.viewpoints.viewpoints import Viewpoints, join_viewpoints, pick_viewpoints

DRAWN, ROWS_KEPT, SCOUTS_KEPT = 20_000, 3_000, 1_000
"""Samples of the believed surface that are drawn, of those rows of the matrix at most, and scouts at most."""

DRAWN_MEASURED = (60_000, 20_000)
"""Samples of the measured surface that are drawn for rows and for scouts: little of it is wanted."""

_COARSE, _EACH = 10_000, 4
"""Faces of the copy of the measured surface of which the planning mesh is made, and for each one that is wanted."""

SCHEDULE = growth.SCHEDULE[:2]
"""Of growth on the believed surface: what is open now is another tomorrow, so the long search for the last of it is not
worth its time. On the measured one it is luck whether one of few candidates takes a sliver; and reasons are told of all
that `cell plan` would have."""

_BRIEF = replace(DEFAULT_BUDGET, path_checks=MAX_CHECKS // 4, polish=0, guesses=DEFAULT_BUDGET.guesses[:1])
"""Of the motion through the few views of a batch: searching on for a shorter one takes longer than it saves."""

STARTS = 6
"""Candidates, each the best after those before it, from which one is searched that measures more."""


class EnoughError(UnreachableError):
    """No further batch is worth its views.

    Attributes:
        open: what stays open, and why; None where nobody looked.
    """

    def __init__(self, message: str, still_open: StillOpen | None = None) -> None:
        super().__init__(message)
        self.open = still_open


def plan_stage(session: Session[None], scene: Scene, believed: Workpiece, asked: Asked, out: Path) -> Path:
    """Plan a batch and write its run folder.

    Args:
        session: of the exploration.
        scene: of the stage.
        believed: the part.
        asked: what it is planned for.
        out: the folder to make.

    Raises:
        EnoughError: if no batch is asked for, the best is expected to add too little, or none can be measured.
        CellError: as `cell plan`.
    """
    own = {"max_views": asked.batch.views or None, "curve": False, "required_visible": 0.0, "solver": "auto"}
    plan = scene.plan.model_copy(update=own)

    def work(session: PlanSession, job: Job) -> int:
        return _steps(session, job, asked)

    inner = replace(session.closed(out), use_cache=False, origin=Origin())
    return pipeline.plan(inner, scene.model_copy(update={"plan": plan}), part=believed, steps_of=work, drawn=False)


def _steps(session: PlanSession, job: Job, asked: Asked) -> int:
    """Steps 2 to 9 and the report."""
    surface, scouts, candidates, asked = _sample_surface(session, job, asked)
    cell = steps.compile_cell(session, job, surface, believed=True)
    with session.stage("reach and grow") as progress:
        reached = steps.reach_of(job, cell, candidates, progress)
        casters = _casters(job, asked, surface, cell)
        scanner = limited(job.scene, job.scanner)
        arm = arm_of(cell.world, cell.kinematics, cell.checker, scanner, casters)
        if job.scene.plan.candidates == GROWN:
            schedule = SCHEDULE if asked.poses is None and asked.batch.views != 0 else growth.SCHEDULE
            grown = grow(candidates, reached.reachable, scouts, arm, schedule=schedule)
            reached = join_reach([reached, steps.reach_of(job, cell, grown)])
            candidates = join_viewpoints([candidates, grown])
        plan_files.write_viewpoints(session.folder, scanners.sweep_columns(job.scanner, candidates))
        plan_files.write_reach(session.folder, reached)
    if asked.batch.views == 0:
        raise EnoughError("no batch is asked for", _explained(asked, scouts, candidates, reached, scanner, casters))
    if not reached.reachable.any():
        raise EnoughError("the arm reaches no view of what is open")
    with session.stage("measurability") as progress:
        usable = np.flatnonzero(reached.reachable)
        M, scanner = steps.columns(session, job, surface, casters, pick_viewpoints(candidates, usable), progress)
        M = spread_measurability(M, usable, len(candidates))
        plan_files.write_measurability(session.folder, M)
        measured = Measured(candidates, reached, M, scanner, casters)
        poses = candidates.T_object_scanner[usable]
        prediction = Prediction.of(scouts, scanner, casters, poses, progress)
    problem = steps.ask(session, job, cell, measured, prediction)
    try:
        problem, chosen = _connected(session, problem, surface, asked, behind(session, job, cell, surface))
    except UnreachableError as error:
        raise EnoughError(str(error)) from error
    if told := _too_little(chosen, asked):
        raise EnoughError(told)
    _finish(session, job, surface, problem, chosen)
    return 0


def _casters(job: Job, asked: Asked, surface: PartSurface, cell: Cell) -> Sequence[RayCaster]:
    """The surface's and the occluders'; to who is asked to keep off, what may be the part's hides what is behind."""
    casters = steps.casters_of(surface, cell)
    if not asked.cautious:
        return casters
    assert job.scene.scanner.range_mm is not None
    return [casters[0], BeyondNear(casters[1], asked.space, job.scene.scanner.range_mm[0] / 1000)]


def _sample_surface(
    session: PlanSession, job: Job, asked: Asked
) -> tuple[PartSurface, SurfaceSamples, Viewpoints, Asked]:
    """Planning mesh and rows of the matrix, points that candidates are grown for, candidates that face the rows.

    And what is asked, with what came of the latest batches.

    Raises:
        EnoughError: if nothing is open.
    """
    with session.stage("decimate and sample"):
        reference = job.part.reference
        if asked.poses is None:
            planning = decimate(belief.rough(asked.space, whole=asked.batch.views == 0), job.settings.faces)
        else:
            coarse = cluster_vertices(reference, max(_COARSE, _EACH * job.settings.faces)) or reference
            planning = decimate(coarse, job.settings.faces)
        plan_files.write_meshes(session.folder, reference, planning)
        caster, scanner = EmbreeRayCaster(reference.vertices, reference.faces), limited(job.scene, job.scanner)
        counts = (DRAWN, DRAWN) if asked.poses is None else DRAWN_MEASURED
        drawn = [
            draw_samples(reference, planning, count, session.rng(stream))
            for count, stream in zip(counts, (Stream.BELIEF_SAMPLES, Stream.BELIEF_SCOUTS), strict=True)
        ]
        rows, scouts = (
            wanted(samples, asked, kept, scanner, caster)
            for samples, kept in zip(drawn, (ROWS_KEPT, SCOUTS_KEPT), strict=True)
        )
        if not len(rows) or not len(scouts):
            raise EnoughError("nothing is open")
        asked = replace(asked, came=came_of(drawn[0], asked, scanner, caster))
        candidates = first(job.scene, job.settings, job.part, planning)
        if (candidates.face >= 0).all():
            candidates = pick_viewpoints(candidates, np.isin(candidates.face, rows.planning_face))
        return PartSurface(reference, planning, rows, caster), scouts, candidates, asked


def _connected(
    session: PlanSession, problem: Problem, surface: PartSurface, asked: Asked, append: Append
) -> tuple[Problem, ConnectedPlan]:
    """Steps 6 to 8; views that cannot be connected are replaced by those that measure the most."""
    batch = asked.batch
    if not batch.per_second or batch.views is None:
        if asked.least_gain:  # the ring is planned for a cylinder: nothing is gained by looking at it better
            before, problem = problem, with_better(problem, _each_worth(problem, asked), append)
            steps.write_changed(session, before, problem)
            problem = _worth(problem, asked)
        return steps.connect(session, problem, surface)
    with session.stage("select, order and connect") as progress:
        rng, before = session.rng(Stream.SELECTION), problem
        problem = with_better(problem, _best(problem, max(batch.views, STARTS)), append)
        others = tuple(np.setdiff1d(np.arange(len(problem.candidates)), _best(problem, batch.views)).tolist())
        plan = problem.request.plan.model_copy(update={"banned": others})
        selected = first_choice(replace(problem, request=replace(problem.request, plan=plan)), rng)
        problem = replace(problem, request=replace(problem.request, motion=_BRIEF))
        chosen = choose_and_connect(
            problem, selected, selection_rng=rng, motion_rng=session.rng(Stream.MOTION), progress=progress
        )
        steps.write_changed(session, before, problem)
        return problem, chosen


def _best(problem: Problem, count: int) -> Ints:
    """So many candidates, each with the most per second after those before it."""
    seconds = seconds_of_views(problem.request.plan, problem.reached, problem.world.home, problem.limits)
    M = problem.M
    return select_by_gain_per_second(M.matrix(), M.samples.areas, seconds, problem.usable(()), count)


def _each_worth(problem: Problem, asked: Asked) -> Ints:
    """Views that greedily each add the least gain."""
    M, usable = problem.M, problem.usable(())
    most = len(usable) if asked.batch.views is None else asked.batch.views
    gains = asked.came * M.samples.areas
    return select_by_gain_per_second(M.matrix(), gains, np.ones(len(usable)), usable, most, asked.least_area)


def _worth(problem: Problem, asked: Asked) -> Problem:
    """The problem for no more views than greedily each add the least gain."""
    plan = problem.request.plan.model_copy(update={"max_views": max(len(_each_worth(problem, asked)), 1)})
    return replace(problem, request=replace(problem.request, plan=plan))


def _too_little(chosen: ConnectedPlan, asked: Asked) -> str:
    """Why a batch is not worth its views; "" where it is."""
    each = asked.came * chosen.cover.covered_area / len(chosen.cover.views)
    if asked.batch.whole or each >= asked.least_area:
        return ""
    times = "" if asked.batch.worth == 1 else f"{asked.batch.worth:g} x "
    return (
        f"a further view is expected to add {100 * each / asked.measured_area:.3f} % of what was measured, less than "
        f"{times}the {100 * asked.least_gain:g} % asked for"
    )


def _explained(
    asked: Asked, scouts: SurfaceSamples, candidates: Viewpoints, reached: Reach, scanner: Scanner,
    casters: Sequence[RayCaster],
) -> StillOpen:  # fmt: skip
    """What is open with the reasons why it stays open."""
    left = pick_samples(scouts, ~asked.space.is_measured(scouts.points, scouts.normals))
    of = asked.space.open_samples_at(left.points, left.normals)
    left = replace(left, areas=left.areas / asked.record.weights(of))
    return still_open(left, of, candidates, reached, scanner, casters)


def _finish(session: PlanSession, job: Job, surface: PartSurface, problem: Problem, chosen: ConnectedPlan) -> None:
    """Prove and time the motion, and write what is known of the plan."""
    clearance, motion = steps.prove_and_time(session, problem, chosen)
    with session.stage("report"):
        report = plan_report(job, surface.planning, problem, chosen, clearance, motion, Further())
        plan_files.write_plan(session.folder, report, chosen, problem.candidates, problem.world)
        plan_files.write_report(session.folder, report)
