"""A coverage below 1 is a promise about the surface: it is kept on samples that the optimiser has not seen."""

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.sparse import csr_array

from cell.plan import denser_samples
from cell.plan.request import LOOK_WORK, Request, Selected, select
from cell.scene.model import PlanSettings


def covered(asked: float, share_of_view: list[float]) -> tuple[int, float]:
    """Views and final target where view i measures its own tenth of ten samples and its share of the held-out ones."""
    n = len(share_of_view)
    M = SimpleNamespace(matrix=lambda: csr_array(np.eye(n, dtype=bool)), samples=SimpleNamespace(areas=np.ones(n)))
    candidates = SimpleNamespace(T_object_scanner=np.arange(n))
    prediction = SimpleNamespace(share_of_coverable=lambda views: float(np.take(share_of_view, views).sum()))
    selected = select(
        Request(PlanSettings(coverage=asked)), M, SimpleNamespace(reachable=np.ones(n, dtype=bool)), candidates,
        prediction,
        banned=(), rng=np.random.default_rng(0),
    )  # fmt: skip
    return len(selected.cover.views), selected.target


def test_a_plan_that_keeps_its_promise_is_not_touched() -> None:
    """Half of ten equal samples: five views, and the target is what was asked."""
    assert covered(0.5, [0.1] * 10) == (5, 0.5)


def test_the_target_is_raised_until_the_held_out_share_is_there() -> None:
    """Each view measures 0.08 of what is held out: half of it needs seven views, not the five of the matrix."""
    views, target = covered(0.5, [0.08] * 10)
    assert views == 7
    assert 0.5 < target <= 0.7


def test_what_cannot_be_kept_ends_at_everything() -> None:
    """Views that measure almost nothing of the rest: all of them are taken and the target is 1."""
    views, target = covered(0.5, [0.001] * 10)
    assert (views, target) == (10, pytest.approx(1.0))


def test_weighted_views_claim_no_more_than_they_were_asked_for() -> None:
    """One view measures nine tenths of the area and half of the weight: half is what it may count as."""
    areas, weights = np.array([9.0, *[0.1] * 10]), np.array([10.0, *[1.0] * 10])
    goals = SimpleNamespace(
        coverage=np.array([0.5]), plain=False, applied=lambda wish, _: replace(wish, weights=weights),
        shares=lambda *_: np.array([0.4]),
    )  # fmt: skip
    M = SimpleNamespace(matrix=lambda: csr_array(np.eye(11, dtype=bool)), samples=SimpleNamespace(areas=areas))
    looked = select(
        Request(PlanSettings(coverage=0.5), goals=goals), M, SimpleNamespace(reachable=np.ones(11, dtype=bool)),
        SimpleNamespace(T_object_scanner=np.arange(11)), SimpleNamespace(),
        banned=(), rng=np.random.default_rng(0), look=LOOK_WORK,
    )  # fmt: skip
    measured = weights[looked.cover.views].sum() / weights.sum()
    assert looked.cover.covered_area / areas.sum() > 0.8
    assert looked.claimed == pytest.approx([0.5])
    assert looked.claimed <= measured


@pytest.mark.parametrize(
    ("asked", "share", "near"), [(0.99, 0.9895, True), (0.99, 0.98, False), (0.999, 0.9988, False)]
)
def test_a_target_above_everything_is_not_near(asked: float, share: float, near: bool) -> None:
    """At 0.999 asked, views that measure all of the matrix leave no target that is higher: samples are to be added."""
    cover = SimpleNamespace(covered_area=0.99 if asked == 0.99 else 1.0, coverable_area=1.0)
    looked = Selected(cover, np.array([asked]), "", shares=np.array([share]))
    assert looked.nearly(np.array([asked])) is near
    assert looked.raised(np.array([asked])) <= 1


@dataclass
class Stub:
    """What adding samples asks of a problem; M knows how often some were added."""

    request: Any
    prediction: Any
    M: Any
    candidates: Any = None
    reached: Any = None


def test_what_is_raised_in_the_end_was_looked_at_on_the_same_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where every round falls short: a bound over fewer samples, which count otherwise, is none over more."""
    looks: list[tuple[int, int]] = []

    def first_choice(problem: Stub, rng: object, *, looked: object, look: int = 0) -> SimpleNamespace:
        looks.append((problem.M.added, look))
        return SimpleNamespace(nearly=lambda _: False)

    def after(rounds: int) -> SimpleNamespace:
        return SimpleNamespace(added=rounds, sigma=None)

    for name, stands_in in {
        "first_choice": first_choice, "_adds": lambda _: True,
        "sample": lambda *_: None, "_needed": lambda *_: np.ones(1, dtype=bool), "pick_samples": lambda *_: None,
        "rows_of": lambda *_, sigma: None, "add_rows": lambda M, *_: after(M.added + 1),
    }.items():  # fmt: skip
        monkeypatch.setattr(denser_samples, name, stands_in)
    spread = SimpleNamespace(planning_face=np.zeros(1, dtype=int), areas=np.ones(1))
    surface = SimpleNamespace(planning=SimpleNamespace(faces=np.zeros((1, 3))), reference=None)
    prediction = SimpleNamespace(samples=spread, required=None, is_required=None)
    problem = Stub(SimpleNamespace(asked=np.array([0.99])), prediction, after(0), None, SimpleNamespace(reachable=None))
    denser_samples.chosen_where_kept(problem, surface, None, None)
    assert looks == [
        *((k, denser_samples.LOOK_WORK) for k in range(denser_samples.ROUNDS + 1)),
        (denser_samples.ROUNDS, 0),
    ]
