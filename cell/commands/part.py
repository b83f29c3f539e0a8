"""`cell part` as the command line gives it: a part's file in, its faces as a table, a picture and a page out."""

import tempfile
from pathlib import Path
from typing import Annotated

import typer

from cell.commands.options import AsJson, Wishes, from_fields, print_json
from cell.scene.model import Scene
from cell.scene.options import option_specs

EPILOG = (
    "Examples:\n\n"
    "cell part bracket.stp\n\n"
    "cell part bracket.stp --json --out looked\n\n"
    "cell part casting.stl --units mm\n\n"
    "The numbers are those that [[region]] of a scene file takes (docs/step_and_regions.md). STEP needs cascadio: "
    "pip install 'scan-cell[step]'.\n\n"
    "Exit codes: 0 done, 2 usage, 6 files, 70 bug, 130 Ctrl-C."
)


@from_fields
def part(
    *,
    file: Annotated[
        str, typer.Argument(metavar="FILE", help="STEP or mesh file, or a built-in part.", show_default=False)
    ],
    wishes: Annotated[Wishes, option_specs(Scene, "units")],
    out: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Where view.html and faces.png are written. Default: a temporary folder."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List the faces of a CAD part with their numbers, kinds and sizes, draw them, and check the part."""
    from cell.commands.terminal import Terminal
    from cell.part import workpiece
    from cell.part.described import described, heading_and_rows, summary
    from cell.view.looking import write
    from cell.view.part_page import faces_picture, part_page

    terminal = Terminal(quiet_stdout=as_json)
    units = wishes.get("units")
    loaded = workpiece.load(file, None if units is None else str(units))
    folder = Path(tempfile.mkdtemp(prefix="cell-part-")) if out is None else out
    words = ["cell", "plan", file, *([f"--units={units}"] if units else [])]
    with terminal.stage("draw the part"):
        page = write(part_page(loaded, described(loaded), " ".join(words)), folder / "view.html")
        if loaded.cad is not None:
            faces_picture(folder / "faces.png", loaded, loaded.cad)
    if as_json:
        print_json(summary(loaded))
        return
    if loaded.cad is not None:
        heading, rows = heading_and_rows(loaded, loaded.cad)
        terminal.grid(heading, rows, at_most=len(rows))
    drawn = [("picture", str(folder / "faces.png"))] if loaded.cad is not None else []
    terminal.pairs(f"Part {loaded.name}", [*described(loaded), *drawn, ("page", str(page))])
    terminal.then(words)
