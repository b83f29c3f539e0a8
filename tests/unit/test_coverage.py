"""Coverage as a share of area, by visibility and by scan points."""

import numpy as np
import pytest

from cell.scanners.laser_area import LaserArea
from cell.world.prediction import Prediction
from planner.errors import PlannerError
from planner.geometry.sampling import SurfaceSamples, draw_samples
from planner.measurability import coverage
from planner.measurability.visibility import VisibilityMemo, find_measured
from planner.viewpoints.viewpoints import optimal_scanning_zone
from tests.support.meshes import block, caster_of

SCANNER = LaserArea(resolution_deg=(1, 1))
SLAB = block((0.2, 0.1, 0.01), (0.1, 0.05, 0.005))


def _samples(points, areas):
    points = np.asarray(points, dtype=float)
    n = len(points)
    return SurfaceSamples(points, np.tile([0, 0, 1.0], (n, 1)), areas, np.zeros(n), np.zeros(n))


def test_fractions_are_of_area_not_of_count():
    """The fraction is of area: one large covered sample outweighs three small uncovered ones."""
    samples = _samples([[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]], [7, 1, 1, 1])
    near = coverage.sampled_coverage(np.array([[0, 0, 0.05]]), samples, 0.1)
    assert near.fraction == 0.7
    assert near.covered.sum() == 1
    assert near.covered.tolist() == [True, False, False, False]


def test_the_radius_is_inclusive_and_sharp():
    """A scan point exactly at the radius covers a sample, and one beyond it does not."""
    samples = _samples([[0, 0, 0]], [1])
    assert coverage.sampled_coverage(np.array([[0.5, 0, 0]]), samples, 0.5).fraction == 1
    assert coverage.sampled_coverage(np.array([[np.nextafter(0.5, 1), 0, 0]]), samples, 0.5).fraction == 0


def test_sampled_coverage_equals_all_distances():
    """The search tree gives the result of the matrix of all distances."""
    rng = np.random.default_rng(3)
    points, scan_points = rng.random((500, 3)), rng.random((80, 3))
    result = coverage.sampled_coverage(scan_points, _samples(points, np.ones(500)), 0.12)
    nearest = np.linalg.norm(points[:, None] - scan_points, axis=2).min(axis=1)
    assert (result.covered == (nearest <= 0.12)).all()
    assert 0.1 < result.fraction < 0.9


def test_the_radius_is_one_percent_of_the_diagonal():
    """The radius is 1 % of the diagonal, which is 223.83 mm for 200 x 100 x 10 mm."""
    assert coverage.sampling_radius(SLAB) == pytest.approx(0.01 * np.sqrt(0.2**2 + 0.1**2 + 0.01**2))


def test_no_scan_point_covers_nothing_and_broken_input_is_refused():
    """An empty cloud covers nothing. NaN and a radius of zero are refused."""
    samples = _samples([[0, 0, 0]], [1])
    assert coverage.sampled_coverage(np.zeros((0, 3)), samples, 0.1).fraction == 0
    with pytest.raises(PlannerError, match="finite"):
        coverage.sampled_coverage(np.full((1, 3), np.nan), samples, 0.1)
    with pytest.raises(PlannerError, match="above 0"):
        coverage.sampled_coverage(np.zeros((1, 3)), samples, 0.0)


def test_visible_coverage_of_a_slab():
    """Views from above measure the top. Views from above and from the sides measure all but the bottom."""
    slab = SLAB
    caster = caster_of(slab)
    samples = draw_samples(slab, slab, 5000, np.random.default_rng(0))
    candidates = optimal_scanning_zone(slab, [0.3], [0.0]).T_object_scanner
    above = candidates[candidates[:, 0, 2, 3] > 0.2]
    plan = coverage.visible_coverage(above, samples, SCANNER, [caster])
    assert plan.fraction == pytest.approx((samples.normals[:, 2] > 0.9).mean(), abs=1e-12)
    best = coverage.visible_coverage(candidates[candidates[:, 0, 2, 3] > 0], samples, SCANNER, [caster])
    assert best.fraction == pytest.approx((samples.normals[:, 2] > -0.9).mean(), abs=1e-12)
    assert best.total_area == plan.total_area


def test_coverable_is_the_union_of_all_candidates():
    """The coverable samples are the union of those of each candidate alone."""
    part = SLAB
    samples = draw_samples(part, part, 3000, np.random.default_rng(0))
    caster = caster_of(part)
    poses = optimal_scanning_zone(part, (0.3,), tuple(np.deg2rad((0, 90)))).T_object_scanner
    alone = [coverage.visible_coverage(pose[None], samples, SCANNER, [caster]).covered for pose in poses]
    found = Prediction.of(samples, SCANNER, [caster], poses).coverable.covered
    assert (found == np.any(alone, axis=0)).all()
    assert found.sum() > 0
    assert not np.all(alone, axis=0).all()


def test_remembered_results_are_those_of_a_new_evaluation():
    """Stored results equal new ones for sets with common views, in any order, with one or three poses per view."""
    part, draws = SLAB, np.random.default_rng(3)
    samples = draw_samples(part, part, 3000, np.random.default_rng(0))
    caster = caster_of(part)
    poses = optimal_scanning_zone(part, (0.3,), tuple(np.deg2rad((0, 90)))).T_object_scanner
    for views in (poses, np.stack([poses[k : k + 3, 0] for k in range(len(poses) - 2)])):
        remembered = VisibilityMemo(samples, SCANNER, [caster])
        for count in (1, 3, 3, 5, 2, 5):
            some = views[draws.permutation(len(views))[:count]]
            found = remembered.measured(some)
            np.testing.assert_array_equal(found, find_measured(some, samples, SCANNER, [caster]))
            np.testing.assert_array_equal(found, remembered.measured(some[::-1]))
