import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planner.errors import PlannerError
from planner.kinematics.frames import kuka_abc_from_pose, pose_from_kuka_abc


def test_the_rotation_is_rz_ry_rx():
    """The rotation is Rz(A) Ry(B) Rx(C), equal to SciPy's intrinsic z, y, x. The position is the last column."""
    rng = np.random.default_rng(1)
    abc, position = rng.uniform(-np.pi, np.pi, (500, 3)), rng.normal(size=(500, 3))
    T = pose_from_kuka_abc(position, abc)
    np.testing.assert_allclose(T[:, :3, :3], Rotation.from_euler("ZYX", abc).as_matrix(), rtol=0, atol=1e-15)
    np.testing.assert_array_equal(T[:, :3, 3], position)
    np.testing.assert_array_equal(T[:, 3], np.tile([0.0, 0.0, 0.0, 1.0], (500, 1)))


@pytest.mark.parametrize("b", [90.0, -90.0])
def test_straight_up_and_down(b):
    """At B = +-90 deg, C is 0 and A takes the rotation: A - C at 90, A + C at -90."""
    T = pose_from_kuka_abc([1.0, 2.0, 3.0], np.deg2rad([50.0, b, 20.0]))
    position, abc = kuka_abc_from_pose(T)
    np.testing.assert_allclose(np.rad2deg(abc), [30.0 if b > 0 else 70.0, b, 0.0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(pose_from_kuka_abc(position, abc), T, rtol=0, atol=1e-15)


def test_half_turns_are_plus_180():
    """Half a turn is +180, never -180, for any sign of zero in the matrix."""
    for sign in (1.0, -1.0):
        R = np.diag([-1.0, -1.0, 1.0, 1.0])
        R[1, 0] = sign * 0.0
        assert kuka_abc_from_pose(R)[1].tolist() == [np.pi, 0.0, 0.0]


def test_shapes():
    """Leading axes are kept, including none and empty ones."""
    assert pose_from_kuka_abc(np.zeros(3), np.zeros(3)).shape == (4, 4)
    assert pose_from_kuka_abc(np.zeros((0, 3)), np.zeros((0, 3))).shape == (0, 4, 4)
    position, abc = kuka_abc_from_pose(np.tile(np.eye(4), (2, 5, 1, 1)))
    assert position.shape == abc.shape == (2, 5, 3)


@pytest.mark.parametrize(
    ("T", "words"),
    [
        (np.eye(3), "must be \\(..., 4, 4\\)"),
        (np.diag([2.0, 2, 2, 1]), "not orthonormal"),
        (np.diag([np.nan, 1, 1, 1]), "not orthonormal"),
        (np.diag([-1.0, 1, 1, 1]), "mirrored"),
    ],
    ids=["3 x 3", "scaled", "NaN", "mirrored"],
)
def test_an_invalid_pose_is_refused(T, words):
    """A matrix that is not a rigid transform is refused."""
    with pytest.raises(PlannerError, match=words):
        kuka_abc_from_pose(T)


def test_values_that_are_not_finite_are_refused():
    """Positions that are not finite and arrays of wrong or unequal shapes are refused."""
    with pytest.raises(PlannerError, match="position has a value that is not finite"):
        pose_from_kuka_abc([np.inf, 0, 0], [0, 0, 0])
    with pytest.raises(PlannerError, match=r"abc has shape \(2,\)"):
        pose_from_kuka_abc([0, 0, 0], [0, 0])
    with pytest.raises(PlannerError, match="must be equal"):
        pose_from_kuka_abc(np.zeros((2, 3)), np.zeros((3, 3)))
