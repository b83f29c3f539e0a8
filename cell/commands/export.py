"""`cell export` as the command line gives it: options in, the names of the files or one JSON object out."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from cell.commands.options import AsJson, from_fields, print_json
from cell.export.options import ExportOptions

EPILOG = (
    "Examples:\n\n"
    "cell export sim_runs/trial\n\n"
    "cell export sim_runs/trial --name PART_07 --speed 10 --trigger-output 5 --done-input 6 --out program\n\n"
    "cell export sim_runs/trial --format csv\n\n"
    "cell export sim_runs/both\n\n"
    "Read docs/export.md before a program runs on a robot.\n\n"
    "Exit codes: 0 done, 2 usage, 6 files or run folder, 70 bug, 130 Ctrl-C."
)


@from_fields
def export(
    *,
    run: Annotated[Path, typer.Argument(help="Run folder of a finished cell plan, or the folder of cell setups.")],
    options: ExportOptions,
    as_json: AsJson = False,
) -> None:
    """Write the motion of a plan as a KUKA program (KRL), or as a table (CSV, JSON)."""
    from cell.commands.terminal import Terminal
    from cell.export.export import export as run_export
    from cell.export.export import export_setups

    terminal = Terminal(quiet_stdout=as_json)
    several = (run / "setups.json").is_file()
    outcome = (export_setups if several else run_export)(run, options, terminal)
    if options.kind == "krl":
        terminal.note(
            "before this program runs on a robot, check tool, base, signals and cell as docs/export.md says, and run "
            "it in T1 first"
        )
    if as_json:
        print_json(outcome.as_json())
    else:
        sys.stdout.write("".join(f"{path}\n" for path in outcome.files))
        Terminal(quiet_stdout=True).then(("cell", "scan" if several else "replay", run))
