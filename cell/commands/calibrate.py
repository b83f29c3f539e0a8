"""`cell calibrate ...` as the command line gives it: scans in, lines of a scene file out."""

from pathlib import Path
from typing import Annotated

import typer

from cell.commands.options import AsJson, from_fields, print_json
from cell.metrology.options import HandEyeOptions

app = typer.Typer(
    no_args_is_help=True, rich_markup_mode="rich", help="Measure what the scene file says of the cell itself."
)

EPILOG = (
    "Examples:\n\n"
    "cell calibrate hand-eye raw/0001.ply raw/0002.ply raw/0003.ply raw/0004.ply --points-units m --diameter 38.1\n\n"
    "cell calibrate hand-eye 1.ply 2.ply 3.ply 4.ply --target plane --points-units mm --poses flange.csv\n\n"
    "The target stays where it is; the flange is turned about at least two axes, and sees it in the corners of the "
    "field of view, from near and far (docs/acquisition.md).\n\n"
    "Exit codes: 0 done, 2 usage or not determined, 6 files, 70 bug, 130 Ctrl-C."
)
_OPEN = 2


@app.callback()
def _group() -> None:
    """Keeps the word hand-eye although it is the only one."""


@from_fields
def hand_eye(
    *,
    files: Annotated[
        list[Path],
        typer.Argument(metavar="SCAN...", help="Scans of the target, scanner frame (PLY, XYZ, TXT or PCD)."),
    ],
    wanted: HandEyeOptions,
    as_json: AsJson = False,
) -> None:
    """Find the mount (flange to scanner) from scans of a sphere or a plane from several poses."""
    from cell import api
    from cell.commands.terminal import Terminal

    terminal = Terminal(quiet_stdout=as_json)
    found = api.hand_eye(files, wanted, progress=terminal)
    if as_json:
        print_json(found.as_json())
    else:
        terminal.pairs(f"Mount from {len(files)} scans of a {found.target}", found.rows())
        if not found.undetermined:
            terminal.say(found.lines)
    if found.undetermined:
        terminal.note(
            "these poses do not determine the mount; scan the target from poses that are turned about other axes, with "
            "the target elsewhere in the field of view"
        )
        raise typer.Exit(_OPEN)


app.command("hand-eye", epilog=EPILOG)(hand_eye)
