"""Puts the simulated controller behind a line and serves it until it is told to stop."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cell.emulate.memory import Memory
from cell.errors import DriverFailureError, UsageError
from drivers.clock import RealTimeClock
from drivers.contract import Fault
from drivers.emulated.endpoint import Endpoint
from drivers.emulated.lines import Line, PtyLine, TcpLine
from drivers.emulated.modbus_station import ModbusStation
from drivers.emulated.serial_station import SerialStation
from drivers.emulated.serve import Server, Station
from drivers.emulated.wire_faults import Injector, parse
from drivers.errors import DriverError
from drivers.limits import kr16
from drivers.plant import IdealPlant, PlantFactory
from drivers.setpoints import to_rad

PROTOCOLS = ("serial", "modbus", "modbus-rtu")


@dataclass(frozen=True, slots=True)
class Settings:
    """What is emulated.

    Attributes:
        protocol: one of `PROTOCOLS`.
        port: TCP port; 0: a free one.
        link: symbolic link to the pseudo-terminal; None: none.
        baud: speed of the pseudo-terminal.
        unit: Modbus device address.
        faults: list of faults, see `drivers.emulated.wire_faults`.
        seed: of the faults.
        time_scale: seconds of the arm per second.
        state: file of the arm's position; None: it is forgotten.
        log: file of the journal; None: none.
        start: where the arm stands on the first start, counts of 1e-4 deg.
        seconds: ends by itself after this time [s]; None: never.
    """

    protocol: str
    port: int
    link: Path | None
    baud: int
    unit: int
    faults: str
    seed: int
    time_scale: float
    state: Path | None
    log: Path | None
    start: tuple[int, ...]
    seconds: float | None = None


def emulate(settings: Settings, plant: PlantFactory, announce: Callable[[str], None]) -> None:
    """Serve until Ctrl-C; then the arm brakes, and its position is kept.

    Args:
        settings: what.
        plant: makes the arm.
        announce: is given the driver URL, once clients can come.

    Raises:
        UsageError: if a setting cannot be.
        DriverFailureError: if the line cannot be taken, or the controller cannot start.
        FileError: if a file cannot be read or written.
    """
    try:
        injector = Injector(parse(settings.faults), np.random.default_rng(settings.seed)) if settings.faults else None
    except DriverError as error:
        raise UsageError(f"--faults: {error}") from error
    memory = Memory(settings.state, settings.log)
    axes = np.array(settings.start, dtype=np.int32) if memory.axes is None else memory.axes
    wire_clock = RealTimeClock()
    try:
        endpoint = Endpoint(
            plant(to_rad(axes)), kr16(), RealTimeClock(settings.time_scale), wire_clock, memory,
            boot=memory.boot % 65535 + 1, restarted=not memory.ended_in_order, time_scale=settings.time_scale,
        )  # fmt: skip
        line, url = _line(settings)
    except DriverError as error:
        raise DriverFailureError(str(error)) from error
    server = Server(_station(settings, endpoint), line, wire_clock, injector, settings.time_scale)
    try:
        announce(url)
        server.serve(lambda: settings.seconds is not None and wire_clock.now() >= settings.seconds)
    except KeyboardInterrupt:
        pass  # the usual end
    finally:
        line.close()
        if not (state := endpoint.tick()).standing:
            endpoint.controller.latch(Fault.RESTARTED)
            while not (state := endpoint.tick()).standing:
                wire_clock.wait(0.005)
        memory.close(state)


def plants(name: str) -> PlantFactory:
    """The plant of a name.

    Raises:
        UsageError: if there is none.
    """
    if name == "ideal":
        return IdealPlant
    from cell.plant import factory  # brings the engine: an ideal arm starts without it

    known = factory.built_in()
    if name not in known:
        raise UsageError(f"--plant {name} must be one of: {', '.join(('ideal', *known))}")
    return known[name]


def _line(settings: Settings) -> tuple[Line, str]:
    if settings.protocol == "modbus":
        tcp = TcpLine(settings.port)
        return tcp, f"modbus://{tcp.name}?unit={settings.unit}"
    pty = PtyLine(settings.link.absolute() if settings.link else None, settings.baud)
    if settings.protocol == "serial":
        return pty, f"serial://{pty.name}?baud={settings.baud}"
    return pty, f"modbus+rtu://{pty.name}?baud={settings.baud}&unit={settings.unit}"


def _station(settings: Settings, endpoint: Endpoint) -> Station:
    if settings.protocol == "serial":
        return SerialStation(endpoint)
    return ModbusStation(endpoint, unit=settings.unit, rtu=settings.protocol == "modbus-rtu")
