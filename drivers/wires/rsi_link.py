"""`rsi://`: a KUKA controller with the option RobotSensorInterface, driven by corrections of its axes.

The host of the URL is this computer's address in the network of the controller: `rsi://192.168.0.20:49152`. The
controller sends a telegram every 4 or 12 ms and expects its answer within the same cycle, so the answers come from a
process of their own (`drivers.wires.rsi_stream`). The client of this module only commands it.
"""

import secrets
import subprocess
import sys
import time
from dataclasses import replace
from multiprocessing import AuthenticationError
from multiprocessing.connection import Connection, Listener
from typing import Any, Final

from drivers.client import ControllerClient, Link
from drivers.clock import Clock, RealTimeClock
from drivers.contract import Answer, Capabilities, Command, Move, RobotState
from drivers.errors import DriverUrlError, LinkError, LinkLostError
from drivers.limits import Limits
from drivers.registry import Context, DriverUrl
from drivers.setpoints import AXES
from drivers.wire import Timeouts
from drivers.wires import rsi

FIRST_TELEGRAM: Final = 30.0
"""Default time [s] to wait for the controller's first telegram."""

_START = 10.0  # longest time for the process to start [s]
_LOOK = 0.1  # time between two looks at a process that starts [s]
_END = 5.0  # longest time for it to end [s]
_NOT_REPORTED = "its axis limits, nor who else can stop its program; late answers make the arm pause on its path"


class RsiLink(Link):
    """The link to one controller.

    Args:
        host: address of this computer.
        port: of this computer.
        clock: the client's.
        timeouts: waiting times.
        limits: limits of the arm, by which its path is timed.
        patience: longest time until the first telegram [s].
    """

    def __init__(self, host: str, port: int, clock: Clock, timeouts: Timeouts, limits: Limits, patience: float) -> None:
        self._address, self._clock, self._timeouts = (host, port), clock, timeouts
        self._limits, self._patience = limits, patience
        self._process: subprocess.Popen[bytes] | None = None
        self._stream: Connection | None = None
        self._late = self._number = 0
        self._is_busy = False

    def open(self) -> Capabilities:
        """Start the process and wait for the first telegram.

        Raises:
            LinkLostError: if the port is in use, or no telegram arrives.
            LinkError: if the arm is outside its limits.
        """
        self.close()
        try:
            self._start_process()
            began = self._clock.now()
            while True:
                is_ready, refusal = self._ask("is ready")
                if refusal:
                    raise LinkError(refusal)
                if is_ready:
                    break
                if self._clock.now() - began > self._patience:
                    raise LinkLostError(
                        f"no telegram has arrived at {self._name} for {self._patience:g} s; start the program "
                        f"{rsi.NAME} at the controller, and check address, network and firewall"
                    )
                self._clock.wait(0.01)
        except BaseException:
            self.close()
            raise
        able = self._limits.capabilities("KUKA controller (RSI)", hardware=True, simulated_time=False)
        return replace(able, not_reported=_NOT_REPORTED)

    def close(self) -> None:
        """End the connection: the process brakes the arm, ends RSI, and ends."""
        stream, self._stream = self._stream, None
        process, self._process = self._process, None
        if stream is not None:
            stream.close()
        if process is not None:
            try:
                process.wait(_END)
            except subprocess.TimeoutExpired:  # without answers the controller ends RSI with its own error
                process.kill()
                process.wait()

    def take(self, session: int) -> int:
        """Take the arm: the port of the telegrams has one user."""
        return int(self._ask("session", session))

    def give(self) -> None:
        """Give the arm back."""
        self._ask("session", 0)

    def send(self, sequence: int, command: Command) -> Answer:
        """Send a command."""
        answer: Answer = self._ask("command", sequence, command)
        if isinstance(command, Move):
            self._late = self.late_telegrams()[0]
        return answer

    def state(self) -> RobotState:
        """Read the state."""
        state: RobotState = self._ask("state")
        if self._is_busy and not state.is_busy and self.notify:
            late = self.late_telegrams()[0] - self._late
            if late:
                self.notify(f"{late} telegrams of the controller were late; the arm paused on its path")
        self._is_busy = state.is_busy
        return state

    def late_telegrams(self) -> tuple[int, int]:
        """Return the number of telegrams that were not answered in time, and the controller's own count."""
        late, counted = self._ask("late")
        return int(late), int(counted)

    def time_to_wait(self) -> float:
        """Return the polling period."""
        return self._timeouts.poll if self._is_busy else 0.0

    @property
    def _name(self) -> str:
        return f"{self._address[0]}:{self._address[1]}"

    def _start_process(self) -> None:
        key = secrets.token_bytes(16)
        with Listener(("127.0.0.1", 0), authkey=key) as listener:
            listener._listener._socket.settimeout(_LOOK)  # type: ignore[attr-defined]  # accept() has no time-out
            where = f"127.0.0.1:{listener.address[1]}"
            # The module path of this process: a folder of the user may have a package of the same name.
            path = [folder for folder in sys.path if isinstance(folder, str)]
            code = f"import sys; sys.path[:] = {path!r}; from drivers.wires.rsi_stream import main; main()"
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-c", code, where],
                stdin=subprocess.PIPE,
                start_new_session=True,  # Ctrl-C reaches the client, which stops the arm
            )
            assert self._process.stdin is not None
            try:
                with self._process.stdin as key_input:
                    key_input.write(key.hex().encode() + b"\n")
                self._stream = self._accept(listener, self._process)
                self._stream.send((*self._address, self._limits, self._timeouts.watchdog))
                if not self._stream.poll(_START):
                    raise TimeoutError
                failure = self._stream.recv()
            except (EOFError, OSError, AuthenticationError) as error:
                raise LinkLostError("the process that answers the controller did not start") from error
        if failure:
            raise LinkLostError(f"{self._name} cannot be opened: {failure.lower()}; check the address of this computer")

    @staticmethod
    def _accept(listener: Listener, process: "subprocess.Popen[bytes]") -> Connection:
        """Wait until the process connects."""
        deadline = time.monotonic() + _START
        while True:
            try:
                return listener.accept()
            except TimeoutError:
                if process.poll() is not None or time.monotonic() > deadline:
                    raise

    def _ask(self, *request: Any) -> Any:
        if self._stream is None:
            raise LinkLostError("the process that answers the controller is not started")
        self._number += 1
        deadline = time.monotonic() + self._timeouts.answer + 1.0
        try:
            self._stream.send((self._number, *request))
            while self._stream.poll(max(deadline - time.monotonic(), 0.0)):
                number, reply = self._stream.recv()
                if number == self._number:  # an earlier one answers a request that was given up
                    return reply
        except (EOFError, OSError) as error:
            raise LinkLostError("the process that answers the controller has ended") from error
        raise LinkLostError("the process that answers the controller does not answer its client")


class RsiDriver(ControllerClient):
    """A KUKA controller with RSI."""

    @classmethod
    def from_url(cls, url: DriverUrl, context: Context) -> "RsiDriver":
        """Make the driver of an `rsi://` URL.

        Raises:
            DriverUrlError: if it names no host, the arm has external axes, or an option is invalid.
        """
        timeouts = Timeouts.from_url(url)
        patience = url.number("wait_s", FIRST_TELEGRAM, above=0.0, at_most=3600.0)
        url.finish()
        if not url.host or url.path not in ("", "/"):
            raise DriverUrlError(
                f"'{url.text}' must name the address of this computer in the network of the controller: "
                f"rsi://192.168.0.20:{rsi.PORT}"
            )
        if set(url.host) <= set("0.:"):
            raise DriverUrlError(
                f"'{url.text}' names every network of this computer; name its address in the network of the "
                f"controller: rsi://192.168.0.20:{rsi.PORT}"
            )
        if len(context.limits.lower) != AXES:
            raise DriverUrlError("rsi:// drives six axes, and no rotary table; choose another driver")
        clock = context.clock or RealTimeClock()
        link = RsiLink(url.host, url.port or rsi.PORT, clock, timeouts, context.limits, patience)
        return cls(link, clock, context.limits, notify=context.notify)
