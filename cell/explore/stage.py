"""Plan of one batch: the stages of `cell.plan.pipeline` on the surface of a belief, for its uncovered part.

The run folder is verified, executed and read as any other. Its coverage refers to the part of the surface that the
batch is requested for, the rows of its matrix (`cell.explore.policy`).
"""

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cell.errors import UnreachableError
from cell.explore import belief
from cell.explore.belief import UncoveredReport, assign_causes
from cell.explore.frustum import MinRangeOccluder
from cell.explore.policy import BatchRequest, realised_gain_ratio, select_samples
from cell.explore.refinement import with_refined_candidates
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
from cell.plan.motion import ConnectedPlan, connect_views
from cell.plan.pose_search import Append
from cell.plan.selection import SelectionProblem, least_view_times, select_views
from cell.scene.model import Scene
from cell.scene.settle import SettledScene
from cell.session import Origin, Session, Stream
from cell.world.measurability import PartSurface
from planner.explore.gain import select_by_gain_per_second
from planner.geometry.decimation import cluster_vertices, decimate
from planner.geometry.sampling import SurfaceSamples, draw_samples
from planner.path.path import MAX_CHECKS
from planner.ports import RayCaster
from planner.tour.tour_search import DEFAULT_BUDGET
from planner.values import Ints
from planner.viewpoints import growth
from planner.viewpoints.viewpoints import Viewpoints

N_DRAWN, MAX_ROWS, MAX_SCOUTS = 20_000, 3_000, 1_000
"""Drawn samples of the belief surface, largest number of rows of the matrix, and of scouts."""

N_DRAWN_MEASURED = (60_000, 20_000)
"""Drawn samples of the measured surface for rows and for scouts; few of them count."""

_MIN_COARSE_FACES, _FACES_PER_FACE = 10_000, 4
"""Faces of the decimated measured surface for the planning mesh: smallest number, and number per planning face."""

BELIEF_SCHEDULE = growth.SCHEDULE[:2]
"""Schedule of growth on the belief surface, which changes with every batch, so a long search is not worth its time.
On the measured surface, and for causes, candidates are grown as in `cell plan`."""

_SHORT_BUDGET = replace(DEFAULT_BUDGET, path_checks=MAX_CHECKS // 4, polish=0, guesses=DEFAULT_BUDGET.guesses[:1])
"""Budget of the motion of a batch: a longer search takes more time than it saves."""

N_STARTS = 6
"""Number of candidates from which refinement starts."""


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
        request: the request, with the realised gain of the latest batches.
    """

    part: PartSurface
    scouts: SurfaceSamples
    viewpoints: Viewpoints
    request: BatchRequest


def plan_stage(
    session: Session[None], scene: Scene, surface: Workpiece, request: BatchRequest, out: Path
) -> Path | StopReason:
    """Plan a batch and write its run folder.

    Args:
        session: of the exploration.
        scene: of the batch.
        surface: of the belief, as a part.
        request: request.
        out: folder to make; without a plan it is left unfinished.

    Raises:
        CellError: as `cell plan`.
    """
    with _open_run(session, scene, surface, request, out) as run:
        stop = _plan(run.session, run.settled, request)
        run.stopped = "" if stop is None else stop.sentence
    return run.path if stop is None else stop


def explain_uncovered(
    session: Session[None], scene: Scene, surface: Workpiece, request: BatchRequest, out: Path
) -> UncoveredReport | None:
    """Return the uncovered surface of a belief by cause, or None if there is none; `out` is left unfinished."""
    with _open_run(session, scene, surface, request, out) as run:
        run.stopped = "explanation of the uncovered surface; no batch is planned"
        basis = _sample_surface(run.session, run.settled, request)
        if basis is None:
            return None
        cell = pipeline.compile_cell(run.session, run.settled, basis.part, is_belief=True)
        candidates, casters = _find_candidates(run.session, run.settled, basis, cell)
        left = basis.scouts.pick(~request.space.is_measured(basis.scouts.points, basis.scouts.normals))
        of = request.space.open_samples_at(left.points, left.normals)
        left = replace(left, areas=left.areas / request.record.weights(of))
        scanner = limited_scanner(run.settled.scene, run.settled.scanner)
        return assign_causes(left, of, candidates.viewpoints, candidates.reached, scanner, casters)


def _open_run(
    session: Session[None], scene: Scene, surface: Workpiece, request: BatchRequest, out: Path
) -> AbstractContextManager[pipeline.OpenRun]:
    changes = {"max_views": request.batch.views or None, "curve": False, "required_visible": 0.0, "solver": "auto"}
    scene = scene.model_copy(update={"plan": scene.plan.model_copy(update=changes)})
    inner = replace(session, out=out, use_cache=False, origin=Origin())
    return pipeline.open_run(inner, scene, surface, with_plots=False)


def _plan(session: PlanSession, settled: SettledScene, request: BatchRequest) -> StopReason | None:
    """Plan a batch into the open folder; return the reason if none is worth its views."""
    basis = _sample_surface(session, settled, request)
    if basis is None:
        return StopReason("nothing is uncovered")
    surface, request = basis.part, basis.request
    cell = pipeline.compile_cell(session, settled, surface, is_belief=True)
    candidates, casters = _find_candidates(session, settled, basis, cell)
    if not candidates.reached.reachable.any():
        return StopReason("the arm reaches no view of the uncovered surface")
    with session.stage("measurability") as progress:
        measured = measure(session, settled, surface, candidates, casters, progress, samples=basis.scouts)
        files.write_measurability(session.folder, measured.M)
    problem = pipeline.make_problem(session, settled, cell, measured)
    append = pipeline.appending(session, settled, cell, surface)
    try:
        problem, plan = _select_and_connect(session, problem, surface, request, append)
    except UnreachableError as error:
        return StopReason(str(error))
    if sentence := _insufficient_gain(plan, request):
        return StopReason(sentence)
    clearance, motion = pipeline.time_motion(session, problem, plan)
    with session.stage("report"):
        report = plan_report(settled, surface.planning, problem, plan, clearance, motion, OptionalResults())
        files.write_plan(session.folder, report, plan, problem.candidates, problem.world)
        files.write_report(session.folder, report)
    return None


def _find_candidates(
    session: PlanSession, settled: SettledScene, surface: _Surface, cell: Cell
) -> tuple[CandidateSet, Sequence[RayCaster]]:
    """Reach and grow candidates; also return the ray casters.

    If views must keep the minimum range, space in which the part may be nearer occludes everything behind it.
    """
    request, casters = surface.request, cell.casters(surface.part)
    if request.keep_min_range:
        assert settled.scene.scanner.range_mm is not None
        near = settled.scene.scanner.range_mm[0] / 1000
        casters = (casters[0], MinRangeOccluder(casters[1], request.space, near))
    is_short = request.poses is None and request.batch.views != 0
    with session.stage("reach and grow") as progress:
        candidates = reach_viewpoints(settled, cell, surface.viewpoints, progress)
        schedule = BELIEF_SCHEDULE if is_short else growth.SCHEDULE
        candidates = with_grown(settled, cell, candidates, surface.scouts, casters, schedule=schedule)
        files.write_candidates(session.folder, settled, candidates)
    return candidates, casters


def _sample_surface(session: PlanSession, settled: SettledScene, request: BatchRequest) -> _Surface | None:
    """Make the planning mesh, and draw rows and scouts; None if nothing is uncovered."""
    with session.stage("decimate and sample"):
        reference, faces = settled.part.reference, settled.settings.faces
        if request.poses is None:
            planning = decimate(belief.coarse_surface(request.space, unlimited=request.batch.views == 0), faces)
        else:
            planning = decimate(
                cluster_vertices(reference, max(_MIN_COARSE_FACES, _FACES_PER_FACE * faces)) or reference, faces
            )
        files.write_meshes(session.folder, reference, planning)
        counts = (N_DRAWN, N_DRAWN) if request.poses is None else N_DRAWN_MEASURED
        sample_sets = [
            draw_samples(reference, planning, count, session.rng(stream))
            for count, stream in zip(counts, (Stream.BELIEF_SAMPLES, Stream.BELIEF_SCOUTS), strict=True)
        ]
        part = make_surface(reference, planning, sample_sets[0])
        scanner = limited_scanner(settled.scene, settled.scanner)
        rows, scouts = (
            select_samples(samples, request, limit, scanner, part.caster)
            for samples, limit in zip(sample_sets, (MAX_ROWS, MAX_SCOUTS), strict=True)
        )
        if not len(rows) or not len(scouts):
            return None
        request = replace(request, gain_ratio=realised_gain_ratio(sample_sets[0], request, scanner, part.caster))
        viewpoints = generate_viewpoints(settled.scene, settled.settings, settled.part, planning)
        if (viewpoints.face >= 0).all():
            viewpoints = viewpoints.pick(np.isin(viewpoints.face, rows.planning_face))
        return _Surface(replace(part, samples=rows), scouts, viewpoints, request)


def _select_and_connect(
    session: PlanSession, problem: SelectionProblem, surface: PartSurface, request: BatchRequest, append: Append
) -> tuple[SelectionProblem, ConnectedPlan]:
    """Select a batch and plan its motion; views that cannot be connected are replaced by the best others."""
    batch = request.batch
    if not batch.per_second or batch.views is None:
        if request.min_gain:  # the ring is planned for a cylinder: a better view of it gains nothing
            before, problem = problem, with_refined_candidates(problem, _views_with_gain(problem, request), append)
            files.write_measured(session.folder, problem, before)
            limit = max(len(_views_with_gain(problem, request)), 1)
            plan = problem.request.plan.model_copy(update={"max_views": limit})
            problem = replace(problem, request=replace(problem.request, plan=plan))
        return pipeline.select_and_connect(session, problem, surface)
    with session.stage("select, order and connect") as progress:
        rng, before = session.rng(Stream.SELECTION), problem
        problem = with_refined_candidates(problem, _most_per_second(problem, max(batch.views, N_STARTS)), append)
        best = _most_per_second(problem, batch.views)
        others = tuple(np.setdiff1d(np.arange(len(problem.candidates)), best).tolist())
        options = problem.request.plan.model_copy(update={"banned": others})
        selection = select_views(replace(problem, request=replace(problem.request, plan=options)), rng)
        problem = replace(problem, request=replace(problem.request, motion=_SHORT_BUDGET))
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


def _views_with_gain(problem: SelectionProblem, request: BatchRequest) -> Ints:
    """Return views that greedily each add the least gain."""
    M, usable = problem.M, problem.usable()
    limit = len(usable) if request.batch.views is None else request.batch.views
    gains = request.gain_ratio * M.samples.areas
    return select_by_gain_per_second(M.matrix(), gains, np.ones(len(usable)), usable, limit, request.min_area)


def _insufficient_gain(plan: ConnectedPlan, request: BatchRequest) -> str:
    """Return the reason for which a batch is not worth its views; "" if it is."""
    each = request.gain_ratio * plan.cover.covered_area / len(plan.cover.views)
    if request.batch.include_covered or each >= request.min_area:
        return ""
    times = "" if request.batch.min_gain_factor == 1 else f"{request.batch.min_gain_factor:g} x "
    return (
        f"a further view is expected to add {100 * each / request.measured_area:.3f} % of the measured surface, "
        f"less than {times}the {100 * request.min_gain:g} % minimum"
    )
