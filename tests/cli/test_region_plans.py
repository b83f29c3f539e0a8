"""`cell plan` with regions: the requirement of each region is met, reported, and used by all later commands."""

import json
import shutil
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from cell.runs.cell import read_cell
from cell.runs.run import open_run
from tests.support.fixture_types import RunCommand

_REGIONS = """
[part]
path = "block.stl"
units = "mm"

[scanner]
sensor = "generic-area-medium"

[plan]
faces = 60
samples_per_face = 2
candidates = "optimal-scanning-zone"
coverage = 0.9

[[region]]
name = "top"
box_mm = [-31, -31, 19, 31, 31, 21]
views = 2
max_spacing_mm = 0.6

[[region]]
name = "side"
box_mm = [-31, -31, 0, 31, -29, 19]
coverage = 0.5

[[region]]
name = "skin"
care = "no"
"""


@pytest.fixture(scope="session")
def regions(
    made_once: Callable[..., Path], run_cell: RunCommand, drawing: Callable[[], AbstractContextManager[None]]
) -> Path:
    """Return a folder with a plan of a block with requirements for its top and for one of its sides."""

    def make(folder: Path) -> None:
        trimesh.creation.box((60.0, 60.0, 40.0)).export(folder / "block.stl")
        (folder / "scene.toml").write_text(_REGIONS)
        with drawing():
            process = run_cell("plan", "--scene", "scene.toml", "--place", "1000,300,200", "--out", "run", cwd=folder)
        assert process.returncode == 0, process.stderr
        assert "region top" in process.stdout

    return made_once("regions", make)


def report_of(folder: Path) -> dict[str, Any]:
    """Return the content of report.json."""
    return json.loads((folder / "report.json").read_text())


def test_each_region_meets_its_targets(regions: Path) -> None:
    """Areas match the drawing. Shares, two views for each coverable sample of the top, and spacing limits are met."""
    report = report_of(regions / "run")
    top, side = report["regions"]
    assert (top["name"], side["name"]) == ("top", "side")
    assert top["area_mm2"] == pytest.approx(60 * 60 + 4 * 60 * 1)
    assert side["area_mm2"] == pytest.approx(60 * 19 + 2 * 19)
    assert side["visible_of_coverable"] >= 0.5
    assert top["visible_of_coverable"] >= 0.9
    run = open_run(regions / "run")
    M, views = run.measurability, [view.id for view in run.plan.views]
    loads = np.asarray(M.matrix().astype(int)[:, views].sum(axis=1)).ravel()
    available = np.asarray(M.matrix().sum(axis=1)).ravel()
    of_top = (M.samples.region == 0) & (available > 0)
    enough = (loads >= np.minimum(2, available))[of_top]
    assert M.samples.areas[of_top][enough].sum() >= 0.9 * M.samples.areas[of_top].sum() * (1 - 1e-9)
    law = read_cell(run).scanner.spacing
    poses, points, normals = run.candidates.T_object_scanner[:, 0], M.samples.points, M.samples.normals
    for row in np.flatnonzero(M.samples.region == 0)[::25]:
        for view in M.indices[M.indptr[row] : M.indptr[row + 1]]:
            R, t = poses[view, :3, :3], poses[view, :3, 3]
            assert law((points[row] - t)[None] @ R, normals[row][None] @ R)[0] <= 0.6e-3 * (1 + 1e-9)


def test_the_page_shows_regions_and_surface_without_requirement(
    regions: Path, data_of: Callable[[str], dict[str, Any]]
) -> None:
    """The page has a colouring by region and a separate piece for the surface without requirement."""
    data = data_of((regions / "run" / "view.html").read_text())
    assert "Regions" in [layer["title"] for layer in data["surfaces"][0]["layers"]]
    assert "part, not required" in [piece["name"] for piece in data["pieces"]]
    assert any(name == "region top" for name, _ in data["rows"])
    assert "| top | 3,840 |" in (regions / "run" / "report.md").read_text()


def test_commands_that_go_on_know_the_regions(regions: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """`why` names the regions, `edit` keeps them, and a scan measures what is predicted for them."""
    run = tmp_path / "run"
    shutil.copytree(regions / "run", run)
    why = json.loads(run_cell("why", run, "--samples", "3000", "--json", cwd=tmp_path).stdout)
    assert all("in top" in group["detail"] or "in side" in group["detail"] for group in why["groups"])
    process = run_cell("edit", run, "--drop", 1, "--repair", "--out", "edited", cwd=tmp_path)
    assert process.returncode in (0, 3), process.stderr
    edited = report_of(tmp_path / "edited")
    assert [region["name"] for region in edited["regions"]] == ["top", "side"]
    assert edited["regions"][1]["visible_of_coverable"] >= 0.5
    run_cell("diff", run, "edited", "--json", cwd=tmp_path, code=0)
    scanned = run_cell("scan", run, "--json", cwd=tmp_path)
    assert scanned.returncode in (0, 3), scanned.stderr
    executed = json.loads(scanned.stdout)
    coverage, predicted = executed["coverage"], report_of(regions / "run")["regions"]
    assert coverage["visible"] == pytest.approx(coverage["predicted"], abs=0.01)
    for own, planned in zip(executed["regions"], predicted, strict=True):
        assert own["name"] == planned["name"]
        assert own["visible"] == pytest.approx(planned["visible"], abs=0.01)
        assert own["satisfied_share"] == pytest.approx(planned["satisfied_share"], abs=0.02)


@pytest.mark.parametrize(
    ("limit", "exit_code", "output"),
    [
        ("max_spacing_mm = 0.1", 2, "'top' requires points at most 0.1 mm apart, and generic-area-medium"),
        ("max_sigma_mm = 0.00001", 4, "a sigma of at most 1e-05 mm"),
    ],
)
def test_unattainable_limits_of_a_region_are_refused(
    regions: Path, run_cell: RunCommand, tmp_path: Path, limit: str, exit_code: int, output: str
) -> None:
    """The error names the region and its limit."""
    shutil.copy(regions / "block.stl", tmp_path)
    text = _REGIONS.replace("max_spacing_mm = 0.6", limit).partition('[[region]]\nname = "side"')[0]
    (tmp_path / "scene.toml").write_text(text + '[[region]]\nname = "skin"\ncare = "no"\n')
    process = run_cell(
        "plan", "--scene", "scene.toml", "--place", "1000,300,200", "--out", "run", cwd=tmp_path, code=exit_code
    )
    assert output in process.stderr.replace("\n", " ")


def test_an_edit_meets_the_targets_of_regions_and_options(regions: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """An unchanged plan stays valid after repeated edits. The default share of the whole surface is not required."""
    scene = (
        _REGIONS.partition("coverage")[0]
        + """[[region]]
        name = "side"
        box_mm = [-31, -31, 0, 31, -29, 19]
        weight = 40.0"""
    )
    shutil.copy(regions / "block.stl", tmp_path)
    (tmp_path / "scene.toml").write_text(scene)
    place = ("--scene", "scene.toml", "--place", "1000,300,200")
    for name, options in (("weighted", ("--coverage", "0.9")), ("most", ("--max-views", "1"))):
        process = run_cell("plan", *place, *options, "--out", name, cwd=tmp_path, code=0)
        assert report_of(tmp_path / name)["coverage"]["visible_of_coverable"] < 0.9
        for before, after in ((name, f"{name}1"), (f"{name}1", f"{name}2")):
            process = run_cell("edit", before, "--keep-order", "--out", after, cwd=tmp_path)
            assert (process.returncode, "less than" in process.stderr) == (0, False), process.stderr


def test_a_region_without_samples_is_reported(run_cell: RunCommand, tmp_path: Path) -> None:
    """A region of 0.01 mm2 has an area and no held-out sample: exit code 3 and a sentence, in the report as well."""
    trimesh.creation.box((60.0, 60.0, 40.0)).export(tmp_path / "block.stl")
    tiny = '[[region]]\nname = "tiny"\nbox_mm = [0, 0, 19, 0.1, 0.1, 21]\n'
    (tmp_path / "scene.toml").write_text(_REGIONS.split("[[region]]")[0] + tiny)
    options = ("--scene", "scene.toml", "--place", "1000,300,200", "--out")
    process = run_cell("plan", *options, "run", cwd=tmp_path, code=3)
    sentence = "the region 'tiny' cannot be measured: none of the 10,000 samples of the surface lies in its 0.01 mm2"
    assert sentence in process.stderr
    tiny, rest = report_of(tmp_path / "run")["regions"]
    assert (tiny["name"], tiny["visible"], tiny["area_mm2"]) == ("tiny", 0.0, pytest.approx(0.01))
    assert rest["visible_of_coverable"] >= 0.9
    process = run_cell("setups", *options, "both", "--proposals", "1", cwd=tmp_path, code=3)
    assert sentence in process.stderr
