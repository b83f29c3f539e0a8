"""A line followed on one joint branch, proven between its samples: no singularity, no jump, no limit exceeded.

The scanner frame follows a line (`planner.path.sweeps.line`) whose twist xi is constant in its parameter u. With J the
Jacobian of the scanner frame (`planner.path.sweeps.arm`), the joints follow q' = J^-1 xi and q'' = -J^-1 (J' q'),
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

import numpy as np

from planner.path.sweeps.arm import SLACK, ScannerArm, axes_named, derivatives, follow
from planner.path.sweeps.line import SweepLine
from planner.path.sweeps.path import Refused, SweepRefusal
from planner.ports import JointLimits
from planner.values import Bools, Floats

SLOWEST = 4.0
"""A sweep may be driven so many times slower than is wanted where the axes need it; then it is refused."""

_FIRST, _HALVINGS, _MOST = 32, 7, 3000  # intervals at first, rounds of halving, samples at most
_H, _H2, _H3 = float(np.sqrt(51.0)), float(np.sqrt(432.0)), float(np.sqrt(2592.0))
_LEAST_SIGMA = 1e-4  # below this the arm stands in a singularity, to within what a set-point resolves


@dataclass(frozen=True, slots=True)
class Proof:
    """What is proven of a line on a branch: bounds of the joint angles (6,), time at constant speed, least sigma."""

    low: Floats
    high: Floats
    cruise: float
    sigma: float


def prove(line: SweepLine, branch: int, arm: ScannerArm, limits: JointLimits, cruise: float) -> Proof | Refused:
    """Follow a branch and prove what lies between the samples; see the module's docstring for the argument.

    Where the limits do not allow the speed that is wanted, the line is driven slower, up to `SLOWEST` times.
    """
    u = np.linspace(0.0, 1.0, _FIRST + 1)
    for halving in range(_HALVINGS + 1):
        q = follow(line, branch, arm, u)
        if np.isnan(q).any():
            return Refused(branch, SweepRefusal.OUT_OF_REACH, "")
        first, second, sigma, xi, weak = derivatives(line, q, arm)
        if sigma.min() < _LEAST_SIGMA:
            return Refused(branch, SweepRefusal.SINGULAR, axes_named(np.abs(weak[int(sigma.argmin())]) > 0.4))
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
            return Proof(low, high, max(cruise, float(need.max())), float(sigma.min()))
        if last:
            break
        u = np.sort(np.concatenate([u, 0.5 * (u[:-1] + u[1:])[open_]]))
    worst = int(np.flatnonzero(open_)[0])
    if good.all():
        return _too_fast(branch, first[worst], limits)
    jump = np.abs(np.diff(q, axis=0)[worst]) > 0.1
    return Refused(branch, SweepRefusal.SINGULAR, axes_named(jump if jump.any() else np.abs(weak[worst]) > 0.4))


def _too_fast(branch: int, first: Floats, limits: JointLimits) -> Refused:
    """The refusal, with the axes that do most of the motion for what they can."""
    use = np.abs(first) / limits.velocity
    return Refused(branch, SweepRefusal.TOO_FAST, axes_named(use > 0.5 * use.max()))


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
