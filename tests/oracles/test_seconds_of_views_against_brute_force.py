"""Standing and moving together: the bound against every cover, order and joint solution; insertions against tours."""

from itertools import combinations, permutations, product

import numpy as np
import pytest

from planner.ports import JointLimits
from planner.timing.move_time import move_time
from planner.tour.view_times import insertion_times, least_home_time, least_move_times

RANGE = np.full(6, 3.0)
# The ratio of velocity to acceleration differs from axis to axis: no axis' times order the others'.
LIMITS = JointLimits(-RANGE, RANGE, np.array([2.0, 1.0, 2.0, 4.0, 3.0, 6.0]), np.array([4.0, 1.0, 8.0, 3.0, 6.0, 60.0]))
HOME = np.zeros(6)


def tour_time(q: list[np.ndarray]) -> float:
    """Shortest closed tour from home through one joint solution of each view, by enumeration."""
    best = np.inf
    for order in permutations(range(len(q))):
        for chosen in product(*(q[k] for k in order)):
            stops = np.array([HOME, *chosen, HOME])
            best = min(best, float(move_time(stops[:-1], stops[1:], LIMITS).sum()))
    return best


def rows_of(solutions: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Joint solutions one after the other, and where each candidate's begin."""
    return np.concatenate(solutions), np.cumsum([0, *map(len, solutions)])


def check(M: np.ndarray, solutions: list[np.ndarray], standing: float) -> None:
    """The cheapest cover at the least seconds is never above the cheapest cover with its shortest tour."""
    q, offsets = rows_of(solutions)
    costs = standing + least_move_times(q, offsets, HOME, LIMITS)
    bound = truth = np.inf
    usable = [v for v in range(M.shape[1]) if len(solutions[v])]
    for size in range(1, 5):
        for views in combinations(usable, size):
            if M[:, views].any(axis=1).all():
                bound = min(bound, float(costs[list(views)].sum()))
                truth = min(truth, standing * size + tour_time([solutions[v] for v in views]))
    assert np.isfinite(truth), "the example must have a cover of four views"
    assert bound + least_home_time(q, HOME, LIMITS) <= truth * (1 + 1e-12) + 1e-12


@pytest.mark.parametrize("standing", [0.0, 0.3, 2.5])
@pytest.mark.parametrize("seed", range(6))
def test_no_cover_and_tour_undercut_the_bound(seed: int, standing: float) -> None:
    """Seven candidates of up to two joint solutions, some unreachable: every cover of four and every tour over it."""
    rng = np.random.default_rng(seed)
    M = rng.random((8, 7)) < 0.45
    M[np.arange(8), rng.integers(0, 4, 8)] = True
    solutions = [rng.uniform(-1.5, 1.5, (int(rng.integers(1, 3)), 6)) for _ in range(4)]
    solutions += [rng.uniform(-1.5, 1.5, (int(rng.integers(0, 3)), 6)) for _ in range(3)]
    check(M, solutions, standing)


NASTY = {
    "one view does it, the others are far": (np.array([[1, 0, 0], [1, 1, 0]]), [[0.1], [1.4], [-1.4]]),
    "one view, and no other candidate": (np.ones((2, 1)), [[0.5]]),
    "two views on either side": (np.array([[1, 0], [0, 1]]), [[1.0], [-1.0]]),
    "views in one place cost no move between them": (np.array([[1, 0], [0, 1]]), [[1.0], [1.0]]),
    "all at home": (np.eye(3), [[0.0], [0.0], [0.0]]),
    "a candidate that is out of reach": (np.array([[1, 0, 1], [0, 1, 0]]), [[0.4], [0.8], []]),
    "equal costs": (np.eye(4), [[0.7], [-0.7], [0.7], [-0.7]]),
}


@pytest.mark.parametrize("name", NASTY)
@pytest.mark.parametrize("standing", [0.0, 1.0])
def test_nasty_cases_by_name(name: str, standing: float) -> None:
    """The bound holds for one view and for two, without moves, without standing time, without reach."""
    M, angles = NASTY[name]
    check(M.astype(bool), [np.array([np.full(6, a) for a in own]).reshape(-1, 6) for own in angles], standing)


def test_only_the_nearest_moves_are_timed_and_the_bound_still_holds() -> None:
    """Of 120 candidates, each gets half of its two shortest moves over all pairs; of unlike axes, at most that."""
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


def test_what_a_view_adds_to_a_tour_and_takes_from_it() -> None:
    """Insertion of each candidate and removal of each member, against the lengths of the tours with and without."""
    rng = np.random.default_rng(1)
    solutions = [rng.uniform(-1.5, 1.5, (int(k % 3), 6)) for k in range(1, 9)]
    q, offsets = rows_of(solutions)
    views = [4, 0, 3]
    stops = np.array([HOME, *(solutions[v][0] for v in views), HOME])

    def length(at: np.ndarray) -> float:
        return float(move_time(at[:-1], at[1:], LIMITS).sum())

    found = insertion_times(stops, views, q, offsets, LIMITS)
    for place, view in enumerate(views, start=1):
        assert found[view] == pytest.approx(length(stops) - length(np.delete(stops, place, axis=0)))
    for view in {*range(8)} - {*views}:
        longer = [
            length(np.insert(stops, place, own, axis=0)) - length(stops)
            for own in solutions[view]
            for place in range(1, len(stops))
        ]
        assert found[view] == (pytest.approx(max(min(longer), 0.0)) if longer else np.inf)
