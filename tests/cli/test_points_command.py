"""`cell points`: points and surface of an execution in the formats of other programs."""

import contextlib
import json
import shutil
from pathlib import Path

import laspy
import numpy as np
import pye57
import pytest
import trimesh
from scipy.spatial import cKDTree

from cell import api
from cell.errors import FileError, UsageError
from cell.metrology import point_files, scan_files
from cell.runs.run import Execution, open_run, read_execution
from planner.geometry.closest import ClosestPointQuery


@pytest.mark.parametrize("kind", [".e57", ".ptx", ".las", ".laz", ".pcd", ".csv"])
def test_points_of_an_execution(kind: str, executed: Path, tmp_path: Path) -> None:
    """Every point of every scan, in the frame of the part."""
    out = tmp_path / f"points{kind}"
    scans = read_execution(open_run(executed), "latest").scans
    points = np.concatenate([scan.points for scan in scans])
    assert api.points(executed, out) == len(points)
    metres = 0.001 if kind in (".pcd", ".csv") else 1.0
    np.testing.assert_allclose(point_files.read(out) * metres, points, atol=1e-6, rtol=0.0)
    if kind in (".e57", ".ptx"):
        for scan, found in zip(scans, scan_files.read(out), strict=True):
            np.testing.assert_allclose(found.T, scan.T_reported, atol=1e-9, rtol=0.0)


def test_the_grid_of_a_scan_is_kept_in_e57(executed: Path, tmp_path: Path) -> None:
    """Row and column of each point are those of its ray; rays without a point leave gaps."""
    out = tmp_path / "points.e57"
    api.points(executed, out)
    scans = read_execution(open_run(executed), "latest").scans
    with contextlib.closing(pye57.E57(str(out))) as file:
        for number, scan in enumerate(scans):
            found = file.read_scan_raw(number)
            rows, columns = scan.stored["grid_shape"]
            assert (found["rowIndex"].astype(int) * columns + found["columnIndex"] == scan.stored["pixel"]).all()
            assert found["rowIndex"].max() < rows
            assert len(scan.points) < rows * columns


def test_deviations_as_csv(executed: Path, tmp_path: Path) -> None:
    """The signed distance of each point from the reference, and its view."""
    out = tmp_path / "points.csv"
    api.points(executed, out, "0001")
    lines = out.read_text().splitlines()
    assert lines[0] == "x_mm,y_mm,z_mm,deviation_mm,view"
    table = np.loadtxt(lines[1:], delimiter=",")
    reference = ClosestPointQuery(open_run(executed).reference)
    np.testing.assert_allclose(table[:, 3], reference.signed_distance(table[:, :3] / 1000.0) * 1000.0, atol=2e-6)
    assert set(table[:, 4]) == set(range(1, len(read_execution(open_run(executed), "latest").scans) + 1))


def test_registered_points_of_one_view(planned: Path, tmp_path: Path) -> None:
    """The points are those of the report, after registration, and have the number of their view in the plan."""
    shutil.copytree(planned, tmp_path / "run")
    execution = api.scan(tmp_path / "run", view=2, resolution=2, pose_error="2mm,0.5deg")
    for kind, metres in ((".csv", 0.001), (".las", 1.0)):
        api.points(tmp_path / "run", tmp_path / f"points{kind}")
        found = point_files.read(tmp_path / f"points{kind}") * metres
        assert cKDTree(execution.points).query(found)[0].max() < 2e-6
    (scan,) = read_execution(open_run(tmp_path / "run"), "latest").scans
    assert cKDTree(execution.points).query(scan.points)[0].max() > 1e-4
    assert set(np.loadtxt(tmp_path / "points.csv", delimiter=",", skiprows=1)[:, 4]) == {2}
    assert set(laspy.read(tmp_path / "points.las").point_source_id) == {2}


def test_a_changed_scan_is_left_out_as_in_the_report(executed: Path, tmp_path: Path) -> None:
    """The points of a scan that differs from the manifest are not written."""
    shutil.copytree(executed, tmp_path / "run")
    scans = sorted((tmp_path / "run").glob("executions/0001/scans/*.npz"))
    shutil.copyfile(scans[1], scans[0])
    api.points(tmp_path / "run", tmp_path / "points.csv")
    table = np.loadtxt(tmp_path / "points.csv", delimiter=",", skiprows=1)
    assert set(table[:, 4]) == set(range(2, len(scans) + 1))


@pytest.mark.parametrize("kind", [".ply", ".stl", ".obj", ".glb"])
def test_surface_of_an_execution(kind: str, executed: Path, tmp_path: Path) -> None:
    """The same surface; PLY, OBJ and GLB show the deviation."""
    out = tmp_path / f"surface{kind}"
    surface = Execution.open(executed / "executions" / "0001").mesh
    assert surface is not None
    assert api.points(executed, out) == len(surface.vertices)
    mesh = trimesh.load_mesh(out, process=False)
    np.testing.assert_allclose(mesh.area, surface.area * (1.0 if kind == ".glb" else 1e6), rtol=1e-4)
    np.testing.assert_allclose(mesh.bounds, surface.bounds * (1.0 if kind == ".glb" else 1000.0), rtol=1e-5, atol=1e-4)
    if kind in (".obj", ".glb"):
        assert len(np.unique(mesh.visual.vertex_colors, axis=0)) > 10
    if kind == ".glb":
        chunk = out.read_bytes()
        assert "_DEVIATION_MM" in json.dumps(json.loads(chunk[20 : 20 + int.from_bytes(chunk[12:16], "little")]))


def test_refusals(executed: Path, planned: Path, tmp_path: Path) -> None:
    """An unknown suffix, a plan without an execution, and a folder that is missing are one sentence each."""
    with pytest.raises(UsageError, match=r"is '.doc'; it must be one of: .e57"):
        api.points(executed, tmp_path / "points.doc")
    with pytest.raises(FileError, match="has no execution yet"):
        api.points(planned, tmp_path / "points.e57")
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError, match="cannot be written"):
        api.points(executed, tmp_path / "file" / "points.csv")
