"""The KR 16 for tests: limits for drivers and home."""

import numpy as np

from cell.robot import model as robot
from drivers.limits import Limits

KR16 = Limits.from_rad(robot.limits(robot.load()))
HOME = np.radians([0.0, -90.0, 90.0, 0.0, 90.0, 0.0])
