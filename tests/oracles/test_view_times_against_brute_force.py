"""Dwell and motion times of views: the bound for every cover, order and configuration; insertions into tours."""

from itertools import combinations, permutations, product

import numpy as np
import pytest

from planner.ports import JointLimits
from planner.timing.move_time import move_time
from planner.tour.view_times import insertion_times, least_home_time, least_move_times

RANGE = np.full(6, 3.0)
# The ratio of velocity to acceleration differs from axis to axis: the order of times differs by axis.
LIMITS = JointLimits(-RANGE, RANGE, np.array([2.0, 1.0, 2.0, 4.0, 3.0, 6.0]), np.array([4.0, 1.0, 8.0, 3.0, 6.0, 60.0]))
HOME = np.zeros(6)


def tour_time(q: list[np.ndarray]) -> float:
    """Return the shortest closed tour from home through one configuration of each view, by enumeration."""
    best = np.inf
    for order in permutations(range(len(q))):
        for configurations in product(*(q[k] for k in order)):
            stops = np.array([HOME, *configurations, HOME])
            best = min(best, float(move_time(stops[:-1], stops[1:], LIMITS).sum()))
    return best


def rows_of(configurations: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Concatenate configurations; return also the first row of each candidate."""
    return np.concatenate(configurations), np.cumsum([0, *map(len, configurations)])


def check(M: np.ndarray, configurations: list[np.ndarray], dwell: float) -> None:
    """Require the cheapest cover with bounded times not to exceed the cheapest cover with its shortest tour."""
    q, offsets = rows_of(configurations)
    costs = dwell + least_move_times(q, offsets, HOME, LIMITS)
    bound = truth = np.inf
    usable = [v for v in range(M.shape[1]) if len(configurations[v])]
    for size in range(1, 5):
        for views in combinations(usable, size):
            if M[:, views].any(axis=1).all():
                bound = min(bound, float(costs[list(views)].sum()))
                truth = min(truth, dwell * size + tour_time([configurations[v] for v in views]))
    assert np.isfinite(truth), "the example must have a cover of four views"
    assert bound + least_home_time(q, HOME, LIMITS) <= truth * (1 + 1e-12) + 1e-12


@pytest.mark.parametrize(("seed", "dwell"), [(0, 0.3), (1, 2.5), (3, 0.0)])
def test_no_cover_with_its_tour_undercuts_the_bound(seed: int, dwell: float) -> None:
    """Seven candidates with up to two configurations, some unreachable: every cover of four, every tour over it."""
    rng = np.random.default_rng(seed)
    M = rng.random((8, 7)) < 0.45
    M[np.arange(8), rng.integers(0, 4, 8)] = True
    configurations = [rng.uniform(-1.5, 1.5, (int(rng.integers(1, 3)), 6)) for _ in range(4)]
    configurations += [rng.uniform(-1.5, 1.5, (int(rng.integers(0, 3)), 6)) for _ in range(3)]
    check(M, configurations, dwell)


def test_the_bound_holds_if_only_the_nearest_moves_are_timed() -> None:
    """Each of 120 candidates has half of its two shortest moves over all pairs; with unlike axes at most that."""
    rng = np.random.default_rng(0)
    q, offsets = rows_of([rng.uniform(-1.5, 1.5, (2, 6)) for _ in range(120)])
    for limits in (LIMITS, JointLimits(-RANGE, RANGE, LIMITS.velocity, 2 * LIMITS.velocity)):
        found = least_move_times(q, offsets, HOME, limits)
        to_view = np.minimum.reduceat(move_time(q[:, None], q, limits), offsets[:-1], axis=1)
        to_view[np.arange(240), np.repeat(np.arange(120), 2)] = np.inf
        home = move_time(HOME, q, limits)
        both = np.sort(np.column_stack([to_view, home, home]), axis=1)[:, :2].sum(axis=1)
        truth = 0.5 * both.reshape(120, 2).min(axis=1)
        assert (found <= truth + 1e-12).all()
    np.testing.assert_allclose(found, truth, rtol=1e-12)


def test_insertion_and_removal_times() -> None:
    """Insertion of each candidate and removal of each member, compared with the tours with and without it."""
    rng = np.random.default_rng(1)
    configurations = [rng.uniform(-1.5, 1.5, (int(k % 3), 6)) for k in range(1, 9)]
    q, offsets = rows_of(configurations)
    views = [4, 0, 3]
    stops = np.array([HOME, *(configurations[v][0] for v in views), HOME])

    def length(at: np.ndarray) -> float:
        return float(move_time(at[:-1], at[1:], LIMITS).sum())

    found = insertion_times(stops, views, q, offsets, LIMITS)
    for place, view in enumerate(views, start=1):
        assert found[view] == pytest.approx(length(stops) - length(np.delete(stops, place, axis=0)))
    for view in {*range(8)} - {*views}:
        longer = [
            length(np.insert(stops, place, own, axis=0)) - length(stops)
            for own in configurations[view]
            for place in range(1, len(stops))
        ]
        assert found[view] == (pytest.approx(max(min(longer), 0.0)) if longer else np.inf)
