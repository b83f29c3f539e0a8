"""The cached planning mesh equals the decimated part."""

from pathlib import Path

import numpy as np
import pytest

from cell.part import planning_mesh as module
from cell.part.planning_mesh import planning_mesh
from cell.part.workpiece import load
from planner.geometry.decimation import decimate
from planner.geometry.mesh import TriangleMesh


@pytest.fixture
def reference(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> TriangleMesh:
    """Return a built-in part; the cache is empty."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return load("mug").reference


def _files(tmp_path: Path) -> list[Path]:
    return sorted((tmp_path / "scan-cell" / "planning").glob("*"))


def test_a_stored_mesh_is_read_and_equal(reference, tmp_path, monkeypatch):
    """A second call reads the mesh of the first one."""
    expected = decimate(reference, 300)
    planning_mesh(reference, 300)
    monkeypatch.setattr(module, "decimate", lambda *_: pytest.fail("the mesh is decimated again"))
    again = planning_mesh(reference, 300)
    np.testing.assert_array_equal(again.vertices, expected.vertices)
    np.testing.assert_array_equal(again.faces, expected.faces)
    assert len(_files(tmp_path)) == 1


def test_another_count_or_part_has_another_file(reference, tmp_path):
    """The number of faces and the triangles decide which file is read."""
    moved = TriangleMesh(reference.vertices + 0.1, reference.faces)
    meshes = [planning_mesh(reference, 300), planning_mesh(reference, 500), planning_mesh(moved, 300)]
    assert len(meshes[0].faces) < len(meshes[1].faces)
    assert np.abs(meshes[2].vertices.mean(axis=0) - meshes[0].vertices.mean(axis=0)).min() > 0.09
    assert len(_files(tmp_path)) == 3


def test_without_the_cache_nothing_is_written(reference, tmp_path):
    """The cache is not used on request."""
    planning_mesh(reference, 300, use_cache=False)
    assert not _files(tmp_path)


@pytest.mark.parametrize("position", [0.3, 0.7])
def test_a_damaged_file_is_replaced(reference, tmp_path, position):
    """A changed byte is noticed, and the mesh is decimated again."""
    expected = planning_mesh(reference, 300)
    (path,) = _files(tmp_path)
    content = bytearray(path.read_bytes())
    content[int(position * len(content))] ^= 0xFF
    path.write_bytes(content)
    np.testing.assert_array_equal(planning_mesh(reference, 300).vertices, expected.vertices)
    assert path.read_bytes() != bytes(content)


def test_a_folder_that_cannot_be_written_is_ignored(reference, tmp_path):
    """A missing cache costs time only."""
    (tmp_path / "scan-cell").write_text("a file in place of the folder")
    assert len(planning_mesh(reference, 300).faces) > 0
