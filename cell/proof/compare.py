"""Where two tables of a run folder differ: the key of the first difference, numbers to within rounding."""

from collections.abc import Iterator

from pydantic import JsonValue

from cell.runs.schema import JsonTable

_NEAR = 1e-7
"""Numbers that differ by less, absolutely or relatively, are one: 0.1 um, and far below what a file rounds to."""


def difference(found: JsonTable, due: JsonTable) -> str:
    """Key of the first difference between a table that was read and one that was made again; "" where there is none."""
    ours, theirs = dict(_leaves(found.as_json())), dict(_leaves(due.as_json()))
    for key in {**theirs, **ours}:
        if key not in ours or key not in theirs or not _same(ours[key], theirs[key]):
            return key
    return ""


def _leaves(value: JsonValue, key: str = "") -> Iterator[tuple[str, JsonValue]]:
    """Every number, word and empty container with its key: "views[3].q_deg[0]"."""
    if isinstance(value, dict) and value:
        for name, each in value.items():
            yield from _leaves(each, f"{key}.{name}" if key else name)
    elif isinstance(value, list) and value:
        for number, each in enumerate(value):
            yield from _leaves(each, f"{key}[{number}]")
    else:
        yield key, value


def _same(found: JsonValue, due: JsonValue) -> bool:
    numbers = isinstance(found, int | float) and isinstance(due, int | float)
    if numbers and not isinstance(found, bool) and not isinstance(due, bool):
        return bool(abs(found - due) <= _NEAR * max(1.0, abs(due)))  # type: ignore[operator,arg-type]  # numbers
    return bool(found == due)
