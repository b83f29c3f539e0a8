"""Kinematics of any six-axis arm from its chain of axes, by the closed form whose parameters are fitted to it.

A serial chain of six hinges is described by its axes: an axis is a line of the base frame, given at q = 0 by a unit
direction w and a point p on it. A rotation about it by q is the rigid motion exp(q [w, -w x p]); the flange is at
exp(q1 ..) .. exp(q6 ..) T_zero (R. M. Murray, Z. Li, S. S. Sastry, "A mathematical introduction to robotic
manipulation", CRC Press 1994, Section 3.2). This makes no assumption about the positions of the axes; every closed form
is compared with it.

The two families of `planner.kinematics.closed_form` are tried. An arm of a family is the family's own chain between
constant transforms, with signs and offsets of the angles:

    T_base_flange(q) = T_base_root  canonical(sign * q + offset)  T_end_flange

All of them follow from the axes' lines at q = 0. The *residual* is the largest distance between fitted arm and chain at
random angles. If it exceeds rounding errors, each branch is refined with Newton's method on the chain itself.
"""

from dataclasses import dataclass, fields, replace
from typing import Annotated

import numpy as np

from planner.errors import PlannerError
from planner.geometry.rigid import inverse_rigid, rigid_transform
from planner.kinematics.closed_form import BRANCHES, Dimensions, ParallelAxes, ParallelLengths, SphericalWrist
from planner.ports import JointLimits
from planner.values import Floats, Value

POLISH_ABOVE = 1e-9
"""Residual [m] above which branches are refined."""

_MAX_RESIDUAL = 5e-3  # m; a chain with a larger one belongs to no family
_SAMPLED_POSES = 2000
_FITTED_POSES = 200
_REGULARISATION = 1e-4
_ROUNDING = 1e-11  # m; a smaller residual is a rounding error
_CHUNK = 2048
_NEWTON_STEPS = 8
_EXACT = 1e-12  # m and rad; below this Newton's method stops


@dataclass(frozen=True, slots=True, eq=False)
class Chain(Value):
    """The six axes and the flange at q = 0, base frame.

    Attributes:
        directions: (6, 3) unit vectors; positive q turns right-handed about them.
        points: (6, 3) a point on each axis [m].
        T_zero: (4, 4) T_base_flange at q = 0 [m].
    """

    directions: Annotated[Floats, "6 3"]
    points: Annotated[Floats, "6 3"]
    T_zero: Annotated[Floats, "4 4"]

    def forward(self, q: Floats) -> Floats:
        """Return T_base_flange (N, 4, 4) [m] at q (N, 6) [rad]."""
        q = np.asarray(q, dtype=np.float64)
        if q.ndim != 2 or q.shape[1] != 6:
            raise PlannerError(f"q has shape {q.shape}; it must be (N, 6)")
        R = np.broadcast_to(self.T_zero[:3, :3], (len(q), 3, 3))
        t = np.broadcast_to(self.T_zero[:3, 3], (len(q), 3))
        for axis in range(5, -1, -1):
            turn = axis_rotations(self.directions[axis], q[:, axis])
            R = turn @ R
            t = (turn @ (t - self.points[axis])[..., None])[..., 0] + self.points[axis]
        T = np.zeros((len(q), 4, 4))
        T[:, :3, :3], T[:, :3, 3], T[:, 3, 3] = R, t, 1.0
        return T

    def jacobian(self, q: Floats, at: Floats) -> Floats:
        """Return geometric Jacobians (N, 6, 6) at q (N, 6) [rad].

        Rows 0..2 are the velocity of the points `at` (N, 3) [m], rows 3..5 the angular velocity, base frame, per axis
        speed [rad/s].
        """
        rows = np.empty((len(q), 6, 6))
        R, t = np.broadcast_to(np.eye(3), (len(q), 3, 3)), np.zeros((len(q), 3))
        for axis in range(6):
            w = R @ self.directions[axis]
            rows[:, :3, axis] = np.cross(w, at - (R @ self.points[axis] + t))
            rows[:, 3:, axis] = w
            turn = axis_rotations(self.directions[axis], q[:, axis])
            t = (R @ (self.points[axis] - turn @ self.points[axis])[..., None])[..., 0] + t
            R = R @ turn
        return rows


def axis_rotations(w: Floats, angle: Floats) -> Floats:
    """Return (N, 3, 3) rotations about the unit vector w by the angles (N,) (Rodrigues' formula)."""
    K = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
    s, c = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    rotations: Floats = np.eye(3) + s * K + (1.0 - c) * (K @ K)
    return rotations


@dataclass(frozen=True, slots=True, eq=False)
class Fit(Value):
    """A family's chain and the constants that map it to an arm.

    Attributes:
        family: "spherical wrist" or "three parallel axes".
        form: the family's chain.
        T_base_root: (4, 4) [m].
        T_end_flange: (4, 4) [m].
        signs: (6,) 1 or -1.
        offsets: (6,) [rad].
        residual: largest distance between the fitted flange and the chain's at random angles [m].
    """

    family: str
    form: SphericalWrist | ParallelAxes
    T_base_root: Annotated[Floats, "4 4"]
    T_end_flange: Annotated[Floats, "4 4"]
    signs: Annotated[Floats, "6"]
    offsets: Annotated[Floats, "6"]
    residual: float = np.inf

    def forward(self, q: Floats) -> Floats:
        """Return T_base_flange (N, 4, 4) of the fitted arm at q (N, 6)."""
        T = np.zeros((len(q), 4, 4))
        self.form.forward((q * self.signs + self.offsets).T, T)
        fitted: Floats = self.T_base_root @ T @ self.T_end_flange
        return fitted


def fit_closed_form(chain: Chain) -> Fit:
    """Return the family nearest to a chain, with its parameters; raise PlannerError if none is within 5 mm."""
    fits = [fit for fit in (_spherical_wrist(chain), _parallel_axes(chain)) if fit is not None]
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (_SAMPLED_POSES, 6))
    fits = [_with_residual(fit, chain, q) for fit in fits]
    fits = [_adjusted(fit, chain, q) if _ROUNDING < fit.residual < _MAX_RESIDUAL else fit for fit in fits]
    best = min(fits, key=lambda f: f.residual, default=None)
    if best is None or not best.residual < _MAX_RESIDUAL:
        miss = "" if best is None else f" (the nearest, {best.family}, differs by {1000 * best.residual:.1f} mm)"
        raise PlannerError(
            f"the arm belongs to neither family with a closed form, a spherical wrist on two parallel axes or three "
            f"parallel axes{miss}; check the axes' directions and origins"
        )
    return best


def _with_residual(fit: Fit, chain: Chain, q: Floats) -> Fit:
    return replace(fit, residual=float(np.abs(pose_error(fit.forward(q), chain.forward(q))).max()))


def _adjusted(fit: Fit, chain: Chain, q: Floats) -> Fit:
    """Return the fit after least squares over lengths, offsets and both transforms, or itself if that is no better.

    With rounded angles in a robot file the axes are not exactly parallel and their lines do not exactly meet; the
    parameters from single lines are then not those of the nearest arm of the family.
    """
    from scipy.optimize import least_squares  # slow to import

    targets = chain.forward(q[:_FITTED_POSES])
    names = [field.name for field in fields(fit.form.lengths)]

    def moved(x: Floats) -> Fit:
        lengths = replace(
            fit.form.lengths, **{name: getattr(fit.form.lengths, name) + d for name, d in zip(names, x, strict=False)}
        )
        root_twist, end_twist, offsets = np.split(x[len(names) :], (6, 12))
        return replace(
            fit,
            form=replace(fit.form, lengths=lengths),  # type: ignore[arg-type]  # lengths of the same family
            T_base_root=fit.T_base_root @ _small_motion(root_twist),
            T_end_flange=_small_motion(end_twist) @ fit.T_end_flange,
            offsets=fit.offsets + offsets,
        )

    start = np.zeros(len(names) + 18)

    # Some changes of lengths and transforms cancel each other: a small penalty on their size makes them unique.
    def residuals(x: Floats) -> Floats:
        return np.append(pose_error(moved(x).forward(q[:_FITTED_POSES]), targets), _REGULARISATION * x)

    best = least_squares(residuals, start, method="lm")
    adjusted = _with_residual(moved(best.x), chain, q)
    return adjusted if adjusted.residual < fit.residual else fit


def _small_motion(twist: Floats) -> Floats:
    """Return (4, 4) translation by twist[:3] and rotation by the vector twist[3:]."""
    angle = float(np.linalg.norm(twist[3:]))
    R = np.eye(3) if angle == 0.0 else axis_rotations(twist[3:] / angle, np.array([angle]))[0]
    return rigid_transform(R, twist[:3])


def _spherical_wrist(chain: Chain) -> Fit | None:
    """Return the constants of an arm with a spherical wrist; None if A1 and A2 are parallel."""
    w, p = chain.directions, chain.points
    z = _upright(w[0])
    y = _sideways(w[1], z)
    if y is None:
        return None
    wrist = nearest_point(w[3:], p[3:])
    foot = p[0] - z * (p[0] @ z)  # at the height of the base, from which d1 is measured
    x = np.cross(y, z)
    if (ahead := float((p[1] - foot) @ x)) < -1e-6 or (abs(ahead) <= 1e-6 and (wrist - foot) @ x < 0.0):
        x, y = -x, -y
    root = rigid_transform(np.stack((x, y, z), axis=1), foot)
    shoulder, elbow, centre = ((point - foot) @ np.stack((x, y, z), axis=1) for point in (p[1], p[2], wrist))
    upper, fore = elbow - shoulder, centre - elbow
    lift = float(np.arctan2(-upper[2], upper[0]))
    along = w[3] @ np.stack((x, y, z), axis=1)
    along = along if along[[0, 2]] @ fore[[0, 2]] >= 0.0 else -along  # pointing out of the forearm
    total = float(np.arctan2(-along[2], along[0]))
    cs, ss = np.cos(total), np.sin(total)
    arm = Dimensions(
        d1=float(shoulder[2]),
        a1=float(shoulder[0]),
        a2=float(np.hypot(upper[0], upper[2])),
        a3=float(ss * fore[0] + cs * fore[2]),
        d4=float(cs * fore[0] - ss * fore[2]),
        d6=float(abs((chain.T_zero[:3, 3] - wrist) @ w[5])),
        b=float(centre[1]),
    )
    R = root[:3, :3]
    forearm = R @ np.array([[cs, 0.0, ss], [0.0, 1.0, 0.0], [-ss, 0.0, cs]])  # Ry(A2 + A3)
    out = forearm[:, 0]
    hand = w[4] if w[4] @ y >= -1e-9 else -w[4]
    a4 = float(np.arctan2(-(hand @ forearm[:, 2]), hand @ forearm[:, 1]))  # Rx(-A4) y = (0, cos A4, -sin A4)
    c4, s4 = np.cos(a4), np.sin(a4)
    turned = forearm @ np.array([[1.0, 0.0, 0.0], [0.0, c4, s4], [0.0, -s4, c4]])  # Rx(-A4)
    face = w[5] if (chain.T_zero[:3, 3] - wrist) @ w[5] >= 0.0 else -w[5]
    a5 = float(np.arctan2(-(face @ turned[:, 2]), face @ turned[:, 0]))
    signs = np.array([-(w[0] @ z), w[1] @ y, w[2] @ y, -(w[3] @ out), w[4] @ hand, -(w[5] @ face)])
    offsets = np.array([0.0, lift, total - lift, a4, a5, 0.0])
    return _closed("spherical wrist", SphericalWrist(arm), root, signs, offsets, chain)


def _parallel_axes(chain: Chain) -> Fit | None:
    """Return the constants of an arm with three parallel axes; None if A1 and A2 are parallel."""
    w, p = chain.directions, chain.points
    z = _upright(w[0])
    y = _sideways(w[1], z)
    if y is None:
        return None
    foot = p[0] - z * (p[0] @ z)
    x = np.cross(y, z)
    R = np.stack((x, y, z), axis=1)
    meeting = nearest_point(w[4:], p[4:])
    second, third, fourth, last = ((point - foot) @ R for point in (p[1], p[2], p[3], meeting))
    # From axis 4 to the intersection of axes 5 and 6: d5 along axis 5.
    fifth = w[4] @ R
    to_last = last - fourth
    fifth = fifth if fifth[[0, 2]] @ to_last[[0, 2]] >= 0.0 else -fifth
    phi = float(np.arctan2(fifth[0], fifth[2]))
    one, two = third - second, fourth - third
    t2 = float(np.arctan2(-one[2], one[0]))
    t23 = float(np.arctan2(-two[2], two[0]))
    lengths = ParallelLengths(
        d1=float(second[2]),
        a1=float(second[0]),
        b=float(last[1]),
        a2=float(np.hypot(one[0], one[2])),
        a3=float(np.hypot(two[0], two[2])),
        d5=float(np.hypot(to_last[0], to_last[2])),
    )
    cp, sp = np.cos(phi), np.sin(phi)
    turned = R @ np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])  # Ry(phi)
    sixth = w[5] if w[5] @ y >= -1e-9 else -w[5]
    t5 = float(np.arctan2(-(sixth @ turned[:, 0]), sixth @ turned[:, 1]))  # Rz(t5) y = (-sin, cos, 0)
    signs = np.array([w[0] @ z, w[1] @ y, w[2] @ y, w[3] @ y, w[4] @ (R @ fifth), w[5] @ sixth])
    offsets = np.array([0.0, t2, t23 - t2, phi - t23, t5, 0.0])
    return _closed("three parallel axes", ParallelAxes(lengths), rigid_transform(R, foot), signs, offsets, chain)


def _closed(
    family: str, form: SphericalWrist | ParallelAxes, root: Floats, signs: Floats, offsets: Floats, chain: Chain
) -> Fit:
    """Return the fit whose flange agrees with the chain's at q = 0."""
    signs = np.where(signs >= 0.0, 1.0, -1.0)
    T = np.zeros((1, 4, 4))
    form.forward(offsets[:, None], T)
    return Fit(family, form, root, inverse_rigid(root @ T[0]) @ chain.T_zero, signs, offsets)


def _upright(w: Floats) -> Floats:
    """Return the upward direction of the first axis, or its own if it is level."""
    return -w if w[2] < -1e-6 else w


def _sideways(w: Floats, z: Floats) -> Floats | None:
    """Return the unit vector perpendicular to z nearest to w; None if w is nearly parallel to z."""
    across = w - z * (w @ z)
    length = float(np.linalg.norm(across))
    return None if length < 0.5 else across / length


def nearest_point(directions: Floats, points: Floats) -> Floats:
    """Return the point (3,) nearest to the given lines by least squares."""
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    nearest: Floats = np.linalg.lstsq(across.sum(axis=0), (across @ points[..., None]).sum(axis=0)[:, 0], rcond=None)[0]
    return nearest


def pose_error(T: Floats, target: Floats) -> Floats:
    """Return (n, 6) motions from poses T to their targets: translation [m], rotation vector [rad] to first order."""
    R = target[:, :3, :3] @ T[:, :3, :3].transpose(0, 2, 1)
    turn = 0.5 * np.stack((R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]), axis=1)
    # A rotation by half a turn has no skew part, but a small trace.
    far = np.trace(R, axis1=1, axis2=2) < 1.0
    turn[far] = np.pi / np.sqrt(3.0)
    return np.concatenate((target[:, :3, 3] - T[:, :3, 3], turn), axis=1)


class ArmKinematics:
    """`planner.ports.Kinematics` of an arm from its chain.

    Args:
        chain: the axes.
        joint_limits: of the axes; `inverse` does not apply them.

    Raises:
        PlannerError: if no closed form solves the chain.
    """

    def __init__(self, chain: Chain, joint_limits: JointLimits) -> None:
        self._chain = chain
        self._limits = joint_limits
        self.fit = fit_closed_form(chain)

    @property
    def limits(self) -> JointLimits:
        """Limits of the axes."""
        return self._limits

    def forward(self, q: Floats) -> Floats:
        """Return T_base_flange (N, 4, 4) [m] at q (N, 6) [rad], by the chain, not by the fit."""
        return self._chain.forward(q)

    def inverse(self, T_base_flange: Floats) -> Floats:
        """Return all eight branches of each pose, in the slot order of the family, not limited to the joint range.

        Args:
            T_base_flange: (N, 4, 4) [m].

        Returns:
            (N, 8, 6) joint angles [rad] in (-pi, pi]; NaN if a branch has no real solution.
        """
        T = np.asarray(T_base_flange, dtype=np.float64)
        if T.ndim != 3 or T.shape[1:] != (4, 4):
            raise PlannerError(f"T_base_flange has shape {T.shape}; it must be (N, 4, 4)")
        fit = self.fit
        to_root, to_end = inverse_rigid(fit.T_base_root), inverse_rigid(fit.T_end_flange)
        signs, offsets = np.tile(fit.signs, BRANCHES), np.tile(fit.signs * fit.offsets, BRANCHES)
        q = np.empty((len(T), BRANCHES, 6))
        for start in range(0, len(T), _CHUNK):
            chunk = slice(start, start + _CHUNK)
            fit.form.inverse(_transformed(to_root, T[chunk], to_end), q[chunk], start)
            rows = q[chunk].reshape(-1, BRANCHES * 6)  # long rows are twice as fast as rows of six numbers
            rows *= signs
            rows -= offsets
            _wrap(rows)
        if fit.residual > POLISH_ABOVE:
            self._polish(T, q)
            _wrap(q)
        return q

    def _polish(self, T: Floats, q: Floats) -> None:
        """Refine each branch in place with Newton's method on the chain; NaN if it does not converge."""
        pose, branch = np.nonzero(~np.isnan(q[..., 0]))
        for start in range(0, len(pose), _CHUNK):
            rows = pose[start : start + _CHUNK], branch[start : start + _CHUNK]
            q[rows] = self._newton(T[rows[0]], q[rows])

    def _newton(self, T: Floats, q: Floats, steps: int = _NEWTON_STEPS) -> Floats:
        """Return q (n, 6) [rad] after Newton's method towards poses T (n, 4, 4); NaN where it does not converge."""
        for _ in range(steps):
            error = pose_error(self._chain.forward(q), T)
            if np.abs(error).max(initial=0.0) < _EXACT:
                return q
            jacobian = self._chain.jacobian(q, T[:, :3, 3])
            # Slightly damped least squares: near a singularity the plain step is unbounded.
            normal = jacobian @ jacobian.transpose(0, 2, 1) + 1e-12 * np.eye(6)
            q = q + (jacobian.transpose(0, 2, 1) @ np.linalg.solve(normal, error[..., None]))[..., 0]
        off = np.abs(pose_error(self._chain.forward(q), T)).max(axis=1) > POLISH_ABOVE
        return np.where(off[:, None], np.nan, q)


def _transformed(to_root: Floats, T: Floats, to_end: Floats) -> Floats:
    """Return to_root T to_end for poses T (n, 4, 4)."""
    product: Floats = (T.reshape(-1, 4) @ to_end).reshape(-1, 4, 4)
    if np.array_equal(to_root, np.eye(4)):
        return product
    # One matrix product is ten times as fast as a batch of small ones.
    transformed: Floats = (product.transpose(0, 2, 1).reshape(-1, 4) @ to_root.T).reshape(-1, 4, 4).transpose(0, 2, 1)
    return transformed


def _wrap(q: Floats) -> None:
    """Shift angles within 3 pi in place by full turns into (-pi, pi]."""
    q += 2.0 * np.pi * ((q <= -np.pi).view(np.int8) - (q > np.pi).view(np.int8))
