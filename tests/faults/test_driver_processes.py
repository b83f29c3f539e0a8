"""Real pseudo-terminals, sockets and processes: lost and unusable ports, restarts, several clients, a short soak."""

import json
import os
import signal
import socket
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.soak import EVERY_FAULT, PATIENCE, Soak, drive, judge
from cell.runs.run import open_run
from drivers.contract import Fault, Mode, Move
from drivers.errors import LinkError, LinkLostError, RefusedError, StateUnknownError
from drivers.limits import Limits
from drivers.registry import Context, open_driver
from drivers.wires.serial_link import SerialPort
from tests.support.driver_bench import KR16, WIRES, turned
from tests.support.fixture_types import Emulate

pytestmark = pytest.mark.real_time

ARM = Context(KR16)
LONG_TIMEOUTS = "watchdog_ms=1800&timeout_ms=600"  # a slow machine is no fault


@pytest.mark.parametrize("protocol", ["serial", pytest.param("modbus-rtu", marks=pytest.mark.slow)])
def test_a_killed_controller_comes_back(protocol: str, emulate: Emulate, tmp_path: Path) -> None:
    """Killed during a move: state unknown; then a stop opens the line again, and the arm kept its position."""
    link = tmp_path / "kr16"
    first = emulate(protocol, "--link", str(link))
    driver = open_driver(first.url + "&" + LONG_TIMEOUTS, ARM)
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
        link.unlink()  # like an unplugged cable; another process may have the pseudo-terminal's number by now
        with pytest.raises(LinkError):
            driver.state()
        (move,) = first.entries("move")
        assert move["set_points"] == turned(150.0).tolist()
        second = emulate(protocol, "--link", str(link), partner=first)
        assert second.url == first.url
        state = driver.stop()
        assert state.fault_code == Fault.RESTARTED
        assert 0 < state.axes[0] < 1_500_000
        assert state.axes.tolist() == second.entries("start")[1]["axes"]
        driver.reset()
        assert driver.move(state.axes[None].copy(), 1.0).mode is Mode.IN_POSITION


def test_the_watchdog_stops_the_arm_of_a_lost_client(emulate: Emulate) -> None:
    """A socket closes during a move; the next client reads the fault and resets it."""
    emulated = emulate("modbus", "--time-scale", "2")
    client: Any = open_driver(emulated.url + "&watchdog_ms=600&timeout_ms=200", ARM)
    client.connect()
    client.take()
    client._link.send(client.state().ack_sequence + 1, Move(turned(170.0), 0.05))
    client._link.close()  # without the stop of close()
    with open_driver(emulated.url + "&" + LONG_TIMEOUTS, ARM) as driver:
        for _ in range(200):  # reading feeds no watchdog
            if driver.state().fault_code and driver.state().at_rest:
                break
            time.sleep(0.05)
        state = driver.state()
        assert (state.mode, state.fault_code) == (Mode.FAULT, Fault.WATCHDOG)
        with pytest.raises(RefusedError, match="reset first"):
            driver.move(turned(0.0), 1.0)
        assert driver.reset().fault_code == 0


def test_two_clients_are_one_owner_at_a_time(emulate: Emulate) -> None:
    """The second client takes the arm from a silent first one, which must stop before its next move. Both may stop."""
    emulated = emulate("modbus", "--time-scale", "200")
    url = emulated.url + "&watchdog_ms=900&timeout_ms=300"
    with open_driver(url, ARM) as one, open_driver(url, ARM) as two:
        one.move(turned(1.0), 1.0)
        two.move(turned(2.0), 1.0)  # waits for the silence of the first
        with pytest.raises(StateUnknownError, match="owns the arm now"):
            one.move(turned(3.0), 1.0)
        one.stop()
        with pytest.raises(StateUnknownError, match="another client has stopped the arm"):
            two.move(turned(2.0), 1.0)
        assert one.move(turned(3.0), 1.0).axes.tolist() == turned(3.0)[0].tolist()
    assert [entry["set_points"][0][0] for entry in emulated.entries("move")] == [10_000, 20_000, 30_000]


def test_ctrl_c_ends_an_emulator_in_order(emulate: Emulate) -> None:
    """No fault is latched after it, and the position is that of the last move, to the count."""
    first = emulate("modbus", "--time-scale", "200")
    with open_driver(first.url, ARM) as driver:
        driver.move(turned(12.3456), 1.0)
    assert first.end(signal.SIGINT) == 0
    second = emulate("modbus", partner=first)
    with open_driver(second.url, ARM) as driver:
        state = driver.state()
        assert (state.axes[0], state.fault_code, state.ack_sequence) == (123_456, 0, 0)
        assert state.boot == 2


def test_a_wrong_baud_rate(emulate: Emulate) -> None:
    """9,600 baud against 115,200 is an error; at the right speed the same port works."""
    emulated = emulate("serial", "--baud", "9600")
    path = emulated.url.split("?")[0]
    with pytest.raises(LinkError, match=r"baud rate|no answer"):
        open_driver(path + "?baud=115200", ARM).connect()
    with open_driver(emulated.url, ARM) as driver:
        assert driver.state().fault_code == 0


def test_unusable_ports(tmp_path: Path) -> None:
    """A missing port, a file, a read-only, a closed and a mute port each give a driver error."""
    read_only = tmp_path / "read_only"
    read_only.write_bytes(b"")
    read_only.chmod(0o444)
    paths = [f"{scheme}://{path}" for scheme in ("serial", "modbus+rtu") for path in (f"{tmp_path}/nothing", read_only)]
    for url in (*paths, "serial:///dev/null"):
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
def test_a_vanished_port_is_a_lost_line() -> None:
    """Closing the other end of a pseudo-terminal is reported as a lost line."""
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


def test_another_protocol_at_the_port_is_a_link_error() -> None:
    """A web server at the port gives a link error and no exception of the library."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        listener.settimeout(0.1)
        port, stop = listener.getsockname()[1], threading.Event()

        def serve() -> None:
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


@pytest.mark.parametrize(
    ("moves", "axes"), [(6, 7), *(pytest.param(*each, marks=pytest.mark.slow) for each in ((6, 6), (60, 6), (60, 7)))]
)
def test_a_soak_over_real_processes(moves: int, axes: int, emulate: Emulate, request: pytest.FixtureRequest) -> None:
    """Moves of the arm, and of arm and rotary table, with 2 % of every fault over all wires in parallel."""
    run = () if axes == 6 else ("--run", str(request.getfixturevalue("turned")))
    limits = KR16 if axes == 6 else Limits.from_rad(open_run(Path(run[1])).motion.limits)
    faults = EVERY_FAULT.replace("=0.01", "=0.02")
    running = [emulate(name, "--time-scale", "40", "--faults", faults, "--seed", "3", *run) for name in WIRES]
    results: dict[int, Soak] = {}

    def soak(k: int) -> None:
        url = running[k].url
        driver = open_driver(f"{url}{'&' if '?' in url else '?'}{PATIENCE}", Context(limits))
        results[k] = drive(driver, moves, np.random.default_rng(k))

    threads = [threading.Thread(target=soak, args=(k,)) for k in range(len(running))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for k, emulated in enumerate(running):
        assert emulated.end() == 0
        verdict = judge(results[k], emulated.entries())
        assert verdict.clean, (verdict, results[k].outcomes)
        assert len(results[k].commanded) == moves
