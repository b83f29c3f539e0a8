from dataclasses import dataclass

import numpy as np
import pytest

from cell.robot.arm import kr16_kinematics
from planner.errors import PlannerError
from planner.kinematics.frames import pose_from_kuka_abc
from planner.kinematics.reach import (
    Reach,
    Verdict,
    add_configurations,
    are_reachable,
    join_reach,
    pick_reach,
    solve_reach,
)
from planner.viewpoints.viewpoints import Viewpoints

KINEMATICS = kr16_kinematics()
T_FLANGE_SCANNER = pose_from_kuka_abc([0.0, 0.01, 0.12], np.deg2rad([30.0, 5.0, 0.0]))
T_BASE_OBJECT = pose_from_kuka_abc([1.2, 0.3, 0.4], np.deg2rad([20.0, 0.0, 0.0]))


@dataclass
class Wall:
    """A checker that keeps the flange on one side of a plane y = wall, and records its queries."""

    wall: float = -9.0
    clearance: float = 0.01

    def __post_init__(self):
        self.queries = []

    def free(self, q):
        self.queries.append(q)
        return KINEMATICS.forward(q)[:, 1, 3] > self.wall

    def contacts(self, q):
        if KINEMATICS.forward(q[None])[0, 1, 3] > self.wall:
            return ()
        return ("housing with wall" if q[0] > 0 else "arm with wall", "far with wall")

    def distance(self, q):
        raise NotImplementedError

    def travel(self, q_from, q_to):
        raise NotImplementedError


def viewpoints_of(T_base_flange):
    """Return viewpoints with the flange at T_base_flange (V, K, 4, 4)."""
    T = np.linalg.inv(T_BASE_OBJECT) @ np.asarray(T_base_flange) @ T_FLANGE_SCANNER
    count = len(T)
    return Viewpoints(T, np.full(count, -1, np.int32), np.full(count, 0.3), np.zeros(count))


def random_flanges(count, seed=1):
    """Return (count, 4, 4) reachable flange poses."""
    limits = KINEMATICS.limits
    q = np.random.default_rng(seed).uniform(limits.lower, limits.upper, (count, 6))
    return KINEMATICS.forward(q)


def solved(viewpoints, checker, **options):
    """Call `solve_reach` with the placement and mount of this file."""
    return solve_reach(viewpoints, T_BASE_OBJECT, T_FLANGE_SCANNER, KINEMATICS, checker, **options)


def test_each_configuration_puts_the_scanner_at_its_viewpoint():
    """Every set-point takes the scanner to T_base_object T_object_scanner, up to 8 um of rounding."""
    viewpoints = viewpoints_of(random_flanges(1500)[:, None])
    reach = solved(viewpoints, Wall())
    assert reach.reachable.all()
    owner = np.repeat(np.arange(len(reach)), np.diff(reach.offsets))
    have = KINEMATICS.forward(reach.q) @ T_FLANGE_SCANNER
    want = (T_BASE_OBJECT @ viewpoints.T_object_scanner[:, 0])[owner]
    assert np.linalg.norm(have[:, :3, 3] - want[:, :3, 3], axis=1).max() < 8e-6
    assert np.abs(have[:, :3, :3] - want[:, :3, :3]).max() < 6e-6
    assert len(reach.q) > 3 * len(reach)


def test_set_points_are_rounded_inside_the_limits_and_checked_as_they_are():
    """Returned configurations are checked (turns aside), multiples of 1e-4 deg and within every limit."""
    checker = Wall(-0.2)
    reach = solved(viewpoints_of(random_flanges(800)[:, None]), checker)
    assert (reach.q >= KINEMATICS.limits.lower).all()
    assert (reach.q <= KINEMATICS.limits.upper).all()
    steps = np.rad2deg(reach.q) * 1e4
    assert np.abs(steps - np.rint(steps)).max() < 1e-6
    turn = 3_600_000
    checked = {
        tuple(row) for row in (np.rint(np.rad2deg(np.vstack(checker.queries)) * 1e4).astype(int) % turn).tolist()
    }
    returned = {tuple(row) for row in (np.rint(steps).astype(int) % turn).tolist()}
    assert returned <= checked
    assert sum(len(q) for q in checker.queries) < len(reach.q)  # turns are not checked again


def test_verdicts():
    """The verdict is OUT_OF_REACH, JOINT_LIMIT beyond a limit, or COLLISION with a name behind the wall."""
    far = np.eye(4)
    far[0, 3] = 3.0
    # A2 = 80 deg is beyond its 35; the other elbow and the other shoulder exceed a limit as well.
    outside = KINEMATICS.forward(np.deg2rad([[0.0, 80.0, -40.0, 0.0, 30.0, 0.0]]))[0]
    inside = KINEMATICS.forward(np.deg2rad([[-40.0, -60.0, 90.0, 0.0, 45.0, 0.0]]))[0]
    behind = KINEMATICS.forward(np.deg2rad([[40.0, -60.0, 90.0, 0.0, 45.0, 0.0]]))[0]
    reach = solved(viewpoints_of(np.stack([far, outside, inside, behind])[:, None]), Wall(0.0))
    assert reach.verdict.tolist() == [Verdict.OUT_OF_REACH, Verdict.JOINT_LIMIT, Verdict.REACHABLE, Verdict.COLLISION]
    assert reach.blocker[:3] == ("", "", "")
    assert reach.blocker[3] == "housing with wall"
    assert reach.blockers() == {"housing with wall": 1}
    assert reach.counts() == dict.fromkeys(Verdict, 1)
    assert [len(reach.configurations_of(v)) > 0 for v in range(4)] == [False, False, True, False]


def test_the_blocker_is_the_closest_pair_in_most_configurations():
    """With A1 = -40 deg and (overhead) 140 deg blocked, the sign of A1 with more branches gives the name."""
    T = KINEMATICS.forward(np.deg2rad([[-40.0, -60.0, 90.0, 0.0, 45.0, 0.0]]))
    names = []
    checker = Wall(9.0)
    contacts = checker.contacts
    checker.contacts = lambda q: names.append(contacts(q)[0]) or contacts(q)
    reach = solved(viewpoints_of(T[:, None]), checker)
    assert reach.blocker[0] == max(dict.fromkeys(names), key=names.count)
    assert len(names) == len(checker.queries[0])


def test_a_column_of_several_poses_needs_them_all():
    """A column is reachable if all its poses are. Otherwise its verdict is that of the first failing pose."""
    good = KINEMATICS.forward(np.deg2rad([[-40.0, -60, 90, 0, 45, 0], [-41.0, -60, 90, 0, 45, 0]]))
    wall = KINEMATICS.forward(np.deg2rad([[40.0, -60, 90, 0, 45, 0]]))[0]
    far = np.eye(4)
    far[0, 3] = 3.0
    columns = np.stack([[good[0], good[1], good[0]], [good[0], wall, far], [good[0], far, wall], [wall, far, far]])
    # The wall's side is y < 0 of the flange: A1 > 0.
    reach = solved(viewpoints_of(columns), Wall(0.0))
    assert reach.verdict.tolist() == [Verdict.REACHABLE, Verdict.COLLISION, Verdict.OUT_OF_REACH, Verdict.COLLISION]
    alone = solved(viewpoints_of(columns[:1, :1]), Wall(0.0))
    np.testing.assert_array_equal(reach.q, alone.q)


@pytest.mark.parametrize("poses", [1, 3])
def test_are_reachable_agrees_with_solve_reach(poses):
    """Both functions agree for single poses and for columns of poses."""
    viewpoints = viewpoints_of(random_flanges(1200 * poses, seed=8).reshape(1200, poses, 4, 4))
    expected = solved(viewpoints, Wall(0.1)).reachable
    assert 0 < expected.sum() < 1200
    T = viewpoints.T_object_scanner
    np.testing.assert_array_equal(are_reachable(T, T_BASE_OBJECT, T_FLANGE_SCANNER, KINEMATICS, Wall(0.1)), expected)


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("axis", [0, 2, 3, 4])
def test_are_reachable_finds_a_free_branch_of_any_number(axis, sign):
    """If only branches with one sign of an axis are free, the views are those that `solve_reach` reaches with them."""

    class Branches(Wall):
        def free(self, q):
            return sign * np.sin(q[:, axis] + 0.3) > 0  # equal after whole turns

        def contacts(self, q):
            return () if self.free(q[None])[0] else ("arm with wall",)

    T = viewpoints_of(random_flanges(400)[:, None]).T_object_scanner
    expected = solved(viewpoints_of(random_flanges(400)[:, None]), Branches()).reachable
    assert expected.any()
    np.testing.assert_array_equal(are_reachable(T, T_BASE_OBJECT, T_FLANGE_SCANNER, KINEMATICS, Branches()), expected)


def test_chunks_and_progress_change_nothing():
    """A viewpoint's result does not depend on its neighbours; exceptions of the progress callback pass."""
    T = random_flanges(1300, seed=4)
    calls = []
    whole = solved(viewpoints_of(T[:, None]), Wall(0.1), progress=lambda n_done, total: calls.append((n_done, total)))
    assert calls[-1] == (1300, 1300)
    assert [n_done for n_done, _ in calls] == sorted({n_done for n_done, _ in calls})
    assert len(calls) > 1
    part = solved(viewpoints_of(T[700:900, None]), Wall(0.1))
    np.testing.assert_array_equal(part.verdict, whole.verdict[700:900])
    np.testing.assert_array_equal(part.q, whole.q[whole.offsets[700] : whole.offsets[900]])
    assert part.blocker == whole.blocker[700:900]

    def interrupt(n_done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        solved(viewpoints_of(T[:, None]), Wall(), progress=interrupt)


def test_no_viewpoint_is_no_error():
    """Without viewpoints the result is empty."""
    reach = solved(viewpoints_of(np.empty((0, 1, 4, 4))), Wall())
    assert len(reach) == 0
    assert reach.q.shape == (0, 6)
    assert reach.offsets.tolist() == [0]


def test_broken_input_is_named():
    """A transform that is not rigid and a checker with contradictory answers are refused with a message."""
    viewpoints = viewpoints_of(random_flanges(3)[:, None])
    with pytest.raises(PlannerError, match="T_base_object is not a rigid transform"):
        solve_reach(viewpoints, 2 * np.eye(4), T_FLANGE_SCANNER, KINEMATICS, Wall())
    with pytest.raises(PlannerError, match="T_flange_scanner is not a rigid transform"):
        solve_reach(viewpoints, T_BASE_OBJECT, np.diag([1.0, 1, -1, 1]), KINEMATICS, Wall())
    contradictory = Wall(9.0)
    contradictory.contacts = lambda q: ()
    with pytest.raises(PlannerError, match="names no contact"):
        solved(viewpoints, contradictory)


def test_reach_refuses_contradictions():
    """Rows of q without the verdict REACHABLE, missing names and offsets that do not end at q's length are refused."""
    with pytest.raises(PlannerError, match="if, and only if"):
        Reach(np.array([1]), np.zeros((1, 6)), np.array([0, 1]), ("",))
    with pytest.raises(PlannerError, match="offsets must rise"):
        Reach(np.array([0]), np.zeros((1, 6)), np.array([0, 2]), ("",))
    with pytest.raises(PlannerError, match=r"blocker has shape \(0,\); it must be \(1,\)"):
        Reach(np.array([0]), np.zeros((1, 6)), np.array([0, 1]), ())


def test_picked_and_joined_reach_keeps_the_configurations():
    """Viewpoints can be picked in any order, also without configurations. Joined parts give the original."""
    reach = solved(viewpoints_of(random_flanges(60)[:, None]), Wall(0.1))
    which = np.random.default_rng(0).permutation(60)[:40]
    some = pick_reach(reach, which)
    for place, view in enumerate(which):
        np.testing.assert_array_equal(some.configurations_of(place), reach.configurations_of(view))
    np.testing.assert_array_equal(some.verdict, reach.verdict[which])
    parts = [pick_reach(reach, np.arange(25)), pick_reach(reach, np.arange(25, 60))]
    np.testing.assert_array_equal(join_reach(parts).q, reach.q)
    assert len(pick_reach(reach, np.arange(0))) == 0


def test_an_added_configuration_follows_those_of_its_viewpoint():
    """The result equals a list of lists: a known configuration is not added, and other viewpoints are unchanged."""
    q = np.arange(30.0).reshape(5, 6)
    reach = Reach(np.array([0, 1, 0, 0], dtype=np.uint8), q, [0, 2, 2, 4, 5], ("", "", "", ""))
    more = np.array([q[3], np.full(6, 7.0), np.full(6, 9.0)])
    found = add_configurations(reach, np.array([2, 3, 0]), more)
    due = [[*q[:2], more[2]], [], [*q[2:4]], [q[4], more[1]]]
    for view, solutions in enumerate(due):
        np.testing.assert_array_equal(found.configurations_of(view), np.array(solutions).reshape(-1, 6))
