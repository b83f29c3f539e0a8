"""The arm along a line: Jacobian of the scanner frame, joint angles of a branch, their derivatives by the parameter.

J is had from `Kinematics.forward` alone: turning one revolute axis by +-90 deg moves the frame by exactly

    (p+ - p-) / 2 = z x (p - o)        (R+ - R-) R^T / 2 = [z]x

Base frame, metres, radians.
"""

import numpy as np

from planner.path.sweeps.line import SweepLine
from planner.ports import Kinematics
from planner.values import Bools, Floats

SLACK = 1.1
"""R over the largest distance of an axis at a sample; what the distance may grow in between is checked."""


class ScannerArm:
    """Forward kinematics of the scanner frame, and its Jacobian."""

    def __init__(self, kinematics: Kinematics, T_flange_scanner: Floats) -> None:
        self.kinematics, self.mount = kinematics, T_flange_scanner
        self._unmount = np.linalg.inv(T_flange_scanner)

    def flange(self, T_base_scanner: Floats) -> Floats:
        """(n, 4, 4) T_base_flange of scanner poses."""
        T: Floats = T_base_scanner @ self._unmount
        T[:, 3] = (0.0, 0.0, 0.0, 1.0)
        return T

    def scanner(self, q: Floats) -> Floats:
        """(n, 4, 4) T_base_scanner."""
        return np.asarray(self.kinematics.forward(q) @ self.mount)

    def jacobian(self, q: Floats) -> tuple[Floats, Floats]:
        """(n, 3, 6) linear [m/rad] and (n, 3, 6) angular columns."""
        turned = np.repeat(q[:, None], 12, axis=1)
        for axis in range(6):
            turned[:, axis, axis] += 0.5 * np.pi
            turned[:, 6 + axis, axis] -= 0.5 * np.pi
        T = self.scanner(turned.reshape(-1, 6)).reshape(len(q), 12, 4, 4)
        linear = 0.5 * (T[:, :6, :3, 3] - T[:, 6:, :3, 3])
        R = self.scanner(q)[:, None, :3, :3]
        cross = 0.5 * (T[:, :6, :3, :3] - T[:, 6:, :3, :3]) @ np.swapaxes(R, -1, -2)
        angular = np.stack([cross[..., 2, 1], cross[..., 0, 2], cross[..., 1, 0]], axis=-1)
        return np.swapaxes(linear, 1, 2), np.swapaxes(angular, 1, 2)


def follow(line: SweepLine, branch: int, arm: ScannerArm, u: Floats) -> Floats:
    """(n, 6) joint angles of a branch along the line [rad], without jumps of whole turns; NaN out of reach."""
    q: Floats = np.array(arm.kinematics.inverse(arm.flange(line.at(u)))[:, branch])
    return q if np.isnan(q).any() else np.unwrap(q, axis=0)


def derivatives(line: SweepLine, q: Floats, arm: ScannerArm) -> tuple[Floats, Floats, Floats, float, Floats]:
    """First and second derivative by u (n, 6), singular value (n,), |xi|, and the direction that is weakest (n, 6)."""
    linear, angular = arm.jacobian(q)
    lever = SLACK * float(np.linalg.norm(linear, axis=1).max())
    xi = np.concatenate([line.displacement / lever, line.turn])
    left, sigma, right = np.linalg.svd(np.concatenate([linear / lever, angular], axis=1))
    safe = np.maximum(sigma, 1e-12)

    def solve(sides: Floats) -> Floats:
        inner = (np.swapaxes(left, 1, 2) @ sides[:, :, None])[:, :, 0] / safe
        return np.asarray((np.swapaxes(right, 1, 2) @ inner[:, :, None])[:, :, 0])

    first = solve(np.repeat(xi[None], len(q), axis=0))
    z, arms = np.swapaxes(angular, 1, 2), np.swapaxes(linear, 1, 2)  # (n, 6 axes, 3)
    spin = z * first[:, :, None]
    before = np.cumsum(spin, axis=1) - spin
    bend = (np.cross(2.0 * before + spin, arms) * first[:, :, None]).sum(axis=1) / lever
    twist = (np.cross(before, z) * first[:, :, None]).sum(axis=1)
    second = -solve(np.concatenate([bend, twist], axis=1))
    return first, second, sigma[:, -1], float(np.linalg.norm(xi)), right[:, -1]


def axes_named(which: Bools) -> str:
    """The names of some axes: "A4 and A6"."""
    names = [f"A{axis + 1}" for axis in np.flatnonzero(which)]
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
