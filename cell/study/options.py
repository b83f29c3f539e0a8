"""Options of `cell place` and of the studies."""

import math
import os
from collections.abc import Sequence
from typing import Annotated

from pydantic import Field

from cell.errors import UsageError
from cell.scene.fields import OptionalPath, Table
from cell.scene.options import Option

_MAX_VALUES = 1000

Span = Annotated[tuple[float, float], Field(strict=False)]


def _span(ends: Sequence[float]) -> tuple[float, float]:
    """Return first and last value of one number, which is both, or of two ascending numbers."""
    if not ends[0] <= ends[-1]:
        raise ValueError
    return ends[0], ends[-1]


def _axis(help_text: str, unit: str, example: str) -> Option:
    return Option(
        help_text, metavar=f"{unit}:{unit}", form="from:to or one value", examples=(example,), counts=(1, 2),
        separator=":", convert=_span,
    )  # fmt: skip


class PlaceRange(Table):
    """Range of placements: first and last value of each axis; equal values fix it."""

    x_mm: Annotated[Span, _axis("From and to, or one value.", "MM", "700:1600")] = (700.0, 1600.0)
    y_mm: Annotated[Span, _axis("From and to, or one value.", "MM", "0:900")] = (0.0, 900.0)
    z_mm: Annotated[Span, _axis("Of the part's centre.", "MM", "-200:400")] = (-200.0, 400.0)
    yaw_deg: Annotated[Span, _axis("Rotation about the vertical (A).", "DEG", "-180:180")] = (-180.0, 180.0)

    @property
    def ends(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Lowest and highest values of all axes [mm, mm, mm, deg]."""
        spans = self.x_mm, self.y_mm, self.z_mm, self.yaw_deg
        return tuple(low for low, _ in spans), tuple(high for _, high in spans)


class StudyRun(Table):
    """Workers of a study, and its folder."""

    processes: Annotated[int | None, Option("Local worker processes. Default: one per core.")] = None
    cluster: Annotated[
        str | None,
        Option(
            "Dask scheduler, tcp://127.0.0.1:8786 on this machine. Whoever reaches its port runs code: beyond this "
            "machine use tls:// with --cluster-security.",
            metavar="ADDRESS",
        ),
    ] = None
    cluster_security: Annotated[
        OptionalPath, Option("TOML file with ca_file, cert_file and key_file of a tls:// scheduler.", metavar="FILE")
    ] = None
    out: Annotated[OptionalPath, Option("Folder of the study. Default: sim_runs/study-<name>.", metavar="DIR")] = None

    @property
    def count(self) -> int:
        """Number of local worker processes."""
        return os.cpu_count() or 1 if self.processes is None else self.processes


class ScannerNumber(Table):
    """The varied number of `cell study scanner`, one of these texts (`parse_range`, `parse_pairs`)."""

    fov: Annotated[str | None, Option("Fields of view, horizontal and vertical.", metavar="DEG:DEG:DEG")] = None
    resolution: Annotated[str | None, Option("Angles between rays.", metavar="DEG:DEG:DEG")] = None
    baseline: Annotated[
        str | None, Option("Baselines. With --sensors: one value for all sensors.", metavar="MM:MM:MM")
    ] = None
    grazing: Annotated[str | None, Option("Grazing limits.", metavar="DEG:DEG:DEG")] = None
    ranges: Annotated[
        str | None,
        Option("Near and far limits of the range; the standoff is their mean.", name="range", metavar="MM-MM,..."),
    ] = None
    sensors: Annotated[
        str | None,
        Option(
            "Real sensors, see cell sensors; all: every sensor whose data lack at most the baseline.",
            metavar="NAME,...",
        ),
    ] = None


def parse_range(option: str, text: str) -> tuple[float, ...]:
    """Return the values of a text such as `1000:1600:50` (first, last, step) or `5,-3`.

    Args:
        option: name of the option, for the message.
        text: the range, or numbers separated by commas.

    Raises:
        UsageError: if it is neither, the step has the wrong sign, or there are more than 1000 values.
    """
    expected = f"{option} {text} must be first:last:step, for instance {option} 1000:1600:50, or numbers with commas"
    try:
        numbers = [float(piece) for piece in text.split(":" if ":" in text else ",")]
    except ValueError:
        raise UsageError(expected) from None
    if not all(math.isfinite(number) for number in numbers):
        raise UsageError(expected)
    if ":" not in text:
        return tuple(dict.fromkeys(numbers))
    if len(numbers) != 3 or numbers[2] == 0 or (numbers[1] - numbers[0]) * numbers[2] < 0:
        raise UsageError(expected)
    first, last, step = numbers
    count = math.floor((last - first) / step + 1e-9) + 1
    if count > _MAX_VALUES:
        raise UsageError(f"{option} {text} has {count} values; at most {_MAX_VALUES} are allowed, so use a larger step")
    # Rounded to a nanometre, so that 3 x 0.1 is 0.3: the values are part of the keys of trials.
    return tuple(round(first + index * step, 9) for index in range(count))


def parse_pairs(option: str, text: str) -> list[tuple[float, float]]:
    """Return pairs such as `50-150,100-300`.

    Args:
        option: name of the option, for the message.
        text: pairs separated by commas.

    Raises:
        UsageError: if a piece is not a pair of ascending positive numbers.
    """
    pairs = []
    for piece in text.split(","):
        near, dash, far = piece.partition("-")
        try:
            pair = float(near), float(far)
        except ValueError:
            pair = math.nan, math.nan
        if not (dash and 0 < pair[0] < pair[1] < math.inf):
            raise UsageError(
                f"{option} {text} must be pairs of near and far limit, for instance {option} 50-150,100-300"
            )
        pairs.append(pair)
    return pairs
