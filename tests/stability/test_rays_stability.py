"""Difficult cases by name: where float32, exact limits and odd meshes break ray casters."""

import numpy as np
import pytest

from cell.scanners.laser_area import LaserArea
from cell.world.virtual_scan import scan
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples, draw_samples
from planner.measurability.visibility import fill_matrix, find_measured
from planner.ports import Rejection
from planner.viewpoints.viewpoints import Viewpoints, optimal_scanning_zone
from tests.support.meshes import block, caster_of, joined


def _pose(position, towards):
    """Return a pose at a position, aimed at a point."""
    z = np.asarray(towards, float) - position
    z /= np.linalg.norm(z)
    x = np.cross([0.0, 1, 0.1], z)
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, 0], T[:3, 1], T[:3, 2], T[:3, 3] = x, np.cross(z, x), z, position
    return T


def _feature(point, normal):
    return SurfaceSamples(np.array([point], float), np.array([normal], float), [1], [0], [0])


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


@pytest.mark.parametrize("reach", [1.5, 30.0])
def test_a_ray_through_a_vertex_where_six_faces_meet_hits(reach):
    """At most 1 % of rays through vertices of a fine plate miss, as documented, and none through edges."""
    plate = _grid_plate(40, 0.2)
    caster = caster_of(plate)
    inner = plate.vertices[(np.abs(plate.vertices[:, :2]) < 0.09).all(axis=1)]
    source = np.array([0.013, 0.021, 0.1 * reach])
    for aims, lost in ((inner, 0.01), ((inner[1:] + inner[:-1]) / 2, 0.0)):
        legs = aims - source
        hits = caster.first_hit(np.tile(source, (len(aims), 1)), legs / np.linalg.norm(legs, axis=1, keepdims=True))
        assert (hits.face < 0).mean() <= lost


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


def test_a_field_of_view_of_179_degrees_sees_almost_the_half_space():
    """Points at 89.4 degrees are inside, at 89.6 degrees and behind the scanner outside."""
    normal = np.array([[0, 0, -1.0]])
    for degrees, code in ((89.4, Rejection.MEASURED), (89.6, Rejection.OUT_OF_FOV), (90.4, Rejection.OUT_OF_FOV)):
        angle = np.radians(degrees)
        point = np.array([[np.sin(angle), 0, np.cos(angle)]])
        assert WIDE.reject(point, normal if code == Rejection.OUT_OF_FOV else -point).tolist() == [code]
    plate = _grid_plate(2, 0.2)
    counts = scan(WIDE, _pose([0, 0, 0.3], [0, 0, 0]), caster_of(plate), plate).counts()
    assert counts[Rejection.MEASURED] > 0
    assert sum(counts.values()) == 36 * 36


def test_a_scanner_of_one_ray_measures_the_point_ahead():
    """Resolution equal to the field of view: the one ray runs along the viewing direction."""
    plate = _grid_plate(3, 0.2)
    one = LaserArea((5, 5), (5, 5))
    result = scan(one, _pose([0.011, 0.003, 0.3], [0.011, 0.003, 0]), caster_of(plate), plate)
    assert result.codes.tolist() == [Rejection.MEASURED]
    np.testing.assert_allclose(result.points, [[0.011, 0.003, 0]], atol=1e-7)


def test_a_source_inside_the_part_measures_nothing():
    """From inside, every face is seen from behind."""
    part = block((0.4, 0.4, 0.4))
    features = draw_samples(part, part, 500, np.random.default_rng(0))
    T = _pose([0.01, 0, -0.1], [0, 0, 0.2])
    assert not find_measured(T[None, None], features, WIDE, [caster_of(part)]).any()
    assert scan(WIDE, T, caster_of(part), part).counts()[Rejection.MEASURED] == 0


def test_a_sensor_inside_the_part_measures_nothing():
    """The source is outside, but the sensor is inside a block beside the measured face."""
    part = joined(block((0.1, 0.4, 0.5), (0.1, 0, 0.25)), _grid_plate(4, 0.4))
    T = np.array([[1.0, 0, 0, -0.02], [0, -1, 0, 0], [0, 0, -1, 0.3], [0, 0, 0, 1]])
    features = _feature([-0.05, 0.001, 0], [0, 0, 1])
    for baseline, seen in ((30, True), (110, False)):
        scanner = LaserArea(baseline_mm=baseline)
        assert find_measured(T[None, None], features, scanner, [caster_of(part)]).tolist() == [seen]
    counts = scan(LaserArea(resolution_deg=(1, 1), baseline_mm=110), T, caster_of(part), part).counts()
    assert counts[Rejection.MEASURED] == 0
    assert counts[Rejection.SENSOR_BLOCKED] > 0


def test_a_grazing_limit_of_0_keeps_head_on_points_only():
    """The point straight below is measured, and a point one degree off is not."""
    plate = _grid_plate(3, 0.2)
    scanner = LaserArea(baseline_mm=0, grazing_max_deg=0)
    T = _pose([0.01, 0.02, 0.3], [0.01, 0.02, 0])
    for x, seen in ((0.01, True), (0.01 + 0.3 * np.tan(np.radians(1)), False)):
        assert find_measured(
            T[None, None], _feature([x, 0.02, 0], [0, 0, 1]), scanner, [caster_of(plate)]
        ).tolist() == [seen]


def test_a_grazing_limit_of_90_keeps_everything_in_front_and_nothing_behind():
    """Slightly above the plane all of it is measured, and slightly below no point."""
    plate = _grid_plate(10, 0.2)
    features = draw_samples(plate, plate, 500, np.random.default_rng(0))
    for height, seen in ((1e-3, True), (-1e-3, False)):
        T = _pose([-0.3, 0.0, height], [0, 0, height])
        found = find_measured(T[None, None], features, ONE_EYE, [caster_of(plate)])
        assert (found == seen).all()


@pytest.mark.parametrize("limit", [0, 1])
def test_a_plate_exactly_at_the_end_of_the_range_is_in_range(limit):
    """Plates at 150 and 450 mm are measured, although these distances are not representable."""
    distance = (0.15, 0.45)[limit]
    features = _feature([0.1, 0.2, 0.7 - distance], [0, 0, 1])
    plate = _grid_plate(3, 0.9)
    plate = TriangleMesh(plate.vertices + np.array([0, 0, 0.7 - distance]), plate.faces)
    T = np.array([[1.0, 0, 0, 0.1], [0, -1, 0, 0.2], [0, 0, -1, 0.7], [0, 0, 0, 1]])
    assert find_measured(T[None, None], features, LaserArea(), [caster_of(plate)]).all()
