"""Lines of sight through unseen space before the minimum range, where the part may begin."""

from dataclasses import replace

import numpy as np
import pytest

from cell.explore.frustum import MinRangeOccluder, SensorFrustum, area_below_min_range, should_keep_min_range
from cell.scanners.laser_area import LaserArea
from cell.world.embree import EmbreeRayCaster
from planner.explore.gain import N_LATEST_BATCHES
from planner.explore.space import FREE, OCCUPIED, UNKNOWN, VoxelSpace
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples
from planner.values import Floats

TARGET = np.array([[0.0, 0.0, 0.0]])


def _wall(x: float) -> EmbreeRayCaster:
    """Return a ray caster of a square across the x axis."""
    y, z = np.array([-1.0, 1.0, 1.0, -1.0]), np.array([-1.0, -1.0, 1.0, 1.0])
    mesh = TriangleMesh(np.column_stack([np.full(4, x), y, z]), np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32))
    return EmbreeRayCaster(mesh.vertices, mesh.faces)


def _space(state: int = FREE, votes: int = 0) -> VoxelSpace:
    """Return a free space with one occupied voxel in the middle and a block of the given state at x = 60 to 80 mm."""
    space = VoxelSpace.from_cylinder(0.1, 0.1, 0.004, 0.003)
    x = space.centres(np.ones(space.state.shape, dtype=bool))[:, 0].reshape(space.state.shape)
    known = np.where((x > 0.06) & (x < 0.08), state, FREE).astype(np.uint8)
    known[tuple(np.floor((TARGET[0] - space.low) / space.edge).astype(int))] = OCCUPIED
    return replace(space, state=known, votes=np.full(space.votes.shape, votes, dtype=np.int16))


@pytest.mark.parametrize(
    ("space", "away", "blocked"),
    [
        (_space(), 0.2, False),
        (_space(UNKNOWN), 0.2, True),
        (_space(UNKNOWN, votes=2), 0.2, False),
        (_space(UNKNOWN), 0.3, False),
        (_space(OCCUPIED, votes=2), 0.2, True),
        (_space(), 0.1, True),
    ],
    ids=["free", "nobody looked", "voted down", "farther off", "hit", "the target itself is too near"],
)
def test_lines_of_sight_keep_the_minimum_range(space: VoxelSpace, away: float, blocked: bool) -> None:
    """A line of sight is blocked if the part may lie below the minimum range of 150 mm."""
    stand = np.array([[away, 0.0, 0.0]])
    assert MinRangeOccluder(None, space, 0.15).blocked(stand, TARGET).tolist() == [blocked]


@pytest.mark.parametrize(("x", "blocked"), [(0.05, True), (-0.05, False)])
def test_occluders_block_as_they_do(x: float, blocked: bool) -> None:
    """Other occluders block along the whole line of sight, and rays meet them at their true distance."""
    caster, stand = MinRangeOccluder(_wall(x), _space(), 0.15), np.array([[0.2, 0.0, 0.0]])
    assert caster.blocked(stand, TARGET).tolist() == [blocked]
    along: Floats = np.array([[-1.0, 0.0, 0.0]])
    assert caster.first_hit(stand, along).distance == pytest.approx([0.2 - x])


def _scan(eye: SensorFrustum, T: Floats, x: float) -> Floats:
    """Return the (N, 3) points in which rays meet a wall across the x axis within the range."""
    rays = eye.rays @ T[:3, :3].T
    source = T[:3, :3] @ eye.source + T[:3, 3]
    away = (x - source[0]) / rays[:, 0]
    return np.asarray((source + rays * away[:, None])[(away >= eye.near) & (away <= eye.far)])


@pytest.mark.parametrize(
    ("wall", "state", "message"),
    [(0.0, UNKNOWN, 0.0), (0.07, UNKNOWN, 1.0), (0.07, FREE, 0.0), (-0.05, UNKNOWN, 0.0)],
    ids=["where it was believed", "before the range", "before the range, where others saw nothing", "farther off"],
)
@pytest.mark.parametrize("offset_m", [0.0, 0.2])
def test_samples_without_points_before_unseen_space_count_as_too_near(
    wall: float, state: int, message: float, offset_m: float
) -> None:
    """Samples without a point count as too near if the part lies in unseen space before the minimum range."""
    scanner = LaserArea(fov_deg=(20, 20), resolution_deg=(1.0, 1.0), range_mm=(150, 450))
    rays = np.asarray(scanner.ray_directions())
    apart = float(np.arccos(rays[0] @ rays[1]))
    source = np.array([0.0, 0.0, offset_m])
    eye = SensorFrustum(source, np.asarray(scanner.sensor), rays, scanner.grid_shape[1], 0.15, 0.45, apart)
    T = np.eye(4)
    T[:3, :3] = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    T[:3, 3] = np.array([0.2, 0.0, 0.0]) - T[:3, :3] @ source
    y = np.linspace(-0.02, 0.02, 5)
    points = np.column_stack([np.zeros(5), y, np.zeros(5)])
    samples = SurfaceSamples(
        points, np.tile([1.0, 0.0, 0.0], (5, 1)), np.full(5, 0.2), np.zeros(5, dtype=int), np.zeros(5, dtype=int)
    )
    view = (_scan(eye, T, wall), T)
    assert area_below_min_range(samples, np.ones((5, 1), dtype=bool), [view], _space(state), eye) == pytest.approx(
        message
    )
    sees = np.zeros((5, 2), dtype=bool)
    sees[0, 0] = sees[1:3, 1] = True  # two samples are expected of neither view
    assert area_below_min_range(samples, sees, [view, view], _space(state), eye) == pytest.approx(0.6 * message)


def test_views_keep_off_for_some_batches_after_one_that_stood_too_near() -> None:
    """A batch with more than half of its expected area too near has an effect for `N_LATEST_BATCHES` batches."""
    assert not should_keep_min_range([])
    assert not should_keep_min_range([(0.5, 1.0), (0.0, 0.0)])
    assert should_keep_min_range([(0.6, 1.0), *[(0.0, 1.0)] * (N_LATEST_BATCHES - 1)])
    assert not should_keep_min_range([(0.6, 1.0), *[(0.0, 1.0)] * N_LATEST_BATCHES])
