"""The KR 16 for tests: kinematics with a mounted scanner for sweeps, limits for drivers and home."""

import numpy as np

from cell.robot.arm import kr16_kinematics
from drivers.limits import Limits

KINEMATICS = kr16_kinematics()
LIMITS = KINEMATICS.limits
KR16 = Limits.from_rad(LIMITS)
HOME = np.radians([0.0, -90.0, 90.0, 0.0, 90.0, 0.0])
MOUNT = np.eye(4)
MOUNT[2, 3] = 0.12
