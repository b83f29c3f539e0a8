"""Joint angles, speeds and accelerations of a sweep over time. Base frame, metres, radians, seconds."""

from dataclasses import dataclass

import numpy as np

from planner.path.sweeps.arm import ScannerArm, derivatives, follow
from planner.path.sweeps.path import SweepPath
from planner.ports import Kinematics
from planner.timing.s_curve import sample
from planner.values import Floats


@dataclass(frozen=True, slots=True, eq=False)
class DrivenSweep:
    """A sweep with what times it: `planner.timing.motion.TimedLine`.

    Attributes:
        path: the sweep.
        T_flange_scanner: (4, 4) mount [m].
        kinematics: of the arm.
    """

    path: SweepPath
    T_flange_scanner: Floats
    kinematics: Kinematics

    @property
    def times(self) -> Floats:
        """(m,) times after the start at which the vertices are passed [s]."""
        path = self.path
        low, high = np.zeros(len(path.u)), np.full(len(path.u), path.duration)
        if path.line.stands:
            return low
        for _ in range(60):
            middle = 0.5 * (low + high)
            before = sample(path.profile, middle)[0] < path.u
            low, high = np.where(before, middle, low), np.where(before, high, middle)
        high[0], high[-1] = 0.0, path.duration
        return high

    def at(self, t: Floats) -> tuple[Floats, Floats, Floats]:
        """Joint angles, speeds and accelerations.

        The ends are the path's set-points; in between the angles follow the line, the ends' rounding (at most 5e-5 deg)
        faded from one to the other.

        Args:
            t: (n,) times after the start [s], in [0, duration].

        Returns:
            (n, 6) q [rad], (n, 6) qd [rad/s], (n, 6) qdd [rad/s^2].
        """
        path = self.path
        if path.line.stands:
            return np.repeat(path.q[:1], len(t), axis=0), np.zeros((len(t), 6)), np.zeros((len(t), 6))
        arm = ScannerArm(self.kinematics, np.asarray(self.T_flange_scanner, dtype=np.float64))
        u, ud, udd = sample(path.profile, t)
        grid = np.concatenate([path.u, u])
        order = np.argsort(grid, kind="stable")
        q = np.empty((len(grid), 6))
        q[order] = follow(path.line, path.branch, arm, grid[order])
        q += 2.0 * np.pi * np.round((path.q[0] - q[0]) / (2.0 * np.pi))
        error = path.q[[0, -1]] - q[[0, len(path.u) - 1]]
        q = q[len(path.u) :]
        first, second = derivatives(path.line, q, arm)[:2]
        fade = error[1] - error[0]
        q = q + error[0] + u[:, None] * fade
        first = first + fade
        return q, first * ud[:, None], second * ud[:, None] ** 2 + first * udd[:, None]
