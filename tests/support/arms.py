"""A KR 16 with a mounted scanner, for sweeps."""

import numpy as np

from cell.robot.arm import kr16_kinematics

KINEMATICS = kr16_kinematics()
LIMITS = KINEMATICS.limits
HOME = np.radians([0.0, -90.0, 90.0, 0.0, 90.0, 0.0])
MOUNT = np.eye(4)
MOUNT[2, 3] = 0.12
