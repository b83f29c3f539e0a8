"""The layer of sigma: a loop over its entries, its limit, and the best value of chosen views."""

import numpy as np
import pytest
import trimesh

from cell.scanners.laser_area import LaserArea
from cell.world.embree import EmbreeRayCaster
from planner.errors import PlannerError
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import draw_samples
from planner.measurability.matrix import Measurability
from planner.measurability.quality import LimitedScanner, best_sigma, sigma_layer, within_sigma
from planner.measurability.visibility import fill_matrix, find_measured
from planner.ports import Rejection
from planner.viewpoints.viewpoints import Viewpoints, optimal_scanning_zone

SCANNER = LaserArea(range_mm=(50, 400), baseline_mm=40)


@pytest.fixture(scope="module")
def part() -> TriangleMesh:
    """Return a ball beside a box, so that rays are blocked."""
    box = trimesh.creation.box((0.03, 0.03, 0.12)).apply_translation([0.09, 0, 0])
    mesh = trimesh.util.concatenate([trimesh.creation.icosphere(2, 0.05), box])
    return TriangleMesh(mesh.vertices, mesh.faces)


@pytest.fixture(scope="module")
def caster(part: TriangleMesh) -> EmbreeRayCaster:
    """Return the ray caster of the part."""
    return EmbreeRayCaster(part.vertices, part.faces)


def _views(part: TriangleMesh, poses: int) -> Viewpoints:
    few = TriangleMesh(part.vertices, part.faces[::9])
    views = optimal_scanning_zone(few, (0.2,), (0.0, 1.0))
    if poses == 1:
        return views
    T = np.repeat(views.T_object_scanner, poses, axis=1)
    T[:, :, :3, 3] += T[:, :, :3, 0] * np.linspace(-0.02, 0.02, poses)[None, :, None]
    return Viewpoints(T, views.face, views.standoff, views.roll)


@pytest.mark.parametrize("poses", [1, 3])
def test_every_entry_has_the_sigma_of_its_best_measuring_pose(part, caster, poses):
    """Each entry is the smallest `scanner.sigma` over the poses that measure the sample by `find_measured`."""
    views = _views(part, poses)
    samples = draw_samples(part, part, 300, np.random.default_rng(0))
    M = sigma_layer(fill_matrix(views, samples, SCANNER, caster), views, SCANNER, casters=(caster,))
    assert M.sigma is not None
    assert M.sigma.dtype == np.float32
    assert len(M.sigma) > 1000
    sees = [find_measured(views.T_object_scanner[:, [k]], samples, SCANNER, (caster,), each=True) for k in range(poses)]
    for row in range(0, 300, 7):
        for entry in range(M.indptr[row], M.indptr[row + 1]):
            view, found = M.indices[entry], []
            for k in range(poses):
                if sees[k][row, view]:
                    T = np.linalg.inv(views.T_object_scanner[view, k])
                    point = T[:3, :3] @ samples.points[row] + T[:3, 3]
                    found.append(SCANNER.sigma(point[None], (T[:3, :3] @ samples.normals[row])[None])[0])
            assert M.sigma[entry] == pytest.approx(min(found), rel=1e-6)


def test_the_limit_keeps_exactly_the_entries_below_it(part, caster):
    """`within_sigma` is the entry-wise comparison; a larger limit never loses an entry; the largest sigma keeps all."""
    views = _views(part, 1)
    samples = draw_samples(part, part, 300, np.random.default_rng(0))
    M = sigma_layer(fill_matrix(views, samples, SCANNER, caster), views, SCANNER)
    dense = np.full(M.shape, np.inf)
    dense[np.repeat(np.arange(300), np.diff(M.indptr)), M.indices] = M.sigma
    before = np.zeros(M.shape, dtype=bool)
    for limit in np.quantile(M.sigma, [0.0, 0.3, 0.7, 1.0]):
        remaining = within_sigma(M, float(limit)).matrix().toarray()
        np.testing.assert_array_equal(remaining, dense <= limit)
        assert (remaining | ~before).all()
        assert remaining.sum() > before.sum()
        before = remaining
    assert before.sum() == len(M.indices)


def test_layer_and_limited_scanner_agree(part, caster):
    """Filling with the limited scanner gives the same matrix as the limit on the layer."""
    views = _views(part, 1)
    samples = draw_samples(part, part, 300, np.random.default_rng(0))
    M = sigma_layer(fill_matrix(views, samples, SCANNER, caster), views, SCANNER)
    limit = float(np.median(M.sigma)) * (1 + 1e-6)  # not equal to any entry: the layer is rounded to float32
    direct = fill_matrix(views, samples, LimitedScanner(SCANNER, limit), caster)
    assert (direct.matrix() != within_sigma(M, limit).matrix()).nnz == 0
    assert 0 < len(direct.indices) < len(M.indices)


def test_best_sigma_is_the_minimum_over_chosen_views(part, caster):
    """NaN if no chosen view measures the sample."""
    views = _views(part, 1)
    samples = draw_samples(part, part, 300, np.random.default_rng(0))
    M = sigma_layer(fill_matrix(views, samples, SCANNER, caster), views, SCANNER)
    dense = np.full(M.shape, np.nan)
    dense[np.repeat(np.arange(300), np.diff(M.indptr)), M.indices] = M.sigma
    columns = np.array([3, 11, 20])
    expected = np.full(300, np.nan)
    seen = ~np.isnan(dense[:, columns]).all(axis=1)
    expected[seen] = np.nanmin(dense[seen][:, columns], axis=1)
    assert 0 < seen.sum() < 300
    np.testing.assert_allclose(best_sigma(M, columns), expected, rtol=1e-6)


def test_too_uncertain_comes_after_the_scanner_s_own_conditions():
    """The limit is inclusive, and a point that fails another condition keeps that reason."""
    points = np.array([[0, 0, 0.2], [0, 0, 0.3], [0, 0, 0.9]])
    normals = np.tile([0.0, 0, -1], (3, 1))
    limit = float(SCANNER.sigma(points, normals)[0])
    codes = LimitedScanner(SCANNER, limit).reject(points, normals)
    assert codes.tolist() == [Rejection.MEASURED, Rejection.TOO_UNCERTAIN, Rejection.OUT_OF_RANGE]
    assert LimitedScanner(SCANNER, limit).parameters() == SCANNER.parameters()


def test_impossible_arguments_are_refused(part, caster):
    """No layer, a limit of 0, a scanner without sigma, foreign viewpoints, sweeps without casters."""

    class Bare:
        pass

    views = _views(part, 1)
    samples = draw_samples(part, part, 10, np.random.default_rng(0))
    M = fill_matrix(views, samples, SCANNER, caster)
    few = Viewpoints(views.T_object_scanner[:3], views.face[:3], views.standoff[:3], views.roll[:3])
    for call, words in [
        (lambda: within_sigma(M, 1e-3), "sigma_layer"),
        (lambda: best_sigma(M, np.array([0])), "sigma_layer"),
        (lambda: within_sigma(sigma_layer(M, views, SCANNER), 0.0), "above 0"),
        (lambda: LimitedScanner(SCANNER, 0.0), "above 0"),
        (lambda: LimitedScanner(Bare(), 1.0), "does not know its sigma"),
        (lambda: sigma_layer(M, few, SCANNER), "must be the same"),
        (lambda: sigma_layer(M, _views(part, 2), SCANNER), "casters"),
        (lambda: Measurability(M.indptr, M.indices, samples, len(views), np.zeros(3)), "sigma has shape"),
    ]:
        with pytest.raises(PlannerError, match=words):
            call()
