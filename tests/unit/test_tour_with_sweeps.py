"""Tours over sweeps, entered at one end and left at the other: complete, timed, in the best order."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from planner.errors import PlannerError
from planner.path.sweeps import SweepPath, SweepTraversal, TimedSweep, find_sweeps, sweep_traversals
from planner.timing.motion import retime
from planner.timing.move_time import move_time
from planner.tour.tour import TourStatus, plan_tour
from planner.tour.visits import Visits
from planner.values import Floats
from planner.viewpoints.viewpoints import straight_sweep_poses
from tests.support.arms import HOME, KINEMATICS, LIMITS, MOUNT


class _FreeSpace:
    """A checker of an empty cell, except for configurations with A1 in a band."""

    clearance = 0.01

    def __init__(self, band_deg: tuple[float, float] = (400.0, 401.0)) -> None:
        self.band = np.radians(band_deg)

    def free(self, q: Floats) -> NDArray[np.bool_]:
        return np.asarray((q[:, 0] < self.band[0]) | (q[:, 0] > self.band[1]))

    def contacts(self, q: Floats) -> tuple[str, ...]:
        return () if self.free(q[None])[0] else ("housing with wall",)

    def distance(self, q: Floats) -> tuple[Floats, tuple[str, ...]]:
        return np.minimum(np.abs(q[:, :1] - self.band).min(axis=1), 1.0), ("housing with wall",) * len(q)

    def travel(self, q_from: Floats, q_to: Floats) -> Floats:
        return np.asarray(np.abs(q_to - q_from).sum(axis=1) * 1.7)


def _views(count: int) -> tuple[list[tuple[SweepPath, ...]], Floats]:
    """Return sweeps of one branch at several places, two directions each, and the first poses of the columns."""
    paths, poses = [], []
    for k in range(count):
        q = np.radians([12 - 14 * k, -75 + 5 * k, 110, 35, -60, 140])
        column = KINEMATICS.forward(q[None])[0] @ MOUNT @ straight_sweep_poses(0.15, 8)
        found = find_sweeps(column, MOUNT, KINEMATICS, LIMITS).paths
        paths.append(tuple(path for path in found if path.branch == 1)[:2])
        poses.append(column[0])
    return paths, np.stack(poses)


def _visits(paths: list[tuple[SweepPath, ...]], poses: Floats) -> Visits:
    """Return the first configurations of the sweeps, with their traversals."""
    begins = [np.stack([path.q[0] for path in view]) for view in paths]
    return Visits(begins, HOME, poses, traversals=[sweep_traversals(view) for view in paths])


def test_the_tour_contains_every_sweep_and_is_the_shortest() -> None:
    """The tour is the shortest of all orders and directions, and its timed motion has the same duration."""
    paths, poses = _views(4)
    tour = plan_tour(_visits(paths, poses), _FreeSpace(), LIMITS, np.random.default_rng(0))
    assert tour.status is TourStatus.COMPLETE
    best = np.inf
    for order in itertools.permutations(range(4)):
        for direction in itertools.product((0, 1), repeat=4):
            at, time = HOME, 0.0
            for view, which in zip(order, direction, strict=True):
                path = paths[view][which]
                time += float(move_time(at, path.q[0], LIMITS)) + path.duration
                at = path.q[-1]
            best = min(best, time + float(move_time(at, HOME, LIMITS)))
    assert tour.duration == pytest.approx(best, abs=1e-9)
    selection = [paths[view][choice] for view, choice in zip(tour.order, tour.choice, strict=True)]
    for path, row, view, q in zip(selection, tour.entered, tour.order, tour.q, strict=True):
        own = slice(row, row + len(path.q))
        np.testing.assert_array_equal(tour.via[own], path.q)
        np.testing.assert_array_equal(tour.pose[own], path.pose)
        np.testing.assert_array_equal(tour.view[own], np.where(path.pose >= 0, view, -1))
        assert np.ptp(tour.segment[own]) == 0
        np.testing.assert_array_equal(q, path.measured_q[4])
    assert (tour.view >= 0).sum() == 32
    lines = {int(row): TimedSweep(path, MOUNT, KINEMATICS) for row, path in zip(tour.entered, selection, strict=True)}
    motion = retime(tour.via, tour.segment, tour.view, LIMITS, pose=tour.pose, lines=lines)
    assert motion.duration == pytest.approx(tour.duration, abs=1e-9)
    assert motion.view[motion.stops].tolist() == tour.order.tolist()
    assert (np.diff(tour.segment) >= 0).all()


def test_a_sweep_with_a_blocked_end_is_dropped() -> None:
    """A sweep with one end in a wall is dropped in both directions, and the other sweeps remain."""
    paths, poses = _views(3)
    ends = np.degrees(np.sort([paths[1][0].q[0][0], paths[1][0].q[-1][0]]))
    wall = _FreeSpace((float(ends[0]) - 0.2, float(ends[0]) + 0.2))
    tour = plan_tour(_visits(paths, poses), wall, LIMITS, np.random.default_rng(0))
    assert 1 in [exclusion.view for exclusion in tour.dropped]
    assert 1 not in tour.order.tolist()


def test_traversals_must_fit_their_configurations() -> None:
    """One per configuration, from this one to the one that it names."""
    q = np.stack([HOME, HOME + 0.1])
    still = SweepTraversal(HOME[None], np.zeros(1, dtype=np.int64), 0.0, 0)
    with pytest.raises(PlannerError, match="give one for each"):
        Visits([q], HOME, np.eye(4)[None], traversals=[[still]])
    with pytest.raises(PlannerError, match="does not begin and end"):
        Visits([q], HOME, np.eye(4)[None], traversals=[[still, still]])
    with pytest.raises(PlannerError, match="traversal 1 of view 0 must leave at a configuration of it, 0 to 1"):
        Visits([q], HOME, np.eye(4)[None], traversals=[[still, replace(still, leaves=2)]])
