"""The closed form against MuJoCo's chain of bodies."""

import mujoco
import numpy as np
import pytest

from cell.robot import model as robot
from cell.robot.arm import kinematics_of


@pytest.fixture(scope="module")
def model():
    """Return the compiled robot alone."""
    return robot.load()


def test_forward_is_the_flange_site_of_the_compiled_model(model):
    """T_base_flange equals the pose of the site `flange` to 1e-12, anywhere within the limits."""
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
