"""`sim://?plant=mujoco`: the dynamic arm behind the simulated controller.

Time is cut into steps of the simulation, counted from the plant's making and not from a call: what is left of a call
is carried to the next, so the trajectory does not depend on how `advance` is cut up. At each step the servo
(`cell.plant.servo`) sees the joint angles, compares them with the reference, and sets the torques.

The encoders sit on the joints of a rigid arm, so the reported axes are where it is, at the last step.

The plant fails, and says why, when the arm is further from its reference than `FOLLOWING_ERROR` (every controller
watches that; a simulation that diverges passes it on its way), faster than `OVERSPEED`, or when its state is no number
any more. It then stands still where it is, brakes closed. A reset brings it back where its axes still are numbers. The
brakes also close when the arm has been at rest for `BRAKE_DELAY`; time that passes with closed brakes costs nothing.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from cell.plant import dynamics, servo
from cell.plant.servo import Settings
from cell.plant.tool import Tool
from cell.plant.turned import Turned
from cell.robot.model import AXES
from drivers.errors import DriverError
from drivers.profile import Reference, resting
from planner.ports import axis_name
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco
    from numpy.typing import ArrayLike

log = logging.getLogger(__name__)

FOLLOWING_ERROR = 0.01
"""Largest distance of the axes from their reference, length of their vector [rad]: 16 mm at 1.6 m."""

OVERSPEED = 20.0
"""Largest speed of the axes, length of their vector [rad/s]: at full speed of all of them it is 14.4."""

AT_REST = 5e-5
"""Largest error [m] of any point of the tool at which the arm counts as settled: the robot's repeatability."""

BRAKE_DELAY = 2.0
"""Time at rest [s] after which the holding brakes close."""

Observer = Callable[[Reference, Floats, Floats], None]
"""Takes the reference, its times after some steps (K,) [s], and the axes there (K, axes) [rad]."""

_BLOCK = 1000  # steps that are prepared at once
_ROUNDING = 1e-6  # of a step: sums of times have rounding, and what is a whole step but for that is one
_NANOSECOND = 1e-9
_TOO_FAR, _TOO_FAST = FOLLOWING_ERROR**2, OVERSPEED**2


class MujocoPlant:
    """An arm with masses, motors, friction and a servo; implements `drivers.controller.Plant`.

    Args:
        start: (axes,) axes at which the arm stands at rest [rad].
        tool: what its flange carries.
        settings: of simulation and servo.
        observer: is told of every step.
        spec: of the robot alone; None: the built-in one.
        turned: by a rotary table, the last axis; None: there is none.

    Attributes:
        model: the arm that is simulated.
        data: its state.
    """

    def __init__(
        self,
        start: ArrayLike,
        tool: Tool | None = None,
        settings: Settings | None = None,
        observer: Observer | None = None,
        spec: mujoco.MjSpec | None = None,
        turned: Turned | None = None,
    ) -> None:
        import mujoco

        at = np.array(start, dtype=np.float64)
        axes = len(AXES) + (turned is not None)
        if at.shape != (axes,) or not np.isfinite(at).all():
            raise DriverError(f"a plant was started at {at}; it must be {axes} finite joint angles in radians")
        tool, settings = tool or Tool(), settings or Settings()
        if settings.doubt:
            log.warning("%s", settings.doubt)
        self._feed_forward = servo.FeedForward(tool, settings, spec, turned)
        home = np.array(self._feed_forward.model.key("home").qpos)
        inertia = np.diag(dynamics.mass_matrix(self._feed_forward.model, home))
        self._gains = gains = servo.gains(inertia, settings.bandwidth)
        self.model = dynamics.arm(
            tool,
            spec,
            turned=turned,
            stiffness=gains.stiffness,
            damping=gains.damping,
            time_step=settings.time_step,
            integrator=settings.integrator,
        )
        self.data: mujoco.MjData = mujoco.MjData(self.model)
        self._step = mujoco.mj_step
        self._h, self._observer = settings.time_step, observer
        # The implicit integrator damps with the speed at the end of the step; the set-point has to be of that time.
        self._speed_ahead = 0 if settings.integrator == "Euler" else 1
        self._levers = dynamics.levers(self.model, tool, turned)
        self._bandwidth = 2.0 * np.pi * settings.bandwidth
        self._failure = ""
        self._braked = False
        # The grid of steps: so many since the reference was taken, `_offset` after a step, and what is left of time.
        self._steps, self._offset, self._pending = 0, 0.0, 0.0
        self._brake_steps = max(1, math.ceil(BRAKE_DELAY / self._h))
        self._brake_in = self._brake_steps  # steps until the brakes may close
        self._stand(at)

    @property
    def reported_axes(self) -> Floats:
        """(axes,) axes as the encoders see them [rad]."""
        return np.array(self.data.qpos)

    @property
    def settled(self) -> bool:
        """True where the reference has ended and no point of the tool is, or will be, off its end by `AT_REST`."""
        now = self._steps * self._h - self._offset + self._pending
        return now >= self._reference.duration - _NANOSECOND and not self._failure and self._at_rest()

    @property
    def failure(self) -> str:
        """Why the arm no longer follows; empty while it does."""
        return self._failure

    def follow(self, reference: Reference) -> None:
        """Take a new reference, whose time 0 is now.

        After a failure, a reference that stands still where the arm stands (a reset) switches the drives on again.
        """
        if self._failure:
            self._switch_on(reference)
            return
        self._braked = False
        self._begin(reference)

    def advance(self, seconds: float) -> None:
        """Let time pass."""
        if not seconds >= 0:
            raise DriverError(f"a plant was advanced by {seconds} s; time only passes forwards")
        self._pending += seconds
        steps = int(self._pending / self._h + _ROUNDING)
        self._pending = max(self._pending - steps * self._h, 0.0)
        while steps > 0 and not self._failure and not self._braked:
            block = min(steps, _BLOCK, self._brake_in)
            self._go(block)
            steps -= block
        self._steps += steps  # with closed brakes nothing moves, however long

    def _go(self, steps: int) -> None:
        """Servo and simulation, `steps` times."""
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
        done = steps
        for k in range(steps):
            error = q[k] - axes
            if not (error @ error <= _TOO_FAR and speeds @ speeds <= _TOO_FAST):  # NaN too
                done = k
                break
            integral += per_step * error
            data.ctrl[:] = steady[k] + integral
            step(model, data)
            path[k] = axes
        self._steps += done
        if self._observer is not None and done:
            self._observer(self._reference, times[1 : done + 1], path[:done])
        self._error = q[done] - axes
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
        # Whole nanoseconds, so that the rounding of a sum of times does not reach the trajectory.
        self._offset = round(self._pending / _NANOSECOND) * _NANOSECOND
        still = np.zeros((1, len(reference.end)))
        self._holding = self._feed_forward.torque(reference.end[None], still, still)[0]
        self._brake_in = math.ceil(reference.duration / self._h) + 1 + self._brake_steps
        self._error = reference.sample(np.zeros(1))[0][0] - self.data.qpos

    def _stand(self, at: Floats) -> None:
        """At rest and in balance, as after standing there for long: what the feed-forward lacks is in the integral."""
        import mujoco

        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = at
        mujoco.mj_forward(self.model, self.data)
        self._braked = False
        self._begin(resting(at))
        self._integral = np.array(self.data.qfrc_bias) - self._holding

    def _switch_on(self, reference: Reference) -> None:
        """Drives on after a failure, if the arm stands where the reference does."""
        off = reference.end - self.data.qpos
        if np.isfinite(self.data.qpos).all() and reference.duration == 0.0 and off @ off <= _TOO_FAR:
            self._failure = ""
            self._stand(np.array(self.data.qpos))
            self._begin(reference)

    def _at_rest(self) -> bool:
        # At a speed v the servo lets an axis run on by v over its bandwidth.
        motion = np.abs(self._error) + np.abs(self.data.qvel) / self._bandwidth
        return bool(self._levers @ motion <= AT_REST)

    def _fail(self) -> None:
        """Say why; the arm stands from here on."""
        error, speeds = self._error, np.array(self.data.qvel)
        self._braked = True
        self.data.qvel[:] = 0.0
        far, fast = int(np.abs(error).argmax()), int(np.abs(speeds).argmax())
        if not (np.isfinite(error).all() and np.isfinite(speeds).all()):
            self._failure = "the simulation diverged: its state is no number"
        elif speeds @ speeds > _TOO_FAST:
            speed = np.degrees(abs(speeds[fast]))
            self._failure = f"{axis_name(fast)} turns at {speed:.0f} deg/s, faster than it can; the simulation diverged"
        else:
            self._failure = (
                f"{axis_name(far)} is {np.degrees(abs(error[far])):.2f} deg off its reference: its drive cannot "
                "follow, or the simulation diverges"
            )
