"""`cell scan` as the command line gives it: options in, a table or one JSON object out."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from cell.commands.options import AsJson, from_fields, print_json
from cell.errors import UsageError
from cell.scan.options import OF_EACH_TIME, STEEL, ScanOptions

if TYPE_CHECKING:
    from cell.commands.terminal import Terminal
    from cell.session import Confirm, Session

EPILOG = (
    "Examples:\n\n"
    "cell scan sim_runs/trial\n\n"
    "cell scan sim_runs/trial --pose-error 0.5,0.1 --range-noise 0.02 --seed 4\n\n"
    "cell scan sim_runs/trial --view 3 --resolution 0.5 --realtime\n\n"
    "cell scan sim_runs/trial --report 0001\n\n"
    "cell scan sim_runs/trial --driver modbus://192.168.0.10:502 --speed 10\n\n"
    "cell scan sim_runs/trial --resume latest --reset\n\n"
    "cell scan sim_runs/both --setup 1 --setup-error 5mm,2deg --range-noise 0.03\n\n"
    "Exit codes: 0 done, 2 usage, 3 below the plan's required coverage, 5 driver, 6 files or run folder (also: "
    "a report of an execution that lacks views), 70 bug, 130 Ctrl-C."
)


@from_fields
def scan(
    *,
    run: Annotated[Path, typer.Argument(help="Run folder of a finished cell plan, or the folder of cell setups.")],
    options: ScanOptions,
    setup: Annotated[
        int | None,
        typer.Option(
            min=1, help="Of a folder of cell setups: scan this set-up. Default: those that are not scanned yet."
        ),
    ] = None,
    resume: Annotated[
        str | None,
        typer.Option(
            metavar="ID",
            help="Go on with this execution (or latest) at the first view that is not confirmed, on a new way where "
            "the arm stands elsewhere.",
            rich_help_panel=STEEL,
        ),
    ] = None,
    report: Annotated[
        str | None,
        typer.Option(
            metavar="ID",
            help="Scan nothing: make the report of this execution (or latest) anew from what is there.",
            rich_help_panel="Output",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Execute a plan on a controller, scan at every view, merge, make the surface and say how good it is."""
    from cell import api
    from cell.commands.terminal import Terminal
    from cell.scan import execution_page, post_processing
    from cell.scan import scan as scan_command
    from cell.scan.post_processing import ScanOutcome

    _require_one_question(options.model_fields_set, resume, report)
    terminal = Terminal(quiet_stdout=as_json)
    if (run / "setups.json").is_file():
        _scan_setups(run, options, setup, resume, report, terminal, as_json=as_json)
    if setup is not None:
        raise UsageError(f"--setup is of a folder that cell setups made, and {run} is none; leave it out")
    if report is not None:
        outcome = post_processing.report(_session(terminal), run, report)
    elif resume is not None:
        outcome = scan_command.resume(_session(terminal), run, resume, options)
    else:
        executed = api.scan(run, options, progress=terminal, argv=sys.argv[1:], ask=_confirm(terminal))
        outcome = ScanOutcome(executed.folder, executed.exit_code, executed.report)
    if as_json:
        print_json(outcome.summary.as_json())
    else:
        rows = [*execution_page.table(outcome.summary), ("execution", str(outcome.folder))]
        terminal.pairs(f"Scan of {outcome.summary.part.name}", rows)
        number = outcome.folder.name
        missing = [("cell", "scan", run, "--resume", number)] if outcome.summary.missing_views else []
        terminal.then(*missing, ("cell", "replay", run, "--execution", number))
    raise typer.Exit(outcome.exit_code)


def _scan_setups(
    folder: Path, options: ScanOptions, setup: int | None, resume: str | None, report: str | None,
    terminal: "Terminal", *, as_json: bool,
) -> NoReturn:  # fmt: skip
    """The set-ups of a folder, and what all their scans are together."""
    from cell import api
    from cell.scan.of_setups import report as report_of
    from cell.scan.whole_page import rows
    from cell.setups.planned_setups import PlannedSetups

    for option, given in (("--resume", resume), ("--report", report)):
        if given not in (None, "latest"):
            raise UsageError(f"{option} of several set-ups goes on from the latest execution of each: {option} latest")
    if report is not None:
        outcome = report_of(_session(terminal), PlannedSetups.opened(folder))
    else:
        outcome = api.scan_setups(
            folder, options, setup=setup, resume=resume is not None, progress=terminal, argv=sys.argv[1:],
            ask=_confirm(terminal),
        )  # fmt: skip
    made = outcome.report
    if as_json:
        print_json(made.as_json())
    else:
        terminal.pairs(f"Scan of {made.part}", [*rows(made), ("folder", str(outcome.folder))])
        if made.missing:
            terminal.then(("cell", "scan", folder, "--setup", made.missing[0]))
    raise typer.Exit(outcome.exit_code)


def _session(terminal: "Terminal") -> "Session[None]":
    from cell.session import Origin, Session

    return Session(None, terminal, confirm=_confirm(terminal), origin=Origin(tuple(sys.argv[1:])))


def _confirm(terminal: "Terminal") -> "Confirm | None":
    """Return the function that puts questions to the person at the terminal; None if there is nobody."""
    return terminal.ask if sys.stdin.isatty() and sys.stderr.isatty() else None


def _require_one_question(given: set[str], resume: str | None, report: str | None) -> None:
    """Refuse options of a new scan beside those that go back to an old one.

    Raises:
        UsageError: in one sentence.
    """
    if report is not None and resume is not None:
        raise UsageError("--report makes the report of what is there, --resume scans what is missing; give one of them")
    if resume is not None and given - OF_EACH_TIME:
        raise UsageError(
            "--resume goes on as the execution was begun; beside it give only --driver, --realtime, --speed, "
            "--confirm-motion, --reset, --accept-time-scale, --scene, --part and --accept-changed-scene"
        )
    if report is not None and given:
        raise UsageError("--report makes the report of what was scanned; leave the options of a new scan away")
