"""`cell scan`: execute the plan of a run folder from its start or from where it was stopped, and scan.

`cell.scan.results` merges, reconstructs, measures and reports the scans.
"""

from collections.abc import Callable
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path
from typing import TypeVar

import numpy as np

from cell import signals
from cell.errors import FileError, UsageError
from cell.runs import folder as run_folder
from cell.runs.cell import RunCell, read_cell
from cell.runs.current_scene import require_current_scene
from cell.runs.run import RecordedExecution, Run, read_execution, read_manifest, reading
from cell.runs.verification import VerifiedPlan, verify_plan
from cell.scan import as_built, safety
from cell.scan.execution import (
    ExecutionPlan,
    driver_errors,
    execute_plan,
    make_acquisition,
    make_driver,
    plan_execution,
    require_drivable,
    write_motion,
)
from cell.scan.execution_folder import ExecutionFolder
from cell.scan.options import ScanOptions
from cell.scan.plants import plants_of_run
from cell.scan.results import ScanOutcome, exit_code_of, report_execution, usable_scans
from cell.scan.resume import plan_resume
from cell.scan.safety import ApprovedMotion
from cell.scan.states import record_states
from cell.scan.table_turns import remove_whole_turns
from cell.session import Session
from drivers.contract import Driver
from drivers.setpoints import from_rad, to_deg
from planner.geometry.mesh import TriangleMesh

Outcome = TypeVar("Outcome")
Finalise = Callable[[Session[ExecutionFolder], Run, RunCell], Outcome]
"""Process the scans of an execution and finish its folder."""


def scan(session: Session[None], folder: Path, options: ScanOptions) -> ScanOutcome:
    """Execute the plan of a run folder and report.

    Raises:
        CellError: with an exit code; the execution's folder keeps the scans, its status and stage.
    """
    return execute_run(session, _report, folder, options)


def execute_run(
    session: Session[None],
    finalise: Finalise[Outcome],
    folder: Path,
    options: ScanOptions,
    *,
    true_part: TriangleMesh | None = None,
) -> Outcome:
    """Execute the plan of a run folder.

    Args:
        session: of the command.
        finalise: processes the scans.
        folder: of a finished plan.
        options: of the execution.
        true_part: part of the simulated rays if it differs from the plan's [m], object frame.
    """
    verified = verify_plan(folder)
    run, motion = verified.run, verified.motion
    require_current_scene(verified, options, session.reporter, wire=options.uses_wire)
    plan = plan_execution(motion, options.view)
    approved = _approved(verified, plan, options.view)
    cell = _cell(run, options, true_part)
    seed = options.seed if options.seed is not None else run.seed
    driver, clock = make_driver(options, motion, cell, plants_of_run(run), session.note, run.proven_clearance)
    if options.states is not None:
        record_states(driver, clock, options.states, run.joint_names())
    actual = as_built.read_actual(options)
    as_built.require_clearance(actual, cell, run.proven_clearance)
    stored = options.as_manifest() | {"scanner": cell.scanner_keys.as_json()} | as_built.manifest_keys(actual)
    if warning := safety.placement_warning(options, cell, run.min_clearance[0]):
        session.note(warning)
    make_acquisition(stored, cell, seed, run.folder, session.note)  # fails before there is an execution
    if options.is_simulated:
        safety.require_room(cell, plan, run.folder)
    with ExitStack() as stack:
        stack.enter_context(signals.stop_on_signal())
        with driver_errors():  # a refusal of the controller leaves no execution behind
            stack.enter_context(driver)
            speed = _confirmed_speed(session, driver, options, cell, approved, verified, plan)
            state = safety.prepare_controller(driver, options, stop_first=False)
            driver, _ = remove_whole_turns(driver, state, verified.scene, motion.limits, session.reporter)
            require_drivable(plan, driver, speed)
        digest = approved.digest if approved.is_own_path else None
        execution_folder = ExecutionFolder.make(run, list(session.origin.argv), seed, stored, datetime.now(UTC), digest)
        stack.enter_context(safety.exclusive(execution_folder.path))
        if options.view is not None:
            write_motion(execution_folder, plan.to_motion(motion))
        stack.enter_context(execution_folder.keep_on_failure())
        stack.enter_context(driver_errors())
        opened = session.opened(execution_folder, seed)
        execute_plan(opened, plan, driver, clock, cell, speed)
        return finalise(opened, run, cell)


def resume(session: Session[None], folder: Path, execution: str, options: ScanOptions | None) -> ScanOutcome:
    """Resume a stopped execution at its first unconfirmed view.

    Args:
        session: of the command.
        folder: of a finished plan.
        execution: its id, or "latest".
        options: its `RESUME_OPTIONS` count (the driver only if given); the other options are those of the execution.

    Raises:
        CellError: with an exit code; the execution keeps its scans.
    """
    return resume_run(session, _report, folder, execution, options)


def resume_run(
    session: Session[None],
    finalise: Finalise[Outcome],
    folder: Path,
    execution: str,
    options: ScanOptions | None,
    *,
    true_part: TriangleMesh | None = None,
) -> Outcome:
    """Resume an execution, locked against other processes; see `resume` and `execute_run`."""
    with ExitStack() as stack:
        stack.enter_context(safety.exclusive(safety.execution_path(folder, execution)))
        verified = verify_plan(folder)
        run, motion = verified.run, verified.motion
        recorded = read_execution(run, execution)
        scans, unusable = usable_scans(recorded, verified.plan.views)
        options = resumable_options(run, recorded).resumed(options or ScanOptions())
        require_current_scene(verified, options, session.reporter, wire=options.uses_wire)
        cell = _cell(run, options, true_part)
        seed = recorded.manifest.require_seed(recorded.folder)
        plan, scanned_stops = plan_execution(motion, options.view), {scan.stop for scan in scans}
        if recorded.manifest.status == "finished" and scanned_stops >= set(plan.stops):
            raise UsageError(f"execution {recorded.folder.name} is finished and complete; there is nothing to resume")
        for sentence in unusable:
            session.note(sentence)
        if warning := safety.placement_warning(options, cell, run.min_clearance[0]):
            session.note(warning)
        driver, clock = make_driver(options, motion, cell, plants_of_run(run), session.note, run.proven_clearance)
        if options.states is not None:
            record_states(driver, clock, options.states, run.joint_names())
        if options.is_simulated:
            safety.require_room(cell, plan, run.folder)
        stack.enter_context(signals.stop_on_signal())
        with driver_errors():
            stack.enter_context(driver)
            approved = _approved(verified, plan, options.view)
            if session.confirm is None and options.confirm_motion is None:  # no user can confirm: do not move the arm
                _confirmed_speed(session, driver, options, cell, approved, verified, plan)
            state = safety.prepare_controller(driver, options, stop_first=True)
            driver, state = remove_whole_turns(driver, state, verified.scene, motion.limits, session.reporter)
            remaining = plan_resume(plan, scanned_stops, state, verified.checker, motion.limits, seed)
            approach: dict[str, object] = {}
            if remaining.approach_path is not None:
                approved = safety.approve_path(verified, remaining.plan, "the new path and the rest of the plan")
                degrees = to_deg(from_rad(remaining.approach_path)).tolist()
                approach = {"path_digest": approved.digest, "path_deg": tuple(map(tuple, degrees))}
            clearance = remaining.clearance(verified.checker)
            for sentence in remaining.notes(len(scanned_stops), clearance):
                session.note(sentence)
            # The confirmation comes after these notes, so that the person has read the path.
            proven = np.inf if clearance is None else float(clearance.lower_bound[0])
            speed = _confirmed_speed(session, driver, options, cell, approved, verified, remaining.plan, proven)
            require_drivable(remaining.plan, driver, speed)
        reopened = ExecutionFolder.reopen(recorded.folder, recorded.manifest)
        reopened.resume(list(session.origin.argv), options.driver, **approach)
        stack.enter_context(reopened.keep_on_failure())
        stack.enter_context(driver_errors())
        opened = session.opened(reopened, seed)
        execute_plan(opened, remaining.plan, driver, clock, cell, speed)
        return finalise(opened, run, cell)


def resumable_options(run: Run, recorded: RecordedExecution) -> ScanOptions:
    """Return the options of an execution that can be resumed.

    Raises:
        FileError: if it is running, its manifest is damaged, or it belongs to another plan.
    """
    name, manifest = recorded.folder.name, read_manifest(recorded.folder / "manifest.json")
    if run_folder.is_running(manifest):
        raise FileError(f"execution {name} is still running (process {manifest.pid}); stop it with Ctrl-C first")
    if manifest.digest != run.digest:
        raise FileError(f"execution {name} does not belong to the current plan of {run.folder}; scan again")
    with reading(recorded.folder / "manifest.json"):
        return ScanOptions.from_manifest(manifest.options)


def _cell(run: Run, options: ScanOptions, true_part: TriangleMesh | None) -> RunCell:
    """Return the cell of a run, with another part if its true shape is given."""
    cell = read_cell(run, options.resolution_deg)
    return cell if true_part is None else cell.with_surface(true_part)


def _approved(verified: VerifiedPlan, plan: ExecutionPlan, view: int | None) -> ApprovedMotion:
    """Return the plan's motion, or the verified path to one view and back."""
    if view is None:
        return ApprovedMotion("the plan", verified.digest)
    return safety.approve_path(verified, plan, f"the path to view {view} and back,")


def _confirmed_speed(
    session: Session[None], driver: Driver, options: ScanOptions, cell: RunCell, motion: ApprovedMotion,
    verified: VerifiedPlan, plan: ExecutionPlan, approach_clearance: float = np.inf,
) -> float:  # fmt: skip
    """Return the speed fraction after the confirmation of a real arm's motion."""
    hardware, planned = driver.capabilities.hardware, cell.scene.speed_scaling
    speed = safety.speed_fraction(options.speed, planned, hardware=hardware)
    if hardware and options.confirm_motion != safety.ANY_MOTION:
        proven = verified.run.proven_clearance
        reserve = min(proven, approach_clearance) - cell.path_tolerance(proven)
        if warning := safety.watch_warning(plan, verified.motion, cell, options, speed, reserve):
            session.note(warning)
    safety.require_confirmation(driver, speed, motion, confirmation=options.confirm_motion, confirm=session.confirm)
    return speed


def _report(session: Session[ExecutionFolder], run: Run, cell: RunCell) -> ScanOutcome:
    """Report an execution and finish its folder."""
    folder = session.folder
    report = report_execution(session, run, cell, read_execution(run, folder.path.name))
    if report.missing_views:  # the same as a stopped execution
        return ScanOutcome(folder.finish(FileError.exit_code, "incomplete"), FileError.exit_code, report)
    code = exit_code_of(report, cell)
    return ScanOutcome(folder.finish(code), code, report)
