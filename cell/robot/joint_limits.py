"""The axes' limits that a scene asks for, over those of the robot model.

A speed, acceleration or jerk that the scene does not give follows: the model's acceleration changes with the speed, so
that it is reached in the same time (0.5 s for the KR 16), and the jerk with the acceleration (0.1 s). Degrees in, rad
out; positions are the model's.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from planner.ports import JointLimits


def given(
    model: JointLimits,
    velocity_deg_s: Sequence[float] | None = None,
    acceleration_deg_s2: Sequence[float] | None = None,
    jerk_deg_s3: Sequence[float] | None = None,
) -> JointLimits:
    """The model's limits with those that are given in their place.

    Args:
        model: limits of the robot model.
        velocity_deg_s: (6,) axis speeds [deg/s]; None: the model's.
        acceleration_deg_s2: (6,) axis accelerations [deg/s^2]; None: reached in the model's time.
        jerk_deg_s3: (6,) axis jerks [deg/s^3], inf: not limited; None: accelerations reached in the model's time.
    """
    velocity = model.velocity if velocity_deg_s is None else np.radians(velocity_deg_s)
    acceleration = (
        model.acceleration * (velocity / model.velocity)
        if acceleration_deg_s2 is None
        else np.radians(acceleration_deg_s2)
    )
    jerk = model.jerk * (acceleration / model.acceleration) if jerk_deg_s3 is None else np.radians(jerk_deg_s3)
    return replace(model, velocity=velocity, acceleration=acceleration, jerk=jerk)
