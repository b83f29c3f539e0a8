"""`cell cover` as the command line gives it: a set-cover file in, the cover and its bound or one JSON object out."""

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from cell.commands.options import AsJson, print_json

_SEARCH = "Search"

EPILOG = (
    "Examples:\n\n"
    "cell cover scp41.txt --unicost --budget 10\n\n"
    "cell cover rail507.gz --time-limit 60 --json\n\n"
    "FILE is in the row or the rail format of the OR-Library, or a list of Steiner triples; plain or gzip.\n\n"
    "Exit codes: 0 done, 2 usage, 6 not such a file, 70 bug, 130 Ctrl-C while reading (a search that Ctrl-C ends "
    "gives its best cover)."
)


def cover(
    file: Annotated[Path, typer.Argument(help="Set-cover file.")],
    form: Annotated[
        str | None,
        typer.Option("--format", help="rows, rail or steiner. Default: the one that fits.", show_default=False),
    ] = None,
    solver: Annotated[
        str,
        typer.Option(help="auto, greedy, meta-raps, local-search or exact.", rich_help_panel=_SEARCH),
    ] = "auto",
    budget: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            help="Work to spend, counted and not timed: about so many seconds of one core, and the same answer on "
            "every machine. Default: 2, or with --time-limit no end but that.",
            show_default=False,
            rich_help_panel=_SEARCH,
        ),
    ] = None,
    time_limit: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            help="Wall-clock guard; the answer says when it stopped the search.",
            show_default=False,
            rich_help_panel=_SEARCH,
        ),
    ] = None,
    unicost: Annotated[
        bool, typer.Option("--unicost/--costs", help="Every column costs 1, or what the file says.")
    ] = False,
    coverage: Annotated[float, typer.Option(help="Share of the coverable rows that must be covered.")] = 1.0,
    multiplicity: Annotated[int, typer.Option(metavar="K", help="How many columns must cover a row.")] = 1,
    seed: Annotated[int, typer.Option(help="Seed of the solver's random choices.", rich_help_panel=_SEARCH)] = 0,
    as_json: AsJson = False,
) -> None:
    """Solve a set-cover file with the solvers that choose the views, so that anyone can check them."""
    from cell.cover.solve_file import DEFAULT_S, solve_file

    outcome = solve_file(
        file,
        form=form,
        solver=solver,
        budget_s=budget,
        time_limit_s=time_limit,
        unicost=unicost,
        coverage=coverage,
        multiplicity=multiplicity,
        seed=seed,
    )
    if as_json:
        print_json(outcome.as_json())
    else:
        from cell.commands.terminal import Terminal, without

        terminal = Terminal()
        terminal.pairs(f"{outcome.path.name}: {outcome.sentence}", outcome.rows())
        again = ["cell", *sys.argv[1:]]
        if outcome.result.gap <= 0:
            terminal.then(f"{shlex.join(again)} --json > cover.json")
        elif solver != "auto":
            terminal.then(without(again, "--solver"))
        elif budget is None and time_limit is not None:
            terminal.then((*without(again, "--time-limit"), "--time-limit", f"{10 * time_limit:g}"))
        else:
            terminal.then((*without(again, "--budget"), "--budget", f"{10 * (budget or DEFAULT_S):g}"))
