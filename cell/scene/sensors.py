"""Scanners by name: models/sensors/*.toml, what is known of each and where that is from.

A file holds figures of a data sheet, or definitions of this project's own devices; the keys of the scene's `[scanner]`
follow from them. A device of `laser-area` states range and baseline; those of `paper` are shares of the standoff. The
laser line of a `laser-line` grows with the distance, so its fan has an apex, the source of the scanner frame:

    fan  = 2 atan((width_far - width_near) / (2 depth))
    near = width_near / (2 tan(fan / 2)), far = near + depth     range, from the apex

The apex lies `near - clearance` behind the housing's window. A figure that is not known stands in no file: nothing is
guessed in its place, and a scene that needs it must give it.
"""

import math
import tomllib
from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, ValidationError, field_validator, model_validator

from cell.errors import FileError, SceneError
from cell.scene.fields import Positive, Table
from cell.scene.validation import did_you_mean, error_messages

_AREA = {"range_mm": "range", "baseline_mm": "baseline"}
REQUIRED = {"laser-line": {"fan_deg": "fan", **_AREA}, "laser-area": _AREA}
"""By type of scanner: the keys that describe a sensor, without which it is not the sensor of that name."""

DENSITY_KEYS = {"line_points": "points of a line", "profile_rate_hz": "lines a second"}
"""Of a line sensor: the keys without which nothing can be said of its density, so that a limit on it asks for them."""

_Two = Annotated[tuple[Positive, Positive], Field(strict=False)]
_Sides = Annotated[tuple[Positive, Positive, Positive], Field(strict=False)]


class Figures(Table):
    """What a sensor's source states; None: it does not. Lengths [mm].

    `body_mm` are the sides of the body in the source's order, `housing_mm` those along x, y, z of the scanner frame;
    shares are of the standoff, in place of `range_mm` and `baseline_mm`; `profile_rate_hz` are lines a second [1/s],
    `resolution_across_mm` is between neighbouring points of a line, near and far.
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
            raise ValueError(".width_far_mm is of a line that does not grow with the distance")
        return self


class Sensor(Table):
    """One scanner of the library: how a scene calls it, its maker and his name for it, the plug-in that models it."""

    name: str
    maker: str
    model: str
    type: str
    figures: Figures
    source: dict[str, str]

    @model_validator(mode="after")
    def _sources(self) -> Self:
        if lone := sorted(self.figures.model_fields_set ^ set(self.source)):
            raise ValueError(f".source must have a source for each figure and no other; see '{lone[0]}'")
        return self

    @property
    def keys(self) -> dict[str, float | tuple[float, float]]:
        """Keys of the scene's `[scanner]` that follow from the figures."""
        known = self.figures
        fan, span = None, known.range_mm
        if known.depth_mm and known.width_near_mm and known.width_far_mm:
            half = (known.width_far_mm - known.width_near_mm) / known.depth_mm / 2
            near = known.width_near_mm / half / 2
            fan, span = math.degrees(2 * math.atan(half)), span or (near, near + known.depth_mm)
        keys = {
            "fan_deg": fan, "range_mm": span, "baseline_mm": known.baseline_mm, "line_points": known.points_per_line,
            "profile_rate_hz": known.profile_rate_hz,
        }  # fmt: skip
        return {key: value for key, value in keys.items() if value is not None}

    @property
    def follows_standoff(self) -> bool:
        """Whether range and baseline are shares of the standoff, as of no device."""
        return self.figures.range_shares is not None

    @property
    def apex_behind_window_mm(self) -> float | None:
        """How far behind the housing's window (its reference plane) the fan's apex lies [mm]; None: not known."""
        match self.keys.get("range_mm"), self.figures:
            case (near, _), Figures(clearance_mm=float(clearance)):
                return near - clearance
            case (near, _), Figures(depth_mm=float(depth), reference_mm=float(reference)):
                return near + depth / 2 - reference
        return None

    @property
    def not_stated(self) -> dict[str, str]:
        """Scene keys that the scene itself must give, with what each is called."""
        if self.follows_standoff:
            return {}
        return {key: word for key, word in REQUIRED.get(self.type, {}).items() if key not in self.keys}

    def summary(self) -> dict[str, object]:
        """Everything about it as JSON types."""
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
    """Names of the library's scanners, sorted."""
    return tuple(sorted(path.stem for path in _folder().glob("*.toml")))


def load(name: str) -> Sensor:
    """One scanner.

    Args:
        name: such as "gocator-2350".

    Raises:
        SceneError: if there is none of that name.
        FileError: if its file is not a sensor's.
    """
    known = names()
    if name not in known:
        raise SceneError(f"the sensor '{name}' is unknown; {did_you_mean(name, known)}valid are: {', '.join(known)}")
    return read(_folder() / f"{name}.toml")


def read(path: Path) -> Sensor:
    """A sensor's file.

    Raises:
        FileError: with what is wrong in it: nothing but texts, known figures above 0, and a source for each figure.
    """
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
        if "name" in content:
            raise FileError(
                f"the sensor file {path} is damaged: name is an unknown key; a sensor is called as its file"
            )
        return Sensor.model_validate({"name": path.stem, **content})
    except ValidationError as error:
        raise FileError(f"the sensor file {path} is damaged: {'; '.join(error_messages(error, Sensor))}") from error
    except (OSError, ValueError) as error:
        raise FileError(f"the sensor file {path} cannot be read: {error}") from error


def table_rows() -> list[tuple[str, ...]]:
    """Heading and one row per scanner, for the terminal; "-" where nothing is stated."""
    heading = ("scanner", "distance", "line", "fan", "range", "baseline", "you give")
    rows: list[tuple[str, ...]] = [heading]
    for sensor in map(load, names()):
        known, keys, unit = sensor.figures, sensor.keys, " x" if sensor.follows_standoff else ""
        baseline = known.baseline_share or known.baseline_mm
        span = known.range_shares or keys.get("range_mm")
        rows.append((
            sensor.name, _distance(known),
            f"{known.width_near_mm:g}..{known.width_far_mm:g}" if known.width_near_mm else "-",
            f"{keys['fan_deg']:.1f}" if "fan_deg" in keys else "-",
            f"{span[0]:.4g}..{span[1]:.4g}{unit}" if isinstance(span, tuple) else "-",
            f"{baseline:g}{unit}" if baseline is not None else "-",
            ", ".join(sensor.not_stated),
        ))  # fmt: skip
    return rows


def _distance(known: Figures) -> str:
    """From housing to measuring range, as the source puts it."""
    if known.clearance_mm is not None:
        return f"{known.clearance_mm:g}..{known.clearance_mm + (known.depth_mm or 0):g}"
    half = f"+-{known.depth_mm / 2:g}" if known.depth_mm is not None else ""
    return f"{known.reference_mm:g}{half}" if known.reference_mm is not None else "-"


def _folder() -> Path:
    from cell.files import model_file

    return model_file("scene.toml").parent / "sensors"
