"""Sampled poses: the frustum of a scanner, drawn and transferred poses, compared with closed forms."""

import numpy as np
import pytest

from cell.scanners.laser_area import LaserArea
from cell.scanners.laser_line import LaserLine
from planner.ports import Rejection
from planner.viewpoints.lines_of_sight import RayTargets
from planner.viewpoints.pose_sampling import draw_poses, find_frustum, transfer_poses
from planner.viewpoints.viewpoints import aim_viewpoints, viewpoints_from_poses


def _sphere(count):
    """Return random points of a sphere of 50 mm with their normals."""
    normals = np.random.default_rng(3).normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return RayTargets.of(0.05 * normals, normals)


def _codes(scanner, T, points, normals):
    """Apply the scanner's conditions to point i at pose i, one after the other."""
    return np.array(
        [
            scanner.reject(((p - t[:3, 3]) @ t[:3, :3])[None], (n @ t[:3, :3])[None])[0]
            for t, p, n in zip(T, points, normals, strict=True)
        ]
    )


@pytest.mark.parametrize(("fov", "near", "far", "limit"), [((60, 60), 50, 150, 75), ((12, 40), 150, 450, 60)])
def test_the_frustum_is_that_of_the_conditions(fov, near, far, limit):
    """Every place is inside the closed form of the frustum, and the places reach close to its limits."""
    scanner = LaserArea(
        fov_deg=fov, range_mm=(near, far), baseline_mm=10, grazing_max_deg=limit, sensor_grazing_max_deg=90
    )
    found = find_frustum(scanner)
    distance = 1000 * np.linalg.norm(found.points, axis=1)
    across, along = (np.degrees(np.arctan2(found.points[:, k], found.points[:, 2])) for k in (0, 1))
    assert distance.min() >= near
    assert distance.max() <= far
    assert distance.min() < 1.01 * near
    assert distance.max() > 0.99 * far
    for angle, opening in ((across, fov[0]), (along, fov[1])):
        assert 0.4 * opening < np.abs(angle).max() < opening / 2
    assert np.degrees(found.tilt) == pytest.approx(limit)
    assert found.start[-1] == len(found.points)


def test_the_frustum_of_a_line_sensor_is_its_sheet():
    """All places are in the plane of the sheet, which has no field of view across it."""
    found = find_frustum(LaserLine(range_mm=(100, 300), sweep_steps=8, sensor_grazing_max_deg=90))
    assert np.abs(found.points[:, 0]).max() < 0.01 < np.ptp(found.points[:, 1])


def test_a_scanner_that_measures_nothing_has_no_frustum():
    """The frustum has no place and no pose is drawn."""

    class Blind(LaserArea):
        def reject(self, points, normals):
            return np.full(len(points), Rejection.OUT_OF_FOV, dtype=np.uint8)

    scanner, targets = Blind(), _sphere(4)
    found = find_frustum(scanner)
    assert not len(found.points)
    assert not len(draw_poses(targets, np.arange(4), (0, 10), found, scanner))


@pytest.mark.parametrize("scanner", [LaserArea(sensor_grazing_max_deg=75.0), LaserLine()])
def test_drawn_poses_are_rigid_and_have_their_point_in_view(scanner):
    """The conditions hold for each pose and its point; two ranges of the sequence give the poses of both."""
    targets, rows = _sphere(12), np.array([2, 5, 11])
    within = find_frustum(scanner)
    everything = draw_poses(targets, rows, (0, 200), within, scanner)
    R = everything.T_object_scanner[:, :3, :3]
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.broadcast_to(np.eye(3), R.shape), atol=1e-12)
    assert (np.linalg.det(R) > 0).all()
    points, normals = targets.points[:, everything.row].T, targets.normals[:, everything.row].T
    assert (_codes(scanner, everything.T_object_scanner, points, normals) == Rejection.MEASURED).all()
    assert set(everything.row.tolist()) == set(rows.tolist())
    for row in rows:
        parts = [draw_poses(targets, np.array([row]), part, within, scanner) for part in ((0, 77), (77, 200))]
        joined = np.concatenate([part.T_object_scanner for part in parts])
        np.testing.assert_array_equal(joined, everything.T_object_scanner[everything.row == row])


def test_draws_fill_the_allowed_ranges():
    """Distances, tilts and rolls of many draws span the allowed ranges."""
    scanner = LaserArea(range_mm=(50, 150), baseline_mm=0, grazing_max_deg=60, sensor_grazing_max_deg=60)
    targets = _sphere(1)
    poses = draw_poses(targets, np.array([0]), (0, 4000), find_frustum(scanner), scanner).T_object_scanner
    rays = poses[:, :3, 3] - targets.points[:, 0]
    distance = np.linalg.norm(rays, axis=1)
    tilt = np.degrees(np.arccos(rays @ targets.normals[:, 0] / distance))
    assert (distance.min(), distance.max()) == pytest.approx((0.05, 0.15), rel=0.02)
    assert tilt.min() < 3
    assert 58 < tilt.max() <= 60
    heading = np.degrees(np.arctan2(poses[:, 1, 0], poses[:, 0, 0]))
    assert np.histogram(heading, bins=12, range=(-180, 180))[0].min() > 100


def test_poses_are_transferred_to_neighbours():
    """The pose of one point gives accepted and distinct poses of its neighbours."""
    scanner = LaserArea(range_mm=(50, 150), baseline_mm=25, sensor_grazing_max_deg=75)
    targets = _sphere(300)
    known = draw_poses(targets, np.array([7]), (0, 8), find_frustum(scanner), scanner)
    near = np.argsort(np.linalg.norm(targets.points.T - targets.points[:, 7], axis=1))[1:6]
    found = transfer_poses(targets, near, (0, 8), known, 4, scanner)
    assert set(found.row.tolist()) == set(near.tolist())
    codes = _codes(scanner, found.T_object_scanner, targets.points[:, found.row].T, targets.normals[:, found.row].T)
    assert (codes == Rejection.MEASURED).all()
    assert len(np.unique(found.T_object_scanner.reshape(len(found), -1), axis=0)) == len(found)


def test_viewpoints_from_poses_have_their_standoff_and_roll():
    """Standoff and roll of poses from `aim_viewpoints` are recovered."""
    rng = np.random.default_rng(0)
    outward = rng.normal(size=(6, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    points = rng.normal(size=(6, 3))
    viewpoints = aim_viewpoints(points, outward, np.arange(6), (0.1, 0.3), (0.0, 1.0, 4.0))
    back = viewpoints_from_poses(viewpoints.T_object_scanner[:, 0], points[viewpoints.face], viewpoints.face)
    np.testing.assert_allclose(back.standoff, viewpoints.standoff)
    np.testing.assert_allclose(np.cos(back.roll - viewpoints.roll), 1.0)
    np.testing.assert_array_equal(back.T_object_scanner, viewpoints.T_object_scanner)
