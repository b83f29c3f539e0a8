"""`cell cover` as the command line gives it: a set-cover file in, the cover and its bound or one JSON object out."""

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from cell.commands.options import AsJson, from_fields, print_json
from cell.cover.options import CoverOptions

EPILOG = (
    "Examples:\n\n"
    "cell cover scp41.txt --unicost --budget 10\n\n"
    "cell cover rail507.gz --time-limit 60 --json\n\n"
    "FILE is in the row or the rail format of the OR-Library, or a list of Steiner triples; plain or gzip.\n\n"
    "Exit codes: 0 done, 2 usage, 6 not such a file, 70 bug, 130 Ctrl-C while reading (a search that Ctrl-C ends "
    "gives its best cover)."
)


@from_fields
def cover(
    *,
    file: Annotated[Path, typer.Argument(help="Set-cover file.")],
    options: CoverOptions,
    unicost: Annotated[
        bool, typer.Option("--unicost/--costs", help="Every column costs 1, or what the file says.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Solve a set-cover file with the solvers that choose the views, so that anyone can check them."""
    from cell.cover.solve_file import DEFAULT_S, solve_file

    outcome = solve_file(file, options, unicost=unicost)
    if as_json:
        print_json(outcome.as_json())
    else:
        from cell.commands.terminal import Terminal, without

        terminal = Terminal()
        terminal.pairs(f"{outcome.path.name}: {outcome.sentence}", outcome.rows())
        again = ["cell", *sys.argv[1:]]
        if outcome.result.gap <= 0:
            terminal.then(f"{shlex.join(again)} --json > cover.json")
        elif options.solver != "auto":
            terminal.then(without(again, "--solver"))
        elif options.budget_s is None and options.time_limit_s is not None:
            terminal.then((*without(again, "--time-limit"), "--time-limit", f"{10 * options.time_limit_s:g}"))
        else:
            terminal.then((*without(again, "--budget"), "--budget", f"{10 * (options.budget_s or DEFAULT_S):g}"))
