"""The Embree ray caster: results that can be checked by hand, and refused input."""

import sys
import threading

import numpy as np
import pytest

from cell.errors import CellError
from cell.world.embree import HAIR, EmbreeRayCaster

pytestmark = pytest.mark.usefixtures("four_threads")

SQUARE = (
    np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]),
    np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32),
)


def test_first_hit_gives_face_and_distance_and_a_miss_gives_none():
    """Rays at each triangle of a square return face and distance. A ray that misses returns -1 and infinity."""
    origins = np.array([[0.5, -0.5, 2.0], [-0.5, 0.5, -3.0], [1.5, 0, 2.0]])
    directions = np.array([[0, 0, -1.0], [0, 0, 1.0], [0, 0, -1.0]])
    hits = EmbreeRayCaster(*SQUARE).first_hit(origins, directions)
    assert hits.face.tolist() == [0, 1, -1]
    assert hits.distance[:2] == pytest.approx([2.0, 3.0], rel=1e-6)
    assert np.isinf(hits.distance[2])
    assert hits.distance.dtype == np.float64


def test_blocked_is_a_bool_that_ends_before_the_target():
    """A ray to the square is free, a ray through it is blocked, and a ray that ends above it is free."""
    caster = EmbreeRayCaster(*SQUARE)
    origins = np.array([[0.3, 0.2, 2.0]] * 3)
    targets = np.array([[0.3, 0.2, 0.0], [0.3, 0.2, -0.001], [0.3, 0.2, 0.001]])
    blocked = caster.blocked(origins, targets)
    assert blocked.dtype == np.bool_
    assert blocked.tolist() == [False, True, False]


def test_the_hair_is_as_short_as_documented():
    """A target two tolerances behind the square is blocked; a target half a tolerance behind it is not."""
    caster = EmbreeRayCaster(*SQUARE)
    hair = HAIR * (2.0 + np.sqrt(2.0))
    targets = np.array([[0.3, 0.2, -2 * hair], [0.3, 0.2, -0.5 * hair]])
    assert caster.blocked(np.array([[0.3, 0.2, 2.0]] * 2), targets).tolist() == [True, False]


def test_a_ray_without_length_is_free_and_an_empty_batch_is_valid():
    """A ray with equal origin and target is free, and an empty batch gives an empty result."""
    caster = EmbreeRayCaster(*SQUARE)
    assert caster.blocked(np.zeros((1, 3)), np.zeros((1, 3))).tolist() == [False]
    assert caster.blocked(np.zeros((0, 3)), np.zeros((0, 3))).shape == (0,)
    assert caster.first_hit(np.zeros((0, 3)), np.zeros((0, 3))).face.shape == (0,)


def test_the_arguments_are_not_written_to():
    """The caller's arrays are unchanged, although Embree's bindings write to some arguments."""
    origins, directions = np.array([[0, 0, 2.0]]), np.array([[0, 0, -1.0]])
    targets = np.array([[0, 0, -1.0]])
    before = [array.copy() for array in (origins, directions, targets)]
    caster = EmbreeRayCaster(*SQUARE)
    caster.first_hit(origins, directions)
    caster.blocked(origins, targets)
    assert all((a == b).all() for a, b in zip(before, (origins, directions, targets), strict=True))


def test_rays_that_are_split_over_cores_have_equal_results():
    """50,001 rays in one call have bit-equal results to the same rays in small calls."""
    rng = np.random.default_rng(1)
    origins = np.column_stack([rng.uniform(-2, 2, (50_001, 2)), np.full(50_001, 1.5)])
    targets = np.column_stack([rng.uniform(-2, 2, (50_001, 2)), np.full(50_001, -0.5)])
    directions = targets - origins
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    caster = EmbreeRayCaster(*SQUARE)
    whole, legs = caster.first_hit(origins, directions), caster.blocked(origins, targets)
    small = [caster.first_hit(origins[i : i + 9999], directions[i : i + 9999]) for i in range(0, 50_001, 9999)]
    assert (whole.face == np.concatenate([piece.face for piece in small])).all()
    assert (whole.distance == np.concatenate([piece.distance for piece in small])).all()
    assert (legs == (whole.face >= 0)).all()
    assert 0.1 < legs.mean() < 0.9


def test_several_threads_may_share_one_caster():
    """Four concurrent threads get the correct results."""
    caster = EmbreeRayCaster(*SQUARE)
    x = np.linspace(-2, 2, 30_001)
    origins = np.column_stack([x, 0.1 * x, np.ones_like(x)])
    directions = np.tile([0, 0, -1.0], (len(x), 1))
    answers: list[np.ndarray] = []
    threads = [
        threading.Thread(target=lambda: answers.append(caster.first_hit(origins, directions).face >= 0))
        for _ in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(answers) == 4
    assert all((answer == (np.abs(x) <= 1)).all() for answer in answers)


@pytest.mark.parametrize(
    ("vertices", "faces", "words"),
    [
        (SQUARE[0][:, :2], SQUARE[1], "vertices.*shape"),
        (SQUARE[0], np.zeros((0, 3), np.int32), "1 or more"),
        (SQUARE[0], SQUARE[1].astype(float), "integers"),
        (SQUARE[0], SQUARE[1] + 1, "valid are 0 to 3"),
        (SQUARE[0], SQUARE[1] - 1, "valid are 0 to 3"),
        (SQUARE[0] * np.nan, SQUARE[1], "NaN"),
    ],
    ids=["flat vertices", "no faces", "float faces", "index too large", "negative index", "NaN"],
)
def test_invalid_triangles_are_refused(vertices, faces, words):
    """Invalid triangles are refused, since Embree's bindings would read outside the arrays."""
    with pytest.raises(CellError, match=words):
        EmbreeRayCaster(vertices, faces)


@pytest.mark.parametrize(
    ("origins", "directions", "words"),
    [
        (np.zeros((2, 3)), np.ones((1, 3)), r"both must be \(N, 3\)"),
        (np.zeros(3), np.zeros(3), r"both must be \(N, 3\)"),
        (np.full((1, 3), np.nan), np.array([[0, 0, 1.0]]), "NaN"),
        (np.zeros((1, 3)), np.array([[0, 0, 2.0]]), "unit vector"),
        (np.zeros((1, 3)), np.zeros((1, 3)), "unit vector"),
    ],
    ids=["fewer directions", "one-dimensional", "NaN", "not unit", "zero"],
)
def test_invalid_rays_are_refused(origins, directions, words):
    """Invalid rays are refused with one sentence."""
    with pytest.raises(CellError, match=words):
        EmbreeRayCaster(*SQUARE).first_hit(origins, directions)


def test_an_error_in_a_thread_is_raised():
    """NaN in the last of many rays is refused."""
    origins = np.zeros((50_000, 3))
    origins[-1] = np.nan
    with pytest.raises(CellError, match="NaN"):
        EmbreeRayCaster(*SQUARE).blocked(origins, np.ones((50_000, 3)))


def test_without_embreex_the_message_names_the_package(monkeypatch):
    """A missing embreex is reported with the command that installs it. There is no fallback engine."""
    monkeypatch.setitem(sys.modules, "embreex", None)
    with pytest.raises(CellError, match=r'pip install "embreex>=4.4,<5"'):
        EmbreeRayCaster(*SQUARE)


def test_an_old_embreex_is_refused(monkeypatch):
    """Release 2.17 is refused, since it wraps another Embree with a different meaning of results."""
    import embreex

    monkeypatch.setattr(embreex, "__version__", "2.17.7")
    with pytest.raises(CellError, match=r"2\.17\.7 is installed"):
        EmbreeRayCaster(*SQUARE)


def test_an_unused_vertex_may_be_nan():
    """Unused vertices, also with NaN, do not change the results."""
    vertices = np.vstack([SQUARE[0], [np.nan] * 3, [1e9] * 3])
    hits = EmbreeRayCaster(vertices, SQUARE[1]).first_hit(np.array([[0.5, -0.5, 2.0]]), np.array([[0, 0, -1.0]]))
    assert hits.distance[0] == pytest.approx(2.0, rel=1e-6)
