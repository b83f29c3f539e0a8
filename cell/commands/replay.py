"""`cell replay` as the command line gives it: options in, a table or one JSON object out."""

import math
import sys
from pathlib import Path
from typing import Annotated

import typer

from cell.errors import UsageError

EPILOG = (
    "Examples:\n\n"
    "cell replay sim_runs/trial\n\n"
    "cell replay sim_runs/trial --execution latest --view 3 --speed 0.5\n\n"
    "cell replay sim_runs/trial --tightest --picture tight.png\n\n"
    "cell replay sim_runs/trial --picture tour.png --size 1600x1200 --camera -60,20 --hide post\n\n"
    "Keys: space pause, left and right step from view to view, up and down speed, home start, end tightest moment.\n\n"
    "Exit codes: 0 done, 2 usage (also: no display for the viewer), 6 files or run folder, 70 bug, 130 Ctrl-C."
)


def replay(
    run: Annotated[Path, typer.Argument(help="Run folder of cell plan; a failed one (.part) too.")],
    execution: Annotated[
        str | None, typer.Option(metavar="ID", help="Replay an execution of it: an id, or latest. Default: the plan.")
    ] = None,
    view: Annotated[
        int | None, typer.Option(metavar="N", help="Begin at this view, counted from 1 in visiting order.")
    ] = None,
    tightest: Annotated[
        bool, typer.Option("--tightest", help="Begin at the moment at which two things are nearest.")
    ] = False,
    speed: Annotated[float, typer.Option(help="Seconds of the motion for each second.")] = 1.0,
    once: Annotated[bool, typer.Option("--once", help="Close the viewer at the end.")] = False,
    frames: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Draw PNG frames into a folder; needs no display.")
    ] = None,
    fps: Annotated[float, typer.Option(help="Frames for each second of film.")] = 25.0,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Draw one still of the whole tour; needs no display.")
    ] = None,
    camera: Annotated[
        str | None,
        typer.Option(metavar="AZ,EL", help="With --picture: camera's azimuth and elevation from the part, deg."),
    ] = None,
    hide: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="With --picture: leave out robot, post, a fixture, ...")
    ] = None,
    size: Annotated[str, typer.Option(metavar="WxH", help="Size of frames and picture in pixels.")] = "960x720",
) -> None:
    """Show a run: the arm on its motion, the scanner's frustum at each stop, the points of an execution."""
    from cell.commands.terminal import Terminal
    from cell.replay.replay import ReplayOptions
    from cell.replay.replay import replay as run_replay

    width, cross, height = size.lower().partition("x")
    if not (cross and width.isdecimal() and height.isdecimal()):
        raise UsageError(f"--size {size} must be width x height in pixels, for instance --size 960x720")
    wanted = ReplayOptions(
        execution, view, tightest, speed, frames, picture, fps, (int(width), int(height)), once,
        None if camera is None else _angles(camera), tuple(hide or ()),
    )  # fmt: skip
    made = run_replay(run, wanted, Terminal())
    if made:
        sys.stdout.write(made + "\n")
    Terminal(quiet_stdout=True).then(("cell", "scan" if execution is None else "why", run))


def _angles(text: str) -> tuple[float, float]:
    """Azimuth and elevation of `--camera`."""
    try:
        azimuth, elevation = (float(angle) for angle in text.split(","))
    except ValueError:
        azimuth = elevation = math.nan
    if not (abs(azimuth) <= 360 and abs(elevation) <= 89):
        raise UsageError(f"--camera {text} must be azimuth,elevation in degrees, for instance --camera -60,20")
    return azimuth, elevation
