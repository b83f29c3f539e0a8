"""Closed-form forward and inverse kinematics of two families of six-axis arms, vectorised over poses.

**Spherical wrist** (`SphericalWrist`), the KR 16's family. With KUKA angles A1..A6, s = A2 + A3 and the lengths of
`Dimensions` (d1, a1, a2, a3, d4, d6):

    r = a1 + a2 cos A2 + d4 cos s + a3 sin s            wrist centre, signed distance from the A1 axis
    z = d1 - a2 sin A2 - d4 sin s + a3 cos s            wrist centre, height
    w = (r cos A1, -r sin A1, z)
    R = Rz(-A1) Ry(s) Rx(-A4) Ry(A5) Rx(-A6)
    flange: origin w + d6 R[:, 0], axes R Ry(90 deg)

The inverse decouples arm and spherical wrist (D. L. Pieper, "The kinematics of manipulators under computer control",
Stanford 1968; for this family M. Brandstoetter, A. Angerer, M. Hofbaur, "An analytical solution of the inverse
kinematics problem of industrial serial manipulators with an ortho-parallel basis and a spherical wrist", 2014).
With L = hypot(d4, a3), phi = atan2(-a3, d4) and psi = A3 + phi the arm is a planar two-bar chain of lengths a2 and L.

The eight branches have fixed places, slot = 4 shoulder + 2 elbow + wrist:

    shoulder  0: r >= 0, wrist centre in front of A1     1: r < 0, overhead
    elbow     0: psi >= 0 (A3 >= -2.99 deg)              1: psi < 0
    wrist     0: A5 >= 0                                 1: A5 < 0

Singular poses have an exact solution, by these conventions: wrist centre on the A1 axis: A1 = 0 (slots 0..3) or 180 deg
(slots 4..7); A5 = 0: A4 = 0 (wrist 0) or 180 deg (wrist 1); arm stretched or folded: both elbow slots coincide. Poses
beyond the stretched arm by at most 1e-10 m count as stretched; the solution then misses the pose by that distance.

**Three parallel axes** (`ParallelAxes`), the second to the fourth (Universal Robots). With angles t1..t6,
phi = t2 + t3 + t4 and the lengths of `ParallelLengths`:

    p = Rz(t1) [(a1, b, d1) + a2 x(t2) + a3 x(t2 + t3) + Ry(phi) (0, 0, d5)]     x(t) = (cos t, 0, -sin t)
    R = Rz(t1) Ry(phi) Rz(t5) Ry(t6)
    flange: origin p, axes R

Axes 5 and 6 meet in p; `planner.kinematics.fit` adds the constant transform from p to the flange's face. The inverse
follows K. P. Hawkins, "Analytic inverse kinematics for the Universal Robots UR-5/UR-10 arms", 2013: t1 from the offset
b, t5 and phi from the direction of axis 6 in the frame turned by t1, t6 from the remaining rotation, t2 and t3 as a
planar two-bar chain. Slot = 4 shoulder + 2 wrist + elbow:

    shoulder  0: p in front of A1 if its offset b lies aside        1: behind
    wrist     0: t5 >= 0                                            1: t5 < 0
    elbow     0: t3 >= 0                                            1: t3 < 0

Singular poses: p at the distance b from A1: both shoulders coincide; t5 = 0 or 180 deg (axis 6 parallel to the three):
t6 = 0; arm stretched: both elbows coincide. Poses beyond the stretched arm, or nearer to A1 than b, by at most 1e-10 m
count as on the border.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError
from planner.ports import JointLimits
from planner.values import Floats

BRANCHES = 8

STRETCH_TOLERANCE = 1e-10
"""Distance [m] by which a pose may lie beyond the stretched (or inside the folded) arm and still count as stretched."""

# Poses in one batch: the intermediate arrays (about 150 doubles a pose) then fit into the cache.
_CHUNK = 2048
# Nearer to A1 than this [m], the direction of the wrist centre is rounding noise.
_ON_A1 = 1e-12
# Below this |sin A5| A4 and A6 are rounding noise; the convention A4 = 0 at A5 = 0 costs 1e-12 rad at most.
_WRIST_SINGULAR = 1e-12
# Below this |sin A5| A6 is computed from the rotation that A4 leaves: the noise of A4, 1e-16 / sin A5, then cancels.
_WRIST_NEAR_SINGULAR = 1e-3
# Largest deviation of a rotation from orthonormal.
_ROTATION_TOLERANCE = 1e-6


@dataclass(frozen=True, slots=True)
class Dimensions:
    """Seven lengths of a KUKA arm with a spherical wrist [m], at A1..A6 = 0.

    Attributes:
        d1: foot to A2 axis, up.
        a1: A1 axis to A2 axis, forward.
        a2: A2 axis to A3 axis.
        a3: A3 axis to A4 axis, up when the forearm is level (negative: A4 is below A3).
        d4: A3 axis to wrist centre, along A4.
        d6: wrist centre to flange face.
        b: sideways offset of forearm and wrist, along y.
    """

    d1: float
    a1: float
    a2: float
    a3: float
    d4: float
    d6: float
    b: float = 0.0


@dataclass(frozen=True, slots=True)
class SphericalWrist:
    """Kinematics of the spherical-wrist family in the frames, angles and signs of this module."""

    lengths: Dimensions

    def forward(self, q: Floats, T: Floats) -> None:
        """Fill T (n, 4, 4), zeros, with the flange poses at q (6, n)."""
        arm = self.lengths
        a1, a2, a4, a5, a6 = q[0], q[1], q[3], q[4], q[5]
        s = q[1] + q[2]
        c1, s1, cs, ss = np.cos(a1), np.sin(a1), np.cos(s), np.sin(s)
        c4, s4, c5, s5, c6, s6 = np.cos(a4), np.sin(a4), np.cos(a5), np.sin(a5), np.cos(a6), np.sin(a6)
        r = arm.a1 + arm.a2 * np.cos(a2) + arm.d4 * cs + arm.a3 * ss
        z = arm.d1 - arm.a2 * np.sin(a2) - arm.d4 * ss + arm.a3 * cs
        # Columns of the wrist Rx(-A4) Ry(A5) Rx(-A6), each rotated by Ry(s), then by Rz(-A1).
        wrist = (
            (c5, -s4 * s5, -c4 * s5),
            (-s5 * s6, c4 * c6 - s4 * c5 * s6, -s4 * c6 - c4 * c5 * s6),
            (s5 * c6, c4 * s6 + s4 * c5 * c6, -s4 * s6 + c4 * c5 * c6),
        )
        # The flange's axes (x, y, z) are R's columns (-2, 1, 0).
        for column, (x, y, up), sign in ((2, wrist[0], 1.0), (1, wrist[1], 1.0), (0, wrist[2], -1.0)):
            ahead = cs * x + ss * up
            T[:, 0, column] = sign * (c1 * ahead + s1 * y)
            T[:, 1, column] = sign * (c1 * y - s1 * ahead)
            T[:, 2, column] = sign * (cs * up - ss * x)
        T[:, 0, 3] = r * c1 + arm.b * s1 + arm.d6 * T[:, 0, 2]
        T[:, 1, 3] = -r * s1 + arm.b * c1 + arm.d6 * T[:, 1, 2]
        T[:, 2, 3] = z + arm.d6 * T[:, 2, 2]
        T[:, 3, 3] = 1.0

    def inverse(self, T: Floats, q: Floats, first: int) -> None:
        """Fill q (n, 8, 6) with the branches of T (n, 4, 4); `first` is the number of T[0] for messages."""
        arm = self.lengths
        # Contiguous rows, one per matrix element: R = flange axes Ry(-90 deg) = (z, y, -x).
        e = np.ascontiguousarray(T[:, :3, :].reshape(len(T), 12).T)
        R = np.stack((e[2], e[6], e[10], e[1], e[5], e[9], -e[0], -e[4], -e[8])).reshape(3, 3, -1)  # [column][row]
        require_rigid(T, first)
        w = e[3::4] - arm.d6 * R[0]

        # Shoulder (2, n): A1, and the wrist centre in the plane of the arm.
        radius = np.hypot(w[0], w[1])
        aside = radius > _ON_A1
        reach = np.where(aside, radius, 1.0)
        c1 = np.where(aside, w[0] / reach, 1.0)
        s1 = np.where(aside, -w[1] / reach, 0.0)
        a1, c1, s1, out = _shoulders(arm.b, radius, c1, s1)
        x = np.stack((out, -out)) - arm.a1
        y = arm.d1 - w[2]
        # Each axis of the wrist's rotation in the arm's plane: forward, sideways (rotated by +A1). (2, 3 columns, n)
        ahead = c1[:, None] * R[:, 0] - s1[:, None] * R[:, 1]
        sideways = s1[:, None] * R[:, 0] + c1[:, None] * R[:, 1]
        up = R[:, 2]

        # Elbow (2 shoulder, 2 elbow, n): the two-bar chain a2, L to the point (x, y), y down.
        forearm = np.hypot(arm.d4, arm.a3)
        phi = np.arctan2(-arm.a3, arm.d4)
        square = x * x + y * y
        rho = np.sqrt(square)
        longest, shortest = arm.a2 + forearm, abs(arm.a2 - forearm)
        real = (rho <= longest + STRETCH_TOLERANCE) & (rho >= shortest - STRETCH_TOLERANCE) & (rho > 0.0)
        real &= radius >= abs(arm.b) - STRETCH_TOLERANCE
        # 16 times the squared area of the triangle (Heron), factored to lose no digits near the stretched arm.
        heron = np.maximum((longest - rho) * (longest + rho) * (rho - shortest) * (rho + shortest), 0.0)
        sine = np.sqrt(heron)  # 2 a2 L sin psi
        cosine = square - (arm.a2 * arm.a2 + forearm * forearm)  # 2 a2 L cos psi
        psi = np.arctan2(sine, cosine)
        psi = np.stack((psi, -psi), axis=1)
        # Angle between upper arm and the line to the wrist centre: atan2(L sin psi, a2 + L cos psi), times 2 a2.
        along = square + (arm.a2 * arm.a2 - forearm * forearm)
        lean = np.arctan2(sine, along)
        line = np.arctan2(y, x)
        a2 = np.stack((line - lean, line + lean), axis=1)
        a3 = psi - phi
        s = a2 + a3
        cs, ss = np.cos(s), np.sin(s)

        # Wrist (2, 2, 3 columns, n): M = Ry(-s) Rz(A1) R = Rx(-A4) Ry(A5) Rx(-A6); its first row and first column.
        row = cs[:, :, None] * ahead[:, None] - ss[:, :, None] * up
        m20 = ss * ahead[:, None, 0] + cs * up[0]
        m10 = np.broadcast_to(sideways[:, None, 0], m20.shape)
        s5 = np.hypot(m10, m20)
        a4 = np.arctan2(-m10, -m20)
        a5 = np.arctan2(s5, row[:, :, 0])
        a6 = np.arctan2(-row[:, :, 1], row[:, :, 2])
        near = s5 < _WRIST_NEAR_SINGULAR
        if near.any():
            _near_singular_wrist(near, s5, (ahead, sideways, up), (cs, ss), a4, a5, a6)

        for shoulder in (0, 1):
            for elbow in (0, 1):
                slot = 4 * shoulder + 2 * elbow
                u4, u5, u6 = (angle[shoulder, elbow] for angle in (a4, a5, a6))
                for wrist, angles in ((0, (u4, u5, u6)), (1, (_opposite(u4), -u5, _opposite(u6)))):
                    for axis, angle in enumerate((a1[shoulder], a2[shoulder, elbow], a3[shoulder, elbow], *angles)):
                        q[:, slot + wrist, axis] = angle
        np.add(q, 2.0 * np.pi, out=q, where=q <= -np.pi)
        np.subtract(q, 2.0 * np.pi, out=q, where=q > np.pi)
        for shoulder in (0, 1):
            q[~real[shoulder], 4 * shoulder : 4 * shoulder + 4] = np.nan


def _shoulders(b: float, radius: Floats, c: Floats, s: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Return A1 of both shoulders (2, n), its cosine and sine, and the wrist centre's distance ahead (n,).

    Args:
        b: sideways offset of the wrist centre [m].
        radius: (n,) its distance from the A1 axis [m].
        c: (n,) x of its direction from there.
        s: (n,) -y of its direction.
    """
    if b == 0.0:
        a1 = np.arctan2(s, c)
        return np.stack((a1, _opposite(a1))), np.stack((c, -c)), np.stack((s, -s)), radius
    out = np.sqrt(np.maximum((radius - b) * (radius + b), 0.0))
    norm = np.hypot(out, b)  # the radius, except for poses on the border
    cos, sin = np.stack((out, -out)) / norm, b / norm
    c1, s1 = c * cos - s * sin, s * cos + c * sin
    return np.arctan2(s1, c1), c1, s1, out


def _opposite(angle: Floats) -> Floats:
    """Return the angle plus half a turn, in (-pi, pi]."""
    return np.where(angle > 0.0, angle - np.pi, angle + np.pi)


def _near_singular_wrist(
    near: NDArray[np.bool_],
    s5: Floats,
    axes: tuple[Floats, Floats, Floats],
    direction: tuple[Floats, Floats],
    a4: Floats,
    a5: Floats,
    a6: Floats,
) -> None:
    """Correct A4, A5 and A6 in place for A5 near 0 or 180 deg: A6 from the rotation that A4 leaves, A4 = 0 if singular.

    Ry(A5) Rx(-A6) = Rx(A4) M has the second row (0, cos A6, sin A6).
    """
    shoulder, elbow, n = np.nonzero(near)
    ahead, sideways, up = axes[0][shoulder, :, n], axes[1][shoulder, :, n], axes[2][:, n].T
    cs, ss = (part[shoulder, elbow, n][:, None] for part in direction)
    side, top = sideways, ss * ahead + cs * up  # rows 1 and 2 of M, (k, 3)
    singular = s5[near] < _WRIST_SINGULAR
    first = np.where(singular, 0.0, a4[near])
    c4, s4 = np.cos(first), np.sin(first)
    a4[near] = first
    a5[near] = np.where(singular, np.where(a5[near] < 1.0, 0.0, np.pi), a5[near])
    a6[near] = np.arctan2(c4 * side[:, 2] - s4 * top[:, 2], c4 * side[:, 1] - s4 * top[:, 1])


def require_rigid(T: Floats, first: int) -> None:
    """Raise PlannerError with the pose's number unless every pose of T (n, 4, 4) is a rigid transform."""
    u, v, t = np.ascontiguousarray(T[:, :3, :3].transpose(2, 1, 0))
    cross = (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
    miss = np.abs(u[0] * u[0] + u[1] * u[1] + u[2] * u[2] - 1.0) + np.abs(u[0] * v[0] + u[1] * v[1] + u[2] * v[2])
    miss += np.abs(v[0] * v[0] + v[1] * v[1] + v[2] * v[2] - 1.0)
    miss += np.abs(cross[0] - t[0]) + np.abs(cross[1] - t[1]) + np.abs(cross[2] - t[2])
    miss += np.abs(T[:, 3, :] - (0.0, 0.0, 0.0, 1.0)).sum(axis=1)
    good = (miss <= _ROTATION_TOLERANCE) & np.isfinite(T[:, :3, 3].sum(axis=1))  # a NaN fails both
    if not good.all():
        pose = first + int(np.argmin(good))
        raise PlannerError(
            f"pose {pose} of T_base_flange is not a rigid transform (orthonormal, right-handed, finite) to "
            f"{_ROTATION_TOLERANCE:g}; give transforms whose rotation part is a rotation"
        )


@dataclass(frozen=True, slots=True)
class ParallelLengths:
    """Lengths of an arm with three parallel axes [m], at all angles zero.

    Attributes:
        d1: origin to the second axis, up.
        a1: first axis to the second, forward.
        b: first axis to the intersection of axes 5 and 6, along y.
        a2: second axis to the third.
        a3: third axis to the fourth.
        d5: fourth axis to the intersection of axes 5 and 6, along axis 5.
    """

    d1: float
    a1: float
    b: float
    a2: float
    a3: float
    d5: float


@dataclass(frozen=True, slots=True)
class ParallelAxes:
    """Kinematics of the parallel-axes family in the frames, angles and signs of this module."""

    lengths: ParallelLengths

    def forward(self, t: Floats, T: Floats) -> None:
        """Fill T (n, 4, 4) with the poses at t (6, n)."""
        arm = self.lengths
        phi = t[1] + t[2] + t[3]
        c1, s1, cp, sp = np.cos(t[0]), np.sin(t[0]), np.cos(phi), np.sin(phi)
        c5, s5, c6, s6 = np.cos(t[4]), np.sin(t[4]), np.cos(t[5]), np.sin(t[5])
        # Columns of Ry(phi) Rz(t5) Ry(t6).
        columns = (
            (cp * c5 * c6 - sp * s6, s5 * c6, -sp * c5 * c6 - cp * s6),
            (-cp * s5, c5, sp * s5),
            (cp * c5 * s6 + sp * c6, s5 * s6, cp * c6 - sp * c5 * s6),
        )
        x = arm.a1 + arm.a2 * np.cos(t[1]) + arm.a3 * np.cos(t[1] + t[2]) + arm.d5 * sp
        z = arm.d1 - arm.a2 * np.sin(t[1]) - arm.a3 * np.sin(t[1] + t[2]) + arm.d5 * cp
        for column, (ahead, side, up) in enumerate((*columns, (x, arm.b, z))):
            T[:, 0, column], T[:, 1, column], T[:, 2, column] = c1 * ahead - s1 * side, s1 * ahead + c1 * side, up
        T[:, 3] = (0.0, 0.0, 0.0, 1.0)

    def inverse(self, T: Floats, t: Floats, first: int) -> None:
        """Fill t (n, 8, 6) with the branches of T (n, 4, 4); `first` is the number of T[0] for messages."""
        arm = self.lengths
        require_rigid(T, first)
        e = np.ascontiguousarray(T[:, :3, :].reshape(len(T), 12).T).reshape(3, 4, -1)  # [row][column]
        p = e[:, 3]
        # Shoulder (2, n): the offset b in the frame turned by t1.
        radius = np.hypot(p[0], p[1])
        ahead = np.sqrt(np.maximum(radius * radius - arm.b * arm.b, 0.0))
        beside = np.arctan2(p[1], p[0])
        lean = np.arctan2(arm.b, np.stack((ahead, -ahead)))
        t1 = beside - lean
        c1, s1 = np.cos(t1), np.sin(t1)
        aside = radius >= abs(arm.b) - STRETCH_TOLERANCE
        # Rows of Rz(-t1) R: forward, sideways; row 2 is R's own. (2, 3 columns, n)
        forward = c1[:, None] * e[0, :3] + s1[:, None] * e[1, :3]
        sideways = c1[:, None] * e[1, :3] - s1[:, None] * e[0, :3]
        up = e[2, :3]
        x = np.stack((ahead, -ahead)) - arm.a1
        z = p[2] - arm.d1

        # Wrist: the second column of Ry(phi) Rz(t5) is (-cos phi sin t5, cos t5, sin phi sin t5).
        sine = np.hypot(forward[:, 1], up[1])
        singular = sine < _WRIST_SINGULAR
        t5 = np.arctan2(sine, sideways[:, 1])
        for wrist in (0, 1):
            sign = 1.0 - 2.0 * wrist
            # If singular, t6 = 0: then Ry(phi) Rz(t5) is the rotation, its third column (sin phi, 0, cos phi).
            phi = np.where(singular, np.arctan2(forward[:, 2], up[2]), np.arctan2(sign * up[1], -sign * forward[:, 1]))
            cp, sp = np.cos(phi), np.sin(phi)
            # Ry(t6) = Rz(-t5) Ry(-phi) Rz(-t1) R: its first row is (cos t6, 0, sin t6), its last (-sin t6, 0, cos t6).
            t6 = np.where(
                singular, 0.0, np.arctan2(-(sp * forward[:, 0] + cp * up[0]), sp * forward[:, 2] + cp * up[2])
            )
            # Two bars a2, a3 to the fourth axis.
            u, v = x - arm.d5 * sp, z - arm.d5 * cp
            square = u * u + v * v
            rho = np.sqrt(square)
            longest, shortest = abs(arm.a2) + abs(arm.a3), abs(abs(arm.a2) - abs(arm.a3))
            real = aside & (rho <= longest + STRETCH_TOLERANCE) & (rho >= shortest - STRETCH_TOLERANCE)
            heron = np.maximum((longest - rho) * (longest + rho) * (rho - shortest) * (rho + shortest), 0.0)
            bend = np.sqrt(heron)  # 2 a2 a3 sin t3
            t3 = np.arctan2(bend, square - (arm.a2 * arm.a2 + arm.a3 * arm.a3))
            slope = np.arctan2(bend, square + (arm.a2 * arm.a2 - arm.a3 * arm.a3))
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


class KukaKinematics:
    """`planner.ports.Kinematics` of an arm of the KR 16's family.

    Args:
        arm: lengths of the arm.
        joint_limits: limits of A1..A6; `inverse` does not apply them.
    """

    def __init__(self, arm: Dimensions, joint_limits: JointLimits) -> None:
        self.arm = arm
        self._wrist = SphericalWrist(arm)
        self._limits = joint_limits

    @property
    def limits(self) -> JointLimits:
        """Limits of the axes."""
        return self._limits

    def forward(self, q: Floats) -> Floats:
        """Return flange poses T_base_flange (N, 4, 4) [m] at joint angles q (N, 6) [rad], KUKA signs."""
        q = np.asarray(q, dtype=np.float64)
        if q.ndim != 2 or q.shape[1] != 6:
            raise PlannerError(f"q has shape {q.shape}; it must be (N, 6)")
        T = np.zeros((len(q), 4, 4))
        for start in range(0, len(q), _CHUNK):
            chunk = slice(start, start + _CHUNK)
            self._wrist.forward(q[chunk].T, T[chunk])
        return T

    def inverse(self, T_base_flange: Floats) -> Floats:
        """Return all eight branches of each pose, in the slot order of this module, not limited to the joint range.

        Args:
            T_base_flange: (N, 4, 4) [m].

        Returns:
            (N, 8, 6) joint angles [rad] in (-pi, pi]; NaN if a branch has no real solution.
        """
        T = np.asarray(T_base_flange, dtype=np.float64)
        if T.ndim != 3 or T.shape[1:] != (4, 4):
            raise PlannerError(f"T_base_flange has shape {T.shape}; it must be (N, 4, 4)")
        q = np.empty((len(T), BRANCHES, 6))
        for start in range(0, len(T), _CHUNK):
            chunk = slice(start, start + _CHUNK)
            self._wrist.inverse(T[chunk], q[chunk], start)
        return q
