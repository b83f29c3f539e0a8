"""Validated options of `cell export`."""

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from cell.runs.current_files import CurrentFiles
from cell.scene.fields import SpeedShare
from cell.scene.options import Option

_KRL = "KRL"
_Signal = Annotated[int, Field(ge=1, le=4096)]  # of $IN and $OUT on a KR C4


class ExportOptions(CurrentFiles):
    """Format, folder and name of the files, speeds, and the signals between controller and scanner."""

    kind: Annotated[Literal["krl", "csv", "json"], Option("Format: krl, csv or json.", name="format")] = "krl"
    out: Annotated[
        Path | None,
        Field(strict=False),
        Option("Folder for the files. Default: export/ in the run folder.", metavar="DIR"),
    ] = None
    name: Annotated[
        str | None,
        Option("Name of program and files, at most 24 characters. Default: the run folder's, if valid in KRL."),
    ] = None
    speed: Annotated[
        SpeedShare | None,
        Option(
            "Share of the axis speeds; slows down sweeps too. Default: 0.2, or the plan's if less.",
            _KRL,
            metavar="SHARE",
        ),
    ] = None
    acceleration: Annotated[
        SpeedShare | None,
        Option("Share of the axis accelerations. Default: 0.3, or the plan's if less.", _KRL, metavar="SHARE"),
    ] = None
    trigger_output: Annotated[_Signal, Option("$OUT that starts a scan.", _KRL)] = 1
    gate_output: Annotated[_Signal, Option("$OUT that is on during a sweep.", _KRL)] = 2
    done_input: Annotated[_Signal, Option("$IN by which the scanner reports the end of a scan.", _KRL, metavar="M")] = 1
    timer: Annotated[int, Field(ge=1, le=32), Option("$TIMER that measures the time-out.", _KRL, metavar="K")] = 1
    settle: Annotated[float, Field(ge=0, le=3600), Option("Settling time before each scan.", _KRL, metavar="S")] = 0.2
    timeout: Annotated[float, Field(ge=0.1, le=3600), Option("Time-out of the scanner.", _KRL, metavar="S")] = 10.0

    @model_validator(mode="after")
    def _require_distinct_outputs(self) -> Self:
        if self.gate_output == self.trigger_output:
            raise ValueError(f".gate_output is {self.gate_output}, as is the trigger output; give two outputs")
        return self
