"""The builder of the built-in parts: the shipped meshes, the shapes, and their meshing."""

import numpy as np
import pytest

from benchmarks.part_models import fields, mesher
from benchmarks.part_models.build import PART_MODELS, build, packed
from cell.files import model_file
from cell.part import builtin


@pytest.mark.parametrize("name", builtin.NAMES)
def test_the_shipped_part_is_the_built_one(name: str) -> None:
    """A built part equals the shipped part in every bit.

    This holds for the versions of numpy, scikit-image and fast-simplification of the shipped files.
    """
    built, shipped = build(name), builtin.load(name)
    assert built.vertices.tobytes() == shipped.vertices.tobytes()
    assert built.faces.tobytes() == shipped.faces.tobytes()
    assert built.faces.dtype == shipped.faces.dtype == np.int32


def test_packing_again_gives_the_shipped_file() -> None:
    """A part packed again equals its shipped file, and every part is shipped."""
    assert packed("mug") == model_file("parts/mug.npz").read_bytes()
    assert tuple(PART_MODELS) == builtin.NAMES


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
    """The mesh of each shape has the volume of the textbook formula within 1 %, at the right place."""
    assert field(np.array([inside], np.float32).T)[0] < 0
    mesh = mesher.mesh_of(field, (-6.5, -6.5, -6.5), (6.5, 6.5, 6.5), 0.1)
    corners = mesh.vertices[mesh.faces]
    found = np.einsum("fj,fj->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    assert found == pytest.approx(volume, rel=0.01)


def test_sparse_evaluation_is_the_dense_one() -> None:
    """The surface from blocks near a bumpy shape equals the surface from every grid point."""
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
    """An odd number of faces, which pairwise removal cannot reach, is an error."""
    ball = mesher.mesh_of(fields.ellipsoid((0, 0, 0), (3, 3, 3)), (-4, -4, -4), (4, 4, 4), 0.5)
    with pytest.raises(ArithmeticError, match="not to 301"):
        mesher.collapsed_to(ball, 301)
