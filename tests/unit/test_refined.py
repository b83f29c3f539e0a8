"""Views that move, in a plan: never more of them, and never less coverage than without."""

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cell.errors import UnreachableError
from cell.plan import refined


@dataclass(frozen=True)
class Answer:
    """What the choice asks of selected views: their number, and the share that they measure of the held-out samples."""

    number: int
    shares: Any
    bound: int = 1

    @property
    def cover(self) -> SimpleNamespace:
        return SimpleNamespace(views=np.arange(self.number))

    def keeps(self, asked: Any) -> bool:
        return bool((self.shares >= asked).all())

    def bounded(self, easier: "Answer") -> "Answer":
        return replace(self, bound=easier.bound)


def _answer(number: int, share: float, bound: int = 1) -> Answer:
    return Answer(number, np.array([share]), bound)


BEFORE = _answer(12, 0.991)
MOVED = _answer(11, 0.9915)


def _chosen(monkeypatch: pytest.MonkeyPatch, left: int, found: Answer, before: Answer = BEFORE) -> tuple[Any, Any]:
    """The choice with so many views left after moving, and what is found among all candidates."""
    monkeypatch.setattr(refined, "_moved", lambda *_: range(left))
    monkeypatch.setattr(refined, "_appended", lambda *_: ("more", MOVED))
    monkeypatch.setattr(refined, "first_choice", lambda *_, **__: found)
    request = SimpleNamespace(asked=np.array([0.99]), plan=SimpleNamespace(coverage=0.99))
    return refined.with_fewer(SimpleNamespace(request=request), before, None, None)


def test_where_no_view_is_left_out_nothing_changes(monkeypatch):
    """The problem and the views are those given; so they are where the views fall short of what is asked."""
    short = _answer(12, 0.98)
    for before, left in ((BEFORE, 12), (short, 11)):
        problem, after = _chosen(monkeypatch, left, _answer(1, 1.0), before)
        assert after is before
        assert problem != "more"


def test_what_measures_less_than_before_is_not_taken(monkeypatch):
    """Fewer still, but less than the unmoved ones measured: the moved ones stay, with the bound that was found."""
    for found in (_answer(10, 0.9908, bound=9), _answer(10, 0.99, bound=9), _answer(11, 0.9999, bound=9)):
        problem, after = _chosen(monkeypatch, 11, found)
        assert (problem, after) == ("more", replace(MOVED, bound=9))


def test_fewer_views_still_are_taken(monkeypatch):
    """Found among the candidates that there were and those that moved."""
    found = _answer(10, 0.9913)
    assert _chosen(monkeypatch, 11, found)[1] is found


@dataclass(frozen=True)
class Plan:
    """What is held of one plan against another."""

    selected: Answer
    number: int
    area: float

    @property
    def cover(self) -> SimpleNamespace:
        return SimpleNamespace(views=np.arange(self.number))

    @property
    def visible(self) -> SimpleNamespace:
        return SimpleNamespace(area=self.area)


@pytest.mark.parametrize(
    ("as_chosen", "number", "area", "taken"),
    [
        (True, 11, 0.95, "moved"),  # connected as it was chosen
        (False, 12, 0.97, "moved"),  # chosen again, and no worse
        (False, 13, 0.99, "unmoved"),
        (False, 11, 0.95, "unmoved"),
    ],
)
def test_what_is_chosen_again_is_held_against_the_views_that_did_not_move(as_chosen, number, area, taken):
    """No more views and no less measured than with those; which are connected only where it has to be known."""
    asked = []

    def connect(problem: Any, selected: Answer) -> Any:
        asked.append(problem)
        return Plan(BEFORE, 12, 0.97) if problem == "unmoved" else Plan(MOVED if as_chosen else BEFORE, number, area)

    problem, plan = refined.connected(("moved", MOVED), ("unmoved", BEFORE), connect)  # type: ignore[arg-type]
    assert problem == taken
    assert plan.number == (12 if taken == "unmoved" else number)
    assert asked == (["moved"] if as_chosen else ["moved", "unmoved"])


def test_where_the_views_that_did_not_move_cannot_be_connected_the_others_are_the_plan():
    """There is a plan, and it is not lost to what it is held against."""

    def connect(problem: Any, selected: Answer) -> Any:
        if problem == "unmoved":
            raise UnreachableError("no view is left")
        return Plan(BEFORE, 13, 0.9)

    problem, plan = refined.connected(("moved", MOVED), ("unmoved", BEFORE), connect)  # type: ignore[arg-type]
    assert (problem, plan.number) == ("moved", 13)
