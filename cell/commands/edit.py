"""`cell edit` as the command line gives it: options in, a table and what the edit gains or costs out."""

import sys
from typing import TYPE_CHECKING

import typer

from cell.commands.options import AsJson, RunFolder, RunToMake, from_fields, print_json
from cell.edit.options import Edit

if TYPE_CHECKING:
    from cell.report.diff import Difference

EPILOG = (
    "Examples:\n\n"
    "cell edit sim_runs/trial --drop 4 --repair\n\n"
    "cell edit sim_runs/trial --turn 7:90 --keep-order --out sim_runs/turned\n\n"
    "cell edit sim_runs/trial --move 7:812,430,655,90,0,180\n\n"
    "cell edit sim_runs/trial --add-candidate 533 --add-pose 812,430,655,90,0,180\n\n"
    "Views are named by their numbers in visiting order (the column stop of report.md). The plan that is edited stays "
    "as it is.\n\n"
    "Exit codes: 0 done, 2 usage, 3 below the required coverage, 4 the arm cannot, 6 files or run folder, 70 bug, "
    "130 Ctrl-C."
)


@from_fields
def edit(
    *,
    run: RunFolder,
    wanted: Edit,
    out: RunToMake = None,
    as_json: AsJson = False,
) -> None:
    """Change a plan by hand: drop, move, turn, add or reorder views. The result is a new run with its own checks."""
    from cell import api
    from cell.commands.terminal import Terminal
    from cell.plan.report import table
    from cell.report.diff import compare_runs

    terminal = Terminal(quiet_stdout=as_json)
    planned = api.open_run(run)
    made = planned.edited(wanted, out=out, progress=terminal, argv=sys.argv[1:])
    against = compare_runs(run, made.folder, terminal)
    if as_json:
        found = made.as_json() | {"against": against.as_json()}
        print_json(found)
    else:
        rows = [*table(made.report), (f"against {run}", sentence(against)), ("run folder", str(made.folder))]
        terminal.pairs(f"Edited view plan of {made.report.part.name}", rows)
        lost = against.surface is not None and against.surface.lost_mm2 > against.surface.gained_mm2
        alone = planned.is_single_setup
        repaired = [("cell", "edit", made.folder, "--repair")] if lost and not wanted.repair and alone else []
        terminal.then(("cell", "scan", made.folder), *repaired, ("cell", "diff", run, made.folder))
    raise typer.Exit(made.exit_code)


def sentence(found: "Difference") -> str:
    """What the second plan gains or costs, in a line."""
    if found.is_empty:
        return "nothing differs"
    of = {number.name: (number.a, number.b) for number in found.numbers}
    said = []
    if found.surface is not None:
        gained, lost = found.surface.gained_mm2, found.surface.lost_mm2
        said.append(f"gains {gained:,.0f} mm2 and loses {lost:,.0f} mm2 of the surface")
    for name, text in (
        ("views", "{:.0f} views instead of {:.0f}"),
        ("visible %", "visible {:.2f} % instead of {:.2f} %"),
        ("motion s", "motion {:.2f} s instead of {:.2f} s"),
        ("smallest clearance mm", "nearest {:.1f} mm instead of {:.1f} mm"),
    ):
        a, b = of.get(name, (None, None))
        if a is not None and b is not None:
            said.append(text.format(b, a))
    return "; ".join(said)
