"""Options of `cell emulate`, checked."""

from typing import Annotated

from pydantic import Field

from cell.scene.fields import OptionalPath, Table
from cell.scene.options import Option

_LINE, _FAULTS = "The line", "Faults"


class EmulateOptions(Table):
    """Line, arm, files and faults of an emulated controller."""

    port: Annotated[
        int, Field(ge=0, le=65535), Option("TCP port on 127.0.0.1; 0 selects a free one.", _LINE, metavar="N")
    ] = 0
    link: Annotated[OptionalPath, Option("Symbolic link to make for the pseudo-terminal.", _LINE, metavar="PATH")] = (
        None
    )
    baud: Annotated[int, Option("Baud rate of the pseudo-terminal.", _LINE)] = 115200
    cycle_ms: Annotated[int, Field(ge=4, le=12), Option("rsi: time between telegrams, 4 or 12 ms.", _LINE)] = 4
    unit: Annotated[int, Field(ge=1, le=247), Option("Modbus device address.", _LINE)] = 1
    run: Annotated[
        OptionalPath, Option("Run folder with arm, tool and home. Default: the built-in arm.", metavar="RUN")
    ] = None
    plant: Annotated[str, Option("Plant that the controller moves.", metavar="ideal|mujoco")] = "ideal"
    start_deg: Annotated[
        tuple[float, float, float, float, float, float] | None,
        Field(strict=False),
        Option(
            "Axes of the arm at its very first start, deg. Default: home.",
            metavar="A1,...,A6",
            form="six numbers, A1 to A6 in deg",
            examples=("0,-90,90,0,90,0",),
            counts=(6,),
        ),
    ] = None
    state: Annotated[OptionalPath, Option("Stores the arm's position across restarts.", metavar="FILE")] = None
    log: Annotated[OptionalPath, Option("Appends each executed move, JSON lines.", metavar="FILE")] = None
    time_scale: Annotated[
        float, Field(ge=1e-3, le=1e6), Option("Seconds of the arm per real second. Watchdogs stay in real time.")
    ] = 1.0
    faults: Annotated[
        str,
        Option(
            "NAME=PROBABILITY[:SECONDS] or NAME@SECONDS[:SECONDS], joined by commas; drop, delay, duplicate, reorder, "
            "corrupt, truncate, exception, half-open, reboot, estop.",
            _FAULTS,
            metavar="LIST",
        ),
    ] = ""
    seed: Annotated[int, Field(ge=0), Option("Seed of the faults.", _FAULTS)] = 0
    seconds: Annotated[float | None, Option("End after this time. Default: at Ctrl-C.", metavar="S")] = None
