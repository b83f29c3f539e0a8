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
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cell.errors import FileError, SceneError

_AREA = {"range_mm": "range", "baseline_mm": "baseline"}
REQUIRED = {"laser-line": {"fan_deg": "fan", **_AREA}, "laser-area": _AREA}
"""By type of scanner: the keys that describe a sensor, without which it is not the sensor of that name."""

OF_DENSITY = {"line_points": "points of a line", "profile_rate_hz": "lines a second"}
"""Of a line sensor: the keys without which nothing can be said of its density, so that a limit on it asks for them."""

_TEXTS = ("maker", "model", "type")
_NUMBERS = (
    *("clearance_mm", "reference_mm", "depth_mm", "width_near_mm", "width_far_mm", "baseline_mm", "bracket_mm"),
    *("baseline_share", "points_per_line", "profile_rate_hz", "repeatability_mm"),
)
_LISTS = {"body_mm": 3, "housing_mm": 3, "range_mm": 2, "range_shares": 2, "resolution_across_mm": 2}
_RISING = ("range_mm", "range_shares", "resolution_across_mm")
_FIGURES = (*_NUMBERS, *_LISTS)


@dataclass(frozen=True, slots=True)
class Sensor:
    """One scanner of the library.

    Attributes:
        name: how a scene and the command line call it.
        maker: who makes it.
        model: what its maker calls it.
        type: the scanner plug-in that models it.
        figures: what its source states: lengths [mm] and
            body_mm: sides of the body in the source's order; housing_mm: along x, y, z of the scanner frame;
            range_shares, baseline_share: of the standoff, in place of range_mm and baseline_mm;
            resolution_across_mm: between neighbouring points of a line, near and far;
            points_per_line; profile_rate_hz: lines a second [1/s]; repeatability_mm: of a point's distance.
        source: of each figure.
    """

    name: str
    maker: str
    model: str
    type: str
    figures: Mapping[str, Any]
    source: Mapping[str, str]

    @property
    def keys(self) -> dict[str, Any]:
        """Keys of the scene's `[scanner]` that follow from the figures."""
        keys: dict[str, Any] = {}
        known = self.figures
        if {"depth_mm", "width_near_mm", "width_far_mm"} <= set(known):
            half = (known["width_far_mm"] - known["width_near_mm"]) / known["depth_mm"] / 2
            near = known["width_near_mm"] / half / 2
            keys["fan_deg"] = math.degrees(2 * math.atan(half))
            keys["range_mm"] = [near, near + known["depth_mm"]]
        keys |= {key: known[key] for key in ("range_mm", "baseline_mm") if key in known}
        of_lines = {"line_points": "points_per_line", "profile_rate_hz": "profile_rate_hz"}
        return keys | {key: known[figure] for key, figure in of_lines.items() if figure in known}

    @property
    def follows_standoff(self) -> bool:
        """Whether range and baseline are shares of the standoff, as of no device."""
        return "range_shares" in self.figures

    @property
    def apex_behind_window_mm(self) -> float | None:
        """How far behind the housing's window (its reference plane) the fan's apex lies [mm]; None: not known."""
        near, known = self.keys.get("range_mm", [None])[0], self.figures
        if near is None:
            return None
        if "clearance_mm" in known:
            return float(near - known["clearance_mm"])
        return float(near + known["depth_mm"] / 2 - known["reference_mm"]) if "reference_mm" in known else None

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
            "figures": dict(self.figures),
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
    from cell.scene.problems import did_you_mean

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
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise FileError(f"the sensor file {path} cannot be read: {error}") from error
    texts, figures, source = {}, content.get("figures"), content.get("source")
    for name in _TEXTS:
        if not isinstance(content.get(name), str):
            raise FileError(f"the sensor file {path} lacks '{name}', a text")
        texts[name] = str(content[name])
    if not isinstance(figures, dict) or not isinstance(source, dict):
        raise FileError(f"the sensor file {path} lacks its tables [figures] and [source]")
    unknown = [*(set(content) - {*_TEXTS, "figures", "source"}), *(set(figures) - set(_FIGURES))]
    if unknown:
        raise FileError(f"the sensor file {path} has the unknown key '{min(unknown)}'; figures: {', '.join(_FIGURES)}")
    for name, value in figures.items():
        if problem := _problem(name, value):
            raise FileError(f"the sensor file {path} has {name} = {value!r}; {problem}")
    if set(figures) != set(source):
        lone = min(set(figures) ^ set(source))
        raise FileError(f"the sensor file {path} must have a source for each figure and no other; see '{lone}'")
    if figures.get("width_far_mm", math.inf) <= figures.get("width_near_mm", 0):
        raise FileError(f"the sensor file {path} has a line that does not grow with the distance; see 'width_far_mm'")
    return Sensor(path.stem, texts["maker"], texts["model"], texts["type"], figures, source)


def _problem(name: str, value: Any) -> str:
    """What is wrong with a figure; "" for nothing."""
    count = _LISTS.get(name)
    numbers = value if count is not None and isinstance(value, list) else [value]
    if count is not None and (not isinstance(value, list) or len(value) != count):
        return f"it must be {count} numbers above 0"
    if not all(type(number) in (int, float) and 0 < number < math.inf for number in numbers):
        return "it must be a length above 0" if name.endswith("_mm") else "it must be a number above 0"
    if name == "points_per_line" and not isinstance(value, int):
        return "it must be a whole number"
    return "it must be [near, far] with near < far" if name in _RISING and not numbers[0] < numbers[1] else ""


def table_rows() -> list[tuple[str, ...]]:
    """Heading and one row per scanner, for the terminal; "-" where nothing is stated."""
    heading = ("scanner", "distance", "line", "fan", "range", "baseline", "you give")
    rows: list[tuple[str, ...]] = [heading]
    for sensor in map(load, names()):
        known, keys = sensor.figures, sensor.keys
        span = known.get("range_shares") or keys.get("range_mm")
        baseline = known.get("baseline_share") or keys.get("baseline_mm")
        unit = " x" if sensor.follows_standoff else ""
        rows.append(
            (
                sensor.name,
                _distance(known),
                f"{known['width_near_mm']:g}..{known['width_far_mm']:g}" if "width_near_mm" in known else "-",
                f"{keys['fan_deg']:.1f}" if "fan_deg" in keys else "-",
                f"{span[0]:.4g}..{span[1]:.4g}{unit}" if span is not None else "-",
                f"{baseline:g}{unit}" if baseline is not None else "-",
                ", ".join(sensor.not_stated),
            )
        )
    return rows


def _distance(known: Mapping[str, Any]) -> str:
    """From housing to measuring range, as the source puts it."""
    if "clearance_mm" in known:
        return f"{known['clearance_mm']:g}..{known['clearance_mm'] + known['depth_mm']:g}"
    half = f"+-{known['depth_mm'] / 2:g}" if "depth_mm" in known else ""
    return f"{known['reference_mm']:g}{half}" if "reference_mm" in known else "-"


def _folder() -> Path:
    from cell.robot.model import model_file

    return model_file("scene.toml").parent / "sensors"
