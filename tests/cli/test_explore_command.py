"""`cell explore` end to end on the small part: files, reproducible bytes, refusals."""

import base64
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from benchmarks.triangle_cell import TriangleCell
from cell.errors import FileError
from cell.explore import explore, state
from cell.explore.belief import GroundTruth, continue_surface
from cell.explore.options import ExploreOptions
from cell.explore.prepare import ExplorationContext, prepare_exploration
from cell.explore.stage import StopReason
from cell.part import workpiece
from cell.runs import ply, schema
from cell.runs.cell import read_cell
from cell.runs.run import open_finished
from cell.runs.schema import BELIEVED, MEASURED, ExploreFile
from cell.scan.options import ScanOptions
from cell.scene.file import scene_from_options
from cell.session import Session
from cell.study.prepared_part import Bench
from cell.view.explore_page import explore_page
from planner.explore.space import FREE
from planner.geometry.closest import ClosestPointQuery
from planner.measurability.visibility import find_measured
from tests.support.fixture_types import RunCommand

PLACE = (
    "--place", "1100,400,100", "--faces", "120", "--samples", "2", "--standoff", "250", "--seed", "3",
    "--candidates", "optimal-scanning-zone",
)  # fmt: skip
OPTIONS = (*PLACE, "--resolution", "0.5", "--ring", "3", "--batch", "2", "--max-views", "5")


@pytest.fixture(scope="module")
def explored(made_once: Callable[..., Path], part_file: Path, run_cell: RunCommand) -> Path:
    """Return a finished exploration of the small part. Tests must not change it."""

    def make(folder: Path) -> None:
        command = ("explore", part_file, "--units", "mm", *OPTIONS, "--out", "explored", "--json")
        process = run_cell(*command, cwd=folder, code=0)
        (folder / "stdout").write_text(process.stdout)

    return made_once("explored", make) / "explored"


def test_the_next_command_plans_the_model_in_the_cell_of_the_exploration(
    run_cell: RunCommand, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Scene file and options of the cell are kept: in another cell the arm would move through fixtures."""
    (tmp_path / "in.toml").write_text("[post]\nenabled = false\n")
    file = SimpleNamespace(rows=list, as_json=dict, part="mug", model="model.ply")
    found = SimpleNamespace(file=file, folder=Path("explored"), place_mm=(1.5, 2.0, 3.0))
    monkeypatch.setattr("cell.api.explore", lambda *_, **__: found)
    options = ("--place", "1200,500,0", "--max-views", "9", "--sensor", "generic-area-medium", "--curve")
    process = run_cell("explore", "mug", "--scene", "in.toml", *options, cwd=tmp_path, code=0)
    command = "--scene in.toml --sensor=generic-area-medium --curve --units=mm --place=1.5,2,3"
    assert f"next:\n  cell plan explored/model.ply {command}\n" in process.stdout


def test_the_file_describes_the_executed_stages(explored: Path) -> None:
    """Stages, digests and views of explore.json are those of the run folders. The printed JSON equals the file."""
    file = schema.read_explore_file(explored / "explore.json")
    assert (file.status, file.views) == ("finished", 5)
    assert [stage.views for stage in file.batches] == [3, 2]
    assert "the budget of 5 views is used" in file.stop_reason
    for stage in file.batches:
        run = open_finished(explored / stage.folder)
        assert stage.digest == run.digest
        assert stage.views == len(run.plan.views)
    measured = [stage.surface_mm2 - stage.uncovered_mm2 for stage in file.batches]
    assert [stage.measured_mm2 for stage in file.batches] == pytest.approx(measured)
    assert file.batches[0].realised_gain_mm2 == pytest.approx(measured[0], abs=0.01)
    assert all(
        0 < stage.realised_gain_mm2 < all_of_it for stage, all_of_it in zip(file.batches[1:], measured[1:], strict=True)
    )
    printed = json.loads((explored.parent / "stdout").read_text())
    assert printed == json.loads((explored / "explore.json").read_text())
    assert (explored / "report.md").read_text().count("stages/000") == 2


def test_grown_and_refined_candidates_are_like_others(part_file: Path, tmp_path: Path, run_cell: RunCommand) -> None:
    """The columns of the matrix at refined candidates, which follow the grown ones, have the rows of their own rays."""
    grown = (*PLACE[:-1], "grown", "--resolution", "0.5", "--max-views", "2", "--out", "explored")
    run_cell("explore", part_file, "--units", "mm", *grown, cwd=tmp_path, code=0)
    run = open_finished(tmp_path / "explored" / "stages" / "0002")
    M, candidates, cell = run.measurability, run.candidates, read_cell(run)
    assert len(candidates) == len(run.reach) == M.shape[1]
    columns = [run.plan.views[0].id, *range(len(candidates) - 10, len(candidates))]
    casters = (cell.part_caster, cell.occluder_caster)
    found = find_measured(candidates.T_object_scanner[columns], M.samples, cell.scanner, casters, each=True)
    np.testing.assert_array_equal(M.matrix()[:, columns].toarray() > 0, found)
    assert len(np.load(tmp_path / "explored" / "stages" / "0002.voxels.npz")["between"]) > 100


def test_nothing_touches_the_part_that_the_planning_does_not_know(explored: Path, part_file: Path) -> None:
    """Triangles of arm, tool and true part have no contact in python-fcl at any sample of the motions."""
    bench = Bench(scene_from_options(None, {"place": (1100, 400, 100), "standoff": 250, "units": "mm"}, part_file))
    judge = TriangleCell(bench.world, bench.part.reference)
    for stage in schema.read_explore_file(explored / "explore.json").batches:
        assert judge.contacts(open_finished(explored / stage.folder).motion.q) == {}


def test_no_point_of_the_part_is_in_space_that_counts_as_free(explored: Path, part_file: Path) -> None:
    """Voxels that count as free are outside the true part, except for voxels that its surface crosses."""
    scene = scene_from_options(None, {"place": (1100, 400, 100), "units": "mm"}, part_file)
    mesh = GroundTruth.of(scene, workpiece.load(str(part_file), "mm")).mesh
    file = schema.read_explore_file(explored / "explore.json")
    stored = np.load(explored / "stages" / "0002.voxels.npz")
    edge = file.voxel_mm / 1000
    low = -edge * np.array(stored["state"].shape) / 2
    centres = low + edge * (np.argwhere(stored["state"] == FREE) + 0.5)
    depth = -ClosestPointQuery(mesh).signed_distance(centres)
    assert depth.max() < np.sqrt(3) * edge


def _stopped_after_the_first(explored: Path, tmp_path: Path) -> Path:
    """Return a copy in which explore.json has only the first stage, as if the second stage were unfinished."""
    again = Path(shutil.copytree(explored, tmp_path / "explored"))
    file = schema.read_explore_file(again / "explore.json")
    before = file.model_copy(update={"status": "running", "stop_reason": "", "batches": file.batches[:1]})
    (again / "explore.json").write_text(json.dumps(before.as_json()))
    return again


def _plan_killed(stage: Path) -> None:
    stage.rename(stage.with_name(f"{stage.name}.part"))


def _execution_killed(stage: Path) -> None:
    execution = stage / "executions" / "0001"
    (execution / "scans" / "0002.npz").unlink()
    manifest = json.loads((execution / "manifest.json").read_text())
    manifest |= {"status": "running", "artefacts": {}}
    (execution / "manifest.json").write_text(json.dumps(manifest))


def _killed_before_the_manifest(stage: Path) -> None:
    execution = stage / "executions" / "0001"
    shutil.rmtree(execution)
    (execution / "scans").mkdir(parents=True)


@pytest.mark.parametrize(
    "killed", [pytest.param(_plan_killed, marks=pytest.mark.slow), _execution_killed, _killed_before_the_manifest]
)
def test_the_same_command_goes_on_where_it_was_killed(
    killed: Callable[[Path], None], explored: Path, tmp_path: Path, part_file: Path, run_cell: RunCommand
) -> None:
    """A stage that is missing in explore.json is completed from a killed plan or execution with equal bytes."""
    again = _stopped_after_the_first(explored, tmp_path)
    killed(again / "stages" / "0002")
    (again / "stages" / "0002.voxels.npz").unlink()
    run_cell("explore", part_file, "--units", "mm", *OPTIONS, "--out", again, cwd=tmp_path, code=0)
    for name in ("explore.json", "report.md", "model.ply", "stages/0002.voxels.npz"):
        assert (again / name).read_bytes() == (explored / name).read_bytes(), name


@pytest.mark.parametrize("damage", [Path.unlink, lambda path: path.write_bytes(path.read_bytes()[:100])])
def test_a_missing_earlier_scan_is_reported_before_any_motion(
    damage: Callable[[Path], object], explored: Path, tmp_path: Path, part_file: Path, run_cell: RunCommand
) -> None:
    """With a missing or truncated scan of an earlier stage, no batch is planned, and exit code 6 names the stage."""
    again = _stopped_after_the_first(explored, tmp_path)
    shutil.rmtree(again / "stages" / "0002")
    damage(again / "stages" / "0001" / "executions" / "0001" / "scans" / "0002.npz")
    process = run_cell("explore", part_file, "--units", "mm", *OPTIONS, "--out", again, cwd=tmp_path, code=6)
    assert "stages/0001" in process.stderr
    assert "start a new exploration" in process.stderr
    assert not (again / "stages" / "0002").exists()


_MEASURED = (
    *PLACE, "--faces", "160", "--resolution", "0.5", "--ring", "3", "--batch", "1", "--max-views", "5",
    "--min-gain", "0.0003",
)  # fmt: skip


@pytest.fixture
def soon_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make every plan on the believed surface after the first batch stop for too little open surface."""
    believed = explore._plan_on_belief

    def plan(work: ExplorationContext, file: ExploreFile, *requests: Any) -> Path | StopReason:
        folder = believed(work, file, *requests)
        if file.batches and isinstance(folder, Path):
            shutil.rmtree(folder)
            return StopReason("too little of the believed surface is open")
        return folder

    monkeypatch.setattr(explore, "_plan_on_belief", plan)


@pytest.fixture
def on_measured(soon_measured: None, made_once: Callable[..., Path], part_file: Path, run_cell: RunCommand) -> Path:
    """Return an exploration: the first batch is planned on the believed surface, the others on measured surfaces."""

    def make(folder: Path) -> None:
        run_cell("explore", part_file, "--units", "mm", *_MEASURED, "--out", "explored", cwd=folder, code=0)

    return made_once("explored on measured surfaces", make) / "explored"


def test_stages_on_the_measured_surface_measure_new_samples(on_measured: Path, part_file: Path) -> None:
    """The part of such a stage is the stored surface of all earlier points. The record of beliefs does not change."""
    file = schema.read_explore_file(on_measured / "explore.json")
    assert [(stage.planning_surface, stage.views) for stage in file.batches] == [
        (BELIEVED, 3),
        (MEASURED, 1),
        (MEASURED, 1),
    ]
    paths, first = state.ExplorationFolder(on_measured), np.load(on_measured / "stages" / "0001.voxels.npz")
    assert not paths.measured(1).exists()
    scene = scene_from_options(
        None, {"place": (1100.0, 400.0, 100.0), "standoff": 250.0, "units": "mm"}, str(part_file)
    )
    work = prepare_exploration(Session(None, out=on_measured), scene, ExploreOptions(), ScanOptions(resolution_deg=0.5))
    for number, stage in enumerate(file.batches[1:], start=2):
        run, scans = open_finished(on_measured / stage.folder), state.read_scans(paths, file.batches[: number - 1])
        known_before = paths.known(number - 1, work.unknown)
        surface = continue_surface(scans, known_before.space, known_before.solid)
        assert surface is not None
        assert paths.measured(number).read_bytes() == ply.mesh_bytes(surface)
        assert run.mesh("reference.ply").areas.sum() == pytest.approx(surface.areas.sum(), rel=1e-6)
        assert cKDTree(surface.vertices).query(run.mesh("planning.ply").vertices)[0].max() < 0.005
        M, plan = run.measurability, run.plan
        cell = read_cell(run)
        poses = np.stack([scan.T_reported for scan in scans])[:, None]
        assert not find_measured(poses, M.samples, cell.scanner, (cell.part_caster,)).any()
        sees = M.matrix()[:, [view.id for view in plan.views]].toarray().any(axis=1)
        assert stage.expected_gain_mm2 == pytest.approx(1e6 * M.samples.areas[sees].sum(), abs=0.01)
        assert stage.realised_gain_mm2 > 0
        known = np.load(paths.voxels(number))
        for name in ("expected", "found", "tries"):
            assert np.array_equal(known[name], first[name]), name
        assert len(known["points"]) > len(first["points"])
    assert (on_measured / "report.md").read_text().count("| 1 | measured |") == 2


def _measured_plan_killed(stage: Path) -> None:
    shutil.rmtree(stage / "executions")
    stage.rename(stage.with_name(f"{stage.name}.part"))


def _killed_between_plan_and_execution(stage: Path) -> None:
    shutil.rmtree(stage / "executions")


def _killed_before_what_was_learned_was_written(stage: Path) -> None:
    assert (stage / "executions" / "0001").is_dir()


@pytest.mark.usefixtures("soon_measured")
@pytest.mark.parametrize(
    "killed",
    [
        pytest.param(_measured_plan_killed, marks=pytest.mark.slow),
        _killed_between_plan_and_execution,
        pytest.param(_killed_before_what_was_learned_was_written, marks=pytest.mark.slow),
    ],
)
def test_a_stage_on_the_measured_surface_goes_on_where_it_was_killed(
    killed: Callable[[Path], None], on_measured: Path, tmp_path: Path, part_file: Path, run_cell: RunCommand
) -> None:
    """The bytes equal those of an exploration that was not killed."""
    again = Path(shutil.copytree(on_measured, tmp_path / "explored"))
    file = schema.read_explore_file(again / "explore.json")
    before = file.model_copy(update={"status": "running", "stop_reason": "", "batches": file.batches[:1]})
    (again / "explore.json").write_text(json.dumps(before.as_json()))
    for left in (again / "stages").glob("0003*"):
        shutil.rmtree(left) if left.is_dir() else left.unlink()
    (again / "stages" / "0002.voxels.npz").unlink()
    killed(again / "stages" / "0002")
    run_cell("explore", part_file, "--units", "mm", *_MEASURED, "--out", again, cwd=tmp_path, code=0)
    stages = [
        f"stages/{number}.{kind}"
        for number in ("0002", "0003")
        for kind in ("voxels.npz", "measured.ply", "unseen.ply")
    ]
    for name in ("explore.json", "report.md", "model.ply", *stages):
        assert (again / name).read_bytes() == (on_measured / name).read_bytes(), name


def test_points_of_files_need_no_model(explored: Path, tmp_path: Path, run_cell: RunCommand) -> None:
    """With points from files, one folder for each stage, a model is reconstructed without a model of the part."""
    cylinder = schema.read_explore_file(explored / "explore.json").cylinder
    scans = sorted((explored / "stages" / "0001" / "executions" / "0001" / "scans").glob("*.npz"))
    (tmp_path / "points" / "0001").mkdir(parents=True)
    for scan in scans:
        points = 1000 * np.load(scan)["points"] + np.array(cylinder.centre_mm)
        np.savetxt(tmp_path / "points" / "0001" / f"{scan.stem}.xyz", points)
    run_cell(
        "explore", *OPTIONS[:-1], "3", "--cylinder", f"{cylinder.diameter_mm},{cylinder.height_mm}", "--acquire",
        "files:points", "--points-frame", "base", "--points-units", "mm", "--out", "out", cwd=tmp_path, code=0,
    )  # fmt: skip
    file = schema.read_explore_file(tmp_path / "out" / "explore.json")
    assert file.source == "files:points"
    assert file.batches[0].points == sum(len(np.load(scan)["points"]) for scan in scans)
    assert (tmp_path / "out" / "model.ply").is_file()


def test_other_options_do_not_go_on_there(
    explored: Path, tmp_path: Path, part_file: Path, run_cell: RunCommand
) -> None:
    """The folder of another exploration and a folder without an exploration are refused."""
    process = run_cell(
        "explore", part_file, "--units", "mm", *OPTIONS, "--ring", "4", "--out", explored, cwd=tmp_path, code=2
    )
    assert "other options" in process.stderr
    process = run_cell("explore", part_file, "--units", "mm", *OPTIONS, "--out", tmp_path, cwd=tmp_path, code=6)
    assert "not an exploration" in process.stderr


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--acquire", "files:points"), "give --cylinder"),
        (("--voxel", "0.01"), "choose larger voxels or a smaller cylinder"),
        (("--pin", "3"), "omit it here"),
        (("--scene", "line.toml"), "exploration does not support the sweeping scanner laser-line"),
        (("--scene", "setups.toml"), "remove [[setup]] here"),
        (("--require", "0.9"), "--require needs a model of the part"),
        (("--policy", "two-stage", "--batch", "2"), "--batch applies to stepwise only"),
    ],
)
def test_invalid_explorations_are_refused_before_a_folder_is_made(
    options: tuple[str, ...], message: str, tmp_path: Path, part_file: Path, run_cell: RunCommand
) -> None:
    """An invalid exploration is refused with exit code 2, and no folder is created."""
    (tmp_path / "setups.toml").write_text('[[setup]]\nname = "up"\nposition_mm = [1100, 400, 100]\n')
    (tmp_path / "line.toml").write_text('[scanner]\ntype = "laser-line"\nsweep_deg = 24.0\nsweep_steps = 5\n')
    process = run_cell("explore", part_file, "--units", "mm", *PLACE, *options, "--out", "new", cwd=tmp_path, code=2)
    assert message in process.stderr
    assert not (tmp_path / "new").exists()


def test_a_cylinder_smaller_than_the_part_is_reported_after_the_ring(
    tmp_path: Path, part_file: Path, run_cell: RunCommand
) -> None:
    """Points outside the cylinder end the exploration before a stage is recorded. The standoff suits the cylinder."""
    options = ["100" if word == "250" else word for word in OPTIONS]
    process = run_cell(
        "explore", part_file, "--units", "mm", *options, "--cylinder", "70,70", "--out", "new", cwd=tmp_path, code=6
    )
    assert "outside the cylinder" in process.stderr
    assert schema.read_explore_file(tmp_path / "new" / "explore.json").batches == ()


@pytest.mark.usefixtures("drawn_pictures")
def test_the_page_shows_the_views_in_order(
    explored: Path, tmp_path: Path, run_cell: RunCommand,
    data_of: Callable[[str], dict[str, Any]]
) -> None:  # fmt: skip
    """The page has the views of all batches on one motion, colours by view and the curve as a picture."""
    run_cell("view", explored, "--no-open", "--out", tmp_path / "page.html", cwd=tmp_path, code=0)
    page, file = (tmp_path / "page.html").read_text(), schema.read_explore_file(explored / "explore.json")
    assert page == explore_page(explored)
    assert not re.search(r'(src|href)="(?!data:)', page.partition("</head>")[0])
    data = data_of(page)
    assert [view["number"] for view in data["views"]] == ["1", "2", "3", "4", "5"]
    times = [view["time"] for view in data["views"]]
    assert times == sorted(times)
    assert times[-1] < sum(stage.seconds for stage in file.batches)
    assert [dict(view["rows"])["view"] for view in data["views"]] == [
        "1, batch 1", "2, batch 1", "3, batch 1", "4, batch 2", "5, batch 2",
    ]  # fmt: skip
    assert "unseen" not in {piece["name"] for piece in data["pieces"]}
    layer = data["surfaces"][0]["layers"][0]
    assert (layer["kind"], layer["width"]) == ("views", 1)
    seen = np.frombuffer(base64.b64decode(layer["values"]["base64"]), np.uint8)
    assert (seen > 0).mean() > 0.7  # faces that close holes have no point near them
    assert base64.b64decode(data["curve"].partition("base64,")[2]).startswith(b"\x89PNG")
    with pytest.raises(FileError, match="no finished batch yet"):
        explore_page(explored, file.model_copy(update={"batches": ()}))
