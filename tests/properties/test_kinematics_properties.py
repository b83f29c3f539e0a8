import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.kinematics.frames import kuka_abc_from_pose, pose_from_kuka_abc

# Angles anywhere, and often at or next to the multiples of 90 deg where singularities live.
NEAR_A_QUARTER = st.builds(
    lambda quarter, power, sign: quarter * np.pi / 2 + sign * 10.0**power,
    st.integers(-2, 2),
    st.floats(-17, -1),
    st.sampled_from([-1.0, 0.0, 1.0]),
)
ANGLE = st.one_of(st.floats(-np.pi, np.pi), NEAR_A_QUARTER)


@settings(max_examples=4 * settings.default.max_examples)
@given(st.tuples(*[ANGLE] * 3), st.tuples(*[st.floats(-1e3, 1e3)] * 3))
def test_kuka_angles_reproduce_the_rotation_everywhere(abc, position):
    """A, B, C -> T -> A, B, C -> T gives the same T to 5e-14, in gimbal lock too, within the ranges."""
    T = pose_from_kuka_abc(position, abc)
    back_position, back = kuka_abc_from_pose(T)
    assert (back_position == position).all()
    assert (np.abs(back) <= np.pi).all()
    assert abs(back[1]) <= np.pi / 2
    np.testing.assert_allclose(pose_from_kuka_abc(back_position, back), T, rtol=0, atol=5e-14)
