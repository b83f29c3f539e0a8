"""Mesh, cuts and samples: exact statements on closed-form shapes."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from planner.errors import PlannerError
from planner.geometry.decimation import decimate
from planner.geometry.mesh import TriangleMesh, cut_at_plane, faces_in_box
from planner.geometry.sampling import draw_samples, samples_at_face_centres
from tests.support.meshes import box, sphere, with_zero_area_faces


def test_face_quantities_of_a_box_are_exact() -> None:
    """A box's faces have half its sides' areas, axis-parallel outward normals, and centres on its sides."""
    mesh = box()
    assert mesh.areas.sum() == pytest.approx(2 * (0.1 * 0.2 + 0.2 * 0.3 + 0.1 * 0.3), rel=1e-12)
    assert np.abs(mesh.normals).max(axis=1) == pytest.approx(1.0, abs=1e-12)
    outward = np.einsum("fj,fj->f", mesh.centres, mesh.normals)
    assert np.sort(outward) == pytest.approx(np.repeat([0.05, 0.1, 0.15], 4), abs=1e-12)


def test_a_face_without_area_has_normal_zero() -> None:
    """A degenerate face yields the zero vector and area 0, not NaN."""
    mesh = with_zero_area_faces(box())
    degenerate = mesh.areas == 0
    assert degenerate.sum() == 3
    assert (mesh.normals[degenerate] == 0).all()


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (np.zeros((3, 3)), np.zeros((0, 3)), "at least one face"),
        (np.zeros((3, 3)), [[0, 1, 3]], "valid are 0 to 2"),
        (np.zeros((3, 3)), [[0, 1, -1]], "valid are 0 to 2"),
        (np.full((3, 3), np.nan), [[0, 1, 2]], "NaN"),
        (np.full((3, 3), np.inf), [[0, 1, 2]], "infinity"),
        (np.zeros((3, 2)), [[0, 1, 2]], "vertices has shape"),
    ],
    ids=["no faces", "index too large", "index negative", "NaN", "infinity", "two columns"],
)
def test_a_broken_mesh_is_refused_with_its_reason(vertices: object, faces: object, message: str) -> None:
    """The message names the reason and the valid values."""
    with pytest.raises(PlannerError, match=message):
        TriangleMesh(vertices, faces)  # type: ignore[arg-type]


def test_samples_never_lie_on_a_face_without_area() -> None:
    """Degenerate faces first, last and in the middle hold no sample, and every other face of a box holds its share."""
    mesh = with_zero_area_faces(box())
    samples = draw_samples(mesh, box(), 6000, np.random.default_rng(1))
    counts = np.bincount(samples.face, minlength=len(mesh.faces))
    areas = mesh.areas
    assert (counts[areas == 0] == 0).all()
    assert np.abs(counts - 6000 * areas / areas.sum()).max() <= 1.0 + 1e-9


def test_samples_are_tagged_with_the_planning_face_that_they_lie_on() -> None:
    """With the same box as planning and reference mesh, the planning face is the face itself."""
    mesh = box()
    samples = draw_samples(mesh, mesh, 5000, np.random.default_rng(2))
    points = np.repeat(samples.points, 12, axis=0)
    feet = trimesh.triangles.closest_point(np.tile(mesh.vertices[mesh.faces], (5000, 1, 1)), points)
    second = np.sort(np.linalg.norm(feet - points, axis=1).reshape(5000, 12), axis=1)[:, 1]
    clear = second > 1e-6  # off the diagonals and edges, where two faces are equally near
    assert clear.sum() > 4500
    assert (samples.planning_face[clear] == samples.face[clear]).all()


def test_the_two_sides_of_a_thin_wall_are_kept_apart() -> None:
    """On a plate of 0.1 mm, far thinner than a planning face, the planning face of every sample has its side."""
    plate = trimesh.creation.box(extents=(0.1, 0.1, 0.0001)).subdivide().subdivide().subdivide()
    reference = TriangleMesh(plate.vertices, plate.faces)
    planning = box(0.1, 0.1, 0.0002)
    samples = draw_samples(reference, planning, 4000, np.random.default_rng(3))
    agreement = np.einsum("sj,sj->s", samples.normals, planning.normals[samples.planning_face])
    assert (agreement > 0.99).all()


def test_samples_at_face_centres_are_the_planning_faces() -> None:
    """Each planning face gives one row: its centre, its normal, its area and the reference face below it."""
    fine = sphere()
    coarse = decimate(fine, 500)
    samples = samples_at_face_centres(fine, coarse)
    assert len(samples) == len(coarse.faces)
    assert (samples.planning_face == np.arange(len(coarse.faces))).all()
    assert samples.areas.sum() == pytest.approx(coarse.areas.sum(), rel=1e-12)
    direction = samples.points / np.linalg.norm(samples.points, axis=1, keepdims=True)
    below = fine.centres[samples.face]
    below /= np.linalg.norm(below, axis=1, keepdims=True)
    assert np.arccos(np.clip(np.einsum("fj,fj->f", direction, below), -1, 1)).max() < np.deg2rad(4)


def test_the_same_seed_gives_the_same_bytes() -> None:
    """Samples depend on the state of the generator only."""
    fine = sphere(3)
    coarse = decimate(fine, 200)
    one, two, other = (draw_samples(fine, coarse, 1000, np.random.default_rng(seed)) for seed in (5, 5, 6))
    assert one.points.tobytes() == two.points.tobytes()
    assert one.planning_face.tobytes() == two.planning_face.tobytes()
    assert one.points.tobytes() != other.points.tobytes()


@pytest.mark.parametrize("count", [0, -3])
def test_no_samples_is_refused(count: int) -> None:
    """A count below 1 is refused."""
    with pytest.raises(PlannerError, match="at least 1 sample"):
        draw_samples(box(), box(), count, np.random.default_rng(0))


def test_a_surface_without_area_is_refused() -> None:
    """A mesh of degenerate faces only is refused, because it has no area to sample."""
    flat = TriangleMesh(np.zeros((3, 3)), [[0, 1, 2]])  # type: ignore[arg-type]
    with pytest.raises(PlannerError, match="no area"):
        draw_samples(flat, flat, 10, np.random.default_rng(0))


@given(st.lists(st.tuples(st.integers(0, 2), st.sampled_from([-0.7, -0.2, 0.0, 0.1, 0.85, 2.0])), max_size=4))
def test_cuts_leave_the_surface_as_it_was(planes: list[tuple[int, float]]) -> None:
    """Area, closedness and winding are unchanged, no triangle crosses a plane, and the parents are correct."""
    mesh = sphere(2, 1.0)
    parent = np.arange(len(mesh.faces))
    pieces = mesh
    for axis, at in planes:
        pieces, own = cut_at_plane(pieces, axis, at)
        parent = parent[own]
    cut_mesh = trimesh.Trimesh(pieces.vertices, pieces.faces, process=False)
    assert cut_mesh.is_watertight
    assert cut_mesh.is_winding_consistent
    assert np.bincount(parent, pieces.areas, len(mesh.faces)) == pytest.approx(mesh.areas, rel=1e-9)
    assert np.einsum("fj,fj->f", pieces.normals, mesh.normals[parent]) == pytest.approx(1.0)
    for axis, at in planes:
        off = pieces.vertices[pieces.faces][..., axis] - at
        assert not ((off.min(axis=1) < -1e-8) & (off.max(axis=1) > 1e-8)).any()
    assert (pieces.vertices[: len(mesh.vertices)] == mesh.vertices).all()


def test_a_box_of_a_cut_block_has_its_exact_area() -> None:
    """The part of the top inside a box has its closed-form area after twelve triangles are cut."""
    block = trimesh.creation.box((2.0, 2.0, 2.0))
    mesh = TriangleMesh(block.vertices, block.faces)
    low, high = np.array([-0.5, -0.25, 0.5]), np.array([0.7, 0.25, 1.5])
    for k, at in enumerate((*low, *high)):
        mesh, _ = cut_at_plane(mesh, k % 3, float(at))
    assert mesh.areas[faces_in_box(mesh, low, high)].sum() == pytest.approx(1.2 * 0.5)
