"""`sim://`: the simulated controller in this process, with an ideal arm, or with the plant that the opener injects.

| option | default | meaning |
|---|---|---|
| `plant` | `ideal` | which plant moves: `ideal`, or a name that the opener injected |
| `realtime` | off | wait as long as the arm would; else time jumps to the end of each move |
| `time_scale` | 1 | with `realtime`: simulated seconds per real second |
| `start` | 0,-90,90,0,90,0 | axes at which the arm stands first [deg] |

It has everything that a wire has, numbering and refusals on both sides included, except that nothing can get lost.
"""

import dataclasses
import math
from collections.abc import Callable

import numpy as np

from drivers.client import ControllerClient
from drivers.clock import Clock, RealTimeClock, SimulatedClock
from drivers.commands import Answer, Command, Result
from drivers.contract import Capabilities, RobotState
from drivers.controller import Controller
from drivers.errors import DriverUrlError
from drivers.plant import IdealPlant
from drivers.registry import Context
from drivers.setpoints import from_rad, to_rad
from drivers.url import DriverUrl

HOME_DEG = (0.0, -90.0, 90.0, 0.0, 90.0, 0.0)
"""Where the arm stands first [deg]."""


class _InProcess:
    """The link that is a function call: nobody else can own its controller."""

    deadline = math.inf
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
        return self._controller.time_to_wait()


class SimDriver(ControllerClient):
    """The simulated controller as a driver. It stands where it was when it is closed and connected again.

    Args:
        controller: what it talks to.
        clock: the controller's clock.
        say: told what is waited for where nothing happens.

    Attributes:
        controller: for what a wire does not offer: pressing the emergency stop, latching faults.
        clock: simulated or real time.
    """

    def __init__(self, controller: Controller, clock: Clock, say: Callable[[str], None] | None = None) -> None:
        super().__init__(_InProcess(controller, clock.simulated), clock, controller.limits, say=say)
        self.controller, self.clock = controller, clock

    @classmethod
    def from_url(cls, url: DriverUrl, context: Context) -> "SimDriver":
        """Make the driver that a `sim://` URL describes.

        Args:
            url: see the table of the module.
            context: clock, limits and further plants.

        Raises:
            DriverUrlError: if an option does not exist or its value cannot be.
        """
        plants = {"ideal": IdealPlant, **context.plants}
        plant = url.word("plant", "ideal", tuple(plants))
        realtime = url.flag("realtime")
        time_scale = url.number("time_scale", 0.0, above=0.0)
        limits = context.limits
        home = (*HOME_DEG, *[0.0] * (len(limits.lower) - len(HOME_DEG)))  # external axes stand at 0
        start = from_rad(np.radians(url.numbers("start", home)))
        url.finish()
        if url.host or url.path not in ("", "/"):
            raise DriverUrlError(
                f"'{url.text}' names a host or a path; the simulated controller has none: sim://?option=value"
            )
        if context.clock is not None and realtime:
            raise DriverUrlError(f"'{url.text}' asks for real time, but the opener gave a clock of its own; choose one")
        if time_scale and not realtime:
            raise DriverUrlError(
                f"'{url.text}' has time_scale without realtime; add &realtime, or leave time_scale away"
            )
        if ((start < limits.lower) | (start > limits.upper)).any():
            raise DriverUrlError(f"'{url.text}' starts the arm outside the axis limits; start= takes A1 on in degrees")
        clock = context.clock or (RealTimeClock(time_scale or 1.0) if realtime else SimulatedClock())
        return cls(Controller(plants[plant](to_rad(start)), limits, clock), clock, context.say)
