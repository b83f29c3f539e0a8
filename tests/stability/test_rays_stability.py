"""Difficult cases by name: where float32, exact limits and odd meshes break ray casters."""

import numpy as np
import pytest

from cell.scanners.laser_area import LaserArea
from cell.world.virtual_scan import scan
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples, draw_samples
from planner.measurability.visibility import fill_matrix, find_measured
from planner.viewpoints.viewpoints import Viewpoints, optimal_scanning_zone
from tests.support.meshes import block, caster_of


def _pose(position, towards):
    """Return a pose at a position, aimed at a point."""
    z = np.asarray(towards, float) - position
    z /= np.linalg.norm(z)
    x = np.cross([0.0, 1, 0.1], z)
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, 0], T[:3, 1], T[:3, 2], T[:3, 3] = x, np.cross(z, x), z, position
    return T


def _grid_plate(n, size):
    """Return a flat plate of 2 n^2 coplanar triangles at z = 0."""
    u, v = np.meshgrid(np.linspace(-0.5, 0.5, n + 1) * size, np.linspace(-0.5, 0.5, n + 1) * size, indexing="ij")
    number = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = (number[i : i + n, j : j + n].ravel() for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)))
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    return TriangleMesh(np.column_stack([u.ravel(), v.ravel(), 0 * u.ravel()]), faces)


WIDE = LaserArea((179, 179), (5, 5), (0, 20_000), 50, 90, 90)
ONE_EYE = LaserArea((179, 179), (5, 5), (0, 20_000), 0, 90, 90)


def test_coplanar_neighbours_do_not_occlude_each_other():
    """Every sample of a flat plate, on edges and vertices too, is measured from low and from high above it."""
    plate = _grid_plate(20, 0.2)
    caster = caster_of(plate)
    on_vertices = plate.vertices[(np.abs(plate.vertices[:, :2]) < 0.0999).all(axis=1)]
    points = np.concatenate([on_vertices, (on_vertices[1:] + on_vertices[:-1]) / 2])
    n = len(points)
    features = SurfaceSamples(points, np.tile([0, 0, 1.0], (n, 1)), np.ones(n), np.zeros(n), np.zeros(n))
    for position in ([0.01, 0.02, 0.3], [0.25, 0.01, 0.002], [-0.3, 0.2, 0.0002]):
        assert find_measured(_pose(position, [0, 0, 0])[None, None], features, ONE_EYE, [caster]).all()


@pytest.mark.parametrize("thickness", [1e-3, 1e-5, 2e-6])
def test_a_thin_wall_is_opaque_and_its_front_is_seen(thickness):
    """Down to 2 um on a part of 0.3 m: the front is measured from the front, the back from the back only."""
    wall = block((0.3, 0.3, thickness))
    caster = caster_of(wall)
    features = draw_samples(wall, wall, 2000, np.random.default_rng(0))
    inner = np.abs(features.normals[:, 2]) > 0.9
    for side in (1, -1):
        seen = find_measured(_pose([0.02, 0.01, 0.3 * side], [0, 0, 0])[None, None], features, WIDE, [caster])
        assert (seen == (features.normals[:, 2] * side > 0.9))[inner].all()
        origins = np.tile([0.02, 0.01, 0.3 * side], (2000, 1))
        behind = features.points - [0, 0, 2 * thickness * side]
        assert caster.blocked(origins, behind)[inner].all()


def test_faces_without_area_and_faces_that_repeat_change_nothing():
    """A cube with a needle, a point and every face twice is measured like the clean cube."""
    clean = block((0.1, 0.1, 0.1))
    vertices = np.vstack([clean.vertices, clean.vertices[0], (clean.vertices[0] + clean.vertices[1]) / 2])
    dirty = TriangleMesh(vertices, np.vstack([clean.faces, clean.faces, [[0, 0, 1], [0, 8, 0], [0, 9, 1]]]))
    features = draw_samples(clean, clean, 500, np.random.default_rng(0))
    views = optimal_scanning_zone(clean, [0.3], [0.4])
    scanner = LaserArea(resolution_deg=(2, 2))
    a = fill_matrix(views, features, scanner, caster_of(clean))
    b = fill_matrix(views, features, scanner, caster_of(dirty))
    assert (a.matrix().toarray() == b.matrix().toarray()).all()
    assert len(a.indices) > 0
    T = views.T_object_scanner[0, 0]
    assert (scan(scanner, T, caster_of(dirty), dirty).codes == scan(scanner, T, caster_of(clean), clean).codes).all()


@pytest.mark.parametrize("distance", [10.1, 1000.1])
def test_a_part_far_from_the_origin_is_measured_like_one_at_the_origin(distance):
    """The object frame may be 10 m away, or in geodetic coordinates."""
    shift = np.array([distance, -0.7 * distance, 0.3 * distance])
    part = block((0.1, 0.08, 0.06))
    far = TriangleMesh(part.vertices + shift, part.faces)
    features = draw_samples(part, part, 500, np.random.default_rng(0))
    moved = SurfaceSamples(features.points + shift, features.normals, features.areas, features.face, features.face)
    views = optimal_scanning_zone(part, [0.2], [0.1])
    T = np.array(views.T_object_scanner)
    T[..., :3, 3] += shift
    there = Viewpoints(T, views.face, views.standoff, views.roll)
    scanner = LaserArea(range_mm=(100, 300))
    a = fill_matrix(views, features, scanner, caster_of(part))
    b = fill_matrix(there, moved, scanner, caster_of(far))
    assert (a.matrix().toarray() == b.matrix().toarray()).all()
    near = scan(scanner, views.T_object_scanner[0, 0], caster_of(part), part)
    away = scan(scanner, T[0, 0], caster_of(far), far)
    assert (near.codes == away.codes).all()
    np.testing.assert_allclose(near.points + shift, away.points, atol=1e-9 + 1e-12 * distance)


@pytest.mark.parametrize("size", [0.009, 5.0])
def test_a_part_of_9_mm_and_one_of_5_m_are_measured_alike(size):
    """Part, scanner and standoff at another scale give the same matrix."""

    def matrix(scale):
        part = block(np.array([1.0, 0.8, 0.6]) * scale)
        features = draw_samples(part, part, 500, np.random.default_rng(0))
        views = optimal_scanning_zone(part, [2.0 * scale], [0.1])
        scanner = LaserArea((60, 60), (1, 1), (1000 * scale, 3000 * scale), 500 * scale)
        return fill_matrix(views, features, scanner, caster_of(part)).matrix().toarray()

    assert (matrix(size) == matrix(0.1)).all()
    assert matrix(size).any()
