"""Values of the JSON files of a plan: written, read, from earlier versions, damaged."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.errors import FileError
from cell.runs.folder import SCHEMA, json_text
from cell.runs.schema import JsonTable, PlanFile, Report, ReportSettings, ResolvedScene, ScannerKeys, parsed

FILES = {"plan.json": PlanFile, "report.json": Report, "scene.resolved.json": ResolvedScene}


def read(kind: type[JsonTable], content: Any) -> Any:
    """Parse a changed content."""
    return parsed(kind, json.dumps(content).encode(), Path("file.json"))


def content_of(folder: Path, name: str) -> Any:
    """Return the JSON of a file."""
    return json.loads((folder / name).read_text())


@pytest.mark.parametrize("name", FILES)
def test_a_file_that_is_read_is_written_again_byte_for_byte(name: str, planned: Path) -> None:
    """Keys, their order and every digit are unchanged."""
    written = (planned / name).read_bytes()
    value = parsed(FILES[name], written, planned / name)
    assert json_text({"schema": SCHEMA, **value.as_json()}).encode() == written


def test_files_of_earlier_versions_are_read(planned: Path) -> None:
    """Keys that are missing in earlier versions have the value None or the only value of that time."""
    plan, scene, report = (content_of(planned, name) for name in ("plan.json", "scene.resolved.json", "report.json"))
    del plan["clearance"], plan["coverage"]["visible_with_arm"], plan["coverage"]["target_on_samples"]
    del scene["joint_jerk_limits_deg_s3"], report["motion"]["jerk_free_bound_s"], report["clearance"]
    scene["plan"] = {key: scene["plan"][key] for key in ("candidates", "coverage", "required_visible", "seed")}
    assert read(PlanFile, plan).clearance is None
    assert read(ResolvedScene, scene).plan.collision == "hull"
    assert read(ResolvedScene, scene).plan.multiplicity == 1
    assert read(Report, report).motion.jerk_free_bound_s == 0
    assert read(PlanFile, plan | {"schema": "scan-cell/run/1", "key of that version": 1}).views


@pytest.mark.parametrize(
    ("path", "value", "sentence"),
    [
        (("coverage", "visible"), ..., "coverage.visible is missing"),
        (("coverage", "visible"), "0.9", "coverage.visible is '0.9'; it must be a number"),
        (
            ("views", 0, "T_base_flange"),
            [[1.0, 0.0, 0.0, 0.0]] * 3,
            r"views\[0\].T_base_flange is no transform: it must be four rows of four finite numbers",
        ),
        (("views", 1, "q_deg"), [0.0] * 5, r"views\[1\].q_deg has 5 values; it must have 6"),
        (("views", 1, "q_deg", 2), float("nan"), r"views\[1\].q_deg\[2\] is nan; it must be a finite number"),
        (("clearance", "collision"), "sphere", "clearance.collision is 'sphere'; valid are: hull, decomposed, exact"),
        (("views",), {}, r"views is \{\}; it must be a list"),
    ],
    ids=lambda value: str(value)[:24],
)
def test_a_damaged_value_has_one_message(path: tuple[str | int, ...], value: Any, sentence: str, planned: Path) -> None:
    """The message has the key, its value and the valid values."""
    content = content_of(planned, "plan.json")
    table = content
    for step in path[:-1]:
        table = table[step]
    if value is ...:
        del table[path[-1]]
    else:
        table[path[-1]] = value
    with pytest.raises(FileError, match=rf"^file\.json is damaged: {sentence}[^\n]*; plan or scan again$"):
        read(PlanFile, content)


def test_a_file_without_a_json_object_is_refused() -> None:
    """A list and a cut file have one message each."""
    with pytest.raises(FileError, match=r"it must hold one JSON object"):
        read(Report, [1])
    with pytest.raises(FileError, match=r"it is not JSON, or nested too deep"):
        parsed(Report, b'{"part": ', Path("file.json"))


def test_the_keys_of_a_plug_in_are_kept_as_they_are(planned: Path) -> None:
    """The keys of a plug-in follow its type in their own order, and each is read by its kind."""
    keys = {"zeta_deg": 3, "alpha_of_its_own": {"a": [None, True]}, "range_mm": [1.0, 2.5], "fov_deg": 30.0}
    scanner = ScannerKeys(type="cone", **keys)
    assert list(scanner.as_json()) == ["type", *keys]
    assert (scanner.number("zeta_deg"), scanner.pair("range_mm")) == (3, (1.0, 2.5))
    assert scanner.pair("fov_deg") is scanner.number("range_mm") is scanner.number("baseline_mm") is None
    settings = content_of(planned, "report.json")["settings"]
    again = ReportSettings(**settings, zeta_deg=3).as_json()
    assert list(again)[:3] == list(settings)[:3]
    assert list(again).index("zeta_deg") < list(again).index("standoffs_mm")


def test_values_are_read_only(planned: Path) -> None:
    """Fields and transforms are read-only."""
    plan = read(PlanFile, content_of(planned, "plan.json"))
    with pytest.raises(ValueError, match="frozen"):
        plan.gap = 1.0
    with pytest.raises(ValueError, match="read-only"):
        plan.views[0].T_base_scanner[0, 0] = 2.0
    assert plan.views[0].T_object_poses.shape == (1, 4, 4)
    np.testing.assert_allclose(np.degrees(plan.views[0].q), plan.views[0].q_deg)
