"""Test bench for drivers: client, wire in memory, faults and controller in one thread on one simulated clock."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from drivers.client import ControllerClient
from drivers.clock import SimulatedClock
from drivers.contract import RobotState
from drivers.emulated import stations
from drivers.emulated.endpoint import Endpoint, Event
from drivers.emulated.faults import Injector, parse_faults
from drivers.emulated.serve import Server
from drivers.emulated.stations import ModbusStation, SerialStation, Station
from drivers.errors import AnswerTimeoutError, LinkLostError, ProtocolError
from drivers.limits import Limits
from drivers.setpoints import SetPoints, from_rad
from drivers.simulated_controller import IdealPlant
from drivers.wire import ReopeningLink, Timeouts
from drivers.wires.modbus_link import ModbusLink
from drivers.wires.serial_link import SerialLink
from tests.support.arms import KR16

TIMEOUTS = Timeouts(answer=0.08, watchdog=0.5, poll=0.01)
STEP = 0.01
HOME_Q = np.radians([0.0, -90.0, 90.0, 0.0, 90.0, 0.0])
HOME = from_rad(HOME_Q)
WIRES = ("serial", "modbus", "modbus-rtu")


def turned(*degrees: float) -> SetPoints:
    """Return via points (N, 6): home with A1 at these angles [deg]."""
    points = np.tile(HOME, (len(degrees), 1))
    points[:, 0] = np.round(np.array(degrees) * 1e4)
    return points


@dataclass
class Journal:
    """Recorder in memory."""

    entries: list[Event] = field(default_factory=list)
    states: list[RobotState] = field(default_factory=list)

    def record_event(self, event: Event) -> None:
        self.entries.append(event)

    def record_state(self, state: RobotState) -> None:
        self.states.append(state)

    def of(self, event: str) -> list[Event]:
        return [entry for entry in self.entries if entry["event"] == event]


class MemoryLine:
    """Both ends of a wire: a `drivers.emulated.serve.Line` for the server, bytes for the client."""

    name = "memory"

    def __init__(self) -> None:
        self.to_server: list[tuple[int, bytes]] = []
        self.to_client = b""
        self.connection = 1
        self.lost = False

    def receive(self, seconds: float) -> list[tuple[int, bytes]]:
        arrived, self.to_server = self.to_server, []
        return arrived

    def send(self, peer: int, data: bytes) -> None:
        if peer == self.connection:
            self.to_client += data

    def drop_connections(self) -> None:
        self.lost = True

    def disconnect(self, peer: int) -> None:
        self.lost = True

    def close(self) -> None:
        pass


class BenchClock(SimulatedClock):
    """Simulated clock that executes the server at each step."""

    step: Callable[[], None] = staticmethod(lambda: None)

    def wait(self, seconds: float) -> None:
        left = seconds
        while left > 0.0:
            step = min(STEP, left)
            super().wait(step)
            left -= step
            self.step()


class FastClock:
    """Clock of the arm, `scale` times as fast as the clock of the wire."""

    simulated = True

    def __init__(self, clock: BenchClock, scale: float) -> None:
        self._clock, self._scale = clock, scale

    def now(self) -> float:
        return self._clock.now() * self._scale

    def wait(self, seconds: float) -> None:
        self._clock.wait(seconds / self._scale)


class BytePort:
    """A `drivers.wires.serial_link.Port` on a memory line."""

    name = "memory"

    def __init__(self, line: MemoryLine, clock: BenchClock) -> None:
        self.line, self.clock = line, clock
        self.is_open = False

    def open(self) -> None:
        self.is_open = True
        self.line.lost = False
        self.line.to_client = b""

    def close(self) -> None:
        self.is_open = False

    def write(self, data: bytes) -> None:
        if not self.is_open:
            raise LinkLostError("the port is closed")
        self.line.to_client = b""
        self.line.to_server.append((self.line.connection, data))
        self.clock.step()

    def read(self, seconds: float) -> bytes:
        left = seconds
        while not self.line.to_client and left > 0.0:
            self.clock.wait(min(STEP, left))
            left -= STEP
        data, self.line.to_client = self.line.to_client, b""
        return data


class RegisterPort:
    """A `drivers.wires.modbus_link.Port` on a memory line, with a Modbus client of the tests instead of pymodbus."""

    name = "memory"

    def __init__(self, line: MemoryLine, clock: BenchClock, *, rtu: bool, unit: int = 1) -> None:
        self.line, self.clock, self.rtu, self.unit = line, clock, rtu, unit
        self.transaction = 0
        self.is_open = False

    def open(self) -> None:
        self.is_open, self.line.lost, self.line.to_client = True, False, b""
        self.line.connection += 1

    def close(self) -> None:
        self.is_open = False

    def read(self, address: int, count: int) -> list[int]:
        pdu = self._exchange(b"\x04" + address.to_bytes(2, "big") + count.to_bytes(2, "big"))
        if pdu[0] != 4 or len(pdu) != 2 + 2 * count:
            raise ProtocolError("another telegram")
        return [int.from_bytes(pdu[k : k + 2], "big") for k in range(2, len(pdu), 2)]

    def write(self, address: int, values: list[int]) -> None:
        head = b"\x10" + address.to_bytes(2, "big") + len(values).to_bytes(2, "big") + bytes([2 * len(values)])
        pdu = self._exchange(head + b"".join(value.to_bytes(2, "big") for value in values))
        if pdu[0] != 16:
            raise ProtocolError("another telegram")

    def _exchange(self, pdu: bytes) -> bytes:
        if not self.is_open or self.line.lost:
            self.close()
            raise LinkLostError("the connection is closed")
        self.transaction = (self.transaction + 1) % 65536
        header = stations.Header(self.unit, None if self.rtu else self.transaction)
        self.line.to_client = b"" if self.rtu else self.line.to_client
        self.line.to_server.append((self.line.connection, stations.pack(header, pdu)))
        self.clock.step()
        waited, received = 0.0, b""
        while waited < TIMEOUTS.answer:
            received, self.line.to_client = received + self.line.to_client, b""
            answer = self._answer(received, header)
            if answer is not None:
                if answer[0] & 0x80:
                    raise ProtocolError(f"exception {answer[1]}")
                return answer
            if self.line.lost:
                break
            self.clock.wait(STEP)
            waited += STEP
        if not self.rtu:
            self.close()
        raise AnswerTimeoutError("no answer")

    def _answer(self, received: bytes, header: stations.Header) -> bytes | None:
        """Return the first complete telegram; on TCP the telegram with the number of the request."""
        if self.rtu:
            sizes = {0x10: 8, 0x84: 5, 0x90: 5}
            for begin in range(len(received) - 4):
                size = sizes.get(received[begin + 1], 5 + received[begin + 2])
                unpacked = stations.parse_rtu(received[begin : begin + size])
                if unpacked and unpacked[0].unit == self.unit:
                    return unpacked[1]
            return None
        cut = stations.split_tcp(received)
        for packet in cut[0] if cut else []:
            unpacked = stations.parse_tcp(packet)
            if unpacked and unpacked[0] == header:
                return unpacked[1]
        return None


@dataclass
class Bench:
    """A client, a wire and a controller.

    Attributes:
        driver: the client.
        link: the link of the client.
        port: the client's end of the wire.
        line: the wire.
        clock: the simulated clock of all parts.
        endpoint: the controller.
        server: the loop of the controller.
        journal: executed commands.
    """

    driver: ControllerClient
    link: ReopeningLink
    port: Any
    line: MemoryLine
    clock: BenchClock
    endpoint: Endpoint
    server: Server
    journal: Journal


def make_bench(backend: str, faults: str = "", seed: int = 0, time_scale: float = 1.0, limits: Limits = KR16) -> Bench:
    """Return a test bench.

    Args:
        backend: one of `WIRES`.
        faults: list of faults.
        seed: seed of the faults.
        time_scale: speed of the arm's clock relative to the wire's.
        limits: limits of the arm, for client and controller.
    """
    clock, journal, line = BenchClock(), Journal(), MemoryLine()
    start = np.concatenate([HOME_Q, np.zeros(len(limits.lower) - len(HOME_Q))])
    endpoint = Endpoint(IdealPlant(start), limits, FastClock(clock, time_scale), clock, journal, time_scale=time_scale)
    station: Station
    link: ReopeningLink
    port: BytePort | RegisterPort
    if backend == "serial":
        station, port = SerialStation(endpoint), BytePort(line, clock)
        link = SerialLink(port, clock, TIMEOUTS, first_query=100)
    else:
        rtu = backend == "modbus-rtu"
        station, port = ModbusStation(endpoint, rtu=rtu), RegisterPort(line, clock, rtu=rtu)
        link = ModbusLink(port, clock, TIMEOUTS, first_heartbeat=100)
    injector = Injector(parse_faults(faults), np.random.default_rng(seed)) if faults else None
    server = Server(station, line, clock, injector, time_scale)
    clock.step = server.step
    return Bench(ControllerClient(link, clock, limits), link, port, line, clock, endpoint, server, journal)


def on_one_wire(cases: Iterable[Any]) -> list[Any]:
    """Return pytest parameters (case, wire). Each case is in the default suite on one wire and slow on the others."""
    return [
        pytest.param(case, wire, marks=() if wire == WIRES[k % len(WIRES)] else pytest.mark.slow)
        for k, case in enumerate(cases)
        for wire in WIRES
    ]
