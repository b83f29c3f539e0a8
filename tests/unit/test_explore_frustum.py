"""Interpolation between points of neighbouring rays: on one surface, but not across steps or missing rays."""

import numpy as np
import pytest

from cell.errors import SceneError
from cell.explore.frustum import SensorFrustum
from cell.explore.options import ExploreOptions
from cell.explore.prepare import prepare_exploration
from cell.scan.options import ScanOptions
from cell.scanners.laser_area import LaserArea
from cell.scene.file import scene_from_options
from cell.session import Session
from planner.values import Floats

STEP = np.radians(0.5)


def _eye(across: float = 0.5, down: float = 0.5) -> SensorFrustum:
    """Return the frustum of a scanner of 20 by 20 degrees with the given resolution [deg]."""
    scanner = LaserArea(fov_deg=(20, 20), resolution_deg=(across, down), range_mm=(100, 900))
    rays = np.asarray(scanner.ray_directions())
    apart = float(np.arccos(rays[0] @ rays[1]))
    return SensorFrustum(
        np.asarray(scanner.source), np.asarray(scanner.sensor), rays, scanner.grid_shape[1], 0.1, 0.9, apart
    )


def _pose(lean: float, distance: float) -> Floats:
    """Return the (4, 4) pose of a scanner that looks at (0.1, 0.2, 0) from a distance [m].

    The view direction leans by `lean` [rad] from the z axis, and x points along the slope.
    """
    out = np.array([np.sin(lean), 0.0, np.cos(lean)])
    T = np.eye(4)
    T[:3, :3] = np.column_stack([np.array([-np.cos(lean), 0.0, np.sin(lean)]), [0.0, 1.0, 0.0], -out])
    T[:3, 3] = distance * out + [0.1, 0.2, 0.0]
    return T


def _on_planes(eye: SensorFrustum, T: Floats, step: float = 0.0) -> Floats:
    """Return the (N, 3) points in which the rays meet z = 0, or z = -`step` for y below 0.2."""
    rays = eye.rays @ T[:3, :3].T
    height = np.where(rays[:, 1] < 0, step, 0.0)
    return np.asarray(T[:3, 3] - rays * ((T[2, 3] + height) / rays[:, 2])[:, None])


@pytest.mark.parametrize("resolution", [(0.5, 0.5), (0.5, 0.25), (0.25, 0.5)])
@pytest.mark.parametrize(("lean", "distance"), [(45.0, 0.4), (62.0, 0.4), (62.0, 0.8)])
def test_between_points_of_a_slope_are_places_of_it(
    lean: float, distance: float, resolution: tuple[float, float]
) -> None:
    """Interpolated positions lie on the plane within the measured points."""
    eye, T = _eye(*resolution), _pose(np.radians(lean), distance)
    points, gap = _on_planes(eye, T), 1.2 * distance * np.radians(resolution[0])
    places = eye.between(points, T, gap)
    assert np.abs(places[:, 2]).max() < 1e-12
    assert (places.min(axis=0) >= points.min(axis=0) - 1e-12).all()
    assert (places.max(axis=0) <= points.max(axis=0) + 1e-12).all()
    rows = points.reshape(-1, eye.columns, 3)
    middle = rows[len(rows) // 2]
    along = np.sort(middle[:, 0])
    assert np.diff(along).max() > gap
    on_row = np.abs((places - T[:3, 3]) @ np.cross(middle[0] - T[:3, 3], middle[-1] - T[:3, 3])) < 1e-9
    assert np.diff(np.sort(np.concatenate([along, places[on_row, 0]]))).max() <= gap * (1 + 1e-9)


def test_between_points_of_a_surface_that_is_met_squarely_is_nothing() -> None:
    """Points of a surface met squarely are closer than the gap."""
    eye, T = _eye(), _pose(0.0, 0.4)
    points = _on_planes(eye, T)
    assert not len(eye.between(points, T, 1.2 * 0.4 * STEP))
    assert len(eye.between(points, T, 0.6 * 0.4 * STEP)) == 2 * 40 * 39
    assert not len(eye.between(np.empty((0, 3)), T, 0.4 * STEP))


@pytest.mark.parametrize(("step", "joined"), [(3.5, True), (4.5, False), (10.0, False)])
@pytest.mark.parametrize("distance", [0.4, 0.8])
def test_a_step_is_joined_where_it_may_be_a_slope(step: float, joined: bool, distance: float) -> None:
    """A step is bridged up to the point distance of a surface at 75 degrees, and not beyond it."""
    eye, T, spacing = _eye(), _pose(0.0, distance), distance * STEP
    places = eye.between(_on_planes(eye, T, step * spacing), T, 1.5 * spacing)
    assert (len(places) > 0) == joined
    if joined:
        assert (places[:, 2] < 0).all()
        assert (places[:, 2] > -step * spacing).all()


def test_a_ray_that_did_not_come_back_separates() -> None:
    """Points two rays apart are not neighbours. Of several points next to one ray the first is used."""
    eye, T = _eye(), _pose(np.radians(62), 0.4)
    points, gap = _on_planes(eye, T), 0.5 * 0.4 * STEP
    assert not len(eye.between(points.reshape(40, 40, 3)[::2, ::2].reshape(-1, 3), T, gap))
    twice = np.concatenate([points, points + 1e-5])
    assert np.array_equal(eye.between(twice, T, gap), eye.between(points, T, gap))


def test_the_rays_are_those_of_a_scan() -> None:
    """Rays have the resolution of the scan, or that of the plan by default."""
    scene = scene_from_options(None, {"place": (1200, 500, 0)}, "petanque")
    eyes = [
        prepare_exploration(Session(None), scene, ExploreOptions(), ScanOptions(resolution_deg=requests)).frustum
        for requests in (None, 2.0)
    ]
    assert [eye.rays.shape for eye in eyes] == [(240 * 240, 3), (30 * 30, 3)]
    assert [eye.columns for eye in eyes] == [240, 30]
    assert eyes[1].apart > 7 * eyes[0].apart


def test_an_angle_that_leaves_no_ray_is_refused() -> None:
    """A resolution that gives no ray in the field of view is refused by the preparation."""
    scene = scene_from_options(None, {"place": (1200, 500, 0)}, "petanque")
    with pytest.raises(SceneError, match="gives no ray"):
        prepare_exploration(Session(None), scene, ExploreOptions(), ScanOptions(resolution_deg=100.0))
