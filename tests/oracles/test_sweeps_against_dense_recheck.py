"""Claims of driven sweeps, checked by dense forward kinematics and differences, without Jacobian and bounds."""

import numpy as np
import pytest

from cell.robot.arm import kr16_kinematics
from planner.path.sweeps import TUBE, SweepPath, TimedSweep, find_sweeps
from planner.values import Floats
from planner.viewpoints.viewpoints import straight_sweep_poses, turned_sweep_poses

KINEMATICS = kr16_kinematics()
LIMITS = KINEMATICS.limits
MOUNT = np.eye(4)
MOUNT[:3, 3] = (0.02, -0.03, 0.12)

COLUMNS = {
    "along the baseline": straight_sweep_poses(0.15, 8),
    "across": straight_sweep_poses(0.12, 5, (0, 1, 0)),
    "towards the part": straight_sweep_poses(0.2, 6, (0, 0, 1)),
    "turned": turned_sweep_poses(np.radians(24.0), 5),
}


def _paths(column: Floats, rng: np.random.Generator, count: int) -> list[SweepPath]:
    """Return sweeps from random configurations, one per branch and direction."""
    found: list[SweepPath] = []
    while len(found) < count:
        q = rng.uniform(0.6 * LIMITS.lower, 0.6 * LIMITS.upper)
        T = KINEMATICS.forward(q[None])[0] @ MOUNT
        if T[2, 3] < 0.1:
            continue
        by_branch = {
            (path.branch, path.pose[-1]): path for path in find_sweeps(T @ column, MOUNT, KINEMATICS, LIMITS).paths
        }
        found += [by_branch[key] for key in sorted(by_branch)[:2]]
    return found


def _driven(path: SweepPath) -> TimedSweep:
    return TimedSweep(path, MOUNT, KINEMATICS)


@pytest.mark.parametrize("name", COLUMNS)
def test_a_sweep_keeps_its_line_its_speed_its_branch_and_every_limit(name: str) -> None:
    """1000 samples of each: on the line within a micrometre; constant speed from first to last pose; limits held."""
    column = COLUMNS[name]
    slowest = 0.0
    for path in _paths(column, np.random.default_rng(sorted(COLUMNS).index(name)), 2):
        t = np.linspace(0.0, path.duration, 1001)
        q, qd, qdd = _driven(path).at(t)
        T = KINEMATICS.forward(q) @ MOUNT
        begin, way = path.line.T_base_begin[:3, 3], path.line.displacement
        travelled = T[:, :3, 3] - begin
        if path.line.length > 0.01:
            along = travelled @ way / path.line.length
            aside = np.linalg.norm(travelled - along[:, None] * way / path.line.length, axis=1)
            # The ends are set-points: rounded by up to 5e-5 deg an axis, some micrometres at this reach.
            assert aside.max() < 1e-5
            steady = (along > path.line.length * 0.5 / path.line.poses) & (
                along < path.line.length * (1 - 0.5 / path.line.poses)
            )
            speed = np.gradient(along, t)[steady][2:-2]
            assert np.ptp(speed) < 1e-4 * speed.max()
            assert speed.max() <= 0.05 * (1 + 1e-4)
            slowest = max(slowest, 0.05 / speed.max())
            turned = T[:, :3, :3] @ T[0, :3, :3].T
            assert np.abs(turned - np.eye(3)).max() < 1e-5
        else:
            assert np.linalg.norm(travelled, axis=1).max() < 1e-5
            cosine = 0.5 * (np.trace(T[:, :3, :3] @ T[0, :3, :3].T, axis1=1, axis2=2) - 1.0)
            angle = np.arccos(np.clip(cosine, -1, 1))
            steady = (angle > path.line.angle * 0.11) & (angle < path.line.angle * 0.89)
            rate = np.gradient(angle, t)[steady][2:-2]
            assert np.ptp(rate) < 1e-3 * rate.max()
            assert rate.max() <= 0.35 * (1 + 1e-4)
        # One branch: the inverse kinematics has the same slot everywhere, whole turns aside.
        slots = KINEMATICS.inverse(KINEMATICS.forward(q))
        off = np.abs((slots - q[:, None] + np.pi) % (2 * np.pi) - np.pi).max(axis=2)
        assert (off[:, path.branch] < 1e-6).all()
        assert (q >= LIMITS.lower).all()
        assert (q <= LIMITS.upper).all()
        # Speed, acceleration and jerk: from differences of positions, and as returned.
        v, a = np.gradient(q, t, axis=0), np.gradient(qd, t, axis=0)
        np.testing.assert_allclose(qd[2:-2], v[2:-2], atol=1e-4)
        np.testing.assert_allclose(qdd[2:-2], a[2:-2], atol=2e-3 + 0.01 * np.abs(qdd).max())
        assert (np.abs(qd) <= LIMITS.velocity).all()
        assert (np.abs(qdd) <= LIMITS.acceleration).all()
        jerk = np.diff(qdd, axis=0) / np.diff(t)[:, None]
        assert (np.abs(jerk) <= LIMITS.jerk * (1 + 1e-6) + 1e-3).all()
        assert np.abs(qd[[0, -1]]).max() < 1e-12
    assert slowest <= 4.0 + 1e-9


@pytest.mark.parametrize("name", COLUMNS)
def test_the_vertices_are_set_points_within_the_tube_and_hold_every_pose(name: str) -> None:
    """Multiples of 1e-4 deg; joint-linear between them the frame stays within the tube; poses to some micrometres."""
    column = COLUMNS[name]
    for path in _paths(column, np.random.default_rng(7), 1):
        steps = np.degrees(path.q) * 1e4
        np.testing.assert_allclose(steps, np.round(steps), atol=1e-5)
        share = np.linspace(0, 1, 9)[:, None, None]
        q = (path.q[:-1] + share * (path.q[1:] - path.q[:-1])).reshape(-1, 6)
        u = (path.u[:-1] + share[..., 0] * (path.u[1:] - path.u[:-1])).reshape(-1)
        T, T_line = KINEMATICS.forward(q) @ MOUNT, path.line.at(u)
        assert np.linalg.norm(T[:, :3, 3] - T_line[:, :3, 3], axis=1).max() < TUBE + 1e-5
        assert np.abs(T[:, :3, :3] - T_line[:, :3, :3]).max() < 1e-3
        measured = KINEMATICS.forward(path.measured_q) @ MOUNT
        order = path.pose[path.pose >= 0]
        assert sorted(order.tolist()) == list(range(len(column)))
        assert (np.diff(order) > 0).all() or (np.diff(order) < 0).all()
        relative = np.linalg.inv(measured[0]) @ measured
        np.testing.assert_allclose(relative, np.linalg.inv(column[0]) @ column, atol=3e-5)


@pytest.mark.parametrize("name", ["along the baseline", "turned"])
def test_the_reverse_is_the_same_path_backwards(name: str) -> None:
    """The reverse has the same vertices and line, and mirrored times; the reverse of the reverse is the path."""
    (path,) = _paths(COLUMNS[name], np.random.default_rng(3), 1)[:1]
    back = path.reversed()
    np.testing.assert_allclose(back.line.at(back.u), path.line.at(path.u)[::-1], atol=1e-12)
    np.testing.assert_array_equal(back.q, path.q[::-1])
    np.testing.assert_array_equal(back.measured_q, path.measured_q)
    np.testing.assert_allclose(_driven(back).times, path.duration - _driven(path).times[::-1], atol=1e-9)
    t = np.linspace(0, path.duration, 101)
    there, again = _driven(path).at(t), _driven(back).at(t[::-1])
    np.testing.assert_allclose(again[0], there[0], atol=1e-9)
    np.testing.assert_allclose(again[1], -there[1], atol=1e-9)
    np.testing.assert_array_equal(back.reversed().u, path.u)


def test_the_arm_is_at_each_vertex_at_its_time() -> None:
    """The arm is at each vertex at its time, up to the rounding of set-points."""
    for path in _paths(COLUMNS["turned"], np.random.default_rng(9), 2):
        q, _, _ = _driven(path).at(_driven(path).times)
        assert np.degrees(np.abs(q - path.q)).max() < 1.1e-4
