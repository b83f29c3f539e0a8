"""Options from fields: every key is an option or file-only; texts and values are equivalent; examples parse."""

import inspect
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from pydantic import BaseModel

from cell.cli import app, options
from cell.errors import SceneError, UsageError
from cell.explore.options import ExploreOptions
from cell.export.options import ExportOptions
from cell.metrology.options import HandEyeOptions, LocateOptions
from cell.scan.emulator_options import EmulateOptions
from cell.scan.options import ScanOptions
from cell.scene.file import option_tables, scene_from_options
from cell.scene.model import PlanSettings, Scene
from cell.scene.options import flag, option_specs, parse_options
from cell.study.options import PlaceRange, StudyRun
from cell.view.replay_options import ReplayOptions

FILE_ONLY = {
    "view_sphere_step_deg": "of one generator of candidates only",
    "scan_s": "a fact of the scanner, which no plan changes",
    "settle_s": "a fact of the arm, which no plan changes",
    "ensemble": "more of it changes seconds, hardly a plan",
}
MODELS = (
    *(
        Scene,
        ScanOptions,
        ExploreOptions,
        PlaceRange,
        StudyRun,
        ReplayOptions,
        ExportOptions,
        EmulateOptions,
        LocateOptions,
    ),
    HandEyeOptions,
)
ROOT: Any = typer.main.get_command(app)


def _examples(command: Any) -> list[str]:
    """Return the lines of all epilogs that are commands."""
    own = [line for line in (command.epilog or "").split("\n\n") if line.startswith("cell ")]
    return own + [line for each in getattr(command, "commands", {}).values() for line in _examples(each)]


def _parsed(line: str) -> tuple[Any, dict[str, object]]:
    """Return the function of a command and its parsed arguments."""
    command, words = ROOT, shlex.split(line)[1:]
    while words and words[0] in getattr(command, "commands", {}):
        command, words = command.commands[words[0]], words[1:]
    function = inspect.unwrap(command.callback)
    return function, options.arguments(function, command.make_context("cell", words).params)


def test_every_key_of_the_plan_is_offered_or_file_only_with_a_reason() -> None:
    """Each key is either an option or file-only, and never both."""
    offered = {key.removeprefix("plan.") for offer in option_specs(Scene).values() for key in offer.fields}
    assert set(PlanSettings.model_fields) - offered == set(FILE_ONLY)


@pytest.mark.parametrize("model", MODELS)
def test_every_option_shows_its_unit_limits_and_choices(model: type[BaseModel]) -> None:
    """A key with a unit shows it; limits of the field and each choice are in the help."""
    for offer in option_specs(model).values():
        assert offer.help.endswith("."), offer.name
        text = f"{offer.metavar} {offer.help}".lower()
        for key, field in offer.fields.items():
            unit = re.search(r"_(mm2|mm|deg|percent|share)$", key)
            assert unit is None or {"share": "%"}.get(unit[1], unit[1]) in text, key
            for bound in (
                getattr(each, word) for each in field.metadata for word in ("ge", "le") if hasattr(each, word)
            ):
                assert offer.by_unit or bound > 1e9 or f"{bound:g}" in offer.help, key
        assert all(choice in offer.help for choice in offer.kind.choices), offer.name


def test_the_help_imports_nothing_heavy() -> None:
    """Creating all commands with all options imports no array, engine or plot library."""
    code = (
        "import sys; from typer.main import get_command; from cell.cli import app; get_command(app); "
        "assert not {'numpy', 'scipy', 'mujoco', 'trimesh', 'matplotlib', 'numba'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


@pytest.mark.parametrize("line", _examples(ROOT))
def test_every_example_of_the_help_parses(line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The options of each example exist, their texts are valid, and a named scene is valid."""
    monkeypatch.chdir(tmp_path)
    for name in ("part.stl", "part.stp", "part.qif", "my_cell.toml"):
        (tmp_path / name).touch()
    function, arguments = _parsed(line)
    if {"given", "scene"} <= set(inspect.signature(function).parameters):
        assert scene_from_options(arguments["scene"], arguments["given"], arguments.get("part"), flag)


def test_every_visible_command_has_an_example() -> None:
    """The help of each visible command has at least one line to copy."""
    commands = {name for name, command in ROOT.commands.items() if not command.hidden}
    assert commands <= {line.split()[1] for line in _examples(ROOT)}


def test_values_and_texts_are_equivalent() -> None:
    """Both forms of each kind give the same tables, and numbers of NumPy are accepted as numbers."""
    texts = {
        "place": "1200,500,0,90,0,0", "standoff": "300", "roll": "0,90", "pin": "1,2", "overlap": "20%", "curve": True,
        "pose_sd": "0.5mm,0.1deg", "seed": "7", "coverage": "0.9", "cost": "time", "speed": "0.5", "faces": None,
        "camera": "-60,20", "hide": "robot,floor",
    }  # fmt: skip
    values = {
        "place": np.array([1200.0, 500, 0, 90, 0, 0]), "standoff": 300, "roll": (0, 90), "pin": [1, 2],
        "overlap": {"%": 20}, "curve": True, "pose_sd": {"mm": 0.5, "deg": 0.1}, "seed": np.int64(7), "coverage": 0.9,
        "cost": "time", "speed": 0.5, "camera": (-60.0, 20.0), "hide": ["robot", "floor"],
    }  # fmt: skip
    requests = option_tables(texts, "mug")
    assert requests == option_tables(values, "mug")
    assert requests["part"] == {"name": "mug"}
    assert requests["placement"] == {"position_mm": [1200, 500, 0], "abc_deg": [90, 0, 0]}
    assert requests["plan"]["overlap_share"] == 0.2
    assert (requests["plan"]["pose_sd_mm"], requests["plan"]["pose_sd_deg"]) == (0.5, 0.1)
    assert option_tables({"overlap": "500mm2"}) == {"plan": {"overlap_mm2": 500.0}}
    assert option_tables({"place": (1, 2, 3)}) == {"placement": {"position_mm": [1, 2, 3]}}


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"coverag": 0.9}, "there is no option coverag; did you mean 'coverage'? there are "),
        ({"place": (1200, 500)}, "place (1200, 500) must be x,y,z or x,y,z,A,B,C (mm and deg), for instance place 1"),
        ({"overlap": 0.2}, "overlap 0.2 must be a share of the smaller view or an area, for instance overlap 20% or"),
        ({"overlap": "20%,30%"}, "overlap 20%,30% must be"),
        ({"pose_sd": "1mm,2kg"}, "with their units"),
        ({"standoff": "200,x"}, "standoff 200,x must be numbers separated by commas"),
        ({"seed": "1.5"}, "seed 1.5 must be a whole number"),
        ({"alpha": ""}, "alpha  must be a number"),
    ],
)
def test_an_invalid_option_is_named_as_it_was_written(settings: dict[str, Any], words: str) -> None:
    """The message has the keyword of Python or the option of the command line."""
    with pytest.raises(UsageError) as caught:
        option_tables(settings)
    assert words in str(caught.value)
    with pytest.raises(UsageError, match="--"):
        option_tables(settings, spell=flag)


def test_a_contradiction_names_options_and_keys_as_they_were_written(tmp_path: Path) -> None:
    """The message names every key of a contradiction in the form in which the user wrote it."""
    path = tmp_path / "scene.toml"
    path.write_text("[plan]\ncoverage = 0.9\n", encoding="utf-8")
    with pytest.raises(SceneError, match=r"  max_views and plan\.coverage both limit"):
        scene_from_options(path, {"max_views": 3})
    with pytest.raises(SceneError, match="  --max-views and --coverage both limit"):
        scene_from_options(None, {"max_views": "3", "coverage": "0.9"}, spell=flag)
    with pytest.raises(SceneError, match=r"--standoff\[1\] is -5.0; it must be above 0"):
        scene_from_options(None, {"standoff": "200,-5"}, spell=flag)


def test_options_of_a_scan_are_those_given_and_checked() -> None:
    """Given options are recorded, invalid ones are refused in one sentence, and a manifest restores them."""
    requests = parse_options(ScanOptions, {"pose_error": "0.5mm,0.1deg", "register": False}, flag)
    assert requests.model_fields_set == {"pose_error_mm", "pose_error_deg", "registration"}
    assert (requests.pose_error_mm, requests.pose_error_deg, requests.registers) == (0.5, 0.1, False)
    assert ScanOptions.from_manifest({**requests.as_manifest(), "of_later": 1}) == requests
    with pytest.raises(UsageError, match="--noise is 'loud'; valid are: none, model"):
        parse_options(ScanOptions, {"noise": "loud"}, flag)
    with pytest.raises(ValueError, match="seed is 'three'; it must be a whole number"):
        ScanOptions.from_manifest({"seed": "three"})


def test_a_resumed_scan_has_its_original_options() -> None:
    """A resumed scan takes speed and similar options from the new command, and the driver only if it is given."""
    begun = ScanOptions(driver="serial:///dev/x", range_noise_mm=0.1, speed=0.5, reset=True)
    now = begun.resumed(ScanOptions(speed=0.05))
    assert (now.driver, now.range_noise_mm, now.speed, now.reset) == ("serial:///dev/x", 0.1, 0.05, False)
    assert begun.resumed(ScanOptions(driver="sim://")).driver == "sim://"
