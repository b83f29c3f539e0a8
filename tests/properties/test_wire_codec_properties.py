"""Codecs of the wires: decoding inverts encoding, and a corrupted message is never accepted as another one."""

import struct
import zlib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.contract import FULL, Answer, Mode, Move, Reset, RobotState, Stop
from drivers.emulated import stations
from drivers.errors import ProtocolError
from drivers.wire import (
    Give,
    Stage,
    StagingBuffer,
    Take,
    points_crc,
    speed_from_wire,
    speed_to_wire,
    split_move,
)
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
from tests.support.driver_bench import KR16

numbers = st.integers(0, 65535)
int32 = st.integers(-(2**31), 2**31 - 1)
texts = st.text(max_size=60)


def points(lowest: int = 1, highest: int = 12) -> st.SearchStrategy[np.ndarray]:
    """Return a strategy for (n, 6) int32 arrays."""
    rows = st.lists(st.lists(int32, min_size=6, max_size=6), min_size=lowest, max_size=highest)
    return rows.map(lambda values: np.array(values, dtype=np.int32).reshape(-1, 6))


requests = st.one_of(
    st.builds(messages.Hello),
    st.builds(messages.ReadState),
    st.builds(Take, st.integers(0, 65535)),
    st.builds(Give),
    st.builds(Stage, st.integers(0, 10**6), points()),
    st.tuples(points(), st.floats(1e-4, 1.0)).map(lambda arguments: split_move(Move(*arguments), 12)[1]),
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
    """Decoding inverts encoding; a frame fits MAX_FRAME, is ASCII and one line."""
    data = encode_frame(frame)
    assert decode_frame(data) == frame
    assert len(data) <= MAX_FRAME
    assert data.isascii()
    assert data.count(b"\n") == 1


@given(numbers, numbers, requests)
def test_a_request_survives_its_frame(number: int, session: int, request: messages.Request) -> None:
    """Parsing inverts building, compared by frames because arrays have no equality."""
    frame = messages.request_frame(number, session, request)
    parsed = messages.parse_request(frame)
    assert parsed is not None
    assert messages.request_frame(number, *parsed) == frame


@given(numbers, states)
def test_a_state_survives_its_frame(number: int, state: RobotState) -> None:
    """All fields, including the text, are unchanged by encoding and decoding."""
    frame = messages.status_frame(number, state)
    parsed = messages.parse_status(frame)
    assert parsed is not None
    assert messages.status_frame(number, parsed) == frame
    assert parsed.axes.tolist() == state.axes.tolist()
    assert parsed.fault_message == state.fault_message


@given(st.sampled_from([TO_CONTROLLER, FROM_CONTROLLER]), numbers, st.text("ASTOPEMVHLR,0123456789-AF ", max_size=60))
def test_each_message_has_one_spelling(start: str, number: int, body: str) -> None:
    """No two bodies encode the same request or answer."""
    frame = Frame(start, number, body)
    request = messages.parse_request(frame)
    if request is not None:
        assert messages.request_frame(number, *request) == frame
    answer = messages.parse_answer(frame, "MOVE")
    if answer is not None:
        assert messages.answer_frame(number, "MOVE", answer) == frame


@given(st.binary(max_size=80))
def test_any_bytes_are_no_frame_or_the_only_spelling_of_one(data: bytes) -> None:
    """Decoding any bytes raises no error, and a decoded frame has exactly one encoding."""
    frame = decode_frame(data)
    assert frame is None or encode_frame(frame) == data


@given(frames, st.data())
def test_a_corrupted_frame_is_no_frame(frame: Frame, data: st.DataObject) -> None:
    """Frames with flipped bits, cuts, joins or lower case are refused."""
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
def test_frames_are_found_in_any_stream(sent: list[Frame], noise: list[bytes], data: st.DataObject) -> None:
    """With noise between frames and any division into reads, exactly the sent frames are found, in order."""
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
def test_a_body_that_no_frame_can_hold_is_refused(body: str) -> None:
    """A body that is empty, too long, without kind or with invalid characters is refused."""
    with pytest.raises(ProtocolError, match="cannot carry"):
        encode_frame(Frame(">", 1, body))


def test_an_endless_line_is_not_kept() -> None:
    """After a megabyte without LF at most one frame remains."""
    _, rest = split_frames(b">" + b"x" * 1_000_000)
    assert len(rest) <= MAX_FRAME


@given(points(1, 40), st.floats(1e-4, 1.0), st.integers(1, 12), st.integers(1, 65535), st.randoms())
def test_a_staged_move_is_assembled(via: np.ndarray, speed: float, size: int, sequence: int, random: object) -> None:
    """Split, written in order with repetitions, committed: the same points; another number or point is refused."""
    stages, commit = split_move(Move(via, speed), size)
    staging = StagingBuffer()
    for stage in stages:
        assert staging.write(sequence, stage)
        assert staging.write(sequence, stage)
    assembled = staging.assemble(sequence, commit)
    assert assembled is not None
    assert (assembled == via).all()
    assert staging.assemble(sequence, commit) is not None
    assert all(len(stage.points) <= size for stage in stages)
    assert len(commit.tail) <= size
    if stages:
        assert staging.assemble(sequence % 65535 + 1, commit) is None
        staging.write(sequence, Stage(0, stages[0].points ^ 1))
        assert staging.assemble(sequence, commit) is None
        assert not StagingBuffer().write(sequence, Stage(1, stages[0].points))


def test_the_crc_of_points_is_zlibs_over_big_endian_counts() -> None:
    """The CRC is that of zlib, point by point from A1 to A6."""
    via = np.array([[1, -2, 3, -4, 5, -6], [7, 8, 9, 10, 11, 12]], dtype=np.int32)
    assert points_crc(via) == zlib.crc32(struct.pack(">12i", 1, -2, 3, -4, 5, -6, *range(7, 13)))


@given(st.floats())
def test_a_speed_is_never_rounded_up(speed: float) -> None:
    """A value outside (0, 1] becomes 0, which is refused."""
    wire = speed_to_wire(speed)
    assert 0 <= wire <= FULL
    assert speed_from_wire(wire) <= max(speed, 0.0) + 1e-10 or not speed > 0
    assert wire == 0 or speed - speed_from_wire(wire) < 1e-4


def test_every_speed_on_the_wire_is_exact() -> None:
    """All multiples of 1e-4 are unchanged on the wire."""
    assert all(speed_to_wire(speed_from_wire(k)) == k for k in range(FULL + 1))


blocks = st.sampled_from([block.for_axes(axes) for axes in (6, 9) for block in registers.BLOCKS])


def values_of(block: registers.Block, draw: st.DrawFn) -> dict[str, registers.Value]:
    """Draw values of a block's fields."""
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
    """Draw a block and its registers."""
    block = draw(blocks)
    via = (
        draw(st.lists(int32, min_size=block.axes, max_size=block.axes)) * draw(st.integers(0, block.max_points))
        if block.optional_points
        else []
    )
    return block, block.encode(values_of(block, draw), via)


@given(written_blocks(), st.data())
def test_a_block_survives_and_a_corrupted_one_is_refused(
    written: tuple[registers.Block, list[int]], data: st.DataObject
) -> None:
    """Encoding inverts decoding; a flipped bit, shift, cut or swap of words is refused."""
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
    """FC16 telegrams are unchanged over TCP and RTU."""
    header = stations.Header(unit, transaction)
    pdu = struct.pack(f">BHHB{len(values)}H", 16, address, len(values), 2 * len(values), *values)
    packet = stations.pack(header, pdu)
    unpacked = stations.parse_rtu(packet) if transaction is None else stations.parse_tcp(packet)
    assert unpacked == (header, pdu)
    assert stations.parse_pdu(pdu) == stations.Write(address, tuple(values))
    split_packets = stations.split_rtu(packet) if transaction is None else stations.split_tcp(packet)
    assert split_packets == ([packet], b"")


@given(st.binary(max_size=300))
def test_any_bytes_are_split_and_parsed_without_error(data: bytes) -> None:
    """Any bytes are parsed without error, and the kept part is the end of the stream."""
    stations.parse_pdu(data)
    stations.parse_tcp(data)
    stations.parse_rtu(data)
    cut = stations.split_tcp(data)
    assert cut is None or data.endswith(cut[1])
    assert data.endswith(stations.split_rtu(data)[1])


def test_crc16_has_its_published_check_value() -> None:
    """0x4B37 over "123456789" (catalogue of parametrised CRC algorithms)."""
    assert stations.crc16(b"123456789") == 0x4B37


def test_the_lengths_of_rtu_telegrams() -> None:
    """The length is found from a single function code up to 256 bytes."""
    header = stations.Header(17, None)
    for size in (1, 253):
        pdu = bytes(range(7, 7 + size % 200)) + bytes(size - size % 200)
        assert stations.parse_rtu(stations.pack(header, pdu)) == (header, pdu)
    assert stations.parse_rtu(stations.pack(header, bytes(254))) is None
    assert stations.parse_rtu(stations.pack(header, b"")) is None


def test_capabilities_survive_their_frame() -> None:
    """Limits, speed, unlimited via points and name are unchanged by encoding and decoding."""
    sent = replace(KR16.capabilities("emulator", hardware=True, simulated_time=False), max_speed=0.5)
    parsed = messages.parse_hello(messages.hello_frame(3, sent))
    assert parsed is not None
    assert parsed.upper.tolist() == sent.upper.tolist()
    assert (parsed.max_speed, parsed.max_via, parsed.controller) == (0.5, None, "emulator")
