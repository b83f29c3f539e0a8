"""Codecs of the wires: whatever decodes was written like that, and what was mangled never passes for something else."""

import struct
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cell.robot import model as robot
from drivers.contract import Answer, Mode, Move, Reset, RobotState, Stop
from drivers.emulated import stations
from drivers.errors import ProtocolError
from drivers.limits import Limits
from drivers.wire import FULL_SPEED, Stage, StagingBuffer, points_crc, speed_from_wire, speed_to_wire, split_move
from drivers.wires import modbus_protocol as registers
from drivers.wires import serial_protocol as messages
from drivers.wires.serial_protocol import (
    FROM_CONTROLLER,
    MAX_FRAME,
    TO_CONTROLLER,
    Frame,
    decode_frame,
    encode_frame,
    split_frames,
    to_frame_text,
)

KR16 = Limits.from_rad(robot.limits(robot.load()))

numbers = st.integers(0, 65535)
int32 = st.integers(-(2**31), 2**31 - 1)
texts = st.text(max_size=60)


def points(least: int = 1, most: int = 12) -> st.SearchStrategy[np.ndarray]:
    """(n, 6) int32."""
    rows = st.lists(st.lists(int32, min_size=6, max_size=6), min_size=least, max_size=most)
    return rows.map(lambda values: np.array(values, dtype=np.int32).reshape(-1, 6))


requests = st.one_of(
    st.builds(messages.Hello),
    st.builds(messages.ReadState),
    st.builds(messages.Take, st.integers(0, 65535)),
    st.builds(messages.Give),
    st.builds(Stage, st.integers(0, 10**6), points()),
    st.tuples(points(), st.floats(1e-4, 1.0)).map(lambda given: split_move(Move(*given), 12)[1]),
    st.builds(Stop),
    st.builds(Reset),
)
states = st.builds(
    RobotState,
    st.sampled_from(Mode),
    points(1, 1).map(lambda rows: rows[0]),
    st.booleans(),
    numbers, numbers, numbers, numbers, numbers, numbers, texts.map(to_frame_text), *[numbers] * 6,
)  # fmt: skip
frames = st.one_of(
    st.builds(messages.request_frame, numbers, numbers, requests),
    st.builds(messages.status_frame, numbers, states),
    st.builds(
        messages.answer_frame, numbers, st.sampled_from(["MOVE", "STOP"]), st.builds(Answer, numbers, numbers, texts)
    ),
    st.builds(messages.error_frame, numbers, texts),
)


@given(frames)
def test_a_frame_survives_its_bytes(frame: Frame) -> None:
    """Encode, decode: the same frame; it fits MAX_FRAME, is ASCII and one line."""
    data = encode_frame(frame)
    assert decode_frame(data) == frame
    assert len(data) <= MAX_FRAME
    assert data.isascii()
    assert data.count(b"\n") == 1


@given(numbers, numbers, requests)
def test_a_request_survives_its_frame(number: int, session: int, request: messages.Request) -> None:
    """Compared by what is sent, since arrays do not compare."""
    frame = messages.request_frame(number, session, request)
    again = messages.parse_request(frame)
    assert again is not None
    assert messages.request_frame(number, *again) == frame


@given(numbers, states)
def test_a_state_survives_its_frame(number: int, state: RobotState) -> None:
    """All of it, text included."""
    frame = messages.status_frame(number, state)
    again = messages.parse_status(frame)
    assert again is not None
    assert messages.status_frame(number, again) == frame
    assert again.axes.tolist() == state.axes.tolist()
    assert again.fault_message == state.fault_message


@given(st.sampled_from([TO_CONTROLLER, FROM_CONTROLLER]), numbers, st.text("ASTOPEMVHLR,0123456789-AF ", max_size=60))
def test_what_is_understood_is_written_in_one_way(start: str, number: int, body: str) -> None:
    """No two bodies mean the same request, state or answer."""
    frame = Frame(start, number, body)
    request = messages.parse_request(frame)
    if request is not None:
        assert messages.request_frame(number, *request) == frame
    answer = messages.parse_answer(frame, "MOVE")
    if answer is not None:
        assert messages.answer_frame(number, "MOVE", answer) == frame


@given(st.binary(max_size=80))
def test_any_bytes_decode_to_nothing_or_to_what_encodes_to_them(data: bytes) -> None:
    """No crash, and one spelling per frame."""
    frame = decode_frame(data)
    assert frame is None or encode_frame(frame) == data


@given(frames, st.data())
def test_a_mangled_frame_is_no_frame(frame: Frame, data: st.DataObject) -> None:
    """Bits flipped, cut, or two frames run into each other."""
    good = encode_frame(frame)
    how = data.draw(st.sampled_from(["flip", "cut", "join", "case"]))
    if how == "flip":
        at, bit = data.draw(st.integers(0, len(good) - 1)), data.draw(st.integers(0, 7))
        bad = good[:at] + bytes([good[at] ^ 1 << bit]) + good[at + 1 :]
    elif how == "cut":
        bad = good[: data.draw(st.integers(0, len(good) - 1))]
    elif how == "join":
        other = encode_frame(data.draw(frames))
        bad = good[: data.draw(st.integers(1, len(good) - 1))] + other[data.draw(st.integers(1, len(other) - 1)) :]
    else:
        bad = good[:-11] + good[-11:].lower()
    if bad != good and (how != "join" or bad != other):
        assert decode_frame(bad) is None


@given(st.lists(frames, max_size=4), st.lists(st.binary(max_size=30), max_size=5), st.data())
def test_frames_are_found_in_any_stream_however_it_arrives(
    sent: list[Frame], noise: list[bytes], data: st.DataObject
) -> None:
    """Noise lines between frames, and any cut into reads: every frame is found, in order, and nothing else."""
    stream = b""
    for k, frame in enumerate(sent):
        if k < len(noise):
            stream += noise[k].replace(b"\n", b"")
            stream += b"\n" if data.draw(st.booleans()) else b""
        stream += encode_frame(frame)
    found, rest = [], b""
    while stream:
        size = data.draw(st.integers(1, len(stream)))
        candidates, rest = split_frames(rest + stream[:size])
        found += [decoded for decoded in map(decode_frame, candidates) if decoded is not None]
        stream = stream[size:]
    assert found == sent


@pytest.mark.parametrize("body", ["", "move", "MOVE*", "MOVE,<", "MOVE,\n", "MOVE,\u00e4", "M" * 2000, ",MOVE"])
def test_what_a_frame_cannot_carry_is_refused(body: str) -> None:
    """With a sentence."""
    with pytest.raises(ProtocolError, match="cannot carry"):
        encode_frame(Frame(">", 1, body))


def test_what_never_ends_is_not_kept() -> None:
    """A megabyte without LF leaves no more than a frame behind."""
    _, rest = split_frames(b">" + b"x" * 1_000_000)
    assert len(rest) <= MAX_FRAME


@given(points(1, 40), st.floats(1e-4, 1.0), st.integers(1, 12), st.integers(1, 65535), st.randoms())
def test_a_move_survives_being_staged(
    whole: np.ndarray, speed: float, size: int, sequence: int, random: object
) -> None:
    """Cut, written in order with repetitions, committed: the same points; a changed point or count is not taken."""
    stages, commit = split_move(Move(whole, speed), size)
    staging = StagingBuffer()
    for stage in stages:
        assert staging.write(sequence, stage)
        assert staging.write(sequence, stage)
    taken = staging.assemble(sequence, commit)
    assert taken is not None
    assert (taken == whole).all()
    assert staging.assemble(sequence, commit) is not None
    assert all(len(stage.points) <= size for stage in stages)
    assert len(commit.tail) <= size
    if stages:
        assert staging.assemble(sequence % 65535 + 1, commit) is None
        staging.write(sequence, Stage(0, stages[0].points ^ 1))
        assert staging.assemble(sequence, commit) is None
        assert not StagingBuffer().write(sequence, Stage(1, stages[0].points))


def test_the_points_crc_is_zlibs_over_big_endian_counts() -> None:
    """Point by point, A1 to A6."""
    given_points = np.array([[1, -2, 3, -4, 5, -6], [7, 8, 9, 10, 11, 12]], dtype=np.int32)
    assert points_crc(given_points) == zlib.crc32(struct.pack(">12i", 1, -2, 3, -4, 5, -6, *range(7, 13)))


@given(st.floats())
def test_a_speed_is_never_faster_than_asked(speed: float) -> None:
    """What is no fraction travels as 0, which is refused; 1e-4 steps survive exactly."""
    wire = speed_to_wire(speed)
    assert 0 <= wire <= FULL_SPEED
    assert speed_from_wire(wire) <= max(speed, 0.0) + 1e-10 or not speed > 0
    assert wire == 0 or speed - speed_from_wire(wire) < 1e-4


def test_every_wire_speed_survives() -> None:
    """All 10,000."""
    assert all(speed_to_wire(speed_from_wire(k)) == k for k in range(FULL_SPEED + 1))


blocks = st.sampled_from(
    [block.for_axes(6) for block in registers.BLOCKS] + [block.for_axes(9) for block in registers.BLOCKS]
)


def values_of(block: registers.Block, draw: st.DrawFn) -> dict[str, registers.Value]:
    """Any values of a block's fields."""
    ranges = {
        "u16": numbers,
        "u32": st.integers(0, 2**32 - 1),
        "i32": int32,
        "f32": st.floats(width=32, allow_nan=False),
    }
    values: dict[str, registers.Value] = {}
    for field in block.fields:
        if field.type == "text":
            values[field.name] = draw(st.text("abcXYZ 0123", max_size=2 * field.count))
        elif field.count > 1:
            values[field.name] = tuple(draw(ranges[field.type]) for _ in range(field.count))
        else:
            values[field.name] = draw(ranges[field.type])
    return values


@st.composite
def written_blocks(draw: st.DrawFn) -> tuple[registers.Block, list[int]]:
    """A block and registers of it."""
    block = draw(blocks)
    via = (
        draw(st.lists(int32, min_size=block.axes, max_size=block.axes)) * draw(st.integers(0, block.max_points))
        if block.optional_points
        else []
    )
    return block, block.encode(values_of(block, draw), via)


@given(written_blocks(), st.data())
def test_a_block_survives_and_a_mangled_one_does_not(
    written: tuple[registers.Block, list[int]], data: st.DataObject
) -> None:
    """Decoded and encoded again: the same registers; one bit, one register, the length or the word order: refused."""
    block, values = written
    fields, via = block.decode(values)
    assert block.encode(fields, via) == values
    how = data.draw(st.sampled_from(["bit", "shift", "cut", "swap"]))
    if how == "bit":
        at = data.draw(st.integers(0, len(values) - 1))
        bad = [*values[:at], values[at] ^ 1 << data.draw(st.integers(0, 15)), *values[at + 1 :]]
    elif how == "shift":
        bad = [*values[1:], 0]
    elif how == "cut":
        bad = values[: data.draw(st.integers(0, len(values) - 1))]
    else:
        bad = [value for pair in zip(values[1::2], values[::2], strict=False) for value in pair]
    if bad != values:
        with pytest.raises(ProtocolError):
            block.decode(bad)


@given(numbers, st.integers(0, 255), st.one_of(st.none(), numbers), st.lists(numbers, min_size=1, max_size=123))
def test_modbus_telegrams_survive(address: int, unit: int, transaction: int | None, values: list[int]) -> None:
    """FC16 and FC04, TCP and RTU."""
    header = stations.Header(unit, transaction)
    pdu = struct.pack(f">BHHB{len(values)}H", 16, address, len(values), 2 * len(values), *values)
    packet = stations.pack(header, pdu)
    unpacked = stations.parse_rtu(packet) if transaction is None else stations.parse_tcp(packet)
    assert unpacked == (header, pdu)
    assert stations.parse_pdu(pdu) == stations.Write(address, tuple(values))
    split_packets = stations.split_rtu(packet) if transaction is None else stations.split_tcp(packet)
    assert split_packets == ([packet], b"")


@given(st.binary(max_size=300))
def test_any_bytes_make_no_modbus_crash(data: bytes) -> None:
    """Cut and read without an exception; what is kept is what came last."""
    stations.parse_pdu(data)
    stations.parse_tcp(data)
    stations.parse_rtu(data)
    cut = stations.split_tcp(data)
    assert cut is None or data.endswith(cut[1])
    assert data.endswith(stations.split_rtu(data)[1])


def test_crc16_has_its_published_check_value() -> None:
    """0x4B37 over "123456789" (the catalogue of parametrised CRC algorithms)."""
    assert stations.crc16(b"123456789") == 0x4B37


def test_the_kr16_fits_a_hello() -> None:
    """The capabilities of the KR 16 survive both wires' forms."""
    from drivers.contract import Capabilities

    limits = KR16
    able = Capabilities("emulator", limits.lower, limits.upper, limits.max_step, 0.5, None, True, False)
    again = messages.parse_hello(messages.hello_frame(3, able))
    assert again is not None
    assert again.upper.tolist() == able.upper.tolist()
    assert (again.max_speed, again.max_via, again.controller) == (0.5, None, "emulator")
