"""The controller's side of the Modbus map: bytes of one telegram in, bytes of its answer out; TCP and RTU alike."""

import math
from dataclasses import replace

import numpy as np

from drivers.commands import Answer, Reset, Result, Stop
from drivers.emulated.endpoint import Endpoint
from drivers.errors import ProtocolError
from drivers.wire import SCALES, Commit, Stage, speed_to_wire
from drivers.wires.modbus import adu
from drivers.wires.modbus import register_map as registers

RTU_SILENCE = 0.05
"""Silence [s] after which the rest of a broken telegram is dropped; the specification's 3.5 characters are far less."""


class ModbusStation:
    """Answers telegrams.

    Args:
        endpoint: the controller.
        unit: device address; telegrams for others are left to them.
        rtu: RTU instead of TCP.
    """

    def __init__(self, endpoint: Endpoint, *, unit: int = 1, rtu: bool = False) -> None:
        self.endpoint = endpoint
        self._unit, self._rtu = unit, rtu
        self._axes = len(endpoint.limits.lower)
        self._blocks = {block.name: block.of(self._axes) for block in registers.BLOCKS}
        self.silence = RTU_SILENCE if rtu else math.inf
        self.forget()

    def forget(self) -> None:
        """The controller was restarted."""
        self._heartbeat = self._owners = -1
        self._answer = Answer(0, Result.OK)

    def split(self, received: bytes) -> tuple[list[bytes], bytes] | None:
        """Cut a stream into telegrams and the rest; None: it cannot be Modbus."""
        return adu.split_rtu(received) if self._rtu else adu.split_tcp(received)

    def answer(self, packet: bytes) -> bytes:
        """The answer; empty where there is none: to what is no telegram, or is meant for another device."""
        unpacked = self._unpack(packet)
        if unpacked is None or unpacked[0].unit != self._unit:
            return b""
        header, pdu = unpacked
        match adu.request_of(pdu):
            case adu.Read() as request:
                return adu.pack(header, self._read(request))
            case adu.Write() as request:
                return adu.pack(header, self._write(request))
            case refusal:
                return adu.pack(header, adu.refusal_pdu(refusal))

    def refuse(self, packet: bytes) -> bytes:
        """An exception telegram, nothing executed: the device failed."""
        unpacked = self._unpack(packet)
        if unpacked is None:
            return b""
        header, pdu = unpacked
        return adu.pack(header, adu.refusal_pdu(adu.Refusal(pdu[0] & 0x7F, adu.DEVICE_FAILURE)))

    def _unpack(self, packet: bytes) -> tuple[adu.Header, bytes] | None:
        return adu.unpack_rtu(packet) if self._rtu else adu.unpack_tcp(packet)

    def _read(self, request: adu.Read) -> bytes:
        for name, tell in ((registers.STATUS.name, self._status), (registers.CAPABILITIES.name, self._capabilities)):
            block = self._blocks[name]
            first = request.address - block.address
            if first >= 0 and first + request.count <= block.registers:
                values = tell()
                return adu.registers_pdu(block.encode(values)[first : first + request.count])
        return adu.refusal_pdu(adu.Refusal(adu.READ_INPUT, adu.ILLEGAL_ADDRESS))

    def _write(self, request: adu.Write) -> bytes:
        if request.address != registers.COMMAND.address:
            return adu.refusal_pdu(adu.Refusal(adu.WRITE_HOLDING, adu.ILLEGAL_ADDRESS))
        try:
            values, counts = self._blocks[registers.COMMAND.name].decode(request.values)
        except ProtocolError:
            return adu.refusal_pdu(adu.Refusal(adu.WRITE_HOLDING, adu.ILLEGAL_VALUE))
        points = np.array(counts, dtype=np.int32).reshape(-1, self._axes)
        whole = {name: value for name, value in values.items() if isinstance(value, int)}
        if whole["points"] != len(points):
            return adu.refusal_pdu(adu.Refusal(adu.WRITE_HOLDING, adu.ILLEGAL_VALUE))
        self._heartbeat, session = whole["heartbeat"], whole["session"]
        if whole["command"] != registers.NONE:
            self._answer = self._command(whole, points)
        if session and session == self.endpoint.owner and self._heartbeat != self._owners:
            self._owners = self._heartbeat  # a gateway that repeats the last block is no sign of life
            self.endpoint.hear(session)
        return adu.written_pdu(request)

    def _command(self, whole: dict[str, int], points: np.ndarray[tuple[int, int], np.dtype[np.int32]]) -> Answer:
        sequence, session = whole["sequence"], whole["session"]
        match whole["command"]:
            case registers.MOVE if len(points):
                commit = Commit(whole["speed"], whole["count"], whole["points_crc"], points)
                return self.endpoint.commit(session, sequence, commit)
            case registers.STAGE if len(points):
                return self.endpoint.stage(session, sequence, Stage(whole["offset"], points))
            case registers.STOP:
                return self.endpoint.command(session, sequence, Stop())
            case registers.RESET:
                return self.endpoint.command(session, sequence, Reset())
            case registers.TAKE:
                return replace(self.endpoint.take(session, whole["watchdog_ms"]), sequence=sequence)
            case registers.GIVE:
                return replace(self.endpoint.give(session), sequence=sequence)
        return Answer(sequence, Result.UNKNOWN_COMMAND)

    def _status(self) -> dict[str, registers.Value]:
        state = self.endpoint.report()
        return {
            **_IDENTITY,
            "heartbeat": state.heartbeat or 0,
            "boot": state.boot,
            "echo": max(self._heartbeat, 0),
            "flags": state.flags,
            "mode": int(state.mode),
            "owner": state.owner,
            "ack_sequence": state.ack_sequence,
            "ack_result": int(state.ack_result),
            "done_sequence": state.done_sequence,
            "done_result": int(state.done_result),
            "answer_sequence": self._answer.sequence,
            "answer_result": int(self._answer.result),
            "queue_depth": state.queue_depth,
            "fault_code": int(state.fault_code),
            "override": state.override,
            "path": state.path,
            "n_axes": self._axes,
            "axes": tuple(state.axes.tolist()),
        }

    def _capabilities(self) -> dict[str, registers.Value]:
        able = self.endpoint.capabilities
        return {
            **_IDENTITY,
            "n_axes": self._axes,
            "time_scale": round(able.time_scale * SCALES),
            "max_speed": speed_to_wire(able.max_speed),
            "max_via": able.max_via or 0,
            "lower": tuple(able.lower.tolist()),
            "upper": tuple(able.upper.tolist()),
            "max_step": tuple(able.max_step.tolist()),
            "name": able.controller,
        }


_IDENTITY: dict[str, registers.Value] = {
    "magic": registers.MAGIC,
    "version": registers.MAP_VERSION,
    "word_order": registers.WORD_ORDER,
}
