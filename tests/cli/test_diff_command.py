"""`cell diff` on the command line: differences of plans and executions, with areas recounted independently."""

import base64
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from cell.runs import ply
from cell.runs.cell import read_cell
from cell.runs.run import open_finished
from cell.world.prediction import held_out_samples
from planner.measurability import coverage
from tests.support.fixture_types import RunCommand


@pytest.fixture(scope="module")
def other(
    made_once: Callable[..., Path], planned: Path, part_file: Path, small_plan: tuple[str, ...], run_cell: RunCommand
) -> Path:
    """Return a plan of the small part with one view's candidate banned and a slower arm."""

    def make(folder: Path) -> None:
        banned = open_finished(planned).plan.views[1].id
        options = (*small_plan, "--ban", banned, "--speed", "0.5", "--out", "run", "--json")
        run_cell("plan", part_file, "--units", "mm", *options, cwd=folder, code=0)

    return made_once("planned_otherwise", make) / "run"


def test_a_run_does_not_differ_from_itself(executed: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """The output is one sentence for a plan and for an execution. In JSON the lists of differences are empty."""
    execution = executed / "executions" / "0001"
    for run in (executed, execution):
        process = run_cell("diff", run, run, cwd=tmp_path)
        assert (process.returncode, process.stdout) == (0, "nothing differs\n"), process.stderr
    output = json.loads(run_cell("diff", execution, execution, "--json", cwd=tmp_path).stdout)
    assert output["kind"] == "execution"
    views = output["views"]
    assert [output["settings"], output["numbers"], views["similar"], views["only_a"], views["only_b"]] == [[]] * 5
    assert output["surface"]["only_b_mm2"] == output["surface"]["only_a_mm2"] == 0


@pytest.mark.usefixtures("drawn_pictures")
def test_settings_views_and_areas_of_two_plans(
    planned: Path, other: Path, run_cell: RunCommand, data_of: Callable[[str], dict[str, Any]], tmp_path: Path
) -> None:
    """Only the changed settings are listed. Each view occurs once on each side. Areas and page match the artefacts."""
    output = json.loads(run_cell("diff", planned, other, "--json", cwd=tmp_path).stdout)
    assert {each["key"] for each in output["settings"]} == {"speed_scaling", "plan.banned"}
    a, b = open_finished(planned), open_finished(other)
    views = output["views"]
    moved = [(each["a"], each["b"]) for each in views["similar"]]
    assert sorted([i for i, _ in (*views["equal"], *moved)] + views["only_a"]) == list(range(1, len(a.plan.views) + 1))
    assert sorted([j for _, j in (*views["equal"], *moved)] + views["only_b"]) == list(range(1, len(b.plan.views) + 1))
    assert 2 not in [i for i, _ in views["equal"]]
    for i, j in views["equal"]:
        assert np.allclose(a.T_object_scanner[i - 1], b.T_object_scanner[j - 1], atol=2e-4)
    cell = read_cell(a)
    samples = held_out_samples(cell.reference, cell.planning, a.seed)
    seen = [
        coverage.visible_coverage(
            run.T_object_scanner[:, None], samples, cell.scanner, (cell.part_caster, cell.occluder_caster)
        ).covered
        for run in (a, b)
    ]
    loss, gain = (1e6 * samples.areas[mask].sum() for mask in (seen[0] & ~seen[1], seen[1] & ~seen[0]))
    assert (output["surface"]["only_a_mm2"], output["surface"]["only_b_mm2"]) == pytest.approx((loss, gain), abs=1e-3)
    message = run_cell("diff", planned, other, "--out", "diff.html", cwd=tmp_path).stdout
    assert "speed_scaling" in message
    assert "that A measures." in message
    data = data_of((tmp_path / "diff.html").read_text(encoding="utf-8"))
    names = [view["number"] for view in data["views"]]
    assert names == [*(str(k + 1) for k in range(len(b.plan.views))), *(f"A{k}" for k in views["only_a"])]
    for view, name in zip(data["views"], names, strict=True):
        if name.startswith("A"):  # both plans have one placement: the view has its pose in A
            np.testing.assert_allclose(view["T_base_scanner"], a.T_base_scanner[int(name[1:]) - 1], atol=1e-6)
            assert view["time"] is None
    (layer,) = data["surfaces"][0]["layers"]
    shares = [float(re.search(r"\((.*)\u00a0%\)", name)[1]) for name, _ in layer["named"]]  # type: ignore[index] # as written
    expected = [1e6 * samples.areas[mask].sum() for mask in (seen[0] & seen[1], ~seen[0] & ~seen[1])] + [loss, gain]
    np.testing.assert_allclose(shares, 100 * np.array(expected) / output["surface"]["area_mm2"], atol=0.006)
    assert np.frombuffer(base64.b64decode(layer["values"]["base64"]), np.uint8).max() < 4


def test_sides_exchanged_exchange_the_answer(planned: Path, other: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """The gained area in one direction is the lost area in the other direction."""
    one, back = (
        json.loads(run_cell("diff", *pair, "--json", cwd=tmp_path).stdout)
        for pair in ((planned, other), (other, planned))
    )
    assert (one["surface"]["only_b_mm2"], one["views"]["only_a"]) == (
        back["surface"]["only_a_mm2"],
        back["views"]["only_b"],
    )
    assert [(n["a"], n["b"]) for n in one["numbers"]] == [(n["b"], n["a"]) for n in back["numbers"]]


def test_areas_of_executions_are_areas_near_points(executed: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """An execution with one view measures less of the surface. The loss is recounted from the two clouds."""
    shutil.copytree(executed, tmp_path / "run")
    process = run_cell("scan", "run", "--view", "1", "--resolution", "1", "--json", cwd=tmp_path)
    assert process.returncode in (0, 3), process.stderr
    whole, one = (tmp_path / "run" / "executions" / number for number in ("0001", "0002"))
    output = json.loads(run_cell("diff", whole, one, "--json", cwd=tmp_path).stdout)
    assert ("scan.view", None, 1) in [(each["key"], each["a"], each["b"]) for each in output["settings"]]
    assert output["views"]["equal"] == [[1, 1]]
    run = open_finished(executed)
    reference, planning = (run.mesh(name) for name in ("reference.ply", "planning.ply"))
    samples = held_out_samples(reference, planning, run.seed)
    near = []
    for folder in (whole, one):
        points = ply.positions(ply.elements((folder / "cloud.ply").read_bytes())["vertex"])
        distance, _ = cKDTree(points).query(samples.points)
        near.append(distance <= coverage.sampling_radius(reference))
    assert output["surface"]["only_a_mm2"] == pytest.approx(1e6 * samples.areas[near[0] & ~near[1]].sum(), abs=1e-3)
    assert output["surface"]["only_b_mm2"] == 0


def test_wrong_uses_have_their_exit_codes(executed: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """A plan against an execution has exit code 2, a folder that does not exist has 6, each with one line on stderr."""
    mixed = run_cell("diff", executed, executed / "executions" / "0001", cwd=tmp_path)
    assert (mixed.returncode, mixed.stderr.count("\n")) == (2, 1)
    nowhere = run_cell("diff", executed, tmp_path / "nowhere", cwd=tmp_path)
    assert (nowhere.returncode, nowhere.stderr.count("\n")) == (6, 1)
