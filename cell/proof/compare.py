"""Where two tables of a run folder differ: the key of the first difference, numbers to within rounding."""

from collections.abc import Mapping

from pydantic import JsonValue

from cell.run.json_table import JsonTable

_NEAR = 1e-7
"""Numbers that differ by less, absolutely or relatively, are one: 0.1 um, and far below what a file rounds to."""


def difference(found: JsonTable, due: JsonTable) -> str:
    """Key of the first difference between a table that was read and one that was made again; "" where there is none."""
    return _difference(found.as_json(), due.as_json())


def _difference(found: JsonValue, due: JsonValue) -> str:
    if isinstance(found, Mapping) and isinstance(due, Mapping):
        for key in dict.fromkeys((*due, *found)):
            if key not in found or key not in due:
                return key
            if inner := _difference(found[key], due[key]):
                return key + ("" if inner == "." else inner if inner.startswith("[") else f".{inner}")
        return ""
    if isinstance(found, list) and isinstance(due, list):
        if len(found) != len(due):
            return "."
        for number, (one, other) in enumerate(zip(found, due, strict=True)):
            if inner := _difference(one, other):
                return f"[{number}]" + ("" if inner == "." else inner if inner.startswith("[") else f".{inner}")
        return ""
    return "" if _same(found, due) else "."


def _same(found: JsonValue, due: JsonValue) -> bool:
    numbers = isinstance(found, int | float) and isinstance(due, int | float)
    if numbers and not isinstance(found, bool) and not isinstance(due, bool):
        return bool(abs(found - due) <= _NEAR * max(1.0, abs(due)))  # type: ignore[operator,arg-type]  # numbers
    return bool(found == due)
