"""Named nasty cases of the simulated controller and its profile."""

import numpy as np
import pytest

from drivers.clock import SimulatedClock
from drivers.contract import LAST_SEQUENCE, Fault, Mode, Move, Reset, Result, Stop
from drivers.errors import DriverError, FaultError, RefusedError
from drivers.profile import Reference, interpolate
from drivers.registry import Context, DriverUrl
from drivers.setpoints import from_rad, to_rad
from drivers.sim import SimDriver
from drivers.simulated_controller import SETTLE_LIMIT, Controller, IdealPlant
from tests.support.driver_bench import HOME, HOME_Q, KR16, turned


class SetClock(SimulatedClock):
    """A clock that a test sets."""

    def set(self, now: float) -> None:
        self._now = now


def make_controller(clock: SimulatedClock | None = None) -> Controller:
    """Return the controller of a KR 16 at home."""
    return Controller(IdealPlant(HOME_Q), KR16, clock or SimulatedClock())


def simulated(plant: type | None = None, clock: SimulatedClock | None = None) -> SimDriver:
    """Return a sim:// driver over a plant."""
    context = Context(KR16, clock=clock, plants={} if plant is None else {"ideal": plant})
    return SimDriver.from_url(DriverUrl("sim://"), context)


def test_a_move_of_one_count_ends_one_count_further() -> None:
    """A move of the smallest step ends exactly, on the axis with the widest range."""
    with simulated() as driver:
        points = HOME[None] + np.array([0, 0, 0, 0, 0, 1], dtype=np.int32)
        assert driver.move(points, 1.0).axes.tolist() == points[0].tolist()


def test_each_of_a_hundred_thousand_via_points_is_passed_exactly() -> None:
    """The reference of a move rests at each of them; the first twenty are driven and watched."""
    rng = np.random.default_rng(0)
    limits = KR16
    points = rng.integers(limits.lower, limits.upper, (100_000, 6), dtype=np.int32)
    with simulated() as driver:
        assert driver.move(points[:20], 1.0).axes.tolist() == points[19].tolist()
    reference = interpolate(HOME_Q, to_rad(points), limits.velocity, limits.acceleration, limits.jerk)
    ends = np.append(reference.begin[7::7], reference.duration)
    for times in (ends[:1000], ends[-1000:]):
        at_rest, speed, _ = reference.sample(times)
        which = np.searchsorted(ends, times)
        assert (from_rad(at_rest) == points[which]).all()
        assert np.abs(speed).max() < 1e-6


def test_a_stop_in_the_middle_of_a_hundred_thousand_via_points_drops_the_rest() -> None:
    """The arm rests within the segment, no farther than an axis needs to brake from full speed."""
    clock = SimulatedClock()
    arm = make_controller(clock)
    rng = np.random.default_rng(0)
    points = rng.integers(KR16.lower, KR16.upper, (100_000, 6), dtype=np.int32)
    arm.command(1, Move(points, 1.0))
    clock.wait(arm.time_to_wait() / 2)
    before = arm.state().axes
    arm.command(2, Stop())
    clock.wait(10.0)
    state = arm.state()
    assert (state.mode, state.done_sequence, state.done_result) == (Mode.IDLE, 1, Result.STOPPED)
    braking_time = KR16.velocity / KR16.acceleration + KR16.acceleration / KR16.jerk
    assert (np.abs(to_rad(state.axes - before)) <= KR16.velocity * braking_time / 2).all()
    assert arm.time_to_wait() == 0.0


@pytest.mark.parametrize("zero", [0.0, -1e6, 1e6, 1.7e9])
def test_a_clock_may_begin_anywhere(zero: float) -> None:
    """Epoch seconds are rounded to 0.2 microseconds: the move still ends exactly, in a few waits."""
    clock = SimulatedClock(zero)
    with simulated(clock=clock) as driver:
        assert driver.move(turned(30.0, -30.0), 0.3).axes.tolist() == turned(-30.0)[0].tolist()


def test_a_clock_that_jumps_back_stands_still() -> None:
    """No axis moves backwards, and the move continues from the new time."""
    clock = SetClock(1000.0)
    arm = make_controller(clock)
    arm.command(1, Move(turned(90.0), 1.0))
    clock.set(1000.3)
    here = arm.state().axes
    clock.set(-5.0)
    assert arm.state().axes.tolist() == here.tolist()
    assert arm.state().mode is Mode.MOVING
    clock.set(-4.9)
    assert arm.state().axes[0] > here[0]
    clock.set(20.0)
    assert arm.state().axes.tolist() == turned(90.0)[0].tolist()


def test_a_clock_that_jumps_a_year_ahead_ends_the_move() -> None:
    """The move is done at its last set-point. An earlier second move was refused without effect."""
    clock = SetClock()
    arm = make_controller(clock)
    assert arm.command(1, Move(turned(10.0, -20.0, 30.0), 0.01)).result == Result.OK
    assert arm.command(2, Move(turned(0.0), 1.0)).result == Result.BUSY
    clock.set(3.2e7)
    state = arm.state()
    assert (state.mode, state.done_sequence) == (Mode.IN_POSITION, 1)
    assert state.axes.tolist() == turned(30.0)[0].tolist()


@pytest.mark.parametrize("now", [float("nan"), float("inf")])
def test_a_clock_without_a_finite_time_is_refused(now: float) -> None:
    """NaN and infinity are refused."""
    clock = SetClock()
    arm = make_controller(clock)
    clock.set(now)
    with pytest.raises(DriverError, match="clock"):
        arm.state()


def test_the_sequence_wraps_without_zero() -> None:
    """65535 is followed by 1; 0 and 65536 are refused; numbers before the wrap are stale after it."""
    arm = make_controller()
    assert arm.command(LAST_SEQUENCE - 1, Move(turned(0.0), 1.0)).result == Result.OK
    assert arm.command(LAST_SEQUENCE, Move(turned(0.0), 1.0)).result == Result.OK
    assert arm.command(0, Reset()).result == Result.SEQUENCE
    assert arm.command(LAST_SEQUENCE + 1, Reset()).result == Result.SEQUENCE
    assert arm.command(1, Move(turned(0.0), 1.0)).result == Result.OK
    assert arm.state().done_sequence == 1
    assert arm.command(LAST_SEQUENCE, Move(turned(0.0), 1.0)).result == Result.STALE


@pytest.mark.parametrize("number", [0, 1, 40_000, LAST_SEQUENCE, LAST_SEQUENCE + 1, -3])
def test_a_stop_with_any_number_stops_the_arm(number: int) -> None:
    """A stop with a used, stale or invalid number stops the arm; its answer may still be a refusal."""
    clock = SimulatedClock()
    arm = make_controller(clock)
    arm.command(1, Move(turned(90.0), 1.0))
    clock.wait(0.2)
    arm.command(number, Stop())
    clock.wait(1.0)
    state = arm.state()
    assert state.at_rest
    assert 0 < state.axes[0] < 900_000
    assert state.done_result == Result.STOPPED


@pytest.mark.parametrize("share", [0.0, 1e-9, 0.1, 0.5, 0.9, 1 - 1e-9, 1.0])
def test_a_stop_at_any_phase_brakes_on_the_path_as_fast_as_the_limits_allow(share: float) -> None:
    """Without a jerk limit, a stop in any phase takes speed over acceleration and ends within the segment."""
    limits = KR16
    reference = interpolate(HOME_Q, to_rad(turned(120.0)), limits.velocity, limits.acceleration)
    t = share * reference.duration
    braked = reference.braking_from(t)
    (q0,), (v0,), _ = reference.sample(np.array([t]))
    assert braked.sample(np.zeros(1))[0][0] == pytest.approx(q0, abs=1e-12)
    if braked.duration:
        assert braked.sample(np.zeros(1))[1][0] == pytest.approx(v0, abs=1e-12)
    assert braked.duration == pytest.approx(abs(v0[0]) / limits.acceleration[0], rel=1e-6, abs=1e-12)
    assert q0[0] - 1e-15 <= braked.end[0] <= to_rad(turned(120.0))[0, 0]
    assert (braked.end[1:] == HOME_Q[1:]).all()
    repeated = braked.braking_from(braked.duration / 2)
    assert repeated.end == pytest.approx(braked.end, abs=1e-12)


def test_a_fault_while_braking_does_not_prolong_it_and_the_first_fault_is_kept() -> None:
    """A stop and two faults give one braking and the code of the first fault. Only the emergency stop outranks it."""
    clock = SimulatedClock()
    arm = make_controller(clock)
    arm.command(1, Move(turned(90.0), 1.0))
    clock.wait(0.4)
    arm.command(2, Stop())
    remaining = arm.time_to_wait()
    arm.latch(Fault.WATCHDOG)
    arm.latch(Fault.RESTARTED)
    assert arm.time_to_wait() == pytest.approx(remaining)
    state = arm.state()
    assert (state.mode, state.fault_code, state.at_rest) == (Mode.FAULT, Fault.WATCHDOG, False)
    assert arm.command(3, Reset()).result == Result.BUSY
    clock.wait(remaining)
    assert arm.state().at_rest
    arm.emergency_stop()
    assert arm.state().fault_code == Fault.EMERGENCY_STOP


class Sticky(IdealPlant):
    """A plant that never settles."""

    settled = False  # type: ignore[assignment]


class Slow(IdealPlant):
    """A plant that settles a second after its reference has ended."""

    _waited = 0.0

    @property
    def settled(self) -> bool:
        return super().settled and self._waited >= 1.0

    def follow(self, reference: Reference) -> None:
        super().follow(reference)
        self._waited = 0.0

    def advance(self, seconds: float) -> None:
        if super().settled:
            self._waited += seconds
        super().advance(seconds)


class Diverging(IdealPlant):
    """A plant whose axes become NaN after half a second, until it gets a reference at rest."""

    _age, _diverged = 0.0, False

    def advance(self, seconds: float) -> None:
        super().advance(seconds)
        self._age += seconds
        self._diverged = self._diverged or self._age > 0.5

    def follow(self, reference: Reference) -> None:
        super().follow(reference)
        if self._diverged:
            self._age, self._diverged = -1e9, False

    @property
    def reported_axes(self) -> np.ndarray:
        return np.full(6, np.nan) if self._diverged else super().reported_axes


def test_a_plant_that_settles_late_is_waited_for() -> None:
    """The controller is in position only after it has settled."""
    with simulated(Slow) as late, simulated() as ideal:
        assert late.move(turned(20.0), 1.0).axes.tolist() == turned(20.0)[0].tolist()
        ideal.move(turned(20.0), 1.0)
        assert late.clock.now() - ideal.clock.now() == pytest.approx(1.0, abs=0.01)


def test_a_plant_that_never_settles_is_a_fault() -> None:
    """The fault is latched after SETTLE_LIMIT, and the controller does not hang."""
    with simulated(Sticky) as driver:
        with pytest.raises(FaultError, match="did not come to rest") as fault:
            driver.move(turned(20.0), 1.0)
        assert fault.value.code == Fault.NOT_SETTLED
        assert driver.clock.now() > SETTLE_LIMIT


def test_a_plant_that_diverges_is_a_fault_and_never_a_position() -> None:
    """The last finite axes stay in the state, moves are refused, and a reset clears the fault if the plant recovers."""
    with simulated(Diverging) as driver:
        with pytest.raises(FaultError, match="not a number") as fault:
            driver.move(turned(90.0), 1.0)
        assert fault.value.code == Fault.PLANT
        state = driver.state()
        assert state.mode is Mode.FAULT
        assert state.done_result == Result.FAULTED
        assert np.isfinite(state.q).all()
        assert driver.reset().mode is Mode.IDLE
        assert driver.move(turned(10.0), 1.0).mode is Mode.IN_POSITION


class Tripped(IdealPlant):
    """A plant whose drive trips during the first motion and stays tripped."""

    _tripped = False

    @property
    def failure(self) -> str:
        return "drive 3 tripped" if self._tripped else ""

    def advance(self, seconds: float) -> None:
        self._tripped = self._tripped or not self.settled
        super().advance(seconds)


def test_a_plant_that_stays_broken_stays_a_fault() -> None:
    """The message of the plant is reported. A reset without recovery is refused without effect."""
    with simulated(Tripped) as driver:
        with pytest.raises(FaultError, match="drive 3 tripped"):
            driver.move(turned(90.0), 1.0)
        for _ in range(2):
            with pytest.raises(RefusedError, match="drive 3 tripped; the reset did not clear it"):
                driver.reset()
            with pytest.raises(RefusedError, match="reset first"):
                driver.move(turned(90.0), 1.0)
        assert driver.state().fault_code == Fault.PLANT


def test_an_arm_outside_the_limits_is_refused() -> None:
    """A start one count outside the limits is refused."""
    outside = HOME.copy()
    outside[1] = KR16.upper[1] + 1
    with pytest.raises(DriverError, match="outside the controller's limits"):
        Controller(IdealPlant(to_rad(outside)), KR16, SimulatedClock())
