"""Devices that answer with anything: opening a driver ends within its limits, in one sentence."""

import contextlib
import os
import pty
import socket
import struct
import threading
import time
import tty
from collections.abc import Callable, Iterator

import pytest

from drivers.errors import DriverError
from drivers.registry import Context, open_driver
from tests.support.driver_bench import KR16

pytestmark = pytest.mark.real_time

_SHORT = "timeout_ms=100&watchdog_ms=300"
_MAX_S = 10.0
"""Longest allowed time; tries of 0.3 s, and a loaded machine."""


def _flood(piece: bytes, pause_s: float = 0.0) -> Callable[[bytes], Iterator[bytes]]:
    """Return an answer without end, faster than it is read or a byte at a time."""

    def answer(_: bytes) -> Iterator[bytes]:
        while True:
            yield piece
            time.sleep(pause_s)

    return answer


def _telegram(request: bytes, body: bytes) -> bytes:
    return request[:2] + struct.pack(">HHB", 0, len(body) + 1, request[6]) + body


def _registers(value: bytes) -> Callable[[bytes], Iterator[bytes]]:
    """Return an answer that fills every read register with a value, and accepts every write."""

    def answer(request: bytes) -> Iterator[bytes]:
        count = struct.unpack(">H", request[10:12])[0]
        read = request[7] == 4
        yield _telegram(request, bytes([4, 2 * count]) + value * count if read else request[7:12])

    return answer


def _drip(request: bytes) -> Iterator[bytes]:
    for byte in _telegram(request, b"\x04\xfa" + bytes(250)):
        yield bytes([byte])
        time.sleep(0.09)


DEVICES: dict[str, Callable[[bytes], Iterator[bytes]]] = {
    "a flood of noise": _flood(b"\xff" * 4096),
    "a flood of beginnings": _flood(b"<" * 4096),
    "a flood without an end of line": _flood(b"<00001,0001,HELLO," * 256),
    "a flood of telegrams": _flood(b"\x00\x07\x00\x00\x00\x05\x01\x04\x02\x00\x00" * 100),
    "a byte at a time": _flood(b"0", 0.05),
    "silence": lambda request: iter(()),
    "a web server": lambda request: iter([b"HTTP/1.1 400 Bad Request\r\n\r\n" + b"x" * 100_000]),
    "an echo": lambda request: iter([request]),
}
MODBUS: dict[str, Callable[[bytes], Iterator[bytes]]] = {
    "registers of 0": _registers(b"\x00\x00"),
    "registers of 65535": _registers(b"\xff\xff"),
    "a slow answer": _drip,
    "a wrong length": lambda request: iter([_telegram(request, bytes([request[7], 3, 0, 0, 0]))]),
    "a length of 0": lambda request: iter([request[:2] + bytes(4)] * 50),
    "always busy": lambda request: iter([_telegram(request, bytes([request[7] | 0x80, 6]))]),
    "another function": lambda request: iter([_telegram(request, bytes([0x2B, 14, 1, 0, 0]))]),
}


def _refused(url: str) -> str:
    """Return the error of opening a driver."""
    began = time.monotonic()
    with pytest.raises(DriverError) as error, open_driver(url, Context(KR16)):
        pass
    assert time.monotonic() - began < _MAX_S
    message = str(error.value)
    assert "\n" not in message
    return message


@pytest.mark.parametrize("device", {**DEVICES, **MODBUS})
def test_a_hostile_network_device(device: str) -> None:
    """Each device on Modbus TCP is refused with the address."""
    answer = {**DEVICES, **MODBUS}[device]

    def serve(server: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while True:
                line, _ = server.accept()
                threading.Thread(target=talk, args=(line,), daemon=True).start()

    def talk(line: socket.socket) -> None:
        with contextlib.suppress(OSError), line:
            while request := line.recv(4096):
                for piece in answer(request):
                    line.sendall(piece)

    with socket.create_server(("127.0.0.1", 0)) as server:
        threading.Thread(target=serve, args=(server,), daemon=True).start()
        port = server.getsockname()[1]
        message = _refused(f"modbus://127.0.0.1:{port}?{_SHORT}")
        server.shutdown(socket.SHUT_RDWR)
    assert f"127.0.0.1:{port}" in message or message.startswith("register 0 reads")


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("protocol", ["serial", "modbus+rtu"])
def test_a_hostile_serial_device(device: str, protocol: str) -> None:
    """Each device on a serial line is refused with its port."""
    controller, client = pty.openpty()
    tty.setraw(client)
    port = os.ttyname(client)
    is_open = threading.Event()
    is_open.set()

    def talk() -> None:
        with contextlib.suppress(OSError):
            while is_open.is_set():
                for piece in DEVICES[device](os.read(controller, 4096)):
                    os.write(controller, piece)
                    if not is_open.is_set():
                        return

    thread = threading.Thread(target=talk, daemon=True)
    thread.start()
    try:
        assert port in _refused(f"{protocol}://{port}?{_SHORT}")
    finally:
        is_open.clear()
        os.close(client)
        os.close(controller)
