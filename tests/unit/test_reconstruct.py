"""Reconstruction of surfaces that have a closed form."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from cell.metrology.reconstruct import Reconstruction, ReconstructionStatus, reconstruct
from planner.errors import PlannerError
from planner.geometry.mesh import TriangleMesh
from planner.registration.cloud import PointCloud, ScanCloud, merge
from planner.registration.surface import ImplicitSurface, boundary_loops, sample_by_area

RADIUS = 0.05
VIEWS = 0.3 * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1.0]])


def _ball_scan(sensor: np.ndarray, pitch_deg: float = 0.2, noise: float = 0.0, seed: int = 0) -> ScanCloud:
    """Rays of a pinhole grid on the ball of 50 mm at the origin, grazing limit 75 degrees; exact intersections."""
    z = -sensor / np.linalg.norm(sensor)
    x = np.cross([0.3, 0.5, 0.8], z)
    x /= np.linalg.norm(x)
    tangents = np.tan(np.radians(np.arange(-11, 11, pitch_deg)))
    h, v = np.meshgrid(tangents, tangents)
    rays = h.ravel()[:, None] * x + v.ravel()[:, None] * np.cross(z, x) + z
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    along = rays @ sensor
    under = along**2 - sensor @ sensor + RADIUS**2
    distance = -along - np.sqrt(np.maximum(under, 0))
    points = sensor + distance[:, None] * rays
    seen = (under > 0) & (np.einsum("nj,nj->n", points, -rays) / RADIUS > np.cos(np.radians(75)))
    error = np.random.default_rng(seed).normal(0, noise, seen.sum()) if noise else 0.0
    return ScanCloud(points[seen] + np.atleast_1d(error)[:, None] * rays[seen], sensor)


def _mesh_of(result: Reconstruction) -> TriangleMesh:
    assert result.status is ReconstructionStatus.DONE
    assert result.mesh is not None
    return result.mesh


def test_ball_from_six_sides_is_closed_and_exact() -> None:
    """A scan pitch of 1 mm gives a closed ball (no boundary, Euler number 2), right to 10 micrometres everywhere."""
    mesh = _mesh_of(reconstruct(merge([_ball_scan(view) for view in VIEWS])))
    assert np.abs(np.linalg.norm(mesh.vertices, axis=1) - RADIUS).max() < 10e-6
    assert boundary_loops(mesh) == []
    edges = np.unique(np.sort(mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    assert len(mesh.vertices) - len(edges) + len(mesh.faces) == 2
    outward = np.einsum("fj,fj->f", mesh.normals, mesh.vertices[mesh.faces].mean(axis=1))
    assert outward.min() > 0


def test_one_point_predicts_the_distance_from_its_plane() -> None:
    """The surface of a single point is the plane across its normal."""
    surface = ImplicitSurface(PointCloud(np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), np.zeros(1, dtype=np.int32)))
    field = surface.evaluate(np.array([[0.003, 0.0, 0.002], [0.0, 0.004, -0.003]]))
    np.testing.assert_allclose(field.distance, [0.002, -0.003], rtol=1e-6)


def test_noise_is_averaged() -> None:
    """Range noise of 50 micrometres leaves less than half of it in the surface."""
    scans = [_ball_scan(view, noise=50e-6, seed=i) for i, view in enumerate(VIEWS)]
    radius = np.linalg.norm(_mesh_of(reconstruct(merge(scans))).vertices, axis=1)
    assert 5e-6 < np.sqrt(np.mean((radius - RADIUS) ** 2)) < 25e-6


@pytest.mark.parametrize("views", [1, 2, 6])
def test_nothing_is_invented_beyond_two_spacings(views: int) -> None:
    """Corners, and points spread over all faces, lie within two spacings of a datum."""
    cloud = merge([_ball_scan(view) for view in VIEWS[:views]])
    result = reconstruct(cloud)
    mesh = _mesh_of(result)
    tree = cKDTree(cloud.points)
    spread = sample_by_area(mesh, 50_000, np.random.default_rng(0))
    assert tree.query(np.concatenate([mesh.vertices, spread]))[0].max() <= 2 * result.spacing
    longest = np.linalg.norm(np.diff(mesh.vertices[mesh.faces[:, [0, 1, 2, 0]]], axis=1), axis=2).max()
    assert longest < np.sqrt(3) * 2 * result.grid


def test_a_surface_is_continued_by_the_requested_distance() -> None:
    """A ball seen from one side is continued to 8 mm from its last points, within a fifth of that along the ball."""
    scan = merge([_ball_scan(VIEWS[0])])
    short, longer = (_mesh_of(reconstruct(scan, reach=reach)) for reach in (0.0, 0.008))
    away, off = (cKDTree(scan.points).query(longer.vertices)[0], np.linalg.norm(longer.vertices, axis=1) - RADIUS)
    assert 0.0075 < away.max() < 0.008
    assert np.abs(off).max() < 0.0016
    assert longer.areas.sum() > 1.1 * short.areas.sum()
    assert cKDTree(scan.points).query(short.vertices)[0].max() < 0.004


def test_the_result_has_its_input_points() -> None:
    """The result has the cloud without isolated points, or all usable points if they are too few."""
    ball = [_ball_scan(view) for view in VIEWS]
    result = reconstruct(merge([*ball, ScanCloud(np.array([[0.0, 0.0, 2 * RADIUS]]), VIEWS[4])]))
    assert result.outliers == 1
    assert np.array_equal(result.cloud.points, np.concatenate([scan.points for scan in ball]))
    few = reconstruct(merge([ScanCloud(ball[0].points[:5], VIEWS[0])]))
    assert (few.status, len(few.cloud)) == (ReconstructionStatus.TOO_FEW_POINTS, 5)


@pytest.mark.parametrize("reach", [-0.001, float("nan")])
def test_it_does_not_go_on_backwards(reach: float) -> None:
    """A distance below 0 and NaN are refused."""
    with pytest.raises(PlannerError, match="must not be negative"):
        reconstruct(merge([_ball_scan(VIEWS[0])]), reach=reach)


@pytest.mark.parametrize("noise", [0.0, 50e-6, 300e-6])
def test_nothing_is_invented_on_a_displaced_ball_with_a_hole_and_noise(noise: float) -> None:
    """On a displaced, noisy ball with a hole, all of the mesh is within two spacings of the given cloud."""
    whole = merge([_ball_scan(view, 0.3, noise, i) for i, view in enumerate(VIEWS)])
    keep = whole.points[:, 2] < RADIUS * np.cos(np.radians(20))
    aside = np.array([0.71, -0.32, 0.43])
    cloud = PointCloud(whole.points[keep] + aside, whole.normals[keep], whole.scan[keep])
    result = reconstruct(cloud)
    mesh = _mesh_of(result)
    assert result.holes >= 1
    spread = sample_by_area(mesh, 100_000, np.random.default_rng(1))
    distance = cKDTree(cloud.points).query(np.concatenate([mesh.vertices, spread]))[0]
    assert 1.2 * result.spacing < distance.max() <= 2 * result.spacing


def test_a_hole_stays_a_hole_and_closing_it_is_marked() -> None:
    """A cap of 40 degrees without points stays open; on request it is closed by marked faces."""
    cloud = merge([_ball_scan(view) for view in VIEWS])
    keep = cloud.points[:, 2] < RADIUS * np.cos(np.radians(20))
    cloud = PointCloud(cloud.points[keep], cloud.normals[keep], cloud.scan[keep])
    is_open = reconstruct(cloud)
    mesh = _mesh_of(is_open)
    loops = boundary_loops(mesh)
    assert is_open.holes == len(loops) == 1
    assert not is_open.closed.any()
    assert mesh.vertices[:, 2].max() < RADIUS * np.cos(np.radians(20)) + 2 * is_open.spacing
    closed = reconstruct(cloud, close=True)
    whole = _mesh_of(closed)
    assert boundary_loops(whole) == []
    assert closed.closed.sum() == len(loops[0])
    assert whole.faces[~closed.closed].tobytes() == mesh.faces.tobytes()
    corners = whole.vertices[whole.faces[closed.closed]]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0) / 2
    rim = np.pi * (RADIUS * np.sin(np.radians(20))) ** 2
    assert 0.7 * rim < area[2] < rim  # the normals of the cap point up like those around it
    assert np.hypot(area[0], area[1]) < 0.05 * rim


def test_a_thin_sheet_seen_from_both_sides_has_two_surfaces() -> None:
    """A sheet of 1.2 mm, pitch 0.8 mm: two open faces at the right heights that look away from each other."""
    x, y = np.meshgrid(np.arange(-25, 25) * 0.8e-3, np.arange(-25, 25) * 0.8e-3)
    top = np.stack([x.ravel(), y.ravel(), np.full(x.size, 0.6e-3)], axis=1)
    scans = [ScanCloud(top, np.array([0, 0, 0.3])), ScanCloud(top * [1, 1, -1], np.array([0, 0, -0.3]))]
    mesh = _mesh_of(reconstruct(merge(scans)))
    inner = (np.abs(mesh.vertices[mesh.faces].mean(axis=1)[:, :2]) < 0.018).all(axis=1)
    height, up = mesh.vertices[mesh.faces].mean(axis=1)[inner, 2], mesh.normals[inner, 2]
    np.testing.assert_allclose(height, np.sign(up) * 0.6e-3, atol=5e-6)
    areas = [mesh.areas[inner & (sign * mesh.normals[:, 2] > 0)].sum() for sign in (1, -1)]
    np.testing.assert_allclose(areas, 0.036**2, rtol=0.06)


def test_resolution_follows_the_spacing_unless_it_is_given() -> None:
    """Half the pitch gives half the cell; a given cell is kept; the same input gives the same bytes."""
    coarse, fine = (reconstruct(merge([_ball_scan(VIEWS[0], pitch)])) for pitch in (0.4, 0.2))
    assert coarse.grid / fine.grid == pytest.approx(2, rel=0.02)
    cloud = merge([_ball_scan(VIEWS[0])])
    first, second = (reconstruct(cloud, grid=1.5e-3) for _ in range(2))
    assert first.grid == 1.5e-3
    assert _mesh_of(first).vertices.tobytes() == _mesh_of(second).vertices.tobytes()


def test_settings_that_cannot_be_are_refused() -> None:
    """Grid settings that are not positive are refused."""
    cloud = merge([_ball_scan(VIEWS[0])])
    with pytest.raises(PlannerError, match="grid is 0"):
        reconstruct(cloud, grid=0)
