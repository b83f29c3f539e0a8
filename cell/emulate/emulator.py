"""Puts the simulated controller behind a line and serves it until it is told to stop."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cell.emulate.memory import Memory
from cell.emulate.options import EmulateOptions
from cell.errors import DriverFailureError, UsageError
from cell.plant import factory
from cell.robot import model as robot
from cell.runs.cell import table_of
from cell.runs.run import open_run
from drivers.clock import RealTimeClock
from drivers.contract import Fault
from drivers.controller import IdealPlant, PlantFactory
from drivers.emulated.endpoint import Endpoint
from drivers.emulated.faults import Injector, parse_faults
from drivers.emulated.serve import Line, PtyLine, Server, TcpLine
from drivers.emulated.stations import ModbusStation, SerialStation, Station
from drivers.errors import DriverError
from drivers.limits import Limits
from drivers.setpoints import Floats, from_rad, to_rad

PROTOCOLS = ("serial", "modbus", "modbus-rtu")


@dataclass(frozen=True, slots=True, eq=False)
class Arm:
    """Whose controller is emulated.

    Attributes:
        limits: the controller's.
        home: (axes,) where it stands on the first start, where nothing else is said [rad].
        plant: makes it.
    """

    limits: Limits
    home: Floats
    plant: PlantFactory


def emulate(protocol: str, options: EmulateOptions, arm: Arm, announce: Callable[[str], None]) -> None:
    """Serve until Ctrl-C; then the arm brakes, and its position is kept.

    Args:
        protocol: one of `PROTOCOLS`.
        options: behind which line, and what goes wrong.
        arm: whose controller.
        announce: is given the driver URL, once clients can come.

    Raises:
        UsageError: if a fault cannot be.
        DriverFailureError: if the line cannot be taken, or the controller cannot start.
        FileError: if a file cannot be read or written.
    """
    try:
        injector = (
            Injector(parse_faults(options.faults), np.random.default_rng(options.seed)) if options.faults else None
        )
    except DriverError as error:
        raise UsageError(f"--faults: {error}") from error
    memory = Memory(options.state, options.log)
    home = arm.home.copy()
    if options.start_deg is not None:
        home[: len(options.start_deg)] = np.radians(options.start_deg)  # external axes stand at 0
    if memory.axes is not None and len(memory.axes) != len(home):
        raise UsageError(
            f"{options.state} is of an arm of {len(memory.axes)} axes, and this one has {len(home)}; choose another "
            "--state, or remove it and the arm stands at --start"
        )
    wire_clock = RealTimeClock()
    try:
        axes = from_rad(home) if memory.axes is None else memory.axes
        endpoint = Endpoint(
            arm.plant(to_rad(axes)), arm.limits, RealTimeClock(options.time_scale), wire_clock, memory,
            boot=memory.boot % 65535 + 1, restarted=not memory.ended_in_order, time_scale=options.time_scale,
        )  # fmt: skip
        line, url = _line(protocol, options)
    except DriverError as error:
        raise DriverFailureError(str(error)) from error
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


def arm_of(run_folder: Path | None, plant: str) -> Arm:
    """The arm of a run's cell, with its tool; without a run the built-in one.

    Args:
        run_folder: of a plan; None: none.
        plant: name of what moves.

    Raises:
        UsageError: if there is no such plant.
        FileError: if the run folder has no cell, or it is damaged.
    """
    run = None if run_folder is None else open_run(run_folder)
    plants = {"ideal": IdealPlant, **(factory.built_in() if run is None else factory.of_run(run))}
    if plant not in plants:
        raise UsageError(f"--plant {plant} must be one of: {', '.join(plants)}")
    model = robot.load() if run is None else run.cell_model()
    limits, home = robot.limits(model), robot.home(model)
    if run is None or (table := table_of(scene := run.scene)) is None:
        return Arm(Limits.from_rad(limits), home, plants[plant])
    own = Limits.from_rad(table.limits(limits))
    return Arm(own.with_endless_axis() if scene.table_is_endless else own, np.append(home, 0.0), plants[plant])


def _line(protocol: str, options: EmulateOptions) -> tuple[Line, str]:
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
