"""The client's half of the contract against scripted wires: lost answers, lost lines, foreign controllers, Ctrl-C."""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest

from cell.robot import model as robot
from drivers.client import ControllerClient
from drivers.clock import SimulatedClock
from drivers.contract import Answer, Capabilities, Command, Fault, Mode, Move, Reset, Result, RobotState, Stop
from drivers.controller import Controller, IdealPlant
from drivers.errors import (
    AnswerTimeoutError,
    EmergencyStopError,
    FaultError,
    LinkLostError,
    NotConnectedError,
    RefusedError,
    StateUnknownError,
    StoppedError,
)
from drivers.limits import Limits
from drivers.setpoints import SetPoints, from_rad, to_rad

KR16 = Limits.from_rad(robot.limits(robot.load()))

START = from_rad(np.radians([0.0, -90.0, 90.0, 0.0, 90.0, 0.0]))


def at(*degrees: float) -> SetPoints:
    """(N, 6) via points: the start with A1 turned."""
    points = np.tile(START, (len(degrees), 1))
    points[:, 0] = np.round(np.array(degrees) * 10_000)
    return points


class ScriptedLink:
    """A wire to a real controller on which a test can lose, delay and break what it wants.

    `before` and `after` are called with each command's kind, before it reaches the controller and after; what
    they raise is what the wire does.
    """

    def __init__(self) -> None:
        self.clock = SimulatedClock()
        self.controller = Controller(IdealPlant(to_rad(START)), KR16, self.clock)
        self.before: Callable[[Command], None] = lambda command: None
        self.after: Callable[[Command], None] = lambda command: None
        self.on_state: Callable[[], None] = lambda: None
        self.sent: list[tuple[int, Command]] = []
        self.closed = 0
        self.deadline, self.session = math.inf, 0

    def open(self) -> Capabilities:
        limits = KR16
        return Capabilities("scripted", limits.lower, limits.upper, limits.max_step, 1.0, None, False, True)

    def close(self) -> None:
        self.closed += 1

    def take(self, session: int) -> int:
        self.session = session
        return Result.OK

    def give(self) -> None:
        self.session = 0

    def send(self, sequence: int, command: Command) -> Answer:
        self.sent.append((sequence, command))
        self.before(command)
        answer = self.controller.command(sequence, command)
        self.after(command)
        return answer

    def state(self) -> RobotState:
        self.on_state()
        return dataclasses.replace(self.controller.state(), owner=self.session)

    def time_to_wait(self) -> float:
        return self.controller.time_to_wait()

    @property
    def moves(self) -> list[int]:
        return [sequence for sequence, command in self.sent if isinstance(command, Move)]


@pytest.fixture
def link() -> ScriptedLink:
    """A wire without faults so far."""
    return ScriptedLink()


@pytest.fixture
def client(link: ScriptedLink) -> ControllerClient:
    """A connected client."""
    client = ControllerClient(link, link.clock, KR16)
    client.connect()
    return client


def times(count: int, error: Exception, kind: type = Move) -> Callable[[Command], None]:
    """Raise for the first `count` commands of a kind."""
    left = [count]

    def fault(command: Command) -> None:
        if isinstance(command, kind) and left[0] > 0:
            left[0] -= 1
            raise error

    return fault


def test_an_answer_lost_after_execution_is_found_in_the_state(link: ScriptedLink, client: ControllerClient) -> None:
    """The move runs once, is sent once, and move() returns as if nothing had happened."""
    link.after = times(1, AnswerTimeoutError("lost"))
    state = client.move(at(10), 0.5)
    assert state.axes.tolist() == at(10)[-1].tolist()
    assert link.moves == [1]


def test_a_command_lost_on_the_way_is_sent_again_under_its_number(link: ScriptedLink, client: ControllerClient) -> None:
    """The state says that it never arrived; the same number goes out once more and executes once."""
    client.move(at(5), 0.5)
    client.reset()
    link.before = times(1, AnswerTimeoutError("lost"))
    state = client.move(at(10), 0.5)
    assert state.axes.tolist() == at(10)[-1].tolist()
    assert link.moves == [1, 3, 3]
    assert state.done_sequence == 3


def test_a_refusal_whose_answer_was_lost_is_still_a_refusal(link: ScriptedLink, client: ControllerClient) -> None:
    """What the state says of the acknowledged number is the answer."""
    link.before = lambda command: link.controller.latch(Fault.WATCHDOG)  # after the client has looked
    link.after = times(1, AnswerTimeoutError("lost"))
    with pytest.raises(RefusedError) as refused:
        client.move(at(10), 0.5)
    assert refused.value.result == Result.IN_FAULT
    assert link.moves == [1]


def test_two_lost_commands_are_state_unknown_until_a_stop(link: ScriptedLink, client: ControllerClient) -> None:
    """Then only reading and stopping are possible; a confirmed stop makes moves possible under a newer number."""
    link.before = times(2, AnswerTimeoutError("lost"))
    with pytest.raises(StateUnknownError, match="execution of command 1 is unknown"):
        client.move(at(10), 0.5)
    sent = len(link.sent)
    with pytest.raises(StateUnknownError, match="stop"):
        client.move(at(10), 0.5)
    with pytest.raises(StateUnknownError, match="stop"):
        client.reset()
    assert len(link.sent) == sent
    assert client.state().mode is Mode.IDLE
    client.stop()
    assert client.move(at(10), 0.5).axes.tolist() == at(10)[-1].tolist()
    # The lost command turns up at last: it is old news.
    assert link.controller.command(1, Move(at(-50), 1.0)).result == Result.STALE
    assert client.state().axes.tolist() == at(10)[-1].tolist()


def test_a_line_lost_while_sending_is_state_unknown(link: ScriptedLink, client: ControllerClient) -> None:
    """Whether the command went through before the line broke cannot be told; it is not sent again."""
    link.after = times(1, LinkLostError("the port vanished"))
    with pytest.raises(StateUnknownError, match="the port vanished") as unknown:
        client.move(at(10), 0.5)
    assert isinstance(unknown.value.__cause__, LinkLostError)
    assert link.moves == [1]


def test_a_line_lost_while_waiting_is_state_unknown(link: ScriptedLink, client: ControllerClient) -> None:
    """The move was accepted, but how far it went is not known."""

    def lose() -> None:
        if link.moves:
            raise LinkLostError("heartbeat frozen")

    link.on_state = lose
    with pytest.raises(StateUnknownError, match="progress of move 1 is unknown"):
        client.move(at(10), 0.5)


def test_a_controller_restarted_while_moving_is_noticed(link: ScriptedLink, client: ControllerClient) -> None:
    """The new controller reports move 0 as its last: how ours ended is not known."""

    def restart(command: Command) -> None:
        link.controller = Controller(IdealPlant(to_rad(START)), KR16, link.clock)

    link.after = restart
    with pytest.raises(StateUnknownError, match="restarted"):
        client.move(at(10), 0.5)


def test_a_move_that_is_accepted_and_begins_later_is_waited_for(link: ScriptedLink, client: ControllerClient) -> None:
    """It may begin in its next cycle, or when the enabling switch is pressed: until then it stands, with a queue."""
    moved, late = link.state, [3]

    def state() -> RobotState:
        if not link.moves or not late[0]:
            return moved()
        late[0] -= 1
        return RobotState(Mode.IDLE, START, True, ack_sequence=1, queue_depth=1, owner=link.session)

    link.state = state  # type: ignore[method-assign]
    assert client.move(at(10), 0.5).axes.tolist() == at(10)[-1].tolist()
    assert late == [0]


def test_another_client_on_the_line_is_noticed(link: ScriptedLink, client: ControllerClient) -> None:
    """When an answer is lost and the state shows a foreign number, nothing is sent again."""

    def intrude(command: Command) -> None:
        link.before = lambda command: None
        link.controller.command(77, Stop())
        raise AnswerTimeoutError("lost")

    link.before = intrude
    with pytest.raises(StateUnknownError, match="another client"):
        client.move(at(10), 0.5)
    assert link.moves == [1]


def test_what_the_capabilities_exclude_is_not_sent(link: ScriptedLink, client: ControllerClient) -> None:
    """The client refuses with the controller's own codes, without a byte on the wire."""
    outside = at(0)
    outside[0, 1] = KR16.upper[1] + 1
    for points, speed, result in ((outside, 0.5, Result.LIMIT), (at(1), 2.0, Result.SPEED)):
        with pytest.raises(RefusedError) as refused:
            client.move(points, speed)
        assert refused.value.result == result
    assert link.sent == []


def test_numbering_continues_where_the_controller_stands(link: ScriptedLink) -> None:
    """A new client reads the last number and goes on from it, over the wrap too."""
    link.controller.command(65534, Stop())
    with ControllerClient(link, link.clock, KR16) as client:
        done = [client.move(at(k), 0.5).done_sequence for k in (1, 2, 3)]
    assert done == [65535, 1, 2]


class Interrupting(SimulatedClock):
    """A clock during whose `n`-th wait something happens after 0.1 s."""

    def __init__(self, happen: Callable[[], None], n: int = 1) -> None:
        super().__init__()
        self.happen, self.left = happen, n

    def wait(self, seconds: float) -> None:
        self.left -= 1
        if self.left == 0:
            super().wait(min(seconds, 0.1))
            self.happen()
        else:
            super().wait(seconds)


def interrupted(happen: Callable[[ScriptedLink, ControllerClient], None]) -> tuple[ScriptedLink, ControllerClient]:
    """A connected client that meets something 0.1 s into its first move."""
    link = ScriptedLink()
    link.clock = Interrupting(lambda: happen(link, client))
    link.controller = Controller(IdealPlant(to_rad(START)), KR16, link.clock)
    client = ControllerClient(link, link.clock, KR16)
    client.connect()
    return link, client


def test_ctrl_c_is_a_controlled_stop() -> None:
    """KeyboardInterrupt comes through after the arm has been stopped on its path and stands."""

    def ctrl_c(link: ScriptedLink, client: ControllerClient) -> None:
        raise KeyboardInterrupt

    link, client = interrupted(ctrl_c)
    with pytest.raises(KeyboardInterrupt):
        client.move(at(90), 1.0)
    state = client.state()
    assert state.at_rest
    assert state.mode is Mode.IDLE
    assert 0 < state.axes[0] < at(90)[0, 0]
    assert state.axes[1:].tolist() == START[1:].tolist()
    assert isinstance(link.sent[-1][1], Stop)
    assert client.move(at(5), 1.0).mode is Mode.IN_POSITION


def test_a_stop_from_elsewhere_ends_the_move() -> None:
    """move() raises StoppedError with the place where the arm stands, which is what the state says."""
    _, client = interrupted(lambda link, client: client.stop() and None)
    with pytest.raises(StoppedError, match="the arm is at rest at") as stopped:
        client.move(at(90), 1.0)
    state = client.state()
    assert f"({state.axes[0] / 1e4:.4f}, -90.0000" in str(stopped.value)
    assert state.done_result == Result.STOPPED


def test_a_fault_ends_the_move_until_reset() -> None:
    """move() raises FaultError with the code; moves are refused until reset(), and work after it."""
    _, client = interrupted(lambda link, client: link.controller.latch(Fault.WATCHDOG))
    with pytest.raises(FaultError, match="heartbeat") as fault:
        client.move(at(90), 1.0)
    assert fault.value.code == Fault.WATCHDOG
    assert not isinstance(fault.value, EmergencyStopError)
    with pytest.raises(RefusedError, match="reset first"):
        client.move(at(90), 1.0)
    client.reset()
    assert client.move(at(90), 1.0).axes.tolist() == at(90)[-1].tolist()


def test_an_emergency_stop_ends_the_move_until_release_and_reset() -> None:
    """Reset is refused while it is pressed."""
    link, client = interrupted(lambda link, client: link.controller.emergency_stop())
    with pytest.raises(EmergencyStopError, match="emergency stop"):
        client.move(at(90), 1.0)
    with pytest.raises(RefusedError) as refused:
        client.reset()
    assert refused.value.result == Result.ESTOP_PRESSED
    link.controller.emergency_stop(pressed=False)
    assert client.state().mode is Mode.EMERGENCY_STOP
    assert client.reset().mode is Mode.IDLE


def test_closing_stops_an_arm_that_moves(link: ScriptedLink, client: ControllerClient) -> None:
    """close() leaves no moving arm behind, and gives the wire back once."""
    client.take()
    link.controller.command(1, Move(at(90), 1.0))
    assert link.controller.state().mode is Mode.MOVING
    client.close()
    client.close()
    assert link.controller.state().at_rest
    assert link.controller.state().axes[0] < at(90)[0, 0]
    assert link.closed == 1


def test_closing_drops_a_move_that_has_not_begun(link: ScriptedLink, client: ControllerClient) -> None:
    """A move that waits for the enabling switch must not begin when nobody watches any more."""
    client.take()
    stopped = link.state
    link.state = lambda: (  # type: ignore[method-assign]
        stopped() if link.sent else RobotState(Mode.IDLE, START, True, queue_depth=1, owner=link.session)
    )
    client.close()
    assert isinstance(link.sent[-1][1], Stop)


def test_closing_a_lost_line_gives_the_wire_back(link: ScriptedLink, client: ControllerClient) -> None:
    """close() succeeds after any link failure."""

    def lose() -> None:
        raise LinkLostError("gone")

    link.on_state = lose
    client.close()
    assert link.closed == 1
    with pytest.raises(NotConnectedError):
        client.state()


def test_a_failed_connect_gives_the_wire_back(link: ScriptedLink) -> None:
    """connect() raises what the link raised, and leaves nothing open."""

    def lose() -> None:
        raise LinkLostError("nobody there")

    link.on_state = lose
    client = ControllerClient(link, link.clock, KR16)
    with pytest.raises(LinkLostError, match="nobody there"), client:
        pytest.fail("connected to nothing")
    assert link.closed == 1


def test_a_reset_whose_answer_was_lost_is_looked_up(link: ScriptedLink, client: ControllerClient) -> None:
    """Reset follows the same rule as a move."""
    link.controller.latch(Fault.WATCHDOG)
    link.after = times(1, AnswerTimeoutError("lost"), Reset)
    assert client.reset().mode is Mode.IDLE
    assert len(link.sent) == 1


def test_a_fault_right_after_a_move_is_told_by_it() -> None:
    """The arm stands at its goal and the emergency stop is pressed: nobody may scan, so move() does not just return."""
    link = ScriptedLink()

    class Pressing(SimulatedClock):
        def wait(self, seconds: float) -> None:
            super().wait(seconds)
            if link.controller.state().done_sequence:
                link.controller.emergency_stop()

    link.clock = Pressing()
    link.controller = Controller(IdealPlant(to_rad(START)), KR16, link.clock)
    client = ControllerClient(link, link.clock, KR16)
    client.connect()
    with pytest.raises(EmergencyStopError, match="the move had just ended"):
        client.move(at(10), 1.0)
    assert client.state().axes.tolist() == at(10)[-1].tolist()
