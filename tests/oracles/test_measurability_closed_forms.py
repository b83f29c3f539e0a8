"""Measurability and scans compared with formulas: visible cap of a sphere, shadow of a wall, a convex body."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from cell.scanners.laser_area import LaserArea
from cell.world.embree import EmbreeRayCaster
from cell.world.virtual_scan import scan
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples, draw_samples
from planner.measurability.visibility import find_measured

RADIUS = 0.1


def _convex(points):
    """Return the convex hull of points, turned outward."""
    hull = ConvexHull(points)
    corners = points[hull.simplices]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flip = np.einsum("ij,ij->i", normals, hull.equations[:, :3]) < 0
    faces = hull.simplices.copy()
    faces[flip] = faces[flip][:, ::-1]
    return TriangleMesh(points, faces)


def _sphere(count):
    """Return a sphere from points on a golden spiral."""
    z = 1 - (2 * np.arange(count) + 1) / count
    angle = np.pi * (3 - np.sqrt(5)) * np.arange(count)
    ring = np.sqrt(1 - z**2)
    return _convex(RADIUS * np.column_stack([ring * np.cos(angle), ring * np.sin(angle), z]))


@pytest.fixture(scope="module")
def sphere():
    """Return a sphere of 8000 vertices, its caster and 40,000 samples."""
    mesh = _sphere(8000)
    return mesh, EmbreeRayCaster(mesh.vertices, mesh.faces), draw_samples(mesh, mesh, 40_000, np.random.default_rng(0))


def _looking_down_from(height, x=0.0):
    return np.array([[1.0, 0, 0, x], [0, -1, 0, 0], [0, 0, -1, height], [0, 0, 0, 1]])


@pytest.mark.parametrize("grazing", [90, 75, 60, 30])
@pytest.mark.parametrize("distance", [0.15, 0.4, 2.0])
def test_the_share_of_a_sphere_that_is_measured_is_the_cap_of_the_grazing_limit(sphere, distance, grazing):
    """From distance D the grazing angle g is reached at the polar angle g - asin(r sin g / D) of the sphere."""
    _, caster, samples = sphere
    scanner = LaserArea((175, 175), (5, 5), (0, 5000), 0, grazing)
    share = find_measured(_looking_down_from(distance)[None, None], samples, scanner, [caster]).mean()
    g = np.radians(grazing)
    cap = (1 - np.cos(g - np.arcsin(RADIUS * np.sin(g) / distance))) / 2
    assert share == pytest.approx(cap, abs=0.003)  # facets of 1.5 degrees


def test_source_and_sensor_on_opposite_sides_share_the_intersection_of_their_caps(sphere):
    """Both lines of sight within 90 degrees: a point must lie above both horizons, n . position >= radius."""
    _, caster, samples = sphere
    scanner = LaserArea((175, 175), (5, 5), (0, 5000), 300, 90, 90)
    T = _looking_down_from(0.25, x=-0.15)
    found = find_measured(T[None, None], samples, scanner, [caster])
    height = np.einsum("ij,ij->i", samples.normals, samples.points)
    expected = np.ones(len(samples), dtype=bool)
    for x in (-0.15, 0.15):
        expected &= samples.normals @ [x, 0, 0.25] >= height
    assert (found == expected).mean() > 0.9995
    assert 0.05 < expected.mean() < 0.3


def test_no_leg_to_a_convex_body_is_blocked_by_it(sphere):
    """No false shadow among 160,000 rays at any grazing angle below 90 degrees, near and far."""
    _, caster, samples = sphere
    for height in (0.12, 0.3, 3.0):
        scanner = LaserArea((179, 179), (5, 5), (0, 5000), 80, 90, 90)
        T = _looking_down_from(height)
        local = (samples.points - T[:3, 3]) @ T[:3, :3]
        passes = scanner.reject(local, samples.normals @ T[:3, :3]) == 0
        found = find_measured(T[None, None], samples, scanner, [caster])
        assert passes.sum() > 1000
        assert (found == passes).all()


def _plate_and_wall():
    """Return a plate at z = 0 and a thin wall, 40 mm high, that faces -x at x = 30 mm."""
    plate = [[-0.2, -0.2, 0], [0.2, -0.2, 0], [0.2, 0.2, 0], [-0.2, 0.2, 0]]
    wall = [[0.03, -0.2, 0], [0.03, 0.2, 0], [0.03, 0.2, 0.04], [0.03, -0.2, 0.04]]
    return TriangleMesh(np.array(plate + wall), [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])


def _on_plate(x):
    points = np.column_stack([x, np.linspace(-0.05, 0.05, len(x)), np.zeros_like(x)])
    n = len(x)
    return SurfaceSamples(points, np.tile([0, 0, 1.0], (n, 1)), np.ones(n), np.zeros(n), np.zeros(n))


@pytest.mark.parametrize("baseline", [0.0, 0.075, 0.12])
def test_a_wall_throws_the_shadows_of_source_and_sensor(baseline):
    """Similar triangles give the end of each shadow on the plate."""
    mesh = _plate_and_wall()
    caster = EmbreeRayCaster(mesh.vertices, mesh.faces)
    scanner = LaserArea((80, 80), (0.25, 0.25), (100, 600), 1000 * baseline)
    z, h, w = 0.3, 0.04, 0.03
    source_end = w * z / (z - h)
    sensor_start = min((w * z - baseline * h) / (z - h), w) if baseline > w else w
    x = np.setdiff1d(np.linspace(-0.15, 0.15, 30_001), [w])
    found = find_measured(_looking_down_from(z)[None, None], _on_plate(x), scanner, [caster])
    expected = (x < sensor_start) | (x > source_end)
    clear = (np.abs(x - sensor_start) > 2e-6) & (np.abs(x - source_end) > 2e-6) & (np.abs(x - w) > 2e-6)
    assert (found == expected)[clear].all()
    assert (~expected).any()

    result = scan(scanner, _looking_down_from(z), caster, mesh)
    on_plate = result.points[:, 2] < 1e-6
    x_scan = result.points[on_plate, 0]
    in_shadow = (x_scan > sensor_start + 2e-6) & (x_scan < source_end - 2e-6)
    assert not in_shadow.any()
    pitch = z * np.radians(0.25) * 1.3
    assert x_scan[x_scan < w].max() == pytest.approx(sensor_start, abs=pitch)
    assert x_scan[x_scan > w].min() == pytest.approx(source_end, abs=pitch)


def test_every_point_of_a_scan_is_measured_by_aiming_at_it(sphere):
    """The points of a scan are visible; the two methods agree point by point."""
    mesh, caster, _ = sphere
    scanner = LaserArea((60, 60), (1, 1), (50, 1000), 100)
    T = _looking_down_from(0.35)
    result = scan(scanner, T, caster, mesh)
    corners = mesh.vertices[mesh.faces[result.face]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    n = len(result.points)
    features = SurfaceSamples(result.points, normals, np.ones(n), result.face, result.face)
    assert n > 500
    assert find_measured(T[None, None], features, scanner, [caster]).all()
