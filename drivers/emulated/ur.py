"""An emulated controller of Universal Robots on the loopback interface: RTDE and the secondary interface.

It executes the statements of URScript that `drivers.wires.ur_link` sends (movej, stopj, integer registers,
comparisons of registers, rtde_set_watchdog) and refuses every other program, as a controller refuses one with a syntax
error. Any RTDE client can read it. One loop serves it; no thread.
"""

import contextlib
import math
import re
import select
import socket
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from drivers.clock import Clock
from drivers.emulated.serve import LOOPBACK, listen
from drivers.profile import Reference, interpolate, resting
from drivers.setpoints import Floats
from drivers.wires import rtde
from drivers.wires.rtde import Package, Recipe
from drivers.wires.ur_link import PAUSED, PLAYING, ROBOT_RUNNING, STOPPED

NORMAL, PROTECTIVE_STOP, EMERGENCY_STOP = 1, 3, 7
"""Values of safety_mode."""

_N_REGISTERS = 48
_MAX_STEP = 0.008  # longest wait of the loop [s]
_JOINTS = r"\[((?:d2r\(-?[\d.]+\)(?:, )?){6})\]"

_TYPES: Final = {
    "timestamp": "DOUBLE", "actual_q": "VECTOR6D", "actual_qd": "VECTOR6D", "target_q": "VECTOR6D",
    "target_qd": "VECTOR6D", "robot_mode": "INT32", "safety_mode": "INT32", "runtime_state": "UINT32",
    "target_speed_fraction": "DOUBLE", "speed_scaling": "DOUBLE", "actual_execution_time": "DOUBLE",
    "robot_status_bits": "UINT32", "safety_status_bits": "UINT32",
    **{f"{kind}_int_register_{number}": "INT32" for kind in ("input", "output") for number in range(_N_REGISTERS)},
}  # fmt: skip


@dataclass
class _Client:
    """One RTDE client."""

    connection: socket.socket
    rest: bytes = b""
    outputs: Recipe | None = None
    inputs: Recipe | None = None
    period: float = 0.008
    due: float = math.inf


@dataclass
class _Program:
    """A running program: its statements, the place in them, and the watchdog."""

    lines: list[str]
    at: int = 0
    watchdog: tuple[str, float] | None = None


@dataclass
class UrController:
    """State of the emulated controller.

    Attributes:
        q: (6,) axes [rad].
        clock: real time.
        safety_mode: `NORMAL`, `PROTECTIVE_STOP` or `EMERGENCY_STOP`.
        robot_mode: `ROBOT_RUNNING`, or a mode in which no program runs.
        is_remote: whether programs are accepted (remote control).
        is_paused: whether a person paused the program.
        inputs: integer input registers.
        outputs: integer output registers.
        moves: number of executed movej.
    """

    q: Floats
    clock: Clock
    safety_mode: int = NORMAL
    robot_mode: int = ROBOT_RUNNING
    is_remote: bool = True
    is_paused: bool = False
    inputs: list[int] = field(default_factory=lambda: [0] * _N_REGISTERS)
    outputs: list[int] = field(default_factory=lambda: [0] * _N_REGISTERS)
    moves: int = 0

    def __post_init__(self) -> None:
        self._program: _Program | None = None
        self._reference: Reference = resting(self.q)
        self._elapsed = 0.0
        self._updated: dict[str, float] = {}
        self._now = self.clock.now()

    def run(self, source: str) -> bool:
        """Replace the running program; return False if this one is not accepted."""
        lines = [line.strip() for line in source.splitlines() if line.strip()]
        if not self.is_remote or self.safety_mode != NORMAL or self.robot_mode != ROBOT_RUNNING:
            return False
        if len(lines) < 2 or not re.fullmatch(r"def \w+\(\):", lines[0]) or lines[-1] != "end":
            return False
        if not all(any(re.fullmatch(form, line) for form in _STATEMENTS) for line in lines[1:-1]):
            return False
        self._end_program()
        self._program = _Program(lines[1:-1])
        return True

    def write_input(self, name: str, value: int) -> None:
        """Write an input register."""
        self.inputs[int(name.rsplit("_", 1)[1])] = value
        self._updated[name] = self.clock.now()

    def protective_stop(self, active: bool = True) -> None:
        """Begin or end a protective stop, which ends the program."""
        self._set_safety(PROTECTIVE_STOP if active else NORMAL)

    def emergency_stop(self, pressed: bool = True) -> None:
        """Press or release the emergency stop, which ends the program."""
        self._set_safety(EMERGENCY_STOP if pressed else NORMAL)

    def values(self) -> dict[str, Any]:
        """Return all output variables."""
        sampled = self._reference.sample(np.array([self._elapsed]))
        q, qd = tuple(sampled[0][0].tolist()), tuple((sampled[1][0] * (not self.is_paused)).tolist())
        runtime = STOPPED if self._program is None else PAUSED if self.is_paused else PLAYING
        return {
            "timestamp": self.clock.now(), "actual_q": q, "actual_qd": qd, "target_q": q, "target_qd": qd,
            "robot_mode": self.robot_mode, "safety_mode": self.safety_mode, "runtime_state": runtime,
            "target_speed_fraction": 1.0, "speed_scaling": 1.0, "actual_execution_time": 0.0,
            "robot_status_bits": 1 | 2 * (runtime != STOPPED), "safety_status_bits": int(self.safety_mode == NORMAL),
            **{f"input_int_register_{number}": value for number, value in enumerate(self.inputs)},
            **{f"output_int_register_{number}": value for number, value in enumerate(self.outputs)},
        }  # fmt: skip

    def tick(self) -> None:
        """Let time pass."""
        now = self.clock.now()
        passed, self._now = now - self._now, now
        if self.is_paused and self._program is not None:
            return
        self._elapsed += passed
        program = self._program
        if program is not None and program.watchdog is not None:
            name, limit = program.watchdog
            if now - self._updated.get(name, now) > limit:
                self._end_program()
        while self._program is not None and self._elapsed >= self._reference.duration:
            self._step(self._program)

    def _set_safety(self, mode: int) -> None:
        self.safety_mode = mode
        if mode != NORMAL:
            self._end_program()

    def _end_program(self) -> None:
        """End the program; the arm brakes on its path."""
        self._program = None
        if self._elapsed < self._reference.duration:
            self._reference = self._reference.braking_from(self._elapsed)
            self._elapsed = 0.0

    def _step(self, program: _Program) -> None:
        """Execute one statement."""
        if program.at >= len(program.lines):
            self._program = None
            return
        line = program.lines[program.at]
        program.at += 1
        if match := re.fullmatch(_MOVEJ, line):
            target = np.radians([float(angle) for angle in re.findall(r"-?[\d.]+", match[1].replace("d2r", ""))])
            self._drive(target, float(match[2]), float(match[3]))
        elif re.fullmatch(_STOPJ, line):
            self._reference = self._reference.braking_from(self._elapsed)
            self._elapsed = 0.0
        elif match := re.fullmatch(_WRITE, line):
            self.outputs[int(match[1])] = int(match[2]) if match[2].isdecimal() else self._read(match[2])
        elif match := re.fullmatch(_WATCHDOG, line):
            program.watchdog = match[1], 1.0 / float(match[2])
        elif (match := re.fullmatch(_IF, line)) and not all(map(self._holds, match[1].split(" and "))):
            depth = 1
            while depth:
                line = program.lines[program.at]
                depth += line.startswith("if ") - (line == "end")
                program.at += 1

    def _drive(self, target: Floats, acceleration: float, speed: float) -> None:
        """Begin a joint motion with the speed and the acceleration of the axis with the longest way."""
        axes = np.ones(len(target))
        self._reference = interpolate(self._reference.end, target[None], speed * axes, acceleration * axes)
        self._elapsed, self.moves = 0.0, self.moves + 1

    def _read(self, text: str) -> int:
        kind, number = re.fullmatch(_REGISTER, text).groups()  # type: ignore[union-attr]
        return (self.inputs if kind == "input" else self.outputs)[int(number)]

    def _holds(self, condition: str) -> bool:
        if condition == "True":
            return True
        left, operator, right = condition.rsplit(" ", 2)
        return (self._read(left) == int(right)) is (operator == "==")


_REGISTER = r"read_(input|output)_integer_register\((\d+)\)"
_CONDITION = r"(?:True|read_(?:input|output)_integer_register\(\d+\) [=!]= \d+)"
_MOVEJ = rf"movej\({_JOINTS}, ([\d.]+), ([\d.]+)\)"
_STOPJ = r"stopj\([\d.]+\)"
_WRITE = r"write_output_integer_register\((\d+), (\d+|read_(?:input|output)_integer_register\(\d+\))\)"
_WATCHDOG = r'rtde_set_watchdog\("(\w+)", ([\d.]+), "stop"\)'
_IF = rf"if ({_CONDITION}(?: and {_CONDITION})*):"
_STATEMENTS = (_MOVEJ, _STOPJ, _WRITE, _WATCHDOG, _IF, "end")


class UrServer:
    """Server of an emulated controller on the loopback interface.

    Args:
        controller: the controller.
        rtde_port: port of RTDE; 0 selects a free one.
        script_port: port of the secondary interface; 0 selects a free one.

    Raises:
        LinkError: if a port is not available.

    Attributes:
        url: of a driver for it.
    """

    def __init__(self, controller: UrController, rtde_port: int = 0, script_port: int = 0) -> None:
        self.controller = controller
        self._rtde, self._scripts = (listen(port, "choose another one") for port in (rtde_port, script_port))
        ports = (listener.getsockname()[1] for listener in (self._rtde, self._scripts))
        self.url = "ur://{}?rtde_port={}&script_port={}".format(LOOPBACK, *ports)
        self._clients: list[_Client] = []
        self._senders: dict[socket.socket, bytes] = {}

    def serve(self, until: Callable[[], bool]) -> None:
        """Serve until a condition is true."""
        while not until():
            self.step()

    def step(self) -> None:
        """Wait a moment for bytes, let time pass, and send the data packages that are due."""
        sockets = [self._rtde, self._scripts, *(client.connection for client in self._clients), *self._senders]
        now = self.controller.clock.now()
        wait = min([_MAX_STEP, *(max(client.due - now, 0.0) for client in self._clients)])
        ready, _, _ = select.select(sockets, [], [], wait)
        for listener, accept in ((self._rtde, self._add_client), (self._scripts, self._add_sender)):
            if listener in ready:
                with contextlib.suppress(OSError):  # closed again before it was accepted
                    accept(listener.accept()[0])
        for client in [each for each in self._clients if each.connection in ready]:
            if not self._receive(client):
                self._remove(client)
        for sender in [each for each in self._senders if each in ready]:
            self._receive_script(sender)
        self.controller.tick()
        self._send_due()

    def drop_connections(self) -> None:
        """Close all connections."""
        for client in list(self._clients):
            self._remove(client)
        for sender in list(self._senders):
            self._senders.pop(sender)
            sender.close()

    def close(self) -> None:
        """Close all sockets."""
        self.drop_connections()
        self._rtde.close()
        self._scripts.close()

    def _add_client(self, connection: socket.socket) -> None:
        connection.settimeout(1.0)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._clients.append(_Client(connection))

    def _add_sender(self, connection: socket.socket) -> None:
        connection.setblocking(False)
        self._senders[connection] = b""

    def _remove(self, client: _Client) -> None:
        if client in self._clients:
            self._clients.remove(client)
        client.connection.close()

    def _receive_script(self, sender: socket.socket) -> None:
        """Collect a program; its last line is `end` without indentation."""
        try:
            data = sender.recv(1 << 16)
        except OSError:
            data = b""
        text = self._senders[sender] + data
        if text.endswith(b"\nend\n") or not data:
            if text:
                self.controller.run(text.decode("ascii", errors="replace"))
            text = b""
        self._senders[sender] = text
        if not data:
            del self._senders[sender]
            sender.close()

    def _receive(self, client: _Client) -> bool:
        """Answer the packages of a client; return False if it is gone."""
        try:
            data = client.connection.recv(1 << 16)
            packages, client.rest = rtde.split(client.rest + data)
            for kind, payload in packages:
                answer = self._answer(client, kind, payload)
                if answer is not None:
                    client.connection.sendall(answer)
        except (OSError, ValueError):
            return False
        return bool(data)

    def _answer(self, client: _Client, kind: int, payload: bytes) -> bytes | None:
        match kind:
            case Package.VERSION:
                return rtde.encode(Package.VERSION, bytes([payload == rtde.VERSION.to_bytes(2, "big")]))
            case Package.CONTROLLER_VERSION:
                return rtde.encode(Package.CONTROLLER_VERSION, np.array([5, 12, 0, 0], dtype=">u4").tobytes())
            case Package.OUTPUTS:
                frequency = float(np.frombuffer(payload[:8], dtype=">f8")[0])
                client.period = 1.0 / min(max(frequency, 1.0), 500.0)
                client.outputs, answer = self._recipe(payload[8:])
                return rtde.encode(Package.OUTPUTS, answer)
            case Package.INPUTS:
                names = payload.decode("ascii").split(",")
                used = {name for other in self._clients if other.inputs for name in other.inputs.names}
                if used & set(names):
                    types = ",".join("IN_USE" if name in used else _TYPES.get(name, "NOT_FOUND") for name in names)
                    return rtde.encode(Package.INPUTS, b"\0" + types.encode())
                client.inputs, answer = self._recipe(payload)
                return rtde.encode(Package.INPUTS, answer)
            case Package.START | Package.PAUSE:
                client.due = self.controller.clock.now() if kind == Package.START else math.inf
                return rtde.encode(Package(kind), bytes([kind == Package.PAUSE or client.outputs is not None]))
            case Package.DATA if client.inputs is not None:
                for name, value in client.inputs.unpack(payload).items():
                    self.controller.write_input(name, value)
        return None

    @staticmethod
    def _recipe(payload: bytes) -> tuple[Recipe | None, bytes]:
        names = tuple(name for name in payload.decode("ascii").split(",") if name)  # clients end the list with a comma
        types = tuple(_TYPES.get(name, "NOT_FOUND") for name in names)
        is_known = "NOT_FOUND" not in types
        return Recipe(1, names, types) if is_known else None, bytes([is_known]) + ",".join(types).encode()

    def _send_due(self) -> None:
        now = self.controller.clock.now()
        due = [client for client in self._clients if client.due <= now and client.outputs is not None]
        values = self.controller.values() if due else {}
        for client in due:
            client.due = max(client.due + client.period, now)
            try:
                assert client.outputs is not None
                client.connection.sendall(client.outputs.pack(values))
            except OSError:
                self._remove(client)
