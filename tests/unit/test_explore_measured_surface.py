"""The surface of all points and its continuation: a tube seen from its mouth, a plate in free space."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from cell.explore import belief
from planner.explore.space import FREE, OCCUPIED, UNKNOWN, VoxelSpace
from planner.geometry.mesh import TriangleMesh
from planner.registration.cloud import PointCloud
from planner.values import Floats

EDGE, RADIUS, SEEN = 0.001, 0.005, 0.006
"""Of a voxel; of the tube; and how deep its wall was seen from z = 0 on [m]."""


def _scan(points: Floats, source: tuple[float, float, float]) -> Any:
    T = np.eye(4)
    T[:3, 3] = source
    return SimpleNamespace(points=points, T_reported=T)


def _wall(deepest: float, apart: float = 0.0004) -> Floats:
    turn, z = np.meshgrid(np.arange(0, 2 * np.pi, apart / RADIUS), np.arange(0, deepest, apart))
    return np.column_stack([RADIUS * np.cos(turn.ravel()), RADIUS * np.sin(turn.ravel()), z.ravel()])


def _space() -> VoxelSpace:
    return VoxelSpace.from_cylinder(0.02, 0.05, EDGE, 0.0005)


def _looked_into() -> VoxelSpace:
    """Return the space of a tube with a measured wall down to `SEEN`; space before the mouth and inside is free."""
    space = _space()
    state = np.full(space.state.shape, UNKNOWN, np.uint8)
    x, y, z = np.moveaxis(np.stack(np.meshgrid(*(space.low[i] + EDGE * (np.arange(n) + 0.5)
                          for i, n in enumerate(state.shape)), indexing="ij"), axis=-1), -1, 0)  # fmt: skip
    state[(z < 0) | ((np.hypot(x, y) < RADIUS) & (z < SEEN))] = FREE
    points = _wall(SEEN)
    state[tuple(np.floor((points - space.low) / EDGE).astype(int).T)] = OCCUPIED
    return replace(space, state=state, points=points)


def _continued(scans: list[Any], space: VoxelSpace) -> TriangleMesh | None:
    return belief.continue_surface(scans, space, space.belief_voxels())


def _plate(z: float, side: float = 0.008, apart: float = 0.0004) -> Floats:
    x, y = np.meshgrid(np.arange(-side, side, apart), np.arange(-side, side, apart))
    return np.column_stack([x.ravel(), y.ravel(), np.full(x.size, z)])


def _in_the_open(points: Floats) -> VoxelSpace:
    """Return a space that is free except at the points."""
    space = _space()
    state = np.full(space.state.shape, FREE, np.uint8)
    state[tuple(np.floor((points - space.low) / EDGE).astype(int).T)] = OCCUPIED
    return replace(space, state=state, points=points)


def test_the_wall_of_a_tube_goes_on_and_a_lid_stands_where_it_ends() -> None:
    """The wall continues by four voxels on the same cylinder."""
    surface = _continued([_scan(_wall(SEEN), (0.0, 0.0, -0.005))], _looked_into())
    assert surface is not None
    rho, z = np.hypot(*surface.centres[:, :2].T), surface.centres[:, 2]
    wall = (np.abs(rho - RADIUS) < 0.3 * EDGE) & (z > SEEN) & (z < SEEN + 3 * EDGE)
    around = surface.areas[wall].sum() / (2 * np.pi * RADIUS * 3 * EDGE)
    assert around == pytest.approx(1.0, abs=0.05)
    inside = (rho < RADIUS - 2 * EDGE) & (z > -2 * EDGE) & (z < 0.015)
    assert surface.areas[inside].sum() > np.pi * (RADIUS - 2 * EDGE) ** 2
    assert z[inside].min() > SEEN - EDGE
    assert z[inside & (rho < EDGE)].min() < SEEN + EDGE  # the axis is too far from the wall to be excluded
    assert z[inside & (rho > 2 * EDGE)].min() > SEEN + 1.5 * EDGE  # no surface before the continued wall
    assert (inside & (rho > RADIUS - 2.9 * EDGE) & (rho < RADIUS - 2.2 * EDGE)).any()
    beside = (np.abs(rho - RADIUS) > 0.5 * EDGE) & (np.abs(rho - RADIUS) < 1.4 * EDGE)
    assert not (beside & (z > 0) & (z < SEEN + 2 * EDGE)).any()


def test_where_space_was_seen_free_it_does_not_go_on() -> None:
    """A plate in free space ends where its points end, to within one voxel."""
    points = _plate(0.0101)
    plate = _continued([_scan(points, (0.0, 0.0, 0.1))], _in_the_open(points))
    assert plate is not None
    above = plate.normals[:, 2] > 0.7
    assert np.abs(plate.centres[:, :2]).max() < 0.008 + EDGE
    assert plate.areas[above].sum() == pytest.approx((0.0156 + 4 * 0.0004) ** 2, rel=0.1)


def test_where_it_was_voted_down_it_does_not_go_on() -> None:
    """The wall does not continue into voxels with votes of rays without a point."""
    space, scans = _looked_into(), [_scan(_wall(SEEN), (0.0, 0.0, -0.005))]
    voted = replace(space, votes=np.where(space.state == UNKNOWN, 2, 0).astype(np.int16))
    reaches = []
    for each in (space, voted):
        surface = _continued(scans, each)
        assert surface is not None
        rho, z = np.hypot(*surface.centres[:, :2].T), surface.centres[:, 2]
        reaches.append(z[np.abs(rho - RADIUS) < 0.2 * EDGE].max())
    assert reaches[0] > SEEN + 3 * EDGE
    assert reaches[1] < SEEN + 1.5 * EDGE


@pytest.mark.parametrize("thick", [0.0002, 0.0004, 0.0008, 0.0012, 0.002])
def test_a_sheet_has_two_sides_however_thin(thick: float) -> None:
    """A thin sheet with points on both sides has a face on each side, within two voxels of 1 mm."""
    top, below = _plate(0.01 + thick / 2), _plate(0.01 - thick / 2)
    scans = [_scan(top, (0.0, 0.0, 0.1)), _scan(below, (0.0, 0.0, -0.08))]
    sheet = _continued(scans, _in_the_open(np.concatenate([top, below])))
    assert sheet is not None
    assert np.abs(sheet.centres[:, 2] - 0.01).max() < thick / 2 + 1.5 * EDGE
    for side in (1, -1):
        faces = side * sheet.normals[:, 2] > 0.7
        assert sheet.areas[faces].sum() == pytest.approx(0.016**2, rel=0.2)


def test_the_side_of_a_sheet_that_nobody_saw_is_believed() -> None:
    """The unseen side of a thin sheet is part of the believed surface, although it is next to the measured side."""
    points = _plate(0.0102)
    space = _in_the_open(points)
    sheet = _continued([_scan(points, (0.0, 0.0, 0.1))], space)
    assert sheet is not None
    below = sheet.normals[:, 2] < -0.7
    assert sheet.areas[below].sum() == pytest.approx(0.016**2, rel=0.3)
    assert space.is_measured(sheet.centres[below], sheet.normals[below]).mean() > 0.9  # voxels do not distinguish sides


def test_voxels_before_a_wall_are_not_believed() -> None:
    """Voxels of a tube at least half a voxel before the wall are excluded, by comparison with the cylinder."""
    space, wall = _looked_into(), _wall(SEEN)
    hit = tuple(np.floor((np.array([0.0015, 0.0, SEEN + 0.0002]) - space.low) / EDGE).astype(int))
    state = np.array(space.state)
    state[hit] = OCCUPIED
    space, believed = replace(space, state=state), np.ones(state.shape, dtype=np.bool_)
    inward = -wall * (1.0, 1.0, 0.0) / RADIUS
    cloud = PointCloud(wall, inward, np.zeros(len(wall), dtype=np.int32))
    before = belief._ahead_of(cloud, cKDTree(wall), space, believed)
    assert not before[hit]
    assert not before[space.state == FREE].any()
    centres = space.centres(believed)
    rho, z = np.hypot(*centres[:, :2].T).reshape(before.shape), centres[:, 2].reshape(before.shape)
    away = np.asarray(cKDTree(wall).query(centres)[0]).reshape(before.shape)
    sure = (np.abs(RADIUS - rho - 0.5 * EDGE) > 0.05 * EDGE) & (np.abs(away - 4 * EDGE) > 0.01 * EDGE)
    sure &= (space.state == UNKNOWN) & (z > 0)
    expected = (rho < RADIUS - 0.5 * EDGE) & (away < 4 * EDGE)
    assert np.array_equal(before[sure], expected[sure])
    assert expected[sure].sum() > 100


def test_a_stray_point_does_not_change_the_surface() -> None:
    """A single stray point inside a tube, seen from the side, does not change the surface."""
    scans, stray = [_scan(_wall(SEEN), (0.0, 0.0, -0.005))], np.array([[0.0, 0.0, SEEN + 0.002]])
    with_it, without = (_continued([*scans, *more], _looked_into()) for more in ([_scan(stray, (0.1, 0.0, 0.0))], []))
    assert with_it is not None
    assert without is not None
    assert np.array_equal(with_it.faces, without.faces)
    assert np.abs(with_it.vertices - without.vertices).max() < 0.01 * EDGE


def test_where_all_was_seen_nothing_is_believed_beside_it() -> None:
    """A ball seen from six sides has only its own surface."""
    turn, z = np.meshgrid(np.arange(0, 2 * np.pi, 0.08), np.linspace(-1, 1, 60))
    ball = RADIUS * np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z], axis=-1)
    ball, sides = ball.reshape(-1, 3), np.vstack([np.eye(3), -np.eye(3)])
    nearest = np.argmax(ball @ sides.T, axis=1)
    scans = [_scan(ball[nearest == side], tuple(0.1 * sides[side])) for side in range(6)]
    space = _in_the_open(ball)
    centres = space.centres(np.ones(space.state.shape, dtype=np.bool_))
    within = (np.linalg.norm(centres, axis=1) < RADIUS - EDGE).reshape(space.state.shape)
    surface = _continued(scans, replace(space, state=np.where(within, UNKNOWN, space.state).astype(np.uint8)))
    assert surface is not None
    assert surface.areas.sum() == pytest.approx(4 * np.pi * RADIUS**2, rel=0.05)
    assert np.abs(np.linalg.norm(surface.centres, axis=1) - RADIUS).max() < 0.2 * EDGE


def _faces(heights: list[float], sides: list[int]) -> TriangleMesh:
    """Return small horizontal faces at heights [m] above the origin that face up (1) or down (-1)."""
    corner = 1e-5 * np.array([[1.0, 0.0, 0.0], [-0.5, 0.8, 0.0], [-0.5, -0.8, 0.0]])
    vertices = np.concatenate(
        [corner[::side] + np.array([0.0, 0.0, z]) for z, side in zip(heights, sides, strict=True)]
    )
    return TriangleMesh(vertices, np.arange(len(vertices), dtype=np.int32).reshape(-1, 3))


@pytest.mark.parametrize(
    ("heights", "sides", "alike"),
    [
        ([0.0009], [1], True),
        ([0.0011], [1], False),
        ([0.0009], [-1], False),
        ([0.0001, 0.0002, 0.0003], [-1, -1, 1], True),
        ([0.0001, 0.0002, 0.0003, 0.0004], [-1, -1, -1, 1], False),
    ],
)
def test_of_the_three_nearest_faces_one_may_look_alike(heights: list[float], sides: list[int], alike: bool) -> None:
    """One of the three nearest faces within 1 mm with a similar normal is sufficient; farther faces do not count."""
    lid = _faces([0.0], [1])
    assert lid.normals[0, 2] == pytest.approx(1)
    assert belief._has_similar_normal(lid, _faces(heights, sides), 0.001).tolist() == [alike]


def test_a_lone_voxel_has_a_surface() -> None:
    """A single voxel and a row of voxels each have a surface about their centre, although smoothing would remove it."""
    space = _space()
    for size in (1, 9):
        voxels = np.zeros(space.state.shape, dtype=np.bool_)
        voxels[10 : 10 + size, 12, 14] = True
        surface = belief.surface_about(space, voxels)
        assert np.abs(surface.centres.mean(axis=0) - space.centres(voxels).mean(axis=0)).max() < 0.1 * EDGE
        assert 0.5 * EDGE < surface.diagonal < (size + 2) * EDGE


def test_it_is_of_all_scans_with_each_ones_own_side() -> None:
    """Two half walls seen from inside form one wall with normals towards the axis."""
    wall = _wall(SEEN)
    halves = (wall[wall[:, 0] > 0], wall[wall[:, 0] <= 0])
    stands = ((-0.004, 0.0, -0.005), (0.004, 0.0, -0.005))
    surface = _continued([_scan(*each) for each in zip(halves, stands, strict=True)], _looked_into())
    assert surface is not None
    rho, z = np.hypot(*surface.centres[:, :2].T), surface.centres[:, 2]
    seen = (np.abs(rho - RADIUS) < 0.3 * EDGE) & (z > EDGE) & (z < SEEN - EDGE)
    assert surface.areas[seen].sum() == pytest.approx(2 * np.pi * RADIUS * (SEEN - 2 * EDGE), rel=0.1)
    assert (np.einsum("ij,ij->i", surface.normals[seen, :2], surface.centres[seen, :2]) < 0).all()


def test_no_points_are_no_surface() -> None:
    """Without points there is neither a surface to plan on nor a model."""
    for scans in ([], [_scan(np.empty((0, 3)), (0.0, 0.0, 1.0))]):
        assert belief.reconstruct_scans(scans) is None
        assert _continued(scans, _space()) is None
