"""The scene of a run folder read back: what stands between scanner and part is what stood there in the plan."""

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
import trimesh

from cell.errors import FileError, UsageError
from cell.part import workpiece
from cell.plan import files as plan_files
from cell.rays.occluders import occluder_triangles
from cell.run.cell import read_cell
from cell.run.folder import RunFolder
from cell.run.record import RunRecord, open_run
from cell.scanners.laser_area import LaserArea
from cell.scene.resolve import resolve
from cell.scene.scene import load_scene
from cell.world.model import World, compile_world
from planner.surface.decimate import decimate

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
) -> tuple[RunRecord, World]:
    """A run folder that holds what an execution reads of the cell, with every kind of fixture; and the plan's world."""
    home = tmp_path_factory.mktemp("scene")
    trimesh.creation.annulus(20, 40, 60).export(home / "horn.stl")
    (home / "scene.toml").write_text(SCENE)
    scene = load_scene(home / "scene.toml", {"part": {"path": str(part_file), "units": "mm"}})
    part = workpiece.load(part_file, "mm")
    settings = resolve(scene, part)
    world = compile_world(scene, part.reference.vertices, baseline_mm=settings.scanner["baseline_mm"])
    folder = RunFolder.create(home / "run", [], 0, {}, datetime(2024, 1, 2, tzinfo=UTC))
    plan_files.write_meshes(folder, part.reference, decimate(part.reference, 200))
    plan_files.write_cell(folder, scene, settings, part, 200, world, LaserArea(**settings.scanner).parameters())
    return open_run(folder.finish(0)), world


def test_what_occludes_is_what_occluded_the_plan(written: tuple[RunRecord, World]) -> None:
    """Bit for bit: post, pedestal, floor, box on the part, mast; a mesh to the last bit; not what is of glass."""
    run, world = written
    planned, found = occluder_triangles(world), read_cell(run).occluders
    assert [piece.name for piece in found] == [piece.name for piece in planned]
    assert {piece.name for piece in found} == {"post", "pedestal", "floor", "clamp", "mast", "horn"}
    for piece, theirs in zip(found, planned, strict=True):
        np.testing.assert_array_equal(piece.faces, theirs.faces)
        # The folder holds meshes in millimetres.
        np.testing.assert_allclose(piece.vertices, theirs.vertices, rtol=0, atol=1e-15 if piece.name == "horn" else 0)


def test_scanner_and_poses_are_the_plans(written: tuple[RunRecord, World]) -> None:
    """Same law, and the pose at a configuration is forward kinematics through mount and placement."""
    run, world = written
    scene = read_cell(run)
    assert scene.scanner.parameters() == dict(scene.scanner_parameters)
    import mujoco

    q = world.home + 0.2
    data = world.data()
    data.qpos[:] = q
    mujoco.mj_kinematics(world.model, data)
    site = world.model.site("flange").id
    T_base_flange = np.eye(4)
    T_base_flange[:3, :3], T_base_flange[:3, 3] = data.site_xmat[site].reshape(3, 3), data.site_xpos[site]
    wanted = np.linalg.inv(world.T_base_object) @ T_base_flange @ world.T_flange_scanner
    np.testing.assert_allclose(scene.scanner_pose(q), wanted, atol=1e-9)


def test_the_resolution_can_be_another(written: tuple[RunRecord, World]) -> None:
    """The grid follows; a resolution that leaves no ray is refused by the option's name."""
    run, _ = written
    assert read_cell(run, 3.0).scanner.grid_shape == (20, 20)
    with pytest.raises(UsageError, match="--resolution 150"):
        read_cell(run, 150.0)


def test_a_changed_cell_is_refused(written: tuple[RunRecord, World], tmp_path: Path) -> None:
    """An edited cell.xml is not what was checked."""
    import shutil

    copy = tmp_path / "run"
    shutil.copytree(written[0].folder, copy)
    text = (copy / "cell.xml").read_text()
    (copy / "cell.xml").write_text(text.replace("scan_cell", "scam_cell"))
    with pytest.raises(FileError, match="changed or damaged"):
        read_cell(open_run(copy))
