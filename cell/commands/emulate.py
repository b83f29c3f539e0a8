"""`cell emulate` on the command line: the protocol and options; prints the driver URL."""

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from cell.commands.options import from_fields
from cell.emulate.options import EmulateOptions
from cell.errors import UsageError

EPILOG = (
    "Examples:\n\n"
    "cell emulate serial --link /tmp/kr16 --state arm.json\n\n"
    "cell emulate modbus --port 5020 --time-scale 10\n\n"
    "cell emulate modbus --run sim_runs/trial --plant mujoco\n\n"
    "cell emulate modbus-rtu --faults drop=0.01,delay=0.02:0.3,estop@12.5 --seed 4 --log moves.jsonl\n\n"
    "The first line on stdout is the driver URL: cell scan sim_runs/trial --driver URL. Ctrl-C ends it."
)


@from_fields
def emulate(
    *,
    protocol: Annotated[str, typer.Argument(metavar="serial|modbus|modbus-rtu", help="Protocol of the controller.")],
    options: EmulateOptions,
) -> None:
    """Put a simulated controller behind a pseudo-terminal or a loopback socket, to be used like hardware."""
    from cell.emulate import emulator

    if protocol not in emulator.PROTOCOLS:
        raise UsageError(f"cell emulate {protocol}: unknown protocol; valid are: {', '.join(emulator.PROTOCOLS)}")
    if options.link is not None and protocol == "modbus":
        raise UsageError("--link is for pseudo-terminals; cell emulate modbus has --port")
    if options.port and protocol != "modbus":
        raise UsageError(f"--port is for cell emulate modbus; cell emulate {protocol} has --link")
    arm = emulator.load_arm(options.run, options.plant)
    emulator.emulate(protocol, options, arm, lambda url: _announce(url, options.run, options.time_scale))


def _announce(url: str, run: Path | None, time_scale: float) -> None:
    sys.stdout.write(url + "\n")
    sys.stdout.flush()
    sys.stderr.write("cell: an emulated arm, not a real one, answers there until Ctrl-C\n")
    scaled = "" if time_scale == 1.0 else f" --accept-time-scale {time_scale:g}"
    planned = "RUN" if run is None else shlex.quote(str(run))
    sys.stderr.write(f"next, in another terminal:\n  cell scan {planned} --driver {shlex.quote(url)}{scaled}\n")
