"""Planning pipeline: candidates, measured candidates, selection, motion, report.

Each stage is a function of the session and values. `plan` shows them on one screen. Edited plans (`cell.plan.edit`),
several set-ups (`cell.plan.setups`) and batches of an exploration (`cell.explore.stage`) use the same stages with other
candidates, rows, requests and verdicts. A finished stage is on disk before the next one starts.
"""

import logging
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from cell import scanners
from cell.errors import UnreachableError, UsageError
from cell.files import file_errors
from cell.inspect.artefacts import FEATURES
from cell.part import workpiece
from cell.part.planning_mesh import planning_mesh
from cell.part.workpiece import Workpiece
from cell.plan import evaluation, files, selection
from cell.plan.candidates import (
    GROWN,
    CandidateSet,
    Cell,
    MeasuredSet,
    PlanSession,
    append_viewpoints,
    generate_viewpoints,
    make_surface,
    measure,
    reach_viewpoints,
    require_reachable,
    with_grown,
)
from cell.plan.evaluation import OptionalResults, Verdict, judge_plan
from cell.plan.motion import ConnectedPlan, connect_views
from cell.plan.pose_search import Append, search_views, skip_reason
from cell.plan.selection import (
    RegionGroups,
    Request,
    Selection,
    SelectionProblem,
    pose_error,
    pose_probabilities,
    select_least_time,
    select_thoroughly,
    select_with_row_generation,
)
from cell.report import plots
from cell.runs.folder import RunFolder
from cell.runs.run import Run
from cell.runs.schema import Report
from cell.scene import settle, validation
from cell.scene.file import BUILT_IN, scene_from_options
from cell.scene.model import Scene, with_rest
from cell.scene.regions import with_regions
from cell.scene.settle import SettledScene
from cell.session import PlotQueue, Session, Stream
from cell.world import clearance
from cell.world.checks import find_warnings, require_feasible
from cell.world.clearance import MotionClearance
from cell.world.measurability import PartSurface, surface_samples
from cell.world.model import compile_settled
from planner import first_use
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import draw_samples
from planner.ports import Progress
from planner.timing.limits import scale_limits
from planner.timing.motion import Motion, retime
from planner.values import Bools, Floats
from planner.viewpoints import growth
from planner.viewpoints.pose_search import SearchProgress
from planner.viewpoints.viewpoints import Viewpoints

if TYPE_CHECKING:
    import trimesh

log = logging.getLogger(__name__)


@dataclass(slots=True)
class OpenRun:
    """An open run folder with the values that a plan begins with.

    Attributes:
        session: with the open folder.
        settled: scene, part and scanner.
        exit_code: of the finished run.
        stopped: reason for abandoning the run; "" to finish it.
    """

    session: PlanSession
    settled: SettledScene
    exit_code: int = 0
    stopped: str = ""

    @property
    def path(self) -> Path:
        """The folder, where it is now."""
        return self.session.folder.path

    def conclude(self, verdict: Verdict) -> None:
        """Report a verdict and take its exit code."""
        for sentence in verdict.missed:
            self.session.note(sentence)
        self.exit_code = verdict.exit_code


def plan(session: Session[None], scene: Scene, part: Workpiece | None = None) -> Path:
    """Plan the views of a part and write the run folder.

    Args:
        session: of the command.
        scene: checked, with the options of the command line.
        part: in place of the scene's part.

    Returns:
        The run folder.

    Raises:
        CellError: in one sentence; the run folder keeps the finished stages, its status and stage.
    """
    if scene.setup:
        raise UsageError(
            f"the scene has {len(scene.setup)} [[setup]] tables, which cell plan does not use: remove them, or use "
            "cell setups"
        )
    with open_run(session, scene, part) as run:
        surface, problem, plan = plan_views(run)
        report = finish(run.session, run.settled, surface.planning, problem, plan)
        run.conclude(_judge(report))
    return run.path


def plan_views(run: OpenRun) -> tuple[PartSurface, SelectionProblem, ConnectedPlan]:
    """Take the steps from the part to connected views."""
    session, settled = run.session, run.settled
    surface, viewpoints = sample_part(session, settled)
    cell = compile_cell(session, settled, surface)
    candidates = find_candidates(session, settled, surface, cell, viewpoints)
    measured = measure_candidates(session, settled, surface, cell, candidates)
    problem = make_problem(session, settled, cell, measured)
    problem, plan = select_and_connect(session, problem, surface, appending(session, settled, cell, surface))
    return surface, problem, plan


@contextmanager
def open_run(
    session: Session[None], scene: Scene, part: Workpiece | None = None, *, with_plots: bool = True
) -> Iterator[OpenRun]:
    """Settle a scene for its part, and open the run folder; finish or abandon the folder at the end of the block.

    Args:
        session: of the command.
        scene: checked.
        part: in place of the scene's part.
        with_plots: whether plots are drawn.
    """
    first_use.share_compilation()
    with plots.plot_process() if with_plots else nullcontext(PlotQueue()) as queue:
        with session.stage("load the part"):
            part = workpiece.load(scene.part.source, scene.part.units) if part is None else part
            unmet = ""
            if scene.has_features:
                from cell.plan import inspection  # takes half a second, which most plans do not need

                scene, unmet = inspection.with_feature_regions(scene, part)
            part = with_regions(part, scene)
        for sentence in (
            *(finding.sentence for finding in part.findings),
            *settle.notes(scene, part),
            *filter(None, [unmet]),
        ):
            session.note(sentence)
        settled = settle.settle(scene, part)
        if hasattr(settled.scanner, "T_view_scanner"):
            settled.scene.require_fixed_part("a scanner that sweeps")
        folder = RunFolder.create(
            session.out,
            list(session.origin.argv),
            scene.plan.seed,
            files.input_hashes(settled.scene, part),
            datetime.now(UTC),
        )
        run = OpenRun(session.opened(folder, scene.plan.seed, queue), settled)
        with folder.keep_on_failure(), _logged(folder.path / "run.log"):
            files.write_scene(folder, session.origin.scene_path)
            path = session.origin.scene_path
            folder.record_files(files.named_files(settled.scene, path), files.overridden_keys(scene, path))
            yield run
            if (folder.path / "plan.json").is_file():  # each of several set-ups has a folder and digest of its own
                folder.seal()
        if run.stopped:
            folder.fail("failed", UnreachableError.exit_code, run.stopped)
        else:
            folder.finish(run.exit_code)


@contextmanager
def _logged(path: Path) -> Iterator[None]:
    """Write the log of this process to a file as well."""
    root = logging.getLogger()
    with file_errors(f"{path} cannot be written", "choose a writable --out"):
        handler = logging.FileHandler(path, encoding="utf-8")
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


def sample_part(session: PlanSession, settled: SettledScene) -> tuple[PartSurface, Viewpoints]:
    """Decimate the part, draw the rows of the matrix, and generate viewpoints."""
    with session.stage("decimate and sample"):
        reference, faces = settled.part.reference, settled.settings.faces
        planning = planning_mesh(reference, faces, use_cache=session.use_cache)
        files.write_meshes(session.folder, reference, planning)
        for sentence in write_features(session.folder, settled):
            session.note(sentence)
        session.plots.part_ready(session.folder.path)
        viewpoints = generate_viewpoints(settled.scene, settled.settings, settled.part, planning)
        rows = surface_samples(settled.scene, reference, planning, session.rng(Stream.MATRIX_SAMPLES))
        deviation = validation.mesh_deviation(rows, planning)
        for note in (
            validation.face_count_note(len(planning.faces), faces),
            validation.coarse_mesh_note(deviation, len(planning.faces)),
        ):
            if note:
                session.note(note)
        files.write_viewpoints(session.folder, scanners.sweep_columns(settled.scanner, viewpoints))
        return make_surface(reference, planning, rows), viewpoints


def write_features(folder: RunFolder, settled: SettledScene) -> tuple[str, ...]:
    """Write the features of a scene that has any; return doubts about them."""
    if not settled.scene.has_features:
        return ()
    from cell.plan import inspection

    return inspection.write_features(folder, settled.scene, settled.part)


def copy_surface(session: PlanSession, settled: SettledScene, run: Run) -> PartSurface:
    """Take meshes and rows of the matrix from a finished run."""
    with session.stage("read the plan"):
        files.copy_meshes(session.folder, run)
        session.plots.part_ready(session.folder.path)
        return make_surface(settled.part.reference, run.planning_mesh, run.measurability.samples)


def compile_cell(session: PlanSession, settled: SettledScene, surface: PartSurface, *, is_belief: bool = False) -> Cell:
    """Compile the cell. The surface of a belief is inside unseen space, so that it is not checked for contacts."""
    with session.stage("compile the cell"):
        world = compile_settled(settled, surface.reference)
        if not is_belief:
            require_feasible(world)
            for sentence in (*find_warnings(world), *filter(None, [validation.sweep_note(settled.scanner)])):
                session.note(sentence)
        files.write_cell(session.folder, settled, surface.planning, world)
        session.plots.cell_ready(session.folder.path)
        return Cell.of(world)


def find_candidates(
    session: PlanSession, settled: SettledScene, surface: PartSurface, cell: Cell, viewpoints: Viewpoints
) -> CandidateSet:
    """Reach viewpoints, and grow more for samples that no reachable viewpoint measures."""
    plan = settled.scene.plan
    with session.stage("reach") as progress:
        candidates = reach_viewpoints(settled, cell, viewpoints, progress)
        files.write_reach(session.folder, candidates.reached)
    if plan.candidates == GROWN:
        with session.stage("grow the candidates") as progress:
            scouts = draw_samples(surface.reference, surface.planning, growth.N_SCOUTS, session.rng(Stream.SCOUTS))
            candidates = with_grown(settled, cell, candidates, scouts, cell.casters(surface), progress)
            files.write_candidates(session.folder, settled, candidates)
    require_reachable(plan, settled.part, candidates.reached)
    return candidates


def measure_candidates(
    session: PlanSession, settled: SettledScene, surface: PartSurface, cell: Cell, candidates: CandidateSet,
    *, may_be_empty: bool = False,
) -> MeasuredSet:  # fmt: skip
    """Fill the matrix, evaluate the candidates on held-out samples, and write them."""
    with session.stage("measurability") as progress:
        measured = measure(
            session, settled, surface, candidates, cell.casters(surface), progress, may_be_empty=may_be_empty
        )
        files.write_measured(session.folder, measured)
        return measured


def appending(session: PlanSession, settled: SettledScene, cell: Cell, surface: PartSurface) -> Append:
    """Return the function that appends viewpoints to the candidates of a problem; their matrix is not cached."""
    uncached = replace(session, use_cache=False)

    def append(problem: SelectionProblem, viewpoints: Viewpoints) -> SelectionProblem:
        return append_viewpoints(uncached, settled, surface, problem, reach_viewpoints(settled, cell, viewpoints))

    return append


def make_problem(session: PlanSession, settled: SettledScene, cell: Cell, measured: MeasuredSet) -> SelectionProblem:
    """Combine measured candidates with the request of the scene."""
    scene, options = settled.scene, settled.scene.plan
    layer = None
    if not pose_error(options).is_exact:
        with session.stage("pose errors") as progress:
            layer = pose_probabilities(options, measured, session.rng(Stream.POSE_ERRORS), progress)
    request = Request(options, None, layer, RegionGroups.of(with_rest(scene.region), options), effort=session.effort)
    limits = scale_limits(cell.world.limits, scene.robot.speed_scaling, scene.robot.acceleration_scaling)
    problem = SelectionProblem(
        measured.candidates, measured.reached, measured.M, measured.prediction, request, cell, limits
    )
    return problem.priced() if options.cost == "time" else problem


def select_and_connect(
    session: PlanSession, problem: SelectionProblem, surface: PartSurface, append: Append | None = None,
    *, is_allowed: Callable[[Floats], Bools] | None = None,
) -> tuple[SelectionProblem, ConnectedPlan]:  # fmt: skip
    """Select the views, order them and plan the motion.

    Args:
        session: of the plan.
        problem: candidates and request.
        surface: the part, for further rows.
        append: appends moved views to the candidates; None: poses are not searched.
        is_allowed: (n, 4, 4) [m] -> (n,) whether a view may be moved to each pose; None: all poses are allowed.

    Returns:
        The problem with added rows and candidates, and the plan.
    """
    with session.stage("select the views"):
        rng, before = session.rng(Stream.SELECTION), problem
        fresh = session.rng(Stream.FRESH_SAMPLES)
        reason = "" if append is None else skip_reason(problem)
        is_searched = append is not None and not reason
        start = select_with_row_generation(problem.with_costs(None), surface, rng, fresh, is_short=is_searched)
    choice, search = start, None
    if append is not None and is_searched:
        with _search_stage(session, len(start[1].cover.views)) as report:
            search_rng, comparison_rng = session.rng(Stream.POSE_SEARCH), session.rng(Stream.POSE_COMPARISON)
            moved_problem, moved, search = search_views(
                *start, surface, append, search_rng, comparison_rng, rng, report, is_allowed=is_allowed
            )
            choice = moved_problem, moved
    initial = start
    if is_searched and choice[1] is start[1]:
        choice = initial = start[0], select_thoroughly(*start, rng)
    searched = f"Poses are not searched: {reason}" if reason else ""
    n_moved = len(choice[1].cover.views)
    if append is not None and (session.folder.path / FEATURES).is_file():
        with session.stage("uncertainty of the characteristics"):
            from cell.plan import inspection

            choice = inspection.add_certain_views(session, *choice, surface, rng, fresh)
    with session.stage("order and connect") as progress:
        if before.request.costs is not None:
            choice = initial = select_least_time(*choice, rng)

        def connect(problem: SelectionProblem, selection: Selection) -> ConnectedPlan:
            motion_rng = session.rng(Stream.MOTION)
            return connect_views(problem, selection, selection_rng=rng, motion_rng=motion_rng, progress=progress)

        problem, plan = choice[0], connect(*choice)
        # A moved view that cannot be connected may be replaced by worse ones than the initial views.
        if choice[1] is not initial[1] and plan.selection is not choice[1] and problem.request.demand is None:
            try:
                unmoved = connect(*initial)
            except UnreachableError:  # only the moved views can be connected
                unmoved = plan
            fewer = len(unmoved.cover.views) < len(plan.cover.views)
            if fewer or plan.visible.area < unmoved.visible.area:
                problem, plan = initial[0], unmoved
        if search is not None:
            n_views = len(plan.cover.views)
            has_more = problem.request.demand is not None and n_views > n_moved
            searched = search.sentence(n_moved if has_more else n_views)
            searched += " More views serve the uncertainty of the characteristics." if has_more else ""
        plan = replace(plan, searched=searched)
        problem = problem.with_configurations(plan.candidate, plan.tour.q)
        files.write_measured(session.folder, problem, before)
        return problem, plan


@contextmanager
def _search_stage(session: PlanSession, n_views: int) -> Iterator[SearchProgress]:
    """Record the pose search as a stage, and report the number of views found so far."""
    with session.folder.stage("search fewer views"), ExitStack() as stack:

        def show(n_views: int) -> Progress:
            stack.close()
            return stack.enter_context(session.reporter.stage(f"search fewer than {n_views} views"))

        fewest, report = n_views, show(n_views)

        def update(n_done: int, total: int, n_views: int) -> None:
            nonlocal fewest, report
            if n_views < fewest:
                fewest, report = n_views, show(n_views)
            report(n_done, total)

        yield update


def time_motion(session: PlanSession, problem: SelectionProblem, plan: ConnectedPlan) -> tuple[MotionClearance, Motion]:
    """Measure the clearance of every segment, and time the motion."""
    with session.stage("measure the clearance") as progress:
        tour = plan.tour
        measured = clearance.motion_clearance(
            problem.cell.checker, tour.via, tour.segment, len(tour.detour), progress, session.effort.clearance_share
        )
        evaluation.require_no_contact(measured)
        motion = retime(
            tour.via, tour.segment, plan.via_candidate, problem.limits, pose=tour.pose, lines=plan.driven.lines
        )
        files.write_motion(session.folder, motion, measured)
        return measured, motion


def finish(
    session: PlanSession,
    settled: SettledScene,
    planning: TriangleMesh,
    problem: SelectionProblem,
    plan: ConnectedPlan,
    annotations: Mapping[str, object] = MappingProxyType({}),
) -> Report:
    """Time the motion of a connected plan, and write plan, report, plots and page.

    Args:
        session: of the plan.
        settled: scene and part.
        planning: planning mesh.
        problem: candidates and request.
        plan: connected.
        annotations: values that replace those of the report.
    """
    files.queue_views(session, settled, problem, plan)
    measured, motion = time_motion(session, problem, plan)
    files.queue_motion(session, motion)
    optional = _optional_results(session, problem, plan)
    section: list[str] = []
    if (session.folder.path / FEATURES).is_file():
        with session.stage("predict the uncertainty"):
            from cell.plan import inspection

            is_noted = "common_cover" not in annotations
            section = inspection.uncertainty_section(session, settled.scene, problem, plan, is_noted=is_noted)
    with session.stage("report"):
        report = evaluation.plan_report(settled, planning, problem, plan, measured, motion, optional)
        report = report.model_copy(update=dict(annotations))
        file = files.write_plan(session.folder, report, plan, problem.candidates, problem.world)
        files.write_report(session.folder, report, section)
        files.finish_page(session, report, file, motion, problem.world)
    return report


def _optional_results(session: PlanSession, problem: SelectionProblem, plan: ConnectedPlan) -> OptionalResults:
    """Compute optional results: simulated pose errors, coverage curve, attainable coverage."""
    plan_selection, options, cover = plan.selection, problem.request.plan, plan.cover
    if plan_selection.note:
        session.note(plan_selection.note)
    robust, curve = None, None
    if numbers := evaluation.robust_selection(plan_selection, cover.total_area):
        with session.stage("simulate executions") as progress:
            rng = session.rng(Stream.SIMULATED_EXECUTIONS)
            robust = selection.simulate_pose_errors(
                options, numbers, plan.driven.T_object_poses, problem.prediction, rng, progress
            )
    if options.curve:
        with session.stage("coverage over views"):
            rng = session.rng(Stream.COVERAGE_CURVE)
            points = selection.curve_of_plan(problem, plan.matrix, plan_selection, rng)
            selection.write_curve(session.folder, session.plots, points, len(cover.views), cover.covered_area)
        curve = selection.minimum_views_of(points)
    with session.stage("attainable coverage"):
        attainable = evaluation.attainable_coverage(problem, plan.visible, session.rng(Stream.ATTAINABLE_SAMPLES))
    return OptionalResults(attainable, robust, curve)


def _judge(report: Report) -> Verdict:
    cause = "the arm occludes the views that measure the rest, or the rest lies between the samples; see cell why"
    if report.exclusions:
        cause = f"{len(report.exclusions)} selected views could not be connected; move the part, or request less"
    has_target = report.max_coverage is None and report.multiplicity is None and report.robust is None
    return judge_plan(report, (cause, "move the part, or allow more standoffs and rolls"), has_target=has_target)


def read_request(
    part: "str | Path | trimesh.Trimesh | Scene | None", path: str | Path | None, options: Mapping[str, object]
) -> tuple[Scene, Workpiece | None]:
    """Return the checked scene, and the part unless it comes from a file.

    Args:
        part: mesh file or built-in part by name, a mesh in memory, a whole scene, or None for the scene's part.
        path: scene file; None is the built-in scene.
        options: by the names of `cell.scene.options.option_specs(Scene)`; `units` is the unit of a mesh in memory.

    Raises:
        UsageError: if options are given in addition to a scene, or the part is none.
        SceneError: if the scene is not possible.
    """
    if isinstance(part, Scene):
        if options:
            raise UsageError(
                f"{', '.join(options)} given in addition to a Scene, which contains all options; set them "
                "there, or give a scene file instead"
            )
        return part, None
    file = None if path is None else Path(path)
    if part is None or isinstance(part, str | Path):
        return scene_from_options(file, options, part), None
    if not (hasattr(part, "vertices") and hasattr(part, "faces")):
        raise UsageError(
            f"the part is a {type(part).__name__}; give a path, the name of a built-in part, or a trimesh.Trimesh "
            "(of a trimesh.Scene: scene.to_mesh())"
        )
    units = options.get("units")
    name = Path(str(part.metadata.get("file_name") or "mesh")).stem
    loaded = workpiece.from_arrays(
        "mesh" if name in BUILT_IN else name, part.vertices, part.faces, None if units is None else str(units)
    )
    return scene_from_options(file, {key: value for key, value in options.items() if key != "units"}), loaded
