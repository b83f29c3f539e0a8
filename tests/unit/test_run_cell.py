"""The scene of a run folder read back: occluders, scanner and poses equal those of the plan."""

import json
import shutil
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

from cell.errors import FileError, UsageError
from cell.part import workpiece
from cell.plan import files as plan_files
from cell.robot.model import LINKS
from cell.runs.cell import collision_note, read_cell, scene_of_run, world_of
from cell.runs.folder import RunFolder
from cell.runs.run import Run, open_run
from cell.scene.file import load_scene
from cell.scene.settle import settle
from cell.view.replay_model import build_replay_model
from cell.world.model import World, compile_world
from cell.world.occluders import fixed_occluders
from cell.world.shapes import ShapeDistances
from cell.world.travel import TravelBound
from planner.geometry.decimation import decimate

SCENE = """
[placement]
position_mm = [1100, 400, 100]
abc_deg = [30, 20, 10]

[[fixtures]]
name = "clamp"
shape = "box"
size_mm = [40, 20, 30]
position_mm = [60, 80, 10]
abc_deg = [10, 0, 40]
attached_to = "object"

[[fixtures]]
name = "mast"
shape = "cylinder"
size_mm = [50, 700]
position_mm = [1500, -600, 0]

[[fixtures]]
name = "glass"
shape = "box"
size_mm = [10, 10, 10]
position_mm = [1500, 900, 0]
occludes = false

[[fixtures]]
name = "horn"
shape = "mesh"
path = "horn.stl"
units = "mm"
position_mm = [1500, 700, 200]
abc_deg = [0, 90, 0]
"""


@pytest.fixture(scope="module")
def written(
    tmp_path_factory: pytest.TempPathFactory, part_file: Path, blob: Callable[[int], trimesh.Trimesh]
) -> tuple[Run, World]:
    """Return a run folder with the cell files of an execution and fixtures of every kind, and the plan's world."""
    return _written(tmp_path_factory.mktemp("scene"), part_file, {})


def _written(home: Path, part_file: Path, plan: dict[str, object], units: str = "mm") -> tuple[Run, World]:
    trimesh.creation.annulus(20, 40, 60).export(home / "horn.stl")
    (home / "scene.toml").write_text(SCENE)
    scene = load_scene(home / "scene.toml", {"part": {"path": str(part_file), "units": units}, "plan": plan})
    part = workpiece.load(part_file, units)
    settled = settle(scene, part)
    world = compile_world(settled.scene, part.reference.vertices, baseline_mm=settled.baseline_mm)
    folder = RunFolder.create(home / "run", [], 0, {}, datetime(2024, 1, 2, tzinfo=UTC))
    planning = decimate(part.reference, 200)
    plan_files.write_meshes(folder, part.reference, planning)
    plan_files.write_cell(folder, settled, planning, world)
    return open_run(folder.finish(0)), world


def test_the_occluders_are_those_of_the_plan(written: tuple[Run, World]) -> None:
    """The occluders equal those of the plan bit for bit, and a mesh to rounding."""
    run, world = written
    planned, found = fixed_occluders(world), read_cell(run).occluders
    assert [piece.name for piece in found] == [piece.name for piece in planned]
    assert {piece.name for piece in found} == {"post", "pedestal", "floor", "clamp", "mast", "horn"}
    for piece, theirs in zip(found, planned, strict=True):
        np.testing.assert_array_equal(piece.faces, theirs.faces)
        # The folder holds meshes in millimetres.
        np.testing.assert_allclose(piece.vertices, theirs.vertices, rtol=0, atol=1e-15 if piece.name == "horn" else 0)


def test_scanner_and_poses_are_the_plans(written: tuple[Run, World]) -> None:
    """The scanner has the plan's parameters, and its pose follows from forward kinematics, mount and placement."""
    run, world = written
    scene = read_cell(run)
    assert scene.scanner.parameters() == scene.scanner_keys.as_json()
    q = world.home + 0.2
    data = world.data()
    data.qpos[:] = q
    mujoco.mj_kinematics(world.model, data)
    site = world.model.site("flange").id
    T_base_flange = np.eye(4)
    T_base_flange[:3, :3], T_base_flange[:3, 3] = data.site_xmat[site].reshape(3, 3), data.site_xpos[site]
    expected = np.linalg.inv(world.T_base_object) @ T_base_flange @ world.T_flange_scanner
    np.testing.assert_allclose(scene.scanner_pose(q), expected, atol=1e-9)


def test_the_resolution_can_be_another(written: tuple[Run, World]) -> None:
    """The grid follows the given resolution; a resolution without any ray is refused with the name of the option."""
    run, _ = written
    assert read_cell(run, 3.0).scanner.grid_shape == (20, 20)
    with pytest.raises(UsageError, match="--resolution 150"):
        read_cell(run, 150.0)


def test_a_plan_of_at_most_so_many_views_is_read_back(tmp_path: Path, part_file: Path) -> None:
    """The scene of a plan with `max_views` is valid and has the coverage of the settled plan."""
    run, _ = _written(tmp_path, part_file, {"max_views": 3})
    plan = scene_of_run(run).plan
    assert (plan.max_views, plan.coverage) == (3, run.scene.plan.coverage)


def test_the_part_of_a_run_has_its_size_whatever_the_unit_of_its_file(tmp_path: Path, part_file: Path) -> None:
    """The scene of a run names its own mesh in millimetres, so that edits and further set-ups load the same part."""
    run, _ = _written(tmp_path, part_file, {}, units="cm")
    part = scene_of_run(run).part
    again = workpiece.load(part.source, part.units)
    np.testing.assert_allclose(again.reference.vertices, run.reference.vertices, rtol=0, atol=1e-12)


def test_a_changed_cell_is_refused(written: tuple[Run, World], tmp_path: Path) -> None:
    """An edited cell.xml is reported as changed."""
    copy = tmp_path / "run"
    shutil.copytree(written[0].folder, copy)
    text = (copy / "cell.xml").read_text()
    (copy / "cell.xml").write_text(text.replace("scan_cell", "scam_cell"))
    with pytest.raises(FileError, match="changed or damaged"):
        read_cell(open_run(copy))


def _as_earlier(run: Run, to: Path, collision: str) -> Run:
    """Return a copy as written by a version that used the hulls of mesh fixtures."""
    copy = Path(shutil.copytree(run.folder, to))
    resolved = json.loads((copy / "scene.resolved.json").read_text())
    resolved["plan"]["collision"] = collision
    for fixture in resolved["fixtures"]:
        fixture.pop("collision", None)
    (copy / "scene.resolved.json").write_text(json.dumps(resolved))
    manifest = json.loads((copy / "manifest.json").read_text())
    manifest["artefacts"].pop("scene.resolved.json")
    (copy / "manifest.json").write_text(json.dumps(manifest))
    return open_run(copy)


@pytest.mark.parametrize(
    ("collision", "triangles", "output"),
    [
        ("decomposed", {"part", "horn"}, "the part as convex pieces and the fixture 'horn' as its convex hull; their"),
        ("exact", {"part", "horn"}, "checked with the fixture 'horn' as its convex hull; their triangles"),
        ("hull", set(), None),
    ],
)
def test_a_run_of_an_earlier_version_is_compiled_with_triangles_and_a_note(
    written: tuple[Run, World], tmp_path: Path, collision: str, triangles: set[str], output: str | None
) -> None:
    """Convex pieces and hulls of an earlier run become triangles, with a note. Replay checks as the run did."""
    earlier = _as_earlier(written[0], tmp_path / "run", collision)
    part, scene = earlier.mesh("reference.ply"), earlier.scene
    again = world_of(earlier, part)
    assert _meshes_beside_the_arm(again.entities, again.shapes) == triangles
    assert (output is None) == (collision_note(scene) == [])
    assert all(output in sentence for sentence in collision_note(scene) if output)
    replay_model = build_replay_model(earlier, scene, part)
    assert _meshes_beside_the_arm(replay_model.geom_names, replay_model.shapes) == (
        {"part"} if collision == "exact" else set()
    )
    assert "horn_surface" not in replay_model.geom_names


def test_a_mesh_fixture_is_compiled_again_and_shown_as_its_triangles(written: tuple[Run, World]) -> None:
    """Replay shows and checks the triangles of a mesh fixture in the frame of its body."""
    run, world = written
    part, scene = run.mesh("reference.ply"), run.scene
    again = world_of(run, part)
    assert _meshes_beside_the_arm(world.entities, world.shapes) == {"horn"}  # compiled from the part's vertices alone
    assert _meshes_beside_the_arm(again.entities, again.shapes) == {"part", "horn"}
    assert collision_note(scene) == []
    replay_model = build_replay_model(run, scene, part)
    assert _meshes_beside_the_arm(replay_model.geom_names, replay_model.shapes) == {"part", "horn"}
    assert replay_model.model.geom("horn_surface").bodyid == replay_model.model.geom("horn").bodyid
    np.testing.assert_allclose(
        _extent(replay_model.model, "horn_surface"), _extent(replay_model.model, "horn"), atol=1e-6
    )


def _meshes_beside_the_arm(names: tuple[str, ...], shapes: ShapeDistances) -> set[str]:
    """Return the names of the geoms with triangles, without the links."""
    return {names[geom] for geom in shapes.meshes} - set(LINKS)


def _extent(model: mujoco.MjModel, name: str) -> np.ndarray:
    """Return the lowest and highest corner of a geom's mesh in the frame of its body."""
    geom = model.geom(name)
    mesh = model.mesh(geom.dataid[0])
    vertices = model.mesh_vert[mesh.vertadr[0] : mesh.vertadr[0] + mesh.vertnum[0]]
    R = np.empty(9)
    mujoco.mju_quat2Mat(R, geom.quat)
    placed = vertices @ R.reshape(3, 3).T + geom.pos
    return np.stack([placed.min(axis=0), placed.max(axis=0)])


def test_how_far_an_arm_is_off_is_that_of_the_cell_that_was_checked(written: tuple[Run, World]) -> None:
    """The travel bound equals that of the planned world bit for bit, although cell.xml starts at home."""
    run, world = written
    rng = np.random.default_rng(0)
    begin = rng.uniform(-1.0, 1.0, (20, 6))
    end = begin + rng.uniform(-0.01, 0.01, (20, 6))
    assert (read_cell(run).travel(begin, end) == TravelBound(world.model)(begin, end)).all()
