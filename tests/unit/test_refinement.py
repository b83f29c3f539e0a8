"""Refined views: the code that fills the matrix measures the result again, pose by pose."""

from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from cell.explore.refinement import improve_views
from cell.scanners.laser_area import LaserArea
from cell.world.embree import EmbreeRayCaster
from planner.cover import CoverProblem, solve
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import draw_samples
from planner.measurability.visibility import fill_matrix, find_measured
from planner.ports import Rejection
from planner.viewpoints.growth import ViewEvaluator
from planner.viewpoints.lines_of_sight import RayTargets, in_view, in_view_matrix
from planner.viewpoints.pose_sampling import perturb_pose
from planner.viewpoints.viewpoints import aim_viewpoints

STANDOFF = 0.1


@pytest.fixture(scope="module")
def case():
    """Return a ball of 60 mm, 300 samples, 40 candidates aimed at its centre, and a cover of 98 % of it."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.03)
    mesh = TriangleMesh(ball.vertices, ball.faces)
    samples = draw_samples(mesh, mesh, 300, np.random.default_rng(1))
    scanner = LaserArea(fov_deg=(40, 40), range_mm=(50, 150), baseline_mm=20, sensor_grazing_max_deg=75)
    caster = EmbreeRayCaster(mesh.vertices, mesh.faces)
    outward = np.random.default_rng(2).normal(size=(40, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    candidates = aim_viewpoints(0.03 * outward, outward, np.full(40, -1), [STANDOFF], [0.0])
    M = fill_matrix(candidates, samples, scanner, caster)
    selection = solve(CoverProblem(M.matrix(), samples.areas, coverage=0.98), rng=np.random.default_rng(0)).views
    poses, n = candidates.T_object_scanner[selection, 0], len(selection)
    measured = M.matrix().tocsc()[:, selection].toarray()
    views = SimpleNamespace(T_object_scanner=poses, distance=np.full(n, STANDOFF), measured=measured)
    return samples, scanner, caster, views


def _evaluator(scanner, caster, are_reachable=lambda T: np.ones(len(T), dtype=bool)):
    return ViewEvaluator(scanner, (caster,), are_reachable, np.eye(4)[None])


def _improve(case, weights, are_reachable=lambda T: np.ones(len(T), dtype=bool), which=slice(None)):
    samples, scanner, caster, views = case
    targets, evaluator = RayTargets.of(samples.points, samples.normals), _evaluator(scanner, caster, are_reachable)
    return improve_views(views.T_object_scanner[which], views.distance[which], targets, weights, evaluator)


def test_each_improved_view_measures_more_by_itself(case):
    """Each moved view measures more by its own rays, and a view that did not move is unchanged to the bit."""
    samples, scanner, caster, views = case
    weights = samples.areas * (samples.points[:, 0] > 0)
    T, moved_ = _improve(case, weights)
    more = weights @ find_measured(T[:, None], samples, scanner, (caster,), each=True) > weights @ views.measured
    np.testing.assert_array_equal(more, moved_)
    assert more.mean() > 0.5
    np.testing.assert_array_equal(T[~moved_], views.T_object_scanner[~moved_])
    np.testing.assert_array_equal(_improve(case, weights)[0], T)
    np.testing.assert_array_equal(_improve(case, weights, which=[2])[0][0], T[2])
    assert [len(each) for each in _improve(case, weights, which=[])] == [0, 0]


def test_unreachable_poses_do_not_improve_a_view(case):
    """With half of space reachable no view leaves it, and with nothing else reachable all views stay."""
    samples, _, _, views = case
    T, moved_ = _improve(case, samples.areas, lambda T: np.zeros(len(T), dtype=bool))
    assert not moved_.any()
    np.testing.assert_array_equal(T, views.T_object_scanner)
    T, moved_ = _improve(case, samples.areas, lambda T: T[:, 0, 2, 3] > 0)
    assert moved_.any()
    assert (T[moved_, 2, 3] > 0).all()


def test_perturbed_poses_stay_near_their_aim():
    """Poses are turned about the point and then shifted by at most the share. A share of 0 has no effect."""
    view = aim_viewpoints(np.zeros((1, 3)), np.array([[0.6, 0.0, 0.8]]), np.array([-1]), [0.2], [0.3])
    T = view.T_object_scanner[0, 0]
    for share in (0.0, 0.5, 1.0):
        found = perturb_pose(T, 0.2, share, (0, 200), 3)
        aim = found[:, :3, 3] + 0.2 * found[:, :3, 2]
        assert np.abs(aim).max() <= 0.15 * share * 0.2 + 1e-12
        turn = np.arccos(np.clip((np.einsum("nij,ij->n", found[:, :3, :3], T[:3, :3]) - 1) / 2, -1, 1))
        assert np.degrees(turn).max() <= 15 * share * np.sqrt(3) + 1e-5


def test_views_above_the_threshold_are_evaluated_in_full(case):
    """Views that measure more than the threshold have all their rows; others have all or none."""
    samples, scanner, caster, views = case
    targets, rows = RayTargets.of(samples.points, samples.normals), np.arange(0, 300, 2)
    T, area = perturb_pose(views.T_object_scanner[0], STANDOFF, 1.0, (0, 60), 0), samples.areas[rows]
    evaluator = _evaluator(scanner, caster)
    full = evaluator.measured(T, targets, rows)
    np.testing.assert_array_equal(full, find_measured(T[:, None], samples, scanner, (caster,), each=True)[rows])
    threshold = float(np.median(area @ full)) * (1 + 1e-9)
    found = evaluator.measured(T, targets, rows, (area, threshold))
    for pose in range(60):
        same, none = np.array_equal(found[:, pose], full[:, pose]), not found[:, pose].any()
        assert same or (none and area @ full[:, pose] <= threshold)
    assert 0 < found.any(axis=0).sum() < 60


def test_poses_evaluated_together_give_the_result_of_each_alone(case):
    """The result of a pose is independent of the other poses, also with limits of the regions."""
    samples, scanner, caster, views = case
    region = (np.arange(len(samples.points)) % 3).astype(np.int32)
    targets, rows = RayTargets.of(samples.points, samples.normals, region), np.arange(1, 300, 2)
    T = perturb_pose(views.T_object_scanner[0], STANDOFF, 1.0, (0, 12), 0)
    evaluator = _evaluator(_RegionalScanner(scanner), caster)
    visible = in_view_matrix(targets, T, evaluator.scanner, rows)
    for pose, seen in zip(T, visible, strict=True):
        np.testing.assert_array_equal(rows[seen], in_view(targets, pose, evaluator.scanner, rows))
    assert not visible[:, region[rows] == 1].any()
    assert visible.any()
    full = evaluator.measured(T, targets, rows)
    for pose in range(12):
        np.testing.assert_array_equal(evaluator.measured(T[pose : pose + 1], targets, rows)[:, 0], full[:, pose])
    assert full[:, 5:].any()


class _RegionalScanner:
    """A scanner that measures no point of region 1."""

    def __init__(self, scanner):
        self._scanner = scanner

    def __getattr__(self, name):
        return getattr(self._scanner, name)

    def reject_in(self, points, normals, region):
        """Reject every point of region 1."""
        return np.where(region == 1, Rejection.OUT_OF_RANGE, self._scanner.reject(points, normals)).astype(np.uint8)
