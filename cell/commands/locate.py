"""`cell locate` as the command line gives it: options in, a table or one JSON object out, and the plan there."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from cell.commands.options import AsJson, RunFolder, from_fields, print_json
from cell.errors import UsageError
from cell.metrology.options import LocateOptions

_THERE = "The plan there"

EPILOG = (
    "Examples:\n\n"
    "cell locate sim_runs/trial --execution latest\n\n"
    "cell locate sim_runs/trial --points scans --points-frame scanner --points-units mm --view 1,4\n\n"
    "cell locate sim_runs/trial --pairs touched.csv --points-frame base --points-units mm --out sim_runs/there\n\n"
    "cell locate sim_runs/trial --three-two-one touched.csv --points-frame base --points-units mm --point-sd 0.05\n\n"
    "The plan stays as it is; --out makes another one, whose views have moved with the part.\n\n"
    "Exit codes: 0 done, 2 usage or not determined, 3 below the required coverage, 4 the arm cannot, 6 files or run "
    "folder, 70 bug, 130 Ctrl-C."
)


@from_fields
def locate(
    *,
    run: RunFolder,
    wanted: LocateOptions,
    out: Annotated[
        Path | None,
        typer.Option(help="Run folder to make: the plan with its views where the part stands.", rich_help_panel=_THERE),
    ] = None,
    repair: Annotated[
        bool,
        typer.Option(
            "--repair",
            help="Leave out views that the arm cannot take there, and add the fewest others that restore the coverage.",
            rich_help_panel=_THERE,
        ),
    ] = False,
    keep_planned: Annotated[
        bool,
        typer.Option(
            "--keep-planned",
            help="Where the points leave a direction open, take the part to stand as planned.",
            rich_help_panel=_THERE,
        ),
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Find where the part really stands, from points measured on it, and take the plan there."""
    from cell import api
    from cell.commands.terminal import Terminal

    if out is None and (repair or keep_planned):
        raise UsageError("--repair and --keep-planned are of the plan that --out makes; give --out")
    terminal = Terminal(quiet_stdout=as_json)
    found = api.locate(run, wanted, progress=terminal)
    if not as_json:
        terminal.pairs(f"Where the part of {run} stands", found.rows())
    made = None
    if out is not None:
        if not keep_planned:
            found.require_determined()
        made = api.open_run(run).edited(
            repair=repair, T_base_object=found.T_base_object, out=out, progress=terminal, argv=sys.argv[1:]
        )
    if as_json:
        there = {} if made is None else {"made": made.as_json()}
        print_json({**found.as_json(), **there})
    elif made is not None:
        from cell.plan.report import table

        terminal.pairs("The plan there", [*table(made.report), ("run folder", str(made.folder))])
        terminal.then(("cell", "scan", made.folder), ("cell", "diff", run, made.folder))
    else:
        again = [word for word in sys.argv[1:] if word != "--json"]
        terminal.then(("cell", *again, "--out", "sim_runs/there"))
    raise typer.Exit(0 if made is None else made.exit_code)
