"""`ur://`: Universal Robots (e-Series and CB3 from software 3.10) by generated URScript and RTDE.

The host of the URL is the controller: `ur://192.168.0.20`. Every command is a small URScript program, sent to the
secondary interface (port 30002). The state is read over RTDE (port 30004). The programs write these output registers:

| register | value |
|---|---|
| 24, 25 | number and result of the last executed command |
| 26, 27 | number and end of the last ended move |
| 28 | number of the current move; 0: none |
| 29 | passed via points of the current or last move |

and read two input registers that this client writes: 24 is the session that owns the arm, 25 a heartbeat. A controller
lets one client at a time write an input register, so the session is exclusive. A program that is not of the session, or
whose number was executed already, does nothing. `rtde_set_watchdog` stops a moving arm when the heartbeat stops.

A move is one `movej` for every via point, without blending. Its speed and acceleration, both of the axis with the
longest way, give it the peak speed and the duration of the fastest profile at the speed of the move. The controller
must be in remote control; it accepts programs from every client of its network.
"""

import select
import socket
from dataclasses import replace
from typing import Any, Final

import numpy as np

from drivers.client import ControllerClient, Link
from drivers.clock import Clock, RealTimeClock
from drivers.contract import FULL, Answer, Capabilities, Command, Mode, Move, Reset, Result, RobotState, Stop
from drivers.errors import (
    AnswerTimeoutError,
    DriverUrlError,
    LinkError,
    LinkLostError,
    ProtocolError,
    SetPointError,
)
from drivers.limits import Limits
from drivers.profile import interpolate
from drivers.registry import MAX_PORT, Context, DriverUrl
from drivers.setpoints import AXES, PER_DEGREE, SetPoints, from_rad, to_rad
from drivers.wire import Heartbeat, Timeouts, connect_tcp, describe_failure, state_of_program
from drivers.wires import rtde
from drivers.wires.rtde import Package, Recipe

RTDE_PORT: Final = 30004
SCRIPT_PORT: Final = 30002

ACK, ACK_RESULT, DONE, DONE_RESULT, RUNNING, PASSED = range(24, 30)
SESSION, HEARTBEAT = 24, 25

OUTPUTS = (
    "timestamp", "actual_q", "actual_qd", "robot_mode", "safety_mode", "runtime_state", "target_speed_fraction",
    f"input_int_register_{SESSION}", *(f"output_int_register_{number}" for number in range(ACK, PASSED + 1)),
)  # fmt: skip
INPUTS = (f"input_int_register_{SESSION}", f"input_int_register_{HEARTBEAT}")

STOPPED, PLAYING, PAUSING, PAUSED = 1, 2, 3, 4
"""Values of runtime_state."""

ROBOT_RUNNING = 7
"""The value of robot_mode with released brakes."""

_ROBOT_MODES = {
    -1: "has no controller", 0: "is disconnected", 1: "waits for the confirmation of its safety settings",
    2: "is booting", 3: "has no power", 4: "switches its power on", 5: "has its brakes on", 6: "is in freedrive",
    8: "updates its firmware",
}  # fmt: skip
_DRIVING = (1, 2)  # safety modes in which programs run: normal and reduced
_UNDEFINED = 11
_SAFETY_MODES = {
    3: "a protective stop is active", 4: "the recovery mode is active", 5: "a safeguard stop is active",
    6: "the emergency stop of the system is pressed", 7: "the emergency stop of the robot is pressed",
    8: "a safety violation is active", 9: "a safety fault is active", _UNDEFINED: "the safety mode is undefined",
    12: "a safeguard stop of the automatic mode is active", 13: "the three-position enabling device is released",
    14: "the three-position enabling switch of the pendant is released",
    15: "the emergency stop of the moulding machine is pressed", 20: "the emergency stop by PROFIsafe is pressed",
}  # fmt: skip
_EMERGENCY = (6, 7, 15, 20)

_FREQUENCY = 50.0  # of data packages [Hz]
_PROGRAM_START = 1.0  # longest time until a sent program runs, beside the answer time [s]
_AT_REST = 1e-3  # largest speed of an axis at rest [rad/s]
_MAX_VIA = 1000
_STOP_DECELERATION = 4.0  # of stopj [rad/s^2]
_NOT_REPORTED = "its axis limits, nor which other clients of its network send programs"
_ROBOT_FAULT = 100  # fault code of a robot mode: this plus the mode


class UrLink(Link):
    """The link to one controller.

    Args:
        host: name or address of the controller.
        clock: the client's.
        timeouts: waiting times.
        limits: limits of the arm, by which motions are timed.
        rtde_port: port of RTDE.
        script_port: port of the secondary interface.
    """

    def __init__(
        self, host: str, clock: Clock, timeouts: Timeouts, limits: Limits, rtde_port: int, script_port: int
    ) -> None:
        self._host, self._clock, self._timeouts, self._limits = host, clock, timeouts, limits
        self._rtde_port, self._script_port = rtde_port, script_port
        self._socket: socket.socket | None = None
        self._rest = b""
        self._outputs: Recipe | None = None
        self._inputs: Recipe | None = None
        self._session = self._beat = 0
        self._monitor = Heartbeat(clock, timeouts.watchdog)
        self._register = 0  # last value of the register ACK
        self._local: tuple[int, Answer] | None = None  # answer without a program, and the register then
        self._n_via, self._last = 1, RobotState(Mode.IDLE, np.zeros(AXES, dtype=np.int32), at_rest=True)

    def open(self) -> Capabilities:
        """Connect RTDE and start the exchange.

        Raises:
            LinkLostError: if nothing answers.
            ProtocolError: if the answer is not that of a controller of Universal Robots.
        """
        self.close()
        self._monitor.restart()
        try:
            return self._start()
        except LinkError:
            self.close()
            raise

    def _start(self) -> Capabilities:
        """Connect and set up the output recipe."""
        self._socket = connect_tcp((self._host, self._rtde_port), self._timeouts.answer, "the controller is on")
        if self._ask(Package.VERSION, rtde.VERSION.to_bytes(2, "big")) != b"\x01":
            raise ProtocolError(f"{self._name} has no RTDE of version {rtde.VERSION}; update the controller's software")
        request = np.array([_FREQUENCY], dtype=">f8").tobytes() + ",".join(OUTPUTS).encode()
        self._outputs = self._recipe(OUTPUTS, self._ask(Package.OUTPUTS, request))
        if self._ask(Package.START) != b"\x01":
            raise ProtocolError(f"{self._name} does not start the exchange of data")
        able = self._limits.capabilities("controller of Universal Robots", hardware=True, simulated_time=False)
        return replace(able, not_reported=_NOT_REPORTED)

    def close(self) -> None:
        """Release the wire; allowed twice."""
        connection, self._socket = self._socket, None
        self._rest, self._inputs = b"", None
        if connection is not None:
            connection.close()

    def take(self, session: int) -> int:
        """Set up the input registers, which one client at a time may write, and write the session."""
        self.state()  # opens a lost connection again
        if self._inputs is None and not self._set_up_inputs():
            return Result.NOT_OWNER
        self._session = session
        self._send_heartbeat()
        return Result.OK

    def give(self) -> None:
        """Write session 0."""
        if self._session:
            self._session = 0
            self._send_heartbeat()

    def send(self, sequence: int, command: Command) -> Answer:
        """Send the program of a command, and wait until it runs.

        Raises:
            AnswerTimeoutError: if the registers do not show it in time.
            LinkLostError, ProtocolError.
        """
        state = self.state()  # opens a lost connection again
        if state.fault_code and not isinstance(command, Move):  # no program runs; the safety functions stop the arm
            is_pressed = state.mode is Mode.EMERGENCY_STOP
            refusal = Result.ESTOP_PRESSED if is_pressed else Result.IN_FAULT
            result = Result.OK if isinstance(command, Stop) else refusal
            self._local = self._register, Answer(sequence, result, f"{state.fault_message}; clear it at the pendant")
            return self._local[1]
        try:
            with socket.create_connection((self._host, self._script_port), self._timeouts.answer + 1.0) as connection:
                connection.sendall(self._program(sequence, command).encode("ascii"))
                return self._await_answer(sequence)
        except OSError as error:
            raise LinkLostError(
                f"port {self._script_port} of {self._host} does not accept programs: {describe_failure(error)}"
            ) from error

    def state(self) -> RobotState:
        """Read the state; open a lost connection again until the watchdog's time is over.

        Raises:
            LinkLostError: if the connection is lost, or the controller's clock stands still.
            AnswerTimeoutError, ProtocolError.
        """
        state = self._read_or_reopen()
        try:
            self._monitor.update(state.heartbeat or 0)
        except LinkLostError:
            self.close()
            raise
        return state

    def _read_or_reopen(self) -> RobotState:
        began = self._clock.now()
        while True:
            try:
                if self._socket is None:
                    self._reopen()
                self._send_heartbeat()
                return self._read()
            except LinkError:
                self.close()
                if self._clock.now() - began > self._timeouts.watchdog or self._clock.now() >= self.deadline:
                    raise
                self._clock.wait(self._timeouts.poll)

    def time_to_wait(self) -> float:
        """Return the polling period."""
        return self._timeouts.poll if self._last.is_busy else 0.0

    @property
    def _name(self) -> str:
        return f"{self._host}:{self._rtde_port}"

    def _reopen(self) -> None:
        self.open()
        if self._session and not self._set_up_inputs():
            self.close()
            raise LinkLostError(f"another client took the arm at {self._host} while the connection was lost")

    def _set_up_inputs(self) -> bool:
        """Set up the input registers; return False if another client writes them."""
        types = self._ask(Package.INPUTS, ",".join(INPUTS).encode())
        if b"IN_USE" in types:
            return False
        self._inputs = self._recipe(INPUTS, types)
        return True

    def _recipe(self, names: tuple[str, ...], answer: bytes) -> Recipe:
        """Return the recipe of an answer: its number and the types."""
        types = tuple(answer[1:].decode("ascii", errors="replace").split(","))
        try:
            return Recipe(answer[0] if answer else 0, names, types)
        except ValueError as error:
            missing = [name for name, kind in zip(names, types, strict=False) if kind == "NOT_FOUND"]
            raise ProtocolError(
                f"{self._name} does not offer {', '.join(missing) or 'the required variables'} ({error}); it needs "
                "software 3.10 or newer"
            ) from error

    def _send_heartbeat(self) -> None:
        if self._inputs is not None:
            self._beat = (self._beat + 1) % 65536
            self._write(self._inputs.pack(dict(zip(INPUTS, (self._session, self._beat), strict=True))))

    def _write(self, data: bytes) -> None:
        if self._socket is None:
            raise LinkLostError(f"{self._name} is not open")
        try:
            self._socket.sendall(data)
        except OSError as error:
            raise LinkLostError(f"{self._name} is gone: {describe_failure(error)}") from error

    def _receive(self, deadline: float) -> list[tuple[int, bytes]]:
        """Return the packages that arrived; wait for the first until `deadline`."""
        if self._socket is None:
            raise LinkLostError(f"{self._name} is not open")
        try:
            ready, _, _ = select.select([self._socket], [], [], max(deadline - self._clock.now(), 0.0))
            if not ready:
                return []
            data = self._socket.recv(1 << 16)
        except OSError as error:
            raise LinkLostError(f"{self._name} is gone: {describe_failure(error)}") from error
        if not data:
            raise LinkLostError(f"{self._name} closed the connection")
        try:
            packages, self._rest = rtde.split(self._rest + data)
        except ValueError as error:
            raise ProtocolError(f"{self._name} sends no RTDE: {error}") from error
        return packages

    def _ask(self, kind: Package, payload: bytes = b"") -> bytes:
        """Send a request and return the payload of its answer."""
        self._write(rtde.encode(kind, payload))
        deadline = self._clock.now() + self._timeouts.answer + 1.0
        while self._clock.now() < deadline:
            for received, content in self._receive(deadline):
                if received == kind:
                    return content
        raise AnswerTimeoutError(f"{self._name} gave no answer; it may be no controller of Universal Robots")

    def _read(self) -> RobotState:
        """Read the newest data package: all that have arrived, then the next one."""
        assert self._outputs is not None
        deadline, newest = self._clock.now() + self._timeouts.answer, b""
        while True:
            is_old = self._socket is not None and bool(select.select([self._socket], [], [], 0.0)[0])
            packages = [content for kind, content in self._receive(deadline) if kind == Package.DATA]
            newest = packages[-1] if packages else newest
            if packages and not is_old:
                break
            if self._clock.now() >= deadline:
                raise AnswerTimeoutError(f"{self._name} sends no data")
        try:
            self._last = self._parse(self._outputs.unpack(newest))
        except (ValueError, OverflowError, SetPointError) as error:
            raise ProtocolError(f"{self._name} sends impossible data: {error}") from error
        return self._last

    def _parse(self, values: dict[str, Any]) -> RobotState:
        """Return the state of a data package."""
        register = {number: int(values[f"output_int_register_{number}"]) for number in range(ACK, PASSED + 1)}
        self._register = register[ACK]
        if self._local and self._local[0] == self._register:
            register[ACK], register[ACK_RESULT] = self._local[1].sequence, self._local[1].result
        running, done_sequence, done_result = register[RUNNING], register[DONE], register[DONE_RESULT]
        safety, robot, runtime = values["safety_mode"], values["robot_mode"], values["runtime_state"]
        fault, message = 0, ""
        if safety not in _DRIVING:  # modes that this driver does not know stop the arm too
            fault = int(safety) or _UNDEFINED
            message = _SAFETY_MODES.get(fault, f"the safety mode is {fault}, in which no program runs")
        elif robot != ROBOT_RUNNING:
            fault, message = _ROBOT_FAULT + int(robot), f"the robot {_ROBOT_MODES.get(robot, f'is in mode {robot}')}"
        if running and running != done_sequence and runtime == STOPPED:  # somebody or a fault ended the program
            done_sequence, done_result = running, Result.FAULTED if fault else Result.STOPPED_BY_OTHER
        return state_of_program(
            is_slow=max(abs(speed) for speed in values["actual_qd"]) < _AT_REST,
            is_paused=runtime in (PAUSING, PAUSED),
            has_move=bool(running) and running != done_sequence,
            is_emergency=safety in _EMERGENCY,
            passed=register[PASSED],
            n_via=self._n_via,
            axes=from_rad(values["actual_q"]),
            ack_sequence=register[ACK],
            ack_result=register[ACK_RESULT],
            done_sequence=done_sequence,
            done_result=done_result,
            fault_code=fault,
            fault_message=message,
            heartbeat=int(values["timestamp"] * 1000.0) % 65536,
            owner=int(values[f"input_int_register_{SESSION}"]),
            override=min(max(round(values["target_speed_fraction"] * FULL), 0), FULL),
        )

    def _await_answer(self, sequence: int) -> Answer:
        """Wait until the registers show a command."""
        deadline = self._clock.now() + self._timeouts.answer + _PROGRAM_START
        while self._clock.now() < min(deadline, self.deadline):
            state = self.state()
            if state.ack_sequence == sequence:
                return Answer(sequence, state.ack_result)
        raise AnswerTimeoutError(
            f"{self._host} did not run the program of command {sequence}; check that the controller is in remote "
            "control and the robot is on with its brakes released"
        )

    def _program(self, sequence: int, command: Command) -> str:
        """Return the program of a command."""
        name = type(command).__name__.lower()
        guard = f"read_input_integer_register({SESSION}) == {self._session}"
        match command:
            case Move():
                lines = self._move_lines(sequence, command)
                guard += f" and read_output_integer_register({ACK}) != {sequence}"
            case Stop():  # every client may stop
                guard = "True"
                lines = [
                    f"stopj({_STOP_DECELERATION})",
                    f"if read_output_integer_register({RUNNING}) != 0:",
                    _write_register(DONE_RESULT, int(Result.STOPPED)),
                    f"write_output_integer_register({DONE}, read_output_integer_register({RUNNING}))",
                    _write_register(RUNNING, 0),
                    "end",
                    _write_register(ACK_RESULT, 0),
                    _write_register(ACK, sequence),
                ]
            case Reset():
                lines = [_write_register(ACK_RESULT, 0), _write_register(ACK, sequence)]
        return "\n".join([f"def scan_cell_{name}():", f"if {guard}:", *lines, "end", "end", ""])

    def _move_lines(self, sequence: int, move: Move) -> list[str]:
        """Return the statements of a move; a via point at the present position takes no time."""
        limits, start = self._limits, self._last.axes
        self._n_via = len(move.set_points)
        lines = [
            _write_register(RUNNING, sequence),
            _write_register(PASSED, 0),
            _write_register(ACK_RESULT, 0),
            _write_register(ACK, sequence),
            f'rtde_set_watchdog("input_int_register_{HEARTBEAT}", {1.0 / self._timeouts.watchdog:.4f}, "stop")',
        ]
        for number, point in enumerate(move.set_points, start=1):
            if (point != start).any():
                leg = interpolate(
                    to_rad(start), to_rad(point[None]), limits.velocity * move.speed, limits.acceleration, limits.jerk
                )
                peak = float(leg.s[:, 1].max())  # of the path parameter [1/s]
                speed = float(np.abs(to_rad(point) - to_rad(start)).max()) * peak
                lines.append(f"movej({_joints(point)}, {speed / (leg.duration - 1.0 / peak):.6f}, {speed:.6f})")
            lines.append(_write_register(PASSED, number))
            start = point
        return [*lines, _write_register(DONE_RESULT, 0), _write_register(DONE, sequence), _write_register(RUNNING, 0)]


def _write_register(number: int, value: int) -> str:
    return f"write_output_integer_register({number}, {value})"


def _joints(point: SetPoints) -> str:
    """Return (6,) set-points as a list in URScript."""
    return "[" + ", ".join(f"d2r({count / PER_DEGREE:.4f})" for count in point.tolist()) + "]"


class UrDriver(ControllerClient):
    """A controller of Universal Robots."""

    @classmethod
    def from_url(cls, url: DriverUrl, context: Context) -> "UrDriver":
        """Make the driver of a `ur://` URL.

        Raises:
            DriverUrlError: if it names no host, the arm has external axes, or an option is invalid.
        """
        timeouts = Timeouts.from_url(url)
        rtde_port = url.integer("rtde_port", RTDE_PORT, at_least=1, at_most=MAX_PORT)
        script_port = url.integer("script_port", SCRIPT_PORT, at_least=1, at_most=MAX_PORT)
        url.finish()
        if not url.host or url.port is not None or url.path not in ("", "/"):
            raise DriverUrlError(f"'{url.text}' must name a host without port or path: ur://192.168.0.20")
        if len(context.limits.lower) != AXES:
            raise DriverUrlError("ur:// drives six axes; a controller of Universal Robots turns no rotary table")
        clock = context.clock or RealTimeClock()
        limits = replace(context.limits, max_via=min(context.limits.max_via or _MAX_VIA, _MAX_VIA))
        link = UrLink(url.host, clock, timeouts, limits, rtde_port, script_port)
        return cls(link, clock, context.limits, notify=context.notify)
