"""Decimation of a part to the planning mesh: face count, shape, and each of the three methods."""

import threading

import numpy as np
import pytest
import trimesh

from planner.errors import PlannerError
from planner.geometry.decimation import (
    _cancel_opposite,
    cluster_vertices,
    contract_short_edges,
    decimate,
    remesh,
    split_long_edges,
)
from planner.geometry.mesh import TriangleMesh
from tests.support.meshes import box, sphere, with_zero_area_faces


def test_decimation_hits_the_count_and_keeps_the_shape() -> None:
    """A sphere of 5120 faces becomes a closed, outward sphere of exactly 930 faces within 1 % of its volume."""
    fine = sphere()
    coarse = decimate(fine, 930)
    assert len(coarse.faces) == 930
    result = trimesh.Trimesh(coarse.vertices, coarse.faces, process=False)
    assert result.is_watertight
    assert result.is_winding_consistent
    assert result.volume == pytest.approx(4 / 3 * np.pi * 0.1**3, rel=0.01)


def test_decimation_of_a_mesh_that_is_coarse_already_only_cleans_it() -> None:
    """A mesh with fewer faces than requested loses only its degenerate and repeated faces."""
    dirty = with_zero_area_faces(box())
    repeated = TriangleMesh(dirty.vertices, np.vstack([dirty.faces, dirty.faces[5:7, [1, 2, 0]]]))
    clean = decimate(repeated, 12)
    assert len(clean.faces) == 12
    assert clean.areas.sum() == pytest.approx(box().areas.sum(), rel=1e-12)
    assert trimesh.Trimesh(clean.vertices, clean.faces, process=False).is_watertight


def test_decimation_from_several_threads_is_that_from_one() -> None:
    """Concurrent calls equal single calls, although the library keeps its mesh in globals."""
    meshes = [sphere(3, radius) for radius in (0.1, 0.2, 0.3, 0.4)]
    alone = [decimate(mesh, 200) for mesh in meshes]
    together: list[TriangleMesh | None] = [None] * 4

    def work(i: int) -> None:
        for _ in range(5):
            together[i] = decimate(meshes[i], 200)

    threads = [threading.Thread(target=work, args=(i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for one, other in zip(alone, together, strict=True):
        assert other is not None
        assert one.vertices.tobytes() == other.vertices.tobytes()


def test_decimation_to_no_faces_is_refused() -> None:
    """A face count below 1 is refused."""
    with pytest.raises(PlannerError, match="at least 1"):
        decimate(box(), 0)


def test_a_mesh_of_few_large_faces_is_split_on_its_surface() -> None:
    """A box of 12 faces decimated to 1000 is closed, has about 1000 faces on its surface, and keeps its area."""
    mesh = box()
    planning = decimate(mesh, 1000)
    assert 500 < len(planning.faces) < 1500
    assert planning.areas.sum() == pytest.approx(mesh.areas.sum(), rel=1e-12)
    assert trimesh.Trimesh(planning.vertices, planning.faces, process=False).is_watertight
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    centres = planning.centres
    assert (np.isclose(centres, low, atol=1e-12) | np.isclose(centres, high, atol=1e-12)).any(axis=1).all()


def test_a_ball_stays_a_ball():
    """A clustered ball is closed, with about the requested count.

    No vertex is farther off than half a cell's diagonal. Its decimation has the count and the volume of the ball.
    """
    ball = trimesh.creation.icosphere(subdivisions=6, radius=0.05)
    copy = cluster_vertices(TriangleMesh(ball.vertices, ball.faces), 8000)
    assert 5000 < len(copy.faces) < 10_000
    copy_mesh = trimesh.Trimesh(copy.vertices, copy.faces, process=False)
    assert copy_mesh.is_watertight
    assert copy_mesh.volume == pytest.approx(ball.volume, rel=0.01)
    side = np.sqrt(3 * ball.area / 8000)
    assert np.abs(np.linalg.norm(copy.vertices, axis=1) - 0.05).max() < side * np.sqrt(3) / 2
    planning = decimate(copy, 900)
    assert abs(len(planning.faces) - 900) <= 20
    assert trimesh.Trimesh(planning.vertices, planning.faces).volume == pytest.approx(ball.volume, rel=0.02)


def test_no_copy_of_few_faces_or_thin_walls():
    """Clustering is refused for a sheet thinner than a cell and for a mesh with few faces."""
    sheet = trimesh.creation.box((0.1, 0.1, 1e-4))
    for _ in range(7):
        sheet = sheet.subdivide()
    assert cluster_vertices(TriangleMesh(sheet.vertices, sheet.faces), 2000) is None
    assert cluster_vertices(sphere(), 5000) is None


def test_coincident_faces_cancel_by_winding():
    """Two opposite faces cancel. Of two faces with one winding and a third, opposite face, one of the two remains."""
    one, other = [0, 1, 2], [2, 1, 0]
    rest = [4, 3, 5]
    for on_each_other, left in (([one, other], None), ([one, one, other], one), ([other, one, one], one)):
        remaining = _cancel_opposite(np.array([*on_each_other, rest], dtype=np.int32), 6).tolist()
        assert remaining == ([] if left is None else [left]) + [[3, 5, 4]]


def needles() -> trimesh.Trimesh:
    """Return a CAD cylinder: 400 needles from end to end and 400 about the centre of each lid."""
    return trimesh.creation.cylinder(radius=0.03, height=0.25, sections=400)


@pytest.mark.parametrize("limit", [0.2, 0.05, 0.02])
def test_splitting_changes_no_surface(limit: float) -> None:
    """Splitting keeps area, volume, closedness and winding. No edge is longer than the limit at the end."""
    body = needles()
    vertices, faces = np.array(body.vertices), np.array(body.faces, np.int32)
    for _ in range(30):
        before = len(faces)
        vertices, faces = split_long_edges(vertices, faces, limit)
        if len(faces) == before:
            break
    result = trimesh.Trimesh(vertices, faces, process=False)
    assert result.edges_unique_length.max() <= limit
    assert result.is_watertight
    assert result.is_winding_consistent
    assert result.area == pytest.approx(body.area, rel=1e-9)
    assert result.volume == pytest.approx(body.volume, rel=1e-9)
    assert (vertices[: len(body.vertices)] == body.vertices).all()


@pytest.mark.parametrize("limit", [0.002, 0.01, 0.02])
def test_contracting_keeps_the_topology(limit: float) -> None:
    """A contracted ball is closed and keeps its genus and outward winding.

    It has fewer faces if any edge was shorter than the limit.
    """
    body = trimesh.creation.icosphere(subdivisions=4, radius=0.1)
    vertices, faces = contract_short_edges(np.array(body.vertices), np.array(body.faces, np.int32), limit)
    result = trimesh.Trimesh(vertices, faces, process=False)
    assert result.is_watertight
    assert result.is_winding_consistent
    assert len(np.unique(faces)) - len(faces) // 2 == 2
    assert result.volume == pytest.approx(body.volume, rel=0.08)  # chords of 0.02 m and more in a ball of 0.1 m
    shorter = body.edges_unique_length.min() < limit
    assert (len(faces) < len(body.faces)) == shorter


def test_contracting_keeps_corners() -> None:
    """A finely meshed box keeps its eight corners and its volume to within 3 %."""
    body = trimesh.creation.box(extents=(0.1, 0.1, 0.1))
    for _ in range(4):
        body = body.subdivide()
    vertices, faces = contract_short_edges(np.array(body.vertices), np.array(body.faces, np.int32), 0.02)
    result = trimesh.Trimesh(vertices, faces, process=False)
    assert len(faces) < 0.5 * len(body.faces)
    assert (np.abs(vertices[np.unique(faces)]).min(axis=1) == 0.05).sum() == 8
    assert result.volume == pytest.approx(1e-3, rel=0.03)


def test_a_torus_keeps_its_hole() -> None:
    """A torus keeps its genus when edges are contracted to nearly the tube's radius."""
    body = trimesh.creation.torus(0.1, 0.02, major_sections=120, minor_sections=40)
    vertices, faces = contract_short_edges(np.array(body.vertices), np.array(body.faces, np.int32), 0.015)
    assert len(np.unique(faces)) - len(faces) // 2 == 0
    assert len(faces) < len(body.faces) / 4
    assert trimesh.Trimesh(vertices, faces, process=False).is_watertight


def test_remeshing_removes_needles() -> None:
    """Remeshing a cylinder of needles gives compact faces and keeps the volume."""
    body = needles()
    vertices, faces = remesh(np.array(body.vertices), np.array(body.faces, np.int32), 0.01)
    corners = vertices[faces]
    sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    width = 2 * area / sides.max(axis=1)
    assert np.median(width / sides.max(axis=1)) > 0.3
    assert trimesh.Trimesh(vertices, faces, process=False).volume == pytest.approx(body.volume, rel=0.03)


@pytest.mark.parametrize("face_count", [100, 300, 930])
@pytest.mark.parametrize(
    "body",
    [needles(), trimesh.creation.annulus(0.02, 0.05, 0.1, sections=600)],
    ids=["cylinder", "tube"],
)
def test_a_cad_mesh_of_needles_reaches_its_count(body: trimesh.Trimesh, face_count: int) -> None:
    """A CAD mesh of needles reaches the requested count, although edge collapse alone stops early."""
    planning = decimate(TriangleMesh(body.vertices, body.faces), face_count)
    assert abs(len(planning.faces) - face_count) <= 2 + 0.02 * face_count
    result = trimesh.Trimesh(planning.vertices, planning.faces, process=False)
    assert result.area == pytest.approx(body.area, rel=0.03)
    assert result.is_winding_consistent


def test_the_result_is_the_same_every_time() -> None:
    """Repeated decimation is bit-equal, since ties are resolved by a fixed seed."""
    body = TriangleMesh(needles().vertices, needles().faces)
    assert decimate(body, 200).vertices.tobytes() == decimate(body, 200).vertices.tobytes()
