"""Contracting and splitting edges: the surface stays what it is."""

import numpy as np
import pytest
import trimesh

from planner.geometry.decimation import contract_short_edges, decimate, split_long_edges, stout
from planner.geometry.mesh import TriangleMesh


def needles() -> trimesh.Trimesh:
    """A CAD cylinder: 400 needles from end to end and 400 about the centre of each lid."""
    return trimesh.creation.cylinder(radius=0.03, height=0.25, sections=400)


def closed_ball() -> trimesh.Trimesh:
    """A ball of 5120 faces."""
    return trimesh.creation.icosphere(subdivisions=4, radius=0.1)


def as_mesh(vertices: np.ndarray, faces: np.ndarray) -> trimesh.Trimesh:
    """For measuring."""
    return trimesh.Trimesh(vertices, faces, process=False)


@pytest.mark.parametrize("limit", [0.2, 0.05, 0.02])
def test_splitting_changes_no_surface(limit: float) -> None:
    """Area, volume, closedness and winding stay; every pass shortens, in the end below the limit."""
    body = needles()
    vertices, faces = np.array(body.vertices), np.array(body.faces, np.int32)
    for _ in range(30):
        before = len(faces)
        vertices, faces = split_long_edges(vertices, faces, limit)
        if len(faces) == before:
            break
    result = as_mesh(vertices, faces)
    assert result.edges_unique_length.max() <= limit
    assert result.is_watertight
    assert result.is_winding_consistent
    assert result.area == pytest.approx(body.area, rel=1e-9)
    assert result.volume == pytest.approx(body.volume, rel=1e-9)
    assert (vertices[: len(body.vertices)] == body.vertices).all()


@pytest.mark.parametrize("limit", [0.002, 0.01, 0.02])
def test_contracting_keeps_the_topology(limit: float) -> None:
    """A ball stays a closed ball of one body, its genus and outward winding unchanged, and is coarser."""
    body = closed_ball()
    vertices, faces = contract_short_edges(np.array(body.vertices), np.array(body.faces, np.int32), limit)
    result = as_mesh(vertices, faces)
    assert result.is_watertight
    assert result.is_winding_consistent
    assert len(np.unique(faces)) - len(faces) // 2 == 2
    assert result.volume == pytest.approx(body.volume, rel=0.08)  # chords of 0.02 m and more in a ball of 0.1 m
    shorter = body.edges_unique_length.min() < limit
    assert (len(faces) < len(body.faces)) == shorter


def test_contracting_keeps_corners() -> None:
    """On a finely meshed box all eight corners stay, and little is cut off between them."""
    body = trimesh.creation.box(extents=(0.1, 0.1, 0.1))
    for _ in range(4):
        body = body.subdivide()
    vertices, faces = contract_short_edges(np.array(body.vertices), np.array(body.faces, np.int32), 0.02)
    result = as_mesh(vertices, faces)
    assert len(faces) < 0.5 * len(body.faces)
    assert (np.abs(vertices[np.unique(faces)]).min(axis=1) == 0.05).sum() == 8
    assert result.volume == pytest.approx(1e-3, rel=0.03)


def test_a_torus_keeps_its_hole() -> None:
    """The genus survives contraction to edges near the tube's radius."""
    body = trimesh.creation.torus(0.1, 0.02, major_sections=120, minor_sections=40)
    vertices, faces = contract_short_edges(np.array(body.vertices), np.array(body.faces, np.int32), 0.015)
    assert len(np.unique(faces)) - len(faces) // 2 == 0
    assert len(faces) < len(body.faces) / 4
    assert as_mesh(vertices, faces).is_watertight


def test_needles_become_stout() -> None:
    """Of the cylinder's needles (a hundredth as wide as long) none is left, and the shape is kept."""
    body = needles()
    vertices, faces = stout(np.array(body.vertices), np.array(body.faces, np.int32), 0.01)
    corners = vertices[faces]
    sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    width = 2 * area / sides.max(axis=1)
    assert np.median(width / sides.max(axis=1)) > 0.3
    assert as_mesh(vertices, faces).volume == pytest.approx(body.volume, rel=0.03)


@pytest.mark.parametrize("face_count", [100, 300, 930])
@pytest.mark.parametrize(
    "body",
    [needles(), trimesh.creation.annulus(0.02, 0.05, 0.1, sections=600)],
    ids=["cylinder", "tube"],
)
def test_a_cad_mesh_of_needles_reaches_its_count(body: trimesh.Trimesh, face_count: int) -> None:
    """Where the collapse alone gets stuck at the start, the planning mesh has the count that was asked for."""
    planning = decimate(TriangleMesh(body.vertices, body.faces), face_count)
    assert abs(len(planning.faces) - face_count) <= 2 + 0.02 * face_count
    result = as_mesh(planning.vertices, planning.faces)
    assert result.area == pytest.approx(body.area, rel=0.03)
    assert result.is_winding_consistent


def test_the_result_is_the_same_every_time() -> None:
    """Ties are broken by a fixed seed."""
    body = TriangleMesh(needles().vertices, needles().faces)
    assert decimate(body, 200).vertices.tobytes() == decimate(body, 200).vertices.tobytes()
