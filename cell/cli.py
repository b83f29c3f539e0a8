"""The command line: which commands there are, and how a run of one ends. Each command is a file of `cell.commands`.

Exit codes: 0 done, 2 usage or scene, 3 below the required coverage, 4 nothing reachable, 5 driver, 6 files or run
folder, 70 a bug, 130 Ctrl-C, SIGTERM or SIGHUP. Heavy modules are imported inside the commands, so that `--help`
answers at once.
"""

import atexit
import gc
import os
import sys
from contextlib import suppress
from importlib.metadata import version
from typing import Annotated

import typer

from cell import signals
from cell.commands import (
    calibrate,
    check,
    diff,
    edit,
    emulate,
    explore,
    export,
    locate,
    part,
    place,
    plan,
    replay,
    robot,
    scan,
    sensors,
    setups,
    study,
    view,
    why,
)
from cell.commands.failures import guarded
from cell.commands.options import add_moved

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    epilog="Start with: [bold]cell plan --place 1200,500,0[/bold]",
)


def _say_version(asked: bool) -> None:
    if asked:
        typer.echo(f"scan-cell {version('scan-cell')}")
        raise typer.Exit


@app.callback()
def cell(
    _version: Annotated[
        bool, typer.Option("--version", callback=_say_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Plan, check and time the views that measure a part with a laser scanner on a six-axis robot."""


app.command(epilog=plan.EPILOG)(plan.plan)
app.command(epilog=setups.EPILOG)(setups.setups)
app.command(epilog=check.EPILOG)(check.check)
app.command(epilog=robot.EPILOG)(robot.robot)
app.command(epilog=sensors.EPILOG)(sensors.sensors)
app.command(epilog=part.EPILOG)(part.part)
app.command(epilog=view.EPILOG)(view.view)
app.command(epilog=replay.EPILOG)(replay.replay)
app.command(epilog=scan.EPILOG)(scan.scan)
app.command(epilog=explore.EPILOG)(explore.explore)
app.command(epilog=why.EPILOG)(why.why)
app.command(epilog=diff.EPILOG)(diff.diff)
app.command(epilog=edit.EPILOG)(edit.edit)
app.command(epilog=locate.EPILOG)(locate.locate)
app.add_typer(calibrate.app, name="calibrate")
app.add_typer(study.app, name="study")
app.command(epilog=place.EPILOG)(place.place)
app.command(epilog=export.EPILOG)(export.export)
app.command(epilog=emulate.EPILOG)(emulate.emulate)
add_moved(app, "cover", "cell cover", "python -m benchmarks cover solve FILE")


def main(argv: list[str] | None = None) -> int:
    """Entry point of the console script: runs a command and turns every failure into one sentence and its exit code."""
    gc.set_threshold(50_000)  # at 700, importing alone has it look through every loaded module again and again: 0.13 s
    atexit.register(gc.freeze)  # at the end Python would look through them once more: 0.25 s
    signals.end_politely()
    words = sys.argv[1:] if argv is None else argv
    code = guarded(lambda: app(args=words, prog_name="cell", standalone_mode=False), as_json="--json" in words)
    if code == signals.INTERRUPTED:
        # The interrupt may have come between a ray engine and its threads: leave without taking them down in order.
        with suppress(OSError):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(code)
    sys.exit(code)


if __name__ == "__main__":
    main()
