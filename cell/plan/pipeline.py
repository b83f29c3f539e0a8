"""`cell plan`, steps 1 to 9: part in, measured views in collision-free order and a timed motion out.

`_steps` shows the whole on one screen. Every noun is an immutable value; what a step has finished is on disk before the
next one starts.
"""

import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from cell import compile_ahead, scanners
from cell.compile_ahead import Ahead
from cell.errors import FileError, UnreachableError
from cell.narrator import Narrator
from cell.part import workpiece
from cell.part.mesh_checks import Kind
from cell.part.workpiece import Workpiece
from cell.plan import curve as curves
from cell.plan import files as plan_files
from cell.plan import promise
from cell.plan import request as requests
from cell.plan.candidates import first, grow
from cell.plan.clearances import clearance_summary, require_no_contact
from cell.plan.problem import Problem
from cell.plan.request import Request, check_named, seconds_of_views
from cell.plan.summary import draw, plan_summary
from cell.plan.view_plan import ConnectedPlan, choose_and_connect
from cell.rays.embree import EmbreeRayCaster
from cell.rays.matrix import limit_sigma, part_matrix, surface_features
from cell.rays.occluders import caster_of, occluder_triangles
from cell.rays.prediction import Prediction, held_out
from cell.robot.kinematics import Kr16Kinematics
from cell.run.folder import SCHEMA, RunFolder
from cell.scene import doubts
from cell.scene.resolve import Settings, resolve
from cell.scene.scene import Scene
from cell.world import clearance
from cell.world.collision import MujocoCollisionChecker
from cell.world.world import compile as compile_world
from planner.measurability.matrix import Measurability, occlude
from planner.ports import Progress, Scanner
from planner.reach import reach
from planner.reach.reach import Reach
from planner.surface.decimate import decimate
from planner.timing.motion import retime, scaled
from planner.viewpoints.viewpoints import Viewpoints

log = logging.getLogger(__name__)

_ONE_SIDED = (Kind.OPEN, Kind.FLAT)

_FEATURES, _SELECTION, _MOTION, _ENSEMBLE, _EXECUTIONS, _CURVE = (
    0,
    2,
    3,
    4,
    5,
    6,
)
"""Streams of randomness (1 is `cell.rays.prediction.HELD_OUT_STREAM`): each step draws from its own, so that one step's
appetite does not change another's draws."""


@dataclass(frozen=True, slots=True, eq=False)
class PlanOutcome:
    """What a finished `cell plan` leaves.

    Attributes:
        folder: the run folder.
        exit_code: 0, or 3 where the plan stays below the required coverage.
        summary: the content of report.json.
    """

    folder: Path
    exit_code: int
    summary: dict[str, Any]

    def as_json(self) -> dict[str, Any]:
        """The object that `--json` prints: report.json, and where and how the run ended."""
        return {"schema": SCHEMA, "exit_code": self.exit_code, "run_folder": str(self.folder), **self.summary}


@dataclass(frozen=True, slots=True)
class Run:
    """The open run: where files go, who is told, and the seed."""

    folder: RunFolder
    narrator: Narrator
    seed: int
    use_cache: bool

    @contextmanager
    def step(self, name: str) -> Iterator[Progress]:
        """Name the step to the person and to the manifest."""
        with self.narrator.stage(name) as progress, self.folder.stage(name):
            yield progress

    def rng(self, stream: int) -> np.random.Generator:
        """The generator of one stream of randomness."""
        return np.random.default_rng([self.seed, stream])


def plan(
    scene: Scene,
    *,
    scene_path: Path | None,
    out: Path | None,
    argv: Sequence[str],
    use_cache: bool,
    narrator: Narrator,
) -> PlanOutcome:
    """Plan and write the run folder.

    Args:
        scene: the checked scene, the command line's options in it.
        scene_path: where it came from; None for the built-in scene.
        out: the run folder to make; None makes one below sim_runs/.
        argv: for the manifest.
        use_cache: whether matrices may be taken from and left in the cache.
        narrator: is told what goes on.

    Raises:
        CellError: with one sentence and the exit code; the run folder keeps what was finished, its status and stage.
    """
    groups = [group for group in compile_ahead.GROUPS if group == "tours" or scene.plan.collision == "exact"]
    with compile_ahead.begun(groups) as ahead:
        with narrator.stage("load the part"):
            part = workpiece.load(scene.part.source, scene.part.units)
        for finding in part.findings:
            narrator.note(finding.sentence)
        for sentence in doubts.of_scene(scene):
            narrator.note(sentence)
        settings = resolve(scene, part)
        inputs = plan_files.input_hashes(scene, part)
        folder = RunFolder.create(out, list(argv), scene.plan.seed, inputs, datetime.now(UTC))
        run = Run(folder, narrator, scene.plan.seed, use_cache)
        with folder.kept_on_failure(), _logged(folder.path / "run.log"):
            plan_files.write_scene(folder, scene_path)
            summary, exit_code = _steps(run, scene, part, settings, ahead)
        return PlanOutcome(folder.finish(exit_code), exit_code, summary)


def _steps(run: Run, scene: Scene, part: Workpiece, settings: Settings, ahead: Ahead) -> tuple[dict[str, Any], int]:
    """Steps 2 to 9 and the report; returns the summary and the exit code."""
    reference = part.reference
    scanner = scanners.make(scene.scanner.type, settings.scanner)
    settings = replace(settings, scanner=scanners.settled(settings.scanner, scanner))

    with run.step("decimate and sample"):
        planning = decimate(reference, settings.faces)
        _note_other_count(run.narrator, len(planning.faces), settings.faces)
        candidates = first(scene, settings, part, planning)
        features = surface_features(scene, reference, planning, run.rng(_FEATURES))
        if doubt := doubts.planning_mesh(doubts.off_mesh(features, planning), len(planning.faces)):
            run.narrator.note(doubt)
        plan_files.write_meshes(run.folder, reference, planning)
        plan_files.write_viewpoints(run.folder, scanners.swept(scanner, candidates))

    with run.step("compile the cell") as progress:
        world = compile_world(
            scene, reference.vertices, part_faces=reference.faces, use_cache=run.use_cache,
            baseline_mm=scanners.baseline_mm(settings.scanner, scanner), progress=progress,
        )  # fmt: skip
        checker = MujocoCollisionChecker(world)
        kinematics = Kr16Kinematics.from_model(world.model)
        described = scanners.described(scene.scanner.type, scanner)
        plan_files.write_cell(run.folder, scene, settings, part, len(planning.faces), world, described)
        for sentence in doubts.of_scanner(scene, scanner):
            run.narrator.note(sentence)

    with run.step("reach") as progress:

        def reach_of(views: Viewpoints, progress: Progress | None = None) -> Reach:
            poses = scanners.swept(scanner, views)
            return reach.solve(
                poses, world.T_base_object, world.T_flange_scanner, kinematics, checker, progress=progress
            )

        reached = reach_of(candidates, progress)
        plan_files.write_reach(run.folder, reached)
        if scene.plan.candidates != "targeted":  # those come in rounds, see below
            check_named(scene.plan, reached)
        if not reached.reachable.any():
            raise UnreachableError(_nothing_reachable(reached, part))

    with run.step("measurability") as progress:
        casters = [EmbreeRayCaster(reference.vertices, reference.faces)]
        casters.append(caster_of(occluder_triangles(world)))

        def measure(views: Viewpoints) -> tuple[Measurability, Scanner]:
            views = scanners.swept(scanner, views)
            M = part_matrix(
                scene, settings, reference, planning, features, views, casters[0],
                narrator=run.narrator, use_cache=run.use_cache, progress=progress,
            )  # fmt: skip
            M = occlude(M, views, scanner, casters[1], ray_caster=casters[0], progress=progress)
            most = scene.plan.max_sigma_mm
            if most is None:
                return M, scanner
            return limit_sigma(M, views, scanner, most, casters, may_be_empty=scene.plan.candidates == "targeted")

        M, judge = measure(candidates)
        if scene.plan.candidates == "targeted":
            candidates, reached, M = grow(
                candidates, reached, M, standoff=settings.standoffs[0], scanner=judge, casters=casters,
                reach_of=reach_of, measure=lambda views: measure(views)[0], progress=progress,
            ).all()  # fmt: skip
            plan_files.write_viewpoints(run.folder, scanners.swept(scanner, candidates))
            plan_files.write_reach(run.folder, reached)
        check_named(scene.plan, reached)
        candidates = scanners.swept(scanner, candidates)
        plan_files.write_measurability(run.folder, M)
        samples = held_out(reference, planning, run.seed)
        prediction = Prediction.of(samples, judge, casters, candidates.T_object_scanner[reached.reachable], progress)

    layer = None
    if not promise.pose_error(scene.plan).none:
        with run.step("pose errors") as progress:
            layer = promise.layer(
                scene.plan, M, candidates, reached, judge, casters, run.rng(_ENSEMBLE), progress=progress
            )

    ahead.wait(run.narrator)
    with run.step("select, order and connect") as progress:
        limits = scaled(world.limits, scene.robot.speed_scaling, scene.robot.acceleration_scaling)
        costs = seconds_of_views(scene.plan, reached, limits) if scene.plan.cost == "time" else None
        request = Request(scene.plan, costs, layer)
        problem = Problem(request, candidates, reached, M, prediction, world, limits, kinematics, checker)
        chosen = choose_and_connect(
            problem, selection_rng=run.rng(_SELECTION), motion_rng=run.rng(_MOTION), progress=progress
        )

    with run.step("measure the clearance") as progress:
        tour = chosen.tour
        measured = clearance.of_motion(checker, tour.via, tour.segment, len(tour.between), progress)
        require_no_contact(measured)
        chosen = replace(chosen, tour=replace(tour, clearance=measured.distance, between=measured.between))
        tour = chosen.tour
        motion = retime(tour.via, tour.segment, chosen.via_candidate, limits, pose=tour.pose, lines=chosen.lines)
        plan_files.write_motion(run.folder, motion, chosen.tour, measured)

    answers = further(run, scene, request, reached, prediction, chosen)

    with run.step("report"):
        visible = chosen.visible
        summary = plan_summary(
            scene,
            settings,
            part,
            planning,
            candidates,
            reached,
            M,
            chosen,
            motion,
            visible.fraction,
            prediction.coverable_with(visible),
        )
        summary |= answers
        summary["clearance"] = clearance_summary(measured, motion, world.collision)
        plan_files.write_plan(run.folder, summary, chosen, candidates)
        plan_files.write_report(run.folder, summary)
        draw(run.folder, scene, part, planning, candidates, reached, prediction, chosen, motion, world)
    return summary, 3 if _below(run.narrator, summary) else 0


def further(
    run: Run, scene: Scene, request: Request, reached: Reach, prediction: Prediction, chosen: ConnectedPlan
) -> dict[str, Any]:
    """What the summary says beyond a plain plan: overlaps in visiting order, the promise simulated, the curve."""
    selected = chosen.selected
    if selected.note:
        run.narrator.note(selected.note)
    answers = requests.summary(selected, chosen.tour.order, chosen.cover.total_area)
    if request.layer is not None:
        with run.step("simulate executions") as progress:
            kept = promise.simulate(scene.plan, chosen.T_object_poses, prediction, run.rng(_EXECUTIONS), progress)
        answers["promise"] |= asdict(kept)
    if scene.plan.curve:
        with run.step("coverage over views"):
            curve = curves.curve_of(request, selected, chosen.matrix, reached, run.rng(_CURVE))
            curves.write(run.folder, curve, len(chosen.cover.views), chosen.cover.covered_area)
        answers["curve"] = curves.summary(curve)
    return answers


def _below(narrator: Narrator, summary: Mapping[str, Any]) -> bool:
    """Whether the plan stays below a coverage that was asked for; says which, and what would help.

    A coverage of 1 asks for every coverable sample of the matrix, which a plan always covers.
    """
    coverage, settings = summary["coverage"], summary["settings"]
    share, asked = coverage["visible_of_coverable"], settings["coverage"]
    missed: bool = asked < 1 and share < asked
    if missed:
        narrator.note(
            f"the plan measures {100 * share:.2f} % of what can be measured, less than the {100 * asked:g} % asked "
            "for, although it covers every sample of the matrix; more --samples or --faces bring it closer"
        )
    if coverage["visible"] < settings["required_visible"]:
        narrator.note(
            f"the plan measures {100 * coverage['visible']:.2f} % of the surface, less than the "
            f"{100 * settings['required_visible']:g} % required; move the part, or allow more standoffs and rolls"
        )
        return True
    return missed


def _note_other_count(narrator: Narrator, came_out: int, wanted: int) -> None:
    """Say when the planning mesh is not as coarse as asked for; the plan uses what came out."""
    if abs(came_out - wanted) > max(2, 0.02 * wanted):
        narrator.note(
            f"the planning mesh has {came_out} faces in place of {wanted}: this mesh does not come closer (slivers, "
            "several bodies, or fewer faces than asked for); the plan uses these"
        )


def _nothing_reachable(reached: Reach, part: Workpiece) -> str:
    counts = ", ".join(f"{count} {verdict.sentence}" for verdict, count in reached.counts().items() if count)
    worst = next(iter(reached.blockers()), "")
    return (
        f"none of the {len(reached)} candidate viewpoints is reachable: {counts}"
        + (f" (most often {worst})" if worst else "")
        + "; move the part (--place), change the standoff or allow more --roll values"
        + (", or turn its faces round if they face inwards" if any(f.kind in _ONE_SIDED for f in part.findings) else "")
    )


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
