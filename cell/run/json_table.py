"""The pieces of which the values of a run folder's JSON files are made.

`plan_json`, `report_json` and `scene_json` define one file each: what a key is called, what it holds, in which unit.
Who writes a file makes such a value, who reads one gets it, and docs/internals/run_folder.md lists its keys.
"""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, JsonValue, PlainSerializer, PlainValidator, ValidationError

from cell.errors import FileError
from cell.scene.problems import sentences
from planner.values import readonly


def _transform(values: Any) -> NDArray[np.float64]:
    try:
        return readonly("as a transform", values, (4, 4))
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError("is no transform: it must be four rows of four finite numbers") from error


Transform = Annotated[NDArray[np.float64], PlainValidator(_transform), PlainSerializer(lambda T: T.tolist())]
"""(4, 4) read-only [m]; rows in the file."""

JointAngles = tuple[float, float, float, float, float, float]
Triple = tuple[float, float, float]


class JsonTable(BaseModel):
    """An object of a JSON file: frozen, its numbers finite; keys that this version does not know are passed over.

    Values are made in the order in which their keys are written. Nothing is compiled before the first value is made.
    """

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False, defer_build=True)

    def as_json(self) -> dict[str, JsonValue]:
        """The object as JSON types, in the order in which it is written."""
        return self.model_dump(mode="json")


class OpenTable(JsonTable):
    """A table in which the keys of a scanner plug-in stand beside known ones, whatever that plug-in calls them."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, JsonValue] = Field(init=False)

    @property
    def own(self) -> Mapping[str, JsonValue]:
        """The plug-in's keys, in the plug-in's order."""
        return MappingProxyType(self.__pydantic_extra__)

    def number(self, key: str) -> float | None:
        """One of the plug-in's keys, where it has it as a number."""
        value = self.own.get(key)
        return float(value) if isinstance(value, int | float) else None

    def pair(self, key: str) -> tuple[float, float] | None:
        """One of the plug-in's keys, where it has it as two numbers."""
        match self.own.get(key):
            case [int() | float() as first, int() | float() as second]:
                return float(first), float(second)
        return None


def optional(description: str = "") -> Any:
    """A field that is left out of the file where it is None."""
    return Field(default=None, exclude_if=lambda value: value is None, description=description or None)


Table = TypeVar("Table", bound=JsonTable)


def parsed(kind: type[Table], content: bytes, path: Path) -> Table:
    """A JSON file as the value that defines it.

    Args:
        kind: the definition.
        content: of the file.
        path: for the sentence.

    Raises:
        FileError: if it is not JSON, lacks a key, or a key holds another kind of value.
    """
    try:
        return kind.model_validate_json(content, strict=True)
    except ValidationError as error:
        problem = error.errors(include_url=False)[0]
        if problem["type"] == "json_invalid":
            said = "it is not JSON, or nested too deep"
        else:
            said = sentences(error, kind)[0] if problem["loc"] else "it must hold one JSON object"
        raise FileError(f"{path} is damaged: {said}; plan or scan again") from error
