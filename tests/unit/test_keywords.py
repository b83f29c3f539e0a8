"""The keywords of `cell.api` are the options of the command line, with types that a type checker checks."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import NoneType
from typing import Any, Literal, get_args, get_type_hints

import pytest
from mypy import api as mypy

from cell import api, keywords
from cell.cli import app
from cell.explore.options import SCAN_OPTIONS, ExploreOptions
from cell.export.options import ExportOptions
from cell.metrology.options import HandEyeOptions, InspectOptions, LocateOptions
from cell.plan.edit_options import Edit
from cell.plan.setup_options import SetupOptions
from cell.scan.options import ScanOptions
from cell.scene.model import Scene
from cell.scene.options import OptionSpec, option_specs
from cell.study.options import PlaceRange, StudyRun
from cell.view.replay_options import ReplayOptions

ROOT = Path(__file__).parents[2]
_PLAN, _STUDY = option_specs(Scene), {**option_specs(StudyRun), **option_specs(Scene, "units")}
TABLES: dict[type, Mapping[str, OptionSpec]] = {
    keywords.PlanKeywords: _PLAN,
    keywords.SetupsKeywords: {**_PLAN, **option_specs(SetupOptions)},
    keywords.EditKeywords: option_specs(Edit),
    keywords.ScanKeywords: option_specs(ScanOptions),
    keywords.ExploreKeywords: {**option_specs(ScanOptions, *SCAN_OPTIONS), **_PLAN, **option_specs(ExploreOptions)},
    keywords.LocateKeywords: option_specs(LocateOptions),
    keywords.FeaturesKeywords: option_specs(Scene, "units", "qif"),
    keywords.InspectKeywords: {**option_specs(Scene, "units", "qif"), **option_specs(InspectOptions)},
    keywords.HandEyeKeywords: option_specs(HandEyeOptions),
    keywords.ExportKeywords: option_specs(ExportOptions),
    keywords.ReplayKeywords: option_specs(ReplayOptions),
    keywords.StudyKeywords: _STUDY,
    keywords.PlaceKeywords: {**_STUDY, **option_specs(PlaceRange), **option_specs(Scene, "seed", "table")},
}
NO_FUNCTION = {
    "robot": "is `cell.world.robot_check.report`",
    "sensors": "is `cell.scene.sensors`",
    "emulate": "is a process of its own",
    "controller": "writes constant files",
    "live": "is a server",
}
WRONG = {
    "plan('mug', max_view=8)": 'did you mean "max_views"',
    "plan('mug', coverage='high')": 'expected "float"',
    "plan('mug', solver='best')": "'local-search'",
    "plan('mug', place=1200)": "Sequence[float]",
    "setups('mug', pin=3)": "Sequence[str]",
    "edit('run', drop='all')": "Sequence[int]",
    "scan('run', resolution='fine')": '"float | None"',
    "explore('mug', policy='greedy')": "'two-stage'",
    "export('run', format='karel')": "'krl'",
}


@pytest.mark.parametrize("typed", TABLES, ids=lambda typed: typed.__name__)
def test_keywords_are_the_options(typed: type) -> None:
    """Names, types and the permission of None follow from the table of the options."""
    hints, specs = get_type_hints(typed), TABLES[typed]
    scene_file = {"scene"} if typed in (keywords.StudyKeywords, keywords.PlaceKeywords) else set()
    assert hints.keys() == specs.keys() | scene_file
    differ = {name: (hints[name], expected(spec)) for name, spec in specs.items() if hints[name] not in expected(spec)}
    assert differ == {}


def expected(spec: OptionSpec) -> list[Any]:
    """Return the valid types of the keyword of an option."""
    kind, is_several = spec.kind, bool(spec.kind.length or spec.option.counts)
    types: list[Any]
    if spec.name in ("move", "turn", "add_pose"):
        return [Mapping[int, Sequence[float]], Mapping[int, float], Sequence[Sequence[float]]]
    if spec.by_unit:
        types = [keywords.WithUnits]
    elif kind.choices:
        types = [Literal[kind.choices]]
    elif kind.base is str:
        types = [keywords.Names] if is_several else [str, keywords.File]
    elif kind.base is Path:
        types = [keywords.File]
    else:
        several = Sequence[kind.base]  # type: ignore[name-defined]
        types = [kind.base | several, several] if is_several else [kind.base]
    is_optional = any(NoneType in get_args(field.annotation) for field in spec.fields.values())
    return [each | None for each in types] if is_optional else types


def test_every_command_is_a_function() -> None:
    """`cell NAME` is `cell.api.NAME`; spaces and hyphens are underscores."""
    names = {command.name or getattr(command.callback, "__name__", "") for command in visible(app)}
    for group in app.registered_groups:
        assert group.typer_instance is not None
        for command in visible(group.typer_instance):
            names.add(f"{group.name}_{command.name or getattr(command.callback, '__name__', '')}")
    assert {name.replace("-", "_") for name in names} - NO_FUNCTION.keys() <= set(api.__all__)


def visible(group: Any) -> list[Any]:
    """Return the commands of a group that `--help` shows."""
    return [command for command in group.registered_commands if not command.hidden]


def test_a_type_checker_finds_wrong_keywords(tmp_path: Path) -> None:
    """Valid calls pass. Each misspelt keyword and wrong type is an error on its line; modules behind are not read."""
    right, wrong, config = tmp_path / "right.py", tmp_path / "wrong.py", tmp_path / "mypy.ini"
    imports = "from cell.api import edit, explore, export, plan, replay, scan, setups, study_scanner\n"
    right.write_text(
        imports
        + "run = plan('mug', place=(1100, 300, 100), overlap={'mm2': 20}, standoff=[200, 300], max_views=None)\n"
        "scan(edit(run, drop=2, turn={1: 90}), resolution=2, pose_error='0.5mm,0.1deg')\n"
        "setups('mug', pin=['0:12'], max_setups=2)\n"
        "replay(run, picture='tour.png', size=(640, 480))\n"
        "study_scanner('mug', parameter='range', values=[(50, 150)], processes=2)\n"
    )
    wrong.write_text(imports + "\n".join(WRONG))
    config.write_text(
        f"[mypy]\nmypy_path = {ROOT}\nfollow_imports = skip\n[mypy-cell.api,cell.keywords]\nfollow_imports = normal\n"
    )
    shared = ["--config-file", str(config), "--cache-dir", str(tmp_path / "cache"), "--no-error-summary"]
    output, problems, _ = mypy.run([*shared, str(right), str(wrong)])
    assert problems == ""
    errors = [line.partition(f"{wrong.name}:")[2] for line in output.splitlines() if ": error:" in line]
    assert len(errors) == len(WRONG), output
    for number, (error, words) in enumerate(zip(errors, WRONG.values(), strict=True), start=2):
        assert error.startswith(f"{number}:"), output
        assert words in error
