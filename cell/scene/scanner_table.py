"""The keys of the scene's `[scanner]` table: those of the plug-in that `type` names, and of a sensor of the library.

A plug-in declares its keys by the arguments of its class; another type's key is an error with a hint. A sensor of the
library sets its type and what is known of it; keys of the scene go before the sensor's.
"""

from collections.abc import Callable
from typing import Any, TypeVar

from pydantic import ValidationError
from pydantic_core import ErrorDetails, InitErrorDetails

from cell import scanners
from cell.errors import SceneError
from cell.scene import sensors
from cell.scene.problems import did_you_mean

OF_EVERY_TYPE = ("type", "sensor")
OF_RAY_GRIDS = "planning_resolution_deg"
"""Stands for `resolution_deg` where the matrix is filled by scanning: a key of every type that has a resolution."""

T = TypeVar("T")


def validated(table: Any, validate: Callable[[Any], T], default_type: str) -> T:
    """The `[scanner]` table as pydantic's `validate` makes it, after the keys are checked and a sensor is put in.

    Args:
        table: what stands in the scene.
        validate: takes the table without the keys that are wrong here.
        default_type: the type of a table that names none.

    Raises:
        ValidationError: with all problems at once.
    """
    if not isinstance(table, dict):
        return validate(table)
    content = {key: value for key, value in table.items() if value is not None}
    problems = _put_sensor_in(content)
    kind = content.get("type", default_type)
    if kind in scanners.names():
        problems += _foreign_keys(content, kind)
    result: T | None = None
    try:
        result = validate(content)
    except ValidationError as error:
        problems += [_again(detail) for detail in error.errors()]
    if problems or result is None:
        raise ValidationError.from_exception_data("Scanner", problems)
    return result


def keys_of(kind: str) -> tuple[str, ...] | None:
    """Valid keys of a type's table; None where its class takes any.

    Raises:
        SceneError: if the plug-in cannot be imported; the message names its distribution.
    """
    own = scanners.keys(kind)
    if own is None:
        return None
    return (*OF_EVERY_TYPE, *own, *((OF_RAY_GRIDS,) if "resolution_deg" in own else ()))


def _put_sensor_in(content: dict[str, object]) -> list[InitErrorDetails]:
    """Fill in what the sensor's file states; returns what is wrong."""
    name = content.get("sensor")
    if not isinstance(name, str):
        return []
    try:
        sensor = sensors.load(name)
    except SceneError:
        known = sensors.names()
        return [_problem("sensor", name, f"is '{name}'; {did_you_mean(name, known)}valid are: {', '.join(known)}")]
    if content.get("type", sensor.type) != sensor.type:
        return [
            _problem("type", content["type"], f"is '{content['type']}', and {name} is a {sensor.type}; leave type out")
        ]
    for key, value in {"type": sensor.type, **sensor.keys}.items():
        content.setdefault(key, value)
    needed = dict(sensor.not_stated)
    if sensor.type == "laser-line" and {"max_spacing_mm", "profile_rate_hz"} & set(content):
        needed |= sensors.OF_DENSITY
    return [
        _problem("sensor", name, f"{name} does not state its {word}; set scanner.{key}")
        for key, word in needed.items()
        if key not in content
    ]


def _foreign_keys(content: dict[str, object], kind: str) -> list[InitErrorDetails]:
    """Take out the keys that the type does not have; returns a problem for each."""
    known = keys_of(kind)
    problems = []
    for key in [key for key in content if known is not None and key not in known]:
        hint = did_you_mean(key, known or ())
        text = f"is an unknown key of {kind}; {hint}valid are: {', '.join(known or ())}"
        problems.append(_problem(key, content.pop(key), text))
    return problems


def _problem(key: str, value: object, text: str) -> InitErrorDetails:
    return {"type": "value_error", "loc": (key,), "input": value, "ctx": {"error": ValueError(text)}}


def _again(detail: ErrorDetails) -> InitErrorDetails:
    """An error of pydantic's in the form in which it can be raised once more."""
    kept: InitErrorDetails = {"type": detail["type"], "loc": detail["loc"], "input": detail["input"]}
    if "ctx" in detail:
        kept["ctx"] = detail["ctx"]
    return kept
