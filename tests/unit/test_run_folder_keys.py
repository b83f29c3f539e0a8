"""docs/internals/run_folder.md lists the keys of the JSON files as their definitions say them.

Written anew by `python tests/unit/test_run_folder_keys.py`.
"""

from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel

from cell.run.execution_json import ExecutionReport
from cell.run.explore_json import ExploreFile
from cell.run.manifest_json import Manifest
from cell.run.plan_json import PlanFile
from cell.run.report_json import Report
from cell.run.scene_json import ResolvedScene
from cell.run.setups_json import ScannedSetups, SetupsFile
from cell.run.why_json import WhyReport
from cell.scene.plan_settings import PlanKeys

PAGE = Path(__file__).parents[2] / "docs" / "internals" / "run_folder.md"
BEGIN, END = "<!-- keys: `python tests/unit/test_run_folder_keys.py` writes them -->\n", "<!-- end of keys -->\n"
FILES = {
    "plan.json": PlanFile,
    "report.json": Report,
    "scene.resolved.json": ResolvedScene,
    "manifest.json of a run and of an execution; what is not known is left out": Manifest,
    "report.json of an execution": ExecutionReport,
    "why/why.json": WhyReport,
    "explore.json of an exploration": ExploreFile,
    "setups.json of `cell setups`": SetupsFile,
    "scanned/report.json of `cell scan SETUPS`": ScannedSetups,
}


def table_in(annotation: Any) -> tuple[type[BaseModel] | None, str]:
    """The table that an annotation names, and what its keys are called behind: "." for one, "[]." for a list."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation, "."
    found = [table_in(inner) for inner in get_args(annotation)]
    table, dots = next((pair for pair in found if pair[0]), (None, ""))
    return table, "[]" + dots if table and getattr(annotation, "__origin__", None) is tuple else dots


def rows(model: type[BaseModel], before: str, known: dict[type[BaseModel], str]) -> list[tuple[str, str]]:
    """Key and meaning of a table's keys, of those inside it too; `known` are tables that were listed, and where."""
    found = []
    of_scene = [name for name in PlanKeys.model_fields if name not in model.__annotations__]
    if issubclass(model, PlanKeys):
        found.append((f"`{before}*`", ", ".join(f"`{name}`" for name in of_scene) + " as models/scene.toml has them"))
    for name, field in model.model_fields.items():
        if issubclass(model, PlanKeys) and name in of_scene:
            continue
        table, dots = table_in(field.annotation)
        meaning = field.description or (" ".join((table.__doc__ or "").split()) if table else str(field.default or ""))
        if table in known:
            meaning = f"as `{known[table]}`"
        assert meaning, f"{model.__name__}.{name} needs a description"
        name = field.alias or name
        found.append((f"`{before}{name}`" + ("?" if field.exclude_if else ""), meaning))
        if table and table not in known:
            known[table] = before + name
            found += rows(table, f"{before}{name}{dots}", known)
    return found


def keys() -> str:
    """The section of the page."""
    lines: list[str] = []
    known: dict[type[BaseModel], str] = {}
    for file, model in FILES.items():
        lines += [f"### {file}", "", "|key||", "|---|---|"]
        lines += [f"|{key}|{meaning}|" for key, meaning in rows(model, "", known)] + [""]
        known = {table: place if ":" in place else f"{file}:{place}" for table, place in known.items()}
    return "\n".join(lines)


def test_the_page_lists_the_keys_as_they_are_defined() -> None:
    """Every key is in the page with its meaning, and the page knows no other."""
    section = PAGE.read_text(encoding="utf-8").split(BEGIN)[1].split(END)[0]
    assert section == keys(), "python tests/unit/test_run_folder_keys.py writes the section anew"


if __name__ == "__main__":
    text = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(text.split(BEGIN)[0] + BEGIN + keys() + END + text.split(END)[1], encoding="utf-8")
