"""`cell scan SETUPS`: one set-up after the other, halting where the part has to be turned over; then all as one.

Nothing is kept of the chain but the executions of the set-ups themselves: which of them are whole says what is next,
so it goes on wherever it was stopped.
"""

from dataclasses import dataclass, replace
from pathlib import Path

from cell.acquisition import SIMULATED
from cell.errors import FileError, UsageError
from cell.runs.run import open_finished, read_execution
from cell.runs.schema import ScannedSetups
from cell.scan import driver as scan_driver
from cell.scan import whole
from cell.scan.options import ScanOptions
from cell.scan.scan import resume, scan
from cell.session import Session
from cell.setups.planned_setups import PlannedSetups
from cell.words import listed

_FILES = "files:"


@dataclass(frozen=True, slots=True, eq=False)
class SetupsOutcome:
    """What `cell scan SETUPS` leaves.

    Attributes:
        folder: of what is made of all scans.
        exit_code: 0; 3 where all set-ups measure less than the plan requires.
        report: its report.json.
    """

    folder: Path
    exit_code: int
    report: ScannedSetups


def scan_setups(
    session: Session[None],
    folder: Path,
    options: ScanOptions | None,
    *,
    setup: int | None,
    resumed: bool,
) -> SetupsOutcome:
    """Scan the next set-up, or a given one, and make one model of all that are scanned.

    Simulated parts turn over by themselves, and so does the chain where a person is asked before each motion; with
    points of other sources it halts after one set-up.

    Args:
        session: of the command.
        folder: of `cell setups`.
        options: what was asked for; those of a resumed execution as `cell.scan.scan.resume` takes them. None, of a
            set-up that is not begun: those of the set-up before.
        setup: its number; None: each that is not scanned yet, in order.
        resumed: whether to go on: with an execution that was stopped, where there is one.

    Raises:
        UsageError: if there is no such set-up, all are scanned, or an option is of one run alone.
        FileError: if views have no points, or a set-up's folder is of another plan.
        CellError: whatever an execution raises; what was scanned is kept.
    """
    planned = PlannedSetups.opened(folder)
    _require_possible(planned, options, setup)
    left = [n for n, each in enumerate(planned.folders, start=1) if whole.finished_execution(each) is None]
    if setup is None and not left:
        raise UsageError(
            f"all {len(planned.folders)} set-ups of {folder} are scanned; --setup 1 scans one again, --report latest "
            "makes the report anew"
        )
    for number in left if setup is None else [setup]:
        run, lies = planned.folders[number - 1], _lies(planned, number)
        stopped = _stopped(run) if resumed else None
        session.note(lies)
        if stopped is not None:
            chosen = _begun(run, stopped, options)
            done = resume(_asking(session, lies), run, stopped, options)
        else:
            chosen = _options(planned, number, options, resumed=resumed)
            done = scan(_asking(session, lies), run, chosen)
        if missing := done.summary.missing_views:
            raise FileError(
                f"view {missing[0]} of set-up {number} has no points ({len(missing)} such views); "
                f"cell scan {folder} --resume latest takes them"
            )
        alone = chosen.acquire != SIMULATED or (scan_driver.on_a_wire(chosen.driver) and session.confirm is None)
        if alone:
            break
    return report(session, planned)


def report(session: Session[None], planned: PlannedSetups) -> SetupsOutcome:
    """One model of all set-ups that are scanned."""
    made = whole.report(session, planned)
    for doubt in made.doubts:
        session.note(doubt)
    missed = not made.missing and made.visible < planned.file.coverage.required
    return SetupsOutcome(planned.folder / whole.FOLDER, 3 if missed else 0, made)


def _require_possible(planned: PlannedSetups, options: ScanOptions | None, setup: int | None) -> None:
    if setup is not None and not 1 <= setup <= len(planned.folders):
        raise UsageError(f"there is no set-up {setup} of {planned.folder}; there are 1 to {len(planned.folders)}")
    if options is not None and options.view is not None:
        raise UsageError(
            "--view is of one run: give its folder in place of that of all set-ups, such as "
            f"{planned.folders[(setup or 1) - 1]}"
        )


def _options(planned: PlannedSetups, number: int, given: ScanOptions | None, *, resumed: bool) -> ScanOptions:
    """The options of a new execution: those given, or in a chain that goes on those of the set-up before.

    Raises:
        UsageError: if those before name the files of another set-up's points.
    """
    if not resumed:
        return given or ScanOptions()
    for before in range(number - 1, 0, -1):
        name = whole.finished_execution(planned.folders[before - 1])
        if name is not None:
            begun = _begun(planned.folders[before - 1], name, given)
            if begun.acquire.startswith(_FILES):
                raise UsageError(
                    f"{begun.acquire} has the points of set-up {before}; begin with cell scan {planned.folder} --setup "
                    f"{number} and the --acquire of its own points"
                )
            return begun
    return given or ScanOptions()


def _begun(folder: Path, execution: str, given: ScanOptions | None) -> ScanOptions:
    """What an execution was asked for, as it is gone on with now."""
    manifest = read_execution(open_finished(folder), execution).manifest
    return ScanOptions.begun(manifest.options).resumed(given or ScanOptions())


def _stopped(folder: Path) -> str | None:
    """The latest execution of all views of a run, if it did not finish."""
    run = open_finished(folder)
    for name in reversed(run.execution_ids):
        manifest = read_execution(run, name).manifest
        if manifest.options.get("view") is None:
            return None if manifest.status == "finished" else name
    return None


def _asking(session: Session[None], lies: str) -> Session[None]:
    """Whoever says that the arm may move says too that the part lies so."""
    confirm = session.confirm
    return session if confirm is None else replace(session, confirm=lambda question: confirm(f"{lies}. {question}"))


def _lies(planned: PlannedSetups, number: int) -> str:
    """How the part has to lie.

    Raises:
        FileError: if that is of another plan than the one in the folder.
    """
    chosen, folder = planned.file.chosen[number - 1], planned.folders[number - 1]
    run = open_finished(folder)
    if run.digest != chosen.digest:
        raise FileError(
            f"{folder} is not the plan that setups.json names, so how the part lies in it is not known; nothing was "
            "moved: plan the set-ups anew"
        )
    offer = planned.file.offered[chosen.offered]
    xyz, abc = (listed(values) for values in (offer.placement_mm, offer.placement_abc_deg))
    turned = "" if run.scene.table is None else ", the rotary table at 0"
    return (
        f"set-up {number} of {len(planned.folders)}: the part lies {offer.name}, its centre at {xyz} mm, "
        f"A, B, C {abc} deg{turned}"
    )
