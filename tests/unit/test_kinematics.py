import numpy as np
import pytest

from cell.robot.arm import kr16_kinematics
from planner.errors import PlannerError
from planner.kinematics.closed_form import STRETCH_TOLERANCE
from planner.kinematics.frames import kuka_abc_from_pose

# A1..A6 [deg] -> flange X, Y, Z [mm], A, B, C [deg] and the number of real branches. Computed by a chain of
# Denavit-Hartenberg matrices; Z and H0 can be checked by adding up lengths.
POSES = {
    "zero": ((0, 0, 0, 0, 0, 0), (1768.0, 0, 640.0), (0, 90, 0), 4),
    "upright, forearm level": ((0, -90, 90, 0, 0, 0), (1088.0, 0, 1320.0), (0, 90, 0), 4),
    "home": ((0, -90, 90, 0, 90, 0), (930.0, 0, 1162.0), (180, 0, 180), 4),
    "A1 turned: y goes negative": ((30, -90, 90, 0, 90, 0), (805.404, -465.0, 1162.0), (150, 0, 180), 4),
    "generic": ((12, -75, 110, 35, -60, 140), (1086.173, -150.636, 965.366), (-128.353, -69.975, -30.739), 8),
    "tool sideways": ((0, -90, 90, 90, 90, 0), (930.0, -158.0, 1320.0), (-180, 0, -90), 4),
    "wrist singular": ((20, -80, 100, 40, 0, -10), (1075.173, -391.331, 1028.587), (-140.642, 54.469, -126.052), 8),
    "arm stretched": ((0, -45, -2.990345, 0, 40, 0), (1371.706, 0, 1652.203), (0, 82.010, 0), 4),
    "wrist over A1": ((0, -120, 33.857864, 0, 60, 0), (141.837, 0, 1999.639), (0, 63.858, 0), 8),
}


@pytest.fixture(scope="module")
def kinematics():
    """Return the kinematics of models/kr16.xml."""
    return kr16_kinematics()


def difference(a, b):
    """Return the difference of two joint angles modulo full turns."""
    return np.abs((a - b + np.pi) % (2 * np.pi) - np.pi)


@pytest.mark.parametrize("name", POSES)
def test_named_poses(kinematics, name):
    """Named poses agree with the table to the last digit, and their inverse solutions lead back to them."""
    q_deg, xyz_mm, abc_deg, branches = POSES[name]
    T = kinematics.forward(np.deg2rad([q_deg]))
    position, abc = kuka_abc_from_pose(T[0])
    np.testing.assert_allclose(position * 1000, xyz_mm, rtol=0, atol=6e-4)
    np.testing.assert_allclose(difference(abc, np.deg2rad(abc_deg)), 0.0, rtol=0, atol=np.deg2rad(6e-4))
    solutions = kinematics.inverse(T)[0]
    real = ~np.isnan(solutions).any(axis=1)
    if name not in ("zero", "arm stretched"):  # there rounding decides whether the other shoulder's branches are real
        assert real.sum() == branches
    np.testing.assert_allclose(
        kinematics.forward(solutions[real]), np.repeat(T, real.sum(), axis=0), rtol=0, atol=1e-10
    )


def test_telegram_of_a_real_controller(kinematics):
    """Axis angles and pose from one telegram of a KR C2 agree to 0.01 mm and 0.001 deg: d6 is 158 mm, not 115."""
    q = np.deg2rad([[74.8478, -128.7977, 75.8236, 102.2260, 0.0987, -56.5347]])
    position, abc = kuka_abc_from_pose(kinematics.forward(q)[0])
    np.testing.assert_allclose(position * 1000, (93.9531, -347.9674, 1844.9703), rtol=0, atol=0.01)
    np.testing.assert_allclose(np.rad2deg(abc), (-126.9460, 24.9226, -28.2871), rtol=0, atol=0.001)


def test_slots_are_shoulder_elbow_wrist(kinematics):
    """Slot 4 shoulder + 2 elbow + wrist holds the branch with the corresponding signs of r, psi and A5."""
    rng = np.random.default_rng(2)
    q = rng.uniform(kinematics.limits.lower, kinematics.limits.upper, (3000, 6))
    solutions = kinematics.inverse(kinematics.forward(q))
    arm = kinematics.arm
    for slot in range(8):
        a = solutions[:, slot]
        a = a[~np.isnan(a[:, 0])]
        assert len(a) > 500
        s = a[:, 1] + a[:, 2]
        r = arm.a1 + arm.a2 * np.cos(a[:, 1]) + arm.d4 * np.cos(s) + arm.a3 * np.sin(s)
        psi = (a[:, 2] + np.arctan2(-arm.a3, arm.d4) + np.pi) % (2 * np.pi) - np.pi
        assert ((r < 0) == bool(slot & 4)).all()
        assert ((psi < 0) == bool(slot & 2)).all()
        assert ((a[:, 4] < 0) == bool(slot & 1)).all()


def test_angles_lie_in_the_half_open_turn(kinematics):
    """All angles are in (-pi, pi], including whole and half turns."""
    rng = np.random.default_rng(3)
    q = np.vstack([rng.uniform(-np.pi, np.pi, (2000, 6)), rng.integers(-2, 3, (2000, 6)) * (np.pi / 2)])
    solutions = kinematics.inverse(kinematics.forward(q))
    solutions = solutions[~np.isnan(solutions)]
    assert (solutions > -np.pi).all()
    assert (solutions <= np.pi).all()


def test_out_of_reach_is_nan_in_whole_branches(kinematics):
    """A branch is NaN in all six angles or in none; beyond the stretched arm all eight are NaN."""
    reach = kinematics.arm.a1 + kinematics.arm.a2 + np.hypot(kinematics.arm.d4, kinematics.arm.a3)
    T = np.tile(np.eye(4), (3, 1, 1))
    T[:, 0, 3] = reach + np.array([1e-6, 0.5, -0.2])
    T[:, 2, 3] = kinematics.arm.d1 + kinematics.arm.d6  # the wrist centre at the height of A2
    nan = np.isnan(kinematics.inverse(T))
    assert (nan.all(axis=2) == nan.any(axis=2)).all()
    assert nan[:2].all()
    assert not nan[2, :4].any()


def test_stretched_arm_within_the_documented_tolerance(kinematics):
    """A pose half the tolerance beyond the stretched arm is solved with that error; twice the tolerance is not."""
    reach = kinematics.arm.a1 + kinematics.arm.a2 + np.hypot(kinematics.arm.d4, kinematics.arm.a3)
    T = np.tile(np.eye(4), (2, 1, 1))
    T[:, 0, 3] = reach + STRETCH_TOLERANCE * np.array([0.5, 2.0])
    T[:, 2, 3] = kinematics.arm.d1 + kinematics.arm.d6
    solutions = kinematics.inverse(T)
    assert np.isnan(solutions[1]).all()
    np.testing.assert_allclose(kinematics.forward(solutions[0, :4]) - T[0], 0.0, rtol=0, atol=STRETCH_TOLERANCE)


def test_the_result_does_not_depend_on_other_poses(kinematics):
    """A pose has the same eight branches, bit for bit, alone and in a long array."""
    rng = np.random.default_rng(4)
    T = kinematics.forward(rng.uniform(kinematics.limits.lower, kinematics.limits.upper, (5000, 6)))
    together = kinematics.inverse(T)
    for row in (0, 1, 2047, 2048, 4095, 4999):
        np.testing.assert_array_equal(kinematics.inverse(T[row : row + 1])[0], together[row])
    assert kinematics.inverse(T[:0]).shape == (0, 8, 6)
    assert kinematics.forward(np.empty((0, 6))).shape == (0, 4, 4)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda T: T[0], "must be \\(N, 4, 4\\)"),
        (lambda T: T * 1000.0, "pose 0 .* not a rigid transform"),
        (lambda T: np.where(np.arange(3)[:, None, None] == 2, np.nan, T), "pose 2 .* not a rigid transform"),
        (lambda T: T * np.array([-1.0, 1, 1, 1]), "pose 0 .* not a rigid transform"),
    ],
    ids=["one pose without an axis", "millimetres in the rotation", "NaN", "mirrored"],
)
def test_a_transform_that_is_not_rigid_is_refused(kinematics, spoil, words):
    """A wrong shape and a scaled, mirrored or missing rotation are refused with the number of the pose."""
    T = kinematics.forward(np.deg2rad([[0, -90, 90, 0, 90, 0]] * 3))
    with pytest.raises(PlannerError, match=words):
        kinematics.inverse(spoil(T))


def test_forward_refuses_a_wrong_shape(kinematics):
    """A single configuration without its leading axis is refused."""
    with pytest.raises(PlannerError, match=r"q has shape \(6,\)"):
        kinematics.forward(np.zeros(6))
