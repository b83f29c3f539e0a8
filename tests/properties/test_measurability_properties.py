"""Properties of measurability for any part, scanner and viewpoints."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from cell.scanners.laser_area import LaserArea
from cell.world.embree import EmbreeRayCaster
from cell.world.virtual_scan import scan
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import draw_samples
from planner.measurability.visibility import apply_occluders, fill_matrix, find_measured
from planner.ports import Rejection
from planner.viewpoints.lines_of_sight import RayTargets, flatten_poses, in_view
from planner.viewpoints.viewpoints import Viewpoints
from tests.support.meshes import caster_of

seeds = st.integers(0, 2**32 - 1)
few = settings(
    max_examples=settings.default.max_examples // 4, derandomize=True
)  # some pairs are exactly on a limit: the same examples every time


def _hull(rng, centre, size):
    points = centre + size * rng.normal(size=(12, 3))
    hull = ConvexHull(points)
    corners = points[hull.simplices]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    faces = hull.simplices.copy()
    inward = np.einsum("ij,ij->i", normals, hull.equations[:, :3]) < 0
    faces[inward] = faces[inward][:, ::-1]
    return points, faces


def _part(rng):
    """Return three convex bodies that occlude each other."""
    vertices, faces, count = [], [], 0
    for _ in range(3):
        points, triangles = _hull(rng, rng.normal(size=3) * 0.06, 0.03)
        vertices.append(points)
        faces.append(triangles + count)
        count += len(points)
    return TriangleMesh(np.concatenate(vertices), np.concatenate(faces))


def _views(rng, count=12, K=1):
    """Return random poses around the origin, 0.2 to 0.4 m away, aimed roughly at it."""
    T = np.tile(np.eye(4), (count, K, 1, 1))
    position = rng.normal(size=(count, K, 3))
    position *= rng.uniform(0.2, 0.4, (count, K, 1)) / np.linalg.norm(position, axis=-1, keepdims=True)
    z = rng.normal(size=(count, K, 3)) * 0.03 - position
    z /= np.linalg.norm(z, axis=-1, keepdims=True)
    x = np.cross(rng.normal(size=(count, K, 3)), z)
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    T[..., :3, 0], T[..., :3, 1], T[..., :3, 2], T[..., :3, 3] = x, np.cross(z, x), z, position
    return _as_viewpoints(T)


def _as_viewpoints(T):
    n = len(T)
    return Viewpoints(T, np.full(n, -1), np.ones(n), np.zeros(n))


def _dense(matrix):
    return matrix.matrix().toarray()


def _scanner(**keys):
    defaults = {"fov_deg": (40, 30), "resolution_deg": (2, 2), "range_mm": (150, 380), "baseline_mm": 80}
    return LaserArea(**{**defaults, **keys})


def _scene(seed, K=1):
    rng = np.random.default_rng(seed)
    part = _part(rng)
    return rng, part, caster_of(part), draw_samples(part, part, 200, rng), _views(rng, K=K)


@few
@given(seeds)
def test_moving_part_and_scanner_together_changes_nothing(seed):
    """A rigid motion of up to 10 m applied to both: the same matrix, aimed and by rays, and the same scan."""
    rng, part, caster, features, views = _scene(seed)
    motion = np.eye(4)
    motion[:3, :3] = Rotation.random(rng=rng).as_matrix()
    motion[:3, 3] = rng.uniform(-10, 10, 3)

    def moved(points):
        return points @ motion[:3, :3].T + motion[:3, 3]

    other_part = TriangleMesh(moved(part.vertices), part.faces)
    other_caster = caster_of(other_part)
    other_features = type(features)(
        moved(features.points),
        features.normals @ motion[:3, :3].T,
        features.areas,
        features.face,
        features.planning_face,
    )
    other_views = _as_viewpoints(motion @ views.T_object_scanner)
    scanner = _scanner()
    here = _dense(fill_matrix(views, features, scanner, caster))
    there = _dense(fill_matrix(other_views, other_features, scanner, other_caster))
    assert (here == there).all()
    a = scan(scanner, views.T_object_scanner[0, 0], caster, part)
    b = scan(scanner, other_views.T_object_scanner[0, 0], other_caster, other_part)
    assert (a.codes == b.codes).mean() > 0.99  # a ray may pass a silhouette closer than float32's rounding
    both = np.isin(a.pixel, b.pixel), np.isin(b.pixel, a.pixel)
    np.testing.assert_allclose(moved(a.points[both[0]]), b.points[both[1]], atol=1e-6)


@few
@given(seeds, st.sampled_from([1, 3]))
def test_an_added_occluder_never_adds_an_entry(seed, K):
    """M with one occluder lies within M, with two within that with one, and equals casting on both from the start."""
    rng, _, caster, features, views = _scene(seed, K)
    scanner = _scanner()
    first, second = (EmbreeRayCaster(*_hull(rng, rng.normal(size=3) * 0.15, 0.03)) for _ in range(2))
    bare = fill_matrix(views, features, scanner, caster)
    once = apply_occluders(bare, views, scanner, first, ray_caster=caster)
    assert (_dense(once) <= _dense(bare)).all()
    joint = find_measured(views.T_object_scanner, features, scanner, [caster, first], each=True)
    assert (_dense(once) == joint).all()
    if K == 1:
        twice = apply_occluders(once, views, scanner, second)
        assert (_dense(twice) <= _dense(once)).all()
        assert (
            _dense(apply_occluders(apply_occluders(bare, views, scanner, second), views, scanner, first))
            == _dense(twice)
        ).all()


@few
@given(seeds)
def test_an_occluder_never_adds_a_point_to_a_scan(seed):
    """Every point with an occluder is also measured without it, and a far occluder has no effect."""
    rng, part, caster, _, views = _scene(seed)
    near, far = (EmbreeRayCaster(*_hull(rng, place, 0.03)) for place in (rng.normal(size=3) * 0.1, np.full(3, 9.0)))
    for T in views.T_object_scanner[:, 0]:
        bare = scan(_scanner(), T, caster, part)
        hidden = scan(_scanner(), T, caster, part, near)
        assert np.isin(hidden.pixel, bare.pixel).all()
        assert (hidden.points == bare.points[np.isin(bare.pixel, hidden.pixel)]).all()
        assert (scan(_scanner(), T, caster, part, far).codes == bare.codes).all()


@few
@given(seeds)
def test_without_a_baseline_the_sensor_leg_blocks_nothing(seed):
    """M follows from the conditions and the source's line of sight alone; no ray is in the sensor's shadow."""
    _, part, caster, features, views = _scene(seed)
    scanner = _scanner(baseline_mm=0, grazing_max_deg=90)
    targets = RayTargets.of(features.points, features.normals)
    expected = np.zeros((len(features), len(views)), dtype=bool)
    for j, T in enumerate(flatten_poses(views.T_object_scanner)):
        rows = in_view(targets, T, scanner)
        free = ~caster.blocked(np.tile(T[:3, 3], (len(rows), 1)), targets.lifted[rows])
        expected[rows[free], j] = True
    assert (_dense(fill_matrix(views, features, scanner, caster)) == expected).all()
    for T in views.T_object_scanner[:, 0]:
        assert scan(scanner, T, caster, part).counts()[Rejection.SENSOR_BLOCKED] == 0


@few
@given(seeds)
def test_the_ray_grid_sets_exactly_the_rows_that_its_scans_hit(seed):
    """`rays` equals single scans, so the culling of rays that miss the part has no effect."""
    rng, part, caster, _, views = _scene(seed)
    scanner = _scanner()
    row_of_face = rng.integers(-1, 9, len(part.faces))
    features = draw_samples(part, part, 9, rng)
    expected = np.zeros((9, len(views)), dtype=bool)
    for j, T in enumerate(views.T_object_scanner[:, 0]):
        rows = row_of_face[scan(scanner, T, caster, part).face]
        expected[rows[rows >= 0], j] = True
    got = fill_matrix(views, features, scanner, caster, method="rays", part=part, row_of_face=row_of_face)
    assert (_dense(got) == expected).all()


@few
@given(seeds)
def test_rolls_share_the_source_s_legs_to_the_bit(seed):
    """M of views that differ by roll equals that of each alone; neighbours cast the source's rays once."""
    rng, _, caster, features, views = _scene(seed)
    turns = np.tile(np.eye(4), (3, 1, 1))
    turns[:, :3, :3] = Rotation.from_euler("z", [[0.0], [0.6], [1.9]]).as_matrix()
    rolled = (views.T_object_scanner[:, :, None] @ turns).reshape(-1, 1, 4, 4)
    scanner = _scanner(fov_deg=(60, 60))
    counted = _Counting(caster)
    for order in (np.arange(len(rolled)), rng.permutation(len(rolled))):
        together = _dense(fill_matrix(_as_viewpoints(rolled[order]), features, scanner, counted))
        shared, counted.legs = counted.legs, 0
        alone = [_dense(fill_matrix(_as_viewpoints(rolled[[i]]), features, scanner, counted))[:, 0] for i in order]
        assert (together == np.stack(alone, axis=1)).all()
        assert shared < counted.legs or not together.any() or not np.array_equal(order, np.arange(len(order)))
        counted.legs = 0


class _Counting:
    """A ray caster that counts rays."""

    def __init__(self, caster):
        self.caster, self.legs = caster, 0

    def blocked(self, origins, targets):
        self.legs += len(origins)
        return self.caster.blocked(origins, targets)
