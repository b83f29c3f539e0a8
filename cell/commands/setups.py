"""`cell setups` as the command line gives it: a part in, the poses it is measured in and their plans out."""

import sys
from typing import Annotated

import typer

from cell.commands.options import AsJson, NoCache, Part, RunToMake, SceneFile, Wishes, from_fields, print_json
from cell.scene.file import scene_from_options
from cell.scene.model import Scene
from cell.scene.options import flag, option_specs
from cell.setups.options import SetupOptions

EPILOG = (
    "Examples:\n\n"
    "cell setups part.stl --units mm --place 1200,500,0\n\n"
    "cell setups mug --most 2 --offer 8 --coverage 0.95 --json\n\n"
    "cell setups mug --cost time --setup-seconds 300\n\n"
    "cell setups mug --table --offer 6\n\n"
    "cell setups mug --offer 4 --pin 0:168 --ban 0:1506\n\n"
    "Each set-up is a run folder of its own in FOLDER/setups; cell scan FOLDER scans one after the other.\n\n"
    "Exit codes: 0 done, 2 usage or scene, 3 below the required coverage, 4 nothing reachable, 6 files, 70 bug, "
    "130 Ctrl-C."
)

_OfScene = Annotated[
    Wishes, {name: offer for name, offer in option_specs(Scene).items() if name not in option_specs(SetupOptions)}
]


@from_fields
def setups(
    *,
    part: Part = None,
    scene: SceneFile = None,
    wishes: _OfScene,
    options: SetupOptions,
    out: RunToMake = None,
    as_json: AsJson = False,
    no_cache: NoCache = False,
) -> None:
    """Plan several set-ups of a part as one cover: fewest set-ups, then fewest views, each with a bound."""
    from cell import api
    from cell.commands.terminal import Terminal
    from cell.setups.report import rows

    terminal = Terminal(quiet_stdout=as_json)
    checked = scene_from_options(scene, wishes, part, flag)
    made = api.plan_setups(
        checked, options, scene=scene, out=out, use_cache=not no_cache, progress=terminal,
        argv=sys.argv[1:],
    )  # fmt: skip
    if as_json:
        print_json(made.as_json())
    else:
        terminal.pairs(f"Set-ups of {made.file.part}", [*rows(made.file), ("folder", str(made.folder))])
        terminal.then(("cell", "scan", made.folder, "--setup", 1), ("cell", "view", made.folder))
    raise typer.Exit(made.exit_code)
