"""`cell replay` as the command line gives it: options in, a table or one JSON object out."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from cell.commands.options import from_fields
from cell.replay.options import ReplayOptions

EPILOG = (
    "Examples:\n\n"
    "cell replay sim_runs/trial\n\n"
    "cell replay sim_runs/trial --execution latest --view 3 --speed 0.5\n\n"
    "cell replay sim_runs/trial --tightest --picture tight.png\n\n"
    "cell replay sim_runs/trial --picture tour.png --size 1600x1200 --camera -60,20 --hide post\n\n"
    "Keys: space pause, left and right step from view to view, up and down speed, home start, end tightest moment.\n\n"
    "Exit codes: 0 done, 2 usage (also: no display for the viewer), 6 files or run folder, 70 bug, 130 Ctrl-C."
)


@from_fields
def replay(
    *,
    run: Annotated[Path, typer.Argument(help="Run folder of cell plan; a failed one (.part) too.")],
    options: ReplayOptions,
) -> None:
    """Show a run: the arm on its motion, the scanner's frustum at each stop, the points of an execution."""
    from cell.commands.terminal import Terminal
    from cell.replay.replay import replay as run_replay

    made = run_replay(run, options, Terminal())
    if made:
        sys.stdout.write(made + "\n")
    Terminal(quiet_stdout=True).then(("cell", "scan" if options.execution is None else "why", run))
