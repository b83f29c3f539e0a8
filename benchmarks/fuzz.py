"""Corrupted frames and telegrams against the codecs: none may crash them, none may be accepted as another message.

Valid frames with random values are corrupted as on a wire: flipped bits, lost, doubled, swapped or inserted bytes,
bursts, cuts, joined frames, exchanged digits. A decoded frame that is not among the valid frames is a *false
accept*. A
CRC-32 must detect it in frames of the serial line and blocks of the register map; RTU telegrams have a CRC-16 before
the block's CRC-32, TCP telegrams only the latter.

`FUZZ_FRAMES` in the environment changes the 1,000,000 frames.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable
from time import perf_counter
from typing import Any

import numpy as np

from drivers.contract import Answer, Mode, Move, Reset, RobotState, Stop
from drivers.emulated import stations
from drivers.errors import ProtocolError
from drivers.wire import Give, Stage, Take, split_move
from drivers.wires import modbus_protocol as registers
from drivers.wires import serial_protocol as messages
from drivers.wires.serial_protocol import decode_frame, encode_frame, split_frames

GOOD = 500
"""Different valid frames of each form, each corrupted many times."""

Decoder = Callable[[bytes], "set[bytes]"]
"""Bytes to what was accepted in them, in its one spelling."""


def corrupted(good: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """Return one frame after corruption."""
    data, n = bytearray(good), len(good)
    at = int(rng.integers(n))
    match int(rng.integers(9)):
        case 0:
            for _ in range(int(rng.integers(1, 9))):
                data[int(rng.integers(n))] ^= 1 << int(rng.integers(8))
        case 1:
            del data[at : at + int(rng.integers(1, 6))]
        case 2:
            data[at:at] = data[at : at + int(rng.integers(1, 6))]
        case 3:
            data[at:at] = rng.integers(0, 256, int(rng.integers(1, 6)), dtype=np.uint8).tobytes()
        case 4:
            burst = rng.integers(0, 256, int(rng.integers(1, 12)), dtype=np.uint8).tobytes()
            data[at : at + len(burst)] = burst
        case 5:
            data = data[:at]
        case 6:
            data = data[:at] + bytearray(other[int(rng.integers(len(other))) :])
        case 7:
            there = int(rng.integers(n))
            data[at], data[there] = data[there], data[at]
        case _:
            for _ in range(int(rng.integers(1, 4))):
                data[int(rng.integers(n))] = int(rng.choice(list(b"0123456789ABCDEF,*-<>")))
    return bytes(data)


def serial_frames(rng: np.random.Generator) -> list[bytes]:
    """Return valid frames of all kinds."""
    valid = []
    for k in range(GOOD):
        points = rng.integers(-(2**31), 2**31, (int(rng.integers(1, 13)), 6)).astype(np.int32)
        axes, number = points[0], int(rng.integers(65536))
        state = RobotState(Mode(k % 5), axes, bool(k % 2), number, 0, number, 20, 1, 4001, "a fault", 1)
        frames = (
            messages.request_frame(number, 0, messages.Hello()),
            messages.request_frame(number, number, messages.ReadState()),
            messages.request_frame(number, number, Take(1000) if k % 2 else Give()),
            messages.request_frame(number, number, Stage(number, points)),
            messages.request_frame(number, number, split_move(Move(points, 0.5), 12)[1]),
            messages.request_frame(number, number, Stop() if k % 2 else Reset()),
            messages.status_frame(number, state),
            messages.answer_frame(number, "MOVE", Answer(number, 3, "via point 0 has A1 at 185.0001 deg")),
        )
        valid.append(encode_frame(frames[k % len(frames)]))
    return valid


def accepted_frames(data: bytes) -> set[bytes]:
    """Return the frames that the serial receivers accept, arguments included."""
    found = set()
    for candidate in split_frames(data)[0]:
        frame = decode_frame(candidate)
        if frame is None:
            continue
        found.add(encode_frame(frame))
        messages.parse_request(frame)
        messages.parse_status(frame)
        messages.parse_answer(frame, frame.kind)
        messages.parse_hello(frame)
    return found


_COMMAND = registers.COMMAND.for_axes(6)


def command_blocks(rng: np.random.Generator) -> list[list[int]]:
    """Return valid command blocks."""
    valid = []
    for k in range(GOOD):
        points = rng.integers(-(2**31), 2**31, (k % 10, 6))
        values: dict[str, registers.Value] = {
            "heartbeat": k, "session": 4711, "sequence": int(rng.integers(1, 65536)), "watchdog_ms": 1000,
            "command": (0, 1, 2, 4, 5, 6, 9)[k % 7], "speed": int(rng.integers(1, 10001)), "points": len(points),
            "offset": k, "count": k, "points_crc": int(rng.integers(2**32)),
        }  # fmt: skip
        valid.append(_COMMAND.encode(values, points.ravel().tolist()))
    return valid


def telegrams(rng: np.random.Generator, transaction: int | None) -> list[bytes]:
    """Return valid FC16 telegrams, TCP or RTU."""
    valid = []
    for block in command_blocks(rng):
        pdu = struct.pack(f">BHHB{len(block)}H", 16, 0, len(block), 2 * len(block), *block)
        valid.append(stations.pack(stations.Header(1, transaction), pdu))
    return valid


def accepted_blocks(data: bytes, rtu: bool) -> set[bytes]:
    """Return the command blocks that a controller would accept from these bytes."""
    cut = stations.split_rtu(data) if rtu else stations.split_tcp(data)
    found = set()
    for packet in cut[0] if cut else []:
        unpacked = stations.parse_rtu(packet) if rtu else stations.parse_tcp(packet)
        request = stations.parse_pdu(unpacked[1]) if unpacked else None
        if not isinstance(request, stations.Write) or request.address != registers.COMMAND.address:
            continue
        try:
            values, points = _COMMAND.decode(request.values)
        except ProtocolError:
            continue
        found.add(struct.pack(f">{len(request.values)}H", *_COMMAND.encode(values, points)))
    return found


def fuzz(good: list[bytes], accept: Decoder, frames: int, rng: np.random.Generator) -> dict[str, Any]:
    """Corrupt, decode and count.

    Args:
        good: valid frames.
        accept: function from bytes to the frames that a receiver accepts.
        frames: number of corrupted frames.
        rng: random stream of the corruption.
    """
    meanings = [accept(data) for data in good]
    assert all(meanings)
    crashes = false = survived = 0
    began = perf_counter()
    for k in range(frames):
        a, b = k % len(good), int(rng.integers(len(good)))
        data = corrupted(good[a], good[b], rng)
        try:
            decoded = accept(data)
        except Exception:  # any exception is a crash
            crashes += 1
            continue
        survived += bool(decoded)
        false += bool(decoded - meanings[a] - meanings[b])
    return {
        "mangled": frames,
        "seconds": perf_counter() - began,
        "crashes": crashes,
        "false accepts": false,
        "still whole": survived,
    }


def run(frames: int | None = None, seed: int = 0) -> list[dict[str, Any]]:
    """Return a row for each form."""
    total = int(os.environ.get("FUZZ_FRAMES", "1000000")) if frames is None else frames
    forms: tuple[tuple[str, Callable[[np.random.Generator], list[bytes]], Decoder, int], ...] = (
        ("serial frame", serial_frames, accepted_frames, total // 2),
        ("Modbus TCP", lambda rng: telegrams(rng, 7), lambda data: accepted_blocks(data, rtu=False), total // 4),
        ("Modbus RTU", lambda rng: telegrams(rng, None), lambda data: accepted_blocks(data, rtu=True), total // 4),
    )
    rows = []
    for name, make, accept, n in forms:
        rng = np.random.default_rng(seed)
        rows.append({"form": name, **fuzz(make(rng), accept, n, rng)})
    return rows
