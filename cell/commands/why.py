"""`cell why` as the command line gives it: options in, a table or one JSON object out."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cell.commands.options import AsJson, RunFolder, print_json

if TYPE_CHECKING:
    from cell.commands.terminal import Terminal

EPILOG = (
    "Examples:\n\n"
    "cell why sim_runs/trial\n\n"
    "cell why sim_runs/trial --samples 20000 --json\n\n"
    "cell why sim_runs/trial --advise\n\n"
    "Writes why.json, why.ply, why.png and view.html to why/ in the run folder; the plan is not changed.\n\n"
    "Exit codes: 0 done, 2 usage, 6 files or run folder, 70 bug, 130 Ctrl-C."
)


def why(
    run: RunFolder,
    samples: Annotated[
        int | None,
        typer.Option(metavar="N", help="Number of surface samples. Default: 100,000, as in coverage."),
    ] = None,
    advise: Annotated[
        bool,
        typer.Option("--advise", help="Instead of causes: gain of a second set-up or of another placement."),
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Explain the uncovered surface by cause and area, with the smallest single change that would measure it."""
    from cell.commands.terminal import Terminal, without
    from cell.runs.run import open_run
    from cell.why.explain import TABLE_COLUMNS, explain, table_rows

    terminal = Terminal(quiet_stdout=as_json)
    if advise:
        _advise(run, terminal, as_json=as_json)
        return
    outcome = explain(run, terminal, samples=samples)
    if as_json:
        print_json(outcome.summary.as_json())
    else:
        summary = outcome.summary
        if summary.groups:
            title = f"Uncovered surface of {summary.part}: {100 * summary.open:.2f} %"
            terminal.grid(TABLE_COLUMNS, table_rows(summary), title)
        else:
            terminal.say("the whole surface is covered")
        terminal.say(f"files: {outcome.folder}")
        settings = [change.setting for group in summary.groups for change in group.changes]
        better = [tuple(shlex.split(setting)) for setting in settings if setting.startswith("--")][:1]
        planned = [word for word in without(open_run(run).manifest.argv, "--out") if word != "--json"]
        again = [("cell", *without(planned, setting[0]), *setting) for setting in better if planned[:1] == ["plan"]]
        terminal.then(*again, ("cell", "scan", run))


def _advise(run: Path, terminal: "Terminal", *, as_json: bool) -> None:
    from cell.runs.run import open_finished  # kept out of the start-up of --help
    from cell.why.advise import advise

    visible, found = advise(open_finished(run), terminal)
    if as_json:
        content = {"visible": visible, "advice": [advice.as_json() for advice in found]}
        print_json(content)
        return
    rows = [
        (str(number), advice.what, f"{100 * advice.share:.2f} % (+- {100 * advice.standard_error:.2f})")
        for number, advice in enumerate(found, 1)
    ]
    title = f"This plan measures {100 * visible:.2f} % of the surface"
    terminal.grid(("", "change", "coverage by any pose"), rows, title)
    for number, advice in enumerate(found, 1):
        terminal.say(f"{number}: {advice.command}")
