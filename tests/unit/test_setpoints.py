import numpy as np
import pytest

from planner.kinematics.setpoints import STEPS_PER_DEGREE, first_setpoints, from_steps, setpoints, to_steps
from planner.ports import JointLimits

LIMITS = JointLimits(
    lower=np.deg2rad([-185.0, -155, -130, -350, -130, -350]),
    upper=np.deg2rad([185.0, 35, 154, 350, 130, 350]),
    velocity=np.ones(6),
    acceleration=np.ones(6),
)


def degrees(*rows):
    """Return (1, len(rows), 6) branches of one pose [rad]; None for a branch without solution."""
    return np.deg2rad([[row if row is not None else [np.nan] * 6 for row in rows]])


def test_every_multiple_inside_the_limits_is_found():
    """The rows are exactly the brute-force set: all turns of each branch that lie within the limits, each once."""
    rng = np.random.default_rng(1)
    branches = rng.uniform(-np.pi, np.pi, (200, 8, 6))
    branches[rng.random((200, 8)) < 0.3] = np.nan
    found = setpoints(branches, LIMITS)
    want = set()
    turns = np.stack(np.meshgrid(*[[-1, 0, 1]] * 6, indexing="ij"), axis=-1).reshape(-1, 6)
    for pose in range(200):
        for branch in branches[pose]:
            if not np.isnan(branch[0]):
                q = np.round(np.rad2deg(branch), 4) + 360.0 * turns
                inside = ((q >= np.rad2deg(LIMITS.lower) - 1e-9) & (q <= np.rad2deg(LIMITS.upper) + 1e-9)).all(axis=1)
                want |= {(pose, *row) for row in np.rint(q[inside] * STEPS_PER_DEGREE).astype(int).tolist()}
    have = [(pose, *row) for pose, row in zip(found.pose.tolist(), to_steps(found.q).tolist(), strict=True)]
    assert len(want) > 500
    assert len(have) == len(set(have))
    assert set(have) == want


@pytest.mark.parametrize("widest", [350.0, 800.0])
def test_first_setpoints_are_those_of_each_geometry(widest):
    """The short form gives the first row of each geometry, also with more turns and narrow limits."""
    rng = np.random.default_rng(2)
    branches = rng.uniform(-np.pi, np.pi, (200, 8, 6))
    branches[rng.random((200, 8)) < 0.3] = np.nan
    ends = np.deg2rad([widest, 90, 100, widest, 130, 200.0])
    limits = JointLimits(-ends, ends * 0.9, np.ones(6), np.ones(6))
    every = setpoints(branches, limits)
    q, pose = first_setpoints(branches, limits)
    assert 0 < len(q) < len(every.q)
    np.testing.assert_array_equal(q, every.q[every.first])
    np.testing.assert_array_equal(pose, every.pose[every.first])


def test_a_turn_shares_the_geometry_of_its_branch():
    """Rows of one geometry differ by full turns only, `first` is its first row, and each branch is one geometry."""
    found = setpoints(degrees((10, -90, 90, 20, 45, -30), None, (10, -90, 90, -160, -45, 150)), LIMITS)
    assert len(found.q) == 2 * 4  # A4 and A6 have two angles each
    assert found.geometry.tolist() == [0] * 4 + [1] * 4
    assert found.first.tolist() == [0, 4]
    whole = (found.q - found.q[found.first][found.geometry]) / (2 * np.pi)
    np.testing.assert_allclose(whole, np.rint(whole), rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.rad2deg(found.q[0]), (10, -90, 90, 20, 45, -30), rtol=0, atol=1e-9)


def test_no_solution_and_no_room_are_distinguished():
    """`real` is False without any branch, True with a branch that exceeds a limit; neither gives a row."""
    branches = np.concatenate([degrees(None), degrees((0, 100, 0, 0, 0, 0)), degrees((0, 0, 0, 0, 45, 0))])
    found = setpoints(branches, LIMITS)
    assert found.real.tolist() == [False, True, True]
    assert set(found.pose.tolist()) == {2}


@pytest.mark.parametrize("excess", [-6e-5, -4e-5, 4e-5, 6e-5])
def test_rounding_never_leaves_the_limits(excess):
    """An angle within half a step of a limit rounds onto it; no set-point exceeds a limit by even the last bit."""
    upper = np.rad2deg(LIMITS.upper[1:2])
    branches = degrees((0, upper[0] + excess, 0, 0, 45, 0))
    found = setpoints(branches, LIMITS)
    assert (found.q <= LIMITS.upper).all()
    assert (found.q >= LIMITS.lower).all()
    assert (len(found.q) > 0) == (excess < 5e-5)
    assert np.abs(np.rad2deg(found.q) * 1e4 - np.rint(np.rad2deg(found.q) * 1e4)).max(initial=0.0) < 1e-6


def test_limits_between_two_steps_are_kept():
    """A limit that is no multiple of a step is rounded inwards."""
    limits = JointLimits(
        LIMITS.lower, np.deg2rad([10.00005, 35, 154, 350, 130, 350]), LIMITS.velocity, LIMITS.acceleration
    )
    found = setpoints(degrees((10.00004, 0, 0, 0, 45, 0), (10.00006, 0, 0, 0, 45, 0)), limits)
    assert set(np.rad2deg(found.q[:, 0]).round(6).tolist()) == {10.0}


def test_steps_survive_the_conversion_to_radians():
    """Steps are unchanged by the conversion to radians and back, over two turns."""
    steps = np.arange(-3_600_000, 3_600_001, 7)
    np.testing.assert_array_equal(to_steps(from_steps(steps)), steps)
