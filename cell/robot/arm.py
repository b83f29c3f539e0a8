"""Kinematics of any six-axis arm that one of the closed forms solves (`cell.robot.fit`).

Where the fitted arm is not the chain to rounding, each branch is polished with Newton's method on the chain itself.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cell.errors import SceneError
from cell.robot.chain import Chain, turns
from cell.robot.fit import fit, inverted, meeting_point, pose_error
from cell.robot.kinematics import BRANCHES, Kr16Kinematics
from cell.robot.model import AXES, FLANGE, dimensions, limits
from planner.errors import PlannerError
from planner.ports import JointLimits, Kinematics
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco

POLISHED_ABOVE = 1e-9
"""Residual [m] from which branches are polished."""

_CHUNK = 2048
_NEWTON_STEPS = 8
_EXACT = 1e-12  # m and rad; below this Newton's method stops


def kinematics_of(model: mujoco.MjModel) -> Kinematics:
    """Kinematics of a compiled model of the robot, alone or in its cell.

    Args:
        model: joints A1 to A6, a site `flange` and the axes' limits.

    Raises:
        SceneError: if a joint, a limit or the flange is missing, or no closed form solves the arm.
    """
    arm = dimensions(model)
    if arm is not None:
        return Kr16Kinematics(arm, limits(model))
    try:
        return ArmKinematics(chain_of(model), limits(model))
    except PlannerError as error:
        raise SceneError(str(error)) from error


def chain_of(model: mujoco.MjModel) -> Chain:
    """The axes of a compiled model, and its flange, at all angles zero."""
    import mujoco

    data = mujoco.MjData(model)
    data.qpos[:] = 0.0  # a cell.xml opens at home
    mujoco.mj_kinematics(model, data)
    joints = [model.joint(axis).id for axis in AXES]
    flange, T = data.site(FLANGE), np.eye(4)
    T[:3, :3], T[:3, 3] = flange.xmat.reshape(3, 3), flange.xpos
    return Chain(data.xaxis[joints].copy(), data.xanchor[joints].copy(), T)


class ArmKinematics:
    """`planner.ports.Kinematics` of an arm from its chain.

    Args:
        chain: the axes.
        joint_limits: of the axes; they are handed out, `inverse` does not apply them.

    Raises:
        PlannerError: if no closed form solves the chain.
    """

    def __init__(self, chain: Chain, joint_limits: JointLimits) -> None:
        self._chain = chain
        self._limits = joint_limits
        self.fit = fit(chain)

    @property
    def limits(self) -> JointLimits:
        """Limits of the axes."""
        return self._limits

    def forward(self, q: Floats) -> Floats:
        """(N, 4, 4) T_base_flange [m] at q (N, 6) [rad]: the chain's, whatever was fitted."""
        return self._chain.forward(q)

    def inverse(self, T_base_flange: Floats) -> Floats:
        """All eight branches of each pose, in the slot order of the family, not limited to the joint range.

        Args:
            T_base_flange: (N, 4, 4) [m].

        Returns:
            (N, 8, 6) joint angles [rad] in (-pi, pi]; NaN where a branch has no real solution.

        Raises:
            PlannerError: if the shape is wrong or a pose is not a rigid transform.
        """
        T = np.asarray(T_base_flange, dtype=np.float64)
        if T.ndim != 3 or T.shape[1:] != (4, 4):
            raise PlannerError(f"T_base_flange has shape {T.shape}; it must be (N, 4, 4)")
        fitted = self.fit
        to_root, to_end = inverted(fitted.T_base_root), inverted(fitted.T_end_flange)
        signs, offsets = np.tile(fitted.signs, BRANCHES), np.tile(fitted.signs * fitted.offsets, BRANCHES)
        q = np.empty((len(T), BRANCHES, 6))
        for start in range(0, len(T), _CHUNK):
            chunk = slice(start, start + _CHUNK)
            fitted.form.inverse(_seen(to_root, T[chunk], to_end), q[chunk], start)
            rows = q[chunk].reshape(-1, BRANCHES * 6)  # long rows: a loop of six numbers takes twice as long
            rows *= signs
            rows -= offsets
            _wrap(rows)
        if fitted.residual > POLISHED_ABOVE:
            self._polish(T, q)
            _wrap(q)
        return q

    def _polish(self, T: Floats, q: Floats) -> None:
        """Newton's method on the chain from each branch; one that does not converge becomes NaN. In place."""
        pose, branch = np.nonzero(~np.isnan(q[..., 0]))
        for start in range(0, len(pose), _CHUNK):
            of = pose[start : start + _CHUNK], branch[start : start + _CHUNK]
            q[of] = self._newton(T[of[0]], q[of])

    def _newton(self, T: Floats, q: Floats, steps: int = _NEWTON_STEPS) -> Floats:
        for _ in range(steps):
            error = pose_error(self._chain.forward(q), T)
            if np.abs(error).max(initial=0.0) < _EXACT:
                return q
            jacobian = self._chain.jacobian(q, T[:, :3, 3])
            # Least squares with a whisper of damping: beside a singularity the plain step is unbounded.
            normal = jacobian @ jacobian.transpose(0, 2, 1) + 1e-12 * np.eye(6)
            q = q + (jacobian.transpose(0, 2, 1) @ np.linalg.solve(normal, error[..., None]))[..., 0]
        off = np.abs(pose_error(self._chain.forward(q), T)).max(axis=1) > POLISHED_ABOVE
        return np.where(off[:, None], np.nan, q)


def wrist_places(model: mujoco.MjModel, T_base: Floats, step: float) -> tuple[Floats, Floats]:
    """Where the wrist gets while the first axis stands at zero: signed distance from that axis, height over the base.

    The wrist is where axes 5 and 6 meet. Axes 2 and 3 go through their range, axis 4 too where it moves the wrist.

    Args:
        model: the compiled robot, alone or in its cell.
        T_base: (4, 4) where its base stands [m].
        step: between angles [rad].

    Returns:
        Two arrays of one length [m].
    """
    chain, limits_ = chain_of(model), limits(model)
    wrist = meeting_point(chain.directions[4:], chain.points[4:])
    off = np.cross(wrist - chain.points[3], chain.directions[3])
    turned = [1, 2] if float(np.linalg.norm(off)) < 1e-6 else [1, 2, 3]
    span = np.minimum(limits_.upper - limits_.lower, 2 * np.pi)[turned]
    step = step if len(turned) == 2 else 4 * step
    low = limits_.lower[turned]
    grid = np.meshgrid(*(np.linspace(a, a + s, int(s / step) + 1) for a, s in zip(low, span, strict=True)))
    places = np.broadcast_to(wrist, (grid[0].size, 3))
    for axis, angles in reversed(list(zip(turned, grid, strict=True))):
        away = places - chain.points[axis]
        places = (turns(chain.directions[axis], angles.ravel()) @ away[..., None])[..., 0] + chain.points[axis]
    up = chain.directions[0] if chain.directions[0] @ T_base[:3, 2] > 0 else -chain.directions[0]
    ahead = np.cross(chain.directions[1], up)
    away = places - chain.points[0]
    return away @ ahead / np.linalg.norm(ahead), (places - T_base[:3, 3]) @ T_base[:3, 2]


def wrist_of_flange(model: mujoco.MjModel) -> Floats:
    """(3,) where axes 5 and 6 meet, in the flange's frame [m]; no joint moves it there."""
    chain = chain_of(model)
    wrist: Floats = (inverted(chain.T_zero) @ np.append(meeting_point(chain.directions[4:], chain.points[4:]), 1.0))[:3]
    return wrist


def _seen(to_root: Floats, T: Floats, to_end: Floats) -> Floats:
    """(n, 4, 4) to_root T to_end."""
    seen: Floats = (T.reshape(-1, 4) @ to_end).reshape(-1, 4, 4)
    if np.array_equal(to_root, np.eye(4)):
        return seen
    # As one product: a batch of small ones takes ten times as long.
    turned: Floats = (seen.transpose(0, 2, 1).reshape(-1, 4) @ to_root.T).reshape(-1, 4, 4).transpose(0, 2, 1)
    return turned


def _wrap(q: Floats) -> None:
    """A turn less or more, into (-pi, pi]; q lies within 3 pi. In place."""
    q += 2.0 * np.pi * ((q <= -np.pi).view(np.int8) - (q > np.pi).view(np.int8))
