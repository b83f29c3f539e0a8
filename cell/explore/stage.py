"""Plan of one batch: the stages of `cell.plan.pipeline` on the surface of a belief, for its uncovered part.

The run folder is verified, executed and read as any other. Its coverage refers to the part of the surface that the
batch is requested for, the rows of its matrix (`cell.explore.asked`).
"""

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cell.errors import UnreachableError
from cell.explore import belief
from cell.explore.asked import Asked, came_of, wanted
from cell.explore.moved import with_better
from cell.explore.reasons import StillOpen, still_open
from cell.explore.too_near import BeyondNear
from cell.part.workpiece import Workpiece
from cell.plan import files, pipeline
from cell.plan.candidates import (
    CandidateSet,
    Cell,
    PlanSession,
    generate_viewpoints,
    limited_scanner,
    make_surface,
    measure,
    reach_viewpoints,
    with_grown,
)
from cell.plan.evaluation import OptionalResults, plan_report
from cell.plan.improvement import Append
from cell.plan.motion import ConnectedPlan, connect_views
from cell.plan.selection import SelectionProblem, least_view_times, select_views
from cell.scene.model import Scene
from cell.scene.settle import SettledScene
from cell.session import Origin, Session, Stream
from cell.world.measurability import PartSurface
from planner.explore.gain import select_by_gain_per_second
from planner.geometry.decimation import cluster_vertices, decimate
from planner.geometry.sampling import SurfaceSamples, draw_samples, pick_samples
from planner.path.path import MAX_CHECKS
from planner.ports import RayCaster
from planner.tour.tour_search import DEFAULT_BUDGET
from planner.values import Ints
from planner.viewpoints import growth
from planner.viewpoints.viewpoints import Viewpoints, pick_viewpoints

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


@dataclass(frozen=True, slots=True)
class StopReason:
    """Reason for which no further batch is planned, in one sentence."""

    sentence: str


@dataclass(frozen=True, slots=True, eq=False)
class _Surface:
    """Sampled surface of a batch.

    Attributes:
        part: meshes and rows of the matrix.
        scouts: samples for which viewpoints are grown, and on which candidates are evaluated.
        viewpoints: that face the rows.
        asked: the request, with the realised gain of the latest batches.
    """

    part: PartSurface
    scouts: SurfaceSamples
    viewpoints: Viewpoints
    asked: Asked


def plan_stage(session: Session[None], scene: Scene, surface: Workpiece, asked: Asked, out: Path) -> Path | StopReason:
    """Plan a batch and write its run folder.

    Args:
        session: of the exploration.
        scene: of the batch.
        surface: of the belief, as a part.
        asked: request.
        out: folder to make; without a plan it is left unfinished.

    Raises:
        CellError: as `cell plan`.
    """
    with _open_run(session, scene, surface, asked, out) as run:
        stop = _plan(run.session, run.settled, asked)
        run.stopped = "" if stop is None else stop.sentence
    return run.path if stop is None else stop


def explain_uncovered(
    session: Session[None], scene: Scene, surface: Workpiece, asked: Asked, out: Path
) -> StillOpen | None:
    """Return the uncovered surface of a belief by cause, or None if there is none; `out` is left unfinished."""
    with _open_run(session, scene, surface, asked, out) as run:
        run.stopped = "explanation of the uncovered surface; no batch is planned"
        found = _sample_surface(run.session, run.settled, asked)
        if found is None:
            return None
        cell = pipeline.compile_cell(run.session, run.settled, found.part, is_belief=True)
        candidates, casters = _find_candidates(run.session, run.settled, found, cell)
        left = pick_samples(found.scouts, ~asked.space.is_measured(found.scouts.points, found.scouts.normals))
        of = asked.space.open_samples_at(left.points, left.normals)
        left = replace(left, areas=left.areas / asked.record.weights(of))
        scanner = limited_scanner(run.settled.scene, run.settled.scanner)
        return still_open(left, of, candidates.viewpoints, candidates.reached, scanner, casters)


def _open_run(
    session: Session[None], scene: Scene, surface: Workpiece, asked: Asked, out: Path
) -> AbstractContextManager[pipeline.OpenRun]:
    own = {"max_views": asked.batch.views or None, "curve": False, "required_visible": 0.0, "solver": "auto"}
    scene = scene.model_copy(update={"plan": scene.plan.model_copy(update=own)})
    inner = replace(session, out=out, use_cache=False, origin=Origin())
    return pipeline.open_run(inner, scene, surface, with_plots=False)


def _plan(session: PlanSession, settled: SettledScene, asked: Asked) -> StopReason | None:
    """Plan a batch into the open folder; return the reason if none is worth its views."""
    found = _sample_surface(session, settled, asked)
    if found is None:
        return StopReason("nothing is open")
    surface, asked = found.part, found.asked
    cell = pipeline.compile_cell(session, settled, surface, is_belief=True)
    candidates, casters = _find_candidates(session, settled, found, cell)
    if not candidates.reached.reachable.any():
        return StopReason("the arm reaches no view of what is open")
    with session.stage("measurability") as progress:
        measured = measure(session, settled, surface, candidates, casters, progress, samples=found.scouts)
        files.write_measurability(session.folder, measured.M)
    problem = pipeline.make_problem(session, settled, cell, measured)
    append = pipeline.appending(session, settled, cell, surface)
    try:
        problem, plan = _select_and_connect(session, problem, surface, asked, append)
    except UnreachableError as error:
        return StopReason(str(error))
    if sentence := _too_little(plan, asked):
        return StopReason(sentence)
    clearance, motion = pipeline.time_motion(session, problem, plan)
    with session.stage("report"):
        report = plan_report(settled, surface.planning, problem, plan, clearance, motion, OptionalResults())
        files.write_plan(session.folder, report, plan, problem.candidates, problem.world)
        files.write_report(session.folder, report)
    return None


def _find_candidates(
    session: PlanSession, settled: SettledScene, found: _Surface, cell: Cell
) -> tuple[CandidateSet, Sequence[RayCaster]]:
    """Reach and grow candidates; also return the ray casters.

    If views must keep the minimum range, space in which the part may be nearer occludes everything behind it.
    """
    asked, casters = found.asked, cell.casters(found.part)
    if asked.cautious:
        assert settled.scene.scanner.range_mm is not None
        near = settled.scene.scanner.range_mm[0] / 1000
        casters = (casters[0], BeyondNear(casters[1], asked.space, near))
    is_short = asked.poses is None and asked.batch.views != 0
    with session.stage("reach and grow") as progress:
        candidates = reach_viewpoints(settled, cell, found.viewpoints, progress)
        schedule = SCHEDULE if is_short else growth.SCHEDULE
        candidates = with_grown(settled, cell, candidates, found.scouts, casters, schedule=schedule)
        files.write_candidates(session.folder, settled, candidates)
    return candidates, casters


def _sample_surface(session: PlanSession, settled: SettledScene, asked: Asked) -> _Surface | None:
    """Make the planning mesh, and draw rows and scouts; None if nothing is uncovered."""
    with session.stage("decimate and sample"):
        reference, faces = settled.part.reference, settled.settings.faces
        if asked.poses is None:
            planning = decimate(belief.rough(asked.space, whole=asked.batch.views == 0), faces)
        else:
            planning = decimate(cluster_vertices(reference, max(_COARSE, _EACH * faces)) or reference, faces)
        files.write_meshes(session.folder, reference, planning)
        counts = (DRAWN, DRAWN) if asked.poses is None else DRAWN_MEASURED
        drawn = [
            draw_samples(reference, planning, count, session.rng(stream))
            for count, stream in zip(counts, (Stream.BELIEF_SAMPLES, Stream.BELIEF_SCOUTS), strict=True)
        ]
        part, scanner = make_surface(reference, planning, drawn[0]), limited_scanner(settled.scene, settled.scanner)
        rows, scouts = (
            wanted(samples, asked, kept, scanner, part.caster)
            for samples, kept in zip(drawn, (ROWS_KEPT, SCOUTS_KEPT), strict=True)
        )
        if not len(rows) or not len(scouts):
            return None
        asked = replace(asked, came=came_of(drawn[0], asked, scanner, part.caster))
        viewpoints = generate_viewpoints(settled.scene, settled.settings, settled.part, planning)
        if (viewpoints.face >= 0).all():
            viewpoints = pick_viewpoints(viewpoints, np.isin(viewpoints.face, rows.planning_face))
        return _Surface(replace(part, samples=rows), scouts, viewpoints, asked)


def _select_and_connect(
    session: PlanSession, problem: SelectionProblem, surface: PartSurface, asked: Asked, append: Append
) -> tuple[SelectionProblem, ConnectedPlan]:
    """Select a batch and plan its motion; views that cannot be connected are replaced by the best others."""
    batch = asked.batch
    if not batch.per_second or batch.views is None:
        if asked.min_gain:  # the ring is planned for a cylinder: a better view of it gains nothing
            before, problem = problem, with_better(problem, _views_worth_it(problem, asked), append)
            files.write_measured(session.folder, problem, before)
            limit = max(len(_views_worth_it(problem, asked)), 1)
            plan = problem.request.plan.model_copy(update={"max_views": limit})
            problem = replace(problem, request=replace(problem.request, plan=plan))
        return pipeline.select_and_connect(session, problem, surface)
    with session.stage("select, order and connect") as progress:
        rng, before = session.rng(Stream.SELECTION), problem
        problem = with_better(problem, _most_per_second(problem, max(batch.views, STARTS)), append)
        best = _most_per_second(problem, batch.views)
        others = tuple(np.setdiff1d(np.arange(len(problem.candidates)), best).tolist())
        options = problem.request.plan.model_copy(update={"banned": others})
        selection = select_views(replace(problem, request=replace(problem.request, plan=options)), rng)
        problem = replace(problem, request=replace(problem.request, motion=_BRIEF))
        connected = connect_views(
            problem, selection, selection_rng=rng, motion_rng=session.rng(Stream.MOTION), progress=progress
        )
        files.write_measured(session.folder, problem, before)
        return problem, connected


def _most_per_second(problem: SelectionProblem, count: int) -> Ints:
    """Return candidates, each with the largest marginal gain per second after those before it."""
    seconds = least_view_times(problem.request.plan, problem.reached, problem.world.home, problem.limits)
    M = problem.M
    return select_by_gain_per_second(M.matrix(), M.samples.areas, seconds, problem.usable(), count)


def _views_worth_it(problem: SelectionProblem, asked: Asked) -> Ints:
    """Return views that greedily each add the least gain."""
    M, usable = problem.M, problem.usable()
    limit = len(usable) if asked.batch.views is None else asked.batch.views
    gains = asked.came * M.samples.areas
    return select_by_gain_per_second(M.matrix(), gains, np.ones(len(usable)), usable, limit, asked.least_area)


def _too_little(plan: ConnectedPlan, asked: Asked) -> str:
    """Return the reason for which a batch is not worth its views; "" if it is."""
    each = asked.came * plan.cover.covered_area / len(plan.cover.views)
    if asked.batch.whole or each >= asked.least_area:
        return ""
    times = "" if asked.batch.worth == 1 else f"{asked.batch.worth:g} x "
    return (
        f"a further view is expected to add {100 * each / asked.measured_area:.3f} % of what was measured, less than "
        f"{times}the {100 * asked.min_gain:g} % asked for"
    )
