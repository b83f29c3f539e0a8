"""Closed-form kinematics of an arm whose second to fourth axes are parallel, vectorised over poses (Universal Robots).

With angles t1..t6, phi = t2 + t3 + t4 and the lengths of `Lengths`:

    p = Rz(t1) [(a1, b, d1) + a2 x(t2) + a3 x(t2 + t3) + Ry(phi) (0, 0, d5)]     x(t) = (cos t, 0, -sin t)
    R = Rz(t1) Ry(phi) Rz(t5) Ry(t6)
    flange: origin p, axes R

p is where axes 5 and 6 meet; what lies between it and the flange's face is a constant transform of `cell.robot.arm`.
The inverse follows K. P. Hawkins, "Analytic inverse kinematics for the Universal Robots UR-5/UR-10 arms", 2013: t1 from
the offset b, t5 and phi from the direction of axis 6 in the frame turned by t1, t6 from what is left, t2 and t3 as a
planar two-bar chain.

The eight branches have fixed places, slot = 4 shoulder + 2 wrist + elbow:

    shoulder  0: p in front of A1 where its offset b lies aside      1: behind
    wrist     0: t5 >= 0                                             1: t5 < 0
    elbow     0: t3 >= 0                                             1: t3 < 0

Singular poses keep an exact solution: p at the distance b from A1: both shoulders coincide; t5 = 0 or 180 deg (axis 6
parallel to the three): t6 = 0; arm stretched: both elbows coincide. Poses beyond the stretched arm, or nearer to A1
than b, by no more than 1e-10 m count as on the border.
"""

from dataclasses import dataclass

import numpy as np

from cell.robot.kinematics import require_rigid
from planner.values import Floats

_BORDER = 1e-10  # m
# Below this |sin t5| phi and t6 are rounding noise one by one; the convention t6 = 0 costs 1e-12 rad at most.
_WRIST_SINGULAR = 1e-12


@dataclass(frozen=True, slots=True)
class Lengths:
    """Lengths [m], at all angles zero.

    Attributes:
        d1: origin to the second axis, up.
        a1: first axis to the second, forward.
        b: first axis to where axes 5 and 6 meet, along y.
        a2: second axis to the third.
        a3: third axis to the fourth.
        d5: fourth axis to where axes 5 and 6 meet, along axis 5.
    """

    d1: float
    a1: float
    b: float
    a2: float
    a3: float
    d5: float


@dataclass(frozen=True, slots=True)
class ParallelAxes:
    """The family's chain in the frames, angles and signs of this module."""

    lengths: Lengths

    def forward(self, t: Floats, T: Floats) -> None:
        """Fill T (n, 4, 4) with the poses at t (6, n)."""
        phi = t[1] + t[2] + t[3]
        c1, s1, cp, sp = np.cos(t[0]), np.sin(t[0]), np.cos(phi), np.sin(phi)
        c5, s5, c6, s6 = np.cos(t[4]), np.sin(t[4]), np.cos(t[5]), np.sin(t[5])
        # Columns of Ry(phi) Rz(t5) Ry(t6).
        columns = (
            (cp * c5 * c6 - sp * s6, s5 * c6, -sp * c5 * c6 - cp * s6),
            (-cp * s5, c5, sp * s5),
            (cp * c5 * s6 + sp * c6, s5 * s6, cp * c6 - sp * c5 * s6),
        )
        x = (
            self.lengths.a1
            + self.lengths.a2 * np.cos(t[1])
            + self.lengths.a3 * np.cos(t[1] + t[2])
            + self.lengths.d5 * sp
        )
        z = (
            self.lengths.d1
            - self.lengths.a2 * np.sin(t[1])
            - self.lengths.a3 * np.sin(t[1] + t[2])
            + self.lengths.d5 * cp
        )
        for column, (ahead, side, up) in enumerate((*columns, (x, self.lengths.b, z))):
            T[:, 0, column], T[:, 1, column], T[:, 2, column] = c1 * ahead - s1 * side, s1 * ahead + c1 * side, up
        T[:, 3] = (0.0, 0.0, 0.0, 1.0)

    def inverse(self, T: Floats, t: Floats, first: int) -> None:
        """Fill t (n, 8, 6) with the branches of T (n, 4, 4); `first` is the number of T[0] for messages."""
        require_rigid(T, first)
        e = np.ascontiguousarray(T[:, :3, :].reshape(len(T), 12).T).reshape(3, 4, -1)  # [row][column]
        p = e[:, 3]
        # Shoulder (2, n): the offset b in the frame turned by t1.
        radius = np.hypot(p[0], p[1])
        ahead = np.sqrt(np.maximum(radius * radius - self.lengths.b * self.lengths.b, 0.0))
        beside = np.arctan2(p[1], p[0])
        lean = np.arctan2(self.lengths.b, np.stack((ahead, -ahead)))
        t1 = beside - lean
        c1, s1 = np.cos(t1), np.sin(t1)
        aside = radius >= abs(self.lengths.b) - _BORDER
        # Rows of Rz(-t1) R: forward, sideways; row 2 is R's own. (2, 3 columns, n)
        forward = c1[:, None] * e[0, :3] + s1[:, None] * e[1, :3]
        sideways = c1[:, None] * e[1, :3] - s1[:, None] * e[0, :3]
        up = e[2, :3]
        x = np.stack((ahead, -ahead)) - self.lengths.a1
        z = p[2] - self.lengths.d1

        # Wrist: the second column of Ry(phi) Rz(t5) is (-cos phi sin t5, cos t5, sin phi sin t5).
        sine = np.hypot(forward[:, 1], up[1])
        singular = sine < _WRIST_SINGULAR
        t5 = np.arctan2(sine, sideways[:, 1])
        for wrist in (0, 1):
            sign = 1.0 - 2.0 * wrist
            # Where singular, t6 = 0: then Ry(phi) Rz(t5) is the rotation, its third column (sin phi, 0, cos phi).
            phi = np.where(singular, np.arctan2(forward[:, 2], up[2]), np.arctan2(sign * up[1], -sign * forward[:, 1]))
            cp, sp = np.cos(phi), np.sin(phi)
            # Ry(t6) = Rz(-t5) Ry(-phi) Rz(-t1) R: its first row is (cos t6, 0, sin t6), its last (-sin t6, 0, cos t6).
            t6 = np.where(
                singular, 0.0, np.arctan2(-(sp * forward[:, 0] + cp * up[0]), sp * forward[:, 2] + cp * up[2])
            )
            # Two bars a2, a3 to the fourth axis.
            u, v = x - self.lengths.d5 * sp, z - self.lengths.d5 * cp
            square = u * u + v * v
            rho = np.sqrt(square)
            longest, shortest = (
                abs(self.lengths.a2) + abs(self.lengths.a3),
                abs(abs(self.lengths.a2) - abs(self.lengths.a3)),
            )
            real = aside & (rho <= longest + _BORDER) & (rho >= shortest - _BORDER)
            heron = np.maximum((longest - rho) * (longest + rho) * (rho - shortest) * (rho + shortest), 0.0)
            bend = np.sqrt(heron)  # 2 a2 a3 sin t3
            t3 = np.arctan2(bend, square - (self.lengths.a2 * self.lengths.a2 + self.lengths.a3 * self.lengths.a3))
            slope = np.arctan2(bend, square + (self.lengths.a2 * self.lengths.a2 - self.lengths.a3 * self.lengths.a3))
            line = np.arctan2(-v, u)
            for elbow, (turn, lift) in enumerate(((t3, -slope), (-t3, slope))):
                t2 = line + lift
                for shoulder in (0, 1):
                    row = t[:, 4 * shoulder + 2 * wrist + elbow]
                    row[:, 0], row[:, 1], row[:, 2] = t1[shoulder], t2[shoulder], turn[shoulder]
                    row[:, 3] = phi[shoulder] - t2[shoulder] - turn[shoulder]
                    row[:, 4], row[:, 5] = sign * t5[shoulder], t6[shoulder]
                    row[~real[shoulder]] = np.nan
        for axis in (0, 1, 3):  # sums of angles
            t[..., axis] -= 2.0 * np.pi * np.round(t[..., axis] / (2.0 * np.pi))
