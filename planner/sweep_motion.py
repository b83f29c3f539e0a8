"""A sweep driven on one joint branch, with a proof between its samples: no singularity, no jump, no limit exceeded.

The scanner frame follows a line (`planner.sweep_line`) whose twist xi is constant in its parameter u. With J the
Jacobian of the scanner frame, the joints follow q' = J^-1 xi and q'' = -J^-1 (J' q'), primes by u. J is had from
`Kinematics.forward` alone: turning one revolute axis by +-90 deg moves the frame by exactly

    (p+ - p-) / 2 = z x (p - o)        (R+ - R-) R^T / 2 = [z]x

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

The driven set-points are vertices on the line, at most `TUBE` from it between them; all measuring poses are among them.
Base frame, metres, radians, seconds.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner.edge import certify_many
from planner.errors import PlannerError
from planner.ports import CollisionChecker, Floats, JointLimits, Kinematics
from planner.readonly import readonly
from planner.s_curve import Profile, sample
from planner.setpoints import from_steps, to_steps
from planner.sweep_line import DEFAULT_SPEED, SweepLine, SweepSpeed, line_through, rotation_vectors
from planner.tour import Passage

TUBE = 5e-5
"""Largest distance [m] of the scanner frame on the joint-linear segments between vertices from the line."""

TUBE_ANGLE = 5e-4
"""Largest angle [rad] likewise."""

SLOWEST = 4.0
"""A sweep may be driven so many times slower than is wanted where the axes need it; then it is refused."""

_FIRST, _HALVINGS, _MOST = 32, 7, 3000  # intervals at first, rounds of halving, samples at most
_H, _H2, _H3 = float(np.sqrt(51.0)), float(np.sqrt(432.0)), float(np.sqrt(2592.0))
_SLACK = 1.1  # R over the largest distance at a sample; what the distance may grow in between is checked
_LEAST_SIGMA = 1e-4  # below this the arm stands in a singularity, to within what a set-point resolves
_FINEST = 64  # segments in half a cell at most


class SweepRefusal(IntEnum):
    """Why a sweep cannot be driven on a branch."""

    NO_LINE = 0
    OUT_OF_REACH = 1
    SINGULAR = 2
    JOINT_LIMIT = 3
    TOO_FAST = 4
    COLLISION = 5

    @property
    def sentence(self) -> str:
        """The reason in words, for reports."""
        return _SENTENCES[self]


_SENTENCES = {
    SweepRefusal.NO_LINE: "the poses do not follow each other at equal steps on a line",
    SweepRefusal.OUT_OF_REACH: "the line leaves the arm's reach",
    SweepRefusal.SINGULAR: "the line comes too near to a singularity to be followed on one joint branch",
    SweepRefusal.JOINT_LIMIT: "the line exceeds a joint limit",
    SweepRefusal.TOO_FAST: "even at a quarter of the speed an axis would exceed its speed, acceleration or jerk",
    SweepRefusal.COLLISION: "the line comes nearer to something than the clearance",
}


@dataclass(frozen=True, slots=True, eq=False)
class SweepPath:
    """A sweep on one branch, in one direction.

    Attributes:
        line: in the direction in which it is driven.
        branch: slot of the inverse kinematics.
        q: (m, 6) vertices [rad], multiples of 1e-4 deg; at rest at the first and the last, passed without stop between.
        u: (m,) their parameters, rising from 0 to 1.
        pose: (m,) pose of the column that is measured at the vertex, -1 for none; falling where driven backwards.
        profile: of u over time.
        sigma: smallest singular value of the Jacobian on it (linear rows over the largest lever); 0 is singular.
    """

    line: SweepLine
    branch: int
    q: Floats
    u: Floats
    pose: NDArray[np.int64]
    profile: Profile
    sigma: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "q", readonly("q", self.q, (None, 6)))
        object.__setattr__(self, "u", readonly("u", self.u, (len(self.q),)))
        object.__setattr__(self, "pose", readonly("pose", self.pose, (len(self.q),), np.int64))

    @property
    def duration(self) -> float:
        """Time from rest to rest [s]."""
        return float(self.profile.duration)

    @property
    def measured_q(self) -> Floats:
        """(K, 6) set-points of the measuring poses, in the order of the column [rad]."""
        rows = np.flatnonzero(self.pose >= 0)
        q: Floats = self.q[rows[np.argsort(self.pose[rows])]]
        return q

    def reversed(self) -> "SweepPath":
        """The same sweep driven from its end to its beginning."""
        line = SweepLine(
            self.line.at(np.ones(1))[0], -self.line.displacement, -self.line.turn, self.line.poses
        )  # the turn's axis keeps its direction
        return SweepPath(line, self.branch, self.q[::-1], 1.0 - self.u[::-1], self.pose[::-1], self.profile, self.sigma)


@dataclass(frozen=True, slots=True)
class Refused:
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


@dataclass(frozen=True, slots=True, eq=False)
class Sweeps:
    """What can be driven of a column of poses.

    Attributes:
        paths: every branch and turn that can be driven, each in both directions.
        refused: the other branches that exist, and why not.
    """

    paths: tuple[SweepPath, ...]
    refused: tuple[Refused, ...]


def sweeps_of(
    T_base_scanner: ArrayLike,
    T_flange_scanner: Floats,
    kinematics: Kinematics,
    limits: JointLimits,
    speed: SweepSpeed = DEFAULT_SPEED,
    checker: CollisionChecker | None = None,
) -> Sweeps:
    """All ways to drive a sweep.

    Args:
        T_base_scanner: (K, 4, 4) the column's poses [m], base frame.
        T_flange_scanner: (4, 4) mount [m].
        kinematics: of an arm of six revolute axes.
        limits: range, speeds, accelerations and jerks that hold.
        speed: at which the sweep is driven.
        checker: certifies the vertices' segments where it is given.
    """
    line = line_through(T_base_scanner)
    if line is None:
        return Sweeps((), (Refused(-1, SweepRefusal.NO_LINE, ""),))
    arm = _Arm(kinematics, np.asarray(T_flange_scanner, dtype=np.float64))
    paths: list[SweepPath] = []
    refused: list[Refused] = []
    branches = kinematics.inverse(arm.flange(line.at(np.array([0.0, 0.5, 1.0]))))
    for branch in np.flatnonzero(~np.isnan(branches).any(axis=2).all(axis=0)).tolist():
        found = _on_branch(line, branch, arm, limits, speed)
        if isinstance(found, Refused):
            refused.append(found)
            continue
        if checker is not None and (blocker := _collides(found[0].q, checker)) is not None:
            refused.append(Refused(branch, SweepRefusal.COLLISION, blocker))
            continue
        for path in found:
            paths += [path] if line.stands else [path, path.reversed()]
    if not paths and not refused:
        refused.append(Refused(-1, SweepRefusal.OUT_OF_REACH, ""))
    return Sweeps(tuple(paths), tuple(refused))


def timed(
    path: SweepPath, T_flange_scanner: Floats, kinematics: Kinematics, t: Floats
) -> tuple[Floats, Floats, Floats]:
    """Joint angles, speeds and accelerations of a sweep.

    The ends are the path's set-points; in between the angles follow the line, the ends' rounding (at most 5e-5 deg)
    faded from one to the other.

    Args:
        path: the sweep.
        T_flange_scanner: (4, 4) mount [m].
        kinematics: of the arm.
        t: (n,) times after its start [s], in [0, duration].

    Returns:
        (n, 6) q [rad], (n, 6) qd [rad/s], (n, 6) qdd [rad/s^2].
    """
    if path.line.stands:
        return np.repeat(path.q[:1], len(t), axis=0), np.zeros((len(t), 6)), np.zeros((len(t), 6))
    arm = _Arm(kinematics, np.asarray(T_flange_scanner, dtype=np.float64))
    u, ud, udd = sample(path.profile, t)
    grid = np.concatenate([path.u, u])
    order = np.argsort(grid, kind="stable")
    q = np.empty((len(grid), 6))
    q[order] = _follow(path.line, path.branch, arm, grid[order])
    q += 2.0 * np.pi * np.round((path.q[0] - q[0]) / (2.0 * np.pi))
    error = path.q[[0, -1]] - q[[0, len(path.u) - 1]]
    q = q[len(path.u) :]
    first, second = _derivatives(path.line, q, arm)[:2]
    fade = error[1] - error[0]
    q = q + error[0] + u[:, None] * fade
    first = first + fade
    return q, first * ud[:, None], second * ud[:, None] ** 2 + first * udd[:, None]


def times_at(path: SweepPath) -> Floats:
    """(m,) times after the start at which the vertices are passed [s]."""
    low, high = np.zeros(len(path.u)), np.full(len(path.u), path.duration)
    if path.line.stands:
        return low
    for _ in range(60):
        middle = 0.5 * (low + high)
        before = sample(path.profile, middle)[0] < path.u
        low, high = np.where(before, middle, low), np.where(before, high, middle)
    high[0], high[-1] = 0.0, path.duration
    return high


@dataclass(frozen=True, slots=True, eq=False)
class DrivenSweep:
    """A sweep with what times it: `planner.timing.TimedLine`.

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
        """(m,) times after its start at which the vertices are passed [s]."""
        return times_at(self.path)

    def at(self, t: Floats) -> tuple[Floats, Floats, Floats]:
        """(n, 6) angles, speeds and accelerations at (n,) times after its start [s]."""
        return timed(self.path, self.T_flange_scanner, self.kinematics, t)


def passages_of(paths: Sequence[SweepPath]) -> list[Passage]:
    """The sweeps of one view as passages of a tour; the reverse of each must be among them, unless it stands.

    Raises:
        PlannerError: if a sweep cannot be left for want of its reverse.
    """
    begins = {tuple(to_steps(path.q[0]).tolist()): i for i, path in enumerate(paths)}
    passages = []
    for path in paths:
        leaves = begins.get(tuple(to_steps(path.q[-1]).tolist()))
        if leaves is None:
            raise PlannerError("a sweep's reverse is missing; give both directions of every sweep")
        passages.append(Passage(path.q, path.pose, path.duration, leaves))
    return passages


class _Arm:
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
        T: Floats = self.kinematics.forward(q) @ self.mount
        return T

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


def _on_branch(
    line: SweepLine, branch: int, arm: _Arm, limits: JointLimits, speed: SweepSpeed
) -> list[SweepPath] | Refused:
    """The sweep on one branch, once for each turn that the limits allow; or why not."""
    if line.stands:
        return _standing(line, branch, arm, limits)
    proven = _prove(line, branch, arm, limits, line.cruise(speed))
    if isinstance(proven, Refused):
        return proven
    turns = _turns(proven.low, proven.high, limits)
    if isinstance(turns, str):
        return Refused(branch, SweepRefusal.JOINT_LIMIT, turns)
    vertices, u, pose = _vertices(line, branch, arm)
    profile = line.profile(proven.cruise)
    return [
        SweepPath(line, branch, np.clip(from_steps(to_steps(vertices + turn)), limits.lower, limits.upper), u, pose,
                  profile, proven.sigma)
        for turn in turns
    ]  # fmt: skip


def _standing(line: SweepLine, branch: int, arm: _Arm, limits: JointLimits) -> list[SweepPath] | Refused:
    """A sweep of no length: all poses are one, and the arm stands there."""
    q = from_steps(to_steps(_follow(line, branch, arm, np.zeros(1))[0]))
    turns = _turns(q, q, limits)
    if isinstance(turns, str):
        return Refused(branch, SweepRefusal.JOINT_LIMIT, turns)
    u, pose, none = np.linspace(0.0, 1.0, line.poses), np.arange(line.poses), np.zeros(())
    return [
        SweepPath(line, branch, np.tile(from_steps(to_steps(q + turn)), (line.poses, 1)), u, pose,
                  Profile(none, none, none), float("nan"))
        for turn in turns
    ]  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Proof:
    """What is proven of a line on a branch: bounds of the joint angles (6,), time at constant speed, least sigma."""

    low: Floats
    high: Floats
    cruise: float
    sigma: float


def _prove(line: SweepLine, branch: int, arm: _Arm, limits: JointLimits, cruise: float) -> _Proof | Refused:
    """Follow a branch and prove what lies between the samples; see the module's docstring for the argument.

    Where the limits do not allow the speed that is wanted, the line is driven slower, up to `SLOWEST` times.
    """
    u = np.linspace(0.0, 1.0, _FIRST + 1)
    for halving in range(_HALVINGS + 1):
        q = _follow(line, branch, arm, u)
        if np.isnan(q).any():
            return Refused(branch, SweepRefusal.OUT_OF_REACH, "")
        first, second, sigma, xi, weak = _derivatives(line, q, arm)
        if sigma.min() < _LEAST_SIGMA:
            return Refused(branch, SweepRefusal.SINGULAR, _axes(np.abs(weak[int(sigma.argmin())]) > 0.4))
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
            good &= np.sqrt(6.0) * _SLACK * y1 * r <= _SLACK - 1.0  # no axis' lever outgrows R
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
            return _Proof(low, high, max(cruise, float(need.max())), float(sigma.min()))
        if last:
            break
        u = np.sort(np.concatenate([u, 0.5 * (u[:-1] + u[1:])[open_]]))
    worst = int(np.flatnonzero(open_)[0])
    if good.all():
        return _too_fast(branch, first[worst], limits)
    jump = np.abs(np.diff(q, axis=0)[worst]) > 0.1
    return Refused(branch, SweepRefusal.SINGULAR, _axes(jump if jump.any() else np.abs(weak[worst]) > 0.4))


def _too_fast(branch: int, first: Floats, limits: JointLimits) -> Refused:
    """The refusal, with the axes that do most of the motion for what they can."""
    use = np.abs(first) / limits.velocity
    return Refused(branch, SweepRefusal.TOO_FAST, _axes(use > 0.5 * use.max()))


def _bounds(
    sigma: Floats, first: Floats, xi: float, r: Floats
) -> tuple[Floats, Floats, Floats, Floats, NDArray[np.bool_]]:
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

    With c this time, u has at most the speed 1 / c, the acceleration g / c^2 and the jerk h / c^3.

    Args:
        line: gives g and h.
        speeds: (n, 6) bounds of the first derivative by u [rad].
        curves: (n, 6) of the second.
        jolts: (n, 6) of the third.
        limits: of the axes.
    """
    rising, easing = line.ramp_shares
    g, h = 1.0 / rising, 1.0 / (rising * easing)
    time: Floats = np.maximum(speeds / limits.velocity, np.sqrt((curves + speeds * g) / limits.acceleration))
    return np.maximum(time, np.cbrt((jolts + 3.0 * curves * g + speeds * h) / limits.jerk))


def _follow(line: SweepLine, branch: int, arm: _Arm, u: Floats) -> Floats:
    """(n, 6) joint angles of a branch along the line [rad], without jumps of whole turns; NaN out of reach."""
    q: Floats = np.array(arm.kinematics.inverse(arm.flange(line.at(u)))[:, branch])
    return q if np.isnan(q).any() else np.unwrap(q, axis=0)


def _derivatives(line: SweepLine, q: Floats, arm: _Arm) -> tuple[Floats, Floats, Floats, float, Floats]:
    """First and second derivative by u (n, 6), singular value (n,), |xi|, and the direction that is weakest (n, 6)."""
    linear, angular = arm.jacobian(q)
    lever = _SLACK * float(np.linalg.norm(linear, axis=1).max())
    xi = np.concatenate([line.displacement / lever, line.turn])
    left, sigma, right = np.linalg.svd(np.concatenate([linear / lever, angular], axis=1))
    safe = np.maximum(sigma, 1e-12)

    def solve(sides: Floats) -> Floats:
        inner = (np.swapaxes(left, 1, 2) @ sides[:, :, None])[:, :, 0] / safe
        found: Floats = (np.swapaxes(right, 1, 2) @ inner[:, :, None])[:, :, 0]
        return found

    first = solve(np.repeat(xi[None], len(q), axis=0))
    z, arms = np.swapaxes(angular, 1, 2), np.swapaxes(linear, 1, 2)  # (n, 6 axes, 3)
    spin = z * first[:, :, None]
    before = np.cumsum(spin, axis=1) - spin
    bend = (np.cross(2.0 * before + spin, arms) * first[:, :, None]).sum(axis=1) / lever
    twist = (np.cross(before, z) * first[:, :, None]).sum(axis=1)
    second = -solve(np.concatenate([bend, twist], axis=1))
    return first, second, sigma[:, -1], float(np.linalg.norm(xi)), right[:, -1]


def _vertices(line: SweepLine, branch: int, arm: _Arm) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Set-points whose joint-linear segments stay within the tube about the line, their u, and which pose each is."""
    fine = 1
    while fine <= _FINEST:
        u = np.linspace(0.0, 1.0, 2 * line.poses * fine + 1)
        q = _follow(line, branch, arm, u)
        rounded = from_steps(to_steps(q))
        middle = arm.scanner(0.5 * (rounded[:-1] + rounded[1:]))
        T = line.at(0.5 * (u[:-1] + u[1:]))
        off = np.linalg.norm(middle[:, :3, 3] - T[:, :3, 3], axis=1).max()
        turned = rotation_vectors(middle[:, :3, :3] @ np.swapaxes(T[:, :3, :3], 1, 2))
        if off <= TUBE and np.linalg.norm(turned, axis=1).max() <= TUBE_ANGLE:
            pose = np.full(len(u), -1)
            pose[fine :: 2 * fine] = np.arange(line.poses)
            return q, u, pose
        fine *= 2
    raise PlannerError(
        f"set-points of 1e-4 deg cannot follow a sweep within {TUBE * 1e6:g} micrometres: at the end of this arm they "
        f"are {off * 1e6:.0f} off"
    )


def _turns(low: Floats, high: Floats, limits: JointLimits) -> list[Floats] | str:
    """Whole turns (6,) [rad] that keep all of a sweep within the limits, no turn first; or the axes that forbid it."""
    choices = []
    for axis in range(6):
        counts = sorted(range(-2, 3), key=lambda k: (abs(k), k))
        fits = [
            2.0 * np.pi * k
            for k in counts
            if low[axis] + 2.0 * np.pi * k >= limits.lower[axis] and high[axis] + 2.0 * np.pi * k <= limits.upper[axis]
        ]
        choices.append(fits)
    if not all(choices):
        return _axes(np.array([not fits for fits in choices]))
    return [np.array(turn) for turn in itertools.product(*choices)]


def _collides(q: Floats, checker: CollisionChecker) -> str | None:
    """What the vertices or the segments between them come too near to; "" where only a segment does, None if free."""
    free = checker.free(q)
    if not free.all():
        return next(iter(checker.contacts(q[int(free.argmin())])), "")
    certified, _ = certify_many(q[:-1], q[1:], checker)
    return None if certified.all() else ""


def _axes(which: NDArray[np.bool_]) -> str:
    """The names of some axes: "A4 and A6"."""
    names = [f"A{axis + 1}" for axis in np.flatnonzero(which)]
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
