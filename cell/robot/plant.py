"""`sim://?plant=mujoco`: the dynamic arm behind the simulated controller, with a servo for each axis.

**Time** is divided into simulation steps, counted from the construction of the plant and not from a call: the rest of a
call is added to the next one, so the trajectory does not depend on the division of `advance` into calls. At each step
the servo reads the joint angles, compares them with the reference, and sets the torques. The encoders are at the joints
of a rigid arm, so the reported axes are its position at the last step.

**The plant fails**, with a reason, if the arm is further from its reference than `FOLLOWING_ERROR` (every controller
checks that; a diverging simulation passes it), faster than `OVERSPEED`, or if its state is not a number. It then stays
where it is, with closed brakes. A reset restores it if its axes are still numbers. The brakes also close after the arm
has been at rest for `BRAKE_DELAY`; time with closed brakes costs no computation.

**The servo** has position, speed and integral feedback, and feed-forward from an inexact model. With the error
`e = q_ref - q` an axis gets the torque

    tau = kp e + kd de/dt + ki integral(e) + tau_model(q_ref, qd_ref, qdd_ref)

With an exact model and an axis of one inertia J without friction, the error would obey `J e''' + kd e'' + kp e' + ki e
= 0`. `kd = 3 w J`, `kp = 3 w^2 J` and `ki = w^3 J` would place its three roots at -w. The integral is weaker, 0.3 of
that: at the end of a motion it compensates the friction that the model lacks, and its decay swings the arm past its
goal, from 0.4 on by more than the robot's repeatability. One number, the bandwidth w / 2 pi, thus sets the gains of all
axes. J is the inertia of the axis at home.

`tau_model` is the inverse dynamics (Featherstone, Rigid Body Dynamics Algorithms, 2008, chapter 5, as MuJoCo's
`mj_inverse`) of an arm whose links and tool are lighter than the true ones and whose gears have less friction: the
servo knows its motors, but its masses are those of a model of unknown castings, and gear friction varies.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from cell.errors import UsageError
from cell.robot import dynamics
from cell.robot.dynamics import Integrator, TableLoad, Tool
from cell.robot.model import AXES
from drivers.errors import DriverError
from drivers.profile import Reference, resting
from planner.ports import axis_name
from planner.values import Floats, Value

if TYPE_CHECKING:
    import mujoco
    from numpy.typing import ArrayLike

log = logging.getLogger(__name__)

FOLLOWING_ERROR = 0.01
"""Largest distance of the axes from their reference, vector norm [rad]: 16 mm at 1.6 m."""

OVERSPEED = 20.0
"""Largest speed of the axes, vector norm [rad/s]: 14.4 at full speed of all axes."""

SETTLE_TOLERANCE = 5e-5
"""Largest error [m] of a point of the tool for a settled arm: the robot's repeatability."""

BRAKE_DELAY = 2.0
"""Time at rest [s] after which the holding brakes close."""

Observer = Callable[[Reference, Floats, Floats], None]
"""Function of the reference, its times after some steps (K,) [s], and the axes then (K, axes) [rad]."""

_BLOCK = 1000  # steps that are prepared together
_ROUNDING = 1e-6  # of a step: sums of times have rounding errors, and a step short by less counts as complete
_NANOSECOND = 1e-9
_TOO_FAR, _TOO_FAST = FOLLOWING_ERROR**2, OVERSPEED**2

MAX_ACCURATE_STEP = 1e-3
"""Up to this time step [s] the servo determines a move's error; above it the step does (docs/internals/plant.md)."""


@dataclass(frozen=True, slots=True)
class PlantSettings:
    """Settings of simulation and servo; the chart of docs/internals/plant.md shows their margins.

    Attributes:
        time_step: of simulation and servo [s].
        integrator: of the simulation.
        bandwidth: of the servo [Hz].
        mass_error: relative error of the feed-forward's masses; -0.1: they are 10 % too light.
        friction_error: relative error of its friction independent of speed; -1: no compensation.
    """

    time_step: float = 1e-3
    integrator: Integrator = "implicitfast"
    bandwidth: float = 12.0
    mass_error: float = -0.1
    friction_error: float = -0.3

    def __post_init__(self) -> None:
        for name, limit in (("time_step", 0.1), ("bandwidth", 500.0)):
            if not 0.0 < getattr(self, name) <= limit:
                raise UsageError(
                    f"the plant's {name} is {getattr(self, name)}; it must be above 0 and at most {limit:g}"
                )
        if not -1.0 < self.mass_error < np.inf:
            raise UsageError(f"the plant's mass_error is {self.mass_error}; it must be above -1 and finite")
        if not -1.0 <= self.friction_error < np.inf:
            raise UsageError(f"the plant's friction_error is {self.friction_error}; it must be at least -1 and finite")

    @property
    def warning(self) -> str:
        """Reason why the errors of a move are not those of a real arm, one sentence; empty if there is none."""
        if self.time_step <= MAX_ACCURATE_STEP:
            return ""
        return (
            f"the plant's time_step of {1e3 * self.time_step:g} ms is longer than {1e3 * MAX_ACCURATE_STEP:g} ms: the "
            "step determines the errors of a move, and from ten times that on the simulation may diverge"
        )


@dataclass(frozen=True, slots=True, eq=False)
class Gains(Value):
    """Servo gains of the axes.

    Attributes:
        stiffness: (axes,) kp [Nm/rad].
        damping: (axes,) kd [Nm s/rad].
        integral: (axes,) ki [Nm/(rad s)].
    """

    stiffness: Annotated[Floats, "axes"]
    damping: Annotated[Floats, "axes"]
    integral: Annotated[Floats, "axes"]


def servo_gains(inertia: Floats, bandwidth: float) -> Gains:
    """Return gains that give each axis the same roots, for inertias (axes,) [kg m^2] and a bandwidth [Hz]."""
    w = 2.0 * np.pi * bandwidth
    return Gains(3.0 * w**2 * inertia, 3.0 * w * inertia, 0.3 * w**3 * inertia)


class FeedForward:
    """Torques for a motion by the servo's own, inexact model.

    Args:
        tool: on the flange.
        settings: errors of masses and friction.
        spec: of the robot alone; None: the built-in one.
        table: rotary table; None: none.

    Attributes:
        model: the servo's model of the arm.
    """

    def __init__(
        self, tool: Tool, settings: PlantSettings, spec: mujoco.MjSpec | None = None, table: TableLoad | None = None
    ) -> None:
        import mujoco

        mass, friction = 1.0 + settings.mass_error, 1.0 + settings.friction_error
        self.model = dynamics.compile_dynamic_arm(tool, spec, table=table, mass_scale=mass, friction_scale=friction)
        self._data: mujoco.MjData = mujoco.MjData(self.model)
        self._inverse = mujoco.mj_inverse

    def torque(self, q: Floats, qd: Floats, qdd: Floats) -> Floats:
        """Return torques (N, axes) [Nm] for angles [rad], speeds [rad/s] and accelerations [rad/s^2], all (N, axes)."""
        data, torques = self._data, np.empty_like(q)
        for k in range(len(q)):
            data.qpos[:], data.qvel[:], data.qacc[:] = q[k], qd[k], qdd[k]
            self._inverse(self.model, data)
            torques[k] = data.qfrc_inverse
        return torques


class MujocoPlant:
    """An arm with masses, motors, friction and a servo; implements `drivers.simulated_controller.Plant`.

    Args:
        start: (axes,) axes of the arm at rest at the start [rad].
        tool: on the flange.
        settings: of simulation and servo.
        observer: receives every step.
        spec: of the robot alone; None: the built-in one.
        table: rotary table, the last axis; None: none.

    Attributes:
        model: the simulated arm.
        data: its state.
    """

    def __init__(
        self,
        start: ArrayLike,
        tool: Tool | None = None,
        settings: PlantSettings | None = None,
        observer: Observer | None = None,
        spec: mujoco.MjSpec | None = None,
        table: TableLoad | None = None,
    ) -> None:
        import mujoco

        at = np.array(start, dtype=np.float64)
        axes = len(AXES) + (table is not None)
        if at.shape != (axes,) or not np.isfinite(at).all():
            raise DriverError(f"a plant was started at {at}; it must be {axes} finite joint angles in radians")
        tool, settings = tool or Tool(), settings or PlantSettings()
        if settings.warning:
            log.warning("%s", settings.warning)
        self._feed_forward = FeedForward(tool, settings, spec, table)
        home = np.array(self._feed_forward.model.key("home").qpos)
        inertia = np.diag(dynamics.mass_matrix(self._feed_forward.model, home))
        self._gains = gains = servo_gains(inertia, settings.bandwidth)
        self.model = dynamics.compile_dynamic_arm(
            tool,
            spec,
            table=table,
            stiffness=gains.stiffness,
            damping=gains.damping,
            time_step=settings.time_step,
            integrator=settings.integrator,
        )
        self.data: mujoco.MjData = mujoco.MjData(self.model)
        self._step = mujoco.mj_step
        self._h, self._observer = settings.time_step, observer
        # The implicit integrator damps with the speed at the end of the step; the set-point must be of that time.
        self._speed_ahead = 0 if settings.integrator == "Euler" else 1
        self._levers = dynamics.lever_arms(self.model, tool, table)
        self._bandwidth = 2.0 * np.pi * settings.bandwidth
        self._failure = ""
        self._braked = False
        # Time grid: number of steps since the reference began, its offset from a step, and time not yet simulated.
        self._steps, self._offset, self._pending = 0, 0.0, 0.0
        self._brake_steps = max(1, math.ceil(BRAKE_DELAY / self._h))
        self._brake_in = self._brake_steps  # steps until the brakes may close
        self._stand(at)

    @property
    def reported_axes(self) -> Floats:
        """(axes,) axes as the encoders measure them [rad]."""
        return np.array(self.data.qpos)

    @property
    def settled(self) -> bool:
        """True if the reference has ended and every point of the tool stays within `SETTLE_TOLERANCE` of its end."""
        now = self._steps * self._h - self._offset + self._pending
        return now >= self._reference.duration - _NANOSECOND and not self._failure and self._at_rest()

    @property
    def failure(self) -> str:
        """Why the arm no longer follows; empty while it does."""
        return self._failure

    def follow(self, reference: Reference) -> None:
        """Take a new reference whose time 0 is now.

        After a failure, a reference at rest at the arm's position (a reset) switches the drives on again.
        """
        if self._failure:
            self._switch_on(reference)
            return
        self._braked = False
        self._begin(reference)

    def advance(self, seconds: float) -> None:
        """Let time pass."""
        if not seconds >= 0:
            raise DriverError(f"a plant was advanced by {seconds} s; the time must be at least 0")
        self._pending += seconds
        steps = int(self._pending / self._h + _ROUNDING)
        self._pending = max(self._pending - steps * self._h, 0.0)
        while steps > 0 and not self._failure and not self._braked:
            block = min(steps, _BLOCK, self._brake_in)
            self._simulate(block)
            steps -= block
        self._steps += steps  # with closed brakes nothing moves

    def _simulate(self, steps: int) -> None:
        """Run servo and simulation for `steps` steps."""
        first, h, ahead = self._steps, self._h, self._speed_ahead
        times = np.maximum(np.arange(first, first + steps + 1, dtype=np.float64) * h - self._offset, 0.0)
        q, qd, qdd = self._reference.sample(times)
        if times[0] >= self._reference.duration:
            torque = np.broadcast_to(self._holding, q.shape)
        else:
            torque = self._feed_forward.torque(q[:-1], qd[:-1], qdd[:-1])
        gains, data, model, step, integral = self._gains, self.data, self.model, self._step, self._integral
        steady = gains.stiffness * q[:-1] + gains.damping * qd[ahead : steps + ahead] + torque[:steps]
        per_step, axes, speeds, path = gains.integral * h, data.qpos, data.qvel, np.empty((steps, q.shape[1]))
        n_done = steps
        for k in range(steps):
            error = q[k] - axes
            if not (error @ error <= _TOO_FAR and speeds @ speeds <= _TOO_FAST):  # NaN too
                n_done = k
                break
            integral += per_step * error
            data.ctrl[:] = steady[k] + integral
            step(model, data)
            path[k] = axes
        self._steps += n_done
        if self._observer is not None and n_done:
            self._observer(self._reference, times[1 : n_done + 1], path[:n_done])
        self._error = q[n_done] - axes
        if not (self._error @ self._error <= _TOO_FAR and speeds @ speeds <= _TOO_FAST):
            self._fail()
            return
        self._brake_in -= steps
        if self._brake_in == 0:
            self._braked = self._at_rest()
            self._brake_in = self._brake_steps
            if self._braked:
                data.qvel[:] = 0.0

    def _begin(self, reference: Reference) -> None:
        """Start a reference now, between two steps."""
        self._reference, self._steps = reference, 0
        # Whole nanoseconds: rounding errors of a sum of times must not affect the trajectory.
        self._offset = round(self._pending / _NANOSECOND) * _NANOSECOND
        still = np.zeros((1, len(reference.end)))
        self._holding = self._feed_forward.torque(reference.end[None], still, still)[0]
        self._brake_in = math.ceil(reference.duration / self._h) + 1 + self._brake_steps
        self._error = reference.sample(np.zeros(1))[0][0] - self.data.qpos

    def _stand(self, at: Floats) -> None:
        """Set the arm at rest in equilibrium: the integral holds the torque that the feed-forward lacks."""
        import mujoco

        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = at
        mujoco.mj_forward(self.model, self.data)
        self._braked = False
        self._begin(resting(at))
        self._integral = np.array(self.data.qfrc_bias) - self._holding

    def _switch_on(self, reference: Reference) -> None:
        """Switch the drives on after a failure if the arm is at the position of a reference at rest."""
        error = reference.end - self.data.qpos
        if np.isfinite(self.data.qpos).all() and reference.duration == 0.0 and error @ error <= _TOO_FAR:
            self._failure = ""
            self._stand(np.array(self.data.qpos))
            self._begin(reference)

    def _at_rest(self) -> bool:
        # At speed v the servo lets an axis continue by v divided by its bandwidth.
        motion = np.abs(self._error) + np.abs(self.data.qvel) / self._bandwidth
        return bool(self._levers @ motion <= SETTLE_TOLERANCE)

    def _fail(self) -> None:
        """Record the failure and stop the arm."""
        error, speeds = self._error, np.array(self.data.qvel)
        self._braked = True
        self.data.qvel[:] = 0.0
        far, fast = int(np.abs(error).argmax()), int(np.abs(speeds).argmax())
        if not (np.isfinite(error).all() and np.isfinite(speeds).all()):
            self._failure = "the simulation diverged: its state is not a number"
        elif speeds @ speeds > _TOO_FAST:
            speed = np.degrees(abs(speeds[fast]))
            self._failure = f"{axis_name(fast)} turns at {speed:.0f} deg/s, faster than it can; the simulation diverged"
        else:
            self._failure = (
                f"{axis_name(far)} is {np.degrees(abs(error[far])):.2f} deg from its reference: its drive cannot "
                "follow, or the simulation diverges"
            )
