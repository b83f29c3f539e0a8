"""Vertex clustering: fewer faces, the same closed surface as far as cells tell, and no copy where cells do not tell."""

import numpy as np
import pytest
import trimesh

from planner.geometry.decimation import _uncancelled, clustered, decimate
from planner.geometry.mesh import TriangleMesh


def _mesh(solid: trimesh.Trimesh) -> TriangleMesh:
    return TriangleMesh(np.asarray(solid.vertices), np.asarray(solid.faces, dtype=np.int32))


def test_a_ball_stays_a_ball():
    """About as many faces as wanted, closed, outward, and nowhere farther off than half a cell's diagonal."""
    ball = trimesh.creation.icosphere(subdivisions=6, radius=0.05)
    copy = clustered(_mesh(ball), 8000)
    assert 5000 < len(copy.faces) < 10_000
    made = trimesh.Trimesh(copy.vertices, copy.faces, process=False)
    assert made.is_watertight
    assert made.volume == pytest.approx(ball.volume, rel=0.01)
    side = np.sqrt(3 * ball.area / 8000)
    assert np.abs(np.linalg.norm(copy.vertices, axis=1) - 0.05).max() < side * np.sqrt(3) / 2


def test_no_copy_of_few_faces_or_thin_walls():
    """A sheet thinner than a cell would lose both its sides; a mesh with few faces has nothing to gain."""
    sheet = trimesh.creation.box((0.1, 0.1, 1e-4))
    for _ in range(7):
        sheet = sheet.subdivide()
    assert clustered(_mesh(sheet), 2000) is None
    assert clustered(_mesh(trimesh.creation.icosphere(subdivisions=4)), 5000) is None


def test_faces_that_lie_on_each_other_cancel_by_winding():
    """A fold vanishes; of three sheets, two of them one way, one is left that way, whichever comes first."""
    one, other = [0, 1, 2], [2, 1, 0]
    rest = [4, 3, 5]
    for on_each_other, left in (([one, other], None), ([one, one, other], one), ([other, one, one], one)):
        kept = _uncancelled(np.array([*on_each_other, rest], dtype=np.int32), 6).tolist()
        assert kept == ([] if left is None else [left]) + [[3, 5, 4]]


def test_a_mesh_of_very_many_faces_is_decimated_to_the_count():
    """Through the copy: the count is met, the volume kept."""
    ball = trimesh.creation.icosphere(subdivisions=8, radius=0.05)
    copy = decimate(_mesh(ball), 900)
    assert abs(len(copy.faces) - 900) <= 20
    assert trimesh.Trimesh(copy.vertices, copy.faces).volume == pytest.approx(ball.volume, rel=0.02)
