"""An indexed table: arm and table never move together, and the table turns only with the arm clear of it."""

import numpy as np
import pytest
import trimesh

from cell.runs.verification import find_collision
from cell.scene.model import Scene
from cell.world.checks import find_problems
from cell.world.model import compile_world
from planner.path import indexed
from planner.path.certified_edge import quantise, quantise_inside, subdivide
from planner.path.path import PathStatus, connect, path_time, shorten
from planner.ports import JointLimits
from planner.timing.move_time import move_time
from planner.tour.tour import TourStatus, plan_tour
from planner.tour.visits import Visits

HOME = quantise([2.0, 0, 0, 0, 0, 0, 0])
LIMITS = JointLimits(
    lower=np.full(7, -3.0), upper=np.full(7, 3.0), velocity=np.full(7, 2.0), acceleration=np.full(7, 4.0),
    jerk=np.full(7, np.inf), table_turn_q=HOME,
)  # fmt: skip


class Lobe:
    """A part that blocks a first axis below 0.5 for table angles from 1 to 2; every axis moves 1 m/rad."""

    clearance = 0.01

    def free(self, q: np.ndarray) -> np.ndarray:
        return (q[:, 0] >= 0.5) | (q[:, 6] <= 1.0) | (q[:, 6] >= 2.0)

    def contacts(self, q: np.ndarray) -> tuple[str, ...]:
        return () if self.free(q[None])[0] else ("tool with lobe",)

    def distance(self, q: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
        raise NotImplementedError

    def travel(self, q_from: np.ndarray, q_to: np.ndarray) -> np.ndarray:
        return np.abs(np.asarray(q_to) - q_from).sum(axis=-1)


def at(first: float, table: float, second: float = 0.0) -> np.ndarray:
    """Return a configuration from the angles of two axes and of the table, the others at 0 [rad]."""
    return quantise([first, second, 0, 0, 0, 0, table])


def rng() -> np.random.Generator:
    """Return a new generator with the same seed each time."""
    return np.random.default_rng(0)


def one_after_the_other(via: np.ndarray) -> bool:
    """Return whether arm and table never move together and the table turns only with the first axis beyond the lobe."""
    moved = np.diff(via, axis=0) != 0
    turns = moved[:, 6]
    return not (moved[:, :6].any(axis=1) & turns).any() and bool((via[:-1][turns, 0] >= 0.5).all())


def test_times_of_arm_and_table_add_up() -> None:
    """Times of arm and table are added: 2 rad at 2 rad/s and 4 rad/s^2 take 1.5 s, and 1 rad takes 1 s."""
    assert move_time(at(0, 0), at(2, 1), LIMITS) == pytest.approx(2.5)
    both = move_time(np.stack([at(0, 0), at(0, 1)])[:, None], np.stack([at(2, 1), at(0, 1)]), LIMITS)
    np.testing.assert_allclose(both, [[2.5, 1.0], [1.5, 0.0]], rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize(
    ("q_from", "q_to", "status", "points"),
    [
        (at(-1, 0), at(-2, 0), PathStatus.STRAIGHT, 2),  # one angle: the arm alone
        (at(1, 0), at(-1, 2.5), PathStatus.STRAIGHT, 3),  # clear where it begins
        (at(-1, 2.5), at(1, 0), PathStatus.STRAIGHT, 3),  # clear where it ends
        (at(1, 0), at(1, 2.5), PathStatus.STRAIGHT, 2),  # the table alone
        (at(-1, 0), at(-1, 2.5), PathStatus.DETOUR, 4),  # clear at neither: at home
    ],
)
def test_the_table_turns_where_the_arm_is_clear(
    q_from: np.ndarray, q_to: np.ndarray, status: PathStatus, points: int
) -> None:
    """The table turns at an end of the path if the arm is clear there, otherwise at the given posture."""
    found = connect(q_from, q_to, Lobe(), LIMITS, rng())
    assert found.via is not None
    assert (found.status, len(found.via)) == (status, points)
    np.testing.assert_array_equal(found.via[[0, -1]], [q_from, q_to])
    assert one_after_the_other(found.via)
    assert found.duration == path_time(found.via, LIMITS) >= move_time(q_from, q_to, LIMITS) * (1 - 1e-12)
    assert indexed.find_violation(found.via, Lobe(), LIMITS) == ""
    assert np.array_equal(shorten(found.via, Lobe(), LIMITS, rng(), 1000)[0], found.via)


def test_a_turning_posture_that_is_not_clear_gives_no_path() -> None:
    """No path is found if the arm is clear of the table neither at an end nor at the posture."""
    limits = JointLimits(LIMITS.lower, LIMITS.upper, LIMITS.velocity, LIMITS.acceleration, LIMITS.jerk, at(-2, 0))
    found = connect(at(-1, 0), at(-1, 2.5), Lobe(), limits, rng())
    assert found.via is None
    assert found.status is PathStatus.NO_PATH_FOUND


def test_a_table_turn_is_certified_itself() -> None:
    """A table turn is verified by itself, since the part may be too close between the checked angles."""
    ends = np.stack([HOME, HOME])
    ends[:, 6] = LIMITS.lower[6], LIMITS.upper[6]
    checked = subdivide(*quantise_inside(ends, LIMITS)[:, None], Lobe())[0][:, 6]
    dip = checked[np.argmin(np.abs(checked - 0.5))] + 0.5 * (checked[1] - checked[0])

    class Dip(Lobe):
        def free(self, q: np.ndarray) -> np.ndarray:
            return super().free(q) & (np.abs(q[:, 6] - dip) > 0.002)

    assert indexed.may_turn(HOME, Dip(), LIMITS)[0]
    refused = 0
    for table in np.linspace(2.2, 2.8, 7):
        found = connect(at(-1, 0), at(-1, table), Dip(), LIMITS, rng())
        refused += found.via is None
        assert found.via is None or find_collision(found.via, Dip(), LIMITS) == ""
    assert refused


def test_a_path_that_breaks_the_rule_is_described() -> None:
    """The description states that both move at once, or that the arm is not clear of the table."""
    assert "at once" in indexed.find_violation(np.stack([at(1, 0), at(2, 0.5)]), Lobe(), LIMITS)
    assert "is not clear of it" in indexed.find_violation(np.stack([at(-1, 0), at(-1, 0.5)]), Lobe(), LIMITS)
    # The motion of the arm is below the tolerance.
    assert indexed.find_violation(np.stack([at(1, 0), at(1 + 1e-4, 0.5)]), Lobe(), LIMITS) == ""


def test_a_tour_groups_views_by_angle() -> None:
    """For four views at 0 or 2.5 rad, two of them at one angle only, the table turns once and back."""
    places = ((-1, 0), (1, 0), (1, 1), (-1, 1))
    views = [np.stack([at(first, 0.0, second), at(first, 2.5, second)]) for first, second in places]
    views[0], views[3] = views[0][:1], views[3][1:]
    T = np.repeat(np.eye(4)[None], 4, axis=0)
    tour = plan_tour(Visits(views, HOME, T), Lobe(), LIMITS, rng())
    assert tour.status is TourStatus.COMPLETE
    assert one_after_the_other(tour.via)
    assert int((np.diff(tour.via[:, 6]) != 0).sum()) == 2
    assert not tour.detour.any()
    assert tour.duration >= tour.lower_bound - 1e-9
    assert tour.duration == pytest.approx(float(move_time(tour.via[:-1], tour.via[1:], LIMITS).sum()))


def test_a_home_in_reach_of_the_table_is_refused() -> None:
    """A home position in reach of the part on an indexed table is reported. With a synchronised table it is not."""
    block = trimesh.creation.box((0.2, 0.1, 0.9))
    scene = {
        "table": {"position_mm": [900.0, 500.0, -400.0], "moves": "indexed", "swing_mm": 1500.0},
        "placement": {"position_mm": [900.0, 1100.0, 500.0]},
    }
    for moves, is_reported in (("indexed", True), ("synchronised", False)):
        scene["table"]["moves"] = moves
        world = compile_world(Scene.model_validate(scene), block.vertices, part_faces=block.faces, baseline_mm=75.0)
        found = [sentence for sentence in find_problems(world) if "an indexed table turns" in sentence]
        assert bool(found) == is_reported
        assert all("robot.home_deg" in sentence and " deg; change" in sentence for sentence in found)
