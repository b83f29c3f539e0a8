"""Views moved so that fewer do: what comes out is measured anew, pose by pose, by the code that fills the matrix."""

import numpy as np
import pytest
import trimesh

from cell.scanners.laser_area import LaserArea
from cell.world.embree import EmbreeRayCaster
from planner.cover import CoverProblem, solve
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import draw_samples
from planner.measurability.visibility import fill_matrix, find_measured
from planner.ports import Rejection
from planner.viewpoints import growth, refinement
from planner.viewpoints.growth import ViewEvaluator
from planner.viewpoints.lines_of_sight import RayTargets, in_view, in_view_matrix
from planner.viewpoints.pose_sampling import perturb_pose
from planner.viewpoints.refinement import ViewState, improve_views, reduce_views
from planner.viewpoints.viewpoints import aim_viewpoints

STANDOFF = 0.1


@pytest.fixture(scope="module")
def case():
    """A ball of 60 mm, 300 samples, 40 candidates that look at its centre, and a cover of 98 % of it."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.03)
    mesh = TriangleMesh(ball.vertices, ball.faces)
    features = draw_samples(mesh, mesh, 300, np.random.default_rng(1))
    scanner = LaserArea(fov_deg=(40, 40), range_mm=(50, 150), baseline_mm=20, sensor_grazing_max_deg=75)
    caster = EmbreeRayCaster(mesh.vertices, mesh.faces)
    outward = np.random.default_rng(2).normal(size=(40, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    candidates = aim_viewpoints(0.03 * outward, outward, np.full(40, -1), [STANDOFF], [0.0])
    M = fill_matrix(candidates, features, scanner, caster)
    chosen = solve(CoverProblem(M.matrix(), features.areas, coverage=0.98), rng=np.random.default_rng(0)).views
    views = ViewState(
        candidates.T_object_scanner[chosen, 0], np.full(len(chosen), STANDOFF), np.arange(len(chosen)),
        np.zeros(len(chosen), dtype=bool), M.matrix().tocsc()[:, chosen].toarray(),
    )  # fmt: skip
    return features, scanner, caster, views


def _arm(scanner, caster, are_reachable=lambda T: np.ones(len(T), dtype=bool)):
    return ViewEvaluator(scanner, (caster,), are_reachable, np.eye(4)[None])


def _fewer(case, *, are_reachable=lambda T: np.ones(len(T), dtype=bool), short=lambda views: 0.0, work=20_000):
    features, scanner, caster, views = case
    areas = features.areas / features.areas.sum()
    goal = float(areas[views.measured.any(axis=1)].sum())
    targets = RayTargets.of(features.points, features.normals)
    arm = _arm(scanner, caster, are_reachable)
    return goal, reduce_views(views, targets, areas, lambda view: arm, goal=goal, short=short, work=work)


def test_fewer_views_measure_as_much(case):
    """Each view's rows are those that it measures when asked alone; views that stay where they were are the same."""
    features, scanner, caster, views = case
    goal, after = _fewer(case)
    assert len(after) < len(views)
    alone = find_measured(after.T_object_scanner[:, None], features, scanner, (caster,), each=True)
    np.testing.assert_array_equal(after.measured, alone)
    assert features.areas[alone.any(axis=1)].sum() / features.areas.sum() >= goal * (1 - 1e-12)
    still = ~after.moved
    np.testing.assert_array_equal(after.T_object_scanner[still], views.T_object_scanner[after.origin[still]])
    R = after.T_object_scanner[:, :3, :3]
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.broadcast_to(np.eye(3), R.shape), atol=1e-12)
    assert len(np.unique(after.origin)) == len(after)


def test_equal_input_gives_equal_views(case):
    """To the bit."""
    (_, one), (_, other) = _fewer(case), _fewer(case)
    np.testing.assert_array_equal(one.T_object_scanner, other.T_object_scanner)


def test_what_the_arm_does_not_take_up_is_not_taken(case):
    """Of an arm that reaches one half of space, no view leaves it; of one that reaches nothing, none moves."""
    _, _, _, views = case
    _, after = _fewer(case, are_reachable=lambda T: T[:, 0, 2, 3] > 0)
    assert (after.T_object_scanner[after.moved, 2, 3] > 0).all()
    _, after = _fewer(case, are_reachable=lambda T: np.zeros(len(T), dtype=bool))
    assert not after.moved.any()
    assert len(after) <= len(views)


def test_views_that_fall_short_elsewhere_are_not_taken(case):
    """A promise that is never kept leaves the views as they were; without work nothing is tried either."""
    _, _, _, views = case
    for after in (_fewer(case, short=lambda views: 0.5)[1], _fewer(case, work=0)[1]):
        assert len(after) == len(views)
        np.testing.assert_array_equal(after.T_object_scanner, views.T_object_scanner)


def _better(case, wanted, are_reachable=lambda T: np.ones(len(T), dtype=bool), which=slice(None)):
    features, scanner, caster, views = case
    targets, arm = RayTargets.of(features.points, features.normals), _arm(scanner, caster, are_reachable)
    return improve_views(views.T_object_scanner[which], views.distance[which], targets, wanted, arm)


def test_each_view_alone_measures_more_where_it_is_moved_to(case):
    """By the rays of each pose alone, whoever stands beside it; where it did not move it is the same to the bit."""
    features, scanner, caster, views = case
    wanted = features.areas * (features.points[:, 0] > 0)
    T, moved_ = _better(case, wanted)
    more = wanted @ find_measured(T[:, None], features, scanner, (caster,), each=True) > wanted @ views.measured
    np.testing.assert_array_equal(more, moved_)
    assert more.mean() > 0.5
    np.testing.assert_array_equal(T[~moved_], views.T_object_scanner[~moved_])
    np.testing.assert_array_equal(_better(case, wanted)[0], T)
    np.testing.assert_array_equal(_better(case, wanted, which=[2])[0][0], T[2])
    assert [len(each) for each in _better(case, wanted, which=[])] == [0, 0]


def test_each_round_measures_more(case, monkeypatch):
    """Smaller steps after large ones find what these did not; no view goes farther than the steps allow."""
    features, _, _, views = case
    rounds = []
    for count in (1, 2, 3):
        monkeypatch.setattr(refinement, "SINGLE_SCALES", (1.0, 0.5, 0.25)[:count])
        T, _ = _better(case, features.areas)
        way = np.linalg.norm(T[:, :3, 3] - views.T_object_scanner[:, :3, 3], axis=1)
        turn = 2 * np.sin(np.sqrt(3) * np.radians(15) / 2)
        assert way.max() <= STANDOFF * sum(refinement.SINGLE_SCALES) * (turn + np.sqrt(3) * 0.15)
        rounds.append(
            float(np.sum(features.areas @ find_measured(T[:, None], features, *case[1:2], (case[2],), each=True)))
        )
    assert rounds == sorted(rounds)
    assert rounds[0] < rounds[2]


def test_what_the_arm_does_not_take_up_is_not_better(case):
    """Views stay where an arm takes up nothing else; of an arm that reaches one half of space none leaves it."""
    features, _, _, views = case
    T, moved_ = _better(case, features.areas, lambda T: np.zeros(len(T), dtype=bool))
    assert not moved_.any()
    np.testing.assert_array_equal(T, views.T_object_scanner)
    T, moved_ = _better(case, features.areas, lambda T: T[:, 0, 2, 3] > 0)
    assert moved_.any()
    assert (T[moved_, 2, 3] > 0).all()


def test_moved_poses_stay_about_their_aim():
    """Turned about the point, then shifted by no more than the share; a share of 0 moves nothing."""
    T = aim_viewpoints(np.zeros((1, 3)), np.array([[0.6, 0.0, 0.8]]), np.array([-1]), [0.2], [0.3]).T_object_scanner[
        0, 0
    ]
    for share in (0.0, 0.5, 1.0):
        found = perturb_pose(T, 0.2, share, (0, 200), 3)
        aim = found[:, :3, 3] + 0.2 * found[:, :3, 2]
        assert np.abs(aim).max() <= 0.15 * share * 0.2 + 1e-12
        turn = np.arccos(np.clip((np.einsum("nij,ij->n", found[:, :3, :3], T[:3, :3]) - 1) / 2, -1, 1))
        assert np.degrees(turn).max() <= 15 * share * np.sqrt(3) + 1e-5


def test_a_view_that_may_be_worth_more_is_asked_in_full(case):
    """Where a bound is named, all that measure more than that stay as they are, and nothing else counts."""
    features, scanner, caster, views = case
    targets, rows = RayTargets.of(features.points, features.normals), np.arange(0, 300, 2)
    T, area = perturb_pose(views.T_object_scanner[0], STANDOFF, 1.0, (0, 60), 0), features.areas[rows]
    arm = _arm(scanner, caster)
    whole = arm.measured(T, targets, rows)
    np.testing.assert_array_equal(whole, find_measured(T[:, None], features, scanner, (caster,), each=True)[rows])
    least = float(np.median(area @ whole)) * (1 + 1e-9)
    asked = arm.measured(T, targets, rows, (area, least))
    for pose in range(60):
        same, none = np.array_equal(asked[:, pose], whole[:, pose]), not asked[:, pose].any()
        assert same or (none and area @ whole[:, pose] <= least)
    assert 0 < asked.any(axis=0).sum() < 60


def test_poses_that_are_asked_together_are_asked_as_alone(case, monkeypatch):
    """Whatever goes into one look; also where each point has the limits of its region."""
    features, scanner, caster, views = case
    region = (np.arange(len(features.points)) % 3).astype(np.int32)
    targets, rows = RayTargets.of(features.points, features.normals, region), np.arange(1, 300, 2)
    T, arm = perturb_pose(views.T_object_scanner[0], STANDOFF, 1.0, (0, 12), 0), _arm(_OfRegions(scanner), caster)
    sighted = in_view_matrix(targets, T, arm.scanner, rows)
    for pose, seen in zip(T, sighted, strict=True):
        np.testing.assert_array_equal(rows[seen], in_view(targets, pose, arm.scanner, rows))
    assert not sighted[:, region[rows] == 1].any()
    assert sighted.any()
    whole = arm.measured(T, targets, rows)
    monkeypatch.setattr(growth, "_PAIRS", 5 * len(rows))
    np.testing.assert_array_equal(arm.measured(T, targets, rows), whole)
    assert whole[:, 5:].any()


class _OfRegions:
    """A scanner that measures nothing of region 1."""

    def __init__(self, scanner):
        self._scanner = scanner

    def __getattr__(self, name):
        return getattr(self._scanner, name)

    def reject_in(self, points, normals, region):
        """Its codes."""
        return np.where(region == 1, Rejection.OUT_OF_RANGE, self._scanner.reject(points, normals)).astype(np.uint8)
