"""One scan of a plate, a wall and an occluder, with known results for every ray."""

import numpy as np
import pytest

from cell.scanners.laser_area import LaserArea
from cell.world.embree import EmbreeRayCaster
from cell.world.virtual_scan import scan
from planner.errors import PlannerError
from planner.geometry.mesh import TriangleMesh
from planner.ports import Rejection

DOWN = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0.3], [0, 0, 0, 1]])  # 300 mm above, looking down
SCANNER = LaserArea(fov_deg=(60, 40), resolution_deg=(2, 2))


def _plate(half=0.05, z=0.0):
    vertices = np.array([[-half, -half, z], [half, -half, z], [half, half, z], [-half, half, z]])
    return TriangleMesh(vertices, np.array([[0, 1, 2], [0, 2, 3]]))


def _caster(mesh):
    return EmbreeRayCaster(mesh.vertices, mesh.faces)


def test_rays_that_meet_the_plate_give_points_on_it():
    """The tangents decide which rays hit; points are on their ray, on the plate and on their face."""
    plate = _plate()
    result = scan(SCANNER, DOWN, _caster(plate), plate)
    directions = SCANNER.ray_directions()
    x, y = (0.3 * directions[:, axis] / directions[:, 2] for axis in (0, 1))
    meets = (np.abs(x) <= 0.05) & (np.abs(y) <= 0.05)
    assert (result.codes == np.where(meets, Rejection.MEASURED, Rejection.NO_HIT)).all()
    assert (result.pixel == np.flatnonzero(meets)).all()
    np.testing.assert_allclose(result.points, np.column_stack([x, -y, 0 * x])[meets], atol=2e-7)
    assert result.points.dtype == np.float64
    below_diagonal = result.points[:, 1] < result.points[:, 0]
    clear = np.abs(result.points[:, 1] - result.points[:, 0]) > 1e-6
    assert (result.face[clear] == np.where(below_diagonal, 0, 1)[clear]).all()
    assert (result.hit_face >= 0).tolist() == meets.tolist()
    assert result.grid_shape == (20, 30)


def test_counts_add_up_to_the_grid():
    """Every ray has exactly one code."""
    plate = _plate()
    counts = scan(SCANNER, DOWN, _caster(plate), plate).counts()
    assert set(counts) == set(Rejection)
    assert sum(counts.values()) == 600
    assert counts[Rejection.MEASURED] > 0


def test_an_occluder_blocks_only_in_front():
    """A small screen in front of the plate blocks the active ray; behind the plate it has no effect."""
    plate = _plate()
    free = scan(SCANNER, DOWN, _caster(plate), plate)
    behind = scan(SCANNER, DOWN, _caster(plate), plate, _caster(_plate(0.02, -0.1)))
    assert (behind.codes[free.pixel] == Rejection.MEASURED).all()
    front = scan(SCANNER, DOWN, _caster(plate), plate, _caster(_plate(0.02, 0.1)))
    directions = SCANNER.ray_directions()
    at_screen = np.abs(0.2 * directions[:, :2] / directions[:, 2:])
    screened = (at_screen <= 0.02).all(axis=1)
    assert (front.codes[screened] == Rejection.SOURCE_BLOCKED).all()
    assert (front.codes[~screened] != Rejection.SOURCE_BLOCKED).all()
    assert (front.hit_face[screened] == -1).all()
    assert front.counts()[Rejection.SENSOR_BLOCKED] > 0  # the screen is also between the plate and the sensor


def test_range_and_back_faces_are_rejected_with_their_reason():
    """A plate beyond the range and a plate seen from behind have their own codes."""
    for plate, reason in (
        (_plate(z=-0.2), Rejection.OUT_OF_RANGE),
        (TriangleMesh(_plate().vertices, _plate().faces[:, ::-1]), Rejection.GRAZING_SOURCE),
    ):
        counts = scan(SCANNER, DOWN, _caster(plate), plate).counts()
        assert counts[reason] > 0
        assert counts[Rejection.MEASURED] == 0


def test_with_no_baseline_the_sensor_sees_whatever_the_source_hits():
    """Without baseline no reflected ray is blocked on a bumpy surface, at every angle up to 90 degrees."""
    u, v = np.meshgrid(np.linspace(-0.1, 0.1, 41), np.linspace(-0.1, 0.1, 41), indexing="ij")
    height = 0.03 * np.sin(80 * u) * np.cos(70 * v)
    number = np.arange(41 * 41).reshape(41, 41)
    a, b, c, d = (number[i : i + 40, j : j + 40].ravel() for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)))
    mesh = TriangleMesh(
        np.column_stack([u.ravel(), v.ravel(), height.ravel()]),
        np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])]),
    )
    scanner = LaserArea(resolution_deg=(0.5, 0.5), baseline_mm=0, grazing_max_deg=90)
    counts = scan(scanner, DOWN, _caster(mesh), mesh).counts()
    assert counts[Rejection.MEASURED] > 4000
    assert counts[Rejection.SENSOR_BLOCKED] == 0


def test_a_pose_that_is_no_rigid_motion_is_refused():
    """A scaled pose is refused, because it would change distances without notice."""
    plate = _plate()
    with pytest.raises(PlannerError, match="not a rigid motion"):
        scan(SCANNER, 2 * DOWN, _caster(plate), plate)
