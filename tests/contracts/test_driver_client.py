"""The client's half of the contract against a scripted link: lost answers, lost lines, restarts, faults, closing."""

import dataclasses
import math
from collections.abc import Callable

import pytest

from drivers.client import ControllerClient
from drivers.clock import SimulatedClock
from drivers.contract import Answer, Capabilities, Command, Fault, Mode, Move, Reset, Result, RobotState, Stop
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
from drivers.simulated_controller import Controller, IdealPlant
from tests.support.driver_bench import HOME, HOME_Q, KR16, turned


class ScriptedLink:
    """A link to a simulated controller whose messages a test can lose or delay.

    `before` and `after` are called with each command before and after it reaches the controller; an exception is a
    failure of the wire.
    """

    def __init__(self, clock: SimulatedClock | None = None) -> None:
        self.clock = clock or SimulatedClock()
        self.controller = Controller(IdealPlant(HOME_Q), KR16, self.clock)
        self.before: Callable[[Command], None] = lambda command: None
        self.after: Callable[[Command], None] = lambda command: None
        self.on_state: Callable[[], None] = lambda: None
        self.sent: list[tuple[int, Command]] = []
        self.closed = 0
        self.deadline, self.began, self.session = math.inf, -math.inf, 0

    def open(self) -> Capabilities:
        return KR16.capabilities("scripted", hardware=False, simulated_time=True)

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
    """Return a link without faults."""
    return ScriptedLink()


@pytest.fixture
def client(link: ScriptedLink) -> ControllerClient:
    """Return a connected client."""
    client = ControllerClient(link, link.clock, KR16)
    client.connect()
    return client


def times(count: int, error: Exception, kind: type = Move) -> Callable[[Command], None]:
    """Return a function that raises for the first `count` commands of a kind."""
    left = [count]

    def fault(command: Command) -> None:
        if isinstance(command, kind) and left[0] > 0:
            left[0] -= 1
            raise error

    return fault


def raising(error: Exception) -> Callable[[], None]:
    """Return a function that raises an error."""

    def fail() -> None:
        raise error

    return fail


def test_an_answer_lost_after_execution_is_found_in_the_state(link: ScriptedLink, client: ControllerClient) -> None:
    """The move is sent and runs once, and move() returns normally; the same holds for a reset."""
    link.after = times(1, AnswerTimeoutError("lost"))
    state = client.move(turned(10), 0.5)
    assert state.axes.tolist() == turned(10)[-1].tolist()
    assert link.moves == [1]
    link.controller.latch(Fault.WATCHDOG)
    link.after = times(1, AnswerTimeoutError("lost"), Reset)
    assert client.reset().mode is Mode.IDLE
    assert len(link.sent) == 2


def test_a_command_lost_on_the_way_is_sent_again_under_its_number(link: ScriptedLink, client: ControllerClient) -> None:
    """The state shows that the command did not arrive, and the same number executes once."""
    client.move(turned(5), 0.5)
    client.reset()
    link.before = times(1, AnswerTimeoutError("lost"))
    state = client.move(turned(10), 0.5)
    assert state.axes.tolist() == turned(10)[-1].tolist()
    assert link.moves == [1, 3, 3]
    assert state.done_sequence == 3


def test_a_refusal_whose_answer_was_lost_is_still_a_refusal(link: ScriptedLink, client: ControllerClient) -> None:
    """The state has the result of the acknowledged number."""
    link.before = lambda command: link.controller.latch(Fault.WATCHDOG)  # after the client's check
    link.after = times(1, AnswerTimeoutError("lost"))
    with pytest.raises(RefusedError) as refused:
        client.move(turned(10), 0.5)
    assert refused.value.result == Result.IN_FAULT
    assert link.moves == [1]


def test_two_lost_commands_are_state_unknown_until_a_stop(link: ScriptedLink, client: ControllerClient) -> None:
    """Only reading and stopping are allowed; after a stop moves get newer numbers."""
    link.before = times(2, AnswerTimeoutError("lost"))
    with pytest.raises(StateUnknownError, match="execution of command 1 is unknown"):
        client.move(turned(10), 0.5)
    sent = len(link.sent)
    with pytest.raises(StateUnknownError, match="stop"):
        client.move(turned(10), 0.5)
    with pytest.raises(StateUnknownError, match="stop"):
        client.reset()
    assert len(link.sent) == sent
    assert client.state().mode is Mode.IDLE
    client.stop()
    assert client.move(turned(10), 0.5).axes.tolist() == turned(10)[-1].tolist()
    # The lost command arrives late: it is stale.
    assert link.controller.command(1, Move(turned(-50), 1.0)).result == Result.STALE
    assert client.state().axes.tolist() == turned(10)[-1].tolist()


def test_a_line_lost_while_sending_is_state_unknown(link: ScriptedLink, client: ControllerClient) -> None:
    """The command may have arrived, so it is not sent again."""
    link.after = times(1, LinkLostError("the port vanished"))
    with pytest.raises(StateUnknownError, match="the port vanished") as unknown:
        client.move(turned(10), 0.5)
    assert isinstance(unknown.value.__cause__, LinkLostError)
    assert link.moves == [1]


def test_a_line_lost_while_waiting_is_state_unknown(link: ScriptedLink, client: ControllerClient) -> None:
    """The move was accepted, but its progress is unknown."""
    link.after = lambda command: setattr(link, "on_state", raising(LinkLostError("heartbeat frozen")))
    with pytest.raises(StateUnknownError, match="progress of move 1 is unknown"):
        client.move(turned(10), 0.5)


def test_a_controller_restarted_while_moving_is_detected(link: ScriptedLink, client: ControllerClient) -> None:
    """The new controller reports no move; the end of the client's move is unknown."""
    link.after = lambda command: setattr(link, "controller", Controller(IdealPlant(HOME_Q), KR16, link.clock))
    with pytest.raises(StateUnknownError, match="restarted"):
        client.move(turned(10), 0.5)


def test_an_accepted_move_may_begin_later(link: ScriptedLink, client: ControllerClient) -> None:
    """A move may begin in the next cycle or with the enabling switch: until then the arm rests with a queue."""
    state, left = link.state, [3]

    def delayed() -> RobotState:
        if not link.moves or not left[0]:
            return state()
        left[0] -= 1
        return RobotState(Mode.IDLE, HOME, True, ack_sequence=1, queue_depth=1, owner=link.session)

    link.state = delayed  # type: ignore[method-assign]
    link.time_to_wait = lambda: 0.0 if left[0] else link.controller.time_to_wait()  # type: ignore[method-assign]
    assert client.move(turned(10), 0.5).axes.tolist() == turned(10)[-1].tolist()
    assert left == [0]


def test_another_client_on_the_line_is_detected(link: ScriptedLink, client: ControllerClient) -> None:
    """After a lost answer the state has the number of another client, and no command is sent again."""

    def intrude(command: Command) -> None:
        link.before = lambda command: None
        link.controller.command(77, Stop())
        raise AnswerTimeoutError("lost")

    link.before = intrude
    with pytest.raises(StateUnknownError, match="another client"):
        client.move(turned(10), 0.5)
    assert link.moves == [1]


def test_moves_outside_the_capabilities_are_not_sent(link: ScriptedLink, client: ControllerClient) -> None:
    """The client refuses such moves with the codes of the controller."""
    outside = turned(0)
    outside[0, 1] = KR16.upper[1] + 1
    for points, speed, result in ((outside, 0.5, Result.LIMIT), (turned(1), 2.0, Result.SPEED)):
        with pytest.raises(RefusedError) as refused:
            client.move(points, speed)
        assert refused.value.result == result
    assert link.sent == []


class InterruptingClock(SimulatedClock):
    """A clock that calls a function 0.1 s into its first wait."""

    def __init__(self) -> None:
        super().__init__()
        self.action: Callable[[], object] | None = None

    def wait(self, seconds: float) -> None:
        action, self.action = self.action, None
        super().wait(seconds if action is None else min(seconds, 0.1))
        if action is not None:
            action()


@pytest.fixture
def interrupted() -> tuple[ScriptedLink, ControllerClient, InterruptingClock]:
    """A connected client whose clock can call a function during its first move."""
    clock = InterruptingClock()
    link = ScriptedLink(clock)
    client = ControllerClient(link, clock, KR16)
    client.connect()
    return link, client, clock


Interrupted = tuple[ScriptedLink, ControllerClient, InterruptingClock]


def test_a_stop_from_another_thread_ends_the_move(interrupted: Interrupted) -> None:
    """move() raises StoppedError with the position of the arm."""
    _, client, clock = interrupted
    clock.action = client.stop
    with pytest.raises(StoppedError, match="the arm is at rest at") as stopped:
        client.move(turned(90), 1.0)
    state = client.state()
    assert f"({state.axes[0] / 1e4:.4f}, -90.0000" in str(stopped.value)
    assert state.done_result == Result.STOPPED


def test_a_fault_ends_the_move_until_reset(interrupted: Interrupted) -> None:
    """move() raises FaultError with the code; moves are refused until reset()."""
    link, client, clock = interrupted
    clock.action = lambda: link.controller.latch(Fault.WATCHDOG)
    with pytest.raises(FaultError, match="heartbeat") as fault:
        client.move(turned(90), 1.0)
    assert fault.value.code == Fault.WATCHDOG
    assert not isinstance(fault.value, EmergencyStopError)
    with pytest.raises(RefusedError, match="reset first"):
        client.move(turned(90), 1.0)
    client.reset()
    assert client.move(turned(90), 1.0).axes.tolist() == turned(90)[-1].tolist()


def test_an_emergency_stop_ends_the_move_until_release_and_reset(interrupted: Interrupted) -> None:
    """A reset is refused while the emergency stop is pressed."""
    link, client, clock = interrupted
    clock.action = link.controller.emergency_stop
    with pytest.raises(EmergencyStopError, match="emergency stop"):
        client.move(turned(90), 1.0)
    with pytest.raises(RefusedError) as refused:
        client.reset()
    assert refused.value.result == Result.ESTOP_PRESSED
    link.controller.emergency_stop(pressed=False)
    assert client.state().mode is Mode.EMERGENCY_STOP
    assert client.reset().mode is Mode.IDLE


def test_a_fault_just_after_a_move_is_raised_by_it() -> None:
    """The arm is at its goal but the emergency stop is pressed: no scan may follow, so move() raises."""

    class PressingClock(SimulatedClock):
        def wait(self, seconds: float) -> None:
            super().wait(seconds)
            if link.controller.state().done_sequence:
                link.controller.emergency_stop()

    clock = PressingClock()
    link = ScriptedLink(clock)
    client = ControllerClient(link, clock, KR16)
    client.connect()
    with pytest.raises(EmergencyStopError, match="the move had just ended"):
        client.move(turned(10), 1.0)
    assert client.state().axes.tolist() == turned(10)[-1].tolist()


def test_closing_stops_a_moving_arm(link: ScriptedLink, client: ControllerClient) -> None:
    """close() is allowed twice and releases the wire once."""
    client.take()
    link.controller.command(1, Move(turned(90), 1.0))
    assert link.controller.state().mode is Mode.MOVING
    client.close()
    client.close()
    assert link.controller.state().at_rest
    assert link.controller.state().axes[0] < turned(90)[0, 0]
    assert link.closed == 1


def test_closing_drops_a_move_that_has_not_begun(link: ScriptedLink, client: ControllerClient) -> None:
    """A move that waits for the enabling switch must not begin without a client."""
    client.take()
    state = link.state
    link.state = lambda: (  # type: ignore[method-assign]
        state() if link.sent else RobotState(Mode.IDLE, HOME, True, queue_depth=1, owner=link.session)
    )
    client.close()
    assert isinstance(link.sent[-1][1], Stop)


def test_a_lost_line_is_released(link: ScriptedLink, client: ControllerClient) -> None:
    """close() succeeds after a link failure, and a failed connect() releases the wire."""
    link.on_state = raising(LinkLostError("nobody there"))
    client.close()
    assert link.closed == 1
    with pytest.raises(NotConnectedError):
        client.state()
    with pytest.raises(LinkLostError, match="nobody there"), ControllerClient(link, link.clock, KR16):
        pytest.fail("connected to nothing")
    assert link.closed == 2
