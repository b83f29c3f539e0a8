"""`cell scan`, step 10: execute the plan of a run folder, from its beginning or from where it was stopped, and scan.

What is made of the scans stands in `cell.scan.post_processing`.
"""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path
from typing import TypeVar

import numpy as np

from cell import signals
from cell.acquisition import SIMULATED
from cell.errors import FileError, UsageError
from cell.runs import current_scene
from cell.runs import folder as process
from cell.runs.cell import RunCell, read_cell
from cell.runs.run import RecordedExecution, Run, read_execution, read_manifest, reading
from cell.runs.verification import verify_plan
from cell.scan import driver as scan_driver
from cell.scan import execute, lock, plants, resources, safety
from cell.scan.driven import (
    acquisition_of,
    cell_with,
    drive,
    drivers_errors_as_ours,
    part_may_be_near,
    write_motion,
)
from cell.scan.executed_scans import usable
from cell.scan.execution_folder import ExecutionFolder
from cell.scan.legs import legs_of
from cell.scan.options import ScanOptions
from cell.scan.post_processing import ScanOutcome, exit_code_of, results
from cell.scan.resume import Rest, rest_of
from cell.scan.way import Released, of_legs, of_plan
from cell.scan.whole_turns import as_planned
from cell.session import Confirm, Session
from cell.world import clearance
from cell.world.collision import MujocoCollisionChecker
from drivers.contract import Driver
from drivers.setpoints import from_rad, to_deg
from planner.geometry.mesh import TriangleMesh
from planner.timing.motion import Motion

Outcome = TypeVar("Outcome")
Then = Callable[[Session[ExecutionFolder], Run, RunCell, Motion], Outcome]
"""What is made of an execution whose scans are on disk; it also finishes the execution's folder."""

_VIEW, _ANEW = "the way to view {} and back,", "the new way and the rest of the plan"


def scan(session: Session[None], run_folder: Path, options: ScanOptions) -> ScanOutcome:
    """Execute the plan of a run folder and report.

    Args:
        session: of the command.
        run_folder: of a finished plan.
        options: what was asked for.

    Raises:
        CellError: with one sentence and the exit code; the execution's folder keeps the scans, its status and stage.
    """
    return execute_and(session, _reported, run_folder, options)


def execute_and(
    session: Session[None],
    then: Then[Outcome],
    run_folder: Path,
    options: ScanOptions,
    *,
    stands: TriangleMesh | None = None,
) -> Outcome:
    """Execute the plan of a run folder; see `scan`.

    Args:
        session: of the command.
        then: what is made of it.
        run_folder: of a finished plan.
        options: what was asked for.
        stands: the part on which simulated rays fall [m], object frame; None is the plan's.
    """
    proven = verify_plan(run_folder)
    current_scene.require_current_scene(proven, options, session.reporter, wire=scan_driver.on_a_wire(options.driver))
    run, motion = proven.run, proven.motion
    legs = legs_of(motion, options.view)
    released = of_plan(proven) if options.view is None else of_legs(proven, legs, _VIEW.format(options.view))
    cell = cell_with(stands, read_cell(run, options.resolution_deg))
    seed = options.seed if options.seed is not None else run.seed
    driver, clock = scan_driver.prepare(options, motion, cell, plants.plants_of_run(run), session.note)
    kept = options.kept() | {"scanner": cell.scanner_keys.as_json()}
    if doubt := part_may_be_near(options, cell, run.min_clearance[0]):
        session.note(doubt)
    acquisition_of(
        kept, cell, seed, run.folder, session.reporter
    )  # what cannot be asked of it leaves no execution behind
    if options.acquire == SIMULATED:
        resources.require_room(cell, legs, run.folder)
    with ExitStack() as connected:
        connected.enter_context(signals.stop_on_signal())
        with drivers_errors_as_ours():  # what the controller refuses leaves no execution behind
            connected.enter_context(driver)
            speed = _allowed_speed(driver, options, cell, released, session.confirm)
            state = safety.ready(driver, reset=options.reset, stop_first=False, time_scale=options.accept_time_scale)
            driver, _ = as_planned(driver, state, proven.scene, motion.limits, session.reporter)
            execute.require_drivable(legs, driver, speed)
        way = released.digest if released.own else None
        folder = ExecutionFolder.make(run, list(session.origin.argv), seed, kept, datetime.now(UTC), way)
        connected.enter_context(lock.held(folder.path))
        if options.view is not None:
            write_motion(folder, legs.motion(motion))
        opened = session.opened(folder, seed)
        drive(connected, opened, legs, driver, clock, cell, options, speed)
        return then(opened, run, cell, motion)


def resume(session: Session[None], run_folder: Path, execution: str, options: ScanOptions | None) -> ScanOutcome:
    """Go on with an execution that was stopped, at the first view that is not confirmed.

    Args:
        session: of the command.
        run_folder: of a finished plan.
        execution: its id, or "latest".
        options: those of `OF_EACH_TIME` count (a driver only where given); everything else is as the execution was
            begun with.

    Raises:
        CellError: with one sentence and the exit code; the execution keeps what it has.
    """
    return resume_and(session, _reported, run_folder, execution, options)


def resume_and(
    session: Session[None],
    then: Then[Outcome],
    run_folder: Path,
    execution: str,
    options: ScanOptions | None,
    *,
    stands: TriangleMesh | None = None,
) -> Outcome:
    """Go on with an execution, while nobody else does; see `resume` and `execute_and`."""
    with lock.held(lock.folder_of(run_folder, execution)):
        return _resumed(session, then, run_folder, execution, options, stands)


def _resumed(
    session: Session[None],
    then: Then[Outcome],
    run_folder: Path,
    execution: str,
    options: ScanOptions | None,
    stands: TriangleMesh | None,
) -> Outcome:
    proven = verify_plan(run_folder)
    run, motion = proven.run, proven.motion
    recorded = read_execution(run, execution)
    scans, left_out = usable(recorded, proven.plan.views)
    begun = resumable(run, recorded)
    settled = begun.resumed(options or ScanOptions())
    current_scene.require_current_scene(proven, settled, session.reporter, wire=scan_driver.on_a_wire(settled.driver))
    cell = cell_with(stands, read_cell(run, begun.resolution_deg))
    seed = recorded.manifest.require_seed(recorded.folder)
    legs, done = legs_of(motion, begun.view), {scan.stop for scan in scans}
    if recorded.manifest.status == "finished" and done >= {leg.stop for leg in legs.legs if leg.stop}:
        raise UsageError(f"execution {recorded.folder.name} is finished and whole; there is nothing to resume")
    for sentence in left_out:
        session.note(sentence)
    if doubt := part_may_be_near(settled, cell, run.min_clearance[0]):
        session.note(doubt)
    driver, clock = scan_driver.prepare(settled, motion, cell, plants.plants_of_run(run), session.note)
    if settled.acquire == SIMULATED:
        resources.require_room(cell, legs, run.folder)
    with ExitStack() as connected:
        connected.enter_context(signals.stop_on_signal())
        with drivers_errors_as_ours():
            connected.enter_context(driver)
            planned = of_plan(proven) if begun.view is None else of_legs(proven, legs, _VIEW.format(begun.view))
            if (
                session.confirm is None and settled.confirm_motion is None
            ):  # nobody will agree later: leave the arm alone
                _allowed_speed(driver, settled, cell, planned, session.confirm)
            state = safety.ready(driver, reset=settled.reset, stop_first=True, time_scale=settled.accept_time_scale)
            driver, state = as_planned(driver, state, proven.scene, motion.limits, session.reporter)
            rest = rest_of(legs, done, state, proven.checker, motion.limits, seed)
            released = planned if rest.way is None else of_legs(proven, rest.legs, _ANEW)
            for sentence in _told(rest, len(done), proven.checker):
                session.note(sentence)
            # whoever agrees has read which way the arm goes
            speed = _allowed_speed(driver, settled, cell, released, session.confirm)
            execute.require_drivable(rest.legs, driver, speed)
        folder = ExecutionFolder.reopen(recorded.folder, recorded.manifest)
        folder.resume(list(session.origin.argv), settled.driver, **_kept(rest, released))
        opened = session.opened(folder, seed)
        drive(connected, opened, rest.legs, driver, clock, cell, settled, speed)
        return then(opened, run, cell, motion)


def resumable(run: Run, recorded: RecordedExecution) -> ScanOptions:
    """The options that an execution was begun with, if it can be gone on with.

    Raises:
        FileError: if it runs, or its manifest is damaged, or it is of another plan.
    """
    name, manifest = recorded.folder.name, read_manifest(recorded.folder / "manifest.json")
    if process.is_running(manifest):
        raise FileError(f"execution {name} is still running (process {manifest.pid}); stop it with Ctrl-C first")
    if manifest.digest != run.digest:
        raise FileError(f"execution {name} is not of the plan that is in {run.folder} now; scan anew")
    with reading(recorded.folder / "manifest.json"):
        return ScanOptions.begun(manifest.options)


_NAMED = 10  # views named in a sentence


def _kept(rest: Rest, released: Released) -> dict[str, object]:
    """What an execution keeps of a way that was planned to go on."""
    if rest.way is None:
        return {}
    return {"way": released.digest, "way_deg": tuple(tuple(row) for row in to_deg(from_rad(rest.way)).tolist())}


def _told(rest: Rest, done: int, checker: MujocoCollisionChecker) -> Iterator[str]:
    """What a resumed execution is going to do."""
    left = ", ".join(str(stop) for stop in rest.stops[:_NAMED]) + (", ..." if len(rest.stops) > _NAMED else "")
    yield f"{done} views are scanned already; {len(rest.stops)} are left" + (f" ({left})" if left else "")
    if rest.way is not None:
        goal = f"view {rest.stops[0]}" if rest.stops else "home"
        moves = len(rest.way) - 1
        found = clearance.motion_clearance(checker, rest.way, np.zeros(moves + 1, dtype=np.int64), 1)
        yield (
            f"the arm does not stand where the plan goes on; a new way to {goal} was planned: {moves} moves, nearest "
            f"{1000 * found.distance[0]:.1f} mm ({found.between[0] or 'nothing near'})"
        )


def _allowed_speed(
    driver: Driver, options: ScanOptions, cell: RunCell, released: Released, ask: Confirm | None
) -> float:
    """The speed to drive at, once a person has agreed to it where steel moves."""
    speed = safety.speed_fraction(
        options.speed_percent, cell.scene.speed_scaling, hardware=driver.capabilities.hardware
    )
    safety.require_confirmed(driver, speed, released, given=options.confirm_motion, ask=ask)
    return speed


def _reported(session: Session[ExecutionFolder], run: Run, cell: RunCell, motion: Motion) -> ScanOutcome:
    """Report what the execution has."""
    folder = session.folder
    summary = results(session, run, cell, motion, read_execution(run, folder.path.name))
    if summary.missing_views:  # what was to come did not: the same as an execution that was stopped
        return ScanOutcome(folder.finish(FileError.exit_code, "incomplete"), FileError.exit_code, summary)
    code = exit_code_of(summary, cell)
    return ScanOutcome(folder.finish(code), code, summary)
