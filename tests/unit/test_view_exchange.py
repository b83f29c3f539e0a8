"""Views picked by a motion become the plan: sorted by what they add, the motion's numbers following them."""

from types import SimpleNamespace

import numpy as np
import pytest
import scipy.sparse as sp

from cell.plan.view_exchange import settled, shorter
from cell.plan.views import Groups
from planner import cover
from planner.cover import CoverStatus
from planner.order.tour import Tour, plan_motion
from planner.order.visits import Visits
from planner.ports import JointLimits

RANGE = np.full(6, 3.0)
LIMITS = JointLimits(-RANGE, RANGE, np.full(6, 2.0), np.full(6, 4.0))
HOME = np.zeros(6)


class Open:
    """A place without obstacles."""

    clearance = 0.01

    def free(self, q: np.ndarray) -> np.ndarray:
        return np.ones(len(q), dtype=bool)

    def contacts(self, q: np.ndarray) -> tuple[str, ...]:
        return ()

    def distance(self, q: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
        return np.full(len(q), 9.0), ("nothing",) * len(q)

    def travel(self, q_from: np.ndarray, q_to: np.ndarray) -> np.ndarray:
        return np.abs(np.asarray(q_to) - q_from).sum(axis=-1)


# Six candidates over six samples; 3 measures what 0 does and more, 4 and 5 what 1 and 2 do.
MATRIX = np.array(
    [
        [1, 0, 0, 1, 0, 0],
        [0, 0, 0, 1, 0, 0],
        [0, 1, 0, 0, 1, 0],
        [0, 1, 0, 1, 1, 0],
        [0, 0, 1, 0, 0, 1],
        [0, 0, 0, 0, 0, 1],
    ],
    dtype=bool,
)
AREAS = np.array([1.0, 2, 4, 8, 16, 32])
M = SimpleNamespace(matrix=lambda: sp.csr_array(MATRIX), features=SimpleNamespace(areas=AREAS), shape=MATRIX.shape)


def groups() -> Groups:
    """Each view with its stand-in: two joint solutions of the view, then one of the stand-in."""
    members = tuple(np.array([k, k + 3]) for k in range(3))
    owner = tuple(np.array([k, k, k + 3]) for k in range(3))
    q = tuple(np.array([[2.0, k, 0, 0, 0, 0], [2.5, k, 0, 0, 0, 0], [0.2 * k, 0.1, 0, 0, 0, 0]]) for k in range(3))
    return Groups(members, owner, q)


def motion(found: Groups) -> Tour:
    """The motion over the groups; the stand-ins lie nearest to home."""
    poses = np.tile(np.eye(4), (3, 1, 1))
    return plan_motion(Visits(found.configurations, HOME, poses), Open(), LIMITS, np.random.default_rng(0))


def test_the_plan_is_what_the_motion_picked() -> None:
    """Cover and motion name the same candidates at the same stops; areas add up; the number of views stays."""
    rows = MATRIX[:, :3].any(axis=1)
    chosen = cover.solve(cover.Problem(MATRIX[:, :3], AREAS), rng=np.random.default_rng(0))
    found = groups()
    tour = motion(found)
    picks = found.picked(tour)
    np.testing.assert_array_equal(picks, [3, 4, 5])
    plan, remapped = settled(chosen, M, tour, picks)  # type: ignore[arg-type]
    np.testing.assert_array_equal(plan.views[remapped.order], picks[tour.order])
    at = tour.view >= 0
    np.testing.assert_array_equal(plan.views[remapped.view[at]], picks[tour.view[at]])
    assert (remapped.view[~at] == -1).all()
    np.testing.assert_array_equal(plan.views, [5, 4, 3])
    np.testing.assert_allclose(plan.marginal_area, [48.0, 12.0, 3.0])
    assert plan.covered_area == AREAS.sum() > AREAS[rows].sum()
    assert (len(plan.views), plan.lower_bound, plan.status) == (3, 3, CoverStatus.PROVEN)


def test_nothing_changes_where_nothing_was_exchanged() -> None:
    """The same objects come back."""
    chosen = cover.solve(cover.Problem(MATRIX[:, :3], AREAS), rng=np.random.default_rng(0))
    found = groups()
    tour = motion(found)
    assert settled(chosen, M, tour, np.array(chosen.views)) == (chosen, tour)  # type: ignore[arg-type]


@pytest.mark.parametrize(("dropped", "expected"), [((0, 0), 1), ((0, 1), 0), ((1, 0), 1)])
def test_the_shorter_motion_that_visits_more_is_kept(dropped: tuple[int, int], expected: int) -> None:
    """The second motion is shorter: it wins unless it drops a view that the first does not."""
    planned = [
        (groups(), SimpleNamespace(dropped=(None,) * count, duration=duration))
        for count, duration in zip(dropped, (2.0, 1.0), strict=True)
    ]
    assert shorter(*planned) is planned[expected]  # type: ignore[arg-type]
