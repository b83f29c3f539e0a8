"""Text of a scene file (TOML) from a scene: the keys that were given, without defaults."""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from cell.scene.model import Scene


def scene_text(scene: Scene) -> str:
    """Return the TOML text whose scene is equal to a scene; paths in it are absolute."""
    return "\n".join(_table_lines(scene.model_dump(exclude_unset=True), "")).strip() + "\n"


def _table_lines(table: Mapping[str, object], name: str) -> Iterator[str]:
    """Yield the lines of a table: its values, then its tables, then its lists of tables."""
    values = {key: value for key, value in table.items() if value is not None}
    below = {key: value for key, value in values.items() if isinstance(value, Mapping)}
    lists: dict[str, Any] = {key: value for key, value in values.items() if _is_list_of_tables(value)}
    for key, value in values.items():
        if key not in below and key not in lists:
            yield f"{_key(key)} = {_value(value)}"
    for key, value in below.items():
        yield from ("", f"[{name}{_key(key)}]")
        yield from _table_lines(value, f"{name}{_key(key)}.")
    for key, tables in lists.items():
        for each in tables:
            yield from ("", f"[[{name}{_key(key)}]]")
            yield from _table_lines(each, f"{name}{_key(key)}.")


def _is_list_of_tables(value: object) -> bool:
    return isinstance(value, list | tuple) and bool(value) and all(isinstance(each, Mapping) for each in value)


def _key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else json.dumps(key)


def _value(value: object) -> str:
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return repr(value)  # TOML writes inf as Python does
    if isinstance(value, Sequence):
        return f"[{', '.join(map(_value, value))}]"
    raise TypeError(f"a scene has no value of the type {type(value).__name__}")
