"""`cell diff` as the command line gives it: options in, tables or one JSON object out."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cell.commands.options import AsJson, print_json

if TYPE_CHECKING:
    from cell.commands.terminal import Terminal
    from cell.diff.difference import Difference

EPILOG = (
    "Examples:\n\n"
    "cell diff sim_runs/trial sim_runs/other\n\n"
    "cell diff sim_runs/trial sim_runs/other --out diff.html\n\n"
    "cell diff sim_runs/trial/executions/0001 sim_runs/trial/executions/0002 --json\n\n"
    "A view is kept where the other run has one at the same pose to the part, moved where the other has one that "
    "measures mostly the same surface from elsewhere.\n\n"
    "Exit codes: 0 done, 2 usage, 6 files or run folder, 70 bug, 130 Ctrl-C."
)


def diff(
    a: Annotated[Path, typer.Argument(help="Run folder of a finished cell plan, or of an execution.")],
    b: Annotated[Path, typer.Argument(help="The other one, of the same kind.")],
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.html", help="A page to write: the part coloured by what is gained and lost."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compare two plans or two executions: settings, views, the surface that is gained and lost, time and clearance."""
    from cell.commands.terminal import Terminal
    from cell.diff.compare import compare

    terminal = Terminal(quiet_stdout=as_json)
    found = compare(a, b, terminal, out)
    if as_json:
        print_json(found.as_json())
    elif found.empty:
        terminal.say("nothing differs")
    else:
        _say(terminal, found)
        if out is not None:
            terminal.say(f"page: {out}")
        drawn = [("cell", "diff", a, b, "--out", "diff.html")] if out is None and found.surface is not None else []
        replayed = "cell", "replay", b.parent.parent, "--execution", b.name
        terminal.then(*drawn, ("cell", "scan", b) if found.kind == "plan" else replayed)


def _say(terminal: "Terminal", found: "Difference") -> None:
    from cell.diff.difference import shown

    if found.settings:
        terminal.grid(("setting", "A", "B"), [(each.key, shown(each.a), shown(each.b)) for each in found.settings])
    if found.numbers:
        terminal.grid(("figure", "A", "B"), [(each.name, shown(each.a), shown(each.b)) for each in found.numbers])
    views = found.views
    moved = [
        (f"{each.a} moved, now {each.b}", f"{each.distance_mm:.1f} mm, {each.angle_deg:.1f} deg, shares "
         f"{100 * each.shared:.0f} % of what either measures")
        for each in views.moved
    ]  # fmt: skip
    kept = _listed(f"{a}" if a == b else f"{a} as {b}" for a, b in views.kept)
    alone = [("only in A", _listed(map(str, views.lost))), ("only in B", _listed(map(str, views.new)))]
    terminal.pairs("Views, by their numbers in visiting order", [("kept", kept), *moved, *alone])
    surface = found.surface
    if surface is None:
        terminal.say("the two parts are not the same mesh: what is gained and lost of the surface cannot be said")
    else:
        share = 100 / surface.area_mm2
        terminal.say(
            f"B measures {surface.gained_mm2:.0f} mm2 ({share * surface.gained_mm2:.2f} %) that A does not, and misses "
            f"{surface.lost_mm2:.0f} mm2 ({share * surface.lost_mm2:.2f} %) that A measures."
        )


def _listed(numbers: Iterable[str]) -> str:
    return ", ".join(numbers) or "none"
