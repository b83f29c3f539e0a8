"""The line of a sweep, and the proof that the arm can follow it on one joint branch.

A line sensor's column holds a pose in the middle of each of K equal cells (`viewpoints.sweep_viewpoints`). The driven
laser sheet has to pass over each cell completely, so the line runs from the edge of the first cell to the edge of the
last one: the poses are at u = (k + 0.5) / K of it, u from 0 to 1. On the line

    p(u) = p(0) + u displacement          R(u) = exp(u turn) R(0)

the position advances straight and the orientation turns about a fixed axis, both in proportion, as the linear motion
of a controller does. The twist xi = (displacement, turn) of the scanner frame is constant in u. With J the Jacobian of
the scanner frame (`ScannerArm`), the joints follow q' = J^-1 xi and q'' = -J^-1 (J' q'), primes by u.

*Proof between two samples.* Linear rows of J and xi are divided by R, which no axis' distance from the frame exceeds.
The derivative of each column by an axis then has a norm of at most sqrt(2), so |J'| <= H |q'| with H = sqrt(51) (36
linear and 15 angular terms) and |J''| <= H2 |q'|^2 + H |q''| with H2 = sqrt(432). With sigma the smallest singular
value of J and y = |q'| this gives, at a distance r from a sample,

    sigma >= s = sqrt(sigma_k^2 - 2 H |xi| r)     and, tighter, s = sigma_k - H Q1 r
    |q'|   <= Q1 = y_k / (1 - H y_k r / s)
    |q''|  <= Q2 = H Q1^2 / s
    |q'''| <= Q3 = (3 H Q1 Q2 + H2 Q1^3) / s
    |q''''| <= Q4 = (3 H Q1 Q3 + 3 B2 Q2 + B3 Q1) / s     B2 = H2 Q1^2 + H Q2 >= |J''|
                                                          B3 = H3 Q1^3 + 3 H2 Q1 Q2 + H Q3 >= |J'''|, H3 = sqrt(2592)

so |q'_j| <= |q'_j,k| + r Q2 and |q''_j| <= |q''_j,k| + r Q3; the third derivative differs by at most 2 r Q4 from its
mean between two samples, which is a difference of q''. These bounds give the time that the axes' limits on speed,
acceleration and jerk need, and the line is driven no faster. If s > 0, the branch continues without a singularity. The
next sample lies on it, and on no other branch, if its distance from the previous one is at most rho = 2 r Q1 and
H rho <= sigma_k / 2: J then changes by less than half of what it would need to become singular, and no pose is taken
twice within rho. Intervals that are not proven are halved, a limited number of times.

Base frame, metres, radians, seconds.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from planner.geometry.rigid import rotation_matrices, rotation_vectors
from planner.ports import JointLimits, Kinematics, axis_name
from planner.timing.s_curve import Profile
from planner.values import Bools, DescribedEnum, Floats, Value, readonly

SLACK = 1.1
"""R over the largest distance of an axis at a sample; the proof checks that it also holds between samples."""

SLOWEST = 4.0
"""Largest factor by which a sweep may be slowed down for the axes; beyond, it is refused."""

_EASE = 0.1  # shortest time in which a ramp reaches its acceleration [s]
_SAME = 1e-7  # steps that differ by less [m, rad] are equal: set-points are coarser than that
_FIRST, _HALVINGS, _MOST = 32, 7, 3000  # initial intervals, rounds of halving, largest number of samples
_H, _H2, _H3 = float(np.sqrt(51.0)), float(np.sqrt(432.0)), float(np.sqrt(2592.0))
_MIN_SIGMA = 1e-4  # below this the arm is in a singularity, within the resolution of a set-point


@dataclass(frozen=True, slots=True)
class SweepSpeed:
    """Largest speed of a sweep; the slower of straight and turning motion applies.

    Attributes:
        linear: speed of the scanner frame's origin [m/s].
        angular: rate of turn [rad/s].
        linear_acceleration: on the ramps [m/s^2]; reached in a tenth of a second at the fastest, as the next.
        angular_acceleration: on the ramps [rad/s^2].
    """

    linear: float = 0.05
    angular: float = 0.35
    linear_acceleration: float = 0.5
    angular_acceleration: float = 1.0

    def scaled(self, speed: float, acceleration: float = 1.0) -> "SweepSpeed":
        """Return fractions of the speeds and of the accelerations: an override slows lines down like every move."""
        return SweepSpeed(
            self.linear * speed,
            self.angular * speed,
            self.linear_acceleration * acceleration,
            self.angular_acceleration * acceleration,
        )

    def slowed(self, limits: JointLimits, full: JointLimits) -> "SweepSpeed":
        """Return the speed scaled by the ratio of joint limits to those at full speed."""
        return self.scaled(_fraction(limits.velocity, full.velocity), _fraction(limits.acceleration, full.acceleration))


def _fraction(limit: Floats, full: Floats) -> float:
    """Return the fraction to which limits are scaled, from the finite ones."""
    known = np.isfinite(limit) & np.isfinite(full)
    return float((limit[known] / full[known]).min(initial=1.0))


DEFAULT_SPEED = SweepSpeed()


@dataclass(frozen=True, slots=True, eq=False)
class SweepLine(Value):
    """A line of poses.

    Attributes:
        T_base_begin: (4, 4) scanner pose at u = 0 [m].
        displacement: (3,) of the origin from u = 0 to 1 [m], base frame.
        turn: (3,) rotation vector from u = 0 to 1 [rad], base frame, shorter than pi.
        poses: number K of measuring poses on it.
    """

    T_base_begin: Annotated[Floats, "4 4"]
    displacement: Annotated[Floats, "3"]
    turn: Annotated[Floats, "3"]
    poses: int

    @property
    def length(self) -> float:
        """Path length of the origin [m]."""
        return float(np.linalg.norm(self.displacement))

    @property
    def angle(self) -> float:
        """Turn of the orientation [rad]."""
        return float(np.linalg.norm(self.turn))

    @property
    def is_stationary(self) -> bool:
        """Whether all poses are the same."""
        return self.length <= _SAME and self.angle <= _SAME

    def at(self, u: Floats) -> Floats:
        """Return (n, 4, 4) scanner poses [m] at (n,) parameters."""
        T = np.tile(self.T_base_begin, (len(u), 1, 1))
        T[:, :3, :3] = rotation_matrices(u[:, None] * self.turn, scale_first=True) @ self.T_base_begin[:3, :3]
        T[:, :3, 3] += u[:, None] * self.displacement
        return T

    def cruise(self, speed: SweepSpeed) -> float:
        """Return the shortest time for the line at constant speed [s] that `speed` allows, without ramps."""
        push = max(self.length / speed.linear_acceleration, self.angle / speed.angular_acceleration)
        rising, easing = self.ramp_shares
        return max(
            self.length / speed.linear,
            self.angle / speed.angular,
            float(np.sqrt(push / rising)),
            float(np.cbrt(push * _EASE / (rising * easing))),
        )

    @property
    def ramp_shares(self) -> tuple[float, float]:
        """`ramp` and `ease` of the profile (`planner.timing.s_curve.Profile`) as shares of `cruise`.

        The ramps take exactly the half cells before the first and after the last pose, so that every pose is passed at
        constant speed: a ramp covers half the distance of the constant speed in the same time.
        """
        return 0.8 / self.poses, 0.2 / self.poses

    def profile(self, cruise: float) -> Profile:
        """Return the profile of u that takes `cruise` seconds at constant speed, plus its ramps."""
        rising, easing = self.ramp_shares
        return Profile(np.array(cruise), np.array(cruise * rising), np.array(cruise * easing))


def line_through(T_base_scanner: ArrayLike) -> SweepLine | None:
    """Return the line through K poses (K, 4, 4) [m], or None if they do not follow a line at equal steps (or K < 2)."""
    T = readonly("T_base_scanner", T_base_scanner, (None, 4, 4))
    count = len(T)
    if count < 2:
        return None
    steps = np.diff(T[:, :3, 3], axis=0)
    turns = rotation_vectors(T[1:, :3, :3] @ np.swapaxes(T[:-1, :3, :3], 1, 2))
    step, turn = steps.mean(axis=0), turns.mean(axis=0)
    if max(np.abs(steps - step).max(), np.abs(turns - turn).max()) > _SAME:
        return None
    if np.linalg.norm(turn) * count >= np.pi:
        return None
    begin = T[0].copy()
    begin[:3, 3] -= 0.5 * step
    begin[:3, :3] = rotation_matrices(-0.5 * turn[None], scale_first=True)[0] @ begin[:3, :3]
    return SweepLine(begin, step * count, turn * count, count)


class ScannerArm:
    """Forward kinematics of the scanner frame, and its Jacobian.

    The Jacobian needs `Kinematics.forward` only: turning one revolute axis by +-90 deg moves the frame by exactly

        (p+ - p-) / 2 = z x (p - o)        (R+ - R-) R^T / 2 = [z]x
    """

    def __init__(self, kinematics: Kinematics, T_flange_scanner: Floats) -> None:
        self.kinematics, self.mount = kinematics, T_flange_scanner
        self._T_scanner_flange = np.linalg.inv(T_flange_scanner)

    def flange(self, T_base_scanner: Floats) -> Floats:
        """Return (n, 4, 4) T_base_flange of scanner poses."""
        T: Floats = T_base_scanner @ self._T_scanner_flange
        T[:, 3] = (0.0, 0.0, 0.0, 1.0)
        return T

    def scanner(self, q: Floats) -> Floats:
        """Return (n, 4, 4) T_base_scanner at (n, 6) joint angles."""
        return np.asarray(self.kinematics.forward(q) @ self.mount)

    def jacobian(self, q: Floats) -> tuple[Floats, Floats]:
        """Return (n, 3, 6) linear [m/rad] and (n, 3, 6) angular columns."""
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


def follow_branch(line: SweepLine, branch: int, arm: ScannerArm, u: Floats) -> Floats:
    """Return (n, 6) joint angles of a branch along the line [rad], without jumps of full turns; NaN out of reach."""
    q: Floats = np.array(arm.kinematics.inverse(arm.flange(line.at(u)))[:, branch])
    return q if np.isnan(q).any() else np.unwrap(q, axis=0)


def joint_derivatives(line: SweepLine, q: Floats, arm: ScannerArm) -> tuple[Floats, Floats, Floats, float, Floats]:
    """Return q' and q'' (n, 6), the smallest singular value (n,), |xi|, and the weakest joint direction (n, 6)."""
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


def join_axis_names(which: Bools) -> str:
    """Return the names of some axes: "A4 and A6"."""
    names = [axis_name(axis) for axis in np.flatnonzero(which).tolist()]
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


class SweepRefusal(DescribedEnum):
    """Reason why a sweep cannot be driven on a branch."""

    NO_LINE = 0, "the poses do not follow each other at equal steps on a line"
    OUT_OF_REACH = 1, "the line leaves the arm's reach"
    SINGULAR = 2, "the line comes too near to a singularity to be followed on one joint branch"
    JOINT_LIMIT = 3, "the line exceeds a joint limit"
    TOO_FAST = 4, "even at a quarter of the speed an axis would exceed its speed, acceleration or jerk"
    COLLISION = 5, "the line comes nearer to an object than the clearance"


@dataclass(frozen=True, slots=True)
class RefusedSweep:
    """A branch on which the sweep cannot be driven.

    Attributes:
        branch: index in the inverse kinematics; -1 for the sweep as such.
        reason: why.
        detail: the axes of a singularity or a limit ("A4 and A6"), or the colliding pair; "" for none.
    """

    branch: int
    reason: SweepRefusal
    detail: str

    @property
    def sentence(self) -> str:
        """Reason and detail in words."""
        return self.reason.sentence + (f" ({self.detail})" if self.detail else "")


@dataclass(frozen=True, slots=True)
class SweepProof:
    """Proven bounds (6,) of the joint angles of a line on a branch, time at constant speed, smallest sigma."""

    low: Floats
    high: Floats
    cruise: float
    sigma: float


def prove_branch(
    line: SweepLine, branch: int, arm: ScannerArm, limits: JointLimits, cruise: float
) -> SweepProof | RefusedSweep:
    """Follow a branch and prove the motion between the samples (see the proof in the module's docstring).

    If the limits do not allow the wanted `cruise` time, the line is driven slower, up to `SLOWEST` times.
    """
    u = np.linspace(0.0, 1.0, _FIRST + 1)
    for halving in range(_HALVINGS + 1):
        q = follow_branch(line, branch, arm, u)
        if np.isnan(q).any():
            return RefusedSweep(branch, SweepRefusal.OUT_OF_REACH, "")
        first, second, sigma, xi, weak = joint_derivatives(line, q, arm)
        if sigma.min() < _MIN_SIGMA:
            axes = join_axis_names(np.abs(weak[int(sigma.argmin())]) > 0.4)
            return RefusedSweep(branch, SweepRefusal.SINGULAR, axes)
        r = 0.5 * np.diff(u)
        mean = np.abs(np.diff(second, axis=0)) / (2.0 * r)[:, None]  # of the third derivative, between the samples
        at_samples = _time_needed(line, np.abs(first[1:]), np.abs(second[1:]), mean, limits)
        if at_samples.max() > SLOWEST * cruise:
            return _too_fast(branch, first[int(at_samples.max(axis=1).argmax())], limits)
        good, need, reach = np.ones(len(r), dtype=bool), np.zeros(len(r)), np.zeros((len(r), 6))
        steps = np.linalg.norm(np.diff(q, axis=0), axis=1)
        ends = slice(None, -1), slice(1, None)
        bounds = [_derivative_bounds(sigma[end], first[end], xi, r) for end in ends]
        y4 = np.maximum(bounds[0][3], bounds[1][3])  # of the full interval, as the mean is
        for end, (y1, y2, y3, _, holds) in zip(ends, bounds, strict=True):
            rho = 2.0 * r * y1
            good &= holds & (steps <= rho + 1e-12) & (_H * rho <= 0.5 * sigma[end])
            good &= np.sqrt(6.0) * SLACK * y1 * r <= SLACK - 1.0  # no axis' distance exceeds R
            speeds, curves = np.abs(first[end]) + (r * y2)[:, None], np.abs(second[end]) + (r * y3)[:, None]
            jolts = np.minimum(y3[:, None], mean + (2.0 * r * y4)[:, None])
            need = np.maximum(need, _time_needed(line, speeds, curves, jolts, limits).max(axis=1))
            reach = np.maximum(reach, r[:, None] * speeds)
        # An interval is halved while it is not proven, or while its bounds alone would slow the sweep down.
        slowest = SLOWEST * cruise
        open_ = ~good | ~(need <= min(slowest, max(cruise, 1.05 * float(at_samples.max()))))
        last = halving == _HALVINGS or len(u) > _MOST
        if good.all() and (last or not open_.any()) and need.max() <= slowest:
            low = np.minimum(q[:-1] - reach, q[1:] - reach).min(axis=0)
            high = np.maximum(q[:-1] + reach, q[1:] + reach).max(axis=0)
            return SweepProof(low, high, max(cruise, float(need.max())), float(sigma.min()))
        if last:
            break
        u = np.sort(np.concatenate([u, 0.5 * (u[:-1] + u[1:])[open_]]))
    worst = int(np.flatnonzero(open_)[0])
    if good.all():
        return _too_fast(branch, first[worst], limits)
    jump = np.abs(np.diff(q, axis=0)[worst]) > 0.1
    axes = join_axis_names(jump if jump.any() else np.abs(weak[worst]) > 0.4)
    return RefusedSweep(branch, SweepRefusal.SINGULAR, axes)


def _too_fast(branch: int, first: Floats, limits: JointLimits) -> RefusedSweep:
    """Return the refusal, with the axes that use the largest share of their speed limits."""
    use = np.abs(first) / limits.velocity
    return RefusedSweep(branch, SweepRefusal.TOO_FAST, join_axis_names(use > 0.5 * use.max()))


def _derivative_bounds(
    sigma: Floats, first: Floats, xi: float, r: Floats
) -> tuple[Floats, Floats, Floats, Floats, Bools]:
    """Return Q1 to Q4 (n,) within r of samples, and whether they hold: whether no singularity can be that near."""
    y = np.linalg.norm(first, axis=1)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        s = np.sqrt(sigma**2 - 2.0 * _H * xi * r)
        y1 = y / (1.0 - _H * y * r / s)
        holds = (s > 0.0) & (y1 > 0.0)
        s = np.maximum(s, sigma - _H * y1 * r)
        y2 = _H * y1**2 / s
        y3 = (3.0 * _H * y1 * y2 + _H2 * y1**3) / s
        b2, b3 = _H2 * y1**2 + _H * y2, _H3 * y1**3 + 3.0 * _H2 * y1 * y2 + _H * y3
        y4 = (3.0 * _H * y1 * y3 + 3.0 * b2 * y2 + b3 * y1) / s
    y1, y2, y3, y4 = (np.where(holds, y, np.inf) for y in (y1, y2, y3, y4))
    return y1, y2, y3, y4, holds


def _time_needed(line: SweepLine, speeds: Floats, curves: Floats, jolts: Floats, limits: JointLimits) -> Floats:
    """Return (n, 6) the shortest time at constant speed [s] with which each axis keeps its limits.

    `speeds`, `curves` and `jolts` (n, 6) bound the first, second and third derivative by u [rad]. With c the wanted
    time, u has at most the speed 1 / c, the acceleration g / c^2 and the jerk h / c^3.
    """
    rising, easing = line.ramp_shares
    g, h = 1.0 / rising, 1.0 / (rising * easing)
    time: Floats = np.maximum(speeds / limits.velocity, np.sqrt((curves + speeds * g) / limits.acceleration))
    jolt = jolts + 3.0 * curves * g + speeds * h
    # An axis without a jerk limit needs no time, even if its bounds are infinite.
    cubed = np.divide(jolt, limits.jerk, out=np.zeros_like(jolt), where=np.isfinite(limits.jerk))
    return np.maximum(time, np.cbrt(cubed))
