"""Exchange of views for alternatives: the motion is never longer and no sample is lost, for every combination."""

import itertools

import numpy as np
import pytest
import scipy.sparse as sp

from planner.ports import JointLimits
from planner.timing.move_time import move_time
from planner.tour import equivalent_views, visits
from planner.tour.equivalent_views import ViewExchange, VisibilityIndex, exchange_views

LIMITS = JointLimits(np.full(6, -3.0), np.full(6, 3.0), np.arange(1.0, 7.0), np.arange(2.0, 8.0))
HOME = np.full(6, 0.25)


class Case:
    """A seeded part of 40 samples with 60 candidates with up to three configurations, and a cover of it."""

    def __init__(self, seed: int, density: float = 0.25) -> None:
        rng = np.random.default_rng(seed)
        self.M = rng.random((40, 60)) < density
        self.areas = rng.uniform(0.5, 2.0, 40)
        self.usable = rng.random(60) < 0.9
        self.q = [rng.uniform(-3, 3, (int(rng.integers(1, 4)), 6)) for _ in range(60)]
        usable = np.flatnonzero(self.usable)
        self.required = np.minimum(self.M[:, usable].sum(axis=1), 1)
        selection: list[int] = []
        while (self.M[:, selection].sum(axis=1) < self.required).any():
            missing = self.M[:, selection].sum(axis=1) < self.required
            gain = [self.M[missing, v].sum() if v not in selection else -1 for v in usable]
            selection.append(int(usable[int(np.argmax(gain))]))
        self.views = np.array(selection)

    def exchanged(self, **arguments: object) -> ViewExchange:
        """Exchange the views with these arguments."""
        index = VisibilityIndex(sp.csr_array(self.M), self.areas, self.usable)
        rng = np.random.default_rng(0)
        return exchange_views(index, self.views, lambda v: self.q[v], HOME, LIMITS, rng, **arguments)  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", range(3))
def test_nothing_is_lost_in_any_combination(seed: int) -> None:
    """Every combination of picks (or 300 random ones) measures each sample that was measured before.

    There are no more views than before, all usable, and the motion is not longer.
    """
    case = Case(seed)
    found = case.exchanged()
    assert found.duration <= found.duration_before * (1 + 1e-12)
    assert len(found.views) <= len(case.views)
    assert case.usable[np.concatenate(found.groups)].all()
    assert [group[0] for group in found.groups] == found.views.tolist()
    members = np.concatenate(found.groups)
    assert len(np.unique(members)) == len(members)
    rng = np.random.default_rng(seed)
    total = int(np.prod([len(group) for group in found.groups]))
    picked = (
        itertools.product(*found.groups) if total < 300 else ([rng.choice(g) for g in found.groups] for _ in range(300))
    )
    for picks in picked:
        assert (case.M[:, list(picks)].sum(axis=1) >= case.required).all()


def test_exchanges_shorten_the_motion() -> None:
    """Over the seeds the exchange saves at least 5 % on average."""
    found = [Case(seed).exchanged() for seed in range(3)]
    assert np.mean([x.duration / x.duration_before for x in found]) < 0.95


def test_equal_seeds_give_equal_exchanges() -> None:
    """Equal inputs and seeds give equal views and groups."""
    one, two = Case(3).exchanged(), Case(3).exchanged()
    np.testing.assert_array_equal(one.views, two.views)
    for a, b in zip(one.groups, two.groups, strict=True):
        np.testing.assert_array_equal(a, b)


def test_nothing_is_lost_with_too_many_configurations(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each view keeps a few of them: the views measure as much, and the motion is not longer."""
    monkeypatch.setattr(visits, "_MAX_NODES", 10)
    for seed in range(2):
        case = Case(seed)
        found = case.exchanged()
        assert (case.M[:, found.views].sum(axis=1) >= case.required).all()
        assert found.duration <= found.duration_before * (1 + 1e-12)


def test_the_kept_configurations_are_the_best(monkeypatch: pytest.MonkeyPatch) -> None:
    """The ones with the shortest detours, ascending; never fewer than a few."""
    monkeypatch.setattr(visits, "_MAX_NODES", 10)
    detours = np.random.default_rng(0).random(9)
    for n_views, count in ((2, 5), (100, 4), (1, 9)):
        assert visits.best_nodes_on_tour(detours, n_views).tolist() == sorted(np.argsort(detours)[:count].tolist())


def test_pinned_views_stay_and_replace_no_other() -> None:
    """The group of a pinned view is the view itself."""
    case = Case(1)
    pinned = case.views[:2].tolist()
    found = case.exchanged(pinned=pinned)
    for view in pinned:
        assert view in found.views
        assert found.groups[found.views.tolist().index(view)].tolist() == [view]


@pytest.mark.parametrize("seed", range(2))
def test_the_slack_bounds_the_lost_area(seed: int) -> None:
    """The new views measure at most the slack less than the given ones."""
    case = Case(seed)
    slack = 0.05 * case.areas.sum()
    found = case.exchanged(slack=slack)
    before, after = (float(case.areas[case.M[:, v].any(axis=1)].sum()) for v in (case.views, found.views))
    assert after >= before - slack - 1e-12
    assert found.duration <= found.duration_before * (1 + 1e-12)


@pytest.mark.parametrize("count", [0, 1])
def test_no_view_and_one_view(count: int) -> None:
    """No view gives no view, and one view may be exchanged for any that measures as much."""
    case = Case(0)
    case.views = case.views[:count]
    found = case.exchanged()
    assert len(found.views) == count
    if count:
        alone = case.M[:, case.views[0]]
        expected = np.flatnonzero(case.usable & case.M[alone].all(axis=0))
        assert set(found.groups[0]) == set(expected[: equivalent_views.MAX_ALTERNATIVES])


def test_a_candidate_without_configurations_replaces_no_view() -> None:
    """A copy of a column without configurations is in no group."""
    case = Case(2)
    view = int(case.views[0])
    copy = next(v for v in range(60) if v not in case.views)
    case.M[:, copy] = case.M[:, view]
    case.q[copy] = np.zeros((0, 6))
    case.usable[copy] = True
    assert copy not in np.concatenate(case.exchanged().groups)


@pytest.mark.parametrize("seed", range(2))
def test_alternatives_are_ranked_by_their_detours_from_the_given_tour(seed: int) -> None:
    """The rank is the smallest time from the previous stop to the next, for the given tour."""
    case = Case(seed)
    tours = equivalent_views._Tours(lambda view: case.q[view], HOME, LIMITS, np.random.default_rng(seed))
    alone = [case.views[k : k + 1] for k in range(len(case.views))]
    found = tours.first(case.views)
    others = np.setdiff1d(np.arange(60), case.views)
    groups = [np.concatenate([view, others]) for view in alone]
    tours.along(found, groups)
    ranked = tours.nearest(found, groups)
    stops = [HOME, *found.q, HOME]
    for place, group in enumerate(found.order, start=1):

        def through(view: int, place: int = place) -> float:
            detours = [
                move_time(stops[place - 1], q, LIMITS) + move_time(q, stops[place + 1], LIMITS) for q in case.q[view]
            ]
            return float(min(detours))

        expected = sorted(others.tolist(), key=through)[: equivalent_views.MAX_ALTERNATIVES - 1]
        assert ranked[group].tolist() == [case.views[group], *expected]
