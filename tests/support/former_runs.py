"""Run folders as the schemas scan-cell/run/1 and scan-cell/run/2 wrote them, made from new ones.

`former_keys.txt` lists the keys of the JSON files of these schemas, as documented by the last version that wrote them.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from cell.runs.former_keys import FORMER_ARRAYS, key_renames, nested_table
from cell.runs.schema import ExecutionReport, Manifest, PlanFile, Report, ResolvedScene

_RUN_FILES: Mapping[str, type[BaseModel]] = {
    "plan.json": PlanFile,
    "report.json": Report,
    "scene.resolved.json": ResolvedScene,
    "manifest.json": Manifest,
}
_EXECUTION_FILES: Mapping[str, type[BaseModel]] = {"report.json": ExecutionReport, "manifest.json": Manifest}


def former_keys() -> dict[str, list[str]]:
    """Return the keys of each JSON file of the former schemas, such as "views[].sweep.q_deg"."""
    found: dict[str, list[str]] = {}
    for line in Path(__file__).with_name("former_keys.txt").read_text(encoding="utf-8").splitlines():
        if line.startswith("  "):
            found[list(found)[-1]].append(line.strip())
        else:
            found[line] = []
    return found


def with_former_keys(content: Any, table: type[BaseModel]) -> Any:
    """Return a JSON value of the present schema with the former keys of a table."""
    if isinstance(content, list):
        return [with_former_keys(each, table) for each in content]
    if not isinstance(content, dict):
        return content
    names = {new: old for each in table.__mro__ for old, new in key_renames().get(each.__name__, {}).items()}
    nested = {field.alias or name: nested_table(field.annotation) for name, field in table.model_fields.items()}
    return {
        names.get(key, key): with_former_keys(value, kind) if (kind := nested.get(key)) else value
        for key, value in content.items()
    }


def make_former(run: Path, schema: str) -> None:
    """Rewrite a run folder and its executions as a former schema; hashes and digest are not updated."""
    for folder, files in ((run, _RUN_FILES), *((path, _EXECUTION_FILES) for path in (run / "executions").glob("*"))):
        for name, table in files.items():
            content = json.loads((folder / name).read_text()) | {"schema": schema}
            (folder / name).write_text(json.dumps(with_former_keys(content, table), indent=2) + "\n")
    names = {new: old for old, new in FORMER_ARRAYS.items()}
    for path in (run / "motion.npz", *(run / "executions").glob("*/scans/*.npz")):
        with np.load(path) as stored:
            arrays = {names.get(name, name): stored[name] for name in stored.files}
        np.savez_compressed(path, **arrays)
