"""`kvp://`: a KUKA controller with KUKAVARPROXY or C3 Bridge, and the KRL program of `drivers.wires.kvp_program`.

The host of the URL is the controller: `kvp://192.168.0.10:7000`. No option package is needed. A state is a sequence of
readings, one variable each, with that of the program first: an arm that has ended its move then is at its end in the
readings that follow.
"""

import math
import socket
import time
from dataclasses import replace
from typing import Final

import numpy as np

from drivers.client import ControllerClient
from drivers.clock import Clock, RealTimeClock
from drivers.contract import FULL, Answer, Capabilities, Command, Fault, Result, RobotState, Stop
from drivers.errors import AnswerTimeoutError, DriverUrlError, LinkLostError, ProtocolError
from drivers.limits import Limits
from drivers.registry import Context, DriverUrl
from drivers.setpoints import MAX_COUNT, PER_DEGREE, SetPoints, axis_name, frozen
from drivers.wire import (
    Commit,
    Give,
    ReopeningLink,
    Request,
    Stage,
    Take,
    Timeouts,
    connect_tcp,
    describe_failure,
    fault_message,
    speed_from_wire,
    state_of_program,
)
from drivers.wires import kvp, kvp_program

PORT: Final = 7000

_PROGRAM_ANSWER = 1.0  # longest time until the program reads an order, beside the answer time [s]
_MAX_POINTS = 10  # of one stage
_POLL = 0.01  # pause between two readings while the program is waited for [s]: a few cycles of the interpreter
_BEATS = 4  # smallest number of heartbeats in the time of the watchdog while via points are written
_NOT_ACTIVE = 100  # fault code of a program that does not run
_PROGRAM_STATES = {"#P_FREE": 1, "#P_RESET": 2, "#P_STOP": 3, "#P_END": 4}
_NOT_REPORTED = (
    "its accelerations, nor which other clients of its network write its variables, nor whether a move, stopped while "
    "its program did not run, goes on at the start key: cancel or reset the program before you start it; in T1 it "
    "drives slower than commanded"
)


class KvpLine:
    """The connection to the proxy.

    Args:
        host: name or address of the controller.
        port: of the proxy.
        seconds: longest time for an answer.
    """

    def __init__(self, host: str, port: int, seconds: float) -> None:
        self.name = f"{host}:{port}"
        self._address, self._seconds = (host, port), seconds
        self._socket: socket.socket | None = None
        self._rest, self._number = b"", 0
        self._is_mute = False  # whether the last request was not answered

    def open(self) -> None:
        """Connect.

        Raises:
            LinkLostError: if nothing answers.
        """
        self.close()
        what = "KUKAVARPROXY or C3 Bridge runs on the controller"
        self._socket = connect_tcp(self._address, self._seconds, what)

    @property
    def is_open(self) -> bool:
        """Whether there is a connection; it is closed after two unanswered requests, or one that was sent in part."""
        return self._socket is not None

    def close(self) -> None:
        """Release the connection; allowed twice."""
        connection, self._socket, self._rest = self._socket, None, b""
        self._is_mute = False
        if connection is not None:
            connection.close()

    def read(self, name: str) -> str:
        """Return the value of a variable."""
        return self._ask(name, None)

    def write(self, name: str, value: str) -> None:
        """Write a variable."""
        self._ask(name, value)

    def _ask(self, name: str, value: str | None) -> str:
        if self._socket is None:
            raise LinkLostError(f"{self.name} is not open")
        self._number = self._number % 65535 + 1
        deadline = time.monotonic() + self._seconds
        is_sent = False
        try:
            self._socket.settimeout(self._seconds)
            self._socket.sendall(kvp.request(self._number, name, value))
            is_sent = True
            while True:
                messages, self._rest = kvp.split(self._rest)
                for number, body in messages:
                    if number == self._number:  # an earlier one answers a request that was given up
                        self._is_mute = False
                        return self._value(name, value, body)
                if (left := deadline - time.monotonic()) <= 0.0:
                    raise TimeoutError
                self._socket.settimeout(left)
                data = self._socket.recv(1 << 16)
                if not data:
                    self.close()
                    raise LinkLostError(f"{self.name} closed the connection")
                self._rest += data
        except TimeoutError as error:
            if self._is_mute or not is_sent:  # the rest of a request would be read as the beginning of the next one
                self.close()
            else:
                self._is_mute = True
            raise AnswerTimeoutError(f"{self.name} gave no answer about {name}") from error
        except OSError as error:
            self.close()
            raise LinkLostError(f"{self.name} is gone: {describe_failure(error)}") from error

    def _value(self, name: str, value: str | None, body: bytes) -> str:
        try:
            text, is_done = kvp.parse_answer(body)
        except ValueError as error:
            raise ProtocolError(f"{self.name} is no KUKAVARPROXY: {error}") from error
        if not is_done:
            verb = "read" if value is None else "write"
            raise ProtocolError(
                f"{self.name} cannot {verb} {name}; put {kvp_program.NAME}.src and .dat on the controller "
                "(cell controller kvp)"
            )
        return text.strip()


class KvpLink(ReopeningLink):
    """The link to one controller.

    Args:
        line: the connection.
        clock: the client's.
        timeouts: waiting times.
        limits: limits of the arm.
        timer: number of the watchdog's timer.
    """

    def __init__(self, line: KvpLine, clock: Clock, timeouts: Timeouts, limits: Limits, timer: int) -> None:
        super().__init__(line, clock, timeouts)
        self._proxy, self._limits, self._timer = line, limits, timer
        self._axes = [axis_name(axis) for axis in range(len(limits.lower))]
        self._n_via = 1
        self._beaten = -math.inf  # time of the last heartbeat [s]

    def _ask(self, name: str, value: str | None = None) -> str:
        """Read a variable, or write a value; a lost connection is opened again at the next use."""
        try:
            if value is None:
                return self._proxy.read(name)
            self._proxy.write(name, value)
            return value
        except (LinkLostError, AnswerTimeoutError):
            if not self._proxy.is_open:
                self._drop()
            raise

    def _beat(self) -> dict[str, int]:
        """Write the heartbeat if this client owns the arm, and return the state of the program."""
        state = self._state_of_program()
        if self.session and state["OWNER"] == self.session:
            self._ask(f"$TIMER[{self._timer}]", str(-self._timeouts.watchdog_ms))
            self._beaten = self._clock.now()
        return state

    def _max_points(self, axes: int) -> int:
        return _MAX_POINTS

    def _handshake(self) -> Capabilities:
        """Read the limits of the axes."""
        numbers = range(1, len(self._axes) + 1)
        try:
            lower, upper = (
                np.array([float(self._ask(f"${name}[{number}]")) for number in numbers])
                for name in ("SOFTN_END", "SOFTP_END")
            )
        except ValueError as error:
            raise ProtocolError(f"{self._proxy.name} reports axis limits that are no numbers: {error}") from error
        able = self._limits.capabilities("KUKA controller (KUKAVARPROXY)", hardware=True, simulated_time=False)
        own = (np.clip(np.rint(limit * PER_DEGREE), -(2**31), 2**31 - 1) for limit in (lower, upper))
        low, high = (frozen(each, np.int32) for each in own)
        return replace(
            able,
            lower=np.maximum(able.lower, low),
            upper=np.minimum(able.upper, high),
            max_via=kvp_program.MAX_VIA,
            not_reported=_NOT_REPORTED,
        )

    def _exchange(self, sequence: int | None, request: Request) -> Answer:
        match request:
            case Take() | Give():
                sign = 1 if isinstance(request, Take) else -1
                self._ask("SC_TAKE", str(sign * self.session))
                self._await_zero("SC_TAKE", "the request for the arm")
                is_granted = sign < 0 or self._state_of_program()["OWNER"] == self.session
                return Answer(0, Result.OK if is_granted else Result.NOT_OWNER)
            case Stage():
                self._write_points(sequence or 0, request.offset, request.points)
                return Answer(sequence or 0, Result.OK)
            case Commit():
                self._write_points(sequence or 0, request.count - len(request.tail), request.tail)
                self._n_via = request.count
                percent = math.floor(100.0 * speed_from_wire(request.speed) + 1e-9)
                return self._order(sequence or 0, kvp_program.MOVE, request.count, percent)
            case _:
                return self._order(sequence or 0, kvp_program.RESET, 0, 0)

    def send(self, sequence: int, command: Command) -> Answer:
        """Send a command once."""
        if not isinstance(command, Stop):
            return super().send(sequence, command)
        self._require_open()
        self._ask("SC_HALTER", str(self.session))
        self._ask("SC_HALT", str(sequence))
        if self._ask("$PRO_STATE1") == "#P_ACTIVE":
            self._await_zero("SC_HALT", "the stop")
        return Answer(sequence, Result.OK)  # a program that does not run moves nothing until a person starts it

    def _order(self, sequence: int, kind: int, count: int, percent: int) -> Answer:
        self._retry(self._beat)
        order = f"SESSION {self.session},NUMBER {sequence},KIND {kind},COUNT {count},SPEED {percent}"
        self._ask("SC_ORDER", f"{{SC_ORDER_T: {order}}}")
        deadline = self._clock.now() + self._timeouts.answer + _PROGRAM_ANSWER
        while self._clock.now() < min(deadline, self.deadline):
            state = self._state_of_program()
            if state["ACK"] == sequence:
                return Answer(sequence, state["RESULT"])
            if state["OWNER"] != self.session:
                return Answer(sequence, Result.NOT_OWNER)
            self._clock.wait(_POLL)
        raise self._no_answer(f"order {sequence}")

    def _write_points(self, sequence: int, offset: int, points: SetPoints) -> None:
        for number, point in enumerate(points.tolist(), start=offset + 1):
            if self._clock.now() - self._beaten > self._timeouts.watchdog / _BEATS:
                self._beat()
            axes = ",".join(f"{name} {count / PER_DEGREE:.4f}" for name, count in zip(self._axes, point, strict=True))
            content = f"SESSION {self.session},NUMBER {sequence},AXES {{E6AXIS: {axes}}}"
            self._ask(f"SC_POINT[{number}]", f"{{SC_POINT_T: {content}}}")

    def _await_zero(self, name: str, subject: str) -> None:
        """Wait until the program has read a variable."""
        deadline = self._clock.now() + self._timeouts.answer + _PROGRAM_ANSWER
        while self._clock.now() < min(deadline, self.deadline):
            if self._ask(name) == "0":
                return
            self._clock.wait(_POLL)
        raise self._no_answer(subject)

    def _no_answer(self, subject: str) -> AnswerTimeoutError:
        state = self._ask("$PRO_STATE1")
        return AnswerTimeoutError(
            f"the program {kvp_program.NAME} does not answer {subject} ({state}); select it at the pendant and start it"
        )

    def _state_of_program(self) -> dict[str, int]:
        text = self._ask("SC_STATE")
        values = kvp.components(text)
        try:
            return {name: int(values[name]) for name in kvp_program.STATE}
        except (KeyError, OverflowError) as error:
            raise ProtocolError(
                f"SC_STATE of {self._proxy.name} is {text[:60]!r}; put the program there again"
            ) from error

    def _read_state(self) -> RobotState:
        own = self._beat()
        program, alarm, stopped = (self._ask(name) for name in ("$PRO_STATE1", "$ALARM_STOP", "$ROB_STOPPED"))
        axes = kvp.components(self._ask("$AXIS_ACT"))
        try:
            override = int(self._ask("$OV_PRO")) * FULL // 100
            heartbeat = int(self._ask("$ROB_TIMER")) % 65536
            counts = np.rint(np.array([axes[name] for name in self._axes]) * PER_DEGREE)
            if np.abs(counts).max() > MAX_COUNT:
                raise ValueError(f"axes of {axes}")
        except (ValueError, KeyError) as error:
            raise ProtocolError(f"{self._proxy.name} reports impossible values: {error}") from error
        is_stopped, has_move = stopped == "TRUE", own["RUNNING"] != 0
        fault, done_sequence, ending = own["FAULT"], own["DONE"], own["ENDING"]
        message = fault_message(fault)
        if alarm != "TRUE":
            fault, message = int(Fault.EMERGENCY_STOP), "the emergency stop is pressed"
        elif program != "#P_ACTIVE" and not (has_move and program == "#P_STOP"):
            fault = _NOT_ACTIVE + _PROGRAM_STATES.get(program, 0)
            message = f"the program {kvp_program.NAME} does not run ({program}); select it at the pendant and start it"
        if has_move and fault and is_stopped:
            done_sequence, ending = own["RUNNING"], int(Result.FAULTED)
        return state_of_program(
            is_slow=is_stopped,
            is_paused=program == "#P_STOP",
            has_move=has_move,
            is_emergency=fault == Fault.EMERGENCY_STOP,
            passed=own["PASSED"],
            n_via=self._n_via,
            axes=frozen(counts, np.int32),
            ack_sequence=own["ACK"],
            ack_result=own["RESULT"],
            done_sequence=done_sequence,
            done_result=ending,
            fault_code=fault,
            fault_message=message,
            boot=own["BOOT"],
            owner=own["OWNER"],
            heartbeat=heartbeat,
            override=min(max(override, 0), FULL),
        )


class KvpDriver(ControllerClient):
    """A KUKA controller with KUKAVARPROXY or C3 Bridge."""

    @classmethod
    def from_url(cls, url: DriverUrl, context: Context) -> "KvpDriver":
        """Make the driver of a `kvp://` URL.

        Raises:
            DriverUrlError: if it names no host, or an option is invalid.
        """
        timeouts = Timeouts.from_url(url)
        timer = url.integer("timer", kvp_program.TIMER, at_least=1, at_most=kvp_program.MAX_TIMER)
        url.finish()
        if not url.host or url.path not in ("", "/"):
            raise DriverUrlError(f"'{url.text}' must name a host, and may name a port: kvp://192.168.0.10:{PORT}")
        clock = context.clock or RealTimeClock()
        line = KvpLine(url.host, url.port or PORT, timeouts.answer)
        link = KvpLink(line, clock, timeouts, context.limits, timer)
        return cls(link, clock, context.limits, notify=context.notify)
