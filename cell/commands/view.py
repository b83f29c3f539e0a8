"""`cell view` as the command line gives it: a page in the browser."""

import time
from pathlib import Path
from typing import Annotated

import typer

from cell.errors import UsageError

EPILOG = (
    "Examples:\n\n"
    "cell view sim_runs/trial\n\n"
    "cell view sim_runs/trial/executions/0001 --out scan.html --no-open\n\n"
    "cell view my_cell.toml --watch\n\n"
    "cell view sim_runs/study-place\n\n"
    "cell view sim_runs/explore-20261122T101500Z\n\n"
    "A run is never changed: where its folder has no page, or --out is given, the page is written elsewhere. The file "
    "needs no server and no network.\n\n"
    "Exit codes: 0 done, 2 usage or scene, 6 files or run folder, 70 bug, 130 Ctrl-C."
)


def view(
    what: Annotated[
        Path | None,
        typer.Argument(
            metavar="[SCENE | RUN | EXECUTION | EXPLORATION | STUDY]",
            help="Scene file, run folder, executions/<id> of one, or folder of an exploration, of a study or of "
            "cell setups. Default: the built-in scene.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE.html", help="Where to write the page. Default: a temporary file.")
    ] = None,
    no_open: Annotated[bool, typer.Option("--no-open", help="Open no browser, print the path.")] = False,
    watch: Annotated[
        bool, typer.Option("--watch", help="Draw a scene again whenever its file is saved; ends with Ctrl-C.")
    ] = False,
) -> None:
    """See a scene, plan, execution, exploration or study in the browser: a file with robot, views and motion."""
    from cell.commands.terminal import Terminal
    from cell.view import looking

    terminal = Terminal()

    def opened(path: Path) -> None:
        if not no_open and not looking.open_browser(path):
            terminal.note("no browser could be opened; open the file in one")
        terminal.say(str(path))

    if watch and (what is None or what.is_dir()):
        raise UsageError("--watch draws a scene file again when it is saved; give one: cell view my_cell.toml --watch")
    if watch and what is not None:
        looking.watch(what, out, terminal, opened, time.sleep)
    elif what is not None and (what / "setups.json").is_file():
        from cell.setups.planned_setups import PlannedSetups

        if out is not None:
            raise UsageError(f"{what} holds several set-ups, each with a page of its own: leave --out away")
        for folder in PlannedSetups.opened(what).folders:
            opened(looking.page_of(folder, None, terminal))
        Terminal(quiet_stdout=True).then(("cell", "scan", what))
    else:
        opened(looking.page_of(what, out, terminal))
        if further := _next(what):
            Terminal(quiet_stdout=True).then(*further)


def _next(what: Path | None) -> list[tuple[object, ...]]:
    """What can be done with a scene, a run or an execution; of other folders the page itself says it."""
    from cell.runs.run import EXECUTIONS

    if what is None or not what.is_dir():
        return [("cell", "plan", *(["--scene", what] if what else []))]
    if (folder := what.absolute()).parent.name == EXECUTIONS:
        return [("cell", "replay", folder.parent.parent, "--execution", folder.name)]
    if not (what / "plan.json").is_file():
        return []
    return [("cell", "scan", what), ("cell", "why", what), ("cell", "edit", what, "--drop", 1)]
