"""`cell plan` as the command line gives it: options in, a table or one JSON object out."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from cell.commands.options import AsJson, NoCache, OfScene, Part, RunToMake, SceneFile, from_fields, print_json
from cell.scene.file import scene_from_options
from cell.scene.model import PART
from cell.scene.options import flag

EPILOG = (
    "Examples:\n\n"
    "cell plan --place 1200,500,0\n\n"
    "cell plan part.stl --units mm --place 1200,500,0,90,0,0 --standoff 300 --faces 930 --coverage 0.95\n\n"
    "cell plan --scene my_cell.toml --seed 7 --json --out sim_runs/trial\n\n"
    "cell plan --open-of sim_runs/trial --place 1200,500,0,0,0,180\n\n"
    "cell plan --max-views 8 --curve\n\n"
    "cell plan --overlap 20% --coverage 0.98\n\n"
    "cell plan --pose-sd 0.5mm,0.1deg --alpha 0.05 --coverage 0.98\n\n"
    "Exit codes: 0 done, 2 usage or scene, 3 below the required coverage, 4 nothing reachable, 6 files, 70 bug, "
    "130 Ctrl-C."
)


@from_fields
def plan(
    *,
    part: Part = None,
    scene: SceneFile = None,
    wishes: OfScene,
    open_of: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="RUN",
            help="Another set-up: plan only what the views of this finished plan leave open, with the part where "
            "--place says. May be given several times.",
            rich_help_panel=PART,
        ),
    ] = None,
    out: RunToMake = None,
    as_json: AsJson = False,
    no_cache: NoCache = False,
) -> None:
    """Plan the views that measure a part: which, whether the robot reaches them, in which order, along which motion."""
    from cell import api
    from cell.commands.terminal import Terminal
    from cell.plan.report import table
    from cell.runs.digest import SHORT_DIGEST

    terminal = Terminal(quiet_stdout=as_json)
    if open_of:
        from cell.setups.beside import scene_beside

        checked = scene_beside(api.open_run(open_of[0]), scene, wishes, part, flag)
    else:
        checked = scene_from_options(scene, wishes, part, flag)
    run = api.plan(
        checked, scene=scene, out=out, open_of=open_of or (), use_cache=not no_cache, progress=terminal,
        argv=sys.argv[1:],
    )  # fmt: skip
    if as_json:
        print_json(run.as_json())
    else:
        rows = [*table(run.report), ("digest", run.digest[:SHORT_DIGEST]), ("run folder", str(run.folder))]
        terminal.pairs(f"View plan of {run.report.part.name}", rows)
        terminal.then(
            ("cell", "view", run.folder), ("cell", "scan", run.folder),
            ("cell", "why", run.folder), ("cell", "export", run.folder),
        )  # fmt: skip
    raise typer.Exit(run.exit_code)
