"""`cell diff` as the command line gives it: options in, tables or one JSON object out."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cell.commands.options import AsJson, print_json

if TYPE_CHECKING:
    from cell.commands.terminal import Terminal
    from cell.report.diff import Difference

EPILOG = (
    "Examples:\n\n"
    "cell diff sim_runs/trial sim_runs/other\n\n"
    "cell diff sim_runs/trial sim_runs/other --out diff.html\n\n"
    "cell diff sim_runs/trial/executions/0001 sim_runs/trial/executions/0002 --json\n\n"
    "A view is kept if the other run has one at the same pose relative to the part, and moved if the other run has one "
    "that measures mostly the same surface from another pose.\n\n"
    "Exit codes: 0 done, 2 usage, 6 files or run folder, 70 bug, 130 Ctrl-C."
)


def diff(
    a: Annotated[Path, typer.Argument(help="Run folder of a finished cell plan, or of an execution.")],
    b: Annotated[Path, typer.Argument(help="The other one, of the same kind.")],
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.html", help="Page to write: the part coloured by gained and lost surface."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compare two plans or two executions: settings, views, gained and lost surface, time and clearance."""
    from cell.commands.terminal import Terminal
    from cell.report.diff import compare_runs

    terminal = Terminal(quiet_stdout=as_json)
    difference = compare_runs(a, b, terminal, out)
    if as_json:
        print_json(difference.as_json())
    elif difference.is_empty:
        terminal.say("nothing differs")
    else:
        _print_tables(terminal, difference)
        if out is not None:
            terminal.say(f"page: {out}")
        drawn = [("cell", "diff", a, b, "--out", "diff.html")] if out is None and difference.surface is not None else []
        replayed = "cell", "replay", b.parent.parent, "--execution", b.name
        terminal.then(*drawn, ("cell", "scan", b) if difference.kind == "plan" else replayed)


def _print_tables(terminal: "Terminal", difference: "Difference") -> None:
    from cell.report.diff import format_value

    if difference.settings:
        terminal.grid(
            ("setting", "A", "B"),
            [(each.key, format_value(each.a), format_value(each.b)) for each in difference.settings],
        )
    if difference.numbers:
        terminal.grid(
            ("figure", "A", "B"),
            [(each.name, format_value(each.a), format_value(each.b)) for each in difference.numbers],
        )
    views = difference.views
    moved = [
        (f"{each.a} moved, now {each.b}", f"{each.distance_mm:.1f} mm, {each.angle_deg:.1f} deg, shared area "
         f"{100 * each.shared:.0f} % of the union")
        for each in views.moved
    ]  # fmt: skip
    kept = _listed(f"{a}" if a == b else f"{a} as {b}" for a, b in views.kept)
    alone = [("only in A", _listed(map(str, views.lost))), ("only in B", _listed(map(str, views.new)))]
    terminal.pairs("Views, by their numbers in visiting order", [("kept", kept), *moved, *alone])
    surface = difference.surface
    if surface is None:
        terminal.say("the two parts are different meshes: gained and lost surface cannot be computed")
    else:
        share = 100 / surface.area_mm2
        terminal.say(
            f"B measures {surface.gained_mm2:.0f} mm2 ({share * surface.gained_mm2:.2f} %) that A does not, and misses "
            f"{surface.lost_mm2:.0f} mm2 ({share * surface.lost_mm2:.2f} %) that A measures."
        )


def _listed(numbers: Iterable[str]) -> str:
    return ", ".join(numbers) or "none"
