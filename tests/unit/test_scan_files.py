"""E57, PTX, LAS and LAZ: round trips of points and poses, files of other programs, damaged files."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cell.errors import FileError
from cell.metrology import point_files, scan_files
from cell.metrology.scan_files import PosedScan


def scans_of(seed: int) -> list[PosedScan]:
    """Return three scans with general poses, as far from the origin as cells are."""
    rng = np.random.default_rng(seed)
    scans = []
    for count in (400, 1, 250):
        T = np.eye(4)
        T[:3, :3] = Rotation.random(random_state=int(rng.integers(1000))).as_matrix()
        T[:3, 3] = rng.uniform(-3.0, 3.0, 3)
        scans.append(PosedScan(rng.uniform(-0.5, 0.5, (count, 3)), T, rng.normal(0.0, 0.05, count)))
    return scans


@pytest.mark.parametrize("kind", [".e57", ".ptx"])
def test_scans_keep_points_and_poses(kind: str, tmp_path: Path) -> None:
    """Points agree to 1e-6 m, poses to 1e-9; `read` merges them by their poses."""
    scans, path = scans_of(1), tmp_path / f"scans{kind}"
    scan_files.write(path, scans, kind)
    found = scan_files.read(path)
    assert [len(scan.points) for scan in found] == [400, 1, 250]
    for scan, same in zip(scans, found, strict=True):
        np.testing.assert_allclose(same.points, scan.points, atol=1e-6, rtol=0.0)
        np.testing.assert_allclose(same.T, scan.T, atol=1e-9, rtol=0.0)
        if kind == ".e57":
            assert same.values is not None
            np.testing.assert_allclose(same.values, scan.values, atol=1e-6)
    merged = np.concatenate([scan.points_in_file for scan in scans])
    np.testing.assert_allclose(point_files.read(path), merged, atol=1e-6, rtol=0.0)


@pytest.mark.parametrize("kind", [".las", ".laz"])
def test_a_cloud_keeps_points_and_deviations(kind: str, tmp_path: Path) -> None:
    """One cloud in the frame of the file, with the number of the view."""
    scans, path = scans_of(2), tmp_path / f"cloud{kind}"
    scan_files.write(path, scans, kind)
    (found,) = scan_files.read(path)
    merged = np.concatenate([scan.points_in_file for scan in scans])
    np.testing.assert_allclose(found.points, merged, atol=1e-6, rtol=0.0)
    assert found.values is not None
    np.testing.assert_array_equal(found.values, np.concatenate([scan.values for scan in scans]))
    np.testing.assert_array_equal(point_files.read(path), found.points)


def test_a_ptx_file_of_a_scanner(tmp_path: Path) -> None:
    """Rays without an echo are left out; colours behind the intensity do not matter; the matrix is transposed."""
    path = tmp_path / "station.ptx"
    path.write_text(
        "2\r\n2\r\n1 2 3\r\n0 1 0\r\n-1 0 0\r\n0 0 1\r\n0 1 0 0\r\n-1 0 0 0\r\n0 0 1 0\r\n1 2 3 1\r\n"
        "0.5 0 0 0.25 10 20 30\r\n0 0 0 0.5 0 0 0\r\n0 0.5 0 0.75 1 2 3\r\n0 0 0.5 1 1 1 1\r\n"
    )
    (scan,) = scan_files.read(path)
    np.testing.assert_array_equal(scan.points, 0.5 * np.eye(3))
    np.testing.assert_array_equal(scan.values, [0.25, 0.75, 1.0])
    np.testing.assert_allclose(point_files.read(path), [[1.0, 2.5, 3.0], [0.5, 2.0, 3.0], [1.0, 2.0, 3.5]])


@pytest.mark.parametrize("kind", scan_files.SUFFIXES)
@pytest.mark.parametrize("damage", ["cut", "other"])
def test_damaged_files_are_refused(kind: str, damage: str, tmp_path: Path) -> None:
    """One sentence with the name of the file."""
    path = tmp_path / f"scans{kind}"
    scan_files.write(path, scans_of(3), kind)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2] if damage == "cut" else b"not a file of points\n" * 40)
    with pytest.raises(FileError, match=rf"scans{kind} is no readable {kind} file"):
        scan_files.read(path)


@pytest.mark.parametrize("points", ["1 2 3\n4 5 6\n7 8 9\n0 1 2\n", "1 2 3 0.5\n" * 3, ""])
def test_a_ptx_file_without_intensity_or_points_is_refused(points: str, tmp_path: Path) -> None:
    """Four points of three numbers are not three points of four, and a missing point is not none."""
    path = tmp_path / "station.ptx"
    path.write_text("1\n4\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n" + points)
    with pytest.raises(FileError, match=r"cut short, or a point has not x, y, z and intensity"):
        scan_files.read(path)


def test_missing_file() -> None:
    """The words are those of the system."""
    for kind in scan_files.SUFFIXES:
        with pytest.raises(FileError, match="cannot be read: No such file"):
            scan_files.read(Path(f"/nowhere/scans{kind}"))
