"""Best fit of one scan: displaced parts, and parts whose position one scan does not determine."""

import numpy as np
import pytest
import trimesh

from cell.world.embree import EmbreeRayCaster
from planner.errors import PlannerError
from planner.geometry.closest import ClosestPointQuery
from planner.geometry.mesh import TriangleMesh
from planner.registration.cloud import ScanCloud
from planner.registration.localisation import SearchRange, _BodyFit, fit_surface
from planner.registration.observability import FreeKind, surface_type
from planner.registration.registration import MovingScan
from planner.registration.rigid import motion_from_screw, screw_from_motion
from planner.values import Floats
from tests.support.meshes import as_triangles

SENSOR = np.array([0.05, 0.1, 0.28])
NOISE = 3e-5


def _blob() -> TriangleMesh:
    """Return an asymmetric body of about 100 mm."""
    ball = trimesh.creation.icosphere(4, 1.0)
    x, y, z = ball.vertices.T
    radius = 0.05 + 0.006 * np.sin(3 * x + 1) * np.cos(2 * y) + 0.004 * np.sin(4 * z)
    radius -= 0.012 * np.exp(-8 * ((z - 1) ** 2 + y**2))
    return TriangleMesh(ball.vertices * radius[:, None], ball.faces)


def _scan(mesh: TriangleMesh, T_moved: Floats, seed: int = 0, step: float = 1.0) -> ScanCloud:
    """Return the part after a motion (4, 4), seen from the sensor, with noise along the rays."""
    back = np.linalg.inv(T_moved)
    sensor = back[:3, :3] @ SENSOR + back[:3, 3]
    z = -SENSOR / np.linalg.norm(SENSOR)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    h, v = np.meshgrid(*[np.tan(np.radians(np.arange(-22, 22, step)))] * 2)
    rays = h.ravel()[:, None] * x + v.ravel()[:, None] * np.cross(z, x) + z
    rays = rays / np.linalg.norm(rays, axis=1, keepdims=True) @ back[:3, :3].T
    distance = EmbreeRayCaster(mesh.vertices, mesh.faces).first_hit(np.tile(sensor, (len(rays), 1)), rays).distance
    hit = np.isfinite(distance)
    distance = distance[hit] + np.random.default_rng(seed).normal(0, NOISE, hit.sum())
    points = sensor + distance[:, None] * rays[hit]
    return ScanCloud(points @ T_moved[:3, :3].T + T_moved[:3, 3], SENSOR)


def _moved(seed: int, mm: float = 20.0, deg: float = 5.0) -> Floats:
    shift, axis = np.random.default_rng(seed).standard_normal((2, 3))
    shift *= mm / 1000 / np.linalg.norm(shift)
    return motion_from_screw(np.concatenate([shift, np.radians(deg) * axis / np.linalg.norm(axis)]), np.zeros(3))


@pytest.mark.parametrize("seed", range(2))
def test_a_part_is_found_20_mm_and_5_deg_away(seed: int) -> None:
    """Every point is found to 0.05 mm and to five standard deviations, without an undetermined motion."""
    mesh, T_moved = _blob(), _moved(seed)
    found = fit_surface(
        [_scan(mesh, T_moved, seed)], ClosestPointQuery(mesh), np.zeros(3), SearchRange(), np.random.default_rng(0)
    )
    T_off = found.T @ T_moved
    off = np.linalg.norm(mesh.vertices @ T_off[:3, :3].T + T_off[:3, 3] - mesh.vertices, axis=1).max()
    assert off < 5e-5
    assert off < 5 * found.worst_point_sd(mesh.vertices)  # type: ignore[operator]
    assert found.undetermined_motions(1e-4) == ()
    assert found.alternatives == found.doubts == ()
    assert found.rms == pytest.approx(NOISE, rel=0.35)  # along the normals, to which the rays are inclined


def test_a_part_is_found_from_many_small_views() -> None:
    """A part is found from twenty views of thirty points and one without any as from one scan with all points."""
    mesh, T_moved = _blob(), _moved(0)
    scan = _scan(mesh, T_moved, step=0.7)
    views = [ScanCloud(scan.points[k::20], SENSOR) for k in range(20)] + [ScanCloud(scan.points[:0], SENSOR)]
    found = fit_surface(views, ClosestPointQuery(mesh), np.zeros(3), SearchRange(), np.random.default_rng(0))
    T_off = found.T @ T_moved
    assert np.linalg.norm(mesh.vertices @ T_off[:3, :3].T + T_off[:3, 3] - mesh.vertices, axis=1).max() < 5e-5
    assert found.alternatives == found.doubts == ()


def test_the_standard_deviations_are_the_scatter_of_fits() -> None:
    """The standard deviations of 8 noisy scans agree with the scatter of their fits within a factor of two."""
    mesh, T_moved = _blob(), _moved(0, mm=1.0, deg=0.3)
    nearest, search = ClosestPointQuery(mesh), SearchRange(0.002, 0.01)
    fits = [
        fit_surface([_scan(mesh, T_moved, seed, 2.5)], nearest, np.zeros(3), search, np.random.default_rng(0))
        for seed in range(8)
    ]
    scatter = np.stack([screw_from_motion(each.T @ T_moved, np.zeros(3)) for each in fits]).std(axis=0)
    reported = np.mean([np.sqrt(np.diag(each.covariance)) for each in fits], axis=0)
    assert (scatter < 2 * reported).all()
    assert (reported < 2 * scatter).all()


def test_a_ball_turns_every_way() -> None:
    """Three turns are undetermined, the centre is found, and the fit keeps the planned orientation."""
    mesh, T_moved = as_triangles(trimesh.creation.icosphere(5, 0.04)), _moved(1)
    found = fit_surface(
        [_scan(mesh, T_moved)], ClosestPointQuery(mesh), np.zeros(3), SearchRange(), np.random.default_rng(0)
    )
    assert surface_type(found.undetermined_motions(1e-4)) == "a sphere"
    assert np.linalg.norm((found.T @ T_moved)[:3, 3]) < 5e-5
    assert np.linalg.norm(screw_from_motion(found.T, np.zeros(3))[3:]) < 1e-3


def test_a_cylinder_seen_from_the_side_turns_and_slides() -> None:
    """The ends are not visible: one turn and one translation along the axis are reported as undetermined."""
    mesh, T_moved = as_triangles(trimesh.creation.cylinder(0.03, 1.0, sections=720)), _moved(2, mm=5.0, deg=2.0)
    T = np.eye(4)
    T[:3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    mesh = TriangleMesh(mesh.vertices @ T[:3, :3].T, mesh.faces)
    found = fit_surface(
        [_scan(mesh, T_moved)], ClosestPointQuery(mesh), np.zeros(3), SearchRange(), np.random.default_rng(0)
    )
    motions = found.undetermined_motions(1e-4)
    assert surface_type(motions) == "a cylinder"
    assert all(abs(motion.direction[0]) > 0.999 for motion in motions)
    (turn,) = (motion for motion in motions if motion.kind is FreeKind.ROTATION)
    assert np.linalg.norm(turn.point[1:]) < 1e-4


def test_directions_that_lose_their_matches_are_undetermined() -> None:
    """A fit that holds no direction, with matches on a plane only, moves across the plane and reports the others."""
    x, y = np.meshgrid(*[np.linspace(-0.03, 0.03, 20)] * 2)
    points = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 0.006)])
    mesh = as_triangles(trimesh.creation.box((0.1, 0.1, 0.01)))
    body = _BodyFit([MovingScan(ScanCloud(points, SENSOR), 400)], ClosestPointQuery(mesh), 0.01, np.zeros(3), 0.05)
    body._held = np.empty((6, 0))
    body.descend(10)
    np.testing.assert_allclose(body.T[:3, 3], [0.0, 0.0, -0.001], atol=1e-9)
    assert surface_type(body.result().undetermined_motions(1e-4)) == "a plane"


def test_a_row_of_pins_has_a_rival() -> None:
    """Pins every 8 mm fit as well one pitch further, and this alternative is reported."""
    pins = [
        trimesh.creation.icosphere(1, 0.003).apply_translation([0.008 * k, 0.008 * j, 0])
        for k in range(-6, 7)
        for j in range(-6, 7)
    ]
    mesh = as_triangles(trimesh.util.concatenate(pins))
    cloud = _scan(mesh, np.eye(4))
    middle = np.linalg.norm(cloud.points[:, :2], axis=1) < 0.03
    found = fit_surface(
        [ScanCloud(cloud.points[middle], SENSOR)], ClosestPointQuery(mesh), np.zeros(3), SearchRange(0.012, 0.01),
        np.random.default_rng(0),
    )  # fmt: skip
    assert any("fit as well" in sentence for sentence in found.alternatives)


def test_points_of_something_else_are_refused_or_doubted() -> None:
    """No point near the part is an error; a fit with many unmatched points is reported as doubtful."""
    mesh = _blob()
    far = ScanCloud(np.random.default_rng(0).uniform(1, 2, (100, 3)), SENSOR)
    with pytest.raises(PlannerError, match="only 0 points lie within"):
        fit_surface([far], ClosestPointQuery(mesh), np.zeros(3), SearchRange(), np.random.default_rng(0))
    noise = np.random.default_rng(0).uniform(-0.06, 0.06, (200, 3))
    found = fit_surface(
        [ScanCloud(noise, SENSOR)],
        ClosestPointQuery(mesh),
        np.zeros(3),
        SearchRange(0.005, 0.02),
        np.random.default_rng(0),
    )
    assert found.doubts
