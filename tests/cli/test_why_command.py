"""`cell why` on the command line: table, JSON, exit codes."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tests.support.fixture_types import RunCommand


def test_it_prints_a_table_and_writes_its_files(planned: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """The table has its title, the files are named, suggested commands have each option once, and stderr is empty."""
    shutil.copytree(planned, tmp_path / "run")
    process = run_cell("why", "run", "--samples", "2000", cwd=tmp_path, code=0)
    assert process.stderr == ""
    assert "Uncovered surface" in process.stdout
    assert "files: run/why" in process.stdout
    following = [
        line.split() for line in process.stdout.split("next:")[1].splitlines() if line.startswith("  cell plan")
    ]
    assert all(line.count(word) == 1 for line in following for word in line if word.startswith("--"))
    written = sorted(path.name for path in (tmp_path / "run" / "why").iterdir())
    assert written == ["view.html", "why.json", "why.ply", "why.png"]


def test_json_is_one_object_with_shares_that_add_up(planned: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """Stdout is the content of why.json. Visible and open shares sum to one, and the groups sum to the open share."""
    shutil.copytree(planned, tmp_path / "run")
    process = run_cell("why", "run", "--samples", "2000", "--json", cwd=tmp_path, code=0)
    output = json.loads(process.stdout)
    content = json.loads((tmp_path / "run" / "why" / "why.json").read_text())
    assert {key: value for key, value in content.items() if key != "schema"} == output
    assert abs(output["visible"] + output["uncovered"] - 1) < 1e-9
    assert abs(sum(group["share"] for group in output["groups"]) - output["uncovered"]) < 1e-9


def test_wrong_uses_have_their_exit_codes(planned: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """A missing folder and an unfinished run have exit code 6. A request without samples has 2."""
    assert run_cell("why", "nowhere", cwd=tmp_path).returncode == 6
    none = run_cell("why", str(planned), "--samples", "0", cwd=tmp_path)
    assert (none.returncode, none.stderr.count("\n")) == (2, 1)
    shutil.copytree(planned, tmp_path / "run.part")
    manifest = json.loads((tmp_path / "run.part" / "manifest.json").read_text()) | {"status": "failed"}
    (tmp_path / "run.part" / "manifest.json").write_text(json.dumps(manifest))
    failed = run_cell("why", "run.part", cwd=tmp_path, code=6)
    assert "no finished plan" in failed.stderr


def test_complete_coverage_is_reported(planned: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """With one sample, which the plan measures, no reason is given, and the four files are written."""
    shutil.copytree(planned, tmp_path / "run")
    process = run_cell("why", "run", "--samples", "1", cwd=tmp_path, code=0)
    assert "the whole surface is covered" in process.stdout
    assert len(list((tmp_path / "run" / "why").iterdir())) == 4


def test_the_surface_on_a_post_is_occluded_also_from_poses_inside_it(run_cell: RunCommand, tmp_path: Path) -> None:
    """The baseline is smaller than the post: from inside it laser and sensor see the face on it, which no pose does."""
    trimesh.creation.cylinder(radius=30, height=5, sections=48).export(tmp_path / "disc.stl")
    options = ("--units", "mm", "--place", "1100,300,100", "--faces", "60", "--effort", "0", "--out", "run", "--json")
    attainable = json.loads(run_cell("plan", "disc.stl", *options, cwd=tmp_path, code=0).stdout)["attainable"]
    touched = np.pi * 20**2 / (2 * np.pi * 30 * 35)
    assert attainable["out_of_reach"] < 0.02
    assert attainable["out_of_sight"] == pytest.approx(touched, abs=0.02)
    why = json.loads(run_cell("why", "run", "--samples", "2000", "--json", cwd=tmp_path, code=0).stdout)
    by_post = sum(group["share"] for group in why["groups"] if group["object"] == "post")
    assert by_post == pytest.approx(touched, abs=0.02)


def test_advice_is_a_share_and_a_command_each(planned: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """A second set-up never reduces the coverage. Every command is the command of the plan with another placement."""
    shutil.copytree(planned, tmp_path / "run")
    process = run_cell("why", "run", "--advise", "--json", cwd=tmp_path, code=0)
    output = json.loads(process.stdout)
    visible = json.loads((tmp_path / "run" / "plan.json").read_text())["coverage"]["visible"]
    assert output["visible"] == pytest.approx(visible, abs=2e-4)
    commands = [advice["command"] for advice in output["advice"]]
    assert len(set(commands)) == len(commands) == 8
    for advice in output["advice"]:
        words = advice["command"].split()
        is_further = "second set-up" in advice["description"]
        assert words[:2] == ["cell", "setups" if is_further else "plan"]
        assert words.count("--place") == 1
        assert words.count("--first") == is_further
        assert "--out" not in words
        assert 0 <= advice["share"] <= 1
        assert advice["share"] >= visible - 2e-4 or not is_further
