"""`cell scan`, steps 10 and 11: execute the plan of a run folder, scan, merge, make the surface, measure, report.

`_results` shows what is made of the scans on one screen. It reads them from disk, so a report that is made later, or of
an execution that was stopped, is made by the same lines.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, urlsplit

import numpy as np

from cell import cloud_files, execute, execution_report, run_reader, scan_scene
from cell.deviation import deviation
from cell.errors import CellError, DriverFailureError, FileError, UsageError
from cell.execution_folder import ExecutionFolder
from cell.execution_reader import read_execution
from cell.execution_results import ExecutedScan, achieved, merged, usable
from cell.execution_summary import execution_summary
from cell.narrator import Narrator, ProgressCallback
from cell.nearest import NearestSurface
from cell.pose_error import Disturbance
from cell.reconstruct import reconstruct
from cell.run_record import RunRecord, open_run
from cell.scan_scene import ScanScene
from drivers.clock import Clock, RealTimeClock, SimulatedClock
from drivers.contract import Driver
from drivers.errors import DriverError
from drivers.limits import Limits
from drivers.registry import Context, open_driver
from drivers.setpoints import from_rad, to_deg
from planner.errors import PlannerError
from planner.timing import Motion

_DEVIATION = 12
"""Stream of randomness of the samples that the deviation is measured on."""


@dataclass(frozen=True, slots=True)
class ScanOptions:
    """What `cell scan` was asked for.

    Attributes:
        driver: URL of the controller.
        realtime: let the simulated controller take as long as an arm would.
        view: the one view to scan, from 1 in visiting order; None scans all.
        resolution_deg: in place of the plan's.
        range_noise_mm: one sigma along the ray.
        pose_error_mm: one sigma of the executed position, along each axis.
        pose_error_deg: one sigma of the executed rotation, about each axis.
        register: correct poses by registration; None does it where there is a pose error.
        close_holes: close the holes of the surface, marked.
        seed: of noise and pose error; None takes the plan's.
    """

    driver: str = "sim://"
    realtime: bool = False
    view: int | None = None
    resolution_deg: float | None = None
    range_noise_mm: float = 0.0
    pose_error_mm: float = 0.0
    pose_error_deg: float = 0.0
    register: bool | None = None
    close_holes: bool = False
    seed: int | None = None

    def __post_init__(self) -> None:
        for name, value in (
            ("--range-noise", self.range_noise_mm),
            ("--pose-error", self.pose_error_mm),
            ("--pose-error", self.pose_error_deg),
        ):
            if not 0 <= value < np.inf:
                raise UsageError(f"{name} {value:g} must be 0 or more")
        if self.resolution_deg is not None and not 0 < self.resolution_deg < np.inf:
            raise UsageError(f"--resolution {self.resolution_deg:g} must be above 0, in degrees")
        if self.seed is not None and self.seed < 0:
            raise UsageError(f"--seed {self.seed} must be 0 or more")

    @property
    def disturbance(self) -> Disturbance:
        """Noise and pose error in SI units."""
        return Disturbance(
            self.range_noise_mm / 1000, self.pose_error_mm / 1000, float(np.radians(self.pose_error_deg))
        )


@dataclass(frozen=True, slots=True, eq=False)
class ScanOutcome:
    """What `cell scan` leaves.

    Attributes:
        folder: of the execution.
        exit_code: 0, or 3 where a whole execution stays below the coverage that the plan requires.
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


def scan(run_folder: Path, options: ScanOptions, *, argv: Sequence[str], narrator: Narrator) -> ScanOutcome:
    """Execute the plan of a run folder and report.

    Args:
        run_folder: of a finished plan.
        options: what was asked for.
        argv: for the manifest.
        narrator: is told what goes on.

    Raises:
        CellError: with one sentence and the exit code; the execution's folder keeps the scans, its status and stage.
    """
    run = _finished(run_folder)
    motion = run_reader.motion(run)
    legs = execute.legs_of(motion, options.view)
    scene = scan_scene.load(run, options.resolution_deg)
    seed = options.seed if options.seed is not None else int(run.manifest["seed"])
    kept = _options_kept(replace(options, register=_registered(options)), scene)
    driver, clock = _driver(options, motion, scene)
    folder = ExecutionFolder.make(run, list(argv), seed, kept, datetime.now(UTC))
    work = _Work(run, folder, narrator)
    with _kept_on_failure(folder):
        if options.view is not None:
            _write_motion(folder, legs.motion(motion))
        with work.step("execute and scan") as progress, driver:
            folder.note(controller=driver.capabilities.controller)
            seconds = execute.run(
                legs, driver, scene, options.disturbance, folder, seed=seed, clock=clock, progress=progress
            )
            folder.note(moving_s=round(seconds, 6), simulated_time=driver.capabilities.simulated_time)
        summary = _results(work, scene, motion)
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
    if ended != "finished":
        narrator.note(
            f"execution {recorded.folder.name} did not finish (its status is '{ended}'); what is there is used"
        )
    folder = ExecutionFolder.reopen(recorded.folder, recorded.manifest)
    options = folder.manifest.get("options", {})
    scene = scan_scene.load(run, options.get("resolution_deg"))
    # The status tells how the execution ended, not how its report did.
    status, exit_code = ("incomplete" if ended == "running" else ended), folder.manifest.get("exit_code", 0)
    summary = _results(_Work(run, folder, narrator), scene, run_reader.motion(run))
    for sentence in summary["left_out"]:
        narrator.note(sentence)
    code = _exit_code(summary, scene)
    return ScanOutcome(folder.finish(code if ended == "finished" else exit_code, status), code, summary)


def _results(work: _Work, scene: ScanScene, motion: Motion) -> dict[str, Any]:
    """Merge, reconstruct, measure and report what the execution has on disk; returns the summary."""
    run, folder = work.run, work.folder
    seed, options = int(folder.manifest.get("seed", run.manifest["seed"])), folder.manifest.get("options", {})

    with work.step("merge"):
        scans, left_out = usable(read_execution(run, folder.path.name))
        _adopt(folder, scans)
        nearest = NearestSurface(scene.reference)
        cloud = merged(scans, nearest, registered=bool(options.get("register")))
        folder.write_bytes("cloud.ply", cloud_files.cloud_ply(cloud.cloud, cloud.stop))

    with work.step("reconstruct"):
        model = reconstruct(cloud.cloud, close=bool(options.get("close_holes")))
        if model.mesh is None:
            folder.remove("mesh.ply")
        else:
            folder.write_bytes("mesh.ply", cloud_files.mesh_ply(model.mesh, model.closed))

    with work.step("measure"):
        plan, views = run_reader.plan_json(run), run_reader.views(run)
        reached = achieved(scans, views, plan["coverage"]["visible"], cloud.cloud, scene, int(run.manifest["seed"]))
        off = None
        if model.mesh is not None:
            off = deviation(model.mesh, nearest, np.random.default_rng([seed, _DEVIATION]))

    with work.step("report"):
        legs = execute.legs_of(motion, options.get("view"))
        simulated = bool(folder.manifest.get("simulated_time"))
        summary = execution_summary(
            scene, options, seed, plan, scans, [leg.stop for leg in legs.legs if leg.stop], left_out, cloud, reached,
            model, off, legs.planned_seconds, folder.manifest.get("moving_s") if simulated else None,
        )  # fmt: skip
        folder.write_json("report.json", summary)
        folder.write_text("report.md", execution_report.markdown(summary))
        _draw(folder, scene, plan, scans, reached)
        if model.mesh is None or off is None:
            folder.remove("deviation.png")
        else:
            from cell import deviation_picture

            deviation_picture.draw(folder.path / "deviation.png", model.mesh, off)
            folder.adopt("deviation.png")
    return summary


def _draw(folder: ExecutionFolder, scene: ScanScene, plan: Any, scans: Sequence[ExecutedScan], reached: Any) -> None:
    """Part and views, and the cover curve; nothing to draw without a scan."""
    if not scans:
        folder.remove("views.png")
        folder.remove("cover.png")
        return
    from cell import pictures

    h, v = (float(angle) for angle in np.radians(scene.scanner_parameters["fov_deg"]))
    poses = np.stack([scan.T_true for scan in scans])
    pictures.part_and_views(folder.path / "views.png", scene.planning, reached.views_per_face, poses, (h, v))
    coverable = float(plan["coverage"]["coverable"])
    pictures.cover_curve(folder.path / "cover.png", reached.largest_first, coverable, 1.0, int(plan["lower_bound"]))
    folder.adopt("views.png")
    folder.adopt("cover.png")


def _finished(run_folder: Path) -> RunRecord:
    run = open_run(run_folder)
    if not run.finished:
        raise FileError(f"{run_folder} has no finished plan: the run {run.ended}; plan again")
    return run


def _registered(options: ScanOptions) -> bool:
    return options.disturbance.moves_pose if options.register is None else options.register


def _options_kept(options: ScanOptions, scene: ScanScene) -> dict[str, Any]:
    """For the manifest: all that a report made later needs, settled."""
    return {
        "driver": options.driver,
        "realtime": options.realtime,
        "view": options.view,
        "resolution_deg": options.resolution_deg,
        "range_noise_mm": options.range_noise_mm,
        "pose_error_mm": options.pose_error_mm,
        "pose_error_deg": options.pose_error_deg,
        "register": bool(options.register),
        "close_holes": options.close_holes,
        "scanner": dict(scene.scanner_parameters),
    }


def _driver(options: ScanOptions, motion: Motion, scene: ScanScene) -> tuple[Driver, Clock]:
    """The driver, not yet connected, and the clock that tells its time.

    The simulated controller gets the limits and accelerations of the plan, stands at its beginning, and jumps in time
    unless real time was asked for.
    """
    try:
        parts = urlsplit(options.driver)
        query = dict(parse_qsl(parts.query, keep_blank_values=True))
    except ValueError as error:
        raise DriverFailureError(f"driver URL '{options.driver}' cannot be read: {error}") from error
    url, simulated = options.driver, parts.scheme == "sim"
    if options.realtime and not simulated:
        raise UsageError(f"--realtime is for sim://; {options.driver} takes the time that it takes")
    own_clock = "realtime" in query or not simulated
    clock: Clock = RealTimeClock() if own_clock or options.realtime else SimulatedClock()
    if simulated and "start" not in query and "://" in url:
        start = ",".join(f"{angle:.4f}" for angle in to_deg(from_rad(motion.via_q[0])))
        url += ("&" if "?" in url else "?") + f"start={start}"
    lim = motion.limits
    limits = Limits.from_rad(lim.lower, lim.upper, lim.velocity / scene.speed, lim.acceleration)
    try:
        return open_driver(url, Context(clock=None if own_clock else clock, limits=limits)), clock
    except DriverError as error:
        raise DriverFailureError(str(error)) from error


def _write_motion(folder: ExecutionFolder, motion: Motion) -> None:
    """`motion.npz`: what is driven where that is not the plan's motion, so that it can be replayed."""
    folder.write_arrays(
        "motion.npz",
        **{
            name: getattr(motion, name)
            for name in ("via_q", "segment", "view", "via_t", "t", "q", "qd", "qdd", "segment_of_sample")
        },
        **{f"limit_{name}": getattr(motion.limits, name) for name in ("lower", "upper", "velocity", "acceleration")},
    )


def _adopt(folder: ExecutionFolder, scans: Sequence[ExecutedScan]) -> None:
    """Scans of a killed execution get their sha256 in the manifest, as those of a finished one have."""
    for scan in scans:
        folder.adopt(f"scans/{scan.stop:04d}.npz")


def _exit_code(summary: dict[str, Any], scene: ScanScene) -> int:
    whole = summary["settings"]["view"] is None
    return 3 if whole and summary["coverage"]["visible"] < scene.required_visible else 0


@contextmanager
def _kept_on_failure(folder: ExecutionFolder) -> Iterator[None]:
    """An execution that ends early keeps its scans, with status, stage and reason; a driver's error gets its code."""
    try:
        yield
    except KeyboardInterrupt:
        folder.fail("interrupted", 130, "stopped by Ctrl-C")
        raise
    except DriverError as error:
        folder.fail("failed", DriverFailureError.exit_code, str(error))
        raise DriverFailureError(str(error)) from error
    except CellError as error:
        folder.fail("failed", error.exit_code, str(error))
        raise
    except PlannerError as error:
        folder.fail("failed", CellError.exit_code, str(error))
        raise
    except BaseException as error:
        folder.fail("failed", CellError.exit_code, f"{type(error).__name__}: {error}")
        raise
