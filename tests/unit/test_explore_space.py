"""Voxel space of an unknown part: traversal of the grid, points and their lines of sight, belief, expected gain."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_array

from planner.errors import PlannerError
from planner.explore.gain import MAX_TRIES, GainRecord, OpenSamples, gain_ratio, select_by_gain_per_second
from planner.explore.space import FREE, OCCUPIED, UNKNOWN, VoxelSpace, count_crossings, first_in_cubes
from planner.values import Bools, Floats, Ints


def _crossed(starts: Floats, ends: Floats, low: Floats, edge: float, shape: tuple[int, int, int]) -> Ints:
    """Count the segments that cross each voxel by brute force, with the slab test."""
    count = np.zeros(shape, dtype=np.int64)
    with np.errstate(divide="ignore"):
        for start, end in zip(starts, ends, strict=True):
            for voxel in np.ndindex(shape):
                walls = (low + edge * (np.array(voxel) + np.array([[0.0], [1.0]])) - start) / (end - start)
                begin, stop = max(walls.min(axis=0).max(), 0.0), min(walls.max(axis=0).min(), 1.0)
                count[voxel] += begin < stop
    return count


def test_a_segment_crosses_the_voxels_whose_boxes_it_meets() -> None:
    """Random segments that begin and end inside and outside the grid cross the same voxels as brute force."""
    rng = np.random.default_rng(0)
    shape, low, edge = (5, 4, 6), np.array([-0.2, 0.1, 0.3]), 0.1
    size = edge * np.array(shape)
    starts, ends = low + size * rng.uniform(-0.6, 1.6, (2, 200, 3))
    crossed = np.zeros(np.prod(shape), dtype=np.int64)
    count_crossings(starts, ends, low, edge, np.array(shape), crossed)
    assert np.array_equal(crossed.reshape(shape), _crossed(starts, ends, low, edge, shape))


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_segment_along_an_axis_crosses_its_row(axis: int) -> None:
    """A segment along an axis crosses its row without division by zero. One outside the grid crosses nothing."""
    start, end = np.full((2, 3), 0.25), np.full((2, 3), 0.25)
    start[:, axis], end[:, axis] = -1.0, 2.0
    start[1, (axis + 1) % 3] = end[1, (axis + 1) % 3] = 5.0
    crossed = np.zeros(64, dtype=np.int64)
    count_crossings(start, end, np.zeros(3), 0.1, np.array([4, 4, 4]), crossed)
    row = np.zeros((4, 4, 4), dtype=np.int64)
    row[tuple(slice(None) if k == axis else 2 for k in range(3))] = 1
    assert np.array_equal(crossed.reshape(4, 4, 4), row)


def _space() -> VoxelSpace:
    return VoxelSpace.from_cylinder(0.05, 0.06, 0.004, 0.003)


def test_only_the_cylinder_is_unknown_at_first() -> None:
    """Voxels with their centre in the cylinder are unknown; those more than a voxel outside are free."""
    space = _space()
    x, y, z = space.centres(np.ones(space.state.shape, dtype=bool)).T
    excess = np.maximum(np.hypot(x, y) - 0.05, np.abs(z) - 0.03)
    state = space.state.ravel()
    assert (state[excess <= 0] == UNKNOWN).all()
    assert (state[excess > 0.004] == FREE).all()


@pytest.mark.parametrize(
    ("sizes", "words"),
    [
        ((0.0, 0.1, 0.01, 0.01), "must be above 0"), ((0.1, 0.1, -1.0, 0.01), "must be above 0"),
        ((0.1, 0.1, 0.01, 0.0), "must be above 0"), ((1.0, 1.0, 1e-4, 0.01), "exceed the limit"),
    ],
)  # fmt: skip
def test_invalid_cylinders_are_refused(sizes: tuple[float, float, float, float], words: str) -> None:
    """Sizes that are not positive and grids that are too large are refused."""
    with pytest.raises(PlannerError, match=words):
        VoxelSpace.from_cylinder(*sizes)


def _ball_from(space: VoxelSpace, origin: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return the points of a ball of 30 mm radius that are visible from a position, and this position."""
    normals = rng.standard_normal((20_000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = 0.03 * normals
    return points[np.einsum("ij,ij->i", origin - points, normals) > 0], origin


def test_free_space_does_not_contain_the_part() -> None:
    """After views of a ball from all sides, free voxels lie outside it to within a voxel diagonal.

    Its points are occupied and measured; those of a moved ball contradict the space.
    """
    space, rng = _space(), np.random.default_rng(1)
    everything = []
    for direction in rng.standard_normal((40, 3)):
        direction = direction / np.linalg.norm(direction)
        points, stand = _ball_from(space, 0.3 * direction, rng)
        space = space.with_points(points, [stand])
        everything.append(points)
    depth = 0.03 - np.linalg.norm(space.centres(space.state == FREE), axis=1)
    assert depth.max() < np.sqrt(3) * space.edge
    points = np.concatenate(everything)
    assert (space.values_at(points, space.state) == OCCUPIED).all()
    assert space.is_measured(points, points / 0.03).all()
    assert space.contradicted_share(points) == 0
    assert space.contradicted_share(points + np.array([0.02, 0.0, 0.0])) > 0.05  # the ball was moved
    assert not space.outside(points).any()
    assert space.outside(points + np.array([0.05, 0.0, 0.0])).any()


def _seen(space: VoxelSpace, point: Floats, normal: Floats) -> bool:
    """Return whether one of the eight nearest points lies near the normal, by brute force.

    It is at most a gap from the normal, and 0.5 edges above to 1.6 edges below the sample.
    """
    nearest = np.argsort(np.linalg.norm(space.points - point, axis=1))[:8]
    for measured in space.points[nearest]:
        height = float((measured - point) @ normal)
        across = float(np.linalg.norm(measured - point - height * normal))
        if across <= space.gap and -1.6 * space.edge <= height <= 0.5 * space.edge:
            return True
    return False


def test_measured_samples_have_a_point_near_their_normal() -> None:
    """Samples around a layer of random points are measured as brute force finds them."""
    rng = np.random.default_rng(5)
    points = rng.uniform(-1, 1, (300, 3)) * np.array([0.02, 0.02, 0.001])
    space = replace(_space(), points=points)
    assert not _space().is_measured(points, points).any()
    samples = rng.uniform(-1, 1, (400, 3)) * np.array([0.025, 0.025, 0.008])
    normals = rng.standard_normal((400, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    expected = np.array([_seen(space, *each) for each in zip(samples, normals, strict=True)])
    assert 0.2 < expected.mean() < 0.8
    assert np.array_equal(space.is_measured(samples, normals), expected)
    near = np.linalg.norm(samples[:, None] - points, axis=2).min(axis=1) <= space.gap
    assert np.array_equal(space.is_new(samples), ~near)


@pytest.mark.parametrize("more", [0, 40, 300])
def test_measured_since_is_the_difference_of_two_spaces(more: int) -> None:
    """Newly measured samples are those that the later space measures and the earlier one does not."""
    rng = np.random.default_rng(more)
    points = rng.uniform(-1, 1, (300, 3)) * np.array([0.02, 0.02, 0.001])
    before = replace(_space(), points=points[: 300 - more])
    samples = rng.uniform(-1, 1, (400, 3)) * np.array([0.025, 0.025, 0.008])
    normals = rng.standard_normal((400, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    after = replace(before, points=points)
    seen, new = after.measured_since(before, samples, normals)
    assert np.array_equal(seen, after.is_measured(samples, normals))
    assert np.array_equal(new, seen & ~before.is_measured(samples, normals))
    assert new.any() == (more > 0)


@pytest.mark.parametrize(("spacing", "gap"), [(0.003, 0.0027), (0.0005, 0.0014)])
def test_a_strip_without_points_is_open_although_its_voxels_are_occupied(spacing: float, gap: float) -> None:
    """Samples of a strip farther than a gap from all points are open, and those nearer are not.

    The strip is less than two voxels wide, so that each of its voxels or a neighbour holds a point.
    """
    space = VoxelSpace.from_cylinder(0.05, 0.06, 0.004, spacing)
    assert space.gap == pytest.approx(gap)
    x, y = (axis.ravel() for axis in np.meshgrid(*[np.arange(-0.02, 0.02, 0.00025)] * 2))
    is_measured = np.abs(x) > 0.0035
    space = space.with_points(np.column_stack([x, y, np.zeros_like(x)])[is_measured], [])
    across = np.linspace(-0.01, 0.01, 201)
    above = np.column_stack([across, np.zeros(201), np.full(201, 0.5 * space.edge)])
    up = np.tile([0.0, 0.0, 1.0], (201, 1))
    open_now = ~space.is_measured(above, up)
    sure = space.gap * 0.7 + 0.0003  # a kept point is within the side of a cube
    assert open_now[np.abs(across) < 0.0035 - space.gap].all()
    assert not open_now[np.abs(across) > 0.0035 - space.gap + sure].any()
    assert np.array_equal(space.is_still_open(above, up), open_now)


def test_surface_between_points_of_neighbouring_rays_is_a_class_of_its_own() -> None:
    """Surface between points of neighbouring rays is not measured, but is kept as a class of open surface."""
    space = _space()
    space = space.with_points(np.array([[0.0, 0.0, 0.0], [0.012, 0.0, 0.0]]), [])
    places = np.array([[0.004, 0.0, 0.0], [0.008, 0.0, 0.0]])
    joined = (
        space.with_surface_between(places)
        .with_points(np.array([[0.03, 0.0, 0.0]]), [])
        .with_surface_between(np.array([[0.03, 0.003, 0.0]]))
    )
    above = np.array([[x, 0.0, 0.5 * space.edge] for x in (0.0, 0.004, 0.008, 0.012, 0.02)])
    up = np.tile([0.0, 0.0, 1.0], (5, 1))
    assert (
        joined.is_measured(above, up).tolist()
        == space.is_measured(above, up).tolist()
        == [True, False, False, True, False]
    )
    assert joined.open_samples_at(above, up).between.tolist() == [False, True, True, False, False]
    lifted = np.array([[0.004, 0.0, space.edge]])  # a position one edge below is near, one above is not
    assert [joined.open_samples_at(lifted, side * up[:1]).between[0] for side in (1, -1)] == [True, False]
    assert not space.open_samples_at(above, up).between.any()
    outside = np.array([[1.0, 0.0, 0.0]])
    assert np.array_equal(
        joined.with_surface_between(joined.between + 1e-9).with_surface_between(outside).between, joined.between
    )
    assert np.array_equal(joined.between, [*places, [0.03, 0.003, 0.0]])


CUBE_SIDE = 0.25


@pytest.mark.parametrize("offset", [1e6, -1e6])
def test_cubes_far_from_the_origin_are_the_same(offset: float) -> None:
    """Cubes far from the origin select the same points."""
    points = np.round(np.random.default_rng(0).uniform(-1, 1, (1000, 3)) * 1024) / 1024  # so that sums are exact
    assert np.array_equal(first_in_cubes(points + offset, CUBE_SIDE), first_in_cubes(points, CUBE_SIDE))


def test_each_small_cube_keeps_its_first_point() -> None:
    """Earlier points are kept in their order, and repeated points change nothing.

    Points outside the cylinder are ignored.
    """
    rng = np.random.default_rng(6)
    first, second = rng.uniform(-0.01, 0.01, (2, 500, 3))
    once = _space().with_points(np.concatenate([first, [[0.2, 0.0, 0.0]]]), [])
    twice = once.with_points(second, [])
    for space, points in ((once, first), (twice, np.concatenate([once.points, second]))):
        side, first_points = 0.7 * space.gap, dict[tuple[int, ...], Floats]()
        for point in points:
            first_points.setdefault(tuple(np.floor((point - space.low) / side).astype(int).tolist()), point)
        assert np.array_equal(space.points, np.array(list(first_points.values())))
    assert np.array_equal(twice.with_points(first, []).points, twice.points)


def test_unknown_space_without_a_connection_to_points_is_not_believed() -> None:
    """Only unknown voxels connected to points are believed. Before the first point it is the middle of the cylinder."""
    space = _space()
    first = space.belief_voxels()
    assert (space.state[first] == UNKNOWN).all()
    assert 0.1 < first.sum() / (space.state == UNKNOWN).sum() < 0.5
    state = np.full(space.state.shape, FREE, dtype=np.uint8)
    state[10, 10, 10], state[11, 11, 11], state[20, 20, 12] = OCCUPIED, UNKNOWN, UNKNOWN
    believed = replace(space, state=state).belief_voxels()
    assert believed.sum() == 2
    assert believed[11, 11, 11]


@pytest.mark.parametrize(("radius", "height"), [(0.0003, 0.1), (0.1, 0.0005), (0.0002, 0.0002)])
def test_cylinders_thinner_than_voxels_have_a_first_belief(radius: float, height: float) -> None:
    """For a wire, a sheet and a pin the first belief contains some voxels, so that a view can be planned."""
    space = VoxelSpace.from_cylinder(radius, height, 0.0012, 0.001)
    first = space.belief_voxels()
    assert first.any()
    assert (np.abs(space.centres(first)) <= np.array([max(radius, 0.0012)] * 2 + [max(height / 2, 0.0012)])).all()


def test_a_ray_without_a_point_votes_where_the_sensor_sees() -> None:
    """A ray without a point adds two votes along it, but none that a point hides from the sensor.

    Voxels behind a point as seen from the source have a vote of minus one.
    """
    space, source, sensor = _space(), np.array([-0.2, 0.0, 0.0]), np.array([-0.2, 0.1, 0.0])
    wall, ahead = np.array([[0.0, y, 0.0] for y in np.arange(0.006, 0.02, 0.001)]), np.array([[1.0, 0.0, 0.0]])
    at = np.array([[-0.02, 0.001, 0.001], [0.02, 0.001, 0.001], [0.02, 0.015, 0.001]])
    votes = {
        name: space.with_votes(wall, source, eye, ahead, 0.1, 0.3) for name, eye in (("both", source), ("", sensor))
    }
    assert votes["both"].values_at(at, votes["both"].votes).tolist() == [2, 2, -1]
    assert votes[""].values_at(at, votes[""].votes).tolist() == [2, 0, -1]


def test_a_ray_that_may_have_met_the_part_before_the_range_does_not_vote() -> None:
    """A ray does not vote if it crosses unseen or occupied space before the minimum range.

    A part that begins before the range returns no ray, and must remain believed.
    """
    space, ahead = _space(), np.array([[1.0, 0.0, 0.0]])
    source, far = np.array([-0.2, 0.0, 0.0]), np.array([[0.03, 0.001, 0.001]])

    def voted(known: VoxelSpace, near: float) -> int:
        after = known.with_votes(np.empty((0, 3)), source, source, ahead, near, 0.3)
        return int(after.values_at(far, after.votes)[0])

    assert voted(space, 0.14) == 2  # the cylinder begins at 0.15
    assert voted(space, 0.19) == 0
    missed = replace(space, votes=np.full(space.votes.shape, 2, dtype=np.int16))
    assert voted(missed, 0.19) == 4
    state = np.array(missed.state)
    state[tuple(np.floor((np.array([-0.03, 0.001, 0.001]) - space.low) / space.edge).astype(int))] = OCCUPIED
    assert voted(replace(missed, state=state), 0.19) == 2
    assert voted(replace(missed, state=state), 0.16) == 4
    free = replace(space, state=np.full_like(space.state, FREE))
    assert voted(free, 0.19) == 2


def test_tries_are_counted_once_a_voxel_and_reach_to_neighbours() -> None:
    """Two points of one voxel count as one try, which also holds for its neighbours.

    The class includes the distance to the nearest measured voxel.
    """
    space = _space().with_tries(np.array([[0.0, 0.0, 0.001], [0.0, 0.0, 0.0015], [0.02, 0.0, 0.001]]))
    assert space.tries.max() == 1
    points, up = np.array([[0.0, 0.004, 0.001], [0.0, 0.03, 0.001]]), np.tile([0.0, 0.0, 1.0], (2, 1))
    assert space.open_samples_at(points, up).tries.tolist() == [1, 0]
    assert np.isinf(space.open_samples_at(points, up).distance_edges).all()
    state = np.array(space.state)
    state[tuple(np.floor((points[1] - space.low) / space.edge).astype(int))] = OCCUPIED
    beside = replace(space, state=state).open_samples_at(points, up).distance_edges
    assert beside[1] <= np.sqrt(3) / 2
    assert beside[0] == pytest.approx(0.026 / space.edge, abs=2)


def test_the_probability_follows_the_record() -> None:
    """Without observations the probability falls with tries and distance.

    With many observations it is the share found in each class.
    """
    tries, beside = np.repeat(np.arange(3), 2), np.tile([1.0, 20.0], 3)
    unseen = np.zeros(6, dtype=bool)
    before = GainRecord.empty().weights(OpenSamples(tries, beside, unseen))
    assert (np.diff(before[::2]) < 0).all()
    assert (before[1::2] < before[::2]).all()
    assert (
        GainRecord.empty().weights(OpenSamples(np.array([MAX_TRIES, MAX_TRIES + 5]), np.ones(2), unseen[:2])).std() == 0
    )
    often = OpenSamples(np.repeat(tries, 1000), np.repeat(beside, 1000), np.repeat(unseen, 1000))
    shares = [0.6, 0.1, 0.7, 0.0, 1.0, 0.2]
    found = np.concatenate([np.arange(1000) < 1000 * share for share in shares]).astype(float)
    known = GainRecord.empty().with_batch(often, np.ones(6000), found)
    assert known.weights(OpenSamples(tries, beside, unseen)) == pytest.approx(shares, abs=1e-3)
    steep = OpenSamples(tries, beside, ~unseen)
    assert known.weights(steep) == pytest.approx(0.2 * known.weights(OpenSamples(tries, beside, unseen)))
    after = known.with_batch(steep, np.ones(6), np.ones(6))
    assert after.expected == pytest.approx(0.7 * known.expected)
    assert after.found == pytest.approx(0.7 * known.found)


def test_views_are_selected_by_gain_per_second() -> None:
    """Each view has the highest gain per second after those before it, by comparison with brute force.

    Views without gain and unusable views are not selected.
    """
    rng = np.random.default_rng(2)
    measured, areas = rng.random((200, 12)) < 0.2, rng.random(200)
    seconds, usable = rng.uniform(1, 4, 12), np.arange(12) != 5
    selection = select_by_gain_per_second(csr_array(measured), areas, seconds, usable, 4)
    left = areas.copy()
    for view in selection:
        rates = [usable[v] * left[measured[:, v]].sum() / seconds[v] for v in range(12)]
        assert view == int(np.argmax(rates))
        left[measured[:, view]] = 0
    assert len(selection) == 4
    assert len(select_by_gain_per_second(csr_array(measured), np.zeros(200), seconds, usable, 4)) == 0
    assert len(select_by_gain_per_second(csr_array((200, 0)), areas, np.empty(0), np.empty(0, dtype=bool), 4)) == 0
    last = float((measured[:, selection[3]] & ~measured[:, selection[:3]].any(axis=1)) @ areas) / seconds[selection[3]]
    for least, views in ((last * (1 + 1e-9), 3), (last * (1 - 1e-9), 4)):
        assert len(select_by_gain_per_second(csr_array(measured), areas, seconds, usable, 4, least)) == views


def test_the_gain_ratio_is_the_median_of_the_latest_batches() -> None:
    """The gain ratio is 1 without batches, and a single batch with a large gain changes it little."""
    assert gain_ratio([]) == 1
    assert gain_ratio([(1.0, 2.0), (1.0, 2.0), (1.0, 30.0), (0.5, 1.0), (0.0, 7.0)]) == 2
    assert gain_ratio([(1.0, 3.0)]) == 2
    assert gain_ratio([(2.0, 0.0)]) == 0.5
    assert gain_ratio([(1.0, 0.0), (1.0, 0.0)]) == 0
    assert gain_ratio([(1.0, 9.0)] * 9 + [(1.0, 3.0)] * 4) == 3  # early batches are ignored


def _block() -> VoxelSpace:
    """Return a grid with unknown voxels except at its border."""
    return VoxelSpace.from_cylinder(0.08, 0.16, 0.004, 0.003)


def _shell(space: VoxelSpace, radius: float) -> Bools:
    """Return an (X, Y, Z) mask of a closed shell around the centre, one voxel diagonal thick."""
    away = np.linalg.norm(space.centres(np.ones(space.state.shape, dtype=bool)), axis=1).reshape(space.state.shape)
    return np.asarray(np.abs(away - radius) < space.edge)


def _flooded(open_to: Bools, starts: Bools, steps: Ints) -> Bools:
    """Return the voxels reached from the starts by steps on open voxels, by brute force."""
    reached, front = np.array(starts & open_to), [tuple(at) for at in np.argwhere(starts & open_to).tolist()]
    while front:
        at = np.array(front.pop())
        for step in steps:
            to = tuple((at + step).tolist())
            if all(0 <= k < size for k, size in zip(to, reached.shape, strict=True)) and open_to[to] > reached[to]:
                reached[to] = True
                front.append(to)
    return reached


@pytest.mark.parametrize("seed", [0, 1])
def test_the_belief_is_that_of_brute_force(seed: int) -> None:
    """The belief is a flood from occupied voxels, plus everything that a flood from the border does not reach.

    Free voxels are excluded. The grid has random states and votes and includes closed pockets.
    """
    rng, space = np.random.default_rng(seed), VoxelSpace.from_cylinder(0.012, 0.022, 0.001, 0.001)
    state = np.array(space.state)
    inside = state == UNKNOWN
    state[inside & (rng.random(state.shape) < 0.25)] = FREE
    state[inside & (rng.random(state.shape) < 0.002)] = OCCUPIED
    votes = rng.choice([-1, 0, 2], size=state.shape, p=[0.2, 0.6, 0.2]).astype(np.int16)
    occupied = np.argwhere(state == OCCUPIED)
    everywhere = np.argwhere(np.ones(state.shape, dtype=bool))
    steps = np.maximum(np.abs(everywhere[:, None] - occupied) - 3, 0).sum(axis=2)  # a box of 3, then steps to faces
    near = (steps.min(axis=1) <= 5).reshape(state.shape)
    around = np.array([at for at in np.ndindex(3, 3, 3) if at != (1, 1, 1)]) - 1
    solid = (state == OCCUPIED) | ((state == UNKNOWN) & (votes <= 0) & near)
    hit = _flooded(solid, state == OCCUPIED, around)
    border = np.pad(np.zeros(np.array(state.shape) - 2, dtype=bool), 1, constant_values=True)
    outside = _flooded(~hit, border, around[np.abs(around).sum(axis=1) == 1])
    expected = ~outside & (state != FREE)
    assert (expected & ~hit).any()
    assert (~expected & (state == UNKNOWN)).any()
    assert np.array_equal(replace(space, state=state, votes=votes).belief_voxels(), expected)


def test_the_belief_continues_eight_edges_behind_measured_voxels() -> None:
    """The belief has eight layers below a measured plane and none in the free space above it."""
    space = _block()
    state = np.array(space.state)
    state[:, :, 30][state[:, :, 30] == UNKNOWN] = OCCUPIED
    state[:, :, 31:] = FREE
    believed = replace(space, state=state).belief_voxels()
    middle = believed[space.state.shape[0] // 2, space.state.shape[1] // 2]
    assert np.flatnonzero(middle).tolist() == list(range(22, 31))
    assert not believed[:, :, :22].any()
    whole = replace(space, state=state).belief_voxels(unlimited=True)
    assert np.array_equal(whole, state != FREE)


def test_space_inside_a_closed_surface_is_believed_at_any_depth() -> None:
    """Unknown space in a closed surface is believed at any depth, even if voted down; a free pocket stays free.

    A single free crossing of the surface removes the deep voxels from the belief.
    """
    space = _block()
    shell, far = _shell(space, 0.06), _shell(space, 0.0) | _shell(space, 0.07)
    state = np.where(shell, OCCUPIED, np.where(far, FREE, space.state)).astype(np.uint8)
    middle = tuple(size // 2 for size in state.shape)
    deep = (middle[0] + 3, *middle[1:])
    closed = replace(space, state=state)
    assert state[middle] == FREE
    assert not closed.belief_voxels()[middle]
    assert closed.belief_voxels()[deep]
    voted = replace(closed, votes=np.full(state.shape, 2, dtype=np.int16))
    assert voted.belief_voxels()[deep]
    opened = np.array(state)
    opened[middle[0] :, middle[1], middle[2]] = FREE
    assert not replace(closed, state=opened).belief_voxels()[middle[0] - 3, middle[1], middle[2]]
