"""`cell emulate` as the command line gives it: one argument, the protocol, and options; prints the driver URL."""

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from cell.errors import UsageError

_LINE = "The line"
_FAULTS = "What goes wrong"

EPILOG = (
    "Examples:\n\n"
    "cell emulate serial --link /tmp/kr16 --state arm.json\n\n"
    "cell emulate modbus --port 5020 --time-scale 10\n\n"
    "cell emulate modbus --run sim_runs/trial --plant mujoco\n\n"
    "cell emulate modbus-rtu --faults drop=0.01,delay=0.02:0.3,estop@12.5 --seed 4 --log moves.jsonl\n\n"
    "The first line on stdout is the driver URL: cell scan sim_runs/trial --driver URL. Ctrl-C ends it."
)


def emulate(
    protocol: Annotated[str, typer.Argument(metavar="serial|modbus|modbus-rtu", help="What the controller speaks.")],
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="TCP port on 127.0.0.1; 0 takes a free one.", rich_help_panel=_LINE)
    ] = 0,
    link: Annotated[
        Path | None,
        typer.Option(metavar="PATH", help="Symbolic link to the pseudo-terminal.", rich_help_panel=_LINE),
    ] = None,
    baud: Annotated[int, typer.Option(help="Baud rate of the pseudo-terminal.", rich_help_panel=_LINE)] = 115200,
    unit: Annotated[int, typer.Option(min=1, max=247, help="Modbus device address.", rich_help_panel=_LINE)] = 1,
    run: Annotated[
        Path | None,
        typer.Option(metavar="RUN", help="Run folder whose arm, tool and home it is. Default: the built-in arm's."),
    ] = None,
    plant: Annotated[str, typer.Option(metavar="ideal|mujoco", help="What the controller moves.")] = "ideal",
    start: Annotated[
        str | None,
        typer.Option(
            metavar="A1,...,A6", help="Axes at which the arm stands at its very first start, deg. Default: home."
        ),
    ] = None,
    state: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Keeps the arm's position across restarts.")
    ] = None,
    log: Annotated[Path | None, typer.Option(metavar="FILE", help="Appends each executed move, JSON lines.")] = None,
    time_scale: Annotated[float, typer.Option(help="Seconds of the arm per second. Watchdogs stay real.")] = 1.0,
    faults: Annotated[
        str,
        typer.Option(
            metavar="LIST",
            help="NAME=PROBABILITY[:SECONDS] or NAME@SECONDS[:SECONDS], joined by commas; drop, delay, duplicate, "
            "reorder, corrupt, truncate, exception, half-open, reboot, estop.",
            rich_help_panel=_FAULTS,
        ),
    ] = "",
    seed: Annotated[int, typer.Option(min=0, help="Seed of the faults.", rich_help_panel=_FAULTS)] = 0,
    seconds: Annotated[float | None, typer.Option(help="End after this time. Default: at Ctrl-C.")] = None,
) -> None:
    """Put a simulated controller behind a pseudo-terminal or a loopback socket, to be spoken to as hardware is."""
    from cell.emulate import emulator

    if protocol not in emulator.PROTOCOLS:
        raise UsageError(f"cell emulate {protocol}: there is no such protocol; one of {', '.join(emulator.PROTOCOLS)}")
    if link is not None and protocol == "modbus":
        raise UsageError("--link is for pseudo-terminals; cell emulate modbus has --port")
    if port and protocol != "modbus":
        raise UsageError(f"--port is for cell emulate modbus; cell emulate {protocol} has --link")
    if not 1e-3 <= time_scale <= 1e6:
        raise UsageError(f"--time-scale {time_scale:g} must be at least 0.001 and at most 1e6")
    settings = emulator.Settings(
        protocol, port, link, baud, unit, faults, seed, time_scale, state, log, _counts(start), seconds
    )  # fmt: skip
    emulator.emulate(settings, emulator.arm_of(run, plant), lambda url: _announce(url, run, time_scale))


def _counts(start: str | None) -> tuple[int, ...] | None:
    """The set-points of `--start`; None where it was not given."""
    import numpy as np

    from drivers.errors import DriverError
    from drivers.setpoints import from_rad

    if start is None:
        return None
    try:
        axes = [float(piece) for piece in start.split(",")]
    except ValueError:
        axes = []
    if len(axes) != 6:
        raise UsageError(f"--start {start} must be six numbers, A1 to A6 in deg, for instance 0,-90,90,0,90,0")
    try:
        return tuple(from_rad(np.radians(axes)).tolist())
    except DriverError as error:
        raise UsageError(f"--start: {error}") from error


def _announce(url: str, run: Path | None, time_scale: float) -> None:
    sys.stdout.write(url + "\n")
    sys.stdout.flush()
    sys.stderr.write("cell: an emulated arm, no machine, answers there until Ctrl-C\n")
    scaled = "" if time_scale == 1.0 else f" --accept-time-scale {time_scale:g}"
    planned = "RUN" if run is None else shlex.quote(str(run))
    sys.stderr.write(f"next, in another terminal:\n  cell scan {planned} --driver {shlex.quote(url)}{scaled}\n")
