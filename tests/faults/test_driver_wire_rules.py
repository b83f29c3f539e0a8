"""The rules of the wire, on a wire in memory and a clock that a test moves: heartbeats, numbers, answers, refusals."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cell.robot import model as robot
from drivers.contract import LAST_SEQUENCE, Fault, Mode, Move, Reset, Result, Stop
from drivers.errors import (
    FaultError,
    LinkError,
    LinkLostError,
    ProtocolError,
    RefusedError,
    StateUnknownError,
)
from drivers.limits import Limits
from drivers.setpoints import SetPoints, from_rad
from drivers.wire import MAX_POINTS
from drivers.wires import modbus_protocol as registers
from drivers.wires.serial_protocol import Frame, decode_frame, encode_frame

KR16 = Limits.from_rad(robot.limits(robot.load()))

HOME = from_rad(np.radians([0.0, -90.0, 90.0, 0.0, 90.0, 0.0]))


def turned(*degrees: float) -> SetPoints:
    """(N, 6) home with A1 turned."""
    points = np.tile(HOME, (len(degrees), 1))
    points[:, 0] = np.round(np.array(degrees) * 1e4)
    return points


def begin(wire: Any, degrees: float, speed: float = 0.2) -> None:
    """Start a move and do not wait for its end."""
    sequence = wire.driver.state().ack_sequence + 1
    assert wire.link.send(sequence, Move(turned(degrees), speed)).result == Result.OK


def test_a_silent_client_stops_a_moving_arm_on_its_path(wire: Any) -> None:
    """After the watchdog's time the arm brakes, the fault is latched with a sentence, and only a reset helps."""
    begin(wire, 90.0)
    wire.clock.wait(0.45)
    assert wire.endpoint.controller.state().mode is Mode.MOVING
    wire.clock.wait(5.0)
    state = wire.driver.state()
    assert (state.mode, state.fault_code) == (Mode.FAULT, Fault.WATCHDOG)
    assert state.done_result == Result.FAULTED
    assert "heartbeat" in state.fault_message
    assert 0 < state.axes[0] < 900_000
    assert (state.axes[1:] == HOME[1:]).all()
    wire.driver.stop()
    with pytest.raises(RefusedError, match="reset first"):
        wire.driver.move(turned(0.0), 1.0)
    wire.driver.reset()
    assert wire.driver.move(turned(0.0), 1.0).mode is Mode.IN_POSITION


def test_a_silent_client_of_an_arm_that_stands_is_no_fault(wire: Any) -> None:
    """Ten minutes of scanning between two moves, and a move as first thing after them."""
    wire.driver.move(turned(5.0), 1.0)
    for _ in range(600):
        wire.clock._now += 1.0
        wire.server.step()
    assert wire.driver.state().fault_code == 0
    assert wire.driver.move(turned(0.0), 1.0).mode is Mode.IN_POSITION


def test_a_waiting_client_keeps_a_slow_move_alive(wire: Any) -> None:
    """A move of more than six watchdog times."""
    began = wire.clock.now()
    assert wire.driver.move(turned(6.0), 0.01).mode is Mode.IN_POSITION
    assert wire.clock.now() - began > 3.0


def test_a_gateway_that_repeats_the_last_message_is_no_sign_of_life(wire: Any) -> None:
    """The same bytes again and again, as a fieldbus gateway writes its image, do not feed the watchdog."""
    begin(wire, 90.0)
    sent: list[bytes] = []
    take = wire.line.receive
    wire.line.receive = lambda seconds: [sent.append(data) or (peer, data) for peer, data in take(seconds)]
    wire.driver.state()
    telegram = sent[0]
    wire.line.receive = take
    for _ in range(80):
        wire.line.to_server.append((wire.line.connection, telegram))
        wire.clock.wait(0.01)
    assert wire.endpoint.controller.state().fault_code == Fault.WATCHDOG


def test_the_client_says_how_long_its_silence_may_last(bench: Callable[..., Any], backend: str) -> None:
    """The controller takes 100 ms to 5 s; what is beyond is refused, and the arm is nobody's."""
    for asked in (0.1, 5.0, 0.099, 5.001, 0.0, 65.535):
        made = bench(backend)
        object.__setattr__(made.link, "_timeouts", type(made.link._timeouts)(answer=0.05, watchdog=asked))
        made.driver.connect()
        if not 0.1 <= asked <= 5.0:
            with pytest.raises(RefusedError, match="outside 100 to 5000 ms") as refused:
                made.driver.move(turned(1.0), 1.0)
            assert refused.value.result == Result.WATCHDOG
            assert made.driver.state().owner == 0
            continue
        made.driver.take()
        begin(made, 180.0, 0.05)
        made.driver.state()
        made.clock.wait(asked - 0.05)
        assert made.endpoint.controller.state().fault_code == 0
        made.clock.wait(0.2)
        assert made.endpoint.controller.state().fault_code == Fault.WATCHDOG


def test_a_frozen_heartbeat_is_a_lost_line(wire: Any) -> None:
    """A gateway goes on answering for a controller that is dead: the client does not wait for the move for ever."""
    report = wire.endpoint.report
    frozen = report()

    def dead() -> Any:
        return replace(report(), heartbeat=frozen.heartbeat)

    begin(wire, 170.0, 0.02)
    wire.endpoint.report = dead
    while wire.driver.state().at_rest is False and wire.clock.now() < 0.4:
        wire.clock.wait(0.02)
    wire.clock.wait(0.3)
    with pytest.raises(LinkLostError, match="has not changed"):
        wire.driver.state()
    wire.endpoint.report = report
    assert wire.driver.stop().at_rest


def test_a_frozen_heartbeat_while_waiting_is_state_unknown(wire: Any) -> None:
    """And a stop, once the controller is back, makes it known."""
    report = wire.endpoint.report
    real_wait = wire.clock.wait

    def freeze(seconds: float) -> None:
        wire.endpoint.report = lambda: replace(report(), heartbeat=7)
        real_wait(seconds)

    wire.clock.wait = freeze
    with pytest.raises(StateUnknownError, match="has not changed"):
        wire.driver.move(turned(170.0), 0.02)
    wire.clock.wait, wire.endpoint.report = real_wait, report
    with pytest.raises(StateUnknownError, match="stop"):
        wire.driver.move(turned(0.0), 1.0)
    assert wire.driver.stop().at_rest
    assert wire.driver.reset().fault_code == 0


def test_a_clock_that_jumps_ahead_stops_and_one_that_jumps_back_does_not(wire: Any) -> None:
    """A jump of the wire's clock is taken for silence, which is safe; a jump back only makes the watchdog patient."""
    begin(wire, 90.0, 0.05)
    wire.clock._now -= 1000.0
    wire.clock.wait(0.1)
    assert wire.driver.state().mode is Mode.MOVING
    wire.clock._now += 5000.0
    wire.server.step()
    assert wire.endpoint.controller.state().fault_code in (0, Fault.WATCHDOG)
    assert wire.driver.stop().at_rest
    wire.driver.reset()
    assert wire.driver.move(turned(0.0), 1.0).mode is Mode.IN_POSITION


def test_a_zero_length_move_over_the_wire(wire: Any) -> None:
    """Is done at once, and counted."""
    before = wire.clock.now()
    state = wire.driver.move(HOME[None].copy(), 0.5)
    assert (state.mode, state.done_sequence) == (Mode.IN_POSITION, 1)
    assert wire.clock.now() - before < 0.1


def test_the_sequence_wraps_over_the_wire(wire: Any) -> None:
    """65535 is followed by 1, on both sides."""
    wire.endpoint.command(wire.endpoint.owner, LAST_SEQUENCE - 1, Stop())
    wire.driver.close()
    wire.driver.connect()
    numbers = [wire.driver.move(turned(degrees), 1.0).done_sequence for degrees in (1.0, 2.0, 3.0)]
    assert numbers == [LAST_SEQUENCE, 1, 2]


def test_many_via_points_are_one_move(bench: Callable[..., Any], backend: str) -> None:
    """600 points in frames of 12 or blocks of 9; each arrives, and the journal has one move."""
    made = bench(backend, time_scale=1e6)
    made.driver.connect()
    points = np.random.default_rng(0).integers(KR16.lower, KR16.upper, (600, 6), dtype=np.int32)
    assert made.driver.move(points, 1.0).axes.tolist() == points[-1].tolist()
    (move,) = made.journal.of("move")
    assert move["set_points"] == points.tolist()


def test_a_hundred_thousand_via_points_over_the_serial_line(bench: Callable[..., Any]) -> None:
    """8,334 frames make one move."""
    made = bench("serial", time_scale=1e6)
    made.driver.connect()
    points = np.random.default_rng(0).integers(KR16.lower, KR16.upper, (100_000, 6), dtype=np.int32)
    assert made.driver.move(points, 1.0).axes.tolist() == points[-1].tolist()
    assert len(made.journal.of("move")) == 1


def test_more_via_points_than_the_controller_holds_are_refused_unsent(wire: Any) -> None:
    """By the client, with the number that would be taken."""
    with pytest.raises(RefusedError, match="at most 200000") as refused:
        wire.driver.move(np.tile(HOME, (MAX_POINTS + 1, 1)), 1.0)
    assert refused.value.result == Result.TOO_MANY_POINTS
    assert wire.driver.state().ack_sequence == 0


@pytest.mark.parametrize(
    ("points", "speed", "result"),
    [
        (turned(185.0001), 0.5, Result.LIMIT),
        (np.full((1, 6), 2**31 - 1, dtype=np.int32), 0.5, Result.LIMIT),
        (np.full((1, 6), -(2**31), dtype=np.int32), 0.5, Result.LIMIT),
        (turned(1.0), 1.5, Result.SPEED),
        (turned(1.0), 0.0, Result.SPEED),
        (turned(1.0), float("nan"), Result.SPEED),
        (turned(1.0), 1e-9, Result.SPEED),
    ],
    ids=["limit", "largest int32", "smallest int32", "too fast", "no speed", "NaN", "slower than a wire can say"],
)
def test_the_controller_refuses_what_a_client_did_not(
    wire: Any, points: SetPoints, speed: float, result: Result
) -> None:
    """Sent past the client's own check: refused on the other side, nothing moves, the number is used up."""
    assert wire.link.send(1, Move(points, speed)).result == result
    state = wire.driver.state()
    assert (state.ack_sequence, state.ack_result, state.done_sequence) == (1, result, 0)
    assert wire.journal.of("move") == []


def test_a_step_too_large_is_refused_on_both_sides(wire: Any) -> None:
    """By the client, and past it by the controller."""
    limits = wire.endpoint.limits
    small = np.full(6, 50_000, np.int32)
    wire.endpoint.controller.limits = type(limits)(
        limits.lower, limits.upper, limits.velocity, limits.acceleration, small
    )
    assert wire.link.send(1, Move(turned(5.0001), 1.0)).result == Result.STEP
    wire.endpoint.limits = wire.endpoint.controller.limits
    wire.driver.close()
    wire.driver.connect()
    with pytest.raises(RefusedError) as refused:
        wire.driver.move(turned(5.0001), 1.0)
    assert refused.value.result == Result.STEP
    assert wire.driver.state().ack_sequence == 1


def test_a_command_is_executed_once_and_a_repeat_gets_the_old_answer(wire: Any) -> None:
    """Again and again under one number; and another command under a used number is refused."""
    move = Move(turned(3.0), 1.0)
    answers = {wire.link.send(1, move).result for _ in range(5)}
    assert answers == {Result.OK}
    assert len(wire.journal.of("move")) == 1
    assert wire.link.send(1, Move(turned(4.0), 1.0)).result == Result.REUSED
    assert wire.link.send(1, Reset()).result == Result.REUSED
    assert wire.link.send(2, Stop()).result == Result.OK
    assert wire.link.send(1, move).result == Result.STALE
    assert len(wire.journal.of("move")) == 1


def test_staged_points_that_went_missing_are_staged_again(wire: Any) -> None:
    """The commit is not taken, the number stays unused, and the client sends all of it once more."""
    wire.link.state()
    put, spoiled = wire.endpoint._staging.write, [False]

    def forgetful(sequence: int, piece: Any) -> bool:
        if piece.offset and not spoiled[0]:
            spoiled[0] = True
            return True
        return bool(put(sequence, piece))

    wire.endpoint._staging.write = forgetful
    points = np.tile(HOME, (60, 1))
    points[:, 5] = np.arange(60) * 100
    assert wire.driver.move(points, 1.0).axes.tolist() == points[-1].tolist()
    assert spoiled[0]
    (entry,) = wire.journal.of("move")
    assert entry["set_points"] == points.tolist()
    assert entry["sequence"] == 1


def test_a_controller_restarted_between_moves_is_noticed_before_the_next(wire: Any) -> None:
    """Even where it had answered nothing before: sequence 0 again, but another boot number."""
    wire.endpoint.restart()
    with pytest.raises(StateUnknownError, match="restarted"):
        wire.driver.move(turned(10.0), 1.0)
    assert wire.journal.of("move") == []
    assert wire.driver.stop().fault_code == Fault.RESTARTED
    wire.driver.reset()
    assert wire.driver.move(turned(10.0), 1.0).done_sequence > 0


def test_a_first_move_that_a_restart_cut_short_is_not_sent_again(wire: Any) -> None:
    """The restarted controller says 0, as before the move: only its boot number tells that the move may have run."""
    answer = wire.server._station.answer

    def dying(packet: bytes) -> bytes:
        reply = answer(packet)
        if not wire.journal.of("move"):
            return bytes(reply)
        wire.server._station.answer = answer
        wire.clock.wait(0.2)
        wire.endpoint.brake_for_restart()
        wire.clock.wait(2.0)
        wire.endpoint.restart()
        wire.server._station.restart()
        return b""

    wire.server._station.answer = dying
    with pytest.raises(StateUnknownError, match="restarted"):
        wire.driver.move(turned(60.0), 0.3)
    assert len(wire.journal.of("move")) == 1
    state = wire.driver.stop()
    assert 0 < state.axes[0] < 600_000


def test_another_master_is_noticed_and_nothing_is_sent_again(wire: Any) -> None:
    """Its command moved the number on; a stop takes the control back."""
    wire.driver.move(turned(1.0), 1.0)
    wire.endpoint.command(wire.endpoint.owner, 500, Move(turned(2.0), 1.0))  # as a copy of this client would
    wire.clock.wait(0.4)
    moves = len(wire.journal.of("move"))
    with pytest.raises(StateUnknownError, match="another client"):
        wire.driver.move(turned(3.0), 1.0)
    with pytest.raises(StateUnknownError):
        wire.driver.reset()
    assert len(wire.journal.of("move")) == moves
    wire.driver.stop()
    wire.driver.reset()
    assert wire.driver.move(turned(3.0), 1.0).axes.tolist() == turned(3.0)[0].tolist()


def test_ctrl_c_while_the_answer_is_awaited_stops_the_arm(wire: Any) -> None:
    """The command may have been executed: the arm is stopped before the interrupt goes on."""
    send, done = wire.link.send, [False]

    def interrupted(sequence: int, command: Any) -> Any:
        answer = send(sequence, command)
        if isinstance(command, Move) and not done[0]:
            done[0] = True
            raise KeyboardInterrupt
        return answer

    wire.link.send = interrupted
    with pytest.raises(KeyboardInterrupt):
        wire.driver.move(turned(90.0), 0.5)
    state = wire.driver.state()
    assert state.at_rest
    assert state.axes[0] < 900_000
    assert state.fault_code == 0


def test_a_fault_during_a_move_comes_with_its_code(wire: Any) -> None:
    """Not as a lost line."""
    real_wait, pressed = wire.clock.wait, [False]

    def press(seconds: float) -> None:
        real_wait(seconds)
        if not pressed[0] and wire.journal.of("move"):
            pressed[0] = True
            wire.endpoint.emergency_stop()

    wire.clock.wait = press
    with pytest.raises(FaultError) as fault:
        wire.driver.move(turned(90.0), 0.5)
    assert fault.value.code == Fault.EMERGENCY_STOP


class Replies:
    """A port that answers each written frame as a test says."""

    name = "scripted"

    def __init__(self, station: Any) -> None:
        self.station, self.waiting = station, b""
        self.rewrite: Callable[[bytes], bytes] = lambda reply: reply

    def open(self) -> None: ...

    def close(self) -> None: ...

    def write(self, data: bytes) -> None:
        self.waiting = self.rewrite(self.station.answer(data))

    def read(self, seconds: float) -> bytes:
        data, self.waiting = self.waiting, b""
        if not data:
            self.clock.wait(seconds)
        return data

    clock: Any = None


@pytest.fixture
def scripted(bench: Callable[..., Any]) -> tuple[Any, Replies]:
    """A serial link whose answers a test rewrites."""
    from drivers.wire import Timeouts
    from drivers.wires.serial_link import SerialLink

    made = bench("serial")
    port = Replies(made.server._station)
    port.clock = made.clock
    link = SerialLink(port, made.clock, Timeouts(answer=0.05, watchdog=0.2), first_query=10)
    link.open()
    return link, port


def renumbered(reply: bytes, by: int) -> bytes:
    """The same answer under another number."""
    frame = decode_frame(reply)
    assert frame is not None
    return encode_frame(Frame(frame.start, (frame.number + by) % 65536, frame.body))


@pytest.mark.parametrize("name", ["late", "foreign", "echo", "torn", "lower case", "to the controller", "other kind"])
def test_what_is_not_the_current_answer_is_passed_over(scripted: tuple[Any, Replies], name: str) -> None:
    """Alone it is no answer; before the right one it does not matter."""
    link, port = scripted
    wrong: dict[str, Callable[[bytes], bytes]] = {
        "late": lambda reply: renumbered(reply, -1),
        "foreign": lambda reply: renumbered(reply, 777),
        "echo": lambda reply: b">00011,0010,STATE,1000*00000000\r\n",
        "torn": lambda reply: reply[: len(reply) // 2],
        "lower case": lambda reply: reply[:-10] + reply[-10:].lower() if reply[-10:].lower() != reply[-10:] else b"",
        "to the controller": lambda reply: b">" + reply[1:],
        "other kind": lambda reply: encode_frame(Frame("<", decode_frame(reply).number, "MOVE,0,")),  # type: ignore[union-attr] # it is one
    }
    rewrite = wrong[name]
    port.rewrite = rewrite
    with pytest.raises(LinkError):
        link.state()
    port.rewrite = lambda reply: rewrite(reply) + reply
    assert link.state().mode is Mode.IDLE


def test_rubbish_is_told_from_silence(scripted: tuple[Any, Replies]) -> None:
    """Bytes that make no frame hint at the baud rate."""
    link, port = scripted
    port.rewrite = lambda reply: bytes(byte ^ 0x55 for byte in reply)
    with pytest.raises(ProtocolError, match="baud rate"):
        link.state()
    port.rewrite = lambda reply: b""
    with pytest.raises(LinkError, match="no answer to STATE"):
        link.state()


class Rewritten:
    """A Modbus port whose registers a test rewrites."""

    name = "rewritten"

    def __init__(self, port: Any) -> None:
        self.port = port
        self.rewrite: Callable[[int, list[int]], list[int]] = lambda address, values: values

    def open(self) -> None:
        self.port.open()

    def close(self) -> None:
        self.port.close()

    def read(self, address: int, count: int) -> list[int]:
        return self.rewrite(address, self.port.read(address, count))

    def write(self, address: int, values: list[int]) -> None:
        self.port.write(address, values)


def swapped(address: int, values: list[int]) -> list[int]:
    """Every 32-bit value of a block with its words exchanged."""
    block = next(block for block in registers.BLOCKS if block.kind == "input" and block.address == address).for_axes(6)
    at, result = 0, list(values)
    if len(values) == registers.HEAD:
        return [*values[:2], values[3], values[2], *values[4:]]
    for field in (*block.fields, registers.Field("crc", "u32", "")):
        if field.type in ("i32", "u32", "f32"):
            for k in range(at, at + field.registers, 2):
                result[k], result[k + 1] = result[k + 1], result[k]
        at += field.registers
    return result


def one_bit(address: int, values: list[int]) -> list[int]:
    """A bit of the axes."""
    return values if len(values) == registers.HEAD else [*values[:30], values[30] ^ 4, *values[31:]]


@pytest.mark.parametrize(
    ("rewrite", "words"),
    [
        (swapped, "word-order test reads .*; a gateway swaps words"),
        (lambda address, values: [0x4B53, *values[1:]], "register 0 reads"),
        (lambda address, values: [0] * len(values), "register 0 reads 0"),
        (lambda address, values: [values[0], 1, *values[2:]], "map version 1 and this driver 2"),
        (lambda address, values: [*values[1:], 0], "register 0 reads"),
        (one_bit, "CRC-32"),
    ],
    ids=["words swapped", "another device", "zeros", "the first map", "shifted by one", "one bit"],
)
def test_a_foreign_or_broken_map_is_refused(
    bench: Callable[..., Any], rewrite: Callable[[int, list[int]], list[int]], words: str
) -> None:
    """At connecting, with what is wrong; and just so while connected."""
    from drivers.wire import Timeouts
    from drivers.wires.modbus_link import ModbusLink

    made = bench("modbus")
    port = Rewritten(made.port)
    link = ModbusLink(port, made.clock, Timeouts(answer=0.05, watchdog=0.2))
    port.rewrite = rewrite
    with pytest.raises(ProtocolError, match=words):
        link.open()
    port.rewrite = lambda address, values: values
    link.open()
    port.rewrite = rewrite
    with pytest.raises(ProtocolError, match=words):
        link.state()


def test_words_swapped_on_the_way_to_the_controller_execute_nothing(bench: Callable[..., Any]) -> None:
    """The block's own CRC does not fit: an exception telegram."""
    made = bench("modbus")
    made.driver.connect()
    write = made.port.write

    def swap(address: int, values: list[int]) -> None:
        write(address, [*values[:13], *(v for k in range(13, len(values), 2) for v in (values[k + 1], values[k]))])

    made.port.write = swap
    with pytest.raises(ProtocolError, match="exception 3"):
        made.link.send(1, Move(turned(1.0), 1.0))
    made.port.write = write
    assert made.driver.state().ack_sequence == 0


def test_a_status_from_before_the_write_is_not_the_current_one(bench: Callable[..., Any]) -> None:
    """It echoes an older heartbeat: read again, and given up where it stays so."""
    from drivers.wire import Timeouts
    from drivers.wires.modbus_link import ModbusLink

    made = bench("modbus-rtu")
    port = Rewritten(made.port)
    link = ModbusLink(port, made.clock, Timeouts(answer=0.05, watchdog=0.2))
    link.open()
    link.state()
    link.session = 7
    old = made.port.read(0, registers.STATUS.for_axes(6).registers)
    reads = [0]

    def once(address: int, values: list[int]) -> list[int]:
        reads[0] += 1
        return old if reads[0] == 1 else values

    port.rewrite = once
    assert link.state().mode is Mode.IDLE
    assert reads[0] == 2
    port.rewrite = lambda address, values: old
    with pytest.raises(ProtocolError, match="late, or another client"):
        link.state()


def test_registers_written_apart_from_their_block_do_nothing(bench: Callable[..., Any]) -> None:
    """A sequence without its command, a block elsewhere, a block with a wrong count: exceptions 2 and 3."""
    made = bench("modbus")
    made.driver.connect()
    command = registers.COMMAND.for_axes(6)
    block = command.encode({field.name: 0 for field in command.fields} | {"command": 1})
    for address, values in ((1, [5]), (0, [1, 2, 1]), (1, block), (0, block[:-1]), (0, [*block, 0])):
        with pytest.raises(ProtocolError, match=r"exception [23]"):
            made.port.write(address, values)
    end = registers.CAPABILITIES.address + registers.CAPABILITIES.for_axes(6).registers
    for address, count in ((50, 1), (30, 20), (99, 3), (end, 1)):
        with pytest.raises(ProtocolError, match="exception 2"):
            made.port.read(address, count)
    assert made.port.read(18, 12) == made.port.read(0, registers.STATUS.for_axes(6).registers)[18:30]
    assert made.driver.state().ack_sequence == 0
