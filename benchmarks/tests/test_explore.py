"""Benchmark of next views: its rivals compared with closed forms, published bounds and brute force."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from benchmarks.exploring import boundary, density, rivals
from benchmarks.exploring.lab import Knowledge, Lab, explored
from benchmarks.exploring.ours import stepwise
from benchmarks.exploring.policies import RIVALS, TUNED
from benchmarks.exploring.view_spaces import VIEW_SPACES
from planner.explore.space import FREE, OCCUPIED, UNKNOWN


@pytest.fixture(scope="module")
def ball(tmp_path_factory: pytest.TempPathFactory) -> Lab:
    """Return a ball of 120 mm, of which every view of the view sphere measures the same share."""
    path = tmp_path_factory.mktemp("lab") / "ball.stl"
    trimesh.creation.icosphere(subdivisions=4, radius=60.0).export(path)
    return Lab.of(str(path), "mm")


def test_random_views_of_a_ball_cover_what_random_caps_do(ball: Lab) -> None:
    """Random caps, n of a share f of a sphere, leave (1 - f)^n of it uncovered on average (Solomon 1978)."""
    rng, n, times = np.random.default_rng(0), 5, 12
    next_view = rivals.random("sphere, middle")(ball, rng)
    known = Knowledge(ball.unknown, (ball.first_view(rng),))
    poses = [T for _ in range(n * times) if (T := next_view(known)) is not None]
    shares = np.array([ball.by_views((T,))[0] for T in poses[:8]])
    assert shares.std() < 0.01  # of a faceted ball, whose 100,000 samples scatter
    covered = np.array([ball.by_views(tuple(poses[k * n : k * n + n]))[-1] for k in range(times)])
    expected = 1 - (1 - shares.mean()) ** n
    assert abs(covered.mean() - expected) < 4 * covered.std() / np.sqrt(times)
    assert abs(covered.mean() - expected) < 0.1 * expected


def test_farthest_first_views_cover_the_sphere_as_gonzalez_promises(ball: Lab) -> None:
    """Every direction is within twice the covering radius of 12 caps from one of 12 views.

    The covering radius is 37.377 degrees (icosahedron).
    """
    next_view = rivals.uniform("sphere, middle")(ball, np.random.default_rng(0))
    known = Knowledge(ball.unknown, (ball.first_view(np.random.default_rng(0)),))
    while len(known.poses) < 12:
        T = next_view(known)
        assert T is not None
        known = Knowledge(known.space, (*known.poses, T))
    views = np.stack([T[:3, 3] / np.linalg.norm(T[:3, 3]) for T in known.poses])
    directions = VIEW_SPACES["sphere, middle"](ball, 5000)[:, :3, 3]
    directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    farthest = np.degrees(np.arccos(np.clip((directions @ views.T).max(axis=1), -1, 1))).max()
    assert 37.3 < farthest < 2 * 37.377


def test_unknown_voxels_along_rays_are_those_of_brute_force() -> None:
    """A ray counts the voxel under each of its steps until one is occupied."""
    rng = np.random.default_rng(3)
    state = rng.choice([UNKNOWN, FREE, OCCUPIED], size=(9, 8, 7), p=[0.5, 0.48, 0.02]).astype(np.uint8)
    low, edge, source = np.array([-0.9, -0.8, -0.7]), 0.2, np.array([-2.0, 0.13, 0.07])
    directions = rng.normal(size=(200, 3)) * [0.3, 0.3, 0.3] + [1, 0, 0]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    expected = 0
    for ray in directions:
        spans = np.sort(np.stack([(low - source) / ray, (low + edge * np.array(state.shape) - source) / ray]), axis=0)
        for at in np.arange(max(0.1, spans[0].max()) + 0.5 * edge, min(9.0, spans[1].min()), edge):
            met = state[tuple(np.floor((source + at * ray - low) / edge).astype(int))]
            if met == OCCUPIED:
                break
            expected += met == UNKNOWN
    assert abs(int(rivals._crossed(source, directions, 0.1, 9.0, low, edge, state)) - expected) <= 2  # rounded ends


def test_the_frontier_of_a_patch_is_its_border(ball: Lab) -> None:
    """Frontier points of an evenly measured square lie near its border.

    Every part of the border is near a frontier point.
    """
    explorer = density._Explorer(ball, 12.0, most=True)
    spacing = explorer._radius / density._CELLS
    side = np.arange(40) * spacing
    points = np.stack([*np.meshgrid(side, side), np.zeros((40, 40))], axis=-1).reshape(-1, 3)
    frontier = points[explorer._frontier(points, cKDTree(points))]
    inside = np.minimum(frontier, side[-1] - frontier)[:, :2].min(axis=1)
    assert len(frontier)
    assert inside.max() < explorer._radius
    border = points[np.minimum(points, side[-1] - points)[:, :2].min(axis=1) == 0]
    assert cKDTree(frontier).query(border)[0].max() < explorer._radius


def test_boundary_points_have_a_sector_without_neighbours() -> None:
    """A direct search over directions finds the same boundary points: 120 degrees about the normal are empty."""
    rng = np.random.default_rng(4)
    points = np.column_stack([rng.random((600, 2)), np.zeros(600)])
    points = points[np.linalg.norm(points[:, :2] - 0.5, axis=1) > 0.2]  # a hole
    near = cKDTree(points).query(points, 13)[1][:, 1:]
    turned = trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]
    normals = np.tile(turned[:, 2], (len(points), 1))
    found = boundary.is_boundary(points @ turned.T, normals, near)
    for at, others, is_found in zip(points, near, found, strict=True):
        turns = np.degrees(np.arctan2(*(points[others] - at)[:, 1::-1].T))
        clear = [np.abs((turns - middle + 180) % 360 - 180).min() for middle in np.arange(0, 360, 0.25)]
        if abs(max(clear) - 60) > 0.2:
            assert is_found == (max(clear) > 60)
    assert 0.05 < found.mean() < 0.5


def test_boundary_views_look_at_the_rim_of_the_measured_cap(ball: Lab) -> None:
    """After one view of a ball the next one looks at the rim of the measured cap, from the working distance."""
    rng = np.random.default_rng(2)
    known = ball.observe(Knowledge(ball.unknown), ball.first_view(rng))
    T = boundary.boundary(ball, rng)(known)
    assert T is not None
    target = T[:3, 3] + ball.middle_range * T[:3, 2]
    assert abs(np.linalg.norm(target) - 0.06) < 2e-3
    towards = known.poses[0][:3, 3] / np.linalg.norm(known.poses[0][:3, 3])
    assert (known.points[0] @ towards < float(target @ towards)).mean() < 0.1


@pytest.mark.parametrize("name", ["stepwise", *RIVALS])
def test_every_policy_sees_more_of_a_ball_with_each_view(name: str, ball: Lab) -> None:
    """Equal seeds give equal views from free space, and coverage grows."""
    policy = stepwise if name == "stepwise" else RIVALS[name][0](TUNED[name])
    known, by_views = explored(ball, policy, 1, 3)
    again, _ = explored(ball, policy, 1, 2)
    assert np.array_equal(known.poses[:2], again.poses)
    assert by_views[-1] > by_views[0] > 0.1
    assert all(np.hypot(*T[:2, 3]) > ball.cylinder.radius or abs(T[2, 3]) > 0.06 for T in known.poses)


def test_an_explored_ball_is_judged_as_it_was_seen(ball: Lab) -> None:
    """A view from far above measures at most the cap in which its rays meet the ball at the incidence limit."""
    T = ball.first_view(np.random.default_rng(0))
    assert len(ball.observe(Knowledge(ball.unknown), T).space.between) > 100  # towards the ball's edge
    away = np.linalg.norm(T[:3, 3])
    limit = np.radians(75.0)
    cap = limit - np.arcsin(0.06 * np.sin(np.pi - limit) / away)  # at the centre, where a ray meets the ball at 75 deg
    assert 0.8 * (1 - np.cos(cap)) / 2 < ball.by_views((T,))[0] <= (1 - np.cos(cap)) / 2 + 0.002
