"""Views picked by a motion become the plan: sorted by what they add, the motion's numbers following them."""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

from cell.plan import view_exchange, view_plan
from cell.plan.request import Request
from cell.plan.view_exchange import _taken_back, settled, shorter
from cell.plan.views import Groups, Next
from cell.scene.model import PlanSettings
from planner import cover
from planner.cover import CoverStatus
from planner.ports import JointLimits
from planner.timing.move_time import move_time
from planner.tour.tour import Tour, TourStatus, plan_tour
from planner.tour.visits import Visits

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
M = SimpleNamespace(matrix=lambda: sp.csr_array(MATRIX), samples=SimpleNamespace(areas=AREAS), shape=MATRIX.shape)


def groups() -> Groups:
    """Each view with its stand-in: two joint solutions of the view, then one of the stand-in."""
    members = tuple(np.array([k, k + 3]) for k in range(3))
    owner = tuple(np.array([k, k, k + 3]) for k in range(3))
    q = tuple(np.array([[2.0, k, 0, 0, 0, 0], [2.5, k, 0, 0, 0, 0], [0.2 * k, 0.1, 0, 0, 0, 0]]) for k in range(3))
    return Groups(members, owner, q)


def motion(found: Groups) -> Tour:
    """The motion over the groups; the stand-ins lie nearest to home."""
    poses = np.tile(np.eye(4), (3, 1, 1))
    return plan_tour(Visits(found.configurations, HOME, poses), Open(), LIMITS, np.random.default_rng(0))


def test_the_plan_is_what_the_motion_picked() -> None:
    """Cover and motion name the same candidates at the same stops; areas add up; the number of views stays."""
    rows = MATRIX[:, :3].any(axis=1)
    chosen = cover.solve(cover.CoverProblem(MATRIX[:, :3], AREAS), rng=np.random.default_rng(0))
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
    chosen = cover.solve(cover.CoverProblem(MATRIX[:, :3], AREAS), rng=np.random.default_rng(0))
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


class Shown:
    """Views whose arm hides more, or not, where a motion takes them otherwise."""

    def __init__(self, found: Groups, hides_no_more: bool = True) -> None:
        self.found, self.hides = found, not hides_no_more

    def still_measure(self, _: np.ndarray) -> bool:
        return True

    def refusals(self, _: np.ndarray) -> dict[int, str]:
        return {}

    def groups(self, *_: object) -> Groups:
        return self.found

    def alone(self, views: np.ndarray) -> Groups:
        members = tuple(views[k : k + 1] for k in range(len(views)))
        return Groups(members, members, tuple(np.zeros((1, 6)) for _ in views))

    def judge(self, *_: object) -> Next:
        return Next.DONE

    def finer(self, found: Groups, *_: object) -> Groups:
        return replace(found)

    def hides_no_more(self, *_: object) -> bool:
        return not self.hides


@dataclass
class Stub:
    """What connecting asks of a problem."""

    request: SimpleNamespace
    usable: Any = lambda _: None


@dataclass
class Lasts:
    """A motion of so many seconds."""

    duration: float
    detour: np.ndarray = field(default_factory=lambda: np.zeros(2, dtype=bool))
    dropped: tuple[int, ...] = ()
    order: np.ndarray = field(default_factory=lambda: np.arange(0))
    choice: np.ndarray = field(default_factory=lambda: np.arange(0))
    status: TourStatus = TourStatus.COMPLETE


@pytest.mark.parametrize("hides_no_more", [True, False])
def test_a_shorter_motion_at_other_solutions_is_taken_where_their_arms_hide_no_more(
    hides_no_more: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At a solution of the scene's angles that the motion did not take nobody has looked at the arm."""
    monkeypatch.setattr(view_plan, "_motion", lambda *_: Lasts(9.0))
    monkeypatch.setattr(view_plan, "_visited", lambda *_: ())
    problem = Stub(Request(PlanSettings()))
    coarse = view_plan._Connected(groups(), Lasts(10.0))
    found = view_plan._at_finer_angles(problem, Shown(coarse.groups, hides_no_more), None, coarse, None)
    assert found.motion.duration == (9.0 if hides_no_more else 10.0)


@pytest.mark.parametrize(
    ("seconds", "time_counts", "compared"),
    [(101.0, False, False), (103.0, False, True), (99.0, True, False), (101.0, True, True)],
)
def test_what_detours_may_lengthen_is_compared_where_time_counts(
    seconds: float, time_counts: bool, compared: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of many views 2 % of 100 s of motion are left unasked; not where it is seconds that were asked for."""
    planned = []

    def motion_of(_: object, __: object, ___: object, found: Groups, *____: object) -> Lasts:
        planned.append(found)
        return Lasts(seconds)

    monkeypatch.setattr(view_plan, "_motion", motion_of)
    views, standing = np.arange(30), 10.0 if time_counts else 0.0
    exchanged = replace(Shown(groups()).alone(views), straight_before=100.0 + 30 * standing)
    selected = SimpleNamespace(cover=SimpleNamespace(views=views))
    problem = Stub(replace(Request(PlanSettings()), costs=np.ones(30) if time_counts else None))
    monkeypatch.setattr(Request, "standing", standing)
    monkeypatch.setattr(Groups, "exchanged", True)
    view_plan._connect(problem, Shown(exchanged), selected, (), (), None, None)
    assert len(planned) == (2 if compared else 1)


@pytest.mark.parametrize(("durations", "least"), [((12.0, 10.5, 11.0), 10.5), ((12.0, 9.5), 9.5), ((8.5,), 8.5)])
def test_the_motion_of_another_cover_is_compared_with_those_that_straight_moves_put_behind_it(
    durations: tuple[float, ...], least: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where detours cost what was gained: with the exchange of the cover, and where that has detours, the cover."""
    motions = iter(durations)
    monkeypatch.setattr(view_plan, "_motion", lambda *_: Lasts(next(motions)))
    views = np.arange(3)
    exchange = replace(Shown(groups()).alone(views), straight_before=10.0)
    other = replace(exchange, straight_before=9.0, instead=exchange)
    selected = SimpleNamespace(cover=SimpleNamespace(views=views))
    found = view_plan._connect(Stub(Request(PlanSettings())), Shown(other), selected, (), (), None, None)
    assert isinstance(found, view_plan._Connected)
    assert found.motion.duration == least
    assert next(motions, None) is None


@pytest.mark.parametrize("back", [[0, 1, 2], [0, 4, 2]], ids=["all", "one"])
def test_views_taken_back_have_the_seconds_of_their_own_tour(back: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    """Where seconds decide, a cover is not told shorter by stand-ins that it does not have."""
    q = 0.1 * np.eye(6) * np.array([[6], [5], [4], [3], [2], [1]])  # 3 to 5 stand nearer to home than 0 to 2
    alike = SimpleNamespace(
        matrix=lambda: sp.csr_array(np.eye(6)[3:] + np.eye(6)[:3]), samples=Seen(np.ones(3)).samples, shape=(3, 6)
    )
    arm = SimpleNamespace(M=alike, configurations=lambda view: q[view][None])
    known = SimpleNamespace(share_of_coverable=lambda views: 0.5)
    problem = SimpleNamespace(
        request=replace(Request(PlanSettings(coverage=0.4)), costs=np.ones(6)), prediction=known, limits=LIMITS,
        world=SimpleNamespace(home=HOME), candidates=SimpleNamespace(T_object_scanner=np.zeros((6, 1, 4, 4))),
    )  # fmt: skip
    chosen = SimpleNamespace(
        views=np.arange(3), covered_area=3.0, coverable_area=6.0, pinned=np.zeros(0, dtype=np.int64)
    )
    selected = SimpleNamespace(cover=chosen, target=0.5, shares=np.array([0.9]))
    monkeypatch.setattr(view_exchange, "_taken_back", lambda *_: np.array(back))
    rng = np.random.default_rng(0)
    before = view_exchange._exchanged(problem, arm, selected, np.ones(6, dtype=bool), rng)
    found, members = view_exchange._timed(problem, arm, before, rng)
    assert [group.tolist() for group in members] == [[view] for view in back]
    assert sorted(found.visited) == sorted(back)
    stops = np.concatenate([[HOME], q[found.visited], [HOME]])
    assert found.duration == pytest.approx(move_time(stops[:-1], stops[1:], LIMITS).sum())
    assert found.duration_before == before[0].duration_before
    assert view_exchange._timed(problem, arm, (found, members), rng)[0] is found


def test_other_covers_are_compared_by_the_seconds_of_their_own_tour(monkeypatch: pytest.MonkeyPatch) -> None:
    """A cover whose exchange was taken back, 9 s for the 1 s of its stand-ins, does not take the place of 5 s."""
    views = SimpleNamespace(cover=SimpleNamespace(views=np.array([2])))
    tour = SimpleNamespace(views=np.array([1]), stops=None, visited=None, duration=1.0)
    first = SimpleNamespace(**{**vars(tour), "views": np.array([0]), "duration": 5.0})
    monkeypatch.setattr(view_exchange, "select", lambda *_, **__: views)
    monkeypatch.setattr(view_exchange, "insertion_times", lambda *_: np.zeros(3))
    monkeypatch.setattr(view_exchange, "_exchanged", lambda *_: (tour, (np.array([1]),)))
    timed = SimpleNamespace(**{**vars(tour), "duration": 9.0})
    monkeypatch.setattr(view_exchange, "_timed", lambda *_: (timed, (np.array([1]),)))
    problem = SimpleNamespace(
        request=replace(Request(PlanSettings()), costs=np.ones(3)), limits=LIMITS, candidates=None, prediction=None,
        reached=SimpleNamespace(q=None, offsets=None, reachable=np.ones(3, dtype=bool)),
    )  # fmt: skip
    usable, rng = np.ones(3, dtype=bool), np.random.default_rng(0)
    arm, given = SimpleNamespace(M=None), (first, (np.array([0]),))
    assert view_exchange._other_covers(problem, arm, None, given, usable, rng)[0] is first


@pytest.mark.parametrize("better", [True, False])
def test_another_cover_is_connected_with_the_exchange_of_the_fewest_views_behind_it(
    better: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It has to take less than these views stand and move straight; where no cover is better, they are all there is."""
    arm: Any = SimpleNamespace(configurations=lambda view: np.full((1, 6), float(view)))
    few = SimpleNamespace(duration=4.0, duration_before=6.0, visited=np.array([1, 0]), orderings=1)
    own, other = ((np.array([0]), np.array([1])), (np.array([2]),))
    found = SimpleNamespace(**{**vars(few), "visited": np.array([2])})
    monkeypatch.setattr(view_exchange, "_exchanged", lambda *_: (few, own))
    monkeypatch.setattr(view_exchange, "_timed", lambda _, __, exchanged, ___: exchanged)
    monkeypatch.setattr(view_exchange, "_other_covers", lambda *_: (found, other) if better else (few, own))
    monkeypatch.setattr(Request, "standing", 2.5)
    problem: Any = SimpleNamespace(request=replace(Request(PlanSettings()), costs=np.ones(3)))
    selected: Any = SimpleNamespace(cover=SimpleNamespace(views=np.arange(2)))
    told = view_exchange.groups(problem, arm, selected, np.ones(3, dtype=bool), np.random.default_rng(0))
    exchanged = told.instead if better else told
    assert exchanged is not None
    assert (exchanged.straight_before, exchanged.visited, exchanged.instead) == (6.0 + 2 * 2.5, (1, 0), None)
    if better:
        assert (told.straight_before, told.visited, len(told.members)) == (4.0 + 2 * 2.5, (2,), 1)


class Seen:
    """Held-out samples of equal areas, and what each candidate measures of them, asked as `Prediction` is."""

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
def test_views_are_taken_back_until_the_share_is_kept(seed: int) -> None:
    """Every view is the exchange's or the one that it stands in for; few come back for a little, none for nothing."""
    rng = np.random.default_rng(seed)
    known = Seen(rng.random((400, 40)) < 0.1)
    problem = SimpleNamespace(prediction=known, candidates=SimpleNamespace(T_object_scanner=np.arange(40)))
    own, found = np.arange(20), SimpleNamespace(views=np.arange(20, 39), replaces=np.arange(1, 20))
    least, low = known.share_of_coverable(own), known.share_of_coverable(found.views)
    back = []
    for asked in (low, low + 0.25 * (least - low) if least > low else low, least):
        views = _taken_back(problem, own, found, asked)  # type: ignore[arg-type]
        assert known.share_of_coverable(views) >= asked
        if len(views) == len(found.views):
            assert ((views == found.views) | (views == own[found.replaces])).all()
            back.append(int((views != found.views).sum()))
        else:
            np.testing.assert_array_equal(views, own)
    assert back[0] == 0
