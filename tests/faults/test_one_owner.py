"""One owner: the arm is taken and given, a stop is everybody's, looking disturbs nobody; versions, axes."""

import dataclasses
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from cell.robot import model as robot
from drivers.client import ControllerClient
from drivers.contract import Fault, Mode, Move, Reset, Result, Stop
from drivers.controller import IdealPlant
from drivers.errors import NotOwnerError, ProtocolError, StateUnknownError, StoppedError
from drivers.limits import Limits
from drivers.setpoints import SetPoints, from_rad
from drivers.wires import modbus_protocol as registers
from drivers.wires.serial_protocol import Frame, decode_frame, encode_frame

KR16 = Limits.from_rad(robot.limits(robot.load()))

HOME = from_rad(np.radians([0.0, -90.0, 90.0, 0.0, 90.0, 0.0]))


def turned(degrees: float) -> SetPoints:
    """(1, 6) home with A1 turned."""
    points = HOME[None].copy()
    points[0, 0] = round(degrees * 1e4)
    return points


def during(wire: Any, act: Callable[[], None], after: float = 0.3) -> None:
    """Do something once, so long after the next move began."""
    wait, began = wire.clock.wait, [None, False]

    def waiting(seconds: float) -> None:
        wait(seconds)
        if wire.journal.of("move") and began[0] is None:
            began[0] = wire.clock.now()
        if began[0] is not None and not began[1] and wire.clock.now() - began[0] >= after:
            began[1] = True
            act()

    wire.clock.wait = waiting


def test_another_session_moves_nothing(wire: Any) -> None:
    """Moves, resets and pieces of moves of a stranger are refused, use no number and move nothing."""
    wire.driver.move(turned(1.0), 1.0)
    mine, wire.link.session = wire.link.session, 9
    before = wire.endpoint.report()
    points = np.tile(HOME, (40, 1))
    for command in (Move(turned(5.0), 1.0), Move(points, 1.0), Reset()):
        assert wire.link.send(before.ack_sequence + 1, command).result == Result.NOT_OWNER
    wire.link.session = mine
    after = wire.endpoint.report()
    assert (after.ack_sequence, after.owner) == (before.ack_sequence, mine)
    assert len(wire.journal.of("move")) == 1
    assert wire.driver.move(turned(2.0), 1.0).mode is Mode.IN_POSITION


def test_a_stop_of_anybody_is_obeyed_and_told_to_the_owner(wire: Any) -> None:
    """The owner's move ends as stopped by another client, its session is over, and it sends nothing before a stop."""
    during(wire, lambda: wire.endpoint.command(0, 77, Stop()))
    with pytest.raises(StoppedError, match="another client"):
        wire.driver.move(turned(90.0), 0.5)
    state = wire.driver.state()
    assert (state.done_result, state.owner) == (Result.STOPPED_BY_OTHER, 0)
    assert 0 < state.axes[0] < 900_000
    with pytest.raises(StateUnknownError, match="another client has stopped the arm"):
        wire.driver.move(turned(0.0), 1.0)
    assert len(wire.journal.of("move")) == 1
    wire.driver.stop()
    assert wire.driver.move(turned(0.0), 1.0).mode is Mode.IN_POSITION


def test_a_stop_between_two_moves_ends_the_session_too(wire: Any) -> None:
    """Whoever pressed stop while the scan ran had a reason: the next move is not sent."""
    wire.driver.move(turned(1.0), 1.0)
    wire.endpoint.command(0, 1, Stop())
    with pytest.raises(StateUnknownError, match="another client has stopped the arm"):
        wire.driver.move(turned(2.0), 1.0)
    assert len(wire.journal.of("move")) == 1


def test_a_silent_owner_is_taken_over_from_and_one_that_is_there_is_not(wire: Any) -> None:
    """Only while the arm stands and after the watchdog's time; who was robbed sends nothing more."""
    wire.driver.move(turned(1.0), 1.0)
    assert wire.endpoint.take(9, 1000).result == Result.NOT_OWNER
    wire.clock.wait(0.6)
    assert wire.endpoint.take(9, 1000).result == Result.OK
    with pytest.raises(StateUnknownError, match="session 9 owns the arm now"):
        wire.driver.move(turned(2.0), 1.0)
    wire.driver.close()
    assert wire.endpoint.owner == 9
    assert [entry["event"] for entry in wire.journal.entries].count("stop") == 0


def test_an_owner_that_is_there_is_waited_for_and_named(bench: Callable[..., Any], backend: str) -> None:
    """After the longest watchdog: its session is told; before it, what is waited for."""
    made, said = bench(backend), []
    made.endpoint.take(4711, 5000)
    made.driver._notify = said.append
    made.driver.connect()
    turn = made.clock.step

    def lively() -> None:
        made.endpoint.note_activity(4711)
        turn()

    made.clock.step = lively
    began = made.clock.now()
    with pytest.raises(NotOwnerError, match="session 4711 owns the arm"):
        made.driver.move(turned(1.0), 1.0)
    assert 5.0 < made.clock.now() - began < 6.5
    assert len(said) == 1
    assert "4711" in said[0]
    made.clock.step = turn
    made.clock.wait(5.1)
    assert made.driver.move(turned(1.0), 1.0).mode is Mode.IN_POSITION


def test_somebody_else_s_messages_do_not_feed_the_watchdog(wire: Any) -> None:
    """A monitor reads 50 times a second while the owner is dead: the arm is stopped all the same, and nothing else."""
    sequence = wire.driver.state().ack_sequence + 1
    assert wire.link.send(sequence, Move(turned(90.0), 0.2)).result == Result.OK
    wire.link.session = 0
    for _ in range(40):
        wire.link.state()
        wire.clock.wait(0.02)
    assert wire.endpoint.controller.state().fault_code == Fault.WATCHDOG


def test_monitoring_disturbs_nobody(wire: Any, backend: str) -> None:
    """Reads as session 0 between the owner's: its move ends as if nobody had looked."""
    looks = []

    def look() -> None:
        mine, wire.link.session = wire.link.session, 0
        looks.append(wire.link.state())
        wire.link.session = mine

    during(wire, look)
    assert wire.driver.move(turned(20.0), 0.5).mode is Mode.IN_POSITION
    assert looks[0].mode is Mode.MOVING
    assert 0 < looks[0].path < 10_000
    assert looks[0].owner == wire.link.session


def test_the_same_status_on_every_wire(bench: Callable[..., Any]) -> None:
    """All that one wire tells of a moving arm, the others tell too."""
    told = []
    for backend in ("serial", "modbus", "modbus-rtu"):
        made = bench(backend)
        made.driver._ledger.session = 4711
        made.driver.connect()
        made.driver.take()
        assert made.link.send(1, Move(turned(20.0), 0.5)).result == Result.OK
        made.clock.wait(0.2)
        state = made.driver.state()
        told.append({f.name: getattr(state, f.name) for f in dataclasses.fields(state)} | {"axes": 0, "heartbeat": 0})
    assert told[0] == told[1] == told[2]
    assert 0 < told[0]["path"] < 10_000
    assert told[0]["flags"] == 2


def test_the_arm_is_given_back(wire: Any) -> None:
    """After close() nobody owns it, and the next client need not wait."""
    wire.driver.move(turned(1.0), 1.0)
    wire.driver.close()
    assert wire.endpoint.owner == 0
    wire.driver.connect()
    before = wire.clock.now()
    wire.driver.take()
    assert wire.clock.now() - before < 0.1


def test_seven_axes_are_agreed_on(bench: Callable[..., Any], backend: str) -> None:
    """A controller with an external axis: a client of seven drives it, a client of six ends with a sentence."""
    made, six = bench(backend), KR16
    seven = Limits(
        *(np.append(getattr(six, name), more) for name, more in
          (("lower", -10**6), ("upper", 10**6), ("velocity", 1.0), ("acceleration", 2.0), ("max_step", 2 * 10**6)))
    )  # fmt: skip
    endpoint = made.endpoint
    endpoint._plant = IdealPlant(np.radians([0.0, -90.0, 90.0, 0.0, 90.0, 0.0, 5.0]))
    endpoint.limits = seven
    endpoint._start(False)
    made.server._station.__init__(endpoint, **({"rtu": True} if backend == "modbus-rtu" else {}))
    with pytest.raises(ProtocolError, match="has 7 axes; this client drives 6"):
        made.driver.connect()
    client = ControllerClient(made.link, made.clock, seven)
    client.connect()
    points = np.tile(np.append(HOME, 50_000), (30, 1)).astype(np.int32)
    points[:, 6] += np.arange(30, dtype=np.int32) * 100
    assert client.move(points, 1.0).axes.tolist() == points[-1].tolist()
    (entry,) = made.journal.of("move")
    assert entry["set_points"] == points.tolist()
    client.close()


def test_a_client_of_version_1_is_refused_with_a_sentence(bench: Callable[..., Any]) -> None:
    """Its hello is answered by an ERROR that names both versions; its block is too short for exception-free writing."""
    made = bench("serial")
    frame = decode_frame(made.server._station.answer(encode_frame(Frame(">", 7, "HELLO,1"))))
    assert frame is not None
    assert re.search(r"ERROR,.*version 2 .*not 1", frame.body)
    for old in ("STATE,1000", "STOP", "RESET", "MOVE,1000,1,00000000,1,0,0,0,0,0,0"):
        frame = decode_frame(made.server._station.answer(encode_frame(Frame(">", 7, old))))
        assert frame is not None
        assert frame.kind == ("STATE" if old == "STATE,1000" else "ERROR")
    assert made.journal.of("move") == []


def test_a_controller_of_version_1_is_refused_with_a_sentence(bench: Callable[..., Any], backend: str) -> None:
    """On every wire the client names both versions."""
    made = bench(backend)
    if backend == "serial":
        old = "HELLO,1,10000,200000," + ",".join(["0"] * 18) + ",old controller"
        made.server._station.answer = lambda packet: encode_frame(Frame("<", decode_frame(packet).number, old))  # type: ignore[union-attr] # it is one
    else:
        made.server._station._capabilities = lambda: {
            field.name: {"magic": registers.MAGIC, "version": 1, "word_order": registers.WORD_ORDER}.get(
                field.name, "old" if field.type == "text" else (0,) * 6 if field.count == registers.PER_AXIS else 0
            )
            for field in registers.CAPABILITIES.fields
        }
    with pytest.raises(ProtocolError, match=r"version 1 .*this driver 2"):
        made.driver.connect()
