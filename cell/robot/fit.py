"""The closed form that solves a six-axis arm, its parameters fitted from the chain.

Two families: a spherical wrist on an arm of two parallel axes (`cell.robot.kinematics`), and three parallel axes
(`cell.robot.parallel_axes`). An arm of a family is the family's own chain seen through four constants:

    T_base_flange(q) = T_base_root  canonical(sign * q + offset)  T_end_flange

All of them are read off the axes' lines at q = 0. How far the fitted arm is from the chain at random angles is its
*residual*.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Annotated

import numpy as np

from cell.robot.chain import Chain, turns
from cell.robot.kinematics import SphericalWrist
from cell.robot.model import Dimensions
from cell.robot.parallel_axes import Lengths, ParallelAxes
from planner.errors import PlannerError
from planner.values import Floats, Value

_LARGEST_RESIDUAL = 5e-3  # m; a chain that is farther from a family is none of it
_SEEDED_POSES = 2000
_FITTED_POSES = 200
_STAY = 1e-4
_ROUNDING = 1e-11  # m; a residual below it is the arithmetic's


@dataclass(frozen=True, slots=True, eq=False)
class Fit(Value):
    """A family's chain, and the constants through which an arm is seen as one of it.

    Attributes:
        family: "spherical wrist" or "three parallel axes".
        form: the family's chain.
        T_base_root: (4, 4) [m].
        T_end_flange: (4, 4) [m].
        signs: (6,) 1 or -1.
        offsets: (6,) [rad].
        residual: largest distance of the fitted flange from the chain's over seeded angles [m].
    """

    family: str
    form: SphericalWrist | ParallelAxes
    T_base_root: Annotated[Floats, "4 4"]
    T_end_flange: Annotated[Floats, "4 4"]
    signs: Annotated[Floats, "6"]
    offsets: Annotated[Floats, "6"]
    residual: float = np.inf

    def forward(self, q: Floats) -> Floats:
        """(N, 4, 4) T_base_flange of the fitted arm at q (N, 6)."""
        T = np.zeros((len(q), 4, 4))
        self.form.forward((q * self.signs + self.offsets).T, T)
        fitted: Floats = self.T_base_root @ T @ self.T_end_flange
        return fitted


def fit(chain: Chain) -> Fit:
    """The family whose chain is nearest to this one, with its parameters.

    Raises:
        PlannerError: if neither family is within 5 mm of it.
    """
    fits = [found for found in (_spherical_wrist(chain), _parallel_axes(chain)) if found is not None]
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (_SEEDED_POSES, 6))
    judged = [_judged(found, chain, q) for found in fits]
    judged = [
        _adjusted(found, chain, q) if _ROUNDING < found.residual < _LARGEST_RESIDUAL else found for found in judged
    ]
    best = min(judged, key=lambda f: f.residual, default=None)
    if best is None or not best.residual < _LARGEST_RESIDUAL:
        miss = "" if best is None else f" (the nearest, {best.family}, is off by {1000 * best.residual:.1f} mm)"
        raise PlannerError(
            f"the arm is of neither family that has a closed form, a spherical wrist on two parallel axes or three "
            f"parallel axes{miss}; check the axes' directions and origins"
        )
    return best


def _judged(found: Fit, chain: Chain, q: Floats) -> Fit:
    """The fit with its residual at the angles q (N, 6)."""
    return replace(found, residual=float(np.abs(pose_error(found.forward(q), chain.forward(q))).max()))


def _adjusted(found: Fit, chain: Chain, q: Floats) -> Fit:
    """The fit after least squares over lengths, offsets and both constant transforms, where that is nearer.

    The axes of a file whose angles were rounded are not quite parallel, and their lines do not quite meet; what is read
    off single lines is then not the nearest arm of the family.
    """
    from scipy.optimize import least_squares  # kept out of the start-up

    wanted = chain.forward(q[:_FITTED_POSES])
    names = [field.name for field in fields(found.form.lengths)]

    def moved(x: Floats) -> Fit:
        lengths = replace(
            found.form.lengths,
            **{name: getattr(found.form.lengths, name) + d for name, d in zip(names, x, strict=False)},
        )
        of_root, of_end, turned = np.split(x[len(names) :], (6, 12))
        return replace(
            found,
            form=replace(found.form, lengths=lengths),  # type: ignore[arg-type]  # lengths are of its own family
            T_base_root=found.T_base_root @ _small(of_root),
            T_end_flange=_small(of_end) @ found.T_end_flange,
            offsets=found.offsets + turned,
        )

    start = np.zeros(len(names) + 18)

    # Lengths and transforms share directions that change nothing: a whisper of their size keeps them where they are.
    def misses(x: Floats) -> Floats:
        return np.append(pose_error(moved(x).forward(q[:_FITTED_POSES]), wanted), _STAY * x)

    best = least_squares(misses, start, method="lm")
    adjusted = _judged(moved(best.x), chain, q)
    return adjusted if adjusted.residual < found.residual else found


def _small(twist: Floats) -> Floats:
    """(4, 4) translation by twist[:3] and rotation by the vector twist[3:]."""
    angle = float(np.linalg.norm(twist[3:]))
    R = np.eye(3) if angle == 0.0 else turns(twist[3:] / angle, np.array([angle]))[0]
    return _pose(R, twist[:3])


def _spherical_wrist(chain: Chain) -> Fit | None:
    """The constants of an arm with a spherical wrist (module docstring of `cell.robot.kinematics`)."""
    w, p = chain.directions, chain.points
    z = _upright(w[0])
    y = _sideways(w[1], z)
    if y is None:
        return None
    wrist = meeting_point(w[3:], p[3:])
    foot = p[0] - z * (p[0] @ z)  # the base's own height is kept: d1 is counted from it
    x = np.cross(y, z)
    if (ahead := float((p[1] - foot) @ x)) < -1e-6 or (abs(ahead) <= 1e-6 and (wrist - foot) @ x < 0.0):
        x, y = -x, -y
    root = _pose(np.stack((x, y, z), axis=1), foot)
    shoulder, elbow, centre = ((point - foot) @ np.stack((x, y, z), axis=1) for point in (p[1], p[2], wrist))
    upper, fore = elbow - shoulder, centre - elbow
    lift = float(np.arctan2(-upper[2], upper[0]))
    along = w[3] @ np.stack((x, y, z), axis=1)
    along = along if along[[0, 2]] @ fore[[0, 2]] >= 0.0 else -along  # out of the forearm
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
    """The constants of an arm of three parallel axes (module docstring of `cell.robot.parallel_axes`)."""
    w, p = chain.directions, chain.points
    z = _upright(w[0])
    y = _sideways(w[1], z)
    if y is None:
        return None
    foot = p[0] - z * (p[0] @ z)
    x = np.cross(y, z)
    R = np.stack((x, y, z), axis=1)
    meeting = meeting_point(w[4:], p[4:])
    second, third, fourth, last = ((point - foot) @ R for point in (p[1], p[2], p[3], meeting))
    # Axis 4 as seen from the meeting point: along axis 5 lies d5.
    fifth = w[4] @ R
    to_last = last - fourth
    fifth = fifth if fifth[[0, 2]] @ to_last[[0, 2]] >= 0.0 else -fifth
    phi = float(np.arctan2(fifth[0], fifth[2]))
    one, two = third - second, fourth - third
    t2 = float(np.arctan2(-one[2], one[0]))
    t23 = float(np.arctan2(-two[2], two[0]))
    lengths = Lengths(
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
    return _closed("three parallel axes", ParallelAxes(lengths), _pose(R, foot), signs, offsets, chain)


def _closed(
    family: str, form: SphericalWrist | ParallelAxes, root: Floats, signs: Floats, offsets: Floats, chain: Chain
) -> Fit:
    """The fit whose flange agrees with the chain's at q = 0."""
    signs = np.where(signs >= 0.0, 1.0, -1.0)
    T = np.zeros((1, 4, 4))
    form.forward(offsets[:, None], T)
    return Fit(family, form, root, inverted(root @ T[0]) @ chain.T_zero, signs, offsets)


def _upright(w: Floats) -> Floats:
    """The direction of the first axis that points up, or along it where it lies level."""
    return -w if w[2] < -1e-6 else w


def _sideways(w: Floats, z: Floats) -> Floats | None:
    """Unit vector across z that is nearest to w; None where w lies along z."""
    across = w - z * (w @ z)
    length = float(np.linalg.norm(across))
    return None if length < 0.5 else across / length


def meeting_point(directions: Floats, points: Floats) -> Floats:
    """(3,) point nearest to the given lines in the least squares' sense."""
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    nearest: Floats = np.linalg.lstsq(across.sum(axis=0), (across @ points[..., None]).sum(axis=0)[:, 0], rcond=None)[0]
    return nearest


def _pose(R: Floats, origin: Floats) -> Floats:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, origin
    return T


def inverted(T: Floats) -> Floats:
    """(4, 4) inverse of a rigid transform."""
    return _pose(T[:3, :3].T, -T[:3, :3].T @ T[:3, 3])


def pose_error(found: Floats, wanted: Floats) -> Floats:
    """(n, 6) what takes the pose found to the one wanted: translation [m], rotation vector [rad] to first order."""
    R = wanted[:, :3, :3] @ found[:, :3, :3].transpose(0, 2, 1)
    turn = 0.5 * np.stack((R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]), axis=1)
    # Half a turn off has no skew part: the trace tells it.
    far = np.trace(R, axis1=1, axis2=2) < 1.0
    turn[far] = np.pi / np.sqrt(3.0)
    return np.concatenate((wanted[:, :3, 3] - found[:, :3, 3], turn), axis=1)
