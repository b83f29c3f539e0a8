"""`cell scan SETUPS`: one set-up after the other, halting where the part has to be turned over; then all as one.

Nothing is kept of the chain but the executions of the set-ups themselves: which of them are whole says what is next,
so it goes on wherever it was stopped.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from cell.acquisition import SIMULATED
from cell.errors import UsageError
from cell.narrator import Narrator
from cell.run.executions import execution_ids, read_execution
from cell.run.manifest_json import Manifest
from cell.run.record import open_finished
from cell.run.setups_json import ScannedSetups
from cell.scan import driver as scan_driver
from cell.scan import safety, whole
from cell.scan.options import ScanOptions
from cell.scan.scan import resume, scan
from cell.setups.planned_setups import PlannedSetups


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
    folder: Path,
    options: ScanOptions | None,
    *,
    setup: int | None,
    resumed: bool,
    argv: Sequence[str],
    narrator: Narrator,
    ask: safety.Ask | None = None,
) -> SetupsOutcome:
    """Scan the next set-up, or a given one, and make one model of all that are scanned.

    Simulated parts turn over by themselves, and so does the chain where a person is asked before each motion; with
    points of other sources it halts after one set-up.

    Args:
        folder: of `cell setups`.
        options: what was asked for; those of a resumed execution as `cell.scan.scan.resume` takes them. None, of a
            set-up that is not begun: those of the set-up before.
        setup: its number; None: each that is not scanned yet, in order.
        resumed: whether to go on: with an execution that was stopped, where there is one.
        argv: for the manifests.
        narrator: is told what goes on.
        ask: puts a question to a person; None where nobody is there.

    Raises:
        UsageError: if there is no such set-up, all are scanned, or an option is of one run alone.
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
        chosen = _options(planned, number, options, resumed=resumed)
        for sentence in _told(planned, number):
            narrator.note(sentence)
        run, stopped = planned.folders[number - 1], _stopped(planned.folders[number - 1])
        if resumed and stopped is not None:
            resume(run, stopped, options, argv=argv, narrator=narrator, ask=ask)
        else:
            scan(run, chosen, argv=argv, narrator=narrator, ask=ask)
        alone = chosen.acquire != SIMULATED or (scan_driver.on_a_wire(chosen.driver) and ask is None)
        if alone:
            break
    return report(planned, argv, narrator)


def report(planned: PlannedSetups, argv: Sequence[str], narrator: Narrator) -> SetupsOutcome:
    """One model of all set-ups that are scanned."""
    made = whole.report(planned, argv, narrator)
    for doubt in made.doubts:
        narrator.note(doubt)
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
    """The options of a new execution: those given, or in a chain that goes on those of the set-up before."""
    if not resumed:
        return given or ScanOptions()
    for before in range(number - 1, 0, -1):
        run = open_finished(planned.folders[before - 1])
        name = whole.finished_execution(run.folder)
        if name is not None:
            begun = ScanOptions.begun(read_execution(run, name).manifest.options)
            return begun.resumed(given or ScanOptions())
    return given or ScanOptions()


def _stopped(folder: Path) -> str | None:
    """The latest execution of a run, if it did not finish."""
    run = open_finished(folder)
    names = execution_ids(run)
    if not names or _of(names[-1], folder).status == "finished":
        return None
    return names[-1]


def _of(name: str, folder: Path) -> Manifest:
    return read_execution(open_finished(folder), name).manifest


def _told(planned: PlannedSetups, number: int) -> list[str]:
    """How the part has to lie."""
    chosen = planned.file.chosen[number - 1]
    offer = planned.file.offered[chosen.offered]
    xyz, abc = (", ".join(f"{value:g}" for value in each) for each in (offer.placement_mm, offer.placement_abc_deg))
    return [
        f"set-up {number} of {len(planned.folders)}: the part lies {offer.name}, its centre at {xyz} mm, "
        f"A, B, C {abc} deg"
    ]
