"""Names, cache and shapes of the built-in parts; the frozen meshes themselves are in golden."""

import zipfile
from pathlib import Path

import numpy as np
import pytest

from cell import stand_ins
from cell.errors import UsageError
from cell.stand_ins import fields, mesher
from planner.geometry.mesh import TriangleMesh


def shape(part: stand_ins.StandIn) -> TriangleMesh:
    """Any mesh of the part's numbers of faces and vertices."""
    faces = np.random.default_rng(0).integers(0, part.vertices, (part.faces, 3))
    return TriangleMesh(np.random.default_rng(1).random((part.vertices, 3)), faces.astype(np.int32))


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """An empty cache folder; the list tells which parts were made and not read."""
    made: list[str] = []

    def make(name: str) -> TriangleMesh:
        made.append(name)
        return shape(stand_ins.STAND_INS[name])

    monkeypatch.setattr(stand_ins, "_make", make)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return made


def files(tmp_path: Path) -> list[Path]:
    """What the cache holds."""
    return sorted(path for path in tmp_path.rglob("*") if path.is_file())


def test_an_unknown_name_is_refused_with_the_names_that_exist() -> None:
    """The sentence lists all six."""
    with pytest.raises(UsageError, match="mseke, mug, robinet, petanque, humerus, st-jean"):
        stand_ins.build("teapot")


def test_the_cache_gives_the_bytes_that_were_built(cache: list[str], tmp_path: Path) -> None:
    """The second call makes nothing and returns the same arrays; no part file stays."""
    first, second = stand_ins.build("mug"), stand_ins.build("mug")
    assert cache == ["mug"]
    assert first.vertices.tobytes() == second.vertices.tobytes()
    assert first.faces.tobytes() == second.faces.tobytes()
    assert first.faces.dtype == second.faces.dtype == np.int32
    assert [path.suffix for path in files(tmp_path)] == [".npz"]


@pytest.mark.parametrize(
    "spoil",
    [
        lambda path: path.write_bytes(b""),
        lambda path: path.write_bytes(b"not a mesh"),
        lambda path: path.write_bytes(path.read_bytes()[:100_000]),
        lambda path: path.write_bytes(path.read_bytes()[:100_000] + b"\xff" + path.read_bytes()[100_001:]),
        lambda path: np.savez(path, other=np.zeros(3)),
        lambda path: np.savez(path, vertices=np.zeros((3, 3)), faces=np.array([[0, 1, 2]])),
        lambda path: np.savez(path, vertices=np.array([None]), faces=np.array([[0, 1, 2]]), allow_pickle=True),
        lambda path: zipfile.ZipFile(path, "w").close(),
    ],
    ids=["empty", "text", "cut short", "one byte flipped", "other arrays", "another mesh", "pickled", "empty archive"],
)
def test_a_spoilt_cache_is_ignored_and_replaced(cache: list[str], tmp_path: Path, spoil: object) -> None:
    """Whatever lies in the cache file's place, the part is the one that was built, and the file is good again."""
    good = stand_ins.build("mug")
    (path,) = files(tmp_path)
    spoil(path)  # type: ignore[operator]
    again, read = stand_ins.build("mug"), stand_ins.build("mug")
    assert cache == ["mug", "mug"]
    assert good.vertices.tobytes() == again.vertices.tobytes() == read.vertices.tobytes()


def test_a_cache_that_cannot_be_written_is_no_failure(
    cache: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file stands where the folder should be: the part is built each time, and nothing is raised."""
    (tmp_path / "scan-cell").write_text("in the way")
    stand_ins.build("mug")
    stand_ins.build("mug")
    assert cache == ["mug", "mug"]


def test_a_full_disk_leaves_no_half_file(cache: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The write fails in the middle: the part is returned, and the cache folder is as it was."""

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(stand_ins.np, "savez", full)
    assert len(stand_ins.build("mug").faces) == 149988
    assert files(tmp_path) == []


@pytest.mark.parametrize(
    ("field", "inside", "volume"),
    [
        (fields.ellipsoid((0, 0, 0), (4, 3, 2)), (0, 0, 0), 4 / 3 * np.pi * 24),
        (fields.capsule((-2, 0, 0), (2, 0, 0), 2), (0, 0, 0), 4 / 3 * np.pi * 8 + np.pi * 4 * 4),
        (fields.cylinder((0, 0, -2), (0, 0, 3), 3), (0, 0, 0), np.pi * 9 * 5),
        (fields.box((0, 0, 0), (4, 3, 2)), (0, 0, 0), 8 * 24),
        (fields.box((0, 0, 0), (4, 3, 2), 0, fields.rotation(2, 30)), (0, 0, 0), 8 * 24),
        (fields.torus((0, 0, 0), 2, 3.5, 1), (3.5, 0, 0), 2 * np.pi**2 * 3.5),
        (fields.revolve(2, [-2, 3], [3, 3]), (0, 0, 0), np.pi * 9 * 5),
        (
            fields.without(0, fields.box((0, 0, 0), (4, 4, 2)), fields.cylinder((0, 0, -9), (0, 0, 9), 2)),
            (3, 3, 0),
            (64 - 4 * np.pi) * 4,
        ),
    ],
    ids=["ellipsoid", "capsule", "cylinder", "box", "turned box", "torus", "revolved", "drilled box"],
)
def test_a_shape_has_its_closed_forms_volume(field: fields.Field, inside: object, volume: float) -> None:
    """Sign, size and place of each shape: the mesh cut from it has the volume of the textbook formula within 1 %."""
    assert field(np.array([inside], np.float32).T)[0] < 0
    mesh = mesher.mesh_of(field, (-6.5, -6.5, -6.5), (6.5, 6.5, 6.5), 0.1)
    corners = mesh.vertices[mesh.faces]
    found = np.einsum("fj,fj->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    assert found == pytest.approx(volume, rel=0.01)


def test_sparse_evaluation_is_the_dense_one() -> None:
    """On a lumpy shape, the surface from blocks near it is that from every grid point."""
    field = fields.displaced(
        fields.union(0.5, fields.ellipsoid((0, 0, 0), (5, 1, 4)), fields.torus((0, 0, 0), 0, 4, 0.7)),
        fields.ripples(np.random.default_rng(3), 0.1, 2.0),
    )
    low, cell = np.array([-6.0, -6.0, -6.0]), 0.15
    sparse = mesher._sample(field, low, -low, cell)
    index = np.stack(np.meshgrid(*(np.arange(n) for n in sparse.shape), indexing="ij")).reshape(3, -1)
    dense = field(index.astype(np.float32) * np.float32(cell) + low.astype(np.float32)[:, None]).reshape(sparse.shape)
    assert ((sparse < 0) == (dense < 0)).all()
    near = np.abs(dense) < cell
    assert near.sum() > 10_000
    assert (np.abs(sparse[near]) <= 1.001).all()


def test_a_count_that_cannot_be_met_is_an_error() -> None:
    """An odd count cannot be reached by closing pairs of faces: it is said, not rounded."""
    ball = mesher.mesh_of(fields.ellipsoid((0, 0, 0), (3, 3, 3)), (-4, -4, -4), (4, 4, 4), 0.5)
    with pytest.raises(ArithmeticError, match="not to 301"):
        mesher.to_count(ball, 301)
