"""Keys of the former schemas: complete, and read only in files that state such a schema."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

from cell.errors import FileError
from cell.runs import schema
from cell.runs.former_keys import FORMER_SCHEMAS, key_renames, with_present_keys
from cell.runs.schema import ExploreFile, SetupsFile, parsed
from tests.support.former_runs import former_keys, with_former_keys
from tests.unit.test_run_folder_keys import FILES, TABLE

NEW_KEYS = {
    "scene.resolved.json": {"path_tolerance_mm"},
    "manifest.json": {"overrides"},
    "executions/0001/report.json": {
        "deviation.edge_share",
        "deviation.with_edges",
        "settings.actual",
        "views[].determined_error_mm",
        "views[].determined_error_after_mm",
        "views[].determined_error_deg",
        "views[].determined_error_after_deg",
        "views[].undetermined_error_mm",
        "views[].undetermined_error_deg",
    },
}
"""Keys that no file of a former schema has."""

EXPLORED: dict[str, Any] = {
    "status": "finished", "part": "mug", "inputs": "", "seed": 0, "policy": "stepwise", "source": "simulated",
    "options": {"open": 1, "ended": {"stages": 2}}, "voxel_mm": 4.0, "batches": [], "stop_reason": "all is measured",
    "cylinder": {"diameter_mm": 90.0, "height_mm": 50.0, "centre_mm": [1.0, 2.0, 3.0], "user_defined": False},
    "uncovered": [{"cause": "occluded", "area_mm2": 3.0}],
}  # fmt: skip


def nested(keys: list[str]) -> dict[str, Any]:
    """Return a JSON object that has each key; lists have one entry."""
    tree: dict[str, Any] = {}
    for key in keys:
        node: Any = tree
        *tables, last = key.split(".")
        for table in tables:
            child = node.get(table.removesuffix("[]"))
            if child is None:
                child = node[table.removesuffix("[]")] = [{}] if table.endswith("[]") else {}
            node = child[0] if isinstance(child, list) else child
        node.setdefault(last, None)
    return tree


def paths(tree: Any, before: str = "") -> set[str]:
    """Return the keys of a JSON object as `former_keys` writes them."""
    found = set()
    for key, value in tree.items():
        found.add(before + key)
        if isinstance(value, list):
            found |= paths(value[0], f"{before}{key}[].")
        elif isinstance(value, dict):
            found |= paths(value, f"{before}{key}.")
    return found


@pytest.mark.parametrize("file", FILES)
def test_every_former_key_has_its_present_key(file: str) -> None:
    """The documented keys of the last version with a former schema become the documented keys of now but new ones."""
    lines = [line.split(",")[:2] for line in TABLE.read_text(encoding="utf-8").splitlines()]
    present = {key.replace("?", "") for name, key in lines if name == file and "*" not in key}
    tree = nested([key for key in former_keys()[file] if "*" not in key])
    expanded = with_present_keys(tree, FILES[file])
    assert paths(expanded) == present - NEW_KEYS.get(file, set())


def test_the_table_names_keys_that_exist() -> None:
    """Each entry names a class, a present key of it, and a former key that is none of its present keys."""
    for name, keys in key_renames().items():
        fields = getattr(schema, name).model_fields
        assert set(keys.values()) <= set(fields), name
        assert not set(keys) - {"candidates"} & set(fields), name


@pytest.mark.parametrize("former", FORMER_SCHEMAS)
def test_a_file_of_a_former_schema_is_read(former: str) -> None:
    """Keys of tables are converted at any depth, keys of the user are not, and unknown keys are ignored."""
    content = with_former_keys(EXPLORED, ExploreFile) | {"schema": former, "truth": {"visible": 1.0}}
    assert content["cylinder"]["middle_mm"] == [1.0, 2.0, 3.0]
    read = parsed(ExploreFile, json.dumps(content).encode(), Path("explore.json"))
    assert read.cylinder.centre_mm == (1.0, 2.0, 3.0)
    assert read.uncovered[0].cause == "occluded"
    assert read.options == EXPLORED["options"]


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"ended": "all is measured"}, "ended is an unknown key"),
        ({"uncovered": [{"reason": "occluded", "area_mm2": 3.0}]}, "uncovered[0].cause is missing"),
    ],
)
def test_a_former_key_in_a_file_of_this_schema_is_refused(change: dict[str, Any], sentence: str) -> None:
    """The present schema has one name for each value."""
    content = EXPLORED | {"schema": "scan-cell/run/3"} | change
    with pytest.raises(FileError, match=re.escape(sentence)):
        parsed(ExploreFile, json.dumps(content).encode(), Path("explore.json"))


@pytest.mark.parametrize("text", ['{"schema": "scan-cell/run/1", "coverage": [1]}', '{"schema": "scan-cell/run/2"}'])
def test_a_damaged_file_of_a_former_schema_is_refused(text: str) -> None:
    """Values of another type than a table, and missing keys, are damage as in a new file."""
    with pytest.raises(FileError, match=r"^setups\.json is damaged: [^\n]*; plan or scan again$"):
        parsed(SetupsFile, text.encode(), Path("setups.json"))
