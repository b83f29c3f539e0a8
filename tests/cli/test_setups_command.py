"""`cell setups` on the command line: a folder with a run for each set-up, numbers of set-ups and views with bounds."""

import json
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
import trimesh

from cell.api import open_run, setups
from cell.plan.setup_candidates import Setup
from cell.plan.setups import cause_of_omission
from cell.runs.cell import read_cell
from tests.seen_samples import seen_samples
from tests.support.fixture_types import RunCommand


@pytest.fixture
def setups_folder(made_setups: Path) -> Path:
    """Return the folder of the small part's set-ups, chosen from four candidates. The file `stdout` is next to it."""
    return made_setups


def test_the_set_ups_together_measure_the_reported_coverage(setups_folder: Path) -> None:
    """The coverage is the union of all runs on the held-out samples. The number of set-ups equals its bound."""
    output = json.loads((setups_folder / "setups.json").read_text())
    seen = [seen_samples(setups_folder / setup["folder"]) for setup in output["selected"]]
    assert output["coverage"]["visible"] == pytest.approx(np.logical_or.reduce(seen).mean(), abs=1e-12)
    assert [setup["visible"] for setup in output["selected"]] == pytest.approx(
        [each.mean() for each in seen], abs=1e-12
    )
    assert sum(setup["marginal_coverage"] for setup in output["selected"]) == pytest.approx(
        output["coverage"]["visible"], abs=1e-12
    )
    assert output["coverage"]["visible_of_coverable"] >= 0.97
    assert len(output["selected"]) == output["setups_bound"]
    assert output["views"] == sum(setup["views"] for setup in output["selected"]) >= output["views_bound"] >= len(seen)
    assert len(output["candidates"]) == 4
    assert max(each["coverable"] for each in output["candidates"]) <= output["coverage"]["coverable"]
    assert "proven fewest of 4 set-up candidates" in " ".join(
        (setups_folder.parent / "stdout").read_text().replace("│", " ").split()
    )
    assert "## Set-up candidates" in (setups_folder / "report.md").read_text()


def test_each_set_up_is_a_run_of_its_own(setups_folder: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """All runs have the same samples as rows and the digests of setups.json. A run is scanned like any other."""
    output = json.loads((setups_folder / "setups.json").read_text())
    points = [np.load(setups_folder / setup["folder"] / "measurability.npz")["points"] for setup in output["selected"]]
    for other in points[1:]:
        np.testing.assert_array_equal(other, points[0])
    for setup in output["selected"]:
        run = open_run(setups_folder / setup["folder"])
        assert run.digest == setup["digest"]
        offered = output["candidates"][setup["candidate"]]
        assert list(run.report.settings.placement_mm) == offered["placement_mm"]
        assert list(run.report.settings.placement_abc_deg) == offered["placement_abc_deg"]
    shutil.copytree(setups_folder, tmp_path / "made")
    run_cell("scan", "made/setups/1", "--json", cwd=tmp_path, code=0)
    process = run_cell("replay", "made", "--picture", "x.png", cwd=tmp_path, code=6)
    assert "made holds several set-ups; give the run folder of one of them: made/setups/1" in process.stderr


def test_a_name_of_several_programs_leaves_room_for_their_numbers(
    setups_folder: Path, run_cell: RunCommand, tmp_path: Path
) -> None:
    """A name that is too long is refused and not replaced."""
    words = ("export", setups_folder, "--name", "the_part_of_line_two_b", "--out", "out")
    process = run_cell(*words, cwd=tmp_path, code=2)
    assert "has 22 characters; a name for several set-ups has at most 21" in process.stderr
    assert not (tmp_path / "out").exists()


def test_the_page_of_each_set_up_is_opened(setups_folder: Path, run_cell: RunCommand) -> None:
    """`cell view` prints the page of each run. One output file for several pages is refused."""
    process = run_cell("view", "made", "--no-open", cwd=setups_folder.parent, code=0)
    for number in ("1", "2"):
        assert str(Path("made", "setups", number, "view.html")) in process.stdout
    process = run_cell("view", "made", "--no-open", "--out", "x.html", cwd=setups_folder.parent, code=2)
    assert "holds several set-ups with a page each" in process.stderr


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        (("--pin", "3"), 2, "--pin 3 must be candidates, each as SETUP:ID with the number of the set-up candidate"),
        (("--pin", "1:3"), 2, "candidate 1:3: there are 1 set-up candidates, 0 to 0"),
        (("--pin", "0:3000"), 2, "candidate 0:3000: set-up 0 has candidates 0 to "),
        (("--pin", "0:3", "--ban", "0:3"), 2, "candidate 0:3 is pinned and banned"),
        (("--pin", "0:3,0:4", "--max-views", "1"), 2, "2 views are pinned and at most 1 are allowed"),
        (("--pin", "0:3,1:4", "--max-setups", "1"), 2, "views of more than the 1 allowed set-ups are pinned"),
        (("--setup-seconds", "60"), 2, "--setup-seconds needs views with a cost in seconds; give --cost time as well"),
        (("--setup-seconds", "60", "--cost", "time", "--max-setups", "1"), 2, "both limit the number of set-ups"),
        (("--proposals", "0"), 2, "there is no set-up candidate: give [[setup]] tables in the scene"),
        (("--place", "9000,0,100"), 4, "none of the 1 set-up candidates can be planned"),
    ],
)
def test_invalid_requests_are_refused(
    options: tuple[str, ...], code: int, message: str, part_file: Path, run_cell: RunCommand, tmp_path: Path
) -> None:
    """An invalid request is refused with its exit code, and no finished folder is left."""
    small = ("--units", "mm", "--place", "1100,400,100", "--faces", "40", "--standoff", "250")
    small += ("--candidates", "optimal-scanning-zone")
    process = run_cell(
        "setups", part_file, *small, "--proposals", "1", *options, "--out", "made", cwd=tmp_path, code=code
    )
    assert message in process.stderr
    assert not (tmp_path / "made").exists()


SCENE = """
[part]
path = "{part}"
units = "mm"
[placement]
position_mm = [1100, 400, 100]
[plan]
faces = 40
samples_per_face = 4
seed = 3
candidates = "optimal-scanning-zone"
standoffs_mm = [250]
coverage = 0.95
[[setup]]
name = "upright"
position_mm = [1100, 400, 100]
[[setup]]
name = "over"
position_mm = [1100, 400, 100]
abc_deg = [0, 0, 180]
fixtures = [{{ name = "vise", shape = "box", position_mm = [1100, 560, 0], size_mm = [60, 60, 60] }}]
[[setup]]
name = "{third}"
position_mm = [1100, 400, 100]
abc_deg = [0, 0, {angle}]
fixtures = [{{ name = "{fixture}", shape = "box", position_mm = [1100, {y}, 0], size_mm = [60, 60, 260] }}]
"""


def test_given_set_ups_are_planned_each_among_its_own_fixtures(
    part_file: Path, run_cell: RunCommand, tmp_path: Path
) -> None:
    """No set-up is proposed in addition. A set-up with the part in its fixture is left out with the reason."""
    scene = tmp_path / "cell.toml"
    scene.write_text(SCENE.format(part=part_file, third="stuck", angle=90, fixture="block", y=400))
    process = run_cell("setups", "--scene", "cell.toml", "--out", "made", cwd=tmp_path)
    assert process.returncode in (0, 3), process.stderr
    output = json.loads((tmp_path / "made" / "setups.json").read_text())
    assert [each["name"] for each in output["candidates"]] == ["upright", "over", "stuck"]
    assert "block" in output["candidates"][2]["cause"]
    assert "the set-up 'stuck' is omitted: " in process.stderr
    for setup in output["selected"]:
        run = open_run(tmp_path / "made" / setup["folder"])
        names = [fixture.name for fixture in read_cell(run).scene.fixtures if not fixture.built_in]
        assert names == (["vise"] if setup["candidate"] == 1 else [])
    process = run_cell("plan", "--scene", "cell.toml", "--out", "run", cwd=tmp_path, code=2)
    assert "the scene has 3 [[setup]] tables, which cell plan does not use" in process.stderr


def test_equal_set_ups_are_refused(part_file: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """The error names both set-ups."""
    scene = tmp_path / "cell.toml"
    text = SCENE.format(part=part_file, third="again", angle=180, fixture="vise", y=560).replace("260]", "60]")
    scene.write_text(text)
    process = run_cell("setups", "--scene", "cell.toml", "--out", "made", cwd=tmp_path, code=2)
    assert "'over' and 'again' are equal; omit one of them" in process.stderr


def test_options_apply_to_all_set_ups_together(part_file: Path, tmp_path: Path) -> None:
    """A pinned candidate brings its set-up, a banned one is not selected. Two views may be of different set-ups."""
    run_of_setups = setups(
        part_file, out=tmp_path / "made", units="mm", place=(1100, 400, 100), faces=30, samples=2, standoff=250, seed=3,
        candidates="optimal-scanning-zone", proposals=3, coverage=0.95,
        multiplicity=2, pin=["2:12"], ban=["0:4", "1:4"],
    )  # fmt: skip
    views_of = {}
    twice: np.ndarray | int = 0
    for setup, folder in zip(run_of_setups.file.selected, run_of_setups.folders, strict=True):
        run = open_run(folder)
        views_of[setup.candidate] = {view.id for view in run.plan.views}
        M = run.measurability
        twice = twice + np.asarray(M.matrix().tocsc()[:, sorted(views_of[setup.candidate])].sum(axis=1)).ravel()
    assert 12 in views_of[2]
    assert 4 not in views_of.get(0, set()) | views_of.get(1, set())
    assert run_of_setups.file.satisfied_share is not None
    assert run_of_setups.file.satisfied_share >= 0.95
    assert (np.asarray(twice) >= 2).mean() >= 0.9 * run_of_setups.file.satisfied_share


def test_the_curve_is_of_the_set_ups_that_are_used_and_each_is_visited_in_order(
    part_file: Path, tmp_path: Path
) -> None:
    """Views of the curve are named like pinned ones and measure the stated share. Views overlap earlier ones."""
    run_of_setups = setups(
        part_file, out=tmp_path / "made", units="mm", place=(1100, 400, 100), faces=30, samples=2, standoff=250, seed=3,
        candidates="optimal-scanning-zone", proposals=3, coverage=0.95, curve=True, overlap="5%", overlap_in_order=True,
    )  # fmt: skip
    matrices = {}
    for setup, folder in zip(run_of_setups.file.selected, run_of_setups.folders, strict=True):
        run = open_run(folder)
        M = run.measurability
        matrices[str(setup.candidate)], areas = M.matrix().tocsc(), M.samples.areas
        assert json.loads((folder / "report.json").read_text())["overlap"]["views_without_earlier_overlap"] == 0
    output = json.loads((tmp_path / "made" / "curve.json").read_text())
    for point in output["points"][1:]:
        views = [view.split(":") for view in point["views"]]
        seen = np.hstack([matrices[setup][:, [int(number)]].toarray() for setup, number in views]).any(axis=1)
        assert areas[seen].sum() / areas.sum() == pytest.approx(point["coverage"])
        assert point["upper_bound"] >= point["coverage"]
    assert output["points"][-1]["coverage"] == pytest.approx(output["coverable"])
    assert run_of_setups.file.curve is not None
    assert run_of_setups.file.curve.minimum_views[-1].views == len(output["points"]) - 1
    assert "![Coverage over the number of views" in (tmp_path / "made" / "report.md").read_text()
    assert (tmp_path / "made" / "curve.png").is_file()


def test_regions_of_set_ups_have_coverages_of_their_own(part_file: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """The coverage of each region is reached over all set-ups. A region without requirement has no entry."""
    (tmp_path / "cell.toml").write_text(
        SCENE.format(part=part_file, third="over and turned", angle=90, fixture="block", y=560).replace(
            "coverage = 0.95", "coverage = 0.8"
        )
        + '[[region]]\nname = "top"\nbox_mm = [-100, -100, 0, 100, 100, 100]\ncoverage = 0.95\n'
        '[[region]]\nname = "side"\nbox_mm = [0, -100, -100, 100, 100, 0]\ncare = "no"\n[[region]]\nname = "rest"\n'
    )
    process = run_cell("setups", "--scene", "cell.toml", "--out", "made", "--json", cwd=tmp_path, code=0)
    regions = {each["name"]: each for each in json.loads(process.stdout)["regions"]}
    assert set(regions) == {"top", "rest"}
    assert regions["top"]["visible_of_coverable"] >= regions["top"]["target"] == 0.95
    assert regions["rest"]["visible_of_coverable"] >= regions["rest"]["target"] == 0.8


def test_one_of_several_is_edited_and_not_repaired(setups_folder: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """A single set-up of several can be edited. It cannot be repaired, because the coverage belongs to all set-ups."""
    one = next(run for run in sorted((setups_folder / "setups").iterdir()) if len(open_run(run).candidate) > 1)
    process = run_cell("edit", one, "--drop", "1", "--repair", "--out", "repaired", cwd=tmp_path, code=2)
    assert "is one of several set-ups" in process.stderr
    process = run_cell("edit", one, "--drop", "1", "--out", "edited", cwd=tmp_path, code=0)
    assert "their combined coverage is not known now" in " ".join(process.stderr.split())
    assert "--repair" not in process.stdout + process.stderr
    assert "more than the fewest" not in open_run(tmp_path / "edited").report.status
    process = run_cell("edit", "edited", "--repair", "--out", "repaired", cwd=tmp_path, code=2)  # in any folder
    assert "is one of several set-ups" in process.stderr
    for run in (one, tmp_path / "edited"):
        assert "--repair" not in (run / "view.html").read_text()


def test_faces_may_be_the_rows(part_file: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """With `--fill rays` each set-up has the faces of the planning mesh as rows, without further samples."""
    small = ("--units", "mm", "--place", "1100,400,100", "--faces", "30", "--standoff", "250", "--coverage", "0.5")
    settings = ("--candidates", "optimal-scanning-zone", "--fill", "rays", "--proposals", "2")
    run_cell("setups", part_file, *small, *settings, "--out", "made", cwd=tmp_path, code=0)
    run = open_run(tmp_path / "made" / "setups" / "1")
    assert run.report.settings.fill == "rays"
    planning = run.mesh("planning.ply")
    assert len(run.measurability.samples) == len(planning.faces)


def test_a_part_without_a_stable_pose_is_offered_as_it_is_placed(run_cell: RunCommand, tmp_path: Path) -> None:
    """A ball has no stable pose. This is reported, and four candidates are made by turning it."""
    trimesh.creation.icosphere(subdivisions=3, radius=60).export(tmp_path / "ball.stl")
    small = ("--units", "mm", "--place", "1100,400,100", "--faces", "12", "--samples", "1", "--standoff", "250")
    settings = ("--candidates", "optimal-scanning-zone", "--coverage", "0.3")
    process = run_cell(
        "setups", "ball.stl", *small, *settings, "--proposals", "6", "--out", "made", cwd=tmp_path, code=0
    )
    assert (
        "the part has no other stable pose: the only candidate is the part as it is placed, turned," in process.stderr
    )
    assert len(json.loads((tmp_path / "made" / "setups.json").read_text())["candidates"]) == 4


def test_why_a_set_up_is_left_out() -> None:
    """A set-up is infeasible, measures nothing new, or is not required for the request."""
    seen = np.array([True, True, False, False])
    found = cast(Setup, SimpleNamespace(coverable=np.array([True, False, False, False])))
    assert cause_of_omission("home is not free", seen) == "home is not free"
    assert cause_of_omission(found, seen) == "it measures nothing that the others do not measure"
    assert "the request is met without it (it can add 50.00 % of the surface)" in cause_of_omission(
        cast(Setup, SimpleNamespace(coverable=~seen)), seen
    )
