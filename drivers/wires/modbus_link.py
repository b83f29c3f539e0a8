"""`modbus://` and `modbus+rtu://`: the register map of docs/internals/protocol.md over Modbus.

`modbus://host:502?unit=1`, `modbus+rtu:///dev/ttyUSB1?baud=115200`. Only this module imports pymodbus.

Modbus telegrams on a serial line have no number, so a late answer looks like the current one. Here every exchange is a
write of the command block with a new heartbeat, and a read of the status block, which repeats that heartbeat (`echo`).
A status with another echo was made before the write, or for another client, and is read again. The answer to a command
is taken only from a status with the right echo; the response to the write itself says only that a device accepted it.
"""

import logging
import secrets
import select
from collections.abc import Mapping
from typing import Any, Protocol, TypeVar

import numpy as np
from pymodbus import FramerType
from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.exceptions import ConnectionException, ModbusIOException

from drivers.client import ControllerClient
from drivers.clock import Clock, RealTimeClock
from drivers.contract import Answer, Capabilities, Flag, Mode, Reset, RobotState, Stop
from drivers.errors import AnswerTimeoutError, DriverUrlError, LinkLostError, ProtocolError
from drivers.registry import Context, DriverUrl
from drivers.setpoints import AXES, SetPoints
from drivers.wire import (
    MAX_AXES,
    MAX_BAUD,
    REAL_TIME,
    STATUS_FIELDS,
    Commit,
    Give,
    Line,
    ReopeningLink,
    Request,
    Stage,
    Take,
    Timeouts,
    describe_failure,
    fault_message,
    port_path,
    speed_from_wire,
)
from drivers.wires import modbus_protocol as registers

# Failures are raised, and the caller decides whether they are reported: pymodbus must not print them.
logging.getLogger("pymodbus").addHandler(logging.NullHandler())

_EXCEPTIONS = {
    1: "it does not know this function",
    2: "it has no such register",
    3: "it does not accept this value",
    4: "it failed",
    5: "it needs more time",
    6: "it is busy",
    10: "the gateway has no path to it",
    11: "the gateway got no answer from it",
}

_RTU_BYTES = 2 * 260  # the longest request and the longest answer
BITS_PER_BYTE = 11

_COMMANDS = {Give: registers.GIVE, Stop: registers.STOP, Reset: registers.RESET}

Client = TypeVar("Client", bound=ControllerClient)


class Port(Line, Protocol):
    """Registers of one device (`ModbusPort`); it raises LinkErrors."""

    def read(self, address: int, count: int) -> list[int]:
        """Read input registers in one FC04."""

    def write(self, address: int, values: list[int]) -> None:
        """Write holding registers in one FC16."""


class _PromptSerialClient(ModbusSerialClient):
    """A client that wakes as soon as bytes arrive; pymodbus polls every millisecond, and twice more for further bytes.

    The framer waits for missing bytes of a telegram. If pymodbus renames the method, this client is only slower.
    """

    echo = False
    """Whether the adapter returns all sent bytes, which are then read and dropped."""

    is_echoing = False
    """Whether the bytes received since the last request began with the whole request."""

    _sent, _received = b"", b""

    def send(self, request: bytes, addr: tuple[str, int] | None = None) -> int:
        size = int(super().send(request, addr))
        self._sent, self._received, self.is_echoing, port = request, b"", False, self.socket
        if self.echo and port is not None and port.read(size) != request:
            raise ProtocolError(f"{port.name} does not return the bytes that are sent to it; omit the option echo")
        return size

    def recv(self, size: int | None) -> bytes:
        received = bytes(super().recv(size))
        if not self.echo:
            self._received = (self._received + received)[: len(self._sent)]
            self.is_echoing = bool(self._sent) and self._received == self._sent
        return received

    def _wait_for_data(self) -> int:
        port: Any = self.socket
        try:
            descriptor = port.fileno()
        except (AttributeError, OSError):  # Windows has none
            return int(super()._wait_for_data())
        select.select([descriptor], [], [], self.comm_params.timeout_connect)
        return int(port.in_waiting)


class ModbusPort:
    """One device on one line. Every call is one telegram and its answer; nothing is retried.

    Args:
        name: for messages.
        unit: device address.
        client: of pymodbus, with `retries=0`.
        keeps_late_answers: True if a late answer would arrive through the same connection, indistinguishable from a
            current one; the connection is then closed after a missing answer.
    """

    def __init__(self, name: str, unit: int, client: Any, *, keeps_late_answers: bool) -> None:
        self.name, self._unit, self._client = name, unit, client
        self._keeps_late_answers = keeps_late_answers

    @classmethod
    def tcp(cls, host: str, port: int, unit: int, answer: float) -> "ModbusPort":
        """Return a device behind TCP or a gateway; each answer must arrive within `answer` [s]."""
        client = ModbusTcpClient(host, port=port, timeout=answer, retries=0)
        return cls(f"{host}:{port}", unit, client, keeps_late_answers=True)

    @classmethod
    def rtu(cls, path: str, baud: int, unit: int, answer: float, *, echo: bool = False) -> "ModbusPort":
        """Return a device on a serial line; the transfer time of the bytes is added to `answer` [s].

        With `echo` the adapter returns all sent bytes, as RS-485 adapters of two wires do that cannot switch it off.
        """
        timeout = answer + _RTU_BYTES * BITS_PER_BYTE / baud
        client = _PromptSerialClient(path, framer=FramerType.RTU, baudrate=baud, timeout=timeout, retries=0)
        client.echo = echo
        return cls(path, unit, client, keeps_late_answers=False)

    def open(self) -> None:
        """Open the line; raise LinkLostError if this fails."""
        try:
            opened = self._client.connect()
        except Exception as error:  # pymodbus passes on some errors of the operating system
            raise LinkLostError(f"{self.name} cannot be opened: {describe_failure(error)}") from error
        if not opened:
            raise LinkLostError(
                f"{self.name} cannot be opened: nothing listens there, or the port is missing or in use; check "
                "address, plug and rights"
            )

    def close(self) -> None:
        """Release the line; allowed twice."""
        try:
            self._client.close()
        except OSError:
            return  # it is already gone

    def read(self, address: int, count: int) -> list[int]:
        """Read input registers in one FC04.

        Raises:
            AnswerTimeoutError, ProtocolError, LinkLostError.
        """
        response = self._execute(lambda: self._client.read_input_registers(address, count=count, device_id=self._unit))
        values = getattr(response, "registers", None)
        if response.function_code != 4 or not isinstance(values, list) or len(values) != count:
            raise ProtocolError(f"{self.name} answered a read with another telegram; it may be late")
        return [int(value) for value in values]

    def write(self, address: int, values: list[int]) -> None:
        """Write holding registers in one FC16.

        Raises:
            AnswerTimeoutError, ProtocolError, LinkLostError.
        """
        response = self._execute(lambda: self._client.write_registers(address, values, device_id=self._unit))
        if response.function_code != 16 or response.address != address or response.count != len(values):
            raise ProtocolError(f"{self.name} answered a write with another telegram; it may be late")

    def _execute(self, request: Any) -> Any:
        try:
            response = request()
        except ProtocolError:
            raise
        except ModbusIOException as error:  # no answer, or one for another request
            if self._keeps_late_answers:
                self.close()
            self._require_no_echo()
            raise AnswerTimeoutError(
                f"{self.name} gave no answer of unit {self._unit} in time; check cable, unit, baud rate and the device"
            ) from error
        except (ConnectionException, OSError) as error:
            self.close()
            raise LinkLostError(f"{self.name} is gone: {describe_failure(error)}") from error
        except Exception as error:  # a corrupted telegram can fail anywhere in the library
            self._require_no_echo()
            self.close()
            raise ProtocolError(f"{self.name} sent a broken telegram; check cable, baud rate and device") from error
        if response.isError():
            code = int(getattr(response, "exception_code", 0))
            raise ProtocolError(
                f"the device at {self.name} refused a telegram with exception {code}: "
                f"{_EXCEPTIONS.get(code, 'a code of its own')}"
            )
        self._require_no_echo()
        return response

    def _require_no_echo(self) -> None:
        """Raise if the adapter returns the requests. No valid answer begins with its whole request."""
        if getattr(self._client, "is_echoing", False):
            raise ProtocolError(
                f"{self.name} returns the bytes that are sent to it: an RS-485 adapter with echo; switch its echo off, "
                "or add the option echo to the URL"
            )


class ModbusLink(ReopeningLink):
    """The Modbus wire to one controller.

    Args:
        port: access to the registers.
        clock: the client's.
        timeouts: waiting times.
        first_heartbeat: start of the client's heartbeat; None: random.
    """

    def __init__(self, port: Port, clock: Clock, timeouts: Timeouts, *, first_heartbeat: int | None = None) -> None:
        super().__init__(port, clock, timeouts)
        self._port = port
        self._set_axes(AXES)
        self._heartbeat = secrets.randbelow(65536) if first_heartbeat is None else first_heartbeat

    def _set_axes(self, axes: int) -> None:
        self._blocks = {block.name: block.for_axes(axes) for block in registers.BLOCKS}

    def _handshake(self) -> Capabilities:
        head = self._read(registers.CAPABILITIES.address, registers.HEAD)
        registers.require_identity(head)
        axes = head[-1]
        if not AXES <= axes <= MAX_AXES:
            raise ProtocolError(f"the controller has {axes} axes; the protocol allows {AXES} to {MAX_AXES}")
        self._set_axes(axes)
        values = self._read_block(registers.CAPABILITIES)
        return Capabilities(
            controller=str(values["name"]),
            lower=_axes(values, "lower"),
            upper=_axes(values, "upper"),
            max_step=_axes(values, "max_step"),
            max_speed=speed_from_wire(_integer(values, "max_speed")),
            max_via=_integer(values, "max_via") or None,
            hardware=True,
            simulated_time=False,
            time_scale=_integer(values, "time_scale") / REAL_TIME,
        )

    def _read_state(self) -> RobotState:
        if not self.session:  # a client that only reads writes nothing
            return _parse_state(self._read_block(registers.STATUS))
        self._write({})
        return _parse_state(self._read_status())

    def _max_points(self, axes: int) -> int:
        return self._blocks[registers.COMMAND.name].max_points

    def _exchange(self, sequence: int | None, request: Request) -> Answer:
        sequence = self.session if sequence is None else sequence
        points: SetPoints | None = None
        block: dict[str, int]
        match request:
            case Stage(offset, points):
                block = {"command": registers.STAGE, "offset": offset}
            case Commit(speed, count, crc, points):
                block = {"command": registers.MOVE, "speed": speed, "count": count, "points_crc": crc}
            case Take(watchdog_ms):
                block = {"command": registers.TAKE, "watchdog_ms": watchdog_ms}
            case _:
                block = {"command": _COMMANDS[type(request)]}
        self._write({"sequence": sequence, **block}, points)
        values = self._read_status()
        answered, result = _integer(values, "answer_sequence"), _integer(values, "answer_result")
        if answered != sequence:
            raise ProtocolError(
                f"the controller answers command {answered}, not {sequence}; another client sends commands"
            )
        return Answer(sequence, result)

    def _write(self, block: Mapping[str, int], points: SetPoints | None = None) -> None:
        """Write the command block under a new heartbeat."""
        self._heartbeat = (self._heartbeat + 1) % 65536
        values = {
            **dict.fromkeys((field.name for field in registers.COMMAND.fields), 0),
            **block,
            "heartbeat": self._heartbeat,
            "session": self.session,
            "points": 0 if points is None else len(points),
        }
        counts = () if points is None else points.ravel().tolist()
        try:
            command = self._blocks[registers.COMMAND.name]
            self._port.write(command.address, command.encode(values, counts))
        except LinkLostError:
            self._drop()
            raise

    def _read_status(self) -> dict[str, registers.Value]:
        """Return the status that was made after the last write."""
        echo = -1
        for _ in range(self._timeouts.tries):
            values = self._read_block(registers.STATUS)
            echo = _integer(values, "echo")
            if echo == self._heartbeat:
                return values
        raise ProtocolError(
            f"the controller echoes heartbeat {echo}, not {self._heartbeat}; its answers are late, or another client "
            "writes to it"
        )

    def _read_block(self, block: registers.Block) -> dict[str, registers.Value]:
        sized = self._blocks[block.name]
        read = self._read(sized.address, sized.registers)
        registers.require_identity(read)
        values, _ = sized.decode(read)
        return values

    def _read(self, address: int, count: int) -> list[int]:
        try:
            return self._port.read(address, count)
        except LinkLostError:
            self._drop()
            raise


def _parse_state(values: Mapping[str, registers.Value]) -> RobotState:
    code, axes = _integer(values, "fault_code"), _axes(values, "axes")
    if _integer(values, "n_axes") != len(axes):
        raise ProtocolError(f"the controller now has {values['n_axes']} axes instead of {len(axes)}")
    try:
        mode = Mode(_integer(values, "mode"))
    except ValueError as error:
        raise ProtocolError(f"the controller reports mode {values['mode']}; modes are 0 to {max(Mode)}") from error
    at_rest = bool(_integer(values, "flags") & Flag.AT_REST)
    return RobotState(
        mode,
        axes,
        at_rest,
        fault_message=fault_message(code),
        **{name: _integer(values, name) for name in STATUS_FIELDS if name != "mode"},
    )


def _integer(values: Mapping[str, registers.Value], name: str) -> int:
    value = values[name]
    assert isinstance(value, int)
    return value


def _axes(values: Mapping[str, registers.Value], name: str) -> SetPoints:
    return np.array(values[name], dtype=np.int32)


class ModbusDriver(ControllerClient):
    """A controller behind Modbus TCP."""

    @classmethod
    def from_url(cls, url: DriverUrl, context: Context) -> "ModbusDriver":
        """Make the driver of a `modbus://` URL.

        Raises:
            DriverUrlError: if it names no host, or an option is invalid.
        """
        unit, timeouts = _unit(url, 0, 255), Timeouts.from_url(url)
        url.finish()
        if not url.host or url.path not in ("", "/"):
            raise DriverUrlError(f"'{url.text}' must name a host and no path: modbus://192.168.0.10:502?unit=1")
        port = ModbusPort.tcp(url.host, url.port or 502, unit, timeouts.answer)
        return _driver(cls, port, timeouts, context)


class ModbusRtuDriver(ControllerClient):
    """A controller behind Modbus RTU."""

    @classmethod
    def from_url(cls, url: DriverUrl, context: Context) -> "ModbusRtuDriver":
        """Make the driver of a `modbus+rtu://` URL.

        Raises:
            DriverUrlError: if it names no port, or an option is invalid.
        """
        unit, baud = _unit(url, 1, 247), url.integer("baud", 115200, at_least=50, at_most=MAX_BAUD)
        timeouts, echo = Timeouts.from_url(url), url.flag("echo")
        url.finish()
        port = ModbusPort.rtu(port_path(url), baud, unit, timeouts.answer, echo=echo)
        return _driver(cls, port, timeouts, context)


def _driver(kind: type[Client], port: ModbusPort, timeouts: Timeouts, context: Context) -> Client:
    clock = context.clock or RealTimeClock()
    link = ModbusLink(port, clock, timeouts)
    return kind(link, clock, context.limits, notify=context.notify)


def _unit(url: DriverUrl, lowest: int, highest: int) -> int:
    """Take the unit: on a line an address; behind TCP also 0 and 255, by which devices without a line are addressed."""
    return url.integer("unit", 1, at_least=lowest, at_most=highest)
