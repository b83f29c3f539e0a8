"""`cell export` as the command line gives it: options in, the names of the files or one JSON object out."""

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from cell.commands.options import AsJson
from cell.errors import UsageError

_KRL, _CELL = "KRL", "The cell as it is now"

EPILOG = (
    "Examples:\n\n"
    "cell export sim_runs/trial\n\n"
    "cell export sim_runs/trial --name PART_07 --speed 10 --trigger-output 5 --done-input 6 --out program\n\n"
    "cell export sim_runs/trial --format csv\n\n"
    "Read docs/export.md before a program runs on a robot.\n\n"
    "Exit codes: 0 done, 2 usage, 6 files or run folder, 70 bug, 130 Ctrl-C."
)


def export(
    run: Annotated[Path, typer.Argument(help="Run folder of a finished cell plan.")],
    kind: Annotated[str, typer.Option("--format", metavar="krl|csv|json", help="What to write.")] = "krl",
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for the files. Default: export/ in the run folder.")
    ] = None,
    name: Annotated[
        str | None,
        typer.Option(
            help="Name of program and files, at most 24 characters. Default: the run folder's, if KRL takes it."
        ),
    ] = None,
    speed: Annotated[
        int | None,
        typer.Option(
            metavar="PERCENT",
            help="Of the axis speeds, 1 to 100; sweeps slow down alike. Default: 20, or the plan's if slower.",
            rich_help_panel=_KRL,
        ),
    ] = None,
    acceleration: Annotated[
        int | None,
        typer.Option(
            metavar="PERCENT",
            help="Of the axis accelerations. Default: 30, or the plan's if slower.",
            rich_help_panel=_KRL,
        ),
    ] = None,
    trigger_output: Annotated[
        int, typer.Option(metavar="N", help="$OUT that starts a scan.", rich_help_panel=_KRL)
    ] = 1,
    gate_output: Annotated[
        int, typer.Option(metavar="N", help="$OUT that is on while a sweep is driven.", rich_help_panel=_KRL)
    ] = 2,
    done_input: Annotated[
        int, typer.Option(metavar="M", help="$IN by which the scanner says that it is done.", rich_help_panel=_KRL)
    ] = 1,
    timer: Annotated[
        int, typer.Option(metavar="K", help="$TIMER that measures the time-out.", rich_help_panel=_KRL)
    ] = 1,
    settle: Annotated[
        float, typer.Option(metavar="S", help="Standstill before each scan.", rich_help_panel=_KRL)
    ] = 0.2,
    timeout: Annotated[
        float, typer.Option(metavar="S", help="Longest wait for the scanner.", rich_help_panel=_KRL)
    ] = 10.0,
    scene: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Scene file that describes the cell now. Default: the one that was planned with.",
            rich_help_panel=_CELL,
        ),
    ] = None,
    part: Annotated[
        str | None,
        typer.Option(
            metavar="FILE",
            help="Mesh file of the part now. Default: the one that was planned with.",
            rich_help_panel=_CELL,
        ),
    ] = None,
    accept_changed_scene: Annotated[
        str | None,
        typer.Option(
            metavar="NAME[,NAME...]",
            help="Export although this differs from the plan: names as the refusal gives them.",
            rich_help_panel=_CELL,
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Write the motion of a plan as a KUKA program (KRL), or as a table (CSV, JSON)."""
    from cell.commands.terminal import Terminal
    from cell.export.export import Format, Wanted
    from cell.export.export import export as run_export
    from cell.export.krl import Signals
    from cell.proof.files_now import FilesNow

    if kind not in list(Format):
        raise UsageError(f"--format {kind} is not known; it must be one of {', '.join(Format)}")
    signals = Signals(trigger_output, gate_output, done_input, timer, settle, timeout)
    terminal = Terminal(quiet_stdout=as_json)
    now = FilesNow(scene, part, tuple(each.strip() for each in (accept_changed_scene or "").split(",")))
    outcome = run_export(run, Wanted(Format(kind), out, name, speed, acceleration, signals, now), terminal)
    if Format(kind) is Format.KRL:
        terminal.note(
            "before this program runs on a robot, check tool, base, signals and cell as docs/export.md says, and run "
            "it in T1 first"
        )
    if as_json:
        sys.stdout.write(json.dumps(outcome.as_json(), indent=2, allow_nan=False) + "\n")
    else:
        sys.stdout.write("".join(f"{path}\n" for path in outcome.files))
        Terminal(quiet_stdout=True).then(("cell", "replay", run))
