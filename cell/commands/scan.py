"""`cell scan` as the command line gives it: options in, a table or one JSON object out."""

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from cell.commands import options
from cell.errors import UsageError

_ERRORS = "Errors of the execution"
_OUTPUT = "Output"
_STEEL = "Real controllers"

EPILOG = (
    "Examples:\n\n"
    "cell scan sim_runs/trial\n\n"
    "cell scan sim_runs/trial --pose-error 0.5,0.1 --range-noise 0.02 --seed 4\n\n"
    "cell scan sim_runs/trial --view 3 --resolution 0.5 --realtime\n\n"
    "cell scan sim_runs/trial --report 0001\n\n"
    "cell scan sim_runs/trial --driver modbus://192.168.0.10:502 --speed 10\n\n"
    "cell scan sim_runs/trial --resume latest --reset\n\n"
    "Exit codes: 0 done, 2 usage, 3 below the plan's required coverage, 5 driver, 6 files or run folder (also: "
    "a report of an execution that lacks views), 70 bug, 130 Ctrl-C."
)


def scan(
    run: Annotated[Path, typer.Argument(help="Run folder of a finished cell plan.")],
    driver: Annotated[
        str | None, typer.Option(metavar="URL", help="Which controller drives. Default: sim://.", show_default=False)
    ] = None,
    realtime: Annotated[
        bool, typer.Option("--realtime", help="Let the simulated arm take its time. Default: as fast as it goes.")
    ] = False,
    view: Annotated[
        int | None, typer.Option(metavar="N", help="Scan this view only, counted from 1 in visiting order.")
    ] = None,
    resolution: Annotated[
        float | None, typer.Option(metavar="DEG", help="Angle between rays. Default: the plan's.")
    ] = None,
    preset: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="fast, balanced or accurate: the angle between rays, where neither --resolution nor the scene gives "
            "one. Default: the plan's preset.",
            show_default=False,
        ),
    ] = None,
    range_noise: Annotated[
        float, typer.Option(metavar="MM", help="Noise along each ray, one sigma.", rich_help_panel=_ERRORS)
    ] = 0.0,
    noise: Annotated[
        str,
        typer.Option(
            metavar="none|model",
            help="model: noise along each ray by the scanner's own law, from range, triangulation angle and incidence.",
            rich_help_panel=_ERRORS,
        ),
    ] = "none",
    pose_error: Annotated[
        str | None,
        typer.Option(
            metavar="MM,DEG",
            help="Error of the executed pose, one sigma along and about each axis: the scanner stands off what the "
            "controller reports.",
            rich_help_panel=_ERRORS,
        ),
    ] = None,
    register: Annotated[
        bool | None,
        typer.Option(
            "--register/--no-register",
            help="Correct the reported poses by matching the scans. Default: with a pose error.",
            rich_help_panel=_ERRORS,
        ),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(help="Seed of noise and pose error. Default: the plan's.", rich_help_panel=_ERRORS)
    ] = None,
    speed: Annotated[
        float | None,
        typer.Option(
            metavar="PERCENT",
            help="Of the speed that the plan was timed with. Default: 100 in simulation; 10 % of the axis speeds on a "
            "real controller.",
            rich_help_panel=_STEEL,
        ),
    ] = None,
    confirm_motion: Annotated[
        bool,
        typer.Option(
            "--confirm-motion", help="Your word that a real arm may move. Else it is asked for.", rich_help_panel=_STEEL
        ),
    ] = False,
    reset: Annotated[
        bool, typer.Option("--reset", help="Clear a latched fault of the controller first.", rich_help_panel=_STEEL)
    ] = False,
    resume: Annotated[
        str | None,
        typer.Option(
            metavar="ID",
            help="Go on with this execution (or latest) at the first view that is not confirmed, on a new way where "
            "the arm stands elsewhere.",
            rich_help_panel=_STEEL,
        ),
    ] = None,
    close_holes: Annotated[
        bool, typer.Option("--close-holes", help="Close the holes of the surface; the faces are marked.")
    ] = False,
    report: Annotated[
        str | None,
        typer.Option(
            metavar="ID",
            help="Scan nothing: make the report of this execution (or latest) anew from what is there.",
            rich_help_panel=_OUTPUT,
        ),
    ] = None,
    as_json: Annotated[
        bool,
        typer.Option("--json", help="Print one JSON object on stdout, the rest on stderr.", rich_help_panel=_OUTPUT),
    ] = False,
) -> None:
    """Execute a plan on a controller, scan at every view, merge, make the surface and say how good it is."""
    from cell.commands.terminal import Terminal
    from cell.scan import execution_report, post_processing
    from cell.scan import scan as scan_command
    from cell.scan.options import ScanOptions

    errors = options.numbers("--pose-error", pose_error) or [0.0, 0.0]
    if len(errors) != 2:
        raise UsageError(
            f"--pose-error {pose_error} must be two numbers, mm and deg, for instance --pose-error 0.5,0.1"
        )
    if preset is not None and (report is not None or resume is not None):
        raise UsageError("--preset settles a new scan; leave it away beside --report and --resume")
    if preset is not None and resolution is None:
        from cell.run.record import open_run
        from cell.scan.preset import resolution_deg

        resolution = resolution_deg(open_run(run), preset)
    url = driver or "sim://"
    wanted = ScanOptions(
        url, realtime, view, resolution, range_noise, errors[0], errors[1], register, close_holes, seed, noise,
        confirm_motion, speed, reset,
    )  # fmt: skip
    terminal = Terminal(quiet_stdout=as_json)
    ask = terminal.ask if sys.stdin.isatty() and sys.stderr.isatty() else None
    if report is not None and resume is not None:
        raise UsageError("--report makes the report of what is there, --resume scans what is missing; give one of them")
    if resume is not None:
        this_time = ScanOptions(driver or "", realtime, confirm_motion=confirm_motion, speed_percent=speed, reset=reset)
        if replace(wanted, driver=driver or "") != this_time:
            raise UsageError(
                "--resume goes on as the execution was begun; beside it give only --driver, --realtime, --speed, "
                "--confirm-motion and --reset"
            )
        outcome = scan_command.resume(run, resume, this_time, argv=sys.argv[1:], narrator=terminal, ask=ask)
    elif report is None:
        outcome = scan_command.scan(run, wanted, argv=sys.argv[1:], narrator=terminal, ask=ask)
    elif wanted == ScanOptions():
        outcome = post_processing.report(run, report, terminal)
    else:
        raise UsageError("--report makes the report of what was scanned; leave the options of a new scan away")
    if as_json:
        sys.stdout.write(json.dumps(outcome.summary, indent=2, allow_nan=False) + "\n")
    else:
        rows = [*execution_report.table(outcome.summary), ("execution", str(outcome.folder))]
        terminal.pairs(f"Scan of {outcome.summary['part']['name']}", rows)
    raise typer.Exit(outcome.exit_code)
