"""Library of scanners: models/sensors/*.toml, with the figures of each device and their sources.

A file holds figures of a data sheet, or definitions of this project's own devices; the keys of the scene's `[scanner]`
follow from them. A device of `laser-area` states range and baseline; those of `paper` are shares of the standoff. The
laser line of a `laser-line` grows with the distance, so its fan has an apex, the source of the scanner frame:

    fan  = 2 atan((width_far - width_near) / (2 depth))
    near = width_near / (2 tan(fan / 2)), far = near + depth     range, from the apex

The apex is `near - clearance` behind the housing's window. A figure that is not known is in no file: it is never
guessed, and a scene that needs it must give it.
"""

import math
import tomllib
from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, ValidationError, field_validator, model_validator

from cell.errors import FileError, SceneError
from cell.files import read_bytes
from cell.scene.fields import Positive, Table
from cell.scene.validation import did_you_mean, error_messages

_AREA = {"range_mm": "range", "baseline_mm": "baseline"}
REQUIRED = {"laser-line": {"fan_deg": "fan", **_AREA}, "laser-area": _AREA}
"""Required keys by type of scanner, with their names in messages."""

DENSITY_KEYS = {"line_points": "points of a line", "profile_rate_hz": "lines a second"}
"""Keys that a limit on the spacing of a line sensor requires, with their names in messages."""

_Two = Annotated[tuple[Positive, Positive], Field(strict=False)]
_Sides = Annotated[tuple[Positive, Positive, Positive], Field(strict=False)]


class Figures(Table):
    """Figures in the source of a sensor; None: not stated. Lengths [mm].

    `body_mm` are the sides of the body in the order of the source, `housing_mm` those along x, y, z of the scanner
    frame; shares are of the standoff, instead of `range_mm` and `baseline_mm`; `profile_rate_hz` is the rate of lines,
    `resolution_across_mm` the distance of neighbouring points of a line, near and far.
    """

    clearance_mm: Positive | None = None
    reference_mm: Positive | None = None
    depth_mm: Positive | None = None
    width_near_mm: Positive | None = None
    width_far_mm: Positive | None = None
    body_mm: _Sides | None = None
    housing_mm: _Sides | None = None
    bracket_mm: Positive | None = None
    range_mm: _Two | None = None
    range_shares: _Two | None = None
    baseline_mm: Positive | None = None
    baseline_share: Positive | None = None
    points_per_line: Annotated[int, Field(gt=0)] | None = None
    profile_rate_hz: Positive | None = None
    resolution_across_mm: _Two | None = None
    repeatability_mm: Positive | None = None

    @field_validator("range_mm", "range_shares", "resolution_across_mm")
    @classmethod
    def _rising(cls, ends: tuple[float, float] | None) -> tuple[float, float] | None:
        if ends is not None and not ends[0] < ends[1]:
            raise ValueError("must be [near, far] with near < far")
        return ends

    @model_validator(mode="after")
    def _growing(self) -> Self:
        if self.width_near_mm is not None and (self.width_far_mm or math.inf) <= self.width_near_mm:
            raise ValueError(".width_far_mm must be larger than width_near_mm")
        return self


class Sensor(Table):
    """A scanner of the library: name in scenes, maker, the maker's model name, and the plug-in that models it."""

    name: str
    maker: str
    model: str
    type: str
    figures: Figures
    source: dict[str, str]

    @model_validator(mode="after")
    def _sources(self) -> Self:
        if lone := sorted(self.figures.model_fields_set ^ set(self.source)):
            raise ValueError(f".source must have a source for each figure and no others; see '{lone[0]}'")
        return self

    @property
    def keys(self) -> dict[str, float | tuple[float, float]]:
        """Keys of the scene's `[scanner]` that follow from the figures."""
        figures = self.figures
        fan, span = None, figures.range_mm
        if figures.depth_mm and figures.width_near_mm and figures.width_far_mm:
            half = (figures.width_far_mm - figures.width_near_mm) / figures.depth_mm / 2
            near = figures.width_near_mm / half / 2
            fan, span = math.degrees(2 * math.atan(half)), span or (near, near + figures.depth_mm)
        keys = {
            "fan_deg": fan,
            "range_mm": span,
            "baseline_mm": figures.baseline_mm,
            "line_points": figures.points_per_line,
            "profile_rate_hz": figures.profile_rate_hz,
        }
        return {key: value for key, value in keys.items() if value is not None}

    @property
    def follows_standoff(self) -> bool:
        """Whether range and baseline are shares of the standoff, as of no real device."""
        return self.figures.range_shares is not None

    @property
    def apex_behind_window_mm(self) -> float | None:
        """Distance of the fan's apex behind the housing's window, its reference plane [mm]; None: not known."""
        match self.keys.get("range_mm"), self.figures:
            case (near, _), Figures(clearance_mm=float(clearance)):
                return near - clearance
            case (near, _), Figures(depth_mm=float(depth), reference_mm=float(reference)):
                return near + depth / 2 - reference
        return None

    @property
    def not_stated(self) -> dict[str, str]:
        """Keys that the scene itself must give, with their names in messages."""
        if self.follows_standoff:
            return {}
        return {key: word for key, word in REQUIRED.get(self.type, {}).items() if key not in self.keys}

    def summary(self) -> dict[str, object]:
        """Return all properties as JSON types."""
        return {
            "name": self.name,
            "maker": self.maker,
            "model": self.model,
            "type": self.type,
            "figures": self.figures.model_dump(mode="json", exclude_none=True),
            "scanner_keys": self.keys,
            "apex_behind_window_mm": self.apex_behind_window_mm,
            "to_be_given": list(self.not_stated),
            "source": dict(self.source),
        }


def names() -> tuple[str, ...]:
    """Return the names of the scanners of the library, sorted."""
    return tuple(sorted(path.stem for path in _folder().glob("*.toml")))


def load(name: str) -> Sensor:
    """Return a scanner of the library, such as "gocator-2350".

    Raises:
        SceneError: if the name is unknown.
        FileError: if its file is invalid.
    """
    known = names()
    if name not in known:
        raise SceneError(f"the sensor '{name}' is unknown; {did_you_mean(name, known)}valid are: {', '.join(known)}")
    return read(_folder() / f"{name}.toml")


def read(path: Path) -> Sensor:
    """Read the file of a sensor.

    Raises:
        FileError: if it holds other keys than texts, known figures above 0 and a source for each figure.
    """
    try:
        content = tomllib.loads(read_bytes(path).decode("utf-8-sig"))
        if "name" in content:
            raise FileError(
                f"the sensor file {path} is damaged: name is an unknown key; the name of the file is that of the sensor"
            )
        return Sensor.model_validate({"name": path.stem, **content})
    except ValidationError as error:
        raise FileError(f"the sensor file {path} is damaged: {'; '.join(error_messages(error, Sensor))}") from error
    except (OSError, ValueError) as error:
        raise FileError(f"the sensor file {path} cannot be read: {error}") from error


def table_rows() -> list[tuple[str, ...]]:
    """Return heading and one row per scanner for the terminal; "-" for figures that are not stated."""
    heading = ("scanner", "distance", "line", "fan", "range", "baseline", "you give")
    rows: list[tuple[str, ...]] = [heading]
    for sensor in map(load, names()):
        figures, keys, unit = sensor.figures, sensor.keys, " x" if sensor.follows_standoff else ""
        baseline = figures.baseline_share or figures.baseline_mm
        span = figures.range_shares or keys.get("range_mm")
        rows.append(
            (
                sensor.name,
                _distance(figures),
                f"{figures.width_near_mm:g}..{figures.width_far_mm:g}" if figures.width_near_mm else "-",
                f"{keys['fan_deg']:.1f}" if "fan_deg" in keys else "-",
                f"{span[0]:.4g}..{span[1]:.4g}{unit}" if isinstance(span, tuple) else "-",
                f"{baseline:g}{unit}" if baseline is not None else "-",
                ", ".join(sensor.not_stated),
            )
        )
    return rows


def _distance(figures: Figures) -> str:
    """Return the distance from housing to measuring range in the form of the source."""
    if figures.clearance_mm is not None:
        return f"{figures.clearance_mm:g}..{figures.clearance_mm + (figures.depth_mm or 0):g}"
    half = f"+-{figures.depth_mm / 2:g}" if figures.depth_mm is not None else ""
    return f"{figures.reference_mm:g}{half}" if figures.reference_mm is not None else "-"


def _folder() -> Path:
    from cell.files import model_file

    return model_file("scene.toml").parent / "sensors"
