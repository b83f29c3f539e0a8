"""Real pseudo-terminals, sockets and processes: ports that vanish or cannot be, other speeds, restarts, two clients."""

import json
import os
import signal
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.robot import model as robot
from drivers.contract import Fault, Mode
from drivers.errors import LinkError, LinkLostError, ProtocolError, RefusedError, StateUnknownError
from drivers.limits import Limits
from drivers.registry import Context, open_driver
from drivers.setpoints import SetPoints, from_rad

ARM = Context(Limits.from_rad(robot.limits(robot.load())))

HOME = from_rad(np.radians([0.0, -90.0, 90.0, 0.0, 90.0, 0.0]))
PATIENT = "watchdog_ms=3000&timeout_ms=900"  # a slow machine is no fault


def turned(degrees: float) -> SetPoints:
    """(1, 6) home with A1 turned."""
    points = HOME[None].copy()
    points[0, 0] = round(degrees * 1e4)
    return points


@pytest.mark.parametrize("protocol", ["serial", pytest.param("modbus-rtu", marks=pytest.mark.slow)])
def test_a_controller_that_is_killed_and_comes_back(protocol: str, emulate: Callable[..., Any], tmp_path: Path) -> None:
    """While the arm moves: state unknown; then a stop opens the line again, and the arm stands where it was seen."""
    link = tmp_path / "kr16"
    first = emulate(protocol, "--link", str(link))
    driver = open_driver(first.url + "&" + PATIENT, ARM)
    with driver:

        def kill_while_moving() -> None:
            while not first.state.exists() or json.loads(first.state.read_text())["axes"][0] == 0:
                time.sleep(0.02)
            first.process.kill()

        killer = threading.Thread(target=kill_while_moving)
        killer.start()
        with pytest.raises(StateUnknownError):
            driver.move(turned(150.0), 0.2)
        killer.join()
        first.process.wait(20)
        link.unlink()  # as a plug that is pulled; the pseudo-terminal's number may be another process's by now
        with pytest.raises(LinkError):
            driver.state()
        (entry,) = first.entries("move")
        assert entry["set_points"] == turned(150.0).tolist()
        again = emulate(protocol, "--link", str(link), beside=first)
        assert again.url == first.url
        state = driver.stop()
        assert state.fault_code == Fault.RESTARTED
        assert 0 < state.axes[0] < 1_500_000
        assert state.axes.tolist() == again.entries("start")[1]["axes"]
        driver.reset()
        assert driver.move(state.axes[None].copy(), 1.0).mode is Mode.IN_POSITION


def test_a_client_that_goes_away_leaves_a_standing_arm(emulate: Callable[..., Any]) -> None:
    """Its socket closed in the middle of a move: the watchdog stops the arm; the next client hears why, and where."""
    emulated = emulate("modbus", "--time-scale", "2")
    lost = open_driver(emulated.url + "&watchdog_ms=600&timeout_ms=200", ARM)
    lost.connect()
    lost.take()
    lost._link.send(lost.state().ack_sequence + 1, _move(170.0, 0.05))  # type: ignore[attr-defined] # as a killed one
    lost._link.close()  # type: ignore[attr-defined] # without the stop of close()
    with open_driver(emulated.url + "&" + PATIENT, ARM) as driver:
        deadline = threading.Event()
        for _ in range(200):  # looking feeds no watchdog
            if driver.state().fault_code and driver.state().at_rest:
                break
            deadline.wait(0.05)
        state = driver.state()
        assert (state.mode, state.fault_code) == (Mode.FAULT, Fault.WATCHDOG)
        with pytest.raises(RefusedError, match="reset first"):
            driver.move(turned(0.0), 1.0)
        assert driver.reset().fault_code == 0


def _move(degrees: float, speed: float) -> Any:
    from drivers.contract import Move

    return Move(turned(degrees), speed)


def test_two_clients_on_one_controller_are_one_owner_at_a_time(emulate: Callable[..., Any]) -> None:
    """The second takes the arm from a silent first, who says so and sends nothing before a stop; anybody may stop."""
    emulated = emulate("modbus", "--time-scale", "200")
    short = emulated.url + "&watchdog_ms=900&timeout_ms=300"
    with open_driver(short, ARM) as one, open_driver(short, ARM) as two:
        one.move(turned(1.0), 1.0)
        two.move(turned(2.0), 1.0)  # waits for the silence of the first
        with pytest.raises(StateUnknownError, match="owns the arm now"):
            one.move(turned(3.0), 1.0)
        one.stop()
        with pytest.raises(StateUnknownError, match="another client has stopped the arm"):
            two.move(turned(2.0), 1.0)
        assert one.move(turned(3.0), 1.0).axes.tolist() == turned(3.0)[0].tolist()
    assert [entry["set_points"][0][0] for entry in emulated.entries("move")] == [10_000, 20_000, 30_000]


def test_the_arm_stands_where_it_stood_and_ctrl_c_is_a_clean_end(emulate: Callable[..., Any]) -> None:
    """After an end in order no fault is latched; the position is that of the last move, to the count."""
    first = emulate("modbus", "--time-scale", "200")
    with open_driver(first.url, ARM) as driver:
        driver.move(turned(12.3456), 1.0)
    assert first.end(signal.SIGINT) == 0
    second = emulate("modbus", beside=first)
    with open_driver(second.url, ARM) as driver:
        state = driver.state()
        assert (state.axes[0], state.fault_code, state.ack_sequence) == (123_456, 0, 0)
        assert state.boot == 2


def test_a_pseudo_terminal_at_another_speed_is_rubbish_and_says_so(emulate: Callable[..., Any]) -> None:
    """A serial line at 9,600 baud against a client at 115,200; at the right speed the same port works."""
    emulated = emulate("serial", "--baud", "9600")
    path = emulated.url.split("?")[0]
    with pytest.raises(LinkError, match=r"baud rate|no answer"):
        open_driver(path + "?baud=115200", ARM).connect()
    with open_driver(emulated.url, ARM) as driver:
        assert driver.state().mode is Mode.IDLE
    with open_driver(emulated.url, ARM) as one, pytest.raises(LinkLostError, match="cannot be opened"):
        open_driver(emulated.url, ARM).connect()
    assert one is not None


def test_ports_that_cannot_be(tmp_path: Path) -> None:
    """Missing, a file, read-only, a closed port, a mute one: one sentence each, of ours."""
    read_only = tmp_path / "read_only"
    read_only.write_bytes(b"")
    read_only.chmod(0o444)
    for url in (
        f"serial://{tmp_path}/nothing",
        f"serial://{read_only}",
        f"modbus+rtu://{tmp_path}/nothing",
        f"modbus+rtu://{read_only}",
        "serial:///dev/null",
    ):
        with pytest.raises(LinkError, match="cannot be opened") as error:
            open_driver(url, ARM).connect()
        assert error.value.__cause__ is not None or "modbus" in url
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))
        port = closed.getsockname()[1]
        with pytest.raises(LinkLostError, match="cannot be opened"):
            open_driver(f"modbus://127.0.0.1:{port}", ARM).connect()
        closed.listen()
        with pytest.raises(LinkError, match=r"no answer|is gone"):
            open_driver(f"modbus://127.0.0.1:{port}?timeout_ms=50&watchdog_ms=150", ARM).connect()


@pytest.mark.skipif(os.name != "posix", reason="pseudo-terminals")
def test_a_port_that_gives_up_writing_is_a_lost_line() -> None:
    """The other end of a pseudo-terminal is closed under the client."""
    from drivers.wires.serial_link import SerialPort

    controller, peer = os.openpty()
    port = SerialPort(os.ttyname(peer), 115200)
    port.open()
    os.close(peer)
    os.close(controller)

    def use() -> None:
        for _ in range(3):
            port.write(b"x")
            port.read(0.05)

    with pytest.raises(LinkLostError, match=r"any more"):
        use()
    port.close()
    port.close()


def test_a_device_that_speaks_something_else_is_a_protocol_error() -> None:
    """A web server at the port: its bytes are no Modbus; no exception of the library comes through."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        port = listener.getsockname()[1]
        stop = threading.Event()

        def serve() -> None:
            listener.settimeout(0.1)
            while not stop.is_set():
                try:
                    peer, _ = listener.accept()
                except TimeoutError:
                    continue
                with peer:
                    peer.recv(64)
                    peer.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n")

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            with pytest.raises(LinkError):
                open_driver(f"modbus://127.0.0.1:{port}?timeout_ms=100&watchdog_ms=300", ARM).connect()
        finally:
            stop.set()
            thread.join()


def test_protocol_errors_are_link_errors() -> None:
    """So that a program can catch the wire as one."""
    assert issubclass(ProtocolError, LinkError)
