"""The line of a sweep: through the poses of a column, at equal steps, and half a step beyond its first and last pose.

A line sensor's column holds a pose in the middle of each of K equal cells (`viewpoints.swept`). Driven, the
sheet has to pass over the whole of every cell, so the line runs from the edge of the first cell to the edge of the last
one: the poses stand at u = (k + 0.5) / K of it, u from 0 to 1. On the line

    p(u) = p(0) + u displacement          R(u) = exp(u turn) R(0)

the position advances straight and the orientation turns about an axis that keeps its direction, both in proportion:
what a controller's linear motion does. The twist (displacement, turn) of the scanner frame is constant in u.

Base frame, metres, radians.

The arm along a line: Jacobian of the scanner frame, joint angles of a branch, their derivatives by the parameter.

J is had from `Kinematics.forward` alone: turning one revolute axis by +-90 deg moves the frame by exactly

    (p+ - p-) / 2 = z x (p - o)        (R+ - R-) R^T / 2 = [z]x

Base frame, metres, radians.

A line followed on one joint branch, proven between its samples: no singularity, no jump, no limit exceeded.

The scanner frame follows a line (`planner.path.sweep_line`) whose twist xi is constant in its parameter u. With J the
Jacobian of the scanner frame (`planner.path.sweep_line`), the joints follow q' = J^-1 xi and q'' = -J^-1 (J' q'),
primes by u.

*Between two samples.* Linear rows of J and xi are divided by R, which no axis' distance from the frame exceeds; each
column's derivative by an axis then has a norm of at most sqrt(2), |J'| <= H |q'| with H = sqrt(51) (36 linear and 15
angular terms) and |J''| <= H2 |q'|^2 + H |q''| with H2 = sqrt(432). With sigma the smallest singular value of J and
y = |q'| this gives, at a distance r from a sample,

    sigma >= s = sqrt(sigma_k^2 - 2 H |xi| r)     and, tighter, s = sigma_k - H Q1 r
    |q'|   <= Q1 = y_k / (1 - H y_k r / s)
    |q''|  <= Q2 = H Q1^2 / s
    |q'''| <= Q3 = (3 H Q1 Q2 + H2 Q1^3) / s
    |q''''| <= Q4 = (3 H Q1 Q3 + 3 B2 Q2 + B3 Q1) / s     B2 = H2 Q1^2 + H Q2 >= |J''|
                                                          B3 = H3 Q1^3 + 3 H2 Q1 Q2 + H Q3 >= |J'''|, H3 = sqrt(2592)

so |q'_j| <= |q'_j,k| + r Q2 and |q''_j| <= |q''_j,k| + r Q3; the third derivative differs by no more than 2 r Q4 from
its mean between two samples, which is a difference of q''. From these follows the time that the axes' limits on speed,
acceleration and jerk need, and the line is driven no faster. Where s > 0 the branch goes on continuously and without a
singularity. The sample that follows lies on it, and on no other branch, where its distance from the one before is at
most rho = 2 r Q1 and H rho <= sigma_k / 2: J then changes by less than half of what it would need to lose a direction,
and no pose is taken twice within rho. Intervals that are not proven are halved, a number of times.

Base frame, metres, radians, seconds.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from planner.ports import JointLimits, Kinematics
from planner.timing.s_curve import Profile
from planner.values import Bools, Floats, Value, readonly
from planner.worded import Worded

_EASE = 0.1  # time in which a ramp's acceleration is reached at the fastest [s]
_SAME = 1e-7
"""Steps that differ by less [m, rad] are equal: set-points are coarser than that."""


@dataclass(frozen=True, slots=True)
class SweepSpeed:
    """How fast a sweep is driven at most; the slower of straight and turning motion holds.

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
        """Fractions of the speeds and of the accelerations: an override slows lines down like every other move."""
        return SweepSpeed(
            self.linear * speed,
            self.angular * speed,
            self.linear_acceleration * acceleration,
            self.angular_acceleration * acceleration,
        )

    def slowed(self, limits: JointLimits, full: JointLimits) -> "SweepSpeed":
        """As much slower as limits of the axes are than those at full speed."""
        return self.scaled(_fraction(limits.velocity, full.velocity), _fraction(limits.acceleration, full.acceleration))


def _fraction(limit: Floats, full: Floats) -> float:
    """The fraction to which limits were scaled; those that are not finite say nothing."""
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
        poses: K measuring poses on it.
    """

    T_base_begin: Annotated[Floats, "4 4"]
    displacement: Annotated[Floats, "3"]
    turn: Annotated[Floats, "3"]
    poses: int

    @property
    def length(self) -> float:
        """Path of the origin [m]."""
        return float(np.linalg.norm(self.displacement))

    @property
    def angle(self) -> float:
        """Turn of the orientation [rad]."""
        return float(np.linalg.norm(self.turn))

    @property
    def is_stationary(self) -> bool:
        """Whether the sweep has no length at all: every pose is the same."""
        return self.length <= _SAME and self.angle <= _SAME

    def at(self, u: Floats) -> Floats:
        """(n, 4, 4) scanner poses [m] at (n,) parameters."""
        T = np.tile(self.T_base_begin, (len(u), 1, 1))
        T[:, :3, :3] = rotations(u[:, None] * self.turn) @ self.T_base_begin[:3, :3]
        T[:, :3, 3] += u[:, None] * self.displacement
        return T

    def cruise(self, speed: SweepSpeed) -> float:
        """Time for the line at constant speed [s], ramps not counted: the shortest that `speed` allows."""
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

        The ramps take the half cells before the first and behind the last pose, all of them, so that every pose is
        passed at constant speed: a ramp covers half of what the constant speed would in its time.
        """
        return 0.8 / self.poses, 0.2 / self.poses

    def profile(self, cruise: float) -> Profile:
        """The profile of u that takes `cruise` seconds at constant speed, and its ramps besides."""
        rising, easing = self.ramp_shares
        return Profile(np.array(cruise), np.array(cruise * rising), np.array(cruise * easing))


def line_through(T_base_scanner: ArrayLike) -> SweepLine | None:
    """The line of a column of poses.

    Args:
        T_base_scanner: (K, 4, 4) poses [m], K at least 2.

    Returns:
        The line; None where the poses do not follow each other at equal steps on one.
    """
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
    begin[:3, :3] = rotations(-0.5 * turn[None])[0] @ begin[:3, :3]
    return SweepLine(begin, step * count, turn * count, count)


def rotations(vectors: Floats) -> Floats:
    """(n, 3, 3) rotations of (n, 3) rotation vectors [rad] (Rodrigues)."""
    angle = np.linalg.norm(vectors, axis=1)
    safe = np.where(angle > 0.0, angle, 1.0)
    x, y, z = (vectors / safe[:, None]).T
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    R: Floats = np.eye(3) + np.sin(angle)[:, None, None] * cross + (1.0 - np.cos(angle))[:, None, None] * cross @ cross
    return R


def rotation_vectors(R: Floats) -> Floats:
    """(n, 3) rotation vectors [rad] of (n, 3, 3) rotations by less than pi."""
    sine = 0.5 * np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1)
    length = np.linalg.norm(sine, axis=1)
    angle = np.arctan2(length, 0.5 * (np.trace(R, axis1=1, axis2=2) - 1.0))
    factor = np.where(length > 0.0, angle / np.where(length > 0.0, length, 1.0), 1.0)
    return np.asarray(sine * factor[:, None])


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


def follow_branch(line: SweepLine, branch: int, arm: ScannerArm, u: Floats) -> Floats:
    """(n, 6) joint angles of a branch along the line [rad], without jumps of whole turns; NaN out of reach."""
    q: Floats = np.array(arm.kinematics.inverse(arm.flange(line.at(u)))[:, branch])
    return q if np.isnan(q).any() else np.unwrap(q, axis=0)


def joint_derivatives(line: SweepLine, q: Floats, arm: ScannerArm) -> tuple[Floats, Floats, Floats, float, Floats]:
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


def join_axis_names(which: Bools) -> str:
    """The names of some axes: "A4 and A6"."""
    names = [f"A{axis + 1}" for axis in np.flatnonzero(which)]
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


SLOWEST = 4.0
"""A sweep may be driven so many times slower than is wanted where the axes need it; then it is refused."""

_FIRST, _HALVINGS, _MOST = 32, 7, 3000  # intervals at first, rounds of halving, samples at most
_H, _H2, _H3 = float(np.sqrt(51.0)), float(np.sqrt(432.0)), float(np.sqrt(2592.0))
_LEAST_SIGMA = 1e-4  # below this the arm stands in a singularity, to within what a set-point resolves


class SweepRefusal(Worded):
    """Why a sweep cannot be driven on a branch."""

    NO_LINE = 0, "the poses do not follow each other at equal steps on a line"
    OUT_OF_REACH = 1, "the line leaves the arm's reach"
    SINGULAR = 2, "the line comes too near to a singularity to be followed on one joint branch"
    JOINT_LIMIT = 3, "the line exceeds a joint limit"
    TOO_FAST = 4, "even at a quarter of the speed an axis would exceed its speed, acceleration or jerk"
    COLLISION = 5, "the line comes nearer to something than the clearance"


@dataclass(frozen=True, slots=True)
class RefusedSweep:
    """A branch on which the sweep cannot be driven.

    Attributes:
        branch: slot of the inverse kinematics; -1 where the whole sweep is meant.
        reason: why.
        detail: the axes of a singularity or a limit ("A4 and A6"), or what the line collides with; "" for none.
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
    """What is proven of a line on a branch: bounds of the joint angles (6,), time at constant speed, least sigma."""

    low: Floats
    high: Floats
    cruise: float
    sigma: float


def prove_branch(
    line: SweepLine, branch: int, arm: ScannerArm, limits: JointLimits, cruise: float
) -> SweepProof | RefusedSweep:
    """Follow a branch and prove what lies between the samples; see the module's docstring for the argument.

    Where the limits do not allow the speed that is wanted, the line is driven slower, up to `SLOWEST` times.
    """
    u = np.linspace(0.0, 1.0, _FIRST + 1)
    for halving in range(_HALVINGS + 1):
        q = follow_branch(line, branch, arm, u)
        if np.isnan(q).any():
            return RefusedSweep(branch, SweepRefusal.OUT_OF_REACH, "")
        first, second, sigma, xi, weak = joint_derivatives(line, q, arm)
        if sigma.min() < _LEAST_SIGMA:
            return RefusedSweep(branch, SweepRefusal.SINGULAR, join_axis_names(np.abs(weak[int(sigma.argmin())]) > 0.4))
        r = 0.5 * np.diff(u)
        mean = np.abs(np.diff(second, axis=0)) / (2.0 * r)[:, None]  # of the third derivative, between the samples
        at_samples = _time_needed(line, np.abs(first[1:]), np.abs(second[1:]), mean, limits)
        if at_samples.max() > SLOWEST * cruise:
            return _too_fast(branch, first[int(at_samples.max(axis=1).argmax())], limits)
        good, need, reach = np.ones(len(r), dtype=bool), np.zeros(len(r)), np.zeros((len(r), 6))
        steps = np.linalg.norm(np.diff(q, axis=0), axis=1)
        ends = slice(None, -1), slice(1, None)
        bounds = [_bounds(sigma[end], first[end], xi, r) for end in ends]
        y4 = np.maximum(bounds[0][3], bounds[1][3])  # of the whole interval, as the mean is
        for end, (y1, y2, y3, _, followed) in zip(ends, bounds, strict=True):
            rho = 2.0 * r * y1
            good &= followed & (steps <= rho + 1e-12) & (_H * rho <= 0.5 * sigma[end])
            good &= np.sqrt(6.0) * SLACK * y1 * r <= SLACK - 1.0  # no axis' lever outgrows R
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
    return RefusedSweep(
        branch, SweepRefusal.SINGULAR, join_axis_names(jump if jump.any() else np.abs(weak[worst]) > 0.4)
    )


def _too_fast(branch: int, first: Floats, limits: JointLimits) -> RefusedSweep:
    """The refusal, with the axes that do most of the motion for what they can."""
    use = np.abs(first) / limits.velocity
    return RefusedSweep(branch, SweepRefusal.TOO_FAST, join_axis_names(use > 0.5 * use.max()))


def _bounds(sigma: Floats, first: Floats, xi: float, r: Floats) -> tuple[Floats, Floats, Floats, Floats, Bools]:
    """Q1 to Q4 (n,) within r of samples, and whether they hold: whether no singularity can lie so near."""
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
    """(n, 6) shortest time at constant speed [s] under which each axis keeps its limits, from bounds of derivatives.

    `speeds`, `curves` and `jolts` (n, 6) bound the first, second and third derivative by u [rad]. With c the time
    wanted, u has at most the speed 1 / c, the acceleration g / c^2 and the jerk h / c^3.
    """
    rising, easing = line.ramp_shares
    g, h = 1.0 / rising, 1.0 / (rising * easing)
    time: Floats = np.maximum(speeds / limits.velocity, np.sqrt((curves + speeds * g) / limits.acceleration))
    jolt = jolts + 3.0 * curves * g + speeds * h
    # An axis without a jerk limit asks for no time, where the bounds are infinite too.
    cubed = np.divide(jolt, limits.jerk, out=np.zeros_like(jolt), where=np.isfinite(limits.jerk))
    return np.maximum(time, np.cbrt(cubed))
