"""Convex pieces hold every point of every triangle, whatever the mesh; equal meshes give equal pieces."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from cell.world import piece_cache
from cell.world.decomposition import enclosing_pieces, is_closed
from planner.surface.mesh import TriangleMesh

ROUNDING = 1e-9  # m


def _mesh(mesh: trimesh.Trimesh) -> TriangleMesh:
    return TriangleMesh(np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int32))


def _mug() -> TriangleMesh:
    outline = [(0.0, 0.0), (0.04, 0.0), (0.04, 0.1), (0.036, 0.1), (0.036, 0.005), (0.0, 0.005)]
    return _mesh(trimesh.creation.revolve(np.array(outline), sections=48))


def _sheet() -> TriangleMesh:
    return TriangleMesh(
        np.array([[0.0, 0, 0], [0.3, 0, 0], [0.3, 0.2, 0], [0, 0.2, 0]]), np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    )


def _open_bowl() -> TriangleMesh:
    ball = trimesh.creation.icosphere(3, 0.1)
    return _mesh(trimesh.Trimesh(ball.vertices, ball.faces[ball.triangles_center[:, 2] < 0.01]))


def _shells() -> TriangleMesh:
    balls = [trimesh.creation.icosphere(1, 0.02) for _ in range(7)]
    for k, ball in enumerate(balls):
        ball.apply_translation([0.1 * k, 0.05 * (k % 3), 0.03 * (k % 2)])
    return _mesh(trimesh.util.concatenate(balls))


def _soup() -> TriangleMesh:
    rng = np.random.default_rng(5)
    corners = rng.normal(0, 0.05, (80, 1, 3)) + rng.normal(0, 0.02, (80, 3, 3))
    return TriangleMesh(corners.reshape(-1, 3), np.arange(240, dtype=np.int32).reshape(-1, 3))


def _dense() -> TriangleMesh:
    """150,000 faces with a deep cavity."""
    torus = trimesh.creation.torus(0.1, 0.03, major_sections=300, minor_sections=250)
    return _mesh(torus)


PARTS: dict[str, Callable[[], TriangleMesh]] = {
    "a mug": _mug,
    "a thin sheet": _sheet,
    "an open bowl": _open_bowl,
    "seven balls apart": _shells,
    "triangles that cross each other": _soup,
    "a ring around nothing": lambda: _mesh(trimesh.creation.annulus(0.09, 0.1, 0.02)),
    "a torus of 150,000 faces": _dense,
    "a cube": lambda: _mesh(trimesh.creation.box((0.1, 0.1, 0.1))),
    "one triangle": lambda: TriangleMesh(
        np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]]), np.array([[0, 1, 2]], np.int32)
    ),
    "far from the origin": lambda: TriangleMesh(_mug().vertices + np.array([50.0, -30.0, 4.0]), _mug().faces),
    "half a millimetre": lambda: TriangleMesh(_mug().vertices * 0.005, _mug().faces),
}


@pytest.fixture(scope="module")
def found() -> dict[str, tuple[TriangleMesh, tuple[TriangleMesh, ...]]]:
    """Each part with its pieces."""
    parts = {name: make() for name, make in PARTS.items()}
    return {name: (part, enclosing_pieces(part, most=24, use_cache=False)) for name, part in parts.items()}


def _half_spaces(piece: TriangleMesh) -> np.ndarray:
    """(F, 4) of the piece's own vertices, found anew."""
    middle = piece.vertices.mean(axis=0)
    equations = ConvexHull(piece.vertices - middle).equations.copy()
    equations[:, 3] -= equations[:, :3] @ middle
    return equations


@pytest.mark.parametrize("name", PARTS)
def test_every_point_of_every_triangle_is_in_a_piece(
    name: str, found: dict[str, tuple[TriangleMesh, tuple[TriangleMesh, ...]]]
) -> None:
    """Vertices, middles of edges, and random points of all triangles, against the half-spaces of the pieces."""
    part, pieces = found[name]
    rng = np.random.default_rng(0)
    corners = part.vertices[part.faces]
    spread = corners[rng.integers(len(corners), size=3_000)]
    inner = np.einsum("pk,pkj->pj", rng.dirichlet((1, 1, 1), len(spread)), spread)
    points = np.concatenate(
        [rng.permutation(part.vertices[np.unique(part.faces)])[:3_000], spread[:1_000, :2].mean(axis=1), inner]
    )
    rounding = ROUNDING + 1e-14 * np.abs(points).max()
    outside = np.full(len(points), np.inf)
    for piece in pieces:
        equations = _half_spaces(piece)
        waiting = np.flatnonzero(outside > rounding)
        beyond = points[waiting] @ equations[:, :3].T + equations[:, 3]
        outside[waiting] = np.minimum(outside[waiting], beyond.max(axis=1))
    assert outside.max() <= rounding


@pytest.mark.parametrize("name", PARTS)
def test_pieces_never_reach_beyond_the_hull(
    name: str, found: dict[str, tuple[TriangleMesh, tuple[TriangleMesh, ...]]]
) -> None:
    """Nothing is refused that the hull allows, but for the thickness that flat pieces are given."""
    part, pieces = found[name]
    low, high = part.vertices[part.faces].min(axis=(0, 1)), part.vertices[part.faces].max(axis=(0, 1))
    for piece in pieces:
        assert (piece.vertices >= low - 1.1e-4).all()
        assert (piece.vertices <= high + 1.1e-4).all()


def test_a_convex_part_is_one_piece_and_a_hollow_one_is_open(
    found: dict[str, tuple[TriangleMesh, tuple[TriangleMesh, ...]]],
) -> None:
    """What decomposition is for: the middle of mug, ring and torus is in no piece, and a cube is not cut."""
    assert [len(found[name][1]) for name in ("a cube", "one triangle", "a thin sheet")] == [1, 1, 1]
    assert len(found["seven balls apart"][1]) >= 7
    places = {"a mug": [0.0, 0.0, 0.06], "a ring around nothing": [0.0, 0, 0], "a torus of 150,000 faces": [0.0, 0, 0]}
    for name, hollow in places.items():
        _, pieces = found[name]
        assert 1 < len(pieces) <= 24
        for piece in pieces:
            equations = _half_spaces(piece)
            assert (np.array(hollow) @ equations[:, :3].T + equations[:, 3]).max() > 0.01


def test_equal_meshes_give_equal_pieces_and_the_cache_gives_them_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Byte for byte; a damaged or foreign file is passed over; other settings are another file."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    part = _mug()
    first = enclosing_pieces(part)
    files = list(piece_cache.cache_folder().glob("*.npz"))
    assert len(files) == 1
    told: list[tuple[int, int]] = []
    kept = enclosing_pieces(part, progress=lambda done, most: told.append((done, most)))
    assert told == []
    files[0].write_bytes(files[0].read_bytes()[:-200])
    again = enclosing_pieces(part, progress=lambda done, most: told.append((done, most)))
    assert told
    for one, two, three in zip(first, kept, again, strict=True):
        assert one.vertices.tobytes() == two.vertices.tobytes() == three.vertices.tobytes()
        assert one.faces.tobytes() == two.faces.tobytes() == three.faces.tobytes()
    assert len(enclosing_pieces(part, most=2)) == 2
    assert len(list(piece_cache.cache_folder().glob("*.npz"))) == 2


def test_a_cache_that_cannot_be_written_costs_nothing_but_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file stands where the folder would be."""
    blocked = tmp_path / "file"
    blocked.write_text("no folder")
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    assert len(enclosing_pieces(_sheet())) == 1


def test_closed_means_that_every_edge_joins_two_faces() -> None:
    """Two shells are closed as well; an open bowl and a sheet are not."""
    assert is_closed(_mug())
    assert is_closed(_shells())
    assert not is_closed(_open_bowl())
    assert not is_closed(_sheet())
