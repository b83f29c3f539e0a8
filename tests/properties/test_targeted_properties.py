"""Targeted candidates: what the base set and the aimed views hold, and when growing stops."""

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from cell.errors import SceneError
from cell.part.workpiece import load
from cell.plan import candidates as growing
from cell.plan.candidates import grow
from cell.rays.embree import EmbreeRayCaster
from cell.scanners.laser_area import LaserArea
from planner.measurability import coverage
from planner.measurability.columns import join_measurability, pick_measurability
from planner.measurability.matrix import Measurability, fill
from planner.reach.reach import Reach, Verdict, join_reach
from planner.surface.decimate import decimate
from planner.surface.sample import SurfaceSamples, sample
from planner.viewpoints import targeted
from planner.viewpoints.lines_of_sight import Targets
from planner.viewpoints.sphere import view_sphere
from planner.viewpoints.viewpoints import Viewpoints, looking_at, pick_viewpoints
from planner.viewpoints.zone import optimal_scanning_zone

STANDOFF = 0.1


@pytest.fixture(scope="module")
def mug():
    """Planning mesh, features, scanner and caster of the Mug, coarse."""
    part = load("mug")
    planning = decimate(part.reference, 120)
    features = sample(part.reference, planning, 600, np.random.default_rng(0))
    scanner = LaserArea(range_mm=(50, 150), baseline_mm=25)
    return part, planning, features, scanner, EmbreeRayCaster(part.reference.vertices, part.reference.faces)


def _reach(views, allowed):
    """Reach with one made-up solution where allowed."""
    verdict = np.where(allowed, Verdict.REACHABLE, Verdict.OUT_OF_REACH)
    return Reach(verdict, np.zeros((allowed.sum(), 6)), np.cumsum([0, *allowed]), ("",) * len(views))


def _from_above(views):
    """An arm that only reaches sources above the plane z = -0.02."""
    return _reach(views, views.T_object_scanner[:, 0, 2, 3] > -0.02)


def _grown(mug, reach_of=_from_above, normals=20, casters=None):
    part, planning, features, scanner, caster = mug
    casters = casters or [caster]
    base = targeted.base_set(planning, part.centre, 0.15, (np.pi / 4, np.pi / 4), (STANDOFF,), (0.0,), normals=normals)
    asked = []

    def counted(views):
        asked.append(len(views))
        return reach_of(views)

    def measure(views):
        return fill(views, features, scanner, caster)

    M = measure(base)
    grown = grow(
        base, reach_of(base), M, standoff=STANDOFF, scanner=scanner, casters=casters, reach_of=counted, measure=measure
    )
    return base, M, grown, asked


def test_a_spread_subset_leaves_no_gap():
    """Each member is farther from the others than any point left out is from its nearest member (Gonzalez)."""
    rng = np.random.default_rng(0)
    points, normals = rng.normal(size=(400, 3)), rng.normal(size=(400, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    taken = targeted.spread(points, normals, 40, 0.7)
    assert len(set(taken.tolist())) == 40
    where = np.hstack([points / 0.7, normals])
    between = cdist(where[taken], where[taken]) + np.diag(np.full(40, np.inf))
    assert cdist(where, where[taken]).min(axis=1).max() <= between.min() + 1e-12
    assert sorted(targeted.spread(points[:5], normals[:5], 9, 0.7)) == [0, 1, 2, 3, 4]
    assert sorted(targeted.spread(points[[1, 1, 1]], normals[[1, 1, 1]], 3, 0.7)) == [0, 1, 2]


def test_the_base_set_is_sphere_and_normals_as_their_generators_make_them(mug):
    """The whole sphere first; every other view is, to the bit, one of the optimal scanning zone's, each face whole."""
    part, planning, *_ = mug
    rolls = (0.0, 1.0)
    base = targeted.base_set(planning, part.centre, 0.15, (0.5, 0.5), (0.1, 0.12), rolls, normals=30)
    sphere = view_sphere(part.centre, 0.15, 0.5, 0.5, rolls)
    zone = optimal_scanning_zone(planning, (0.1, 0.12), rolls)
    n = len(sphere)
    assert base.T_object_scanner[:n].tobytes() == sphere.T_object_scanner.tobytes()
    rest = pick_viewpoints(base, np.arange(n, len(base)))
    assert len(rest) == 30 * 2 * 2
    kept = np.isin(zone.face, rest.face)
    for name in Viewpoints.__dataclass_fields__:
        assert (getattr(rest, name) == getattr(zone, name)[kept]).all()


@pytest.mark.parametrize(("near", "far", "grazing"), [(50, 150, 75), (90, 110, 40), (99, 300, 90)])
def test_limits_are_the_scanner_s(near, far, grazing):
    """Range and tilt found by asking lie inside the scanner's own, within the margins."""
    found = targeted.limits(LaserArea(range_mm=(near, far), baseline_mm=10, grazing_max_deg=grazing), STANDOFF)
    assert near / 1000 <= found.near <= min(1.03 * near / 1000, STANDOFF)
    assert 0.97 * far / 1000 <= found.far <= far / 1000
    assert grazing - 3.001 <= np.degrees(found.tilt) <= grazing


def test_a_view_that_is_aimed_at_a_point_is_aimed_at_it(mug):
    """The point lies on the axis at the standoff; the axis leans by no more than the limit; face and roll are true."""
    _, _, features, scanner, _ = mug
    within = targeted.limits(scanner, STANDOFF)
    points, normals, face = features.points[:7], features.normals[:7], features.planning_face[:7]
    views, owner = targeted.aimed_at(points, normals, face, STANDOFF, within)
    R, p = views.T_object_scanner[:, 0, :3, :3], views.T_object_scanner[:, 0, :3, 3]
    np.testing.assert_allclose(p + views.standoff[:, None] * R[:, :, 2], points[owner], atol=1e-12)
    lean = np.arccos(np.clip(-np.einsum("ni,ni->n", R[:, :, 2], normals[owner]), -1, 1))
    assert lean.max() <= within.tilt + 1e-9
    assert lean.max() >= within.tilt - 1e-9
    assert (views.face == face[owner]).all()
    assert views.standoff.min() == within.near
    assert views.standoff.max() == within.far
    again = looking_at(p + views.standoff[:, None] * R[:, :, 2], -R[:, :, 2], views.face, [1.0], [0.0])
    flat = again.T_object_scanner[:, 0, :3, :3]
    turn = np.einsum("nji,njk->nik", flat, R)
    np.testing.assert_allclose(np.cos(views.roll), turn[:, 0, 0], atol=1e-9)
    np.testing.assert_allclose(np.sin(views.roll), turn[:, 1, 0], atol=1e-9)


def test_seeing_the_own_point_equals_the_matrix(mug):
    """Whether a view sees its point is its entry of M."""
    _, _, features, scanner, caster = mug
    rows = np.arange(0, 600, 60)
    targets = Targets.of(features.points, features.normals)
    within = targeted.limits(scanner, STANDOFF)
    views, owner = targeted.aimed_at(
        features.points[rows], features.normals[rows], features.planning_face[rows], STANDOFF, within
    )
    seen = targeted.sees_its_point(views, targets, rows[owner], scanner, [caster])
    M = fill(views, features, scanner, caster).matrix().toarray()
    assert (seen == M[rows[owner], np.arange(len(views))]).all()
    assert 0 < seen.mean() < 1
    assert (targeted.measured_rows(views, targets, rows, scanner, [caster]) == M[rows]).all()


def test_growing_only_adds_and_makes_more_coverable(mug):
    """Numbers stay, additions are reached and measure what was open, M and reach agree, held-out samples gain."""
    part, planning, features, scanner, caster = mug
    base, M, grown, _ = _grown(mug)
    views, reached, both = grown
    n = len(base)
    assert len(views) > n
    assert views.T_object_scanner[:n].tobytes() == base.T_object_scanner.tobytes()
    assert reached.reachable[n:].all()
    assert (reached.verdict == _from_above(views).verdict).all()
    assert (both.matrix() != fill(views, features, scanner, caster).matrix()).nnz == 0
    before = M.matrix()[:, _from_above(base).reachable].sum(axis=1) > 0
    new = both.matrix()[:, n:].toarray()
    assert (new & ~before[:, None]).any(axis=0).all()
    held_out = sample(part.reference, planning, 4000, np.random.default_rng(1))
    shares = [
        coverage.visible(v.T_object_scanner[r.reachable], held_out, scanner, [caster]).fraction
        for v, r in ((base, _from_above(base)), (views, reached))
    ]
    assert shares[1] > shares[0] + 0.005


def test_growing_is_deterministic(mug):
    """Twice the same: equal bytes."""
    first, second = _grown(mug)[2], _grown(mug)[2]
    assert first[0].T_object_scanner.tobytes() == second[0].T_object_scanner.tobytes()
    assert first[2].indices.tobytes() == second[2].indices.tobytes()


def test_where_nothing_more_is_reached_growing_stops_after_one_round(mug):
    """An arm that reaches none of the new views: one round, nothing added, the base set comes back."""
    n = len(_grown(mug)[0])

    def only_the_base(views):
        return _reach(views, np.arange(len(views)) < (5 if len(views) == n else 0))

    base, M, (views, _, both), asked = _grown(mug, only_the_base)
    assert len(asked) == 1
    assert views.T_object_scanner.tobytes() == base.T_object_scanner.tobytes()
    assert both.indices.tobytes() == M.indices.tobytes()


def test_the_work_is_bounded(mug, monkeypatch):
    """However few targets a round has, no more than ROUNDS rounds ask no more than the whole family for each target."""
    monkeypatch.setattr(growing, "TARGETS", 2)
    base, _, (views, _, _), asked = _grown(mug, normals=0)
    anywhere = targeted.Limits(0.05, 0.2, 1.0)
    family = len(targeted.aimed_at(np.zeros((1, 3)), np.eye(3)[:1], np.zeros(1, int), 0.1, anywhere)[0])
    assert sum(asked) <= growing.ROUNDS * 2 * family + len(views) - len(base)


def test_sweeps_are_refused(mug):
    """Viewpoints of several poses cannot be aimed here; the sentence says what can."""
    _, _, features, scanner, caster = mug
    views = Viewpoints(np.tile(np.eye(4), (2, 3, 1, 1)), [-1, -1], [1.0, 1.0], [0.0, 0.0])
    M = Measurability([0] * 601, [], features, 2)
    with pytest.raises(SceneError, match=r"this scanner sweeps; choose"):
        grow(
            views, _reach(views, np.array([True, True])), M, standoff=0.1, scanner=scanner, casters=[caster],
            reach_of=_from_above, measure=lambda views: M,
        )  # fmt: skip


def test_columns_are_joined_and_picked_alike():
    """Joining and picking of viewpoints, reach and M commute with NumPy's on dense arrays, sigma included."""
    rng = np.random.default_rng(3)
    features = SurfaceSamples(rng.random((5, 3)), rng.random((5, 3)), rng.random(5), [0] * 5, [0] * 5)
    dense = [rng.random((5, n)) < 0.5 for n in (4, 1, 6)]
    parts = []
    for block in dense:
        indptr = np.concatenate([[0], np.cumsum(block.sum(axis=1))])
        sigma = (np.nonzero(block)[1] + 1 + len(parts) * 10).astype(np.float32)
        parts.append(Measurability(indptr, np.nonzero(block)[1], features, block.shape[1], sigma))
    joined = join_measurability(parts)
    assert (joined.matrix().toarray() == np.hstack(dense)).all()
    expected = np.hstack([np.where(block, np.arange(block.shape[1]) + 1 + 10 * i, 0) for i, block in enumerate(dense)])
    assert (joined.sigma == expected[expected > 0]).all()
    which = rng.permutation(11)[:7]
    assert (pick_measurability(joined, which).matrix().toarray() == np.hstack(dense)[:, which]).all()
    reaches = [_reach(np.zeros(n), rng.random(n) < 0.5) for n in (4, 6)]
    both = join_reach(reaches)
    assert both.verdict.tolist() == [*reaches[0].verdict, *reaches[1].verdict]
