"""Arms that do not move as reported or commanded, and interrupts at any moment."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers.contract import FULL, Capabilities, Flag, Mode, Result, RobotState
from drivers.errors import ArrivalError, DriverError, OverdueError, PathError
from drivers.profile import interpolate
from drivers.setpoints import to_rad
from tests.support.driver_bench import HOME, KR16, WIRES, Bench, make_bench, on_one_wire, turned


def connected(wire: str, time_scale: float = 1.0) -> Bench:
    """Return a connected bench that owns the arm."""
    bench = make_bench(wire, time_scale=time_scale)
    bench.driver.connect()
    bench.driver.take()
    return bench


def report_as(bench: Bench, change: Callable[[RobotState, float], RobotState]) -> None:
    """Let the controller report a changed status, given the true one and the time since the move was accepted."""
    report, began = bench.endpoint.report, [0.0]

    def changed() -> RobotState:
        state = report()
        if not bench.journal.of("move"):
            began[0] = bench.clock.now()
            return state
        return change(state, bench.clock.now() - began[0])

    bench.endpoint.report = changed  # type: ignore[method-assign]


def override_capabilities(bench: Bench, **changes: Any) -> None:
    """Let the controller report other capabilities."""
    kind = type(bench.endpoint)

    def capabilities(self: Any) -> Capabilities:
        return replace(kind.capabilities.fget(self), **changes)  # type: ignore[attr-defined]

    bench.endpoint.__class__ = type("Changed", (kind,), {"capabilities": property(capabilities)})


def waiting(state: RobotState, **more: Any) -> RobotState:
    """Return the status of an accepted move that does not begin."""
    flags = int(Flag.AT_REST)
    return replace(
        state, **{"mode": Mode.IDLE, "at_rest": True, "axes": HOME, "queue_depth": 1, "path": 0, "flags": flags, **more}
    )


def moving(state: RobotState, a1: float, path: int) -> RobotState:
    """Return the status of a move under way, with A1 this far from home [deg]."""
    return replace(
        state,
        mode=Mode.MOVING,
        at_rest=False,
        axes=turned(a1)[0],
        queue_depth=1,
        path=path,
        flags=int(Flag.MOVING),
        done_sequence=state.ack_sequence - 1,
        done_result=0,
    )


def arrived(state: RobotState, a1: float = 30.0, mode: Mode = Mode.IN_POSITION) -> RobotState:
    """Return the status of a move reported as done, with A1 this far from home [deg]."""
    flags = Flag.AT_REST | (Flag.IN_POSITION if mode is Mode.IN_POSITION else 0)
    return replace(
        state,
        mode=mode,
        at_rest=True,
        axes=turned(a1)[0],
        queue_depth=0,
        path=FULL,
        flags=int(flags),
        done_sequence=state.ack_sequence,
        done_result=0,
    )


ARMS: dict[str, tuple[Callable[[RobotState, float], RobotState], type[DriverError], str, float]] = {
    "never begins": (lambda s, t: waiting(s), OverdueError, r"5\.\d s without progress.* end of a move", 7.5),
    "is stuck half-way": (
        lambda s, t: moving(s, min(20 * t, 10.0), min(round(5000 * t), 5000)),
        OverdueError,
        "(without progress|of motion).*50 % of the path",
        8.5,
    ),
    "trembles": (lambda s, t: moving(s, 1e-4 * (round(100 * t) % 5), 3000), OverdueError, "without progress", 7.5),
    "swings": (lambda s, t: moving(s, 5 * np.sin(t), 3000), PathError, r"A1 is at \d.*deg off, and the limit is", 8.5),
    "creeps": (lambda s, t: moving(s, 0.1 * t, min(round(50 * t), 9000)), OverdueError, "s of motion instead of", 8.5),
    "has override 0": (lambda s, t: replace(moving(s, 0, 0), override=0), OverdueError, "override 0 %", 7.5),
    "arrives at once": (lambda s, t: arrived(s), ArrivalError, "did not drive it, or is faster than real time", 2.0),
    "arrives in half the time": (
        lambda s, t: arrived(s) if t > 0.35 else s,
        ArrivalError,
        "did not drive it, or is faster than real time",
        2.0,
    ),
    "reports the end half-way": (
        lambda s, t: arrived(s, 15.0) if t > 1.0 else moving(s, 0, 0),
        ArrivalError,
        "reports the end of the move, but the arm is at",
        3.0,
    ),
    "reports the end and idle": (
        lambda s, t: arrived(s, mode=Mode.IDLE) if t > 1 else moving(s, 0, 0),
        ArrivalError,
        "not in position",
        3.0,
    ),
}


@pytest.mark.parametrize(("name", "wire"), on_one_wire(ARMS))
def test_an_arm_that_moves_otherwise(name: str, wire: str) -> None:
    """The wait ends within its limit with the cause, and the arm is stopped."""
    change, kind, cause, limit = ARMS[name]
    bench = connected(wire)
    began = bench.clock.now()
    report_as(bench, change)
    with pytest.raises(kind, match=cause) as error:
        bench.driver.move(turned(30.0), 1.0)
    assert bench.clock.now() - began < limit
    assert "\n" not in str(error.value)
    assert bench.journal.of("stop")
    began = bench.clock.now()
    bench.driver.close()
    assert bench.clock.now() - began < 1.5


@pytest.mark.parametrize(("name", "wire"), on_one_wire(["hold"]))
def test_a_hold_suspends_the_limits(name: str, wire: str) -> None:
    """A move held for 8 s before it begins is completed; the wait is notified."""
    bench, notes = connected(wire), []
    bench.driver._notify = notes.append
    controller, report = bench.endpoint.controller, bench.endpoint.report
    now, hold_time, began = controller._clock.now, [0.0], bench.clock.now()

    def is_held() -> bool:
        return bool(bench.journal.of("move")) and bench.clock.now() <= 8.0

    def paused() -> float:
        if is_held():
            hold_time[0] = bench.clock.now() - began
        return float(now() - hold_time[0])

    def held_report() -> RobotState:
        state = report()
        return waiting(state, flags=int(Flag.AT_REST | Flag.HELD)) if is_held() else state

    controller._clock = type("Paused", (), {"now": staticmethod(paused)})()
    bench.endpoint.report = held_report  # type: ignore[method-assign]
    assert bench.driver.move(turned(30.0), 1.0).mode is Mode.IN_POSITION
    assert bench.clock.now() > 8.0
    assert any("held" in note and "waiting for the end of a move" in note for note in notes)


@pytest.mark.parametrize(("override", "wire"), on_one_wire([1000, FULL]))
def test_a_slow_arm_must_report_its_override(override: int, wire: str) -> None:
    """A tenth of the speed is accepted if it is reported as override, and overdue if not."""
    bench = make_bench(wire, time_scale=0.1)
    override_capabilities(bench, time_scale=1.0)
    report = bench.endpoint.report
    bench.endpoint.report = lambda: replace(report(), override=override)  # type: ignore[method-assign]
    bench.driver.connect()
    if override == FULL:
        with pytest.raises(OverdueError, match="of motion"):
            bench.driver.move(turned(15.0), 0.5)
    else:
        assert bench.driver.move(turned(15.0), 0.5).mode is Mode.IN_POSITION
    bench.driver.close()


@pytest.mark.parametrize(("factor", "wire"), on_one_wire([0.5, 20.0, 1000.0]))
def test_an_emulator_must_report_its_time_scale(factor: float, wire: str) -> None:
    """A reported time scale is accepted; an unreported one gives an arrival sooner than possible."""
    bench = connected(wire, time_scale=factor)
    assert bench.driver.capabilities.time_scale == factor
    assert bench.driver.move(turned(30.0), 1.0).mode is Mode.IN_POSITION
    bench.driver.close()
    if factor > 1.0:
        silent = make_bench(wire, time_scale=factor)
        silent.endpoint._time_scale = 1.0
        silent.driver.connect()
        with pytest.raises((ArrivalError, PathError), match="faster than real time"):
            silent.driver.move(turned(30.0), 1.0)


@pytest.mark.parametrize("wire", WIRES)
def test_impossible_capabilities_are_refused_at_connecting(wire: str) -> None:
    """Invalid ranges, steps, speeds and time scales are refused, each with its cause."""
    for changes, cause in (
        ({"lower": KR16.upper + np.int32(1)}, "lower limit of an axis is above"),
        ({"max_step": KR16.max_step * 0}, "largest step"),
        ({"max_speed": 0.0}, "largest speed fraction"),
        ({"time_scale": 0.0}, "as fast as real time"),
    ):
        bench = make_bench(wire)
        override_capabilities(bench, **changes)
        with pytest.raises(DriverError, match=cause):
            bench.driver.connect()


@pytest.mark.parametrize(("name", "wire"), on_one_wire(["never rests"]))
def test_an_arm_that_never_rests_after_a_stop(name: str, wire: str) -> None:
    """The stop ends after 5 s with the advice to press the emergency stop."""
    bench = connected(wire)
    report_as(bench, lambda state, t: moving(state, 5 + np.sin(t), 5000))
    with pytest.raises(PathError):
        bench.driver.move(turned(30.0), 1.0)
    began = bench.clock.now()
    with pytest.raises(OverdueError, match="emergency stop"):
        bench.driver.stop()
    assert bench.clock.now() - began < 6.0


MOMENTS = [*range(3), *(pytest.param(k, marks=pytest.mark.slow) for k in range(3, 100))]


@pytest.mark.parametrize("moment", MOMENTS)
@pytest.mark.parametrize("wire", WIRES)
def test_an_interrupt_at_any_moment_stops_the_arm(wire: str, moment: int) -> None:
    """The arm rests within its braking time and 0.2 s, and the client ends within 2 s, even on a mute line."""
    rng = np.random.default_rng([moment, len(wire)])
    at, mute, speed = float(rng.uniform(0.0, 2.5)), bool(moment % 3 == 2), float(rng.uniform(0.3, 1.0))
    bench = connected(wire)
    base, wait, interrupted_at = bench.clock.now(), bench.clock.wait, [0.0]

    def interrupting_wait(seconds: float) -> None:
        wait(seconds)
        if not interrupted_at[0] and bench.clock.now() - base >= at:
            interrupted_at[0] = bench.clock.now()
            if mute:
                bench.server._mute_until = interrupted_at[0] + 60.0
            raise KeyboardInterrupt

    def move_to_and_fro() -> None:
        with bench.driver:
            for degrees in 40.0 * (-1.0) ** np.arange(20):
                bench.driver.move(turned(degrees), speed)

    bench.clock.wait = interrupting_wait  # type: ignore[method-assign]
    with pytest.raises(KeyboardInterrupt):
        move_to_and_fro()
    ended = bench.clock.now()
    bench.clock.wait = wait  # type: ignore[method-assign]
    assert ended - interrupted_at[0] < 2.0
    at_full_speed = interpolate(
        to_rad(HOME), to_rad(turned(170.0)), KR16.velocity * speed, KR16.acceleration, KR16.jerk
    )
    longest_brake = at_full_speed.braking_from(at_full_speed.duration / 2).duration
    until = interrupted_at[0] + longest_brake + 0.2 + (0.5 + 0.1 if mute else 0.0)  # a mute line needs the watchdog
    if until > ended:
        bench.clock.wait(until - ended)
    state = bench.endpoint.controller.state()
    assert state.at_rest
    assert mute or state.done_result in (Result.OK, Result.STOPPED)
