"""Read files of the schemas scan-cell/run/1 (without a rotary table) and scan-cell/run/2 (with one).

The layout is that of the present schema; only the names below differ. Files are converted when they are read and are
never rewritten, so that hashes and digest remain valid.
"""

import tomllib
from collections.abc import Mapping
from functools import cache
from importlib import resources
from types import MappingProxyType
from typing import Any, get_args

from numpy.typing import NDArray
from pydantic import BaseModel
from pydantic.fields import FieldInfo

FORMER_SCHEMAS = ("scan-cell/run/1", "scan-cell/run/2")

FORMER_ARRAYS: Mapping[str, str] = MappingProxyType({"clearance_at_least": "clearance_lower_bound", "stop": "number"})
"""Former to present name of an array of motion.npz or of a scan."""


@cache
def key_renames() -> Mapping[str, Mapping[str, str]]:
    """Return the name of the table in `cell.runs.schema`, to former key, to present key."""
    return tomllib.loads((resources.files("cell.runs") / "former_keys.toml").read_text(encoding="utf-8"))


def with_present_arrays(stored: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return arrays of a former schema by their present names."""
    return {FORMER_ARRAYS.get(name, name): array for name, array in stored.items()}


def nested_table(annotation: Any) -> type[BaseModel] | None:
    """Return the table that an annotation names, alone, optional or in a tuple."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((table for inner in get_args(annotation) if (table := nested_table(inner))), None)


def with_present_keys(content: Any, table: type[BaseModel]) -> Any:
    """Return a JSON value of a former schema with the present keys of a table, without unknown keys."""
    if isinstance(content, list):
        return [with_present_keys(each, table) for each in content]
    if not isinstance(content, dict):
        return content
    names: dict[str, str] = {
        old: new for each in table.__mro__ for old, new in key_renames().get(each.__name__, {}).items()
    }
    fields: dict[str, FieldInfo] = {field.alias or name: field for name, field in table.model_fields.items()}
    converted: dict[str, Any] = {}
    for former, value in content.items():
        key = names.get(str(former), str(former))
        if key in fields:
            nested = nested_table(fields[key].annotation)
            converted[key] = with_present_keys(value, nested) if nested else value
        elif table.model_config.get("extra") == "allow":
            converted[key] = value
    return converted
