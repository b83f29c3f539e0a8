"""`cell explore` as the command line gives it: options in, a table or one JSON object out."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from cell.commands.options import AsJson, OfScene, Part, SceneFile, Wishes, from_fields, print_json
from cell.explore.options import OF_SCAN, ExploreOptions
from cell.scan.options import ScanOptions
from cell.scene.file import scene_from_options
from cell.scene.options import flag, option_specs, parse_options

EPILOG = (
    "Examples:\n\n"
    "cell explore mug --place 1200,500,0\n\n"
    "cell explore part.stl --units mm --place 1200,500,0 --policy two-stage --out sim_runs/first\n\n"
    "cell explore --cylinder 200,120 --place 1100,300,60 --acquire command:./take --points-frame scanner "
    "--points-units mm --driver modbus://192.168.0.10:502\n\n"
    "The same command with the same --out goes on where it was stopped.\n\n"
    "Exit codes: 0 done, 2 usage or scene, 4 nothing reachable, 5 driver, 6 files or points that cannot be, 70 bug, "
    "130 Ctrl-C."
)

OfScan = Annotated[Wishes, option_specs(ScanOptions, *OF_SCAN)]


@from_fields
def explore(
    *,
    part: Part = None,
    scene: SceneFile = None,
    options: ExploreOptions,
    scanning: OfScan,
    wishes: OfScene,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder to make, or to go on in. Default: sim_runs/explore-<UTC>.", rich_help_panel="Output"),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Measure a part that nobody has a model of: a first ring of views, then what stays open, a batch at a time.

    PART stands in the cell and is hidden from the planning. --max-views is the budget of views.
    """
    from cell import api
    from cell.commands.terminal import Terminal

    terminal = Terminal(quiet_stdout=as_json)
    checked = scene_from_options(scene, wishes, part, flag)
    ask = terminal.ask if sys.stdin.isatty() and sys.stderr.isatty() else None
    scans = parse_options(ScanOptions, scanning, flag)
    done = api.explore(checked, options, scanning=scans, out=out, progress=terminal, argv=sys.argv[1:], ask=ask)
    if as_json:
        print_json(done.file.as_json())
        return
    terminal.pairs(f"Exploration of {done.file.part}", [*done.file.rows(), ("folder", str(done.folder))])
    if done.place is not None:
        place = ",".join(f"{value:g}" for value in done.place)
        terminal.then(("cell", "plan", done.folder / done.file.model, "--units", "mm", "--place", place))
