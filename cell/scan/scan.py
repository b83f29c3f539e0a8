"""`cell scan`, steps 10 and 11: execute the plan of a run folder, scan, merge, make the surface, measure, report.

`_results` shows what is made of the scans on one screen. It reads them from disk, so a report that is made later, or of
an execution that was stopped, is made by the same lines.
"""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, fields, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from cell.commands.narrator import Narrator, ProgressCallback
from cell.errors import DriverFailureError, FileError, UsageError
from cell.plant import factory
from cell.reconstruction import cloud_files
from cell.reconstruction.deviation import deviation
from cell.reconstruction.nearest import NearestSurface
from cell.reconstruction.reconstruct import reconstruct
from cell.run import process
from cell.run import reader as run_reader
from cell.run.record import RunRecord, open_run, understood
from cell.scan import driver as scan_driver
from cell.scan import execute, execution_report, safety
from cell.scan import scene as scan_scene
from cell.scan.execute import Legs
from cell.scan.execution_folder import EXECUTING, ExecutionFolder
from cell.scan.execution_reader import RecordedExecution, read_execution
from cell.scan.execution_results import ExecutedScan, achieved, merged, scan_name, usable
from cell.scan.execution_summary import execution_summary
from cell.scan.options import ScanOptions
from cell.scan.resume import Rest, rest_of
from cell.scan.scene import ScanScene
from drivers.clock import Clock
from drivers.contract import Driver
from drivers.errors import DriverError
from planner.timing import Motion

_DEVIATION = 12
"""Stream of randomness of the samples that the deviation is measured on."""


@dataclass(frozen=True, slots=True, eq=False)
class ScanOutcome:
    """What `cell scan` leaves.

    Attributes:
        folder: of the execution.
        exit_code: 0; 3 where a whole execution stays below the coverage that the plan requires; 6 where a report was
            made of an execution that lacks views.
        summary: content of report.json.
    """

    folder: Path
    exit_code: int
    summary: dict[str, Any]


@dataclass(frozen=True, slots=True)
class _Work:
    """What is worked on, and who is told."""

    run: RunRecord
    folder: ExecutionFolder
    narrator: Narrator

    @contextmanager
    def step(self, name: str) -> Iterator[ProgressCallback]:
        """Name the step to the person and to the manifest."""
        with self.narrator.stage(name) as progress, self.folder.stage(name):
            yield progress


def scan(
    run_folder: Path,
    options: ScanOptions,
    *,
    argv: Sequence[str],
    narrator: Narrator,
    ask: safety.Ask | None = None,
) -> ScanOutcome:
    """Execute the plan of a run folder and report.

    Args:
        run_folder: of a finished plan.
        options: what was asked for.
        argv: for the manifest.
        narrator: is told what goes on.
        ask: puts a question to a person; None where nobody is there.

    Raises:
        CellError: with one sentence and the exit code; the execution's folder keeps the scans, its status and stage.
    """
    run = _finished(run_folder)
    motion = run_reader.motion(run)
    if any("sweep" in view for view in run_reader.plan_json(run)["views"]) and not (motion.pose > 0).any():
        raise UsageError(
            f"the views of {run_folder} are sweeps, and its motion holds only their first poses, as earlier versions "
            "planned them; plan again"
        )
    legs = execute.legs_of(motion, options.view)
    scene = scan_scene.load(run, options.resolution_deg)
    seed = options.seed if options.seed is not None else int(run.manifest["seed"])
    driver, clock = scan_driver.prepare(options, motion, scene.speed, factory.of_run(run))
    kept = options.kept() | {"scanner": dict(scene.scanner_parameters)}
    with ExitStack() as connected:
        with _drivers_errors_as_ours():  # what the controller refuses leaves no execution behind
            connected.enter_context(driver)
            speed = _allowed_speed(driver, options, scene, ask)
            safety.ready(driver, reset=options.reset, stop_first=False)
            execute.require_drivable(legs, driver, speed)
        folder = ExecutionFolder.make(run, list(argv), seed, kept, datetime.now(UTC))
        if options.view is not None:
            _write_motion(folder, legs.motion(motion))
        return _executed(connected, _Work(run, folder, narrator), legs, driver, clock, scene, motion, options, speed)


def resume(
    run_folder: Path,
    execution: str,
    options: ScanOptions | None,
    *,
    argv: Sequence[str],
    narrator: Narrator,
    ask: safety.Ask | None = None,
) -> ScanOutcome:
    """Go on with an execution that was stopped, at the first view that is not confirmed.

    Args:
        run_folder: of a finished plan.
        execution: its id, or "latest".
        options: driver (empty: that of the beginning), confirmation, speed and reset of this time; everything else is
            as the execution was begun with.
        argv: for the manifest.
        narrator: is told what goes on.
        ask: puts a question to a person; None where nobody is there.

    Raises:
        CellError: with one sentence and the exit code; the execution keeps what it has.
    """
    run = _finished(run_folder)
    recorded = read_execution(run, execution)
    begun = resumable(run, recorded)
    now = options or ScanOptions(driver="")
    settled = replace(
        begun, driver=now.driver or begun.driver, realtime=now.realtime, confirm_motion=now.confirm_motion,
        speed_percent=now.speed_percent, reset=now.reset,
    )  # fmt: skip
    motion = run_reader.motion(run)
    scene = scan_scene.load(run, begun.resolution_deg)
    seed = int(recorded.manifest["seed"])
    scans, left_out = usable(recorded, run_reader.views(run))
    for sentence in left_out:
        narrator.note(f"{sentence}; that view is scanned again")
    driver, clock = scan_driver.prepare(settled, motion, scene.speed, factory.of_run(run))
    with ExitStack() as connected:
        with _drivers_errors_as_ours():
            connected.enter_context(driver)
            if ask is None:  # nobody will agree later: leave the arm alone
                _allowed_speed(driver, settled, scene, ask)
            state = safety.ready(driver, reset=settled.reset, stop_first=True)
            done = {scan.stop for scan in scans}
            rest = rest_of(execute.legs_of(motion, begun.view), done, state, run, motion, seed)
            for sentence in _told(rest, len(done)):
                narrator.note(sentence)
            speed = _allowed_speed(driver, settled, scene, ask)  # whoever agrees has read which way the arm goes
            execute.require_drivable(rest.legs, driver, speed)
        folder = ExecutionFolder.reopen(recorded.folder, recorded.manifest)
        folder.resume(list(argv), settled.driver)
        return _executed(
            connected, _Work(run, folder, narrator), rest.legs, driver, clock, scene, motion, settled, speed
        )


def resumable(run: RunRecord, recorded: RecordedExecution) -> ScanOptions:
    """The options that an execution was begun with, if it can be gone on with.

    Raises:
        FileError: if it runs, or its manifest is damaged, or it is of another plan.
        UsageError: if it is finished.
    """
    name, manifest = recorded.folder.name, recorded.manifest
    if manifest.get("status") == "finished":
        raise UsageError(f"execution {name} is finished; there is nothing to resume")
    if process.lives(manifest):
        raise FileError(f"execution {name} is still running (process {manifest['pid']}); stop it with Ctrl-C first")
    if manifest.get("plan") != run.manifest.get("artefacts", {}).get("plan.json", ""):
        raise FileError(f"execution {name} is not of the plan that is in {run.folder} now; scan anew")
    with understood(recorded.folder / "manifest.json"):
        options, _ = dict(manifest["options"]), int(manifest["seed"])
        known = {field.name for field in fields(ScanOptions)}
        return ScanOptions(**{key: value for key, value in options.items() if key in known})


def _told(rest: Rest, done: int) -> Iterator[str]:
    """What a resumed execution is going to do."""
    yield f"{done} views are scanned already; {len(rest.stops)} are left"
    if rest.way is not None:
        goal = f"view {rest.stops[0]}" if rest.stops else "home"
        yield (
            f"the arm does not stand where the plan goes on; a new way to {goal} was planned: {len(rest.way.via) - 1} "  # type: ignore[arg-type]
            f"moves, nearest {1000 * rest.way.clearance:.1f} mm ({rest.way.between})"
        )


def _allowed_speed(driver: Driver, options: ScanOptions, scene: ScanScene, ask: safety.Ask | None) -> float:
    """The speed to drive at, once a person has agreed to it where steel moves."""
    speed = safety.speed_fraction(options.speed_percent, scene.speed, hardware=driver.capabilities.hardware)
    safety.require_confirmed(driver, speed, confirmed=options.confirm_motion, ask=ask)
    return speed


def _executed(
    connected: ExitStack,
    work: _Work,
    legs: Legs,
    driver: Driver,
    clock: Clock,
    scene: ScanScene,
    motion: Motion,
    options: ScanOptions,
    speed: float,
) -> ScanOutcome:
    """Drive and scan the legs, then report what the execution has."""
    folder = work.folder
    connected.enter_context(folder.kept_on_failure())
    connected.enter_context(_drivers_errors_as_ours())
    with work.step(EXECUTING) as progress, driver:
        folder.note(controller=driver.capabilities.controller, speed_fraction=round(speed, 6))
        seconds = execute.run(
            legs, driver, scene, options.disturbance, folder, seed=int(folder.manifest["seed"]), speed=speed,
            clock=clock, progress=progress,
        )  # fmt: skip
        folder.note(moving_s=round(seconds, 6), simulated_time=driver.capabilities.simulated_time)
    summary = _results(work, scene, motion, read_execution(work.run, folder.path.name))
    code = _exit_code(summary, scene)
    return ScanOutcome(folder.finish(code), code, summary)


def report(run_folder: Path, execution: str, narrator: Narrator) -> ScanOutcome:
    """Make the report of an execution anew from what is there; what is missing is said.

    Args:
        run_folder: of a finished plan.
        execution: its id, or "latest".
        narrator: is told what goes on.

    Raises:
        CellError: with one sentence and the exit code.
    """
    run = _finished(run_folder)
    recorded = read_execution(run, execution)
    ended = str(recorded.manifest.get("status", "running"))
    if ended == "running" and process.lives(recorded.manifest):
        raise FileError(
            f"execution {recorded.folder.name} is still running (process {recorded.manifest['pid']}); wait until it "
            "ends, or stop it with Ctrl-C"
        )
    if ended != "finished":
        narrator.note(
            f"execution {recorded.folder.name} did not finish (its status is '{ended}'); what is there is used"
        )
    folder = ExecutionFolder.reopen(recorded.folder, recorded.manifest)
    options = folder.manifest.get("options", {})
    scene = scan_scene.load(run, options.get("resolution_deg"))
    # The status tells how the execution ended, not how its report did.
    status, exit_code = ("incomplete" if ended == "running" else ended), folder.manifest.get("exit_code")
    summary = _results(_Work(run, folder, narrator), scene, run_reader.motion(run), recorded)
    for sentence in summary["left_out"]:
        narrator.note(sentence)
    if summary["missing_views"]:
        here = summary["n_views"]
        narrator.note(
            f"the execution is incomplete: {here} of {here + len(summary['missing_views'])} views are there; "
            "the report says what is there"
        )
        return ScanOutcome(folder.finish(exit_code, status), FileError.exit_code, summary)
    code = _exit_code(summary, scene)
    return ScanOutcome(folder.finish(code if ended == "finished" else exit_code, status), code, summary)


def _results(work: _Work, scene: ScanScene, motion: Motion, recorded: RecordedExecution) -> dict[str, Any]:
    """Merge, reconstruct, measure and report what the execution has on disk; returns the summary."""
    run, folder = work.run, work.folder
    seed, options = int(folder.manifest.get("seed", run.manifest["seed"])), folder.manifest.get("options", {})

    with work.step("merge"):
        views = run_reader.views(run)
        scans, left_out = usable(recorded, views)
        _adopt(folder, scans)
        nearest = NearestSurface(scene.reference)
        cloud = merged(scans, nearest, registered=bool(options.get("register")))
        folder.write_bytes("cloud.ply", cloud_files.cloud_ply(cloud.cloud, cloud.stop))

    with work.step("reconstruct"):
        model = reconstruct(cloud.cloud, close=bool(options.get("close_holes")))
        for doubt in model.doubts:
            work.narrator.note(doubt)
        if model.mesh is None:
            folder.remove("mesh.ply")
        else:
            folder.write_bytes("mesh.ply", cloud_files.mesh_ply(model.mesh, model.closed))

    with work.step("measure"):
        plan = run_reader.plan_json(run)
        reached = achieved(scans, views, plan["coverage"]["visible"], cloud.cloud, scene, int(run.manifest["seed"]))
        off = None
        if model.mesh is not None:
            off = deviation(model.mesh, nearest, np.random.default_rng([seed, _DEVIATION]), closed=model.closed)

    with work.step("report"):
        legs = execute.legs_of(motion, options.get("view"))
        # Of a resumed execution only the time of the last part is known.
        timed = bool(folder.manifest.get("simulated_time")) and not folder.manifest.get("resumed")
        summary = execution_summary(
            scene, options, seed, plan, scans, [leg.stop for leg in legs.legs if leg.stop], left_out, cloud, reached,
            model, off, legs.planned_seconds, folder.manifest.get("moving_s") if timed else None,
        )  # fmt: skip
        folder.write_json("report.json", summary)
        folder.write_text("report.md", execution_report.markdown(summary))
        _draw(folder, scene, plan, scans, reached)
        if model.mesh is None or off is None:
            folder.remove("deviation.png")
        else:
            from cell.reconstruction import deviation_picture

            deviation_picture.draw(folder.path / "deviation.png", model.mesh, off)
            folder.adopt("deviation.png")
    return summary


def _draw(folder: ExecutionFolder, scene: ScanScene, plan: Any, scans: Sequence[ExecutedScan], reached: Any) -> None:
    """Part and views, and the cover curve; nothing to draw without a scan."""
    if not scans:
        folder.remove("views.png")
        folder.remove("cover.png")
        return
    from cell.plan import pictures
    from cell.scanners import drawn_opening_deg

    h, v = (float(angle) for angle in np.radians(drawn_opening_deg(scene.scanner_parameters)))
    poses = np.stack([scan.T_true for scan in scans])
    pictures.part_and_views(
        folder.path / "views.png", scene.planning, reached.views_per_face, poses, (h, v), [scan.stop for scan in scans]
    )  # fmt: skip
    coverable = float(plan["coverage"]["coverable"])
    pictures.cover_curve(folder.path / "cover.png", reached.largest_first, coverable, 1.0, int(plan["lower_bound"]))
    folder.adopt("views.png")
    folder.adopt("cover.png")


def _finished(run_folder: Path) -> RunRecord:
    run = open_run(run_folder)
    if not run.finished:
        raise FileError(f"{run_folder} has no finished plan: the run {run.ended}; plan again")
    return run


_LIMITS = ("lower", "upper", "velocity", "acceleration", "jerk")


def _write_motion(folder: ExecutionFolder, motion: Motion) -> None:
    """`motion.npz`: what is driven where that is not the plan's motion, so that it can be replayed."""
    folder.write_arrays(
        "motion.npz",
        **{
            name: getattr(motion, name)
            for name in ("via_q", "segment", "view", "via_t", "t", "q", "qd", "qdd", "segment_of_sample")
        },
        pose=motion.pose,
        line=motion.line,
        **{f"limit_{name}": getattr(motion.limits, name) for name in _LIMITS},
    )


def _adopt(folder: ExecutionFolder, scans: Sequence[ExecutedScan]) -> None:
    """Scans of a killed execution get their sha256 in the manifest, as those of a finished one have."""
    for scan in scans:
        folder.adopt(f"scans/{scan_name(scan.stop)}")


def _exit_code(summary: dict[str, Any], scene: ScanScene) -> int:
    whole = summary["settings"]["view"] is None
    return 3 if whole and summary["coverage"]["visible"] < scene.required_visible else 0


@contextmanager
def _drivers_errors_as_ours() -> Iterator[None]:
    """A driver's error ends the command with its code."""
    try:
        yield
    except DriverError as error:
        raise DriverFailureError(str(error)) from error
