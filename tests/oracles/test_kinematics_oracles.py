"""The closed form against MuJoCo's chain of bodies and py-opw-kinematics, an independent solver."""

import mujoco
import numpy as np
from py_opw_kinematics import KinematicModel, Robot
from scipy.spatial.transform import RigidTransform

from cell.robot import model as robot
from cell.robot.arm import kinematics_of, kr16_kinematics


def test_both_solvers_find_the_same_branches():
    """On 3000 random poses each real branch of one solver is one of the other to 1e-8 rad."""
    kinematics = kr16_kinematics()
    arm = kinematics.arm
    oracle = Robot(
        KinematicModel(
            a1=arm.a1,
            a2=-arm.a3,
            c1=arm.d1,
            c2=arm.a2,
            c3=arm.d4,
            c4=arm.d6,
            offsets=(0.0, -np.pi / 2, 0.0, 0.0, 0.0, 0.0),
            flip_axes=(True, False, False, True, False, True),
        ),
        degrees=False,
    )
    rng = np.random.default_rng(5)
    q = rng.uniform(kinematics.limits.lower, kinematics.limits.upper, (3000, 6))
    T = kinematics.forward(q)
    np.testing.assert_allclose(oracle.forward(q[0]).as_matrix(), T[0], rtol=0, atol=1e-12)

    found = kinematics.inverse(T)
    expected = np.asarray(oracle.reach(RigidTransform.from_matrix(T)).joints)
    assert (np.isnan(found[..., 0]).sum(axis=1) == np.isnan(expected[..., 0]).sum(axis=1)).all()
    assert (~np.isnan(found[..., 0])).sum() > 3000 * 5
    gap = np.abs((found[:, :, None] - expected[:, None] + np.pi) % (2 * np.pi) - np.pi).max(axis=-1)
    gap = np.where(np.isnan(gap), np.inf, gap)
    np.testing.assert_array_less(gap.min(axis=2)[~np.isnan(found[..., 0])], 1e-8)
    np.testing.assert_array_less(gap.min(axis=1)[~np.isnan(expected[..., 0])], 1e-8)


def test_forward_is_the_flange_site_of_the_compiled_model():
    """T_base_flange equals the pose of the site `flange` to 1e-12, anywhere within the limits."""
    model = robot.load()
    kinematics = kinematics_of(model)
    rng = np.random.default_rng(1)
    q = rng.uniform(kinematics.limits.lower, kinematics.limits.upper, (2000, 6))
    q = np.vstack([q, kinematics.limits.lower, kinematics.limits.upper, np.zeros(6), robot.home(model)])
    data = mujoco.MjData(model)
    T = kinematics.forward(q)
    for pose, angles in zip(T, q, strict=True):
        data.qpos[:] = angles
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(pose[:3, 3], data.site("flange").xpos, rtol=0, atol=1e-12)
        np.testing.assert_allclose(pose[:3, :3], data.site("flange").xmat.reshape(3, 3), rtol=0, atol=1e-12)
        assert pose[3].tolist() == [0.0, 0.0, 0.0, 1.0]
