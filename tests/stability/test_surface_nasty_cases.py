"""Nasty meshes by name: guarantees of decimation, sampling and viewpoints where such methods tend to fail."""

from collections.abc import Callable

import numpy as np
import pytest
import trimesh

from planner.geometry.decimation import decimate
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import draw_samples, samples_at_face_centres
from planner.viewpoints.viewpoints import optimal_scanning_zone

_SAMPLES = 300


def sliver_cylinder() -> trimesh.Trimesh:
    """Return a CAD cylinder of 400 faces from end to end, each 500 times longer than wide."""
    return trimesh.creation.cylinder(radius=0.03, height=0.25, sections=400)


def thin_plate() -> trimesh.Trimesh:
    """Return a plate 0.3 m square and 0.2 mm thick, finely meshed."""
    plate = trimesh.creation.box(extents=(0.3, 0.3, 0.0002))
    for _ in range(5):
        plate = plate.subdivide()
    return plate


def needle() -> trimesh.Trimesh:
    """Return a needle 0.3 m long and 0.4 mm thick."""
    return trimesh.creation.capsule(height=0.3, radius=0.0002, count=(32, 32))


def far_away() -> trimesh.Trimesh:
    """Return a part drawn 50 m from its file's origin."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.1)
    return ball.apply_translation([50.0, -50.0, 20.0])


def microscopic() -> trimesh.Trimesh:
    """Return a part of 20 um, as with confused units."""
    return trimesh.creation.icosphere(subdivisions=4, radius=1e-5)


def enormous() -> trimesh.Trimesh:
    """Return a part of 200 m."""
    return trimesh.creation.icosphere(subdivisions=4, radius=100.0)


def dust() -> trimesh.Trimesh:
    """Return a ball among 60 crumbs of 80 faces each."""
    rng = np.random.default_rng(0)
    crumbs = [trimesh.creation.icosphere(subdivisions=1, radius=0.002) for _ in range(60)]
    for crumb in crumbs:
        crumb.apply_translation(0.2 * rng.normal(size=3))
    return trimesh.util.concatenate([trimesh.creation.icosphere(subdivisions=4, radius=0.1), *crumbs])


def open_bowl() -> trimesh.Trimesh:
    """Return half a sphere without thickness."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.1)
    return trimesh.Trimesh(ball.vertices, ball.faces[ball.triangles_center[:, 2] < 0], process=False)


def touching_cubes() -> trimesh.Trimesh:
    """Return two cubes that share an edge of four faces."""
    cubes = [trimesh.creation.box(extents=(0.1, 0.1, 0.1)) for _ in range(2)]
    cubes[1].apply_translation([0.1, 0.1, 0.0])
    both = trimesh.util.concatenate(cubes)
    both.merge_vertices()
    for _ in range(4):
        both = both.subdivide()
    return both


def one_triangle() -> trimesh.Trimesh:
    """Return the smallest surface."""
    return trimesh.Trimesh([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]], [[0, 1, 2]], process=False)


def huge_beside_tiny() -> trimesh.Trimesh:
    """Return two triangles of 1 m and 5120 of 0.1 mm."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.002).apply_translation([0.5, 0.5, 0.1])
    floor = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]], process=False)
    return trimesh.util.concatenate([floor, ball])


CASES: list[Callable[[], trimesh.Trimesh]] = [
    sliver_cylinder,
    thin_plate,
    needle,
    far_away,
    microscopic,
    enormous,
    dust,
    open_bowl,
    touching_cubes,
    one_triangle,
    huge_beside_tiny,
]


def _distance(points: np.ndarray, triangles: np.ndarray, extent: float) -> np.ndarray:
    """Return the distance of each point to one triangle, at size 1000 because trimesh has absolute tolerances."""
    scale = 1000 / extent
    return np.linalg.norm(trimesh.triangles.closest_point(scale * triangles, scale * points) / scale - points, axis=1)


@pytest.mark.parametrize("face_count", [30, 300])
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.__name__)
def test_guarantees_hold_on_nasty_meshes(case: Callable[[], trimesh.Trimesh], face_count: int) -> None:
    """For any mesh: the planning mesh is clean, samples are on the surface, faces are near, poses are rotations."""
    body = case()
    reference = TriangleMesh(body.vertices, body.faces)
    planning = decimate(reference, face_count)
    areas = planning.areas
    assert 1 <= len(planning.faces) <= max(2 * face_count, len(reference.faces))  # a coarse mesh is split by halves
    assert (areas > 0).all()
    assert len(np.unique(np.sort(planning.faces, axis=1), axis=0)) == len(planning.faces)
    assert len(np.unique(planning.faces)) == len(planning.vertices)
    extent = float(np.linalg.norm(np.ptp(reference.vertices, axis=0)))
    low, high = reference.vertices.min(axis=0), reference.vertices.max(axis=0)
    assert (planning.vertices > low - 0.1 * extent).all()
    assert (planning.vertices < high + 0.1 * extent).all()

    samples = draw_samples(reference, planning, _SAMPLES, np.random.default_rng(1))
    distance = _distance(samples.points, reference.vertices[reference.faces[samples.face]], extent)
    assert distance.max() < 1e-9 * (extent + np.abs(reference.vertices).max())
    assert samples.areas.sum() == pytest.approx(body.area, rel=1e-9)
    points = np.repeat(samples.points, len(planning.faces), axis=0)
    to_all = _distance(points, np.tile(planning.vertices[planning.faces], (_SAMPLES, 1, 1)), extent).reshape(
        _SAMPLES, -1
    )
    same_side = samples.normals @ planning.normals.T > 0
    nearest = np.where(same_side, to_all, np.inf).min(axis=1)
    distances = to_all[np.arange(_SAMPLES), samples.planning_face]
    comparable = np.isfinite(nearest)
    assert (distances[comparable] - nearest[comparable] < 0.05 * extent).all()

    samples_at_centres = samples_at_face_centres(reference, planning)
    assert ((samples_at_centres.face >= 0) & (samples_at_centres.face < len(reference.faces))).all()
    viewpoints = optimal_scanning_zone(planning, [3 * extent], [0.0, 1.0])
    R = viewpoints.T_object_scanner[:, 0, :3, :3]
    assert len(viewpoints) == 2 * len(planning.faces)
    assert np.abs(np.einsum("vji,vjk->vik", R, R) - np.eye(3)).max() < 1e-12
    assert np.abs(np.linalg.det(R) - 1).max() < 1e-12


@pytest.mark.parametrize("case", [far_away, microscopic, enormous], ids=lambda case: case.__name__)
def test_place_and_size_do_not_change_the_decimation(case: Callable[[], trimesh.Trimesh]) -> None:
    """A ball is decimated to the count and stays a closed ball, wherever and however large it is."""
    body = case()
    planning = decimate(TriangleMesh(body.vertices, body.faces), 300)
    result = trimesh.Trimesh(planning.vertices - body.centroid, planning.faces, process=False)
    assert len(planning.faces) == 300
    assert result.is_watertight
    assert result.volume == pytest.approx(body.copy().apply_translation(-body.centroid).volume, rel=0.03)
