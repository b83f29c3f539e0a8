"""The simulated controller behind a line, served until Ctrl-C, with its position and journal on disk.

A real arm keeps its position during a restart of its controller. The position is therefore on disk before a client
receives it. It is written to a temporary file that is renamed, so that a kill at any moment leaves the old or the new
one. The file survives the process, not a crash of the machine: it is not synchronised to the disk.
"""

import contextlib
import json
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from cell.errors import DriverFailureError, FileError, UsageError, errors_as
from cell.files import atomic_write, file_errors
from cell.robot import model as robot
from cell.runs.cell import table_of
from cell.runs.run import open_run
from cell.scan.emulator_options import EmulateOptions
from cell.scan.plants import built_in_plants, plants_of_run
from drivers.clock import Clock, RealTimeClock
from drivers.contract import Fault, RobotState
from drivers.emulated.endpoint import Endpoint, Event
from drivers.emulated.faults import Injector, parse_faults
from drivers.emulated.kvp import KukaController, KvpStation
from drivers.emulated.rsi import UDP_FAULTS, RsiController
from drivers.emulated.serve import Line, PtyLine, Server, TcpLine
from drivers.emulated.stations import ModbusStation, SerialStation, Station
from drivers.emulated.ur import UrController, UrServer
from drivers.errors import DriverError
from drivers.limits import Limits
from drivers.setpoints import AXES, Floats, SetPoints, from_rad, to_rad
from drivers.simulated_controller import IdealPlant, PlantFactory
from drivers.wires import kvp_program, rsi

PROTOCOLS = ("serial", "modbus", "modbus-rtu", "ur", "kvp", "rsi")
ON_A_PORT = ("modbus", "ur", "kvp", "rsi")
UR_SCRIPT_OFFSET = 2  # of the script port below the RTDE port, as on a real controller
SCHEMA = "cell-emulator-state/1"


@dataclass(frozen=True, slots=True, eq=False)
class Arm:
    """The arm of an emulated controller.

    Attributes:
        limits: the controller's.
        home: (axes,) default position at the first start [rad].
        plant: makes its plant.
    """

    limits: Limits
    home: Floats
    plant: PlantFactory


def emulate(protocol: str, options: EmulateOptions, arm: Arm, announce: Callable[[str], None]) -> None:
    """Serve until Ctrl-C; then the arm brakes, and its position is stored.

    Args:
        protocol: one of `PROTOCOLS`.
        options: line, faults and files.
        arm: the arm.
        announce: receives the driver URL when clients can connect.

    Raises:
        UsageError: if a fault is invalid.
        DriverFailureError: if the line is not available, or the controller cannot start.
        FileError: if a file cannot be read or written.
    """
    if protocol == "ur":
        _emulate_ur(options, arm, announce)
        return
    try:
        faults = parse_faults(options.faults)
    except DriverError as error:
        raise UsageError(f"--faults: {error}") from error
    injector = Injector(faults, np.random.default_rng(options.seed)) if options.faults else None
    if protocol == "kvp":
        _emulate_kvp(options, arm, injector, announce)
        return
    if protocol == "rsi":
        _emulate_rsi(options, arm, injector, announce)
        return
    memory = Memory(options.state, options.log)
    home = arm.home.copy()
    if options.start_deg is not None:
        home[: len(options.start_deg)] = np.radians(options.start_deg)  # external axes start at 0
    if memory.axes is not None and len(memory.axes) != len(home):
        raise UsageError(
            f"{options.state} is the state of an arm with {len(memory.axes)} axes, and this one has {len(home)}; "
            "choose another --state, or remove it to start at --start"
        )
    wire_clock = RealTimeClock()
    with errors_as(DriverFailureError, DriverError):
        axes = from_rad(home) if memory.axes is None else memory.axes
        endpoint = Endpoint(
            arm.plant(to_rad(axes)),
            arm.limits,
            RealTimeClock(options.time_scale),
            wire_clock,
            memory,
            boot=memory.boot % 65535 + 1,
            restarted=not memory.ended_in_order,
            time_scale=options.time_scale,
        )
        line, url = _open_line(protocol, options)
    server = Server(_station(protocol, options, endpoint), line, wire_clock, injector, options.time_scale)
    try:
        announce(url)
        server.serve(lambda: options.seconds is not None and wire_clock.now() >= options.seconds)
    except KeyboardInterrupt:
        pass  # the usual end
    finally:
        line.close()
        if not (state := endpoint.tick()).at_rest:
            endpoint.controller.latch(Fault.RESTARTED)
            while not (state := endpoint.tick()).at_rest:
                wire_clock.wait(0.005)
        memory.close(state)


def _emulate_kvp(options: EmulateOptions, arm: Arm, injector: Injector | None, announce: Callable[[str], None]) -> None:
    """Serve a KUKA controller with the variables of its KRL program until Ctrl-C."""
    _refuse_options("kvp", options, ("link", "baud", "unit", "plant", "state", "time_scale"))
    home = arm.home if options.start_deg is None else np.append(np.radians(options.start_deg), arm.home[AXES:])
    clock, memory = RealTimeClock(), Memory(None, options.log)
    controller = KukaController(to_rad(from_rad(home)), arm.limits, clock, memory)
    with errors_as(DriverFailureError, DriverError):
        line = TcpLine(options.port)
    with _until_stopped(line, options, clock) as is_over:
        announce(f"kvp://{line.name}")
        Server(KvpStation(controller), line, clock, injector).serve(is_over)


def _emulate_rsi(options: EmulateOptions, arm: Arm, injector: Injector | None, announce: Callable[[str], None]) -> None:
    """Send the telegrams of a KUKA controller with RSI until Ctrl-C."""
    _refuse_options("rsi", options, ("link", "baud", "unit", "plant", "state", "log", "time_scale"))
    _require_arm_only("rsi", arm)
    _require_cycle(options.cycle_ms)
    faults = () if injector is None else (*injector.faults.random, *(each.name for each in injector.faults.scheduled))
    for name in faults:
        if name not in UDP_FAULTS:
            raise UsageError(f"cell emulate rsi has no fault {name}; valid are: {', '.join(UDP_FAULTS)}")
    home = arm.home if options.start_deg is None else np.radians(options.start_deg)
    clock = RealTimeClock()
    with errors_as(DriverFailureError, DriverError):
        controller = RsiController(to_rad(from_rad(home)), clock, options.port, options.cycle_ms, injector)
    with _until_stopped(controller, options, clock) as is_over:
        announce(controller.url)
        controller.serve(is_over)


class _Closable(Protocol):
    """A line or a controller that is served."""

    def close(self) -> None:
        """Release its port."""


@contextlib.contextmanager
def _until_stopped(served: _Closable, options: EmulateOptions, clock: Clock) -> Iterator[Callable[[], bool]]:
    """Yield whether the time of the options is over; Ctrl-C is the usual end of the block, which then closes."""
    with contextlib.closing(served), contextlib.suppress(KeyboardInterrupt):
        yield lambda: options.seconds is not None and clock.now() >= options.seconds


def _require_cycle(cycle_ms: int) -> None:
    if cycle_ms not in (4, 12):
        raise UsageError(f"--cycle-ms is {cycle_ms}; it must be 4 or 12")


def _require_arm_only(protocol: str, arm: Arm) -> None:
    if len(arm.home) != AXES:
        raise UsageError(f"cell emulate {protocol} turns no rotary table; choose another --run")


def _refuse_options(protocol: str, options: EmulateOptions, names: tuple[str, ...]) -> None:
    default = EmulateOptions()
    for name in names:
        if getattr(options, name) != getattr(default, name):
            raise UsageError(f"cell emulate {protocol} has no --{name.replace('_', '-')}; omit it")


def _emulate_ur(options: EmulateOptions, arm: Arm, announce: Callable[[str], None]) -> None:
    """Serve a controller of Universal Robots until Ctrl-C."""
    _refuse_options("ur", options, ("link", "baud", "unit", "plant", "state", "log", "time_scale", "faults"))
    _require_arm_only("ur", arm)
    home = arm.home if options.start_deg is None else np.radians(options.start_deg)
    clock = RealTimeClock()
    with errors_as(DriverFailureError, DriverError):
        controller = UrController(to_rad(from_rad(home)), clock)
        server = UrServer(controller, options.port, max(options.port - UR_SCRIPT_OFFSET, 0))
    with _until_stopped(server, options, clock) as is_over:
        announce(server.url)
        server.serve(is_over)


def load_arm(run_folder: Path | None, plant: str) -> Arm:
    """Load the arm of a run's cell with its tool; without a run the built-in one.

    Args:
        run_folder: of a plan; None: none.
        plant: name of the plant.

    Raises:
        UsageError: if there is no such plant.
        FileError: if the run folder has no cell, or is damaged.
    """
    run = None if run_folder is None else open_run(run_folder)
    plants = {"ideal": IdealPlant, **(built_in_plants() if run is None else plants_of_run(run))}
    if plant not in plants:
        raise UsageError(f"--plant {plant} must be one of: {', '.join(plants)}")
    model = robot.load() if run is None else run.cell_model()
    limits, home = robot.limits(model), robot.home(model)
    if run is None or (table := table_of(run.scene)) is None:
        return Arm(Limits.from_rad(limits), home, plants[plant])
    table_limits = Limits.from_rad(table.limits(limits))
    if run.scene.table_is_endless:
        table_limits = table_limits.with_endless_axis()
    return Arm(table_limits, np.append(home, 0.0), plants[plant])


def write_controller_files(
    protocol: str, out: Path, run_folder: Path | None, address: str, port: int, cycle_ms: int, timer: int
) -> list[Path]:
    """Write the files that a controller needs for `kvp://` or `rsi://`, and return their paths.

    Raises:
        UsageError: if an argument is invalid.
        FileError: if a file cannot be written.
    """
    if protocol == "kvp":
        contents = kvp_program.files(timer)
    elif protocol == "rsi":
        _require_cycle(cycle_ms)
        if not re.fullmatch(r"[\w.-]+", address, re.ASCII):
            raise UsageError(f"--address {address!r} is no address; write it like 192.168.0.20")
        contents = rsi.files(address, port, load_arm(run_folder, "ideal").limits, cycle_ms=cycle_ms)
    else:
        raise UsageError(f"cell controller {protocol}: unknown protocol; valid are: kvp, rsi")
    with file_errors(f"{out} cannot be written", "choose another --out"):
        for name, content in contents.items():
            with atomic_write(out / name) as part:
                part.write_bytes(content)
    return [out / name for name in contents]


def _open_line(protocol: str, options: EmulateOptions) -> tuple[Line, str]:
    """Open the line of a protocol; return it and the driver URL of its clients."""
    if protocol == "modbus":
        tcp = TcpLine(options.port)
        return tcp, f"modbus://{tcp.name}?unit={options.unit}"
    pty = PtyLine(options.link.absolute() if options.link else None, options.baud)
    if protocol == "serial":
        return pty, f"serial://{pty.name}?baud={options.baud}"
    return pty, f"modbus+rtu://{pty.name}?baud={options.baud}&unit={options.unit}"


def _station(protocol: str, options: EmulateOptions, endpoint: Endpoint) -> Station:
    if protocol == "serial":
        return SerialStation(endpoint)
    return ModbusStation(endpoint, unit=options.unit, rtu=protocol == "modbus-rtu")


class Memory:
    """Files of an emulated controller: position of the arm and journal (`drivers.emulated.endpoint.Recorder`).

    Args:
        state: file of the arm's position; None: it is not stored.
        log: file of the journal, JSON lines, appended to; None: none.

    Attributes:
        axes: (n,) last position of the arm, counts of 1e-4 deg; None on the first start.
        boot: number of the last start, 0 on the first.
        ended_in_order: False if the last run was killed.

    Raises:
        FileError: if a file cannot be read or written.
    """

    def __init__(self, state: Path | None, log: Path | None) -> None:
        self._state = state
        with file_errors(f"{log} cannot be written", "choose another --log"):
            self._log = None if log is None else log.open("a", encoding="utf-8")
        self.axes: SetPoints | None = None
        self.boot, self.ended_in_order = 0, True
        if state is not None and state.exists():
            self.axes, self.boot, self.ended_in_order = _read(state)
        self._written: tuple[object, ...] = ()

    def record_event(self, event: Event) -> None:
        """Append one line to the journal."""
        if self._log is None:
            return
        with file_errors(f"{self._log.name} cannot be written", "choose another --log"):
            self._log.write(json.dumps(event) + "\n")
            self._log.flush()

    def record_state(self, state: RobotState) -> None:
        """Store the position before a client receives it."""
        self._write(state.axes, state.boot, ended_in_order=False)

    def close(self, state: RobotState) -> None:
        """Store the end of a run in order, with the arm at rest."""
        self._write(state.axes, state.boot, ended_in_order=True)
        if self._log is not None:
            self._log.close()

    def _write(self, axes: SetPoints, boot: int, *, ended_in_order: bool) -> None:
        if self._state is None:
            return
        content = (axes.tolist(), boot, ended_in_order)
        if content == self._written:
            return
        text = json.dumps({"schema": SCHEMA, "axes": content[0], "boot": boot, "ended_in_order": ended_in_order})
        with (
            file_errors(f"{self._state} cannot be written", "choose another --state"),
            atomic_write(self._state) as part,
        ):
            part.write_text(text + "\n", encoding="utf-8")
        self._written = content


def _read(path: Path) -> tuple[SetPoints, int, bool]:
    try:
        content: Any = json.loads(path.read_text(encoding="utf-8"))
        axes = np.array(content["axes"], dtype=np.int32)
        boot, in_order = int(content["boot"]), bool(content["ended_in_order"])
        if content["schema"] != SCHEMA or axes.ndim != 1 or len(axes) < AXES or not 0 <= boot <= 65535:
            raise ValueError
    except OSError as error:
        raise FileError(f"{path} cannot be read: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise UsageError(
            f"{path} is not the state of an emulated arm: schema, axes or boot number are missing or wrong; "
            "remove it to start at --start"
        ) from error
    return axes, boot, in_order
