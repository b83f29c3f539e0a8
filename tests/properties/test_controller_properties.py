"""The controller as a hypothesis state machine: any commands in any order at any time."""

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from drivers.clock import SimulatedClock
from drivers.contract import Command, Fault, Mode, Move, Reset, Result, Stop, next_sequence
from drivers.limits import Limits
from drivers.setpoints import SetPoints, to_rad
from drivers.simulated_controller import Controller, IdealPlant

RANGE = 200_000  # counts: 20 deg
MAX_STEP = 300_000
LIMITS = Limits(
    lower=np.full(6, -RANGE),
    upper=np.full(6, RANGE),
    velocity=np.radians([30.0, 40.0, 50.0, 60.0, 70.0, 80.0]),
    acceleration=np.radians([100.0, 90.0, 80.0, 70.0, 60.0, 50.0]),
    max_step=np.full(6, MAX_STEP),
)


def via_points(axis: st.SearchStrategy[int]) -> st.SearchStrategy[SetPoints]:
    """Return a strategy for one to four via points."""
    rows = st.lists(st.lists(axis, min_size=6, max_size=6), min_size=1, max_size=4)
    return rows.map(lambda values: np.array(values, dtype=np.int32))


# Points with allowed steps between them, and points near the limits and one count beyond them.
good = via_points(st.integers(-MAX_STEP // 2, MAX_STEP // 2))
nasty = via_points(st.one_of(st.integers(-RANGE, RANGE), st.sampled_from([-RANGE - 1, -RANGE, RANGE, RANGE + 1, 0])))
fractions = st.floats(0.05, 1.0)
no_fractions = st.sampled_from([0.0, -1.0, 1.0000001, float("nan"), float("inf")])
times = st.floats(0.0, 3.0)


class ControllerMachine(RuleBasedStateMachine):
    """A controller and an independent, simple model of its expected behaviour."""

    def __init__(self) -> None:
        super().__init__()
        self.clock = SimulatedClock()
        self.plant = IdealPlant(np.zeros(6))
        self.controller = Controller(self.plant, LIMITS, self.clock)
        self.sequence = 0
        self.last: Command | None = None
        self.waiting: list[tuple[int, SetPoints]] = []  # accepted moves that have not ended
        self.ended = 0
        self.corners = [np.zeros(6)]  # the polyline that the arm must not leave [rad]
        self.seen = 0.0, np.zeros(6)
        self.cut = False  # a move was cut, and the arm has not been seen at rest since
        self.estop = False

    def send(self, command: Command) -> Result:
        """Send under a new number and check the acknowledgement."""
        self.sequence = next_sequence(self.sequence)
        answer = self.controller.command(self.sequence, command)
        assert answer.sequence == self.sequence
        self.last = command
        state = self.controller.state()
        assert (state.ack_sequence, state.ack_result) == (self.sequence, answer.result)
        return Result(answer.result)

    @rule(points=good, more=good, speed=fractions, seconds=times)
    def move_twice(self, points: SetPoints, more: SetPoints, speed: float, seconds: float) -> None:
        """Send two moves; the second is refused unless the first has no length."""
        self.move(points, speed)
        self.move(more, speed)
        self.clock.wait(seconds)

    @rule()
    def recover(self) -> None:
        """Clear every fault: release, rest, reset."""
        self.emergency_stop(pressed=False)
        self.wait_for_rest()
        assert self.send(Reset()) is Result.OK

    @rule(points=nasty, speed=fractions)
    def move_near_the_limits(self, points: SetPoints, speed: float) -> None:
        """Send a move that is often refused."""
        self.move(points, speed)

    @rule(points=good, speed=no_fractions)
    def move_at_no_speed(self, points: SetPoints, speed: float) -> None:
        """Send a move that is always refused."""
        self.move(points, speed)

    @rule(points=good, speed=fractions)
    def move(self, points: SetPoints, speed: float) -> None:
        """Send a move; it is accepted if and only if there is no reason against it, and reasons have an order."""
        before = self.controller.state()
        steps = np.abs(np.diff(np.concatenate([before.axes[None], points]).astype(int), axis=0))
        if before.mode in (Mode.FAULT, Mode.EMERGENCY_STOP):
            expected = {Result.IN_FAULT}
        elif before.mode is Mode.MOVING:
            expected = {Result.BUSY}
        elif np.abs(points).max() > RANGE:
            expected = {Result.LIMIT}
        elif not 0 < speed <= 1:
            expected = {Result.SPEED}
        elif steps.max() > MAX_STEP:
            expected = {Result.STEP}
        else:
            expected = {Result.OK}
        result = self.send(Move(points, speed))
        assert result in expected
        if result is Result.OK:
            self.waiting.append((self.sequence, points))
            self.corners.extend(to_rad(points))

    @rule()
    def stop(self) -> None:
        """Stop: the answer is OK and the queue is empty."""
        assert self.send(Stop()) is Result.OK
        assert self.controller.state().queue_depth == 0

    @rule(seconds=times)
    def wait(self, seconds: float) -> None:
        """Let time pass."""
        self.clock.wait(seconds)

    @rule()
    def wait_for_rest(self) -> None:
        """Wait for rest, which time_to_wait() reaches in few steps."""
        for _ in range(40):
            if self.controller.state().at_rest:
                break
            self.clock.wait(self.controller.time_to_wait())
        state = self.controller.state()
        assert state.at_rest
        assert self.controller.time_to_wait() == 0.0

    @precondition(lambda self: self.last is not None)
    @rule()
    def repeat(self) -> None:
        """Repeat the last command under its number: the old answer, without another effect."""
        assert self.last is not None
        before, queued = self.controller.state(), self.controller.time_to_wait()
        answer = self.controller.command(self.sequence, self.last)
        after = self.controller.state()
        assert answer.result == before.ack_result
        assert (after.axes == before.axes).all()
        assert (after.mode, after.queue_depth, after.done_sequence) == (
            before.mode,
            before.queue_depth,
            before.done_sequence,
        )
        assert self.controller.time_to_wait() == queued

    @precondition(lambda self: self.sequence > 1)
    @rule(points=good, back=st.integers(1, 5))
    def stale_or_reused(self, points: SetPoints, back: int) -> None:
        """Send an old number, or the last one with other content: no motion starts."""
        before = self.controller.state()
        old = self.controller.command(max(self.sequence - back, 1), Move(points, 0.987654))
        reused = self.controller.command(self.sequence, Move(points, 0.987654))
        assert old.result == Result.STALE
        assert reused.result == Result.REUSED
        after = self.controller.state()
        assert (after.queue_depth, after.ack_sequence) == (before.queue_depth, before.ack_sequence)

    @rule(fault=st.sampled_from([Fault.WATCHDOG, Fault.RESTARTED]))
    def fault(self, fault: Fault) -> None:
        """Latch a fault at any time."""
        self.controller.latch(fault)
        assert self.controller.state().mode in (Mode.FAULT, Mode.EMERGENCY_STOP)

    @rule(pressed=st.booleans())
    def emergency_stop(self, pressed: bool) -> None:
        """Press or release: pressing latches, and releasing alone clears no fault."""
        before = self.controller.state().mode
        self.controller.emergency_stop(pressed)
        self.estop = pressed
        assert self.controller.state().mode is (Mode.EMERGENCY_STOP if pressed else before)

    @rule()
    def reset(self) -> None:
        """Reset: it succeeds only with the arm at rest and the emergency stop released."""
        before = self.controller.state()
        result = self.send(Reset())
        after = self.controller.state()
        if self.estop:
            assert result is Result.ESTOP_PRESSED
        elif not before.at_rest:
            assert result is Result.BUSY
        else:
            assert result is Result.OK
            assert after.fault_code == 0
        if result is not Result.OK:
            assert (after.mode, after.fault_code) == (before.mode, before.fault_code)

    @invariant()
    def never_leaves_the_limits(self) -> None:
        """The axes of controller and plant stay inside."""
        state = self.controller.state()
        assert (np.abs(state.axes) <= RANGE).all()
        assert (np.abs(self.plant.reported_axes) <= to_rad(LIMITS.upper)).all()

    @invariant()
    def is_on_the_commanded_path(self) -> None:
        """The arm is on the polyline through the accepted via points, moving, braking or at rest."""
        here, corners = self.plant.reported_axes, np.array(self.corners)
        a, b = corners[:-1], corners[1:]
        if len(a) == 0:
            assert np.abs(here - corners[0]).max() < 1e-12
            return
        along = b - a
        square = (along**2).sum(axis=1)
        share = np.divide(((here - a) * along).sum(axis=1), square, out=np.zeros(len(a)), where=square > 0)
        nearest = a + np.clip(share, 0, 1)[:, None] * along
        assert np.abs(nearest - here).max(axis=1).min() < 1e-12

    @invariant()
    def every_accepted_move_ends_at_its_set_point_or_is_reported_as_cut(self) -> None:
        """Moves end in order; OK only exactly at the last via point."""
        state = self.controller.state()
        if state.done_sequence != self.ended:
            self.ended = state.done_sequence
            index = [number for number, _ in self.waiting].index(state.done_sequence)
            points = self.waiting[index][1]
            self.waiting = self.waiting[index + 1 :]
            if state.done_result in (Result.STOPPED, Result.FAULTED):
                assert self.waiting == []
                self.cut = True
            elif state.at_rest:
                assert (state.axes == points[-1]).all()
                assert (self.plant.reported_axes == to_rad(points[-1])).all()
        assert state.queue_depth == len(self.waiting)
        if self.cut and state.at_rest:
            self.corners, self.cut = [self.plant.reported_axes], False  # the next move begins here

    @invariant()
    def never_jumps(self) -> None:
        """Between two checks no axis moves farther than its full speed allows."""
        now, here = self.clock.now(), self.plant.reported_axes
        then, there = self.seen
        assert (np.abs(here - there) <= LIMITS.velocity * (now - then) + 1e-12).all()
        self.seen = now, here

    @invariant()
    def the_mode_agrees_with_the_other_fields(self) -> None:
        """Faults, motion and rest agree."""
        state = self.controller.state()
        assert (state.fault_code == Fault.EMERGENCY_STOP) == (state.mode is Mode.EMERGENCY_STOP)
        assert (state.fault_code != 0) == (state.mode in (Mode.FAULT, Mode.EMERGENCY_STOP))
        assert bool(state.fault_message) == (state.fault_code != 0)
        if self.estop:
            assert state.mode is Mode.EMERGENCY_STOP
        if state.mode is Mode.MOVING:
            assert not state.at_rest
        if state.mode in (Mode.IDLE, Mode.IN_POSITION):
            assert state.at_rest
        assert (state.queue_depth > 0) <= (state.mode is Mode.MOVING)


TestController = ControllerMachine.TestCase
TestController.settings = settings(stateful_step_count=40)
