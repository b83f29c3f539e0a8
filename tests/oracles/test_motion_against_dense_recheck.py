"""Complete motions of a toy arm among spheres, checked ten times finer on the sampled motion by plain distances."""

from functools import lru_cache

import numpy as np
import pytest

from planner.path.certified_edge import STEP
from planner.timing.motion import Motion, retime
from planner.timing.move_time import move_time
from planner.tour.tour import MotionBudget, Tour, TourStatus, plan_tour
from planner.tour.visits import Visits
from tests.support.joint_space import KR16_LIMITS as LIMITS

BUDGET = MotionBudget(path_checks=5000, guess_checks=20_000, polish=1)
HOME = np.radians([0.0, -90, 90, 0, 90, 0])

# A chain in the proportions of an industrial arm, stretched forward at q = 0: axes, points on them, balls by link.
AXES = np.array([[0, 0, -1], [0, 1, 0], [0, 1, 0], [-1, 0, 0], [0, 1, 0], [-1, 0, 0]], dtype=float)
POINTS = np.array([[0, 0, 0], [0.26, 0, 0.68], [0.94, 0, 0.68], [0.94, 0, 0.64], [1.61, 0, 0.64], [1.61, 0, 0.64]])
BALLS = [(2, x, 0.68, 0.12) for x in np.linspace(0.26, 0.94, 5)]
BALLS += [(3, x, 0.64, 0.1) for x in np.linspace(0.94, 1.5, 5)]
BALLS += [(5, 1.61, 0.64, 0.09), (6, 1.8, 0.64, 0.06), (6, 1.9, 0.58, 0.05), (6, 1.9, 0.7, 0.05)]
LINK = np.array([ball[0] for ball in BALLS])
CENTRE = np.array([[x, 0.0, z] for _, x, z, _ in BALLS])
RADIUS = np.array([radius for *_, radius in BALLS])


def reach() -> np.ndarray:
    """Return the largest travel of a surface point per radian of each axis: the length of the chain beyond it."""
    tool = (np.linalg.norm(CENTRE - POINTS[4], axis=1) + RADIUS)[LINK >= 5].max()
    spin = (np.abs(CENTRE[:, 2] - 0.64) + RADIUS)[LINK == 6].max()
    elbow = max(
        float(np.linalg.norm(POINTS[4] - POINTS[2]) + tool),
        float((np.linalg.norm(CENTRE - POINTS[2], axis=1) + RADIUS)[LINK == 3].max()),
    )
    shoulder = float(np.linalg.norm(POINTS[2] - POINTS[1])) + elbow
    return np.array([0.26 + shoulder, shoulder, elbow, tool, tool, spin])


class Arm:
    """Balls on an arm against spheres, a floor, and the tool against the upper arm (both move)."""

    clearance = 0.01

    def __init__(self, spheres: np.ndarray) -> None:
        self.spheres = spheres
        self.weights = reach()

    def centres(self, q: np.ndarray) -> np.ndarray:
        """Return (N, balls, 3) centres of the balls [m], by the product of the joints' rotations."""
        rotation, position = np.tile(np.eye(3), (len(q), 1, 1)), np.zeros((len(q), 3))
        out = np.zeros((len(q), len(BALLS), 3))
        for joint in range(6):
            x, y, z = AXES[joint]
            cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
            s, c = np.sin(q[:, joint])[:, None, None], np.cos(q[:, joint])[:, None, None]
            turn = np.eye(3) + s * cross + (1 - c) * (cross @ cross)
            position = position + (rotation @ (POINTS[joint] - turn @ POINTS[joint])[..., None])[..., 0]
            rotation = rotation @ turn
            of_joint = joint + 1 == LINK
            out[:, of_joint] = CENTRE[of_joint] @ rotation.transpose(0, 2, 1) + position[:, None]
        return out

    def distances(self, q: np.ndarray) -> np.ndarray:
        p = self.centres(q)
        outside = np.linalg.norm(p[:, :, None] - self.spheres[:, :3], axis=3) - RADIUS[:, None] - self.spheres[:, 3]
        floor = p[:, :, 2] - RADIUS + 0.6
        tool, upper = LINK == 6, LINK == 2
        own = np.linalg.norm(p[:, tool, None] - p[:, None, upper], axis=3) - RADIUS[tool, None] - RADIUS[upper]
        return np.concatenate([outside.reshape(len(q), -1), floor, own.reshape(len(q), -1)], axis=1)

    def free(self, q: np.ndarray) -> np.ndarray:
        return self.distances(q).min(axis=1) >= self.clearance

    def contacts(self, q: np.ndarray) -> tuple[str, ...]:
        near = self.distances(q[None])[0]
        return tuple(f"pair {k}" for k in np.argsort(near) if near[k] < self.clearance)

    def distance(self, q: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
        near = self.distances(q)
        return near.min(axis=1), tuple(f"pair {k}" for k in near.argmin(axis=1))

    def travel(self, q_from: np.ndarray, q_to: np.ndarray) -> np.ndarray:
        return np.abs(np.asarray(q_to) - q_from) @ self.weights


@lru_cache
def cell_with_part(seed: int, n: int) -> tuple[Arm, list[np.ndarray], np.ndarray]:
    """Return a part on a post between two pillars, and views near the part with two free configurations each."""
    rng = np.random.default_rng(seed)
    post = [(1.2, 0.2, z, 0.06) for z in np.arange(-0.6, 0.4, 0.12)]
    pillars = [(x, y, z, 0.08) for x, y in ((0.75, 0.6), (0.75, -0.3)) for z in np.arange(-0.6, 1.2, 0.14)]
    arm = Arm(np.array([(1.2, 0.2, 0.5, 0.22), *post, *pillars]))
    q = rng.uniform(LIMITS.lower, LIMITS.upper, (20_000, 6)) * [0.5, 1, 1, 1, 1, 1]
    q = np.radians(np.round(np.degrees(q), 4))
    tip = arm.centres(q)[:, LINK == 6].mean(axis=1)
    near = np.abs(np.linalg.norm(tip - [1.2, 0.2, 0.5], axis=1) - 0.45) < 0.12
    q = q[near]
    q = q[arm.free(q)]
    configurations = [q[2 * k : 2 * k + 2] for k in range(n)]
    assert all(len(c) == 2 for c in configurations)
    poses = np.tile(np.eye(4), (n, 1, 1))
    poses[:, :3, 3] = [arm.centres(c[:1])[0, LINK == 6].mean(axis=0) for c in configurations]
    return arm, configurations, poses


@lru_cache
def planned(seed: int) -> tuple[Arm, Tour, Motion]:
    """Return a tour of six views and its motion."""
    arm, configurations, poses = cell_with_part(seed, 6)
    tour = plan_tour(Visits(configurations, HOME, poses), arm, LIMITS, np.random.default_rng(seed), BUDGET)
    return arm, tour, retime(tour.via, tour.segment, tour.view, LIMITS)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_no_configuration_of_the_driven_motion_is_in_contact(seed: int) -> None:
    """Samples at a tenth of the certified spacing keep the proven 0.55 c to others and 0.1 c to the arm itself."""
    arm, tour, _ = planned(seed)
    assert tour.status is TourStatus.COMPLETE
    assert tour.detour.any(), "precondition: straight moves alone do not suffice"
    outside = len(arm.spheres) * len(BALLS) + len(BALLS)
    for a, b in zip(tour.via[:-1], tour.via[1:], strict=True):
        n = 10 * (2 + int(arm.travel(a, b) / (2 * STEP * arm.clearance)))
        near = arm.distances(a + np.linspace(0, 1, n)[:, None] * (b - a))
        assert near[:, :outside].min() >= (1 - STEP) * arm.clearance
        assert near[:, outside:].min() >= (1 - 2 * STEP) * arm.clearance


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_no_limit_is_exceeded_by_samples_or_their_differences(seed: int) -> None:
    """Speeds, accelerations, first and second finite differences of q stay within the limits without tolerance."""
    _, tour, motion = planned(seed)
    speeds = np.diff(motion.q, axis=0) / np.diff(motion.t)[:, None]
    middles = 0.5 * (motion.t[1:] + motion.t[:-1])
    accelerations = np.diff(speeds, axis=0) / np.diff(middles)[:, None]
    for what, limit in (
        (motion.qd, LIMITS.velocity),
        (speeds, LIMITS.velocity),
        (motion.qdd, LIMITS.acceleration),
        (accelerations, LIMITS.acceleration),
    ):
        assert (np.abs(what) <= limit).all()
        assert (np.abs(what) / limit).max() > 0.99  # the limits are used
    assert (motion.q >= LIMITS.lower).all()
    assert (motion.q <= LIMITS.upper).all()
    assert motion.duration == pytest.approx(tour.duration, rel=1e-12)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_the_fields_of_the_tour_are_consistent(seed: int) -> None:
    """Home at both ends, each view at its configuration exactly once, segments numbered, detours tagged."""
    _, tour, _ = planned(seed)
    _, configurations, _ = cell_with_part(seed, 6)
    np.testing.assert_allclose(tour.via[[0, -1]], [HOME, HOME], atol=1e-15)
    np.testing.assert_array_equal(tour.view[tour.view >= 0], tour.order)
    np.testing.assert_array_equal(tour.via[tour.view >= 0], tour.q)
    assert sorted(tour.order) == list(range(6))
    for k, choice, q in zip(tour.order, tour.choice, tour.q, strict=True):
        np.testing.assert_allclose(q, configurations[k][choice], atol=1e-15)
    np.testing.assert_array_equal(np.unique(tour.segment), np.arange(7))
    np.testing.assert_array_equal(tour.segment[tour.view >= 0], np.arange(6))
    assert tour.duration == pytest.approx(float(move_time(tour.via[:-1], tour.via[1:], LIMITS).sum()))
    assert tour.lower_bound <= tour.duration
    for leg in range(7):
        rows = np.flatnonzero(tour.segment == leg)
        path = tour.via[max(rows[0] - 1, 0) : rows[-1] + 1]
        assert tour.detour[leg] == (len(path) > 2)


def test_equal_seeds_give_equal_motions() -> None:
    """Equal inputs and seeds give equal bytes, and the progress ends with every edge of the tour certified."""
    arm, configurations, poses = cell_with_part(0, 6)
    reports: list[tuple[int, int]] = []
    again = plan_tour(
        Visits(configurations, HOME, poses), arm, LIMITS, np.random.default_rng(0), BUDGET,
        progress=lambda *p: reports.append(p),
    )  # fmt: skip
    assert again.via.tobytes() == planned(0)[1].via.tobytes()
    assert reports[-1] == (7, 7)


def test_one_round_still_ends_with_a_certified_tour() -> None:
    """With a single ordering its edges are certified, and the tour is complete."""
    arm, configurations, poses = cell_with_part(0, 6)
    budget = MotionBudget(rounds=1, path_checks=4000)
    tour = plan_tour(Visits(configurations, HOME, poses), arm, LIMITS, np.random.default_rng(0), budget)
    assert (tour.status, tour.rounds) == (TourStatus.COMPLETE, 1)
    assert sorted(tour.order) == list(range(6))
    for a, b in zip(tour.via[:-1], tour.via[1:], strict=True):
        assert arm.distances(a + np.linspace(0, 1, 500)[:, None] * (b - a)).min() > 0
