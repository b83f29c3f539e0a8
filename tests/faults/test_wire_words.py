"""Messages and options of the wires: echoing adapters, units, Windows ports, no sentence of a library."""

import re
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from drivers.clock import RealTimeClock
from drivers.emulated.endpoint import Endpoint
from drivers.emulated.serve import PtyLine, Server, TcpLine
from drivers.emulated.stations import ModbusStation, SerialStation
from drivers.errors import DriverError, DriverUrlError, LinkError, ProtocolError
from drivers.registry import Context, DriverUrl, open_driver
from drivers.simulated_controller import IdealPlant
from drivers.wire import port_path
from tests.support.driver_bench import HOME_Q, KR16, Journal, make_bench

pytestmark = pytest.mark.real_time

LIBRARY = re.compile(r"retries|Modbus Error|Errno|Exception|Traceback|device_id|<.*object")
PATIENCE = "timeout_ms=600&watchdog_ms=3000"


class EchoingLine(PtyLine):
    """A pseudo-terminal whose adapter returns every byte that the client sends.

    Args:
        pieces: the echo arrives "whole", byte by byte ("bytes"), or in one piece with the answer ("merged").
    """

    def __init__(self, pieces: str = "whole") -> None:
        super().__init__()
        self._pieces, self._echo = pieces, b""

    def receive(self, seconds: float) -> list[tuple[int, bytes]]:
        received = super().receive(seconds)
        for peer, data in received:
            match self._pieces:
                case "whole":
                    super().send(peer, data)
                case "bytes":
                    for index in range(len(data)):
                        super().send(peer, data[index : index + 1])
                        time.sleep(0.002)
                case "merged":
                    self._echo += data
        return received

    def send(self, peer: int, data: bytes) -> None:
        echo, self._echo = self._echo, b""
        super().send(peer, echo + data)


@contextmanager
def served(line: PtyLine | TcpLine, *, rtu: bool = True, unit: int = 1, serial: bool = False) -> Iterator[None]:
    """Serve a controller on a line in a thread."""
    clock, ended = RealTimeClock(), threading.Event()
    endpoint = Endpoint(IdealPlant(HOME_Q), KR16, clock, clock, Journal())
    station = SerialStation(endpoint) if serial else ModbusStation(endpoint, rtu=rtu, unit=unit)
    thread = threading.Thread(target=Server(station, line, clock).serve, args=(ended.is_set,), daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join(10.0)
        line.close()


@pytest.mark.parametrize("pieces", ["whole", "bytes", "merged"])
def test_an_echoing_adapter_is_recognised_and_coped_with(pieces: str) -> None:
    """Without the option the message names echo and option; with it the controller is driven."""
    line = EchoingLine(pieces)
    with served(line):
        url = f"modbus+rtu://{line.name}?{PATIENCE}"
        with pytest.raises(ProtocolError, match=r"RS-485 adapter with echo.*option echo") as error:
            open_driver(url, Context(KR16)).connect()
        assert not LIBRARY.search(str(error.value))
        with open_driver(f"{url}&echo", Context(KR16)) as driver:
            assert driver.state().axes.tolist() == [0, -900000, 900000, 0, 900000, 0]


def test_an_echo_that_is_promised_and_missing() -> None:
    """The option echo on an adapter without echo is a message about the option."""
    line = PtyLine()
    with served(line), pytest.raises(LinkError, match="echo"):
        open_driver(f"modbus+rtu://{line.name}?{PATIENCE}&echo", Context(KR16)).connect()


def test_the_serial_wire_ignores_an_echo_and_names_a_line_with_nothing_else() -> None:
    """An echo before the answer is skipped; an echo alone is named."""
    line = EchoingLine()
    with served(line, serial=True), open_driver(f"serial://{line.name}?{PATIENCE}", Context(KR16)) as driver:
        assert driver.state().at_rest
    bench = make_bench("serial")
    write = bench.port.write

    def echo_only(data: bytes) -> None:
        write(data)
        bench.line.to_client = data

    bench.port.write = echo_only
    with pytest.raises(LinkError, match=r"received its own request and no answer to HELLO.*controller is silent"):
        bench.driver.connect()


@pytest.mark.parametrize("unit", [0, 255])
def test_units_of_devices_without_a_line(unit: int) -> None:
    """Units 0 and 255 are accepted over TCP; on a line they are not."""
    line = TcpLine()
    with (
        served(line, rtu=False, unit=unit),
        open_driver(f"modbus://127.0.0.1:{line.port}?unit={unit}&{PATIENCE}", Context(KR16)) as driver,
    ):
        assert driver.state().at_rest
    with pytest.raises(DriverUrlError, match="1"):
        open_driver(f"modbus+rtu:///dev/ttyUSB0?unit={unit}", Context(KR16))


@pytest.mark.parametrize(
    ("url", "path"),
    [
        ("serial:///COM3", r"\\.\COM3"),
        ("serial://COM3?baud=9600", r"\\.\COM3"),
        ("serial:///com12", r"\\.\COM12"),
        (r"serial:///\\.\COM12", r"\\.\COM12"),
        (r"serial://\\.\COM12", r"\\.\COM12"),
        ("modbus+rtu:///%5C%5C.%5CCOM12", r"\\.\COM12"),
        ("serial:///dev/ttyUSB0", "/dev/ttyUSB0"),
        ("serial:///dev/COM3", "/dev/COM3"),
    ],
)
def test_ports_of_windows(url: str, path: str) -> None:
    """COM ports are accepted in every usual form; other paths stay as they are."""
    assert port_path(DriverUrl(url)) == path


@pytest.mark.parametrize(
    "url",
    ["modbus://127.0.0.1:1", "modbus+rtu:///dev/no-such-port", "serial:///dev/no-such-port", "serial:///dev/null",
     "modbus+rtu:///dev/null"],
)  # fmt: skip
def test_no_sentence_of_a_library(url: str) -> None:
    """Missing, refused and unsuitable ports are named in plain words with a cure."""
    with pytest.raises(DriverError) as error:
        open_driver(f"{url}?timeout_ms=100&watchdog_ms=300", Context(KR16)).connect()
    assert not LIBRARY.search(str(error.value)), error.value
    assert "check" in str(error.value)


def test_a_silent_device() -> None:
    """A device that does not answer is named with its unit."""
    line = TcpLine()
    with (
        served(line, rtu=False, unit=9),
        pytest.raises(LinkError, match="gave no answer of unit 1 in time; check cable, unit, baud rate") as error,
    ):
        open_driver(f"modbus://127.0.0.1:{line.port}?timeout_ms=100&watchdog_ms=300", Context(KR16)).connect()
    assert not LIBRARY.search(str(error.value))
