"""The simulated controller behind a line, served until Ctrl-C, with its position and journal on disk.

A real arm keeps its position during a restart of its controller. The position is therefore on disk before a client
receives it. It is written to a temporary file that is renamed, so that a kill at any moment leaves the old or the new
one. The file survives the process, not a crash of the machine: it is not synchronised to the disk.
"""

import contextlib
import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

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
from drivers.emulated.stations import ModbusStation, SerialStation
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
        UsageError: if a fault is invalid, the protocol does not have an option, or the stored state is another arm's.
        DriverFailureError: if the line is not available, or the controller cannot start.
        FileError: if a file cannot be read or written.
    """
    _require_usable(protocol, options, arm)
    try:
        faults = parse_faults(options.faults)
    except DriverError as error:
        raise UsageError(f"--faults: {error}") from error
    for name in (*faults.random, *(each.name for each in faults.scheduled)):
        if protocol == "rsi" and name not in UDP_FAULTS:
            raise UsageError(f"cell emulate rsi has no fault {name}; valid are: {', '.join(UDP_FAULTS)}")
    injector = Injector(faults, np.random.default_rng(options.seed)) if options.faults else None
    memory = Memory(options.state, options.log)
    home = arm.home.copy()
    if options.start_deg is not None:
        home[: len(options.start_deg)] = np.radians(options.start_deg)  # external axes start at 0
    if memory.axes is not None and len(memory.axes) != len(home):
        raise UsageError(
            f"{options.state} is the state of an arm with {len(memory.axes)} axes, and this one has {len(home)}; "
            "choose another --state, or remove it to start at --start"
        )
    clock, q = RealTimeClock(), to_rad(from_rad(home) if memory.axes is None else memory.axes)
    served: UrServer | RsiController | Line
    with contextlib.ExitStack() as stack:
        with errors_as(DriverFailureError, DriverError):
            match protocol:
                case "ur":
                    served = UrServer(UrController(q, clock), options.port, max(options.port - UR_SCRIPT_OFFSET, 0))
                    url, serve = served.url, served.serve
                case "rsi":
                    served = RsiController(q, clock, options.port, options.cycle_ms, injector)
                    url, serve = served.url, served.serve
                case "kvp":
                    controller, served = KukaController(q, arm.limits, clock, memory), TcpLine(options.port)
                    url, serve = f"kvp://{served.name}", Server(KvpStation(controller), served, clock, injector).serve
                case _:
                    endpoint = Endpoint(
                        arm.plant(q),
                        arm.limits,
                        RealTimeClock(options.time_scale),
                        clock,
                        memory,
                        boot=memory.boot % 65535 + 1,
                        restarted=not memory.ended_in_order,
                        time_scale=options.time_scale,
                    )
                    served, url = _open_line(protocol, options)
                    rtu = protocol == "modbus-rtu"
                    modbus = ModbusStation(endpoint, unit=options.unit, rtu=rtu)
                    station = SerialStation(endpoint) if protocol == "serial" else modbus
                    serve = Server(station, served, clock, injector, options.time_scale).serve
                    stack.callback(_end, endpoint, memory, clock)
        stack.enter_context(contextlib.closing(served))
        with contextlib.suppress(KeyboardInterrupt):  # the usual end
            announce(url)
            serve(lambda: options.seconds is not None and clock.now() >= options.seconds)


def _end(endpoint: Endpoint, memory: "Memory", clock: Clock) -> None:
    """Brake the arm and store its position."""
    if not (state := endpoint.tick()).at_rest:
        endpoint.controller.latch(Fault.RESTARTED)
        while not (state := endpoint.tick()).at_rest:
            clock.wait(0.005)
    memory.close(state)


_REFUSED = {
    "kvp": ("link", "baud", "unit", "plant", "state", "time_scale"),
    "rsi": ("link", "baud", "unit", "plant", "state", "time_scale", "log"),
    "ur": ("link", "baud", "unit", "plant", "state", "time_scale", "log", "faults"),
}
"""Options that a protocol does not have."""


def _require_usable(protocol: str, options: EmulateOptions, arm: Arm) -> None:
    default = EmulateOptions()
    for name in _REFUSED.get(protocol, ()):
        if getattr(options, name) != getattr(default, name):
            raise UsageError(f"cell emulate {protocol} has no --{name.replace('_', '-')}; omit it")
    if protocol in ("rsi", "ur") and len(arm.home) != AXES:
        raise UsageError(f"cell emulate {protocol} turns no rotary table; choose another --run")
    if protocol == "rsi":
        _require_cycle(options.cycle_ms)


def _require_cycle(cycle_ms: int) -> None:
    if cycle_ms not in (4, 12):
        raise UsageError(f"--cycle-ms is {cycle_ms}; it must be 4 or 12")


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
        UsageError: if the file of the position has other content.
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
