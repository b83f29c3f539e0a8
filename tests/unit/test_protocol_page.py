"""docs/internals/protocol.md is true: a controller says the sessions beside it, its tables are those of the code."""

import csv
import re
import zlib
from pathlib import Path

import numpy as np
import pytest

from cell.emulate.emulator import Memory
from cell.robot import model as robot
from drivers.clock import SimulatedClock
from drivers.contract import Fault, Result
from drivers.controller import IdealPlant
from drivers.emulated.endpoint import Endpoint
from drivers.emulated.stations import ModbusStation, SerialStation
from drivers.limits import Limits
from drivers.wire import MAX_AXES, MAX_POINTS
from drivers.wires import modbus_protocol as registers
from drivers.wires.serial_protocol import (
    COUNTS_PER_FRAME,
    MAX_FRAME,
    decode_frame,
    parse_hello,
    parse_request,
    parse_status,
)

KR16 = Limits.from_rad(robot.limits(robot.load()))

INTERNALS = Path(__file__).parents[2] / "docs" / "internals"
PAGE, SERIAL, MODBUS = (
    (INTERNALS / name).read_text(encoding="utf-8")
    for name in ("protocol.md", "protocol_serial.txt", "protocol_modbus.txt")
)


def endpoint() -> tuple[Endpoint, SimulatedClock]:
    """A KR 16 at home, as the page says, and its clock."""
    clock = SimulatedClock()
    plant = IdealPlant(np.radians([0, -90, 90, 0, 90, 0]))
    return Endpoint(plant, KR16, clock, clock, Memory(None, None)), clock


def lines(session: str) -> list[str]:
    """Without comments."""
    return [line for line in session.splitlines() if not line.startswith("#")]


def test_the_serial_session_is_what_a_controller_says() -> None:
    """Every frame of the page, in order, byte for byte."""
    robot, clock = endpoint()
    station, answer, answered = SerialStation(robot), "", 0
    for line in lines(SERIAL):
        if pause := re.fullmatch(r"\.\.\. (\S+) s later", line):
            clock.wait(float(pause[1]))
        elif line.startswith(">"):
            answer = station.answer(line.encode() + b"\r\n").decode()
        else:
            assert answer == line + "\r\n"
            answered += 1
    assert answered >= 10


def test_the_modbus_session_is_what_a_controller_says() -> None:
    """Every telegram of the page, in order, byte for byte."""
    robot, clock = endpoint()
    station, answer, answered = ModbusStation(robot, rtu=True), b"", 0
    for line in lines(MODBUS):
        if pause := re.fullmatch(r"\.\.\. (\S+) s later", line):
            clock.wait(float(pause[1]))
        elif line.startswith(">"):
            answer = station.answer(bytes.fromhex(line[2:]))
        else:
            assert answer == bytes.fromhex(line[2:])
            answered += 1
    assert answered >= 5


@pytest.mark.parametrize("line", [line for line in lines(SERIAL) if line[0] in "<>"])
def test_the_pages_frames_can_be_taken_apart_by_its_words(line: str) -> None:
    """Read as a reader of the page would: fields by position, the length counted, the CRC computed by zlib."""
    head, crc = line.rsplit("*", 1)
    start, number, length, body = head[0], head[1:6], head[7:11], head[12:]
    assert start in "<>"
    assert head[6] == head[11] == ","
    assert number.isdigit()
    assert int(length) == len(body)
    assert crc == f"{zlib.crc32(head.encode()):08X}"
    frame = decode_frame(line.encode() + b"\r\n")
    assert frame is not None
    if start == ">":
        assert parse_request(frame) is not None or frame.kind == "JOG"
    elif frame.kind == "STATE":
        assert parse_status(frame) is not None
    elif frame.kind == "HELLO":
        assert parse_hello(frame) is not None


def rows() -> list[list[str]]:
    """Of the code's registers, as the table has them; n axes."""
    found = []
    for block in registers.BLOCKS:
        at, axes, kind = block.address, 0, [block.name, block.kind]  # an address is `at + axes n`
        for field in block.fields:
            each = field.count == registers.PER_AXIS
            where = f"{at} + {axes}n" if axes else f"{at}"
            if each:
                where += "..."
            elif field.registers > 1:
                where += f"-{at + field.registers - 1}"
            count = "n" if each else f"{field.count}"
            found.append(
                [*kind, where, field.name, field.type if count == "1" else f"{field.type} x {count}", field.meaning]
            )
            at, axes = at + field.registers, axes + 2 * each
        if block.optional_points:
            found.append([*kind, f"{at}...", "points", "i32 x kn", "k = `points` via points, A1 on each [1e-4 deg]"])
        end = f"{at} + {'2k' if block.optional_points else axes}n"
        found.append([*kind, end, "crc", "u32", "CRC-32 of all registers before"])
    return found


def test_the_register_tables_are_the_codes() -> None:
    """The table of registers and the page's command codes are those of the code."""
    with (INTERNALS / "protocol_registers.csv").open(encoding="utf-8", newline="") as file:
        assert list(csv.reader(file)) == [["block", "kind", "register", "name", "type", "meaning"], *rows()]
    codes = "\n".join(f"| {code} | {meaning} |" for code, meaning in registers.COMMANDS.items())
    assert f"| code | meaning |\n|---|---|\n{codes}\n" in PAGE + "\n"


def test_the_numbers_in_the_text_are_the_codes() -> None:
    """Sizes, check values and result codes."""
    page = " ".join(PAGE.split())
    assert f"{zlib.crc32(b'123456789'):08X}" in page
    assert f"at most {MAX_FRAME} bytes" in page
    nine = registers.COMMAND.for_axes(6).max_points
    assert f"a frame holds {COUNTS_PER_FRAME} axes, a register block {nine} points of six axes" in page
    assert f"its length is {registers.COMMAND.for_axes(6).registers} registers and 2n for each via point" in page
    assert f"n, 6 to {MAX_AXES}" in page
    assert f"up to {MAX_POINTS:,} via points" in page
    for result in Result:
        assert f"| {int(result)} | " in PAGE
    for fault in Fault:
        assert f"| {int(fault)} | " in PAGE


@pytest.mark.parametrize("axes", [6, 7, MAX_AXES])
def test_the_blocks_fit_their_telegrams(axes: int) -> None:
    """123 registers in an FC16, 125 in an FC04, for every number of axes."""
    command, status, able = (block.for_axes(axes) for block in registers.BLOCKS)
    full = command.registers + command.max_points * 2 * axes
    assert full <= registers.MAX_WRITTEN < full + 2 * axes
    assert status.registers <= 125
    assert able.registers <= 125
    assert status.address + status.registers <= able.address
