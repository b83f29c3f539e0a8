"""Nasty cases of paths and tours, by name."""

from collections.abc import Callable

import numpy as np
import pytest

from planner.errors import PlannerError
from planner.path.path import PathStatus, connect
from planner.timing.motion import retime
from planner.timing.move_time import move_time
from planner.tour.tour import DropReason, MotionBudget, Tour, TourStatus, plan_tour
from planner.tour.visits import Visits
from tests.support.joint_space import BIG, Boxes, at, box
from tests.support.joint_space import SYMMETRIC_LIMITS as LIMITS

HOME = np.zeros(6)


def motion_over(views: list[np.ndarray], checker: Boxes, **arguments: object) -> Tour:
    """Plan a motion over views given by their configurations."""
    poses = np.tile(np.eye(4), (len(views), 1, 1))
    for pose, q in zip(poses, views, strict=True):
        pose[:3, 3] = q[0, :3] if len(q) else 0.0
    return plan_tour(Visits(views, HOME, poses), checker, LIMITS, np.random.default_rng(0), **arguments)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("x_from", "x_to", "status"),
    [(0.0, 1.0, PathStatus.START_IN_COLLISION), (1.0, 0.0, PathStatus.GOAL_IN_COLLISION)],
)
def test_an_end_in_collision_is_reported(x_from: float, x_to: float, status: PathStatus) -> None:
    """The status names the end, and no search is started."""
    found = connect(at(x_from), at(x_to), Boxes(box(x=(-0.1, 0.1))), LIMITS, np.random.default_rng(0))
    assert (found.status, found.via, found.checks) == (status, None, 2)


def test_a_wall_across_the_whole_range_has_no_path() -> None:
    """The search ends at its budget, exceeded by at most one step, and the status has the reason."""
    found = connect(at(-1), at(1), Boxes(box(x=(-0.1, 0.1))), LIMITS, np.random.default_rng(0), 5000)
    assert found.status is PathStatus.NO_PATH_FOUND
    assert 5000 <= found.checks < 8000
    assert "does not prove" in found.status.sentence


def test_a_narrow_gap_is_found() -> None:
    """A path enters and leaves a door 5 mm wider on each side than the clearance, in a wall 20 mm thick."""
    door = Boxes(box(x=(-0.01, 0.01), y=(-BIG, 0.285)), box(x=(-0.01, 0.01), y=(0.315, BIG)))
    found = connect(at(-0.5, 0.0), at(0.5, 0.1), door, LIMITS, np.random.default_rng(0), 40_000)
    assert found.status is PathStatus.DETOUR
    for a, b in zip(found.via[:-1], found.via[1:], strict=True):
        assert door.distances(a + np.linspace(0, 1, 20_000)[:, None] * (b - a)).min() > 0.5 * door.clearance


def test_no_view_and_one_view() -> None:
    """The motion goes from home to the view and back; without views it stays at home."""
    empty = motion_over([], Boxes())
    assert (empty.status, empty.duration, empty.via.shape) == (TourStatus.COMPLETE, 0.0, (1, 6))
    tour = motion_over([at(1)[None]], Boxes())
    np.testing.assert_array_equal(tour.via, [HOME, at(1), HOME])
    np.testing.assert_array_equal(tour.view, [-1, 0, -1])
    np.testing.assert_array_equal(tour.segment, [0, 0, 1])


def test_a_view_at_home_and_duplicates() -> None:
    """Views that cost no move are visited, one after the other, and the motion can be retimed."""
    tour = motion_over([at(1)[None], HOME[None], at(1)[None], at(1)[None]], Boxes())
    assert sorted(tour.order) == [0, 1, 2, 3]
    assert tour.duration == pytest.approx(2 * float(move_time(HOME, at(1), LIMITS)))
    motion = retime(tour.via, tour.segment, tour.view, LIMITS)
    assert motion.duration == pytest.approx(tour.duration)
    assert (np.diff(motion.t) > 0).all()


def test_home_in_collision() -> None:
    """The motion is empty, the status names the blocker of home, and every view is reported."""
    tour = motion_over([at(1)[None], at(2)[None]], Boxes(box(x=(-0.1, 0.1))))
    assert tour.status is TourStatus.HOME_IN_COLLISION
    assert tour.home_blocker == "tool with box 0"
    assert len(tour.via) == 0
    assert [(d.view, d.reason) for d in tour.dropped] == [(0, DropReason.NO_HOME), (1, DropReason.NO_HOME)]


def test_views_that_cannot_be_visited_are_dropped_with_their_reasons() -> None:
    """Views without configuration, in collision or behind a wall have their own reasons.

    The tour over the others is complete.
    """
    wall = Boxes(box(x=(1.5, 1.6)))
    views = [
        np.zeros((0, 6)),
        at(1)[None],
        np.array([at(1.55), at(1.52, 0.3)]),
        np.array([at(2.0), at(2.2, 0.5)]),
        at(-1)[None],
    ]
    tour = motion_over(views, wall, budget=MotionBudget(path_checks=3000))
    assert tour.status is TourStatus.VIEWS_DROPPED
    assert [(d.view, d.reason) for d in tour.dropped] == [
        (0, DropReason.NO_SOLUTION),
        (2, DropReason.IN_COLLISION),
        (3, DropReason.NO_PATH),
    ]
    assert tour.dropped[1].blocker == "tool with box 0"
    assert sorted(tour.order) == [1, 4]


def test_another_branch_is_taken_where_one_is_walled_off() -> None:
    """A view with one configuration behind the wall and one in front of it is visited with the second."""
    tour = motion_over([np.array([at(2.0), at(-1.4)])], Boxes(box(x=(1.5, 1.6))), budget=MotionBudget(path_checks=3000))
    assert tour.status is TourStatus.COMPLETE
    assert tour.choice.tolist() == [1]


def test_all_branches_of_all_views_walled_off() -> None:
    """Every view is dropped, and the motion stays at home."""
    views = [at(2.0)[None], at(2.3)[None]]
    tour = motion_over(views, Boxes(box(x=(1.5, 1.6))), budget=MotionBudget(path_checks=2000))
    assert tour.status is TourStatus.VIEWS_DROPPED
    assert [d.view for d in tour.dropped] == [0, 1]
    assert tour.via.shape == (1, 6)


def test_a_detour_between_views_is_part_of_the_tour() -> None:
    """Home and a view are on opposite sides of a bar: both moves go around it and are tagged as detours."""
    bar = Boxes(box(x=(0.4, 0.6), y=(-BIG, 0.5)))
    tour = motion_over([at(1)[None]], bar)
    assert tour.detour.tolist() == [True, True]
    assert (tour.view == 0).sum() == 1
    assert tour.duration > tour.lower_bound == pytest.approx(2 * float(move_time(HOME, at(1), LIMITS)))


@pytest.mark.parametrize("after", [0, 50, 2000])
def test_an_interrupt_passes_through(after: int) -> None:
    """Ctrl-C during a check reaches the caller immediately."""
    checker = Boxes(box(x=(0.4, 0.6), y=(-BIG, 0.5)))
    checker.interrupt_after = after
    with pytest.raises(KeyboardInterrupt):
        motion_over([at(1)[None]], checker)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a: a.update(home=np.full(6, 9.0)), "home: number 0 has A1 at 515"),
        (lambda a: a.update(configurations=[np.full((1, 6), -9.0)]), "configuration of view 0: number 0 has A1"),
        (lambda a: a.update(T_base_scanner=np.eye(4)), "T_base_scanner has shape"),
    ],
)
def test_broken_input_is_refused_in_one_sentence(change: Callable[[dict], None], message: str) -> None:
    """The message names the argument and the valid values."""
    arguments = {"configurations": [at(1)[None]], "home": HOME, "T_base_scanner": np.eye(4)[None]}
    change(arguments)
    with pytest.raises(PlannerError, match=message):
        plan_tour(Visits(**arguments), Boxes(), LIMITS, np.random.default_rng(0))


def test_more_effort_never_makes_the_motion_longer() -> None:
    """Among bars, inspected neighbours, a second guess and polish never make the motion longer."""
    bars = Boxes(box(x=(0.4, 0.6), y=(-BIG, 0.5)), box(x=(-0.9, -0.7), y=(-0.3, BIG)))
    views = [np.array([at(x), at(x + 0.1)]) for x in (1.0, -1.3, 0.2)]
    high, low = (1.1, 1.2), (1.1, 0.35)
    first = motion_over(views, bars, budget=MotionBudget(path_checks=4000, guesses=(high,), polish=0))
    again = motion_over(views, bars, budget=MotionBudget(path_checks=4000, guesses=(high, low), polish=0))
    polished = motion_over(views, bars, budget=MotionBudget(path_checks=4000, guesses=(high, low), polish=2))
    assert first.status is again.status is polished.status is TourStatus.COMPLETE
    assert polished.detour.any()
    assert first.duration >= again.duration >= polished.duration > polished.lower_bound
