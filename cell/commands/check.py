"""`cell check` as the command line gives it: options in, a table or one JSON object out."""

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from cell.commands import options

EPILOG = "Examples:\n\ncell check my_cell.toml\n\ncell check my_cell.toml --part part.stl --units mm --place 1200,500,0"


def check(
    scene: Annotated[
        Path | None, typer.Argument(help="Scene file (TOML). Default: the built-in scene.", show_default=False)
    ] = None,
    part: Annotated[str | None, typer.Option(help="As in cell plan: mesh file or built-in part.")] = None,
    units: Annotated[str | None, typer.Option(help="Unit of the mesh file.")] = None,
    place: Annotated[str | None, typer.Option(metavar="X,Y,Z[,A,B,C]", help="As in cell plan.")] = None,
    collision: Annotated[str | None, typer.Option(help="As in cell plan: hull, decomposed or exact.")] = None,
    preset: options.Preset = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")] = False,
) -> None:
    """Compile a scene, list contacts at home and the cell's numbers, and say what is wrong."""
    from cell.commands.terminal import Terminal
    from cell.scene.scene import load_scene
    from cell.world.check import check_scene

    tables: dict[str, dict[str, Any]] = {"part": {}, "placement": {}, "plan": {**options.preset(preset)}}
    if part is not None:
        tables["part"] = options.part(part, units)
    if place is not None:
        tables["placement"] = options.placement(place)
    if collision is not None:
        tables["plan"]["collision"] = collision
    with options.named_as_options(tables):
        checked = load_scene(scene, tables)
    result = check_scene(checked)
    if as_json:
        sys.stdout.write(json.dumps(result.summary(), indent=2, allow_nan=False) + "\n")
    else:
        terminal = Terminal()
        terminal.pairs("Scene", result.rows())
        for problem in result.problems:
            terminal.error(f"wrong: {problem}")
    raise typer.Exit(result.exit_code)
