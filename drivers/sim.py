"""`sim://`: the simulated controller in this process, with an ideal arm or an injected plant.

| option | default | meaning |
|---|---|---|
| `plant` | `ideal` | the plant that moves: `ideal`, or the name of an injected plant |
| `realtime` | off | wait as long as the arm would; else time jumps between readings of the arm |
| `time_scale` | 1 | with `realtime`: simulated seconds per real second |
| `start` | 0,-90,90,0,90,0 | axes of the arm at the start [deg] |

It has everything that a wire has, numbering and refusals at both ends included, but nothing can get lost.
"""

import dataclasses
from collections.abc import Callable

import numpy as np

from drivers.client import ControllerClient, Link
from drivers.clock import Clock, RealTimeClock, SimulatedClock
from drivers.contract import Answer, Capabilities, Command, Result, RobotState
from drivers.errors import DriverUrlError
from drivers.registry import Context, DriverUrl
from drivers.setpoints import from_rad, to_rad
from drivers.simulated_controller import Controller, IdealPlant

HOME_DEG = (0.0, -90.0, 90.0, 0.0, 90.0, 0.0)
"""Axes of the arm at the start [deg]."""

POLL = 0.02
"""Longest time [s] between two readings of a moving arm, as on a wire."""


class _InProcessLink(Link):
    """A link by function calls; its controller has no other client."""

    _session = 0

    def __init__(self, controller: Controller, simulated_time: bool) -> None:
        self._controller, self._simulated_time = controller, simulated_time

    def open(self) -> Capabilities:
        return self._controller.limits.capabilities(
            "simulated controller", hardware=False, simulated_time=self._simulated_time
        )

    def close(self) -> None:
        pass

    def take(self, session: int) -> int:
        self._session = session
        return Result.OK

    def give(self) -> None:
        self._session = 0

    def send(self, sequence: int, command: Command) -> Answer:
        return self._controller.command(sequence, command)

    def state(self) -> RobotState:
        return dataclasses.replace(self._controller.state(), owner=self._session)

    def time_to_wait(self) -> float:
        return min(self._controller.time_to_wait(), POLL)


class SimDriver(ControllerClient):
    """The simulated controller as a driver. Its arm keeps its position when it is closed and connected again.

    Args:
        controller: the simulated controller.
        clock: the controller's clock.
        notify: receives a message about a long wait.

    Attributes:
        controller: for actions that no wire offers: press the emergency stop, latch a fault.
        clock: simulated or real time.
    """

    def __init__(self, controller: Controller, clock: Clock, notify: Callable[[str], None] | None = None) -> None:
        super().__init__(_InProcessLink(controller, clock.simulated), clock, controller.limits, notify=notify)
        self.controller, self.clock = controller, clock

    @classmethod
    def from_url(cls, url: DriverUrl, context: Context) -> "SimDriver":
        """Make the driver of a `sim://` URL; the table of this module lists the options.

        Raises:
            DriverUrlError: if an option does not exist or its value is invalid.
        """
        plants = {"ideal": IdealPlant, **context.plants}
        plant = url.choice("plant", "ideal", tuple(plants))
        realtime = url.flag("realtime")
        time_scale = url.number("time_scale", 0.0, above=0.0)
        limits = context.limits
        home = (*HOME_DEG, *[0.0] * (len(limits.lower) - len(HOME_DEG)))  # external axes start at 0
        start = from_rad(np.radians(url.numbers("start", home)))
        url.finish()
        if url.host or url.path not in ("", "/"):
            raise DriverUrlError(
                f"'{url.text}' names a host or a path; the simulated controller has none: sim://?option=value"
            )
        if context.clock is not None and realtime:
            raise DriverUrlError(f"'{url.text}' has realtime, but the caller injected a clock; use one of the two")
        if time_scale and not realtime:
            raise DriverUrlError(f"'{url.text}' has time_scale without realtime; add &realtime, or omit time_scale")
        if ((start < limits.lower) | (start > limits.upper)).any():
            raise DriverUrlError(f"'{url.text}' starts the arm outside the axis limits; start= takes A1 on in degrees")
        clock = context.clock or (RealTimeClock(time_scale or 1.0) if realtime else SimulatedClock())
        return cls(Controller(plants[plant](to_rad(start)), limits, clock), clock, context.notify)
