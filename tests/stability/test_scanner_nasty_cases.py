"""Difficult scanners, by name: each case has a defined result and no warning."""

import numpy as np
import pytest
import trimesh

from cell.errors import SceneError
from cell.scanners.laser_area import LaserArea
from cell.world import virtual_scan
from cell.world.embree import EmbreeRayCaster
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples
from planner.measurability.visibility import find_measured
from planner.ports import Rejection

BACK = np.array([[0.0, 0.0, -1.0]])
AHEAD = np.array([[0.0, 0.0, 0.3]])
BALL = trimesh.creation.icosphere(3, 0.05)
PART = TriangleMesh(BALL.vertices, BALL.faces)


def _in_front(distance: float) -> np.ndarray:
    """Return T_object_scanner of a scanner that is aimed at the ball's middle along +z."""
    T = np.eye(4)
    T[2, 3] = -distance
    return T


def _scan(scanner: LaserArea, distance: float) -> virtual_scan.Scan:
    return virtual_scan.scan(scanner, _in_front(distance), EmbreeRayCaster(PART.vertices, PART.faces), PART)


def test_baseline_0_has_no_shadow_and_no_sigma():
    """Source and sensor coincide, so no ray is shadowed, no point has a sigma, and model noise is refused."""
    scanner = LaserArea(baseline_mm=0, resolution_deg=(1, 1), sensor_fov_deg=(60, 60))
    scan = _scan(scanner, 0.3)
    assert scan.counts()[Rejection.SENSOR_BLOCKED] == 0
    assert len(scan.points) > 50
    assert np.isinf(scanner.sigma(AHEAD, BACK)).all()
    with pytest.raises(SceneError, match="baseline of 0"):
        scan.sigma(scanner, PART)


def test_baseline_longer_than_the_standoff():
    """At five standoffs the sensor sees the side of the ball: both must see a measured point; sigma is finite."""
    scanner = LaserArea(baseline_mm=1500, resolution_deg=(1, 1))
    scan = _scan(scanner, 0.3)
    normals = scan.points / np.linalg.norm(scan.points, axis=1, keepdims=True)
    sensor = np.array([1.5, 0, -0.3])
    assert len(scan.points) > 20
    assert (
        np.einsum("ij,ij->i", normals, sensor - scan.points) > -0.1
    ).all()  # facets: 4 degrees of the sphere at 1.5 m
    assert scan.counts()[Rejection.GRAZING_SENSOR] > 20
    assert np.isfinite(scan.sigma(scanner, PART)).all()
    assert scanner.sigma(AHEAD, np.array([[0.7, 0, -0.7]]))[0] > 0


def test_sensor_inside_the_part_sees_nothing():
    """Every reflected ray leaves through the surface from inside."""
    scanner = LaserArea(baseline_mm=30, range_mm=(5, 600), resolution_deg=(2, 2), grazing_max_deg=90)
    T = np.eye(4)
    T[:3, 3] = [-0.051, 0, 0]  # the source just outside, the sensor 21 mm deep in the ball
    T[:3, :3] = np.eye(3)
    scan = virtual_scan.scan(scanner, T, EmbreeRayCaster(PART.vertices, PART.faces), PART)
    assert len(scan.points) == 0


def test_source_and_sensor_inside_the_part_see_its_inside_as_grazing():
    """From inside, every normal points away."""
    scan = _scan(LaserArea(baseline_mm=10, range_mm=(1, 600), resolution_deg=(2, 2)), 0.0)
    assert len(scan.points) == 0
    assert scan.counts()[Rejection.GRAZING_SOURCE] == scan.codes.size


def test_grazing_limit_0_accepts_only_a_surface_that_faces_the_source():
    """With a baseline and a limit of 0 for the sensor too, no point is measured."""
    facing, tilted = BACK, np.array([[np.sin(0.01), 0.0, -np.cos(0.01)]])
    scanner = LaserArea(grazing_max_deg=0)
    assert scanner.reject(AHEAD, facing)[0] == Rejection.MEASURED
    assert scanner.reject(AHEAD, tilted)[0] == Rejection.GRAZING_SOURCE
    both = LaserArea(grazing_max_deg=0, sensor_grazing_max_deg=0)
    assert both.reject(AHEAD, facing)[0] == Rejection.GRAZING_SENSOR


def test_grazing_limit_90_accepts_an_edge_on_surface():
    """The limit is inclusive; sigma is infinite there, so a limit on sigma rejects the point."""
    edge_on = np.array([[0.0, 1.0, 0.0]])
    scanner = LaserArea(grazing_max_deg=90)
    assert scanner.reject(AHEAD, edge_on)[0] == Rejection.MEASURED
    assert np.isinf(scanner.sigma(AHEAD, edge_on)).all()


def test_fov_of_179_degrees_for_source_and_sensor():
    """Points almost at the side of the scanner are measured, and points behind it are not."""
    scanner = LaserArea(fov_deg=(179, 179), sensor_fov_deg=(179, 179), sensor_tilt_deg=0, resolution_deg=(179, 179))
    beside = np.array([[0.29, 0.0, 0.003], [0.29, 0.0, -0.003], [0.29, 0.0, 0.002]])
    towards = np.tile([-1.0, 0, 0], (3, 1))
    codes = scanner.reject(beside, towards)
    assert codes.tolist() == [Rejection.MEASURED, Rejection.OUT_OF_FOV, Rejection.OUT_OF_FOV]


def test_one_ray():
    """A grid of one ray scans the point straight ahead and gives it one sigma."""
    scanner = LaserArea(fov_deg=(1, 1), resolution_deg=(1, 1))
    scan = _scan(scanner, 0.3)
    assert scan.grid_shape == (1, 1)
    np.testing.assert_allclose(scan.points, [[0, 0, -0.05]], atol=1e-3)
    assert scan.sigma(scanner, PART).shape == (1,)


def test_no_point_has_no_sigma():
    """A scan without points has an empty sigma and raises no error."""
    scanner = LaserArea(fov_deg=(1, 1), resolution_deg=(1, 1))
    away = _in_front(0.9) @ np.diag([1, -1, -1, 1.0])
    scan = virtual_scan.scan(scanner, away, EmbreeRayCaster(PART.vertices, PART.faces), PART)
    assert len(scan.points) == 0
    assert scan.sigma(scanner, PART).shape == (0,)


def test_points_on_the_scanner_itself():
    """The source, the sensor and points on the baseline have no direction: rejected, with an infinite sigma."""
    scanner = LaserArea(range_mm=(0, 450))
    points = np.array([[0, 0, 0], scanner.sensor, [0.03, 0, 0], [0.2, 0, 0]])
    normals = np.tile(BACK, (4, 1))
    assert (scanner.reject(points, normals) == Rejection.OUT_OF_FOV).all()
    assert np.isinf(scanner.sigma(points, normals)).all()


def test_a_fixture_on_the_part_hides_only_its_contact():
    """A plate on the pole of the ball hides the covered pole only."""
    plate = trimesh.creation.box((0.02, 0.02, 0.002))
    plate.apply_translation([0, 0, -0.05 - 0.001])
    casters = [EmbreeRayCaster(PART.vertices, PART.faces), EmbreeRayCaster(plate.vertices, plate.faces)]
    directions = np.array([[np.sin(a), 0, -np.cos(a)] for a in np.radians([0, 3, 30, 45])])
    points = directions * 0.0499  # slightly inside the sphere: on the mesh's side of the plate
    scanner = LaserArea(baseline_mm=20)
    face = np.zeros(4, dtype=np.int32)
    samples = SurfaceSamples(points, directions, np.full(4, 1e-4), face, face)
    T = _in_front(0.3)[None, None]
    bare = find_measured(T, samples, scanner, [])
    covered = find_measured(T, samples, scanner, casters[1:])
    assert bare.tolist() == [True] * 4
    assert covered.tolist() == [False, False, True, True]
