"""What `cell place` and the studies can be asked for, checked."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from pydantic import Field

from cell.scene.fields import Table
from cell.scene.options import Option

Span = Annotated[tuple[float, float], Field(strict=False)]


def _span(ends: Sequence[float]) -> tuple[float, float]:
    """First and last value of one, which is both, or two; ValueError where they run backwards."""
    if not ends[0] <= ends[-1]:
        raise ValueError
    return ends[0], ends[-1]


def _of(axis: str, unit: str, example: str) -> Option:
    return Option(
        axis, metavar=f"{unit}:{unit}", form="from:to or one value", examples=(example,), counts=(1, 2), separator=":",
        made=_span,
    )  # fmt: skip


class PlaceRange(Table):
    """Where the part may stand: first and last value of each axis; equal ones fix it."""

    x_mm: Annotated[Span, _of("From and to, or one value.", "MM", "700:1600")] = (700.0, 1600.0)
    y_mm: Annotated[Span, _of("From and to, or one value.", "MM", "0:900")] = (0.0, 900.0)
    z_mm: Annotated[Span, _of("Of the part's centre.", "MM", "-200:400")] = (-200.0, 400.0)
    yaw_deg: Annotated[Span, _of("Turn about the vertical (A).", "DEG", "-180:180")] = (-180.0, 180.0)

    @property
    def ends(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Lowest and highest values of all axes [mm, mm, mm, deg]."""
        spans = self.x_mm, self.y_mm, self.z_mm, self.yaw_deg
        return tuple(low for low, _ in spans), tuple(high for _, high in spans)


class StudyRun(Table):
    """Where the trials of a study are computed, and what is left of it."""

    processes: Annotated[int | None, Option("Local worker processes. Default: one per core.")] = None
    cluster: Annotated[str | None, Option("Dask scheduler, for instance tcp://scheduler:8786.", metavar="ADDRESS")] = (
        None
    )
    out: Annotated[
        Path | None, Field(strict=False), Option("Folder of the study. Default: sim_runs/study-<name>.", metavar="DIR")
    ] = None

    @property
    def count(self) -> int:
        """Worker processes: as many as asked for, or one per core."""
        return os.cpu_count() or 1 if self.processes is None else self.processes


class ScannerNumber(Table):
    """What `cell study scanner` varies, one of them: texts as `cell.study.ranges` reads them."""

    fov: Annotated[str | None, Option("Fields of view, both ways.", metavar="DEG:DEG:DEG")] = None
    resolution: Annotated[str | None, Option("Angles between rays.", metavar="DEG:DEG:DEG")] = None
    baseline: Annotated[
        str | None, Option("Baselines; beside --sensors the one of all of them.", metavar="MM:MM:MM")
    ] = None
    grazing: Annotated[str | None, Option("Grazing limits.", metavar="DEG:DEG:DEG")] = None
    ranges: Annotated[
        str | None, Option("Near and far limits; the standoff is between.", name="range", metavar="MM-MM,...")
    ] = None
    sensors: Annotated[
        str | None,
        Option("Real sensors, see cell sensors; all: those that lack no more than a baseline.", metavar="NAME,..."),
    ] = None
