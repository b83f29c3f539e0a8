"""`cell check` as the command line gives it: options in, a table or one JSON object out."""

from pathlib import Path
from typing import Annotated

import typer

from cell.commands.options import AsJson, Wishes, from_fields, print_json
from cell.scene.file import scene_from_options
from cell.scene.model import PART, Scene
from cell.scene.options import flag, option_specs

EPILOG = "Examples:\n\ncell check my_cell.toml\n\ncell check my_cell.toml --part part.stl --units mm --place 1200,500,0"


@from_fields
def check(
    *,
    scene: Annotated[
        Path | None, typer.Argument(help="Scene file (TOML). Default: the built-in scene.", show_default=False)
    ] = None,
    part: Annotated[
        str | None, typer.Option(help="As in cell plan: mesh file or built-in part.", rich_help_panel=PART)
    ] = None,
    wishes: Annotated[Wishes, option_specs(Scene, "units", "place", "collision")],
    as_json: AsJson = False,
) -> None:
    """Compile a scene, list contacts at home and the cell's numbers, and say what is wrong."""
    from cell.commands.terminal import Terminal
    from cell.world.checks import check_scene

    result = check_scene(scene_from_options(scene, wishes, part, flag))
    if as_json:
        print_json(result.summary())
    else:
        terminal = Terminal()
        terminal.pairs("Scene", result.rows())
        for problem in result.problems:
            terminal.error(f"wrong: {problem}")
        given = [f"{flag(name)}={text}" for name, text in wishes.items()]
        at = [] if scene is None else [scene]
        if result.problems:
            terminal.then(("cell", "check", *at, *(["--part", part] if part else []), *given))
        else:
            terminal.then(("cell", "plan", *([part] if part else []), *(["--scene", *at] if at else []), *given))
    raise typer.Exit(result.exit_code)
