"""The surface of all points, where it leads and where not: a tube that was looked into, a plate in the open."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from cell.explore import measured_surface
from cell.reconstruction.cloud import PointCloud
from planner.explore.space import FREE, OCCUPIED, UNKNOWN, VoxelSpace
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
    return VoxelSpace.of_cylinder(0.02, 0.05, EDGE, 0.0005)


def _looked_into() -> VoxelSpace:
    """A tube's first millimetres were seen; free is what lies before the mouth, and in the tube as deep as that."""
    space = _space()
    state = np.full(space.state.shape, UNKNOWN, np.uint8)
    x, y, z = np.moveaxis(np.stack(np.meshgrid(*(space.low[i] + EDGE * (np.arange(n) + 0.5)
                          for i, n in enumerate(state.shape)), indexing="ij"), axis=-1), -1, 0)  # fmt: skip
    state[(z < 0) | ((np.hypot(x, y) < RADIUS) & (z < SEEN))] = FREE
    points = _wall(SEEN)
    state[tuple(np.floor((points - space.low) / EDGE).astype(int).T)] = OCCUPIED
    return replace(space, state=state, points=points)


def test_the_wall_of_a_tube_goes_on_and_a_lid_stands_where_it_ends() -> None:
    """It is continued by four voxels on the same cylinder; behind it the tube is closed, before it nothing is."""
    surface = measured_surface.continued([_scan(_wall(SEEN), (0.0, 0.0, -0.005))], _looked_into())
    assert surface is not None
    rho, z = np.hypot(*surface.centres[:, :2].T), surface.centres[:, 2]
    wall = (np.abs(rho - RADIUS) < 0.3 * EDGE) & (z > SEEN) & (z < SEEN + 3 * EDGE)
    around = surface.areas[wall].sum() / (2 * np.pi * RADIUS * 3 * EDGE)
    assert around == pytest.approx(1.0, abs=0.05)
    inside = (rho < RADIUS - 2 * EDGE) & (z > -2 * EDGE) & (z < 0.015)
    assert surface.areas[inside].sum() > np.pi * (RADIUS - 2 * EDGE) ** 2
    assert z[inside].min() > SEEN - EDGE
    assert z[inside & (rho < EDGE)].min() < SEEN + EDGE  # the axis is too far from the wall for it to say anything
    assert z[inside & (rho > 2 * EDGE)].min() > SEEN + 1.5 * EDGE  # before the wall that goes on nothing is believed
    beside = (np.abs(rho - RADIUS) > 0.5 * EDGE) & (np.abs(rho - RADIUS) < 1.4 * EDGE)
    assert not (beside & (z > 0) & (z < SEEN + 2 * EDGE)).any()


def test_where_a_point_is_known_no_lid_stands() -> None:
    """Also of one that the surface leaves out; where none is the lid stands."""
    scans, space = [_scan(_wall(SEEN), (0.0, 0.0, -0.005))], _looked_into()
    lid = measured_surface.continued(scans, space)
    assert lid is not None
    end = lid.centres[(np.hypot(*lid.centres[:, :2].T) < RADIUS - 2 * EDGE) & (lid.centres[:, 2] < 0.015)]
    half = end[end[:, 0] > 0]
    surface = measured_surface.continued(scans, replace(space, points=np.concatenate([space.points, half])))
    assert surface is not None
    away = cKDTree(surface.centres)
    assert away.query(half)[0].min() > 1e-6
    assert away.query(end[end[:, 0] < -EDGE])[0].max() < 1e-9


def test_where_space_was_seen_free_it_does_not_go_on() -> None:
    """A plate in the open ends where its points end, to within a voxel."""
    space, (x, y) = _space(), np.meshgrid(np.arange(-0.008, 0.008, 0.0004), np.arange(-0.008, 0.008, 0.0004))
    points = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 0.0101)])
    state = np.full(space.state.shape, FREE, np.uint8)
    state[tuple(np.floor((points - space.low) / EDGE).astype(int).T)] = OCCUPIED
    plate = measured_surface.continued([_scan(points, (0.0, 0.0, 0.1))], replace(space, state=state, points=points))
    assert plate is not None
    assert np.abs(plate.centres[:, :2]).max() < 0.008 + EDGE
    assert plate.areas.sum() == pytest.approx((0.0156 + 4 * 0.0004) ** 2, rel=0.1)


def test_points_that_lie_apart_are_the_first_of_their_cubes() -> None:
    """One of each cube, on either side of the origin, in their order; of none, none."""
    wall = _wall(SEEN, 0.0001) - (0.0, 0.0, 0.5 * SEEN)
    kept = measured_surface._apart(wall, 0.0005)
    cubes = np.floor(wall / 0.0005)
    _, first = np.unique(cubes, axis=0, return_index=True)
    assert kept.tolist() == sorted(first.tolist())
    assert 0 < len(kept) < len(wall) / 20
    assert len(measured_surface._apart(np.empty((0, 3)), 0.0005)) == 0


def test_what_it_is_made_of_is_as_fine_as_the_voxels_ask(monkeypatch: pytest.MonkeyPatch) -> None:
    """However many scans there are of one place."""
    asked = list[tuple[PointCloud, dict[str, float]]]()

    def spy(cloud: PointCloud, **how: float) -> Any:
        asked.append((cloud, how))
        return SimpleNamespace(mesh=None)

    monkeypatch.setattr(measured_surface, "reconstruct", spy)
    scans = [_scan(_wall(SEEN, apart), (0.0, 0.0, -0.005)) for apart in (0.0001, 0.00013)]
    assert measured_surface.continued(scans, _looked_into()) is None
    ((cloud, how),) = asked
    cubes = np.floor(cloud.points / (0.5 * EDGE))
    assert len(np.unique(cubes, axis=0)) == len(cloud) > 800
    assert how == {"grid": pytest.approx(0.75 * EDGE), "reach": pytest.approx(4 * EDGE)}


def test_it_is_of_all_scans_with_each_ones_own_side() -> None:
    """Two half walls, seen from within, are one: what is continued begins where both end."""
    wall = _wall(SEEN)
    halves = (wall[wall[:, 0] > 0], wall[wall[:, 0] <= 0])
    stands = ((-0.004, 0.0, -0.005), (0.004, 0.0, -0.005))
    surface = measured_surface.continued([_scan(*each) for each in zip(halves, stands, strict=True)], _looked_into())
    assert surface is not None
    rho, z = np.hypot(*surface.centres[:, :2].T), surface.centres[:, 2]
    seen = (np.abs(rho - RADIUS) < 0.3 * EDGE) & (z > EDGE) & (z < SEEN - EDGE)
    assert surface.areas[seen].sum() == pytest.approx(2 * np.pi * RADIUS * (SEEN - 2 * EDGE), rel=0.1)
    assert (np.einsum("ij,ij->i", surface.normals[seen, :2], surface.centres[seen, :2]) < 0).all()


def test_no_points_are_no_surface() -> None:
    """Neither to plan on nor as a model."""
    for scans in ([], [_scan(np.empty((0, 3)), (0.0, 0.0, 1.0))]):
        assert measured_surface.surface_of(scans) is None
        assert measured_surface.continued(scans, _space()) is None
