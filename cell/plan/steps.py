"""The steps of `cell plan`, put on one screen by `cell.plan.pipeline`: values in, files written, values out."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from cell import scanners
from cell.part.workpiece import Workpiece
from cell.plan import attainable, denser_samples, pose_uncertainty
from cell.plan import files as plan_files
from cell.plan.candidates import GROWN, arm_of, first, grow, limited
from cell.plan.clearances import require_no_contact
from cell.plan.connected_plan import ConnectedPlan
from cell.plan.least_time import counted, in_seconds, priced
from cell.plan.problem import Problem
from cell.plan.reachable import require_reachable
from cell.plan.refined import Append, connected, movable, with_fewer
from cell.plan.region_goals import RegionGoals, require_measurable
from cell.plan.request import Request
from cell.plan.view_plan import choose_and_connect
from cell.runs.folder import RunFolder
from cell.runs.schema import Attainable
from cell.scanners import ScannerPlugin
from cell.scene import validation
from cell.scene.model import Scene, with_rest
from cell.scene.settle import Settings
from cell.session import Session, Stream
from cell.world import clearance
from cell.world.checks import find_warnings, require_feasible
from cell.world.clearance import MotionClearance
from cell.world.collision import MujocoCollisionChecker
from cell.world.embree import EmbreeRayCaster
from cell.world.measurability import PartSurface, limit_sigma, part_matrix, surface_samples
from cell.world.model import World, compile_world
from cell.world.occluders import fixed_occluders, make_caster
from cell.world.prediction import Prediction, held_out_samples
from planner.geometry.decimation import decimate
from planner.geometry.sampling import draw_samples
from planner.kinematics import reach
from planner.kinematics.reach import Reach, join_reach
from planner.measurability import visibility
from planner.measurability.matrix import Measurability, spread_measurability
from planner.ports import Kinematics, Progress, RayCaster, Scanner
from planner.timing.limits import scale_limits
from planner.timing.motion import Motion, retime
from planner.viewpoints import growth
from planner.viewpoints.viewpoints import Viewpoints, join_viewpoints, pick_viewpoints

PlanSession = Session[RunFolder]


@dataclass(frozen=True, slots=True, eq=False)
class Job:
    """What is planned: the checked scene, the part, and what the scene leaves open settled for it."""

    scene: Scene
    part: Workpiece
    settings: Settings
    scanner: ScannerPlugin


@dataclass(frozen=True, slots=True, eq=False)
class Cell:
    """The compiled cell, and who answers for reach and collision in it."""

    world: World
    checker: MujocoCollisionChecker
    kinematics: Kinematics


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """Candidates with all that is known of each.

    Attributes:
        candidates: the viewpoints, columns of M.
        reached: their verdicts and joint solutions.
        M: what they measure, occluders applied.
        scanner: the sensor's law, with the limit on sigma where one was asked for.
        casters: the part's and the occluders', object frame.
    """

    candidates: Viewpoints
    reached: Reach
    M: Measurability
    scanner: Scanner
    casters: Sequence[RayCaster]


def sample_surface(session: PlanSession, job: Job) -> tuple[PartSurface, Viewpoints]:
    """Steps 2 and 3: the planning mesh, the rows of the matrix, the generator's candidates."""
    with session.stage("decimate and sample"):
        reference = job.part.reference
        planning = decimate(reference, job.settings.faces)
        plan_files.write_meshes(session.folder, reference, planning)
        session.plots.part_ready(session.folder.path)
        if other := validation.face_count_note(len(planning.faces), job.settings.faces):
            session.note(other)
        candidates = first(job.scene, job.settings, job.part, planning)
        features = surface_samples(job.scene, reference, planning, session.rng(Stream.MATRIX_SAMPLES))
        if doubt := validation.coarse_mesh_note(validation.mesh_deviation(features, planning), len(planning.faces)):
            session.note(doubt)
        plan_files.write_viewpoints(session.folder, scanners.sweep_columns(job.scanner, candidates))
        caster = EmbreeRayCaster(reference.vertices, reference.faces)
        return PartSurface(reference, planning, features, caster), candidates


def compile_cell(session: PlanSession, job: Job, surface: PartSurface, *, believed: bool = False) -> Cell:
    """The cell as MuJoCo checks it; a part that is only `believed` stands inside unseen space, which no other may."""
    with session.stage("compile the cell"):
        world = compile_world(
            job.scene, surface.reference.vertices, part_faces=surface.reference.faces,
            baseline_mm=scanners.baseline_mm(job.settings.scanner, job.scanner),
        )  # fmt: skip
        if not believed:
            require_feasible(world)
            for sentence in (*find_warnings(world), *filter(None, [validation.sweep_note(job.scanner)])):
                session.note(sentence)
        described, faces = scanners.describe(job.scene.scanner.type, job.scanner), len(surface.planning.faces)
        plan_files.write_cell(session.folder, job.scene, job.settings, job.part, faces, world, described)
        return Cell(world, MujocoCollisionChecker(world), world.kinematics)


def reach_candidates(session: PlanSession, job: Job, cell: Cell, candidates: Viewpoints) -> Reach:
    """Step 4: every branch and turn of every candidate, with a verdict each.

    Raises:
        UnreachableError: if the arm reaches none.
    """
    with session.stage("reach") as progress:
        reached = reach_of(job, cell, candidates, progress)
        plan_files.write_reach(session.folder, reached)
        if job.scene.plan.candidates != GROWN:
            require_reachable(job.scene.plan, job.part, reached)
        return reached


def grow_candidates(
    session: PlanSession, job: Job, surface: PartSurface, cell: Cell, candidates: Viewpoints, reached: Reach
) -> tuple[Viewpoints, Reach]:
    """Step 4 again: candidates where none that is reached measures, if the scene's generator grows them.

    Raises:
        UnreachableError: if the arm reaches none after all.
        SceneError: if the plan names a candidate that there is not, or that is not reached.
    """
    if job.scene.plan.candidates != GROWN:
        return candidates, reached
    with session.stage("grow the candidates") as progress:
        scouts = draw_samples(surface.reference, surface.planning, growth.N_SCOUTS, session.rng(Stream.SCOUTS))
        casters = casters_of(surface, cell)
        arm = arm_of(cell.world, cell.kinematics, cell.checker, limited(job.scene, job.scanner), casters)
        grown = grow(candidates, reached.reachable, scouts, arm, progress)
        reached = join_reach([reached, reach_of(job, cell, grown)])
        candidates = join_viewpoints([candidates, grown])
        plan_files.write_viewpoints(session.folder, scanners.sweep_columns(job.scanner, candidates))
        plan_files.write_reach(session.folder, reached)
        require_reachable(job.scene.plan, job.part, reached)
        return candidates, reached


def measure(
    session: PlanSession, job: Job, surface: PartSurface, cell: Cell, candidates: Viewpoints, reached: Reach
) -> tuple[Measured, Prediction]:
    """Step 5: the measurability matrix, whose columns are asked where the arm gets to, and the held-out samples."""
    with session.stage("measurability") as progress:
        casters = casters_of(surface, cell)
        usable = np.flatnonzero(reached.reachable)
        M, scanner = columns(session, job, surface, casters, pick_viewpoints(candidates, usable), progress)
        M = spread_measurability(M, usable, len(candidates))
        plan_files.write_measurability(session.folder, M)
        require_measurable(job.scene.region, M)
        measured = Measured(scanners.sweep_columns(job.scanner, candidates), reached, M, scanner, casters)
        return measured, predicted(session, surface, measured, progress)


def columns(
    session: PlanSession, job: Job, surface: PartSurface, casters: Sequence[RayCaster],
    views: Viewpoints, progress: Progress,
    *, may_be_empty: bool = False,
) -> tuple[Measurability, Scanner]:  # fmt: skip
    """M of viewpoints past occluders, within the limit on sigma (`limit_sigma`), and the scanner that keeps it."""
    views = scanners.sweep_columns(job.scanner, views)
    M = part_matrix(
        job.scene,
        job.settings,
        surface,
        views,
        reporter=session.reporter,
        use_cache=session.use_cache,
        progress=progress,
    )
    law = limited(job.scene, job.scanner)
    keeps = law if job.scene.region else job.scanner
    M = visibility.apply_occluders(M, views, keeps, casters[1], ray_caster=casters[0], progress=progress)
    if (limit := job.scene.plan.max_sigma_mm) is not None:
        M = limit_sigma(M, views, job.scanner, limit, casters, may_be_empty=may_be_empty)
    return M, law


def casters_of(surface: PartSurface, cell: Cell) -> Sequence[RayCaster]:
    """The part's and the occluders', object frame."""
    return [surface.caster, make_caster(fixed_occluders(cell.world))]


def predicted(session: PlanSession, surface: PartSurface, measured: Measured, progress: Progress) -> Prediction:
    """The held-out samples, and what reachable candidates measure of them."""
    poses = measured.candidates.T_object_scanner[measured.reached.reachable]
    samples = held_out_samples(surface.reference, surface.planning, session.seed)
    return Prediction.of(samples, measured.scanner, measured.casters, poses, progress)


def ask(session: PlanSession, job: Job, cell: Cell, measured: Measured, prediction: Prediction) -> Problem:
    """What is asked of selection and motion: the wishes with what they need to know."""
    scene, plan = job.scene, job.scene.plan
    layer = None
    if not pose_uncertainty.pose_error(plan).is_exact:
        with session.stage("pose errors") as progress:
            layer = pose_uncertainty.layer(
                plan, measured.M, measured.candidates, measured.reached, measured.scanner, measured.casters,
                session.rng(Stream.POSE_ERRORS), progress,
            )  # fmt: skip
    limits = scale_limits(cell.world.limits, scene.robot.speed_scaling, scene.robot.acceleration_scaling)
    goals = RegionGoals.of(with_rest(scene.region), plan)
    problem = Problem(
        Request(plan, None, layer, goals), measured.candidates, measured.reached, measured.M, prediction,
        cell.world, limits, cell.kinematics, cell.checker,
    )  # fmt: skip
    return priced(problem) if plan.cost == "time" else problem


def connect(
    session: PlanSession, problem: Problem, surface: PartSurface, append: Append | None = None
) -> tuple[Problem, ConnectedPlan]:
    """Steps 6 to 8: the problem with what its promise took, and its views connected; `append` lets views be moved."""
    with session.stage("select, order and connect") as progress:
        chooses, before = session.rng(Stream.SELECTION), problem
        moved = unmoved = denser_samples.chosen_where_kept(
            counted(problem), surface, chooses, session.rng(Stream.FRESH_SAMPLES)
        )
        if append is not None and movable(unmoved[0]):
            moved = with_fewer(*unmoved, append, chooses)
        if problem.request.costs is not None:
            moved = unmoved = in_seconds(*moved, chooses)
        joined = partial(choose_and_connect, selection_rng=chooses, progress=progress)
        problem, chosen = connected(
            moved, unmoved, lambda *asked: joined(*asked, motion_rng=session.rng(Stream.MOTION))
        )
        problem = problem.taking(chosen.candidate, chosen.tour.q)
        write_changed(session, before, problem)
        return problem, chosen


def write_changed(session: PlanSession, before: Problem, problem: Problem) -> None:
    """Write again what of a problem's candidates is other than before."""
    if problem.M is not before.M:
        plan_files.write_measurability(session.folder, problem.M)
    if problem.candidates is not before.candidates:
        plan_files.write_viewpoints(session.folder, problem.candidates)
    if problem.reached is not before.reached:
        plan_files.write_reach(session.folder, problem.reached)


def prove_and_time(session: PlanSession, problem: Problem, chosen: ConnectedPlan) -> tuple[MotionClearance, Motion]:
    """Step 9: the motion's clearance along every segment, and its timing."""
    with session.stage("measure the clearance") as progress:
        tour = chosen.tour
        measured = clearance.motion_clearance(problem.checker, tour.via, tour.segment, len(tour.detour), progress)
        require_no_contact(measured)
        motion = retime(
            tour.via, tour.segment, chosen.via_candidate, problem.limits, pose=tour.pose, lines=chosen.lines
        )
        plan_files.write_motion(session.folder, motion, measured)
        return measured, motion


def what_is_lost(session: PlanSession, problem: Problem, chosen: ConnectedPlan) -> Attainable:
    """What any pose would measure that the robot takes up here, beside what the plan measures."""
    with session.stage("what is lost"):
        return attainable.of_plan(problem, chosen.visible, session.rng(Stream.ATTAINABLE_SAMPLES))


def reach_of(job: Job, cell: Cell, views: Viewpoints, progress: Progress | None = None) -> Reach:
    """Verdicts and joint solutions of viewpoints."""
    T_base_object, T_flange_scanner = cell.world.T_base_object, cell.world.T_flange_scanner
    poses = scanners.sweep_columns(job.scanner, views)
    return reach.solve_reach(poses, T_base_object, T_flange_scanner, cell.kinematics, cell.checker, progress=progress)
