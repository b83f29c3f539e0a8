"""Swapped views: the views selected by the motion become the plan, and original views are restored."""

from types import SimpleNamespace

import numpy as np
import pytest
import scipy.sparse as sp

from cell.plan.improvement import EquivalentViews, cover_of_motion, restored_views, shorter_motion
from planner import cover
from planner.cover import CoverStatus
from planner.ports import JointLimits
from planner.tour.tour import Tour, plan_tour
from planner.tour.visits import Visits

RANGE = np.full(6, 3.0)
LIMITS = JointLimits(-RANGE, RANGE, np.full(6, 2.0), np.full(6, 4.0))
HOME = np.zeros(6)


class Open:
    """Collision checker of a space without obstacles."""

    clearance = 0.01

    def free(self, q: np.ndarray) -> np.ndarray:
        return np.ones(len(q), dtype=bool)

    def contacts(self, q: np.ndarray) -> tuple[str, ...]:
        return ()

    def distance(self, q: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
        return np.full(len(q), 9.0), ("nothing",) * len(q)

    def travel(self, q_from: np.ndarray, q_to: np.ndarray) -> np.ndarray:
        return np.abs(np.asarray(q_to) - q_from).sum(axis=-1)


# Six candidates over six samples; 3, 4 and 5 measure the samples of 0, 1 and 2 and more.
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
M = SimpleNamespace(matrix=lambda: sp.csr_array(MATRIX), samples=SimpleNamespace(areas=AREAS), shape=MATRIX.shape)


def groups() -> EquivalentViews:
    """Return three views with an alternative each: two configurations of the view and one of the alternative."""
    members = tuple(np.array([k, k + 3]) for k in range(3))
    owner = tuple(np.array([k, k, k + 3]) for k in range(3))
    q = tuple(np.array([[2.0, k, 0, 0, 0, 0], [2.5, k, 0, 0, 0, 0], [0.2 * k, 0.1, 0, 0, 0, 0]]) for k in range(3))
    return EquivalentViews(members, owner, q)


def motion(found: EquivalentViews) -> Tour:
    """Return the tour over the groups; the alternatives are nearest to home."""
    poses = np.tile(np.eye(4), (3, 1, 1))
    return plan_tour(Visits(found.configurations, HOME, poses), Open(), LIMITS, np.random.default_rng(0))


def test_the_plan_has_the_picks_of_the_motion() -> None:
    """Cover and motion have the same candidates at the same stops."""
    rows = MATRIX[:, :3].any(axis=1)
    selection = cover.solve(cover.CoverProblem(MATRIX[:, :3], AREAS), rng=np.random.default_rng(0))
    found = groups()
    tour = motion(found)
    picks = found.picked_by(tour)
    np.testing.assert_array_equal(picks, [3, 4, 5])
    plan, remapped = cover_of_motion(selection, M, tour, picks)  # type: ignore[arg-type]
    np.testing.assert_array_equal(plan.views[remapped.order], picks[tour.order])
    at = tour.view >= 0
    np.testing.assert_array_equal(plan.views[remapped.view[at]], picks[tour.view[at]])
    assert (remapped.view[~at] == -1).all()
    np.testing.assert_array_equal(plan.views, [5, 4, 3])
    np.testing.assert_allclose(plan.marginal_area, [48.0, 12.0, 3.0])
    assert plan.covered_area == AREAS.sum() > AREAS[rows].sum()
    assert (len(plan.views), plan.lower_bound, plan.status) == (3, 3, CoverStatus.PROVEN)


def test_nothing_changes_without_swaps() -> None:
    """Without swaps cover and motion are returned unchanged."""
    selection = cover.solve(cover.CoverProblem(MATRIX[:, :3], AREAS), rng=np.random.default_rng(0))
    found = groups()
    tour = motion(found)
    assert cover_of_motion(selection, M, tour, np.array(selection.views)) == (selection, tour)  # type: ignore[arg-type]


@pytest.mark.parametrize(("dropped", "expected"), [((0, 0), 1), ((0, 1), 0), ((1, 0), 1)])
def test_the_shorter_of_two_motions_through_all_views_is_kept(dropped: tuple[int, int], expected: int) -> None:
    """The shorter second motion is kept unless it drops a view that the first does not."""
    planned = [
        (groups(), SimpleNamespace(dropped=(None,) * count, duration=duration))
        for count, duration in zip(dropped, (2.0, 1.0), strict=True)
    ]
    assert shorter_motion(*planned) is planned[expected]  # type: ignore[arg-type]


class Seen:
    """Held-out samples of equal areas and the samples that each candidate measures, as a part of `Prediction`."""

    def __init__(self, measured: np.ndarray) -> None:
        self.measured = measured
        self.samples = SimpleNamespace(areas=np.ones(len(measured)))
        self.coverable = SimpleNamespace(area=float(len(measured)))

    def visible(self, views: np.ndarray) -> SimpleNamespace:
        return SimpleNamespace(covered=self.measured[:, views].any(axis=1))

    def share_of_coverable(self, views: np.ndarray) -> float:
        return float(self.visible(views).covered.mean())

    def seen(self, views: np.ndarray, among: np.ndarray) -> np.ndarray:
        return np.asarray(self.measured[np.ix_(among, views)])


@pytest.mark.parametrize("seed", range(8))
def test_original_views_are_restored_until_the_share_is_kept(seed: int) -> None:
    """Each view is the swapped or the original one. None is restored if the share is kept without it."""
    rng = np.random.default_rng(seed)
    known = Seen(rng.random((400, 40)) < 0.1)
    problem = SimpleNamespace(prediction=known, candidates=SimpleNamespace(T_object_scanner=np.arange(40)))
    own, found = np.arange(20), SimpleNamespace(views=np.arange(20, 39), replaces=np.arange(1, 20))
    least, low = known.share_of_coverable(own), known.share_of_coverable(found.views)
    back = []
    for requests in (low, low + 0.25 * (least - low) if least > low else low, least):
        views = restored_views(problem, own, found, requests)  # type: ignore[arg-type]
        assert known.share_of_coverable(views) >= requests
        if len(views) == len(found.views):
            assert ((views == found.views) | (views == own[found.replaces])).all()
            back.append(int((views != found.views).sum()))
        else:
            np.testing.assert_array_equal(views, own)
    assert back[0] == 0
