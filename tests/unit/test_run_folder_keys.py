"""docs/internals/run_folder_keys.csv lists the keys of the JSON files with the meanings of their definitions.

`python tests/unit/test_run_folder_keys.py` writes the file.
"""

import csv
import io
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel

from cell.runs.schema import (
    ExecutionReport,
    ExploreFile,
    Manifest,
    PlanFile,
    Report,
    ResolvedScene,
    ScannedSetups,
    SetupsFile,
    WhyReport,
)
from cell.scene.model import PlanKeys

TABLE = Path(__file__).parents[2] / "docs" / "internals" / "run_folder_keys.csv"
FILES = {
    "plan.json": PlanFile,
    "report.json": Report,
    "scene.resolved.json": ResolvedScene,
    "manifest.json": Manifest,
    "executions/0001/report.json": ExecutionReport,
    "why/why.json": WhyReport,
    "explore.json": ExploreFile,
    "setups.json": SetupsFile,
    "scanned/report.json": ScannedSetups,
}


def table_in(annotation: Any) -> tuple[type[BaseModel] | None, str]:
    """Return the table that an annotation names, and the separator of its keys: "." for one, "[]." for a list."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation, "."
    found = [table_in(inner) for inner in get_args(annotation)]
    table, dots = next((pair for pair in found if pair[0]), (None, ""))
    return table, "[]" + dots if table and getattr(annotation, "__origin__", None) is tuple else dots


def rows(model: type[BaseModel], before: str, known: dict[type[BaseModel], str]) -> list[tuple[str, str]]:
    """Return key and meaning of a table's keys and of nested ones; `known` maps listed tables to their places."""
    found = []
    of_scene = [name for name in PlanKeys.model_fields if name not in model.__annotations__]
    if issubclass(model, PlanKeys):
        found.append((f"{before}*", ", ".join(of_scene) + " as models/scene.toml has them"))
    for name, field in model.model_fields.items():
        if issubclass(model, PlanKeys) and name in of_scene:
            continue
        table, dots = table_in(field.annotation)
        meaning = field.description or (" ".join((table.__doc__ or "").split()) if table else str(field.default or ""))
        if table in known:
            meaning = f"as {known[table]}"
        assert meaning, f"{model.__name__}.{name} needs a description"
        name = field.alias or name
        found.append((f"{before}{name}" + ("?" if field.exclude_if else ""), meaning))
        if table and table not in known:
            known[table] = before + name
            found += rows(table, f"{before}{name}{dots}", known)
    return found


def keys() -> str:
    """Return the CSV text of the table."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["file", "key", "meaning"])
    known: dict[type[BaseModel], str] = {}
    for file, model in FILES.items():
        table.writerows([file, key, meaning] for key, meaning in rows(model, "", known))
        known = {table: place if ":" in place else f"{file}:{place}" for table, place in known.items()}
    return text.getvalue()


def test_the_table_lists_the_keys_as_they_are_defined() -> None:
    """The file has exactly the defined keys with their meanings."""
    assert TABLE.read_text(encoding="utf-8") == keys(), "python tests/unit/test_run_folder_keys.py writes it anew"


if __name__ == "__main__":
    TABLE.write_text(keys(), encoding="utf-8")
