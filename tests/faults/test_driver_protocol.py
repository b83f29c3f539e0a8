"""Rules of the protocols on a wire in memory: watchdog, owner, sequence numbers, staging, restarts, refusals."""

import dataclasses
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers import status
from drivers.contract import LAST_SEQUENCE, Answer, Fault, Mode, Move, Reset, Result, Stop
from drivers.errors import (
    ArrivalError,
    LinkError,
    LinkLostError,
    NotOwnerError,
    ProtocolError,
    RefusedError,
    StateUnknownError,
    StoppedError,
)
from drivers.limits import Limits
from drivers.profile import resting
from drivers.setpoints import to_rad
from drivers.wire import MAX_POINTS, Timeouts
from drivers.wires import modbus_protocol as registers
from drivers.wires.modbus_link import ModbusLink
from drivers.wires.serial_link import SerialLink
from drivers.wires.serial_protocol import Frame, decode_frame, encode_frame
from tests.support.driver_bench import HOME, KR16, WIRES, Bench, make_bench, on_one_wire, turned


def begin(wire: Bench, degrees: float, speed: float = 0.2) -> None:
    """Start a move without waiting for its end."""
    sequence = wire.driver.state().ack_sequence + 1
    assert wire.link.send(sequence, Move(turned(degrees), speed)).result == Result.OK


def during(wire: Bench, act: Callable[[], None], after: float = 0.3) -> None:
    """Act once, `after` seconds after the beginning of the next move."""
    wait, began = wire.clock.wait, [None, False]

    def waiting(seconds: float) -> None:
        wait(seconds)
        if wire.journal.of("move") and began[0] is None:
            began[0] = wire.clock.now()
        if began[0] is not None and not began[1] and wire.clock.now() - began[0] >= after:
            began[1] = True
            act()

    wire.clock.wait = waiting


# Watchdog and heartbeat


def test_a_silent_client_stops_a_moving_arm_on_its_path(wire: Bench) -> None:
    """After the watchdog's time the arm brakes and latches a fault that only a reset clears."""
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


def test_a_silent_client_of_an_arm_at_rest_is_no_fault(wire: Bench) -> None:
    """Ten minutes of scanning between two moves are allowed."""
    wire.driver.move(turned(5.0), 1.0)
    for _ in range(600):
        wire.clock._now += 1.0
        wire.server.step()
    assert wire.driver.state().fault_code == 0
    assert wire.driver.move(turned(0.0), 1.0).mode is Mode.IN_POSITION


def test_a_repeated_message_is_no_heartbeat(wire: Bench) -> None:
    """A fieldbus gateway that repeats its last message does not feed the watchdog."""
    begin(wire, 90.0)
    sent: list[bytes] = []
    receive = wire.line.receive
    wire.line.receive = lambda seconds: [sent.append(data) or (peer, data) for peer, data in receive(seconds)]
    wire.driver.state()
    wire.line.receive = receive
    for _ in range(80):
        wire.line.to_server.append((wire.line.connection, sent[0]))
        wire.clock.wait(0.01)
    assert wire.endpoint.controller.state().fault_code == Fault.WATCHDOG


def test_another_session_does_not_feed_the_watchdog(wire: Bench) -> None:
    """A monitor reads 50 times a second while the owner is silent: the arm stops nevertheless."""
    begin(wire, 90.0)
    wire.link.session = 0
    for _ in range(40):
        wire.link.state()
        wire.clock.wait(0.02)
    assert wire.endpoint.controller.state().fault_code == Fault.WATCHDOG


@pytest.mark.parametrize(("watchdog", "backend"), on_one_wire([0.1, 5.0, 0.099, 5.001, 0.0, 65.535]))
def test_the_client_sets_its_watchdog(watchdog: float, backend: str) -> None:
    """The controller accepts 100 ms to 5 s; with other values no client owns the arm."""
    bench = make_bench(backend)
    bench.link._timeouts = Timeouts(answer=0.05, watchdog=watchdog)
    bench.driver.connect()
    if not 0.1 <= watchdog <= 5.0:
        with pytest.raises(RefusedError, match="outside 100 to 5000 ms") as refused:
            bench.driver.move(turned(1.0), 1.0)
        assert refused.value.result == Result.WATCHDOG
        assert bench.driver.state().owner == 0
        return
    bench.driver.take()
    begin(bench, 180.0, 0.05)
    bench.driver.state()
    bench.clock.wait(watchdog - 0.05)
    assert bench.endpoint.controller.state().fault_code == 0
    bench.clock.wait(0.2)
    assert bench.endpoint.controller.state().fault_code == Fault.WATCHDOG


def test_a_frozen_heartbeat_is_a_lost_line(wire: Bench) -> None:
    """A gateway answers for a dead controller: a read and a wait end, and a stop restores the client."""
    report, wait = wire.endpoint.report, wire.clock.wait
    begin(wire, 170.0, 0.02)
    frozen = report().heartbeat
    wire.endpoint.report = lambda: replace(report(), heartbeat=frozen)
    while not wire.driver.state().at_rest and wire.clock.now() < 0.4:
        wire.clock.wait(0.02)
    wire.clock.wait(0.3)
    with pytest.raises(LinkLostError, match="has not changed"):
        wire.driver.state()
    wire.endpoint.report = report
    assert wire.driver.stop().at_rest
    wire.driver.reset()

    def freeze(seconds: float) -> None:
        wire.endpoint.report = lambda: replace(report(), heartbeat=7)
        wait(seconds)

    wire.clock.wait = freeze
    with pytest.raises(StateUnknownError, match="has not changed"):
        wire.driver.move(turned(170.0), 0.02)
    wire.clock.wait, wire.endpoint.report = wait, report
    with pytest.raises(StateUnknownError, match="stop"):
        wire.driver.move(turned(0.0), 1.0)
    assert wire.driver.stop().at_rest
    assert wire.driver.reset().fault_code == 0


# Owner


def test_another_session_moves_nothing(wire: Bench) -> None:
    """Moves, resets and stages of another session are refused and use no number."""
    wire.driver.move(turned(1.0), 1.0)
    mine, wire.link.session = wire.link.session, 9
    before = wire.endpoint.report()
    for command in (Move(turned(5.0), 1.0), Move(np.tile(HOME, (40, 1)), 1.0), Reset()):
        assert wire.link.send(before.ack_sequence + 1, command).result == Result.NOT_OWNER
    wire.link.session = mine
    after = wire.endpoint.report()
    assert (after.ack_sequence, after.owner) == (before.ack_sequence, mine)
    assert len(wire.journal.of("move")) == 1
    assert wire.driver.move(turned(2.0), 1.0).mode is Mode.IN_POSITION


def test_a_stop_by_another_client_ends_the_session(wire: Bench) -> None:
    """The owner's move ends with the reason."""
    during(wire, lambda: wire.endpoint.command(0, 77, Stop()) and None)
    with pytest.raises(StoppedError, match="another client"):
        wire.driver.move(turned(90.0), 0.5)
    state = wire.driver.state()
    assert (state.done_result, state.owner) == (Result.STOPPED_BY_OTHER, 0)
    assert 0 < state.axes[0] < 900_000
    for expected in (1, 2):
        with pytest.raises(StateUnknownError, match="another client has stopped the arm"):
            wire.driver.move(turned(0.0), 1.0)
        assert len(wire.journal.of("move")) == expected
        wire.driver.stop()
        assert wire.driver.move(turned(0.0), 1.0).mode is Mode.IN_POSITION
        wire.endpoint.command(0, 1, Stop())


def test_a_silent_owner_is_replaced_and_an_active_one_is_not(wire: Bench) -> None:
    """The owner is replaced only at rest and after the watchdog's time. The former owner then sends no move."""
    wire.driver.move(turned(1.0), 1.0)
    assert wire.endpoint.take(9, 1000).result == Result.NOT_OWNER
    wire.clock.wait(0.6)
    assert wire.endpoint.take(9, 1000).result == Result.OK
    with pytest.raises(StateUnknownError, match="session 9 owns the arm now"):
        wire.driver.move(turned(2.0), 1.0)
    wire.driver.close()
    assert wire.endpoint.owner == 9
    assert wire.journal.of("stop") == []


@pytest.mark.parametrize(("name", "backend"), on_one_wire(["owner"]))
def test_an_active_owner_is_waited_for_and_named(name: str, backend: str) -> None:
    """The wait is notified once and lasts for the longest watchdog."""
    bench, notes = make_bench(backend), []
    bench.endpoint.take(4711, 5000)
    bench.driver._notify = notes.append
    bench.driver.connect()
    step = bench.clock.step

    def active_step() -> None:
        bench.endpoint.note_activity(4711)
        step()

    bench.clock.step = active_step
    began = bench.clock.now()
    with pytest.raises(NotOwnerError, match="session 4711 owns the arm"):
        bench.driver.move(turned(1.0), 1.0)
    assert 5.0 < bench.clock.now() - began < 6.5
    assert len(notes) == 1
    assert "4711" in notes[0]
    bench.clock.step = step
    bench.clock.wait(5.1)
    assert bench.driver.move(turned(1.0), 1.0).mode is Mode.IN_POSITION


def test_monitoring_disturbs_nobody(wire: Bench) -> None:
    """Reads of session 0 during the owner's move do not affect it."""
    states = []

    def read() -> None:
        mine, wire.link.session = wire.link.session, 0
        states.append(wire.link.state())
        wire.link.session = mine

    during(wire, read)
    assert wire.driver.move(turned(20.0), 0.5).mode is Mode.IN_POSITION
    assert states[0].mode is Mode.MOVING
    assert 0 < states[0].path < 10_000
    assert states[0].owner == wire.link.session


def test_the_arm_is_given_back(wire: Bench) -> None:
    """After close() the next client need not wait."""
    wire.driver.move(turned(1.0), 1.0)
    wire.driver.close()
    assert wire.endpoint.owner == 0
    wire.driver.connect()
    before = wire.clock.now()
    wire.driver.take()
    assert wire.clock.now() - before < 0.1


# Status, axes and versions


def test_every_wire_reports_the_same_status() -> None:
    """All fields of the status of a moving arm agree on every wire."""
    reported = []
    for backend in WIRES:
        bench = make_bench(backend)
        bench.driver._ledger.session = 4711
        bench.driver.connect()
        bench.driver.take()
        begin(bench, 20.0, 0.5)
        bench.clock.wait(0.2)
        state = bench.driver.state()
        reported.append({**dataclasses.asdict(state), "axes": 0, "heartbeat": 0})
    assert reported[0] == reported[1] == reported[2]
    assert 0 < reported[0]["path"] < 10_000
    assert reported[0]["flags"] == 2


def test_an_arm_with_seven_axes(backend: str) -> None:
    """A client with seven axes drives it, a client with six is refused at connecting."""
    seventh = {"lower": -(10**6), "upper": 10**6, "velocity": 1.0, "acceleration": 2.0, "max_step": 2 * 10**6}
    bench = make_bench(backend, limits=Limits(**{k: np.append(getattr(KR16, k), v) for k, v in seventh.items()}))
    limits, bench.driver._limits = bench.driver._limits, KR16
    with pytest.raises(ProtocolError, match="has 7 axes; this client drives 6"):
        bench.driver.connect()
    bench.driver._limits = limits
    bench.driver.connect()
    points = np.tile(np.append(HOME, 50_000), (30, 1)).astype(np.int32)
    points[:, 6] += np.arange(30, dtype=np.int32) * 100
    assert bench.driver.move(points, 1.0).axes.tolist() == points[-1].tolist()
    (move,) = bench.journal.of("move")
    assert move["set_points"] == points.tolist()
    bench.driver.close()


def test_a_client_of_version_1_is_refused() -> None:
    """The HELLO of version 1 gets an ERROR with both versions, and its commands are refused."""
    bench = make_bench("serial")
    frame = decode_frame(bench.server._station.answer(encode_frame(Frame(">", 7, "HELLO,1"))))
    assert frame is not None
    assert re.search(r"ERROR,.*version 2 .*not 1", frame.body)
    for old in ("STATE,1000", "STOP", "RESET", "MOVE,1000,1,00000000,1,0,0,0,0,0,0"):
        frame = decode_frame(bench.server._station.answer(encode_frame(Frame(">", 7, old))))
        assert frame is not None
        assert frame.kind == ("STATE" if old == "STATE,1000" else "ERROR")
    assert bench.journal.of("move") == []


@pytest.mark.parametrize("backend", WIRES[:2])
def test_a_controller_of_version_1_is_refused(backend: str) -> None:
    """The client names both versions."""
    bench: Any = make_bench(backend)
    station = bench.server._station
    if backend == "serial":
        old = "HELLO,1,10000,200000," + ",".join(["0"] * 18) + ",old controller"
        station.answer = lambda packet: encode_frame(Frame("<", decode_frame(packet).number, old))  # type: ignore[union-attr] # it is one
    else:
        capabilities = station._capabilities
        station._capabilities = lambda: {**capabilities(), "version": 1}
    with pytest.raises(ProtocolError, match=r"version 1 .*this driver 2"):
        bench.driver.connect()


# Numbers, staging and refusals


def test_the_sequence_wraps_over_the_wire(wire: Bench) -> None:
    """65535 is followed by 1, at both ends."""
    wire.endpoint.command(wire.endpoint.owner, LAST_SEQUENCE - 1, Stop())
    wire.driver.close()
    wire.driver.connect()
    numbers = [wire.driver.move(turned(degrees), 1.0).done_sequence for degrees in (1.0, 2.0, 3.0)]
    assert numbers == [LAST_SEQUENCE, 1, 2]


def test_a_command_is_executed_once_and_a_repetition_gets_the_old_answer(wire: Bench) -> None:
    """Another command under a used number is refused."""
    move = Move(turned(3.0), 1.0)
    assert {wire.link.send(1, move).result for _ in range(5)} == {Result.OK}
    assert len(wire.journal.of("move")) == 1
    assert wire.link.send(1, Move(turned(4.0), 1.0)).result == Result.REUSED
    assert wire.link.send(1, Reset()).result == Result.REUSED
    assert wire.link.send(2, Stop()).result == Result.OK
    assert wire.link.send(1, move).result == Result.STALE
    assert len(wire.journal.of("move")) == 1


@pytest.mark.parametrize(
    ("n", "backend"), [*((600, backend) for backend in WIRES), pytest.param(100_000, "serial", marks=pytest.mark.slow)]
)
def test_many_via_points_are_one_move(n: int, backend: str) -> None:
    """All points arrive in frames of 12 or blocks of 9, and the journal has one move."""
    bench = make_bench(backend, time_scale=1e6)
    bench.driver.connect()
    points = np.random.default_rng(0).integers(KR16.lower, KR16.upper, (n, 6), dtype=np.int32)
    assert bench.driver.move(points, 1.0).axes.tolist() == points[-1].tolist()
    (move,) = bench.journal.of("move")
    assert move["set_points"] == points.tolist()


def test_missing_stages_are_sent_again(wire: Bench) -> None:
    """The commit is refused without using the number, and the client sends all points once more."""
    wire.link.state()
    write, has_lost = wire.endpoint._staging.write, [False]

    def losing_write(sequence: int, piece: Any) -> bool:
        if piece.offset and not has_lost[0]:
            has_lost[0] = True
            return True
        return bool(write(sequence, piece))

    wire.endpoint._staging.write = losing_write
    points = np.tile(HOME, (60, 1))
    points[:, 5] = np.arange(60) * 100
    assert wire.driver.move(points, 1.0).axes.tolist() == points[-1].tolist()
    assert has_lost[0]
    (move,) = wire.journal.of("move")
    assert move["set_points"] == points.tolist()
    assert move["sequence"] == 1


def slow_transfer(wire: Bench) -> None:
    """Let each message to the controller take 0.08 s."""
    write = wire.port.write

    def slow_write(*message: Any) -> None:
        wire.clock.wait(0.08)
        write(*message)

    wire.port.write = slow_write


def test_a_long_transfer_is_no_missing_progress(wire: Bench) -> None:
    """The transfer of the via points takes longer than an arm may stand still; the move is executed."""
    slow_transfer(wire)
    points = np.tile(HOME, (800, 1))
    points[:, 5] = np.arange(800) * 100
    began = wire.clock.now()
    assert wire.driver.move(points, 1.0).axes.tolist() == points[-1].tolist()
    assert wire.clock.now() - began > status.STALL_LIMIT


def test_the_transfer_is_no_time_of_motion(wire: Bench) -> None:
    """An arm that arrives at once is recognised, although the transfer took longer than the motion would."""
    slow_transfer(wire)
    start = wire.endpoint.controller._start

    def jump(sequence: int, move: Move) -> None:
        start(sequence, move)
        wire.endpoint.controller._reference = resting(to_rad(move.set_points[-1]))
        wire.endpoint.controller.plant.follow(wire.endpoint.controller._reference)

    wire.endpoint.controller._start = jump
    points = np.tile(HOME, (100, 1))
    points[-1, 5] += 200_000
    with pytest.raises(ArrivalError, match="needs at least"):
        wire.driver.move(points, 1.0)


def test_a_move_that_arrives_late_is_not_refused(wire: Bench) -> None:
    """The commit of a staged move arrives after the client has asked for its result: the move runs once, to its end."""
    wire.link.state()
    commit, stage, late = wire.endpoint.commit, wire.endpoint.stage, list[Any]()

    def lost_commit(*request: Any) -> Answer:
        wire.endpoint.commit = commit
        late.append(request)
        return Answer(request[1], Result.INCOMPLETE)

    def stage_after(*request: Any) -> Answer:
        if late:
            commit(*late.pop())
        return stage(*request)

    wire.endpoint.commit, wire.endpoint.stage = lost_commit, stage_after
    points = np.tile(HOME, (60, 1))
    points[:, 0] = np.arange(60) * 1000
    assert wire.driver.move(points, 1.0).axes.tolist() == points[-1].tolist()
    assert len(wire.journal.of("move")) == 1


def test_the_controller_refuses_moves_that_bypass_the_client(wire: Bench) -> None:
    """Moves that bypass the client's check are refused: the arm does not move, and the number is used."""
    for sequence, (points, speed, result) in enumerate(
        (
            (turned(185.0001), 0.5, Result.LIMIT),
            (np.full((1, 6), 2**31 - 1, dtype=np.int32), 0.5, Result.LIMIT),
            (np.full((1, 6), -(2**31), dtype=np.int32), 0.5, Result.LIMIT),
            (turned(1.0), 1.5, Result.SPEED),
            (turned(1.0), 0.0, Result.SPEED),
            (turned(1.0), float("nan"), Result.SPEED),
            (turned(1.0), 1e-9, Result.SPEED),  # below the resolution of the wire
        ),
        start=1,
    ):
        assert wire.link.send(sequence, Move(points, speed)).result == result
        state = wire.driver.state()
        assert (state.ack_sequence, state.ack_result, state.done_sequence) == (sequence, result, 0)
    assert wire.journal.of("move") == []
    wire.driver.stop()
    with pytest.raises(RefusedError, match="at most 200000") as refused:
        wire.driver.move(np.tile(HOME, (MAX_POINTS + 1, 1)), 1.0)
    assert refused.value.result == Result.TOO_MANY_POINTS


def test_a_step_too_large_is_refused_at_both_ends(wire: Bench) -> None:
    """The controller refuses a step that is too large, and so does the client with the reported limit."""
    wire.endpoint.controller.limits = replace(wire.endpoint.limits, max_step=np.full(6, 50_000, np.int32))
    assert wire.link.send(1, Move(turned(5.0001), 1.0)).result == Result.STEP
    wire.endpoint.limits = wire.endpoint.controller.limits
    wire.driver.close()
    wire.driver.connect()
    with pytest.raises(RefusedError) as refused:
        wire.driver.move(turned(5.0001), 1.0)
    assert refused.value.result == Result.STEP
    assert wire.driver.state().ack_sequence == 1


# Restarts, other clients, interrupts


def test_a_restart_between_moves_is_detected(wire: Bench) -> None:
    """A restart is detected by the boot number, also if the sequence was 0 before."""
    wire.endpoint.restart()
    with pytest.raises(StateUnknownError, match="restarted"):
        wire.driver.move(turned(10.0), 1.0)
    assert wire.journal.of("move") == []
    assert wire.driver.stop().fault_code == Fault.RESTARTED
    wire.driver.reset()
    assert wire.driver.move(turned(10.0), 1.0).done_sequence > 0


def test_a_first_move_cut_by_a_restart_is_not_sent_again(wire: Bench) -> None:
    """Only the boot number shows that the move may have run."""
    station: Any = wire.server._station
    answer = station.answer

    def dying_answer(packet: bytes) -> bytes:
        reply = answer(packet)
        if not wire.journal.of("move"):
            return bytes(reply)
        station.answer = answer
        wire.clock.wait(0.2)
        wire.endpoint.brake_for_restart()
        wire.clock.wait(2.0)
        wire.endpoint.restart()
        station.restart()
        return b""

    station.answer = dying_answer
    with pytest.raises(StateUnknownError, match="restarted"):
        wire.driver.move(turned(60.0), 0.3)
    assert len(wire.journal.of("move")) == 1
    assert 0 < wire.driver.stop().axes[0] < 600_000


def test_a_copy_of_this_client_is_detected(wire: Bench) -> None:
    """A command of a copy changes the last number, and the client sends no move before a stop."""
    wire.driver.move(turned(1.0), 1.0)
    wire.endpoint.command(wire.endpoint.owner, 500, Move(turned(2.0), 1.0))
    wire.clock.wait(0.4)
    for act in (lambda: wire.driver.move(turned(3.0), 1.0), wire.driver.reset):
        with pytest.raises(StateUnknownError):
            act()
    assert len(wire.journal.of("move")) == 2
    wire.driver.stop()
    wire.driver.reset()
    assert wire.driver.move(turned(3.0), 1.0).axes.tolist() == turned(3.0)[0].tolist()


def test_ctrl_c_before_the_answer_stops_the_arm(wire: Bench) -> None:
    """The command may have been executed, so the client stops before the interrupt is raised."""
    send, is_raised = wire.link.send, [False]

    def interrupted(sequence: int, command: Any) -> Any:
        answer = send(sequence, command)
        if isinstance(command, Move) and not is_raised[0]:
            is_raised[0] = True
            raise KeyboardInterrupt
        return answer

    wire.link.send = interrupted
    with pytest.raises(KeyboardInterrupt):
        wire.driver.move(turned(90.0), 0.5)
    state = wire.driver.state()
    assert state.at_rest
    assert state.axes[0] < 900_000
    assert state.fault_code == 0


# Serial line


class ScriptedPort:
    """A serial port that answers each frame through a function of the test."""

    name = "scripted"

    def __init__(self, bench: Bench) -> None:
        self.bench, self.waiting = bench, b""
        self.rewrite: Callable[[bytes], bytes] = lambda reply: reply

    def open(self) -> None: ...

    def close(self) -> None: ...

    def write(self, data: bytes) -> None:
        self.waiting = self.rewrite(self.bench.server._station.answer(data))

    def read(self, seconds: float) -> bytes:
        data, self.waiting = self.waiting, b""
        if not data:
            self.bench.clock.wait(seconds)
        return data


@pytest.fixture
def scripted() -> tuple[SerialLink, ScriptedPort]:
    """An open serial link with a scripted port."""
    bench = make_bench("serial")
    port = ScriptedPort(bench)
    link = SerialLink(port, bench.clock, Timeouts(answer=0.05, watchdog=0.2), first_query=10)
    link.open()
    return link, port


def edited(reply: bytes, number: int = 0, body: str = "") -> bytes:
    """Return the answer with its number shifted, or with another body."""
    frame = decode_frame(reply)
    assert frame is not None
    return encode_frame(Frame(frame.start, (frame.number + number) % 65536, body or frame.body))


OTHER_FRAMES: dict[str, Callable[[bytes], bytes]] = {
    "late": lambda reply: edited(reply, number=-1),
    "of another client": lambda reply: edited(reply, number=777),
    "echo": lambda reply: b">00011,0010,STATE,1000*00000000\r\n",
    "torn": lambda reply: reply[: len(reply) // 2],
    "lower case": lambda reply: reply[:-10] + reply[-10:].lower() if reply[-10:].lower() != reply[-10:] else b"",
    "to the controller": lambda reply: b">" + reply[1:],
    "other kind": lambda reply: edited(reply, body="MOVE,0,"),
}


@pytest.mark.parametrize("name", OTHER_FRAMES)
def test_other_frames_are_ignored(scripted: tuple[SerialLink, ScriptedPort], name: str) -> None:
    """Such a frame alone is no answer, and does not matter before the right one."""
    link, port = scripted
    rewrite = OTHER_FRAMES[name]
    port.rewrite = rewrite
    with pytest.raises(LinkError):
        link.state()
    port.rewrite = lambda reply: rewrite(reply) + reply
    assert link.state().mode is Mode.IDLE


def test_noise_and_silence_have_different_messages(scripted: tuple[SerialLink, ScriptedPort]) -> None:
    """Bytes without a frame hint at the baud rate."""
    link, port = scripted
    port.rewrite = lambda reply: bytes(byte ^ 0x55 for byte in reply)
    with pytest.raises(ProtocolError, match="baud rate"):
        link.state()
    port.rewrite = lambda reply: b""
    with pytest.raises(LinkError, match="no answer to STATE"):
        link.state()


# Modbus


class RewrittenPort:
    """A Modbus port whose read registers pass through a function of the test."""

    name = "rewritten"

    def __init__(self, port: Any) -> None:
        self.open, self.close, self.write, self._read = port.open, port.close, port.write, port.read
        self.rewrite: Callable[[int, list[int]], list[int]] = lambda address, values: values

    def read(self, address: int, count: int) -> list[int]:
        return self.rewrite(address, self._read(address, count))


def rewritten(backend: str) -> tuple[ModbusLink, RewrittenPort]:
    """Return a Modbus link with a port that can be rewritten."""
    bench = make_bench(backend)
    port = RewrittenPort(bench.port)
    return ModbusLink(port, bench.clock, Timeouts(answer=0.05, watchdog=0.2)), port


def swapped(address: int, values: list[int]) -> list[int]:
    """Swap the words of every 32-bit value of a block."""
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


def with_one_bit_flipped(address: int, values: list[int]) -> list[int]:
    """Flip a bit of the axes."""
    return values if len(values) == registers.HEAD else [*values[:30], values[30] ^ 4, *values[31:]]


@pytest.mark.parametrize(
    ("rewrite", "cause"),
    [
        (swapped, "word-order test reads .*; a gateway swaps words"),
        (lambda address, values: [0x4B53, *values[1:]], "register 0 reads"),
        (lambda address, values: [0] * len(values), "register 0 reads 0"),
        (lambda address, values: [values[0], 1, *values[2:]], "map version 1 and this driver 2"),
        (lambda address, values: [*values[1:], 0], "register 0 reads"),
        (with_one_bit_flipped, "CRC-32"),
    ],
    ids=["words swapped", "another device", "zeros", "version 1", "shifted by one", "one bit"],
)
def test_a_wrong_map_is_refused(rewrite: Callable[[int, list[int]], list[int]], cause: str) -> None:
    """A wrong map of registers is refused at connecting and later, with the cause."""
    link, port = rewritten("modbus")
    port.rewrite = rewrite
    with pytest.raises(ProtocolError, match=cause):
        link.open()
    port.rewrite = lambda address, values: values
    link.open()
    port.rewrite = rewrite
    with pytest.raises(ProtocolError, match=cause):
        link.state()


def test_words_swapped_on_the_way_to_the_controller_execute_nothing() -> None:
    """The CRC of the block is wrong, and the controller answers with an exception telegram."""
    bench = make_bench("modbus")
    bench.driver.connect()
    write = bench.port.write

    def swap(address: int, values: list[int]) -> None:
        write(address, [*values[:13], *(v for k in range(13, len(values), 2) for v in (values[k + 1], values[k]))])

    bench.port.write = swap
    with pytest.raises(ProtocolError, match="exception 3"):
        bench.link.send(1, Move(turned(1.0), 1.0))
    bench.port.write = write
    assert bench.driver.state().ack_sequence == 0


def test_a_status_from_before_the_write_is_read_again() -> None:
    """A status with an older heartbeat is read again, and the client gives up if it stays old."""
    link, port = rewritten("modbus-rtu")
    link.open()
    link.state()
    link.session = 7
    old = port.read(0, registers.STATUS.for_axes(6).registers)
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


def test_registers_outside_a_complete_block_do_nothing() -> None:
    """A sequence without its command, a block at another address, a wrong count: exceptions 2 and 3."""
    bench = make_bench("modbus")
    bench.driver.connect()
    command = registers.COMMAND.for_axes(6)
    block = command.encode({field.name: 0 for field in command.fields} | {"command": 1})
    for address, values in ((1, [5]), (0, [1, 2, 1]), (1, block), (0, block[:-1]), (0, [*block, 0])):
        with pytest.raises(ProtocolError, match=r"exception [23]"):
            bench.port.write(address, values)
    end = registers.CAPABILITIES.address + registers.CAPABILITIES.for_axes(6).registers
    for address, count in ((50, 1), (30, 20), (99, 3), (end, 1)):
        with pytest.raises(ProtocolError, match="exception 2"):
            bench.port.read(address, count)
    assert bench.port.read(18, 12) == bench.port.read(0, registers.STATUS.for_axes(6).registers)[18:30]
    assert bench.driver.state().ack_sequence == 0
