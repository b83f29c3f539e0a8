"""Pose search: fewer views of a ball than any selection of its candidates, checked with exact rays."""

import numpy as np
import pytest
import trimesh

from cell.plan.pose_search import draw_evaluated
from cell.scanners.laser_area import LaserArea
from cell.world.embree import EmbreeRayCaster
from cell.world.measurability import PartSurface
from planner.cover import CoverProblem, solve
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import draw_samples
from planner.measurability.direction_table import DirectionTable
from planner.measurability.visibility import fill_matrix, find_measured
from planner.viewpoints.lines_of_sight import RayTargets
from planner.viewpoints.pose_search import Place, SearchPoses, search_poses
from planner.viewpoints.viewpoints import aim_viewpoints, viewpoints_from_poses

N = 40


BALL = trimesh.creation.icosphere(subdivisions=4, radius=0.03)


def _everywhere(T):
    return np.ones(len(T), dtype=bool)


@pytest.fixture(scope="module")
def case():
    """Return a ball of 60 mm, 600 samples, 40 candidates aimed at its centre, and a cover of 98 % of it."""
    mesh = TriangleMesh(BALL.vertices, BALL.faces)
    samples = draw_samples(mesh, mesh, 600, np.random.default_rng(1))
    scanner = LaserArea(fov_deg=(40, 40), range_mm=(50, 150), baseline_mm=20, sensor_grazing_max_deg=75)
    caster = EmbreeRayCaster(mesh.vertices, mesh.faces)
    outward = np.random.default_rng(2).normal(size=(N, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    candidates = aim_viewpoints(0.03 * outward, outward, np.full(N, -1), [0.1], [0.0])
    M = fill_matrix(candidates, samples, scanner, caster)
    selection = solve(CoverProblem(M.matrix(), samples.areas, coverage=0.98), rng=np.random.default_rng(0)).views
    pool = SearchPoses(
        candidates.T_object_scanner[:, 0],
        np.full(N, 0.1),
        np.arange(N),
        np.zeros(N, dtype=bool),
        np.zeros(N, dtype=int),
    )
    table = DirectionTable.build(RayTargets.of(samples.points, samples.normals), scanner, caster, (), (0.05, 0.16))
    return samples, scanner, caster, pool, np.sort(selection), table


def _measured_share(case, views):
    samples, scanner, caster = case[:3]
    return float(find_measured(views.T_object_scanner[:, None], samples, scanner, (caster,)).mean())


def _search(case, *, are_reachable=_everywhere, required=0.98, effort=60_000, seed=0):
    pool, selection, table = case[3:]
    return search_poses(
        selection, pool, [Place(table, are_reachable)], np.full(len(table), 1 / len(table)),
        shortfall=lambda views: required - _measured_share(case, views), effort=effort,
        rng=np.random.default_rng(seed),
    )  # fmt: skip


def test_fewer_views_measure_as_much(case):
    """The search leaves out views that no selection of candidates can spare; exact rays confirm the coverage."""
    found = _search(case).found[-1]
    assert len(found) < len(case[4])
    assert _measured_share(case, found) >= 0.98
    still = ~found.moved
    np.testing.assert_array_equal(found.T_object_scanner[still], case[3].T_object_scanner[found.origin[still]])
    R = found.T_object_scanner[:, :3, :3]
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.broadcast_to(np.eye(3), R.shape), atol=1e-9)


def test_equal_seed_gives_equal_views(case):
    """Equal inputs give equal views to the bit."""
    one, other = _search(case, effort=20_000), _search(case, effort=20_000)
    np.testing.assert_array_equal(one.found[-1].T_object_scanner, other.found[-1].T_object_scanner)
    assert one.evaluated == other.evaluated


def test_moved_views_are_reachable(case):
    """With half of space reachable no moved view leaves it."""
    found = _search(case, are_reachable=lambda T: T[:, 2, 3] > 0, effort=20_000).found[-1]
    assert (found.T_object_scanner[found.moved, 2, 3] > 0).all()


def test_views_that_fall_short_are_not_taken(case):
    """With a requirement that nothing meets, or without effort, the initial views are returned."""
    for found in (_search(case, required=2.0, effort=5_000), _search(case, effort=0)):
        np.testing.assert_array_equal(np.sort(found.found[-1].origin), case[4])
        assert not found.found[-1].moved.any()


def test_effort_limits_the_evaluated_poses(case):
    """The search ends with the round in which the effort is exhausted; without fewer views, a tenth is left."""
    found = _search(case, required=2.0, effort=5_000)
    assert 4_500 <= found.evaluated <= 4_500 + 12 * len(case[4])


def test_candidates_are_added_if_too_many_views_were_left_out(case):
    """Of 40 views that cannot move, exactly the two with the smallest area of their own can be spared."""
    samples, _, caster, pool, _, _ = case
    scanner = LaserArea(fov_deg=(6, 6), range_mm=(50, 150), baseline_mm=5, sensor_grazing_max_deg=75)
    targets = RayTargets.of(samples.points, samples.normals)
    narrow = DirectionTable.build(targets, scanner, caster, (), (0.05, 0.16))
    measured = find_measured(pool.T_object_scanner[:, None], samples, scanner, (caster,), each=True)

    def without(left: np.ndarray) -> float:
        return float(measured[:, left].any(axis=1).mean())

    fewest = np.arange(N)
    for _ in range(2):
        shares = [without(np.delete(fewest, k)) for k in range(len(fewest))]
        fewest = np.delete(fewest, int(np.argmax(shares)))
    required = without(fewest)
    assert max(without(np.delete(fewest, k)) for k in range(len(fewest))) < required

    def share(views: SearchPoses) -> float:
        return float(find_measured(views.T_object_scanner[:, None], samples, scanner, (caster,)).mean())

    found = search_poses(
        np.arange(N), pool, [Place(narrow, lambda T: np.zeros(len(T), dtype=bool))], np.full(600, 1 / 600),
        shortfall=lambda views: required - share(views), effort=60_000, rng=np.random.default_rng(0),
    ).found  # fmt: skip
    assert [len(views) for views in found] == [40, 38]
    assert share(found[-1]) >= required


@pytest.mark.parametrize("n_poses", [2, N])
def test_evaluated_samples_grow_with_the_views_and_weigh_the_surface(case, n_poses):
    """10, 30 and 90 views are evaluated on 12,000, 18,000 and 40,000 samples; their weights are shares of the area.

    Two poses measure less than half of the surface. The rest takes half of the samples.
    """
    _, scanner, caster, pool = case[:4]
    T = pool.T_object_scanner[:n_poses]
    candidates = viewpoints_from_poses(T, np.zeros((n_poses, 3)), np.full(n_poses, -1))
    mesh = TriangleMesh(BALL.vertices, BALL.faces)
    rows = draw_samples(mesh, mesh, 4 * len(mesh.faces), np.random.default_rng(3))
    M, usable = fill_matrix(candidates, rows, scanner, caster), np.ones(n_poses, dtype=bool)
    for n_views, count in ((10, 12_000), (30, 18_000), (90, 40_000)):
        samples, weights = draw_evaluated(
            [(M, usable)], PartSurface(mesh, mesh, rows, caster), n_views, np.random.default_rng(0)
        )
        assert 0.98 * count <= len(samples) <= 1.01 * count
        is_measured = find_measured(T[:, None], samples, scanner, (caster,))
        assert is_measured.mean() > 0.45
        share = float(find_measured(T[:, None], rows, scanner, (caster,)).mean())
        assert float(weights[is_measured].sum() / weights.sum()) == pytest.approx(share, abs=0.01)
