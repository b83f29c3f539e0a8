"""The servo of each axis: position, speed and integral feedback, and feed-forward from a model that is wrong.

With the error `e = q_ref - q` an axis gets the torque

    tau = kp e + kd de/dt + ki integral(e) + tau_model(q_ref, qd_ref, qdd_ref)

Were the model right and the axis one inertia J without friction, the error would obey `J e''' + kd e'' + kp e' + ki e
= 0`. `kd = 3 w J`, `kp = 3 w^2 J` and `ki = w^3 J` would put its three roots at one place, -w. The integral is weaker,
0.3 of that: at the end of a motion it holds the friction that the model lacks, and unwinding that swings the arm past
its goal, from 0.4 on by more than the robot repeats to. So one number, the bandwidth w / 2 pi, is the gain of all
axes. J is the inertia that the axis moves at home.

`tau_model` is the inverse dynamics (Featherstone, Rigid Body Dynamics Algorithms, 2008, chapter 5, as MuJoCo's
`mj_inverse`) of an arm whose links and tool are lighter than the true ones and whose gears rub less: the servo knows
its motors, but masses no better than a model of unknown castings, and friction no better than gears keep it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from cell.errors import UsageError
from cell.plant import dynamics
from cell.plant.dynamics import Integrator
from cell.plant.tool import Tool
from cell.plant.turned import Turned
from planner.values import Floats, Value

if TYPE_CHECKING:
    import mujoco


COARSEST_STEP = 1e-3
"""Up to this time step [s] a move's error is that of the servo; beyond, that of the step (docs/internals/plant.md)."""


@dataclass(frozen=True, slots=True)
class Settings:
    """What the simulation and the servo are set to; the chart of docs/internals/plant.md shows how far from the edge.

    Attributes:
        time_step: of simulation and servo [s].
        integrator: of the simulation.
        bandwidth: of the servo [Hz].
        mass_error: relative error of the masses that the feed-forward believes; -0.1: they are 10 % too light.
        friction_error: the same of the friction that does not depend on speed; -1: it is not compensated.
    """

    time_step: float = 1e-3
    integrator: Integrator = "implicitfast"
    bandwidth: float = 12.0
    mass_error: float = -0.1
    friction_error: float = -0.3

    def __post_init__(self) -> None:
        for name, most in (("time_step", 0.1), ("bandwidth", 500.0)):
            if not 0.0 < getattr(self, name) <= most:
                raise UsageError(
                    f"the plant's {name} is {getattr(self, name)}; it must be above 0 and at most {most:g}"
                )
        if not -1.0 < self.mass_error < np.inf:
            raise UsageError(f"the plant's mass_error is {self.mass_error}; it must be above -1 and finite")
        if not -1.0 <= self.friction_error < np.inf:
            raise UsageError(f"the plant's friction_error is {self.friction_error}; it must be at least -1 and finite")

    @property
    def doubt(self) -> str:
        """Why errors of a move are not those of an arm, in one sentence; "" where nothing speaks against it."""
        if self.time_step <= COARSEST_STEP:
            return ""
        return (
            f"the plant's time_step of {1e3 * self.time_step:g} ms is longer than {1e3 * COARSEST_STEP:g} ms: errors "
            "of a move are those of the step, not of the arm, and from ten times that on the simulation may diverge"
        )


@dataclass(frozen=True, slots=True, eq=False)
class Gains(Value):
    """Of the axes.

    Attributes:
        stiffness: (axes,) kp [Nm/rad].
        damping: (axes,) kd [Nm s/rad].
        integral: (axes,) ki [Nm/(rad s)].
    """

    stiffness: Annotated[Floats, "axes"]
    damping: Annotated[Floats, "axes"]
    integral: Annotated[Floats, "axes"]


def gains(inertia: Floats, bandwidth: float) -> Gains:
    """The same roots, in units of w, for each axis.

    Args:
        inertia: (axes,) that each axis moves [kg m^2].
        bandwidth: [Hz].
    """
    w = 2.0 * np.pi * bandwidth
    return Gains(3.0 * w**2 * inertia, 3.0 * w * inertia, 0.3 * w**3 * inertia)


class FeedForward:
    """Torques that the servo believes a motion needs.

    Args:
        tool: what the flange carries.
        settings: errors of its masses and its friction.
        spec: of the robot alone; None: the built-in one.
        turned: by a rotary table; None: there is none.

    Attributes:
        model: the arm that it believes in.
    """

    def __init__(
        self, tool: Tool, settings: Settings, spec: mujoco.MjSpec | None = None, turned: Turned | None = None
    ) -> None:
        import mujoco

        mass, friction = 1.0 + settings.mass_error, 1.0 + settings.friction_error
        self.model = dynamics.arm(tool, spec, turned=turned, mass_scale=mass, friction_scale=friction)
        self._data: mujoco.MjData = mujoco.MjData(self.model)
        self._inverse = mujoco.mj_inverse

    def torque(self, q: Floats, qd: Floats, qdd: Floats) -> Floats:
        """Inverse dynamics of a motion.

        Args:
            q: (N, axes) joint angles [rad].
            qd: (N, axes) speeds [rad/s].
            qdd: (N, axes) accelerations [rad/s^2].

        Returns:
            (N, axes) torques [Nm].
        """
        data, torques = self._data, np.empty_like(q)
        for k in range(len(q)):
            data.qpos[:], data.qvel[:], data.qacc[:] = q[k], qd[k], qdd[k]
            self._inverse(self.model, data)
            torques[k] = data.qfrc_inverse
        return torques
