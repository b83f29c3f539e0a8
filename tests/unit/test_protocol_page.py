"""docs/internals/protocol.md is correct: a controller reproduces its sessions, and its tables match the code."""

import csv
import re
import zlib
from pathlib import Path

import pytest

from drivers.clock import SimulatedClock
from drivers.contract import Fault, Result
from drivers.emulated.endpoint import Endpoint
from drivers.emulated.stations import ModbusStation, SerialStation
from drivers.simulated_controller import IdealPlant
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
from tests.support.driver_bench import HOME_Q, KR16, Journal

INTERNALS = Path(__file__).parents[2] / "docs" / "internals"
PAGE, SERIAL, MODBUS = (
    (INTERNALS / name).read_text(encoding="utf-8")
    for name in ("protocol.md", "protocol_serial.txt", "protocol_modbus.txt")
)


def endpoint() -> tuple[Endpoint, SimulatedClock]:
    """Return a KR 16 at home, as on the page, and its clock."""
    clock = SimulatedClock()
    return Endpoint(IdealPlant(HOME_Q), KR16, clock, clock, Journal()), clock


def lines(session: str) -> list[str]:
    """Return the lines without comments."""
    return [line for line in session.splitlines() if not line.startswith("#")]


def test_a_controller_reproduces_the_serial_session() -> None:
    """A controller answers with every frame of the page, in order and byte for byte."""
    controller, clock = endpoint()
    station, answer, answered = SerialStation(controller), "", 0
    for line in lines(SERIAL):
        if pause := re.fullmatch(r"\.\.\. (\S+) s later", line):
            clock.wait(float(pause[1]))
        elif line.startswith(">"):
            answer = station.answer(line.encode() + b"\r\n").decode()
        else:
            assert answer == line + "\r\n"
            answered += 1
    assert answered >= 10


def test_a_controller_reproduces_the_modbus_session() -> None:
    """A controller answers with every telegram of the page, in order and byte for byte."""
    controller, clock = endpoint()
    station, answer, answered = ModbusStation(controller, rtu=True), b"", 0
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
def test_the_frames_follow_the_description(line: str) -> None:
    """The frames decode as the page describes: fields by position, the counted length, the CRC of zlib."""
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
    """Return the rows of the register table for the registers of the code; n axes."""
    table = []
    for block in registers.BLOCKS:
        at, axes, kind = block.address, 0, [block.name, block.kind]  # an address has the form `at + axes n`
        for field in block.fields:
            each = field.count == registers.PER_AXIS
            where = f"{at} + {axes}n" if axes else f"{at}"
            if each:
                where += "..."
            elif field.registers > 1:
                where += f"-{at + field.registers - 1}"
            count = "n" if each else f"{field.count}"
            table.append(
                [*kind, where, field.name, field.type if count == "1" else f"{field.type} x {count}", field.meaning]
            )
            at, axes = at + field.registers, axes + 2 * each
        if block.optional_points:
            table.append([*kind, f"{at}...", "points", "i32 x kn", "k = `points` via points, A1 on each [1e-4 deg]"])
        end = f"{at} + {'2k' if block.optional_points else axes}n"
        table.append([*kind, end, "crc", "u32", "CRC-32 of all registers before"])
    return table


def test_the_tables_match_the_code() -> None:
    """The table of registers and the command codes equal those of the code."""
    with (INTERNALS / "protocol_registers.csv").open(encoding="utf-8", newline="") as file:
        assert list(csv.reader(file)) == [["block", "kind", "register", "name", "type", "meaning"], *rows()]
    codes = "\n".join(f"| {code} | {meaning} |" for code, meaning in registers.COMMANDS.items())
    assert f"| code | meaning |\n|---|---|\n{codes}\n" in PAGE + "\n"


def test_the_numbers_in_the_text_match_the_code() -> None:
    """Sizes, check values and result codes equal those of the code."""
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
    command, status, capabilities = (block.for_axes(axes) for block in registers.BLOCKS)
    full = command.registers + command.max_points * 2 * axes
    assert full <= registers.MAX_WRITTEN < full + 2 * axes
    assert status.registers <= 125
    assert capabilities.registers <= 125
    assert status.address + status.registers <= capabilities.address
