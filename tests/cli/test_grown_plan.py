"""`cell plan --candidates grown` on the command line."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cell.runs.cell import read_cell
from cell.runs.run import open_finished
from planner.measurability.visibility import find_measured
from tests.support.cover_oracle import fewest_views
from tests.support.fixture_types import RunCommand


@pytest.fixture(scope="module")
def grown(part_file: Path, small_plan: tuple[str, ...]) -> tuple[str, ...]:
    """Return the command of a small plan with grown candidates."""
    return ("plan", str(part_file), "--units", "mm", *small_plan, "--faces", "60", "--candidates", "grown")


@pytest.fixture(scope="module")
def run(grown: tuple[str, ...], made_once: Callable[..., Path], run_cell: RunCommand) -> Path:
    """Return its run folder, with the matrix from the cache if available."""

    def make(folder: Path) -> None:
        run_cell(*grown, "--out", "run", cwd=folder, code=0)

    return made_once("grown", make) / "run"


@pytest.fixture(scope="module")
def fewest(grown: tuple[str, ...], made_once: Callable[..., Path], run_cell: RunCommand) -> Path:
    """Return the run folder of the fewest views for 97 %, with refined candidates."""

    def make(folder: Path) -> None:
        run_cell(*grown, "--coverage", "0.97", "--no-cache", "--out", "run", cwd=folder, code=0)

    return made_once("grown-fewest", make) / "run"


def test_grown_candidates_keep_the_run_folder_s_contract(
    run: Path, grown: tuple[str, ...], tmp_path: Path, run_cell: RunCommand
) -> None:
    """Runs with and without cache have equal bytes. Every array has all candidates. Views match their candidates."""
    run_cell(*grown, "--no-cache", "--out", "again", cwd=tmp_path, code=0)
    first, second = (json.loads((each / "manifest.json").read_text()) for each in (run, tmp_path / "again"))
    assert first["artefacts"] == second["artefacts"]

    with np.load(run / "viewpoints.npz") as views, np.load(run / "reach.npz") as reach:
        T, roll, verdict = views["T_object_scanner"][:, 0], views["roll"], reach["verdict"]
        assert len(T) == len(roll) == len(views["face"]) == len(views["standoff"]) == len(verdict)
    with np.load(run / "measurability.npz") as stored:
        assert stored["shape"][1] == len(T)
    for view in json.loads((run / "plan.json").read_text())["views"]:
        assert verdict[view["id"]] == 0
        np.testing.assert_allclose(view["roll_deg"], np.degrees(roll[view["id"]]), atol=1e-6)
        np.testing.assert_allclose(np.array(view["T_object_scanner"])[:3, 3], T[view["id"], :3, 3], atol=1e-4)


def test_views_that_moved_are_candidates_like_others(
    run: Path, fewest: Path, tmp_path: Path, run_cell: RunCommand
) -> None:
    """Moved views follow the other candidates, with correct entries of reach and matrix."""
    shutil.copytree(fewest, tmp_path / "run")
    moved, others = open_finished(tmp_path / "run"), open_finished(run)
    known, views = len(others.candidates), moved.candidates
    assert len(views) > known
    np.testing.assert_array_equal(views.T_object_scanner[:known], others.candidates.T_object_scanner)
    T, M, reached = views.T_object_scanner[known:], moved.measurability, moved.reach
    cell = read_cell(moved)
    found = find_measured(T, M.samples, cell.scanner, (cell.part_caster, cell.occluder_caster), each=True)
    np.testing.assert_array_equal(M.matrix().tocsc()[:, np.arange(known, len(views))].toarray(), found)
    assert reached.reachable[known:].all()
    for view in range(known, len(views)):
        for q in reached.configurations_of(view):
            np.testing.assert_allclose(cell.scanner_pose(q), views.T_object_scanner[view, 0], atol=2e-5)
    plan_file = json.loads((tmp_path / "run" / "plan.json").read_text())
    ids = [view["id"] for view in plan_file["views"]]
    assert max(ids) >= known
    # The required coverage is reached, also after exchanges for a shorter motion.
    areas, entries = M.samples.areas, M.matrix().tocsc()
    coverable, covered = (areas[entries[:, which].sum(axis=1) > 0].sum() for which in (reached.reachable, ids))
    assert covered >= plan_file["coverage"]["target_on_samples"] * coverable * (1 - 1e-9)
    process = run_cell("edit", "run", "--turn", "1:30", "--out", "edited", cwd=tmp_path)
    assert process.returncode in (0, 3), process.stderr
    process = run_cell("scan", "run", "--view", "1", "--resolution", "1", cwd=tmp_path)
    assert process.returncode in (0, 3), process.stderr


@pytest.mark.parametrize("coverage", [None, pytest.param("0.95", marks=pytest.mark.slow)])
def test_the_bound_of_moved_views_is_at_most_the_optimum(
    coverage: str | None, fewest: Path, grown: tuple[str, ...], tmp_path: Path, run_cell: RunCommand
) -> None:
    """No selection over the run folder's matrix has fewer views. The bound is nearly that of the relaxation."""
    folder = tmp_path / "run" if coverage else fewest
    if coverage:
        run_cell(*grown, "--coverage", coverage, "--out", "run", cwd=tmp_path, code=0)
    run, plan = open_finished(folder), json.loads((folder / "plan.json").read_text())
    M, areas = run.measurability.matrix().tocsc()[:, run.reach.reachable], run.measurability.samples.areas
    share = plan["coverage"]["target_on_samples"] - 1e-9
    assert fewest_views(M, areas, share, relaxed=True) - 1 <= plan["lower_bound"]
    assert plan["lower_bound"] <= fewest_views(M, areas, share) <= len(plan["views"])


def test_pinned_and_banned_candidates_hold_after_the_pose_search(
    run: Path, grown: tuple[str, ...], tmp_path: Path, run_cell: RunCommand
) -> None:
    """A pinned candidate is a view at its own pose. A banned one, a view of the plan without the ban, is none."""
    ids = [view["id"] for view in json.loads((run / "plan.json").read_text())["views"]]
    reachable = np.flatnonzero(np.load(run / "reach.npz")["verdict"] == 0)
    pinned, banned = int(np.setdiff1d(reachable, ids)[0]), ids[0]
    options = ("--coverage", "0.97", "--pin", str(pinned), "--ban", str(banned), "--out", "run")
    run_cell(*grown, *options, cwd=tmp_path, code=0)
    plan = json.loads((tmp_path / "run" / "plan.json").read_text())
    found = {view["id"] for view in plan["views"]}
    assert pinned in found
    assert banned not in found
    report = json.loads((tmp_path / "run" / "report.json").read_text())
    assert "Pose search" in report["status"]


def test_a_repair_moves_added_views_but_not_towards_dropped_ones(
    fewest: Path, tmp_path: Path, run_cell: RunCommand
) -> None:
    """Repair restores the coverage. Views that stay keep their poses; added ones are no nearer than the range."""
    before = open_finished(fewest)
    dropped = before.candidates.T_object_scanner[before.candidate[:3], 0]
    options = ("--drop", "1,2,3", "--dropped-range", "120mm,40deg", "--repair", "--out", "repaired")
    run_cell("edit", str(fewest), *options, cwd=tmp_path, code=0)
    after = open_finished(tmp_path / "repaired")
    assert set(before.candidate[3:]) < set(after.candidate)
    assert "that keeps the given views" in after.report.status
    added = after.candidates.T_object_scanner[np.setdiff1d(after.candidate, before.candidate), 0]
    assert len(added)
    apart = np.linalg.norm(added[:, None, :3, 3] - dropped[:, :3, 3], axis=2)
    angle = np.degrees(np.arccos(np.clip(added[:, :3, 2] @ dropped[:, :3, 2].T, -1, 1)))
    assert ((apart > 0.12) | (angle > 40)).all()


def test_pose_search_is_skipped_with_its_reason(
    run: Path, grown: tuple[str, ...], tmp_path: Path, run_cell: RunCommand
) -> None:
    """A request that the search does not support is planned without it, and the status gives the reason."""
    run_cell(*grown, "--coverage", "0.97", "--multiplicity", "2", "--out", "run", cwd=tmp_path, code=0)
    for folder, request in ((run, "coverage 1"), (tmp_path / "run", "several views per sample")):
        status = json.loads((folder / "report.json").read_text())["status"]
        assert status.endswith(f"Poses are not searched: the search does not support {request}")


def test_the_shortest_time_is_never_longer_than_the_fewest_views(
    grown: tuple[str, ...], fewest: Path, tmp_path: Path, run_cell: RunCommand
) -> None:
    """The plan of shortest time includes the moved views as candidates. Its bound does not exceed its time."""
    run_cell(*grown, "--coverage", "0.97", "--cost", "time", "--out", "time", cwd=tmp_path, code=0)
    views, time = (json.loads((run / "report.json").read_text()) for run in (fewest, tmp_path / "time"))
    standing = time["settings"]["scan_s"] + time["settings"]["settle_s"]
    assert time["cost"]["seconds"] <= views["n_views"] * standing + views["motion"]["duration_s"] + 1e-9
    assert 0 < time["cost"]["seconds_bound"] <= time["cost"]["seconds"]
