"""The cached matrix: contents, dependencies of the key, and rejected files with their reasons."""

import dataclasses

import numpy as np
import pytest

from cell.errors import FileError
from cell.scanners.laser_area import LaserArea
from cell.world.measurability import FORMAT, column_hashes, load, row_key, save
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples
from planner.measurability.matrix import Measurability
from planner.viewpoints.viewpoints import Viewpoints


@pytest.fixture
def parts():
    """Return all inputs of a small matrix."""
    rng = np.random.default_rng(0)
    mesh = TriangleMesh(rng.random((4, 3)), [[0, 1, 2], [0, 2, 3]])
    features = SurfaceSamples(rng.random((3, 3)), rng.random((3, 3)), rng.random(3), [0, 1, 1], [0, 0, 1])
    views = Viewpoints(np.tile(np.eye(4), (5, 1, 1, 1)), np.arange(5), np.ones(5), np.zeros(5))
    return mesh, features, views, LaserArea().parameters(), "aimed"


@pytest.fixture
def matrix(parts):
    """Return a matrix of 3 samples x 5 viewpoints."""
    return Measurability([0, 2, 2, 3], [0, 4, 1], parts[1], 5)


# Requirements of the regions are applied to M afterwards.
_FEATURES = [name for name in SurfaceSamples.__dataclass_fields__ if name != "region"]


def _key(parts):
    mesh, features, _, scanner, method = parts
    return row_key(mesh, features, scanner, method)


def _distinct(count):
    """Return viewpoints with one translation each."""
    T = np.tile(np.eye(4), (count, 1, 1, 1))
    T[:, 0, 0, 3] = np.arange(count)
    return Viewpoints(T, np.arange(count), np.ones(count), np.zeros(count))


def _nudged(value, name):
    array = np.array(getattr(value, name))
    array.flat[0] = array.flat[0] + (1 if array.dtype.kind == "i" else 1e-12)
    return dataclasses.replace(value, **{name: array})


def test_a_saved_matrix_is_read_back(tmp_path, parts, matrix):
    """Every array and the shape are equal after saving to a new folder."""
    path, key = tmp_path / "new" / "m.npz", _key(parts)
    save(path, matrix, key, column_hashes(parts[2]))
    found = load(path, key)
    assert found.reason == ""
    assert found.measurability.shape == (3, 5)
    for name in ("indptr", "indices"):
        assert (getattr(found.measurability, name) == getattr(matrix, name)).all()
    for name in _FEATURES:
        ours, theirs = getattr(matrix.samples, name), getattr(found.measurability.samples, name)
        assert ours.dtype == theirs.dtype
        assert (ours == theirs).all()
    assert [entry.name for entry in path.parent.iterdir()] == ["m.npz"]


def test_the_file_s_fields_are_the_run_folder_s(tmp_path, parts, matrix):
    """Programs with NumPy alone read these names."""
    save(tmp_path / "m.npz", matrix, _key(parts), column_hashes(parts[2]))
    with np.load(tmp_path / "m.npz", allow_pickle=False) as stored:
        names = set(stored.files)
        assert stored["shape"].tolist() == [3, 5]
    assert names >= {"indptr", "indices", "shape", "points", "normals", "areas", "face", "planning_face", "key"}


def test_every_input_changes_the_key(parts):
    """One changed number in any input gives another key, and equal inputs give the same key."""
    mesh, features, _, scanner, method = parts
    base = row_key(mesh, features, scanner, method)
    assert base == row_key(mesh, features, scanner, method)
    assert len(base) == 64

    keys = [base]
    keys += [row_key(_nudged(mesh, name), features, scanner, method) for name in ("vertices", "faces")]
    keys += [row_key(mesh, _nudged(features, name), scanner, method) for name in _FEATURES]
    keys += [row_key(mesh, features, {**scanner, name: 1}, method) for name in scanner]
    keys.append(row_key(mesh, features, scanner, "rays"))
    keys.append(row_key(mesh, features, scanner, "rays", np.array([0, 1])))
    keys.append(row_key(mesh, features, scanner, "rays", np.array([1, 0])))
    assert len(set(keys)) == len(keys)


def test_the_hash_of_a_column_depends_on_its_poses_alone(parts):
    """A pose changed by 1e-12 changes its own column's hash and no other."""
    views = _distinct(5)
    base = column_hashes(views)
    assert len(set(base)) == 5
    changed = column_hashes(_nudged(views, "T_object_scanner"))
    assert (changed != base).tolist() == [True, False, False, False, False]
    assert (column_hashes(_nudged(views, "standoff")) == base).all()


def test_columns_are_found_in_any_order(tmp_path, parts, matrix):
    """Stored hashes are found in any order, and unknown hashes are not found."""
    views = _distinct(7)
    hashes = column_hashes(views)
    save(tmp_path / "m.npz", matrix, "0" * 64, hashes[:5])
    found = load(tmp_path / "m.npz", "0" * 64)
    assert found.columns_of(hashes[[6, 3, 0, 5, 4]]).tolist() == [-1, 3, 0, -1, 4]
    assert load(tmp_path / "none.npz", "0" * 64).columns_of(hashes).tolist() == [-1] * 7


def test_unsuitable_files_are_rejected_with_the_reason(tmp_path, parts, matrix):
    """A missing, foreign, outdated, truncated or damaged file, a text and another npz are rejected with a reason."""
    key, path = _key(parts), tmp_path / "m.npz"
    assert "does not exist" in load(path, key).reason
    save(path, matrix, key, column_hashes(parts[2]))
    good = path.read_bytes()
    assert "another part" in load(path, "0" * 64).reason

    with np.load(path) as stored:
        arrays = dict(stored)
    np.savez(path, **{**arrays, "format": np.array(FORMAT + 1)})
    assert f"has format {FORMAT + 1}" in load(path, key).reason
    np.savez(path, **{name: array for name, array in arrays.items() if name != "face"})
    assert "has no face" in load(path, key).reason
    np.savez(path, **{**arrays, "indices": np.array([0, 4, 9], np.int32)})
    assert "0 to 4" in load(path, key).reason
    np.savez(path, **{**arrays, "shape": np.array([7, 5])})
    assert "damaged" in load(path, key).reason
    np.savez(path, **{**arrays, "columns": arrays["columns"][:4]})
    assert "one hash each" in load(path, key).reason
    np.savez(path, **{**arrays, "indices": np.array([{}, None, 1], dtype=object)}, allow_pickle=True)
    assert "cannot be read" in load(path, key).reason  # nothing is unpickled

    for broken in (good[: len(good) // 2], b"", b"solid text", good.replace(matrix.indices.tobytes(), b"\0" * 12)):
        path.write_bytes(broken)
        result = load(path, key)
        assert result.measurability is None
        assert "cannot be read" in result.reason
    path.write_bytes(good)
    assert load(path, key).measurability is not None


def test_every_flipped_byte_is_harmless_or_found(tmp_path, parts, matrix):
    """A file with a flipped byte gives the same matrix or a reason, and raises no error."""
    key, path = _key(parts), tmp_path / "m.npz"
    save(path, matrix, key, column_hashes(parts[2]))
    good = path.read_bytes()
    refused = 0
    for place in range(0, len(good), 5):
        path.write_bytes(good[:place] + bytes([good[place] ^ 0x55]) + good[place + 1 :])
        found = load(path, key).measurability
        refused += found is None
        if found is not None:
            assert (found.indices == matrix.indices).all()
            assert (load(path, key).columns == column_hashes(parts[2])).all()
            assert (found.samples.points == matrix.samples.points).all()
    assert refused > 0.5 * len(range(0, len(good), 5))


def test_a_folder_that_cannot_be_written_has_one_message(tmp_path, parts, matrix):
    """A path below a file gives one message and no temporary file."""
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError, match=r"cannot be written to .*choose a folder"):
        save(tmp_path / "file" / "m.npz", matrix, _key(parts), column_hashes(parts[2]))
    assert [entry.name for entry in tmp_path.iterdir()] == ["file"]


def test_an_interrupted_write_keeps_the_old_file(tmp_path, parts, matrix, monkeypatch):
    """A full disk during writing raises an error. The earlier matrix is intact, and no temporary file remains."""
    key, path = _key(parts), tmp_path / "m.npz"
    save(path, matrix, key, column_hashes(parts[2]))

    def full(stream, **arrays):
        stream.write(b"PK half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("cell.world.measurability.np.savez", full)
    with pytest.raises(FileError, match="No space left"):
        save(path, matrix, key, column_hashes(parts[2]))
    assert load(path, key).measurability is not None
    assert [entry.name for entry in tmp_path.iterdir()] == ["m.npz"]
