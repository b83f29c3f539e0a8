"""`cell setups --first RUN`: a finished plan is the fixed first set-up, and only further ones are planned."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from cell.api import open_run
from tests.seen_samples import seen_samples
from tests.support.fixture_types import RunCommand

BOX = ("--units", "mm", "--place", "1100,400,100", "--standoff", "250", "--faces", "40")
OPTIONS = ("--coverage", "0.97", "--proposals", "5")


@pytest.fixture(scope="module")
def setups_folder(made_once: Callable[..., Path], planned: Path, run_cell: RunCommand) -> Path:
    """Return a folder of set-ups with the planned run, which has an execution, as the first one."""

    def make(folder: Path) -> None:
        shutil.copytree(planned, folder / "first")
        run_cell("scan", "first", "--resolution", "2", "--json", cwd=folder, code=0)
        run_cell("setups", *OPTIONS, "--first", "first", "--out", "made", "--json", cwd=folder, code=0)

    return made_once("first_setup", make) / "made"


def test_the_first_set_up_is_the_given_plan_with_its_executions(setups_folder: Path, planned: Path) -> None:
    """The first set-up is an exact copy. Its placement is a set-up candidate and is not proposed again."""
    file = json.loads((setups_folder / "setups.json").read_text())
    first = setups_folder / "setups" / "1"
    assert file["part"] == open_run(planned).scene.part.name
    assert file["selected"][0]["digest"] == open_run(first).digest == open_run(planned).digest
    for path in planned.iterdir():
        if path.is_file():
            assert (first / path.name).read_bytes() == path.read_bytes()
    assert (first / "executions" / "0001" / "manifest.json").is_file()
    candidate = file["candidates"][file["selected"][0]["candidate"]]
    assert candidate["reachable"] == file["selected"][0]["views"] == len(open_run(planned).candidate)
    np.testing.assert_allclose(candidate["placement_mm"], [1100, 400, 100], atol=1e-6)
    assert "as it is placed" not in [each["name"] for each in file["candidates"]]


def test_the_other_set_ups_cover_the_remaining_surface(setups_folder: Path) -> None:
    """The coverage is that of all views together. The further set-ups increase it to the target."""
    file = json.loads((setups_folder / "setups.json").read_text())
    assert len(file["selected"]) > 1
    seen = [seen_samples(setups_folder / each["folder"]) for each in file["selected"]]
    together = np.logical_or.reduce(seen)
    assert file["coverage"]["visible"] == pytest.approx(together.mean(), abs=2e-3)
    assert file["selected"][0]["visible"] == pytest.approx(seen[0].mean(), abs=2e-3)
    assert together.mean() > seen[0].mean() + 0.02
    assert file["coverage"]["visible_of_coverable"] >= 0.97


def test_a_scan_of_the_set_ups_goes_on_with_the_second(
    setups_folder: Path, run_cell: RunCommand, tmp_path: Path
) -> None:
    """The execution of the first set-up is used, and only the others are scanned."""
    shutil.copytree(setups_folder, tmp_path / "made")
    process = run_cell("scan", "made", "--resolution", "2", "--json", cwd=tmp_path, code=0)
    report = json.loads(process.stdout)
    assert report["missing_setups"] == []
    assert [setup["execution"] for setup in report["setups"]] == ["0001"] * len(report["setups"])
    assert "set-up 1 of" not in process.stderr


def test_the_first_set_up_has_the_same_part(planned: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """Another mesh and other options are refused with exit code 2, a missing run with 6."""
    trimesh.creation.box([120, 60, 60]).export(tmp_path / "box.stl")
    process = run_cell("setups", "box.stl", *BOX, *OPTIONS, "--first", planned, "--out", "made", cwd=tmp_path, code=2)
    assert "give a plan of the same part" in process.stderr
    process = run_cell("setups", "--baseline", "60", "--first", planned, "--out", "other", cwd=tmp_path, code=2)
    assert "give part and options, or a scene file" in process.stderr
    run_cell("setups", "--first", "nothing", "--out", "other", cwd=tmp_path, code=6)


def test_the_earlier_option_names_the_new_form(planned: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """`cell plan --open-of RUN` is refused with the new command in the message."""
    process = run_cell("plan", "--open-of", planned, "--place", "1100,400,100,0,0,180", cwd=tmp_path, code=2)
    assert f"cell setups --first {planned}" in " ".join(process.stderr.split())
