"""Round trips of a state and of a command over each wire, with the controller in another process on this machine.

Loopback sockets and pseudo-terminals have no transfer time, so the rows measure only both programs, the operating
system and the library. A state over Modbus takes two telegrams, a written heartbeat and a read status. The last columns
have the transfer time of the same bytes at 115,200 baud (RTU with 11 bits, serial with 10 bits a byte). The row of the
bare line, a byte echoed by another process, is the best possible value of this machine.

`WIRE_ROUNDS` in the environment changes the 500 rounds.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Callable
from time import perf_counter, process_time
from typing import Any

import numpy as np

from cell.robot import model as robot
from drivers.client import ControllerClient
from drivers.contract import Reset, next_sequence
from drivers.limits import Limits
from drivers.registry import Context, open_driver
from drivers.wires import modbus_protocol as registers

FIGURE_MS = {"modbus": 3.0, "modbus-rtu": 15.0, "serial": 5.0}
"""Medians [ms] that are to be kept."""

BAUD = 115_200

_ECHO = (
    "import socket, sys\n"
    "s = socket.create_connection(('127.0.0.1', int(sys.argv[1])))\n"
    "s.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)\n"
    "while data := s.recv(64): s.sendall(data)\n"
)


def _timed(act: Callable[[], object], rounds: int) -> tuple[float, float, float]:
    """Return median and 99th percentile [ms], and the processor time of this process for one round [ms]."""
    for _ in range(20):
        act()
    durations, busy = [], process_time()
    for _ in range(rounds):
        began = perf_counter()
        act()
        durations.append(1000.0 * (perf_counter() - began))
    busy = 1000.0 * (process_time() - busy) / rounds
    return float(np.median(durations)), float(np.percentile(durations, 99)), busy


def _bytes(backend: str) -> tuple[int, int]:
    """Return the bytes of a state in both directions, and the bits of a byte."""
    if backend == "serial":
        return len(">00502,0010,STATE,4711*E559936D\r\n") + 100, 10
    fc16, fc04 = 9 + 2 * registers.COMMAND.registers + 8, 8 + 5 + 2 * registers.STATUS.for_axes(6).registers
    return fc16 + fc04, 11


def _bare_line(rounds: int) -> dict[str, Any]:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        process = subprocess.Popen([sys.executable, "-c", _ECHO, str(listener.getsockname()[1])])
        try:
            peer, _ = listener.accept()
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

            def echo() -> None:
                peer.sendall(b"x")
                peer.recv(64)

            median, p99, busy = _timed(echo, rounds)
            peer.close()
        finally:
            process.wait(10)
    return {
        "wire": "bare loopback socket",
        "state median [ms]": median,
        "state p99 [ms]": p99,
        "cpu of the client [ms]": busy,
    }


def run() -> list[dict[str, Any]]:
    """Return a row for each wire."""
    rounds = int(os.environ.get("WIRE_ROUNDS", "500"))
    rows = [_bare_line(rounds)]
    arm = Context(Limits.from_rad(robot.limits(robot.load())))
    for backend, figure in FIGURE_MS.items():
        command = [sys.executable, "-m", "cell", "emulate", backend]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
            try:
                assert process.stdout is not None
                driver = open_driver(process.stdout.readline().strip(), arm)
                assert isinstance(driver, ControllerClient)
                with driver:
                    driver.take()
                    state, state_p99, busy = _timed(driver.state, rounds)
                    link, sequence = driver._link, [driver.state().ack_sequence]

                    def reset(link: Any = link, sequence: list[int] = sequence) -> None:
                        sequence[0] = next_sequence(sequence[0])
                        link.send(sequence[0], Reset())

                    command_median, command_p99, _ = _timed(reset, rounds)
            finally:
                process.terminate()
                process.wait(20)
        n_bytes, bits = _bytes(backend)
        rows.append(
            {
                "wire": backend,
                "state median [ms]": state,
                "state p99 [ms]": state_p99,
                "cpu of the client [ms]": busy,
                "command median [ms]": command_median,
                "command p99 [ms]": command_p99,
                "figure, median [ms]": figure,
                "kept": max(state, command_median) < figure,
                "bytes of a state": n_bytes,
                "their time at 115200 [ms]": 1000.0 * n_bytes * bits / BAUD if backend != "modbus" else 0.0,
            }
        )
    return rows
