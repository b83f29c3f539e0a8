"""Mesh, decimation and samples: exact statements on closed-form shapes."""

import threading

import numpy as np
import pytest
import trimesh

from planner.errors import PlannerError
from planner.geometry.decimation import decimate
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import face_features, sample


def sphere(subdivisions: int = 4, radius: float = 0.1) -> TriangleMesh:
    """An icosphere [m]."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return TriangleMesh(ball.vertices, ball.faces)


def box(x: float = 0.1, y: float = 0.2, z: float = 0.3) -> TriangleMesh:
    """A box of twelve faces about the origin [m]."""
    body = trimesh.creation.box(extents=(x, y, z))
    return TriangleMesh(body.vertices, body.faces)


def with_zero_area_faces(mesh: TriangleMesh) -> TriangleMesh:
    """The mesh with a degenerate face before, between and after its own."""
    first, *_, last = mesh.faces
    slivers = [[first[0], first[0], first[1]], [last[0], last[1], last[1]], [last[2], last[2], last[2]]]
    half = len(mesh.faces) // 2
    return TriangleMesh(
        mesh.vertices, np.vstack([[slivers[0]], mesh.faces[:half], [slivers[1]], mesh.faces[half:], [slivers[2]]])
    )


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
    """TriangleMesh names what is wrong and what would be valid."""
    with pytest.raises(PlannerError, match=message):
        TriangleMesh(vertices, faces)  # type: ignore[arg-type]


def test_decimation_hits_the_count_and_keeps_the_shape() -> None:
    """A sphere of 5120 faces becomes a closed one of exactly 930 within 1 % of its volume, outward, manifold."""
    fine = sphere()
    coarse = decimate(fine, 930)
    assert len(coarse.faces) == 930
    result = trimesh.Trimesh(coarse.vertices, coarse.faces, process=False)
    assert result.is_watertight
    assert result.is_winding_consistent
    assert result.volume == pytest.approx(4 / 3 * np.pi * 0.1**3, rel=0.01)


def test_decimation_does_not_depend_on_the_unit() -> None:
    """A part in metres and the same numbers a thousand times larger or shifted give the same faces."""
    fine = sphere(3)
    coarse = decimate(fine, 300)
    larger = decimate(TriangleMesh(fine.vertices * 1024, fine.faces), 300)  # a power of two, so exactly
    assert (larger.faces == coarse.faces).all()
    assert larger.vertices == pytest.approx(coarse.vertices * 1024, rel=1e-12, abs=1e-12)


def test_decimation_of_a_mesh_that_is_coarse_already_only_cleans_it() -> None:
    """Asked for more faces than there are, the mesh comes back without its degenerate and repeated faces."""
    dirty = with_zero_area_faces(box())
    repeated = TriangleMesh(dirty.vertices, np.vstack([dirty.faces, dirty.faces[5:7, [1, 2, 0]]]))
    clean = decimate(repeated, 12)
    assert len(clean.faces) == 12
    assert clean.areas.sum() == pytest.approx(box().areas.sum(), rel=1e-12)
    assert trimesh.Trimesh(clean.vertices, clean.faces, process=False).is_watertight


def test_decimation_from_several_threads_is_that_from_one() -> None:
    """The library keeps its mesh in globals; our lock makes concurrent calls give what single ones give."""
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
    """A count below 1 is an error of the caller."""
    with pytest.raises(PlannerError, match="at least 1"):
        decimate(box(), 0)


def test_samples_never_lie_on_a_face_without_area() -> None:
    """Degenerate faces first, last and in the middle hold no sample, and every other face of a box holds its share."""
    mesh = with_zero_area_faces(box())
    samples = sample(mesh, box(), 6000, np.random.default_rng(1))
    held = np.bincount(samples.face, minlength=len(mesh.faces))
    areas = mesh.areas
    assert (held[areas == 0] == 0).all()
    assert np.abs(held - 6000 * areas / areas.sum()).max() <= 1.0 + 1e-9


def test_samples_are_tagged_with_the_planning_face_that_they_lie_on() -> None:
    """Where planning and reference mesh are the same box, the planning face is the face itself."""
    mesh = box()
    samples = sample(mesh, mesh, 5000, np.random.default_rng(2))
    points = np.repeat(samples.points, 12, axis=0)
    feet = trimesh.triangles.closest_point(np.tile(mesh.vertices[mesh.faces], (5000, 1, 1)), points)
    second = np.sort(np.linalg.norm(feet - points, axis=1).reshape(5000, 12), axis=1)[:, 1]
    clear = second > 1e-6  # off the diagonals and edges, where two faces are equally near
    assert clear.sum() > 4500
    assert (samples.planning_face[clear] == samples.face[clear]).all()


def test_the_two_sides_of_a_thin_wall_are_kept_apart() -> None:
    """On a plate of 0.1 mm, far thinner than a planning face, every sample's planning face looks its way."""
    plate = trimesh.creation.box(extents=(0.1, 0.1, 0.0001)).subdivide().subdivide().subdivide()
    reference = TriangleMesh(plate.vertices, plate.faces)
    planning = box(0.1, 0.1, 0.0002)
    samples = sample(reference, planning, 4000, np.random.default_rng(3))
    agreement = np.einsum("sj,sj->s", samples.normals, planning.normals[samples.planning_face])
    assert (agreement > 0.99).all()


def test_face_features_are_the_planning_faces() -> None:
    """One row per planning face: its centre, its normal, its area; the reference face is the one beneath."""
    fine = sphere()
    coarse = decimate(fine, 500)
    features = face_features(fine, coarse)
    assert len(features) == len(coarse.faces)
    assert (features.planning_face == np.arange(len(coarse.faces))).all()
    assert features.areas.sum() == pytest.approx(coarse.areas.sum(), rel=1e-12)
    direction = features.points / np.linalg.norm(features.points, axis=1, keepdims=True)
    below = fine.centres[features.face]
    below /= np.linalg.norm(below, axis=1, keepdims=True)
    assert np.arccos(np.clip(np.einsum("fj,fj->f", direction, below), -1, 1)).max() < np.deg2rad(4)


def test_the_same_seed_gives_the_same_bytes() -> None:
    """Samples depend on the generator's state alone."""
    fine = sphere(3)
    coarse = decimate(fine, 200)
    one, two, other = (sample(fine, coarse, 1000, np.random.default_rng(seed)) for seed in (5, 5, 6))
    assert one.points.tobytes() == two.points.tobytes()
    assert one.planning_face.tobytes() == two.planning_face.tobytes()
    assert one.points.tobytes() != other.points.tobytes()


@pytest.mark.parametrize("count", [0, -3])
def test_no_samples_is_refused(count: int) -> None:
    """A count below 1 is an error of the caller."""
    with pytest.raises(PlannerError, match="at least 1 sample"):
        sample(box(), box(), count, np.random.default_rng(0))


def test_a_surface_without_area_is_refused() -> None:
    """Only degenerate faces: there is nothing to sample, and the sentence says so."""
    flat = TriangleMesh(np.zeros((3, 3)), [[0, 1, 2]])  # type: ignore[arg-type]
    with pytest.raises(PlannerError, match="no area"):
        sample(flat, flat, 10, np.random.default_rng(0))


def test_a_mesh_of_few_large_faces_is_split_on_its_surface() -> None:
    """A box of 12 triangles asked for 1000 gives about so many, all on the box, with its area and closed."""
    mesh = box()
    planning = decimate(mesh, 1000)
    assert 500 < len(planning.faces) < 1500
    assert planning.areas.sum() == pytest.approx(mesh.areas.sum(), rel=1e-12)
    assert trimesh.Trimesh(planning.vertices, planning.faces, process=False).is_watertight
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    centres = planning.centres
    assert (np.isclose(centres, low, atol=1e-12) | np.isclose(centres, high, atol=1e-12)).any(axis=1).all()
