"""Properties of distances and samples over random triangles."""

import numpy as np
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.geometry.closest import closest_facing_faces
from planner.geometry.decimation import decimate
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import draw_samples


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=settings.default.max_examples // 4)
def test_the_closest_face_is_the_closest_that_looks_the_same_way(seed: int) -> None:
    """At most 2 % of the faces are not the nearest with the same facing, and those by less than a face's size."""
    rng = np.random.default_rng(seed)
    ball = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
    radius = 1 + 0.3 * np.sin(ball.vertices @ rng.normal(size=3) * 3 + rng.random())
    mesh = TriangleMesh(ball.vertices * radius[:, None] * rng.uniform(0.3, 1, 3), ball.faces)
    planning = decimate(mesh, 250)
    samples = draw_samples(mesh, planning, 400, rng)
    triangles, count = planning.vertices[planning.faces], len(planning.faces)
    faces = closest_facing_faces(samples.points, samples.normals, planning)
    points = np.repeat(samples.points, count, axis=0)
    feet = trimesh.triangles.closest_point(np.tile(triangles, (400, 1, 1)), points)
    distance = np.linalg.norm(feet - points, axis=1).reshape(400, count)
    agreeing = np.where(samples.normals @ planning.normals.T > 0, distance, np.inf)
    excess = agreeing[np.arange(400), faces] - agreeing.min(axis=1)
    assert np.isfinite(excess).all()
    assert (excess > 1e-9).mean() <= 0.02
    assert excess.max() < np.sqrt(planning.areas.mean())


@given(st.integers(1, 3000), st.integers(0, 2**32 - 1))
def test_samples_lie_on_their_faces_and_share_the_area(count: int, seed: int) -> None:
    """Each sample lies on its reference face, carries that face's normal and an equal part of the whole area."""
    body = trimesh.creation.capsule(height=1.0, radius=0.2, count=(12, 12))
    mesh = TriangleMesh(body.vertices, body.faces)
    samples = draw_samples(mesh, mesh, count, np.random.default_rng(seed))
    assert len(samples) == count
    feet = trimesh.triangles.closest_point(mesh.vertices[mesh.faces[samples.face]], samples.points)
    assert np.abs(feet - samples.points).max() < 1e-12
    assert (samples.normals == mesh.normals[samples.face]).all()
    assert np.isclose(samples.areas.sum(), body.area, rtol=1e-9)
    assert np.ptp(samples.areas) == 0


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=settings.default.max_examples // 4)
def test_stratified_samples_estimate_an_area_better_than_independent_ones(seed: int) -> None:
    """The share of samples in a cap of a sphere is within a third of the independent samples' 3-sigma band."""
    rng = np.random.default_rng(seed)
    ball = trimesh.creation.icosphere(subdivisions=5)
    mesh = TriangleMesh(ball.vertices, ball.faces)
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    height = rng.uniform(-0.8, 0.8)
    samples = draw_samples(mesh, decimate(mesh, 100), 4000, rng)
    share = (samples.points @ direction > height).mean()
    truth = (1 - height) / 2  # Archimedes: a cap's area is proportional to its height
    assert abs(share - truth) < np.sqrt(truth * (1 - truth) / 4000)
