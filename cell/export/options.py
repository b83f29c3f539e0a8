"""Validated options of `cell export`."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from cell.errors import UsageError
from cell.runs.current_files import CurrentFiles
from cell.scene.fields import OptionalPath, SpeedShare
from cell.scene.options import Option

Language = Literal["krl", "rapid", "urscript", "ls", "csv", "json", "ros"]

_PROGRAM = "Program"
_Signal = Annotated[int, Field(ge=0, le=4096)]


class ExportOptions(CurrentFiles):
    """Format, folder and name of the files, speeds, and the signals between controller and scanner."""

    kind: Annotated[
        Language | None,
        Option(
            "Format: krl (KUKA), rapid (ABB), urscript (Universal Robots), ls (Fanuc), csv, json or ros. Default: the "
            "language of the robot's maker.",
            name="format",
        ),
    ] = None
    out: Annotated[OptionalPath, Option("Folder for the files. Default: export/ in the run folder.", metavar="DIR")] = (
        None
    )
    name: Annotated[
        str | None,
        Option("Name of program and files, at most 24 characters. Default: the run folder's, if valid in the format."),
    ] = None
    speed: Annotated[
        SpeedShare | None,
        Option(
            "Share of the axis speeds; slows down sweeps too. Default: 0.2, or the plan's if less.",
            _PROGRAM,
            metavar="SHARE",
        ),
    ] = None
    acceleration: Annotated[
        SpeedShare | None,
        Option("Share of the axis accelerations. Default: 0.3, or the plan's if less.", _PROGRAM, metavar="SHARE"),
    ] = None
    trigger_output: Annotated[_Signal, Option("Digital output that starts a scan.", _PROGRAM)] = 1
    gate_output: Annotated[_Signal, Option("Digital output that is on during a sweep.", _PROGRAM)] = 2
    done_input: Annotated[
        _Signal, Option("Digital input by which the scanner reports the end of a scan.", _PROGRAM, metavar="M")
    ] = 1
    timer: Annotated[
        int, Field(ge=1, le=32), Option("KRL: $TIMER that measures the time-out.", _PROGRAM, metavar="K")
    ] = 1
    settle: Annotated[float, Field(ge=0, le=3600), Option("Settling time before each scan.", _PROGRAM, metavar="S")] = (
        0.2
    )
    timeout: Annotated[float, Field(ge=0.1, le=3600), Option("Time-out of the scanner.", _PROGRAM, metavar="S")] = 10.0

    def require_signals(self, language: str, lowest: int, highest: int) -> None:
        """Raise UsageError unless the controller has the signals."""
        for name in ("trigger_output", "gate_output", "done_input"):
            number = getattr(self, name)
            if not lowest <= number <= highest:
                raise UsageError(
                    f"--{name.replace('_', '-')} is {number}; in {language} it must be from {lowest} to {highest}"
                )

    @model_validator(mode="after")
    def _require_a_percent(self) -> Self:
        for name in ("speed", "acceleration"):
            share = getattr(self, name)
            if share is not None and share < 0.01:
                raise ValueError(f".{name} is {share:g}; it must be at least 0.01: programs have whole percent")
        return self

    @model_validator(mode="after")
    def _require_distinct_outputs(self) -> Self:
        if self.gate_output == self.trigger_output:
            raise ValueError(f".gate_output is {self.gate_output}, as is the trigger output; give two outputs")
        return self
