"""Cutting a mesh along a plane: the same surface, closed as before, no triangle on both sides."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from planner.geometry.mesh import TriangleMesh, cut, faces_within


def ball() -> TriangleMesh:
    """A closed mesh with vertices on the planes through its middle."""
    made = trimesh.creation.icosphere(subdivisions=2)
    return TriangleMesh(made.vertices, made.faces)


@given(st.lists(st.tuples(st.integers(0, 2), st.sampled_from([-0.7, -0.2, 0.0, 0.1, 0.85, 2.0])), max_size=4))
def test_cuts_leave_the_surface_as_it_was(planes: list[tuple[int, float]]) -> None:
    """Area of each triangle, closedness and winding stay; nothing crosses a plane; parents are told truly."""
    mesh = ball()
    parent = np.arange(len(mesh.faces))
    pieces = mesh
    for axis, at in planes:
        pieces, own = cut(pieces, axis, at)
        parent = parent[own]
    made = trimesh.Trimesh(pieces.vertices, pieces.faces, process=False)
    assert made.is_watertight
    assert made.is_winding_consistent
    assert np.bincount(parent, pieces.areas, len(mesh.faces)) == pytest.approx(mesh.areas, rel=1e-9)
    assert np.einsum("fj,fj->f", pieces.normals, mesh.normals[parent]) == pytest.approx(1.0)
    for axis, at in planes:
        off = pieces.vertices[pieces.faces][..., axis] - at
        assert not ((off.min(axis=1) < -1e-8) & (off.max(axis=1) > 1e-8)).any()
    assert (pieces.vertices[: len(mesh.vertices)] == mesh.vertices).all()


def test_a_box_of_a_cut_block_has_its_exact_area() -> None:
    """Twelve triangles, cut along a box: the piece of the top that lies in it has its closed-form area."""
    made = trimesh.creation.box((2.0, 2.0, 2.0))
    mesh = TriangleMesh(made.vertices, made.faces)
    low, high = np.array([-0.5, -0.25, 0.5]), np.array([0.7, 0.25, 1.5])
    for k, at in enumerate((*low, *high)):
        mesh, _ = cut(mesh, k % 3, float(at))
    assert mesh.areas[faces_within(mesh, low, high)].sum() == pytest.approx(1.2 * 0.5)
