"""`modbus://` and `modbus+rtu://`: the register map of docs/internals/protocol.md over Modbus.

`modbus://host:502?unit=1`, `modbus+rtu:///dev/ttyUSB1?baud=115200`.

Modbus telegrams on a serial line carry no number, so an answer that is late looks like the current one. Here every
exchange is a write of the command block with a new heartbeat, and a read of the status block, which repeats that
heartbeat (`echo`). A status that echoes another one was made before the write, or for another client, and is read
again. The answer to a command is taken from such a status and nowhere else; that the write itself was answered says
only that something took it.
"""

import secrets
from collections.abc import Mapping
from functools import partial
from typing import Protocol, TypeVar

import numpy as np

from drivers.client import ControllerClient
from drivers.clock import Clock, RealTimeClock
from drivers.commands import Answer, Command, Move, Result, Stop
from drivers.contract import Capabilities, Fault, Flag, Mode, RobotState
from drivers.errors import DriverUrlError, LinkLostError, ProtocolError
from drivers.registry import Context
from drivers.reopening import Line, ReopeningLink
from drivers.setpoints import AXES, SetPoints
from drivers.url import DriverUrl
from drivers.wire import MOST_AXES, SCALES, Patience, pieces, speed_from_wire
from drivers.wires.modbus import register_map as registers
from drivers.wires.modbus.port import ModbusPort
from drivers.wires.serial.link import port_path, require_taken


class Port(Line, Protocol):
    """Registers of one device (`drivers.wires.modbus.port.ModbusPort`); it raises LinkErrors."""

    def read(self, address: int, count: int) -> list[int]:
        """Input registers, in one FC04."""

    def write(self, address: int, values: list[int]) -> None:
        """Holding registers, in one FC16."""


Client = TypeVar("Client", bound=ControllerClient)


class ModbusLink(ReopeningLink):
    """The wire to one controller.

    Args:
        port: where the registers are.
        clock: the client's.
        patience: how long to wait.
        first_heartbeat: where it begins to count; None: random.
    """

    def __init__(self, port: Port, clock: Clock, patience: Patience, *, first_heartbeat: int | None = None) -> None:
        super().__init__(port, clock, patience)
        self._port = port
        self._size(AXES)
        self._heartbeat = secrets.randbelow(65536) if first_heartbeat is None else first_heartbeat

    def send(self, sequence: int, command: Command) -> Answer:
        """Send a command once; what a move stages first may be sent again."""
        self._require_open()
        if isinstance(command, Move):
            stages, commit = pieces(command, self._block_of[registers.COMMAND.name].most_points)
            for stage in stages:
                block = {"command": registers.STAGE, "offset": stage.offset}
                taken = self._again(partial(self._command, sequence, block, stage.points))
                if taken.result != Result.OK:
                    require_taken(taken)
                    return taken
            block = {
                "command": registers.MOVE, "speed": commit.speed, "count": commit.count, "points_crc": commit.crc
            }  # fmt: skip
            answer = self._command(sequence, block, commit.tail)
            require_taken(answer)
            return answer
        return self._command(sequence, {"command": registers.STOP if isinstance(command, Stop) else registers.RESET})

    def state(self) -> RobotState:
        """Read the state, the owner's heartbeat first; several times if need be, opening a lost line again."""
        return self._taken(self._again(self._beat))

    def _size(self, axes: int) -> None:
        self._block_of = {block.name: block.of(axes) for block in registers.BLOCKS}

    def _ask_for(self) -> int:
        take = {"command": registers.TAKE, "watchdog_ms": self._patience.watchdog_ms}
        return int(self._command(self.session, take).result)

    def _give_back(self) -> None:
        self._command(self.session, {"command": registers.GIVE})

    def _greet(self) -> Capabilities:
        head = self._read(registers.CAPABILITIES.address, registers.HEAD)
        registers.check_identity(head)
        axes = head[-1]
        if not AXES <= axes <= MOST_AXES:
            raise ProtocolError(f"the controller has {axes} axes; there are {AXES} to {MOST_AXES}")
        self._size(axes)
        values = self._block(registers.CAPABILITIES)
        return Capabilities(
            controller=str(values["name"]),
            lower=_axes(values, "lower"),
            upper=_axes(values, "upper"),
            max_step=_axes(values, "max_step"),
            max_speed=speed_from_wire(_whole(values, "max_speed")),
            max_via=_whole(values, "max_via") or None,
            hardware=True,
            simulated_time=False,
            time_scale=_whole(values, "time_scale") / SCALES,
        )

    def _beat(self) -> RobotState:
        if not self.session:  # whoever only looks writes nothing
            return _state_of(self._block(registers.STATUS))
        self._write({})
        return _state_of(self._status())

    def _command(self, sequence: int, block: Mapping[str, int], points: SetPoints | None = None) -> Answer:
        self._write({"sequence": sequence, **block}, points)
        values = self._status()
        answered, result = _whole(values, "answer_sequence"), _whole(values, "answer_result")
        if answered != sequence:
            raise ProtocolError(
                f"the controller answers command {answered}, not {sequence}; another client talks to it"
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
            block_of = self._block_of[registers.COMMAND.name]
            self._port.write(block_of.address, block_of.encode(values, counts))
        except LinkLostError:
            self._drop()
            raise

    def _status(self) -> dict[str, registers.Value]:
        """The status that was made after the last write."""
        echo = -1
        for _ in range(self._patience.tries):
            values = self._block(registers.STATUS)
            echo = _whole(values, "echo")
            if echo == self._heartbeat:
                return values
        raise ProtocolError(
            f"the controller echoes heartbeat {echo}, not {self._heartbeat}; its answers are late, or another client "
            "writes to it"
        )

    def _block(self, block: registers.Block) -> dict[str, registers.Value]:
        sized = self._block_of[block.name]
        read = self._read(sized.address, sized.registers)
        registers.check_identity(read)
        values, _ = sized.decode(read)
        return values

    def _read(self, address: int, count: int) -> list[int]:
        try:
            return self._port.read(address, count)
        except LinkLostError:
            self._drop()
            raise


_AS_THEY_ARE = (
    "ack_sequence", "ack_result", "done_sequence", "done_result", "queue_depth", "fault_code", "boot", "owner",
    "heartbeat", "override", "path", "flags",
)  # fmt: skip


def _state_of(values: Mapping[str, registers.Value]) -> RobotState:
    code, axes = _whole(values, "fault_code"), _axes(values, "axes")
    if _whole(values, "n_axes") != len(axes):
        raise ProtocolError(
            f"the controller has {values['n_axes']} axes and said at the start that there are {len(axes)}"
        )
    try:
        mode = Mode(_whole(values, "mode"))
    except ValueError as error:
        raise ProtocolError(f"the controller reports mode {values['mode']}; there are 0 to {max(Mode)}") from error
    try:
        sentence = Fault(code).sentence
    except ValueError:
        sentence = f"fault {code} of this controller"
    standing = bool(_whole(values, "flags") & Flag.STANDS)
    return RobotState(
        mode, axes, standing, fault_sentence=sentence, **{name: _whole(values, name) for name in _AS_THEY_ARE}
    )


def _whole(values: Mapping[str, registers.Value], name: str) -> int:
    value = values[name]
    assert isinstance(value, int)
    return value


def _axes(values: Mapping[str, registers.Value], name: str) -> SetPoints:
    return np.array(values[name], dtype=np.int32)


class ModbusDriver(ControllerClient):
    """A controller behind Modbus TCP."""

    @classmethod
    def from_url(cls, url: DriverUrl, context: Context) -> "ModbusDriver":
        """Make the driver that a `modbus://` URL describes.

        Raises:
            DriverUrlError: if there is no host in it, or an option cannot be.
        """
        unit, patience = _unit(url), Patience.from_url(url)
        url.finish()
        if not url.host or url.path not in ("", "/"):
            raise DriverUrlError(f"'{url.text}' must name a host and no path: modbus://192.168.0.10:502?unit=1")
        clock = context.clock or RealTimeClock()
        port = ModbusPort.tcp(url.host, url.port or 502, unit, patience.answer)
        return _driver(cls, port, clock, patience, context)


class ModbusRtuDriver(ControllerClient):
    """A controller behind Modbus RTU."""

    @classmethod
    def from_url(cls, url: DriverUrl, context: Context) -> "ModbusRtuDriver":
        """Make the driver that a `modbus+rtu://` URL describes.

        Raises:
            DriverUrlError: if there is no port in it, or an option cannot be.
        """
        unit, baud = _unit(url), url.whole("baud", 115200, at_least=50)
        patience = Patience.from_url(url)
        url.finish()
        path = port_path(url)
        clock = context.clock or RealTimeClock()
        return _driver(cls, ModbusPort.rtu(path, baud, unit, patience.answer), clock, patience, context)


def _driver(kind: type[Client], port: ModbusPort, clock: Clock, patience: Patience, context: Context) -> Client:
    link = ModbusLink(port, clock, patience)
    link.say = context.say
    return kind(link, clock, context.limits, say=context.say)


def _unit(url: DriverUrl) -> int:
    unit = url.whole("unit", 1, at_least=1)
    if unit > 247:
        raise DriverUrlError(f"'{url.text}' has unit={unit}; a device address goes from 1 to 247")
    return unit
