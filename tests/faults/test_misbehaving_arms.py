"""Arms that do something else than their controller says or was told, and signals at any moment, on every wire."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cell.robot import model as robot
from drivers.contract import FULL, Capabilities, Flag, Mode, Result, RobotState
from drivers.errors import ArrivalError, DriverError, OverdueError
from drivers.limits import Limits
from drivers.profile import interpolate
from drivers.setpoints import SetPoints, from_rad, to_rad

KR16 = Limits.from_rad(robot.limits(robot.load()))

HOME = from_rad(np.radians([0.0, -90.0, 90.0, 0.0, 90.0, 0.0]))


def turned(degrees: float) -> SetPoints:
    """(1, 6) home with A1 turned."""
    points = HOME[None].copy()
    points[0, 0] = round(degrees * 1e4)
    return points


def says(wire: Any, change: Callable[[RobotState, float], RobotState]) -> None:
    """The controller tells a changed status, given the true one and the time since the move was accepted."""
    report, began = wire.endpoint.report, [0.0]

    def told() -> RobotState:
        state = report()
        if not wire.journal.of("move"):
            began[0] = wire.clock.now()
            return state
        return change(state, wire.clock.now() - began[0])

    wire.endpoint.report = told


def goal_of(wire: Any) -> SetPoints:
    """Where the last move goes."""
    return np.array(wire.journal.of("move")[-1]["set_points"][-1], dtype=np.int32)


def waits(state: RobotState, **more: Any) -> RobotState:
    """A move that was accepted and does not begin."""
    flags = int(Flag.AT_REST)
    return replace(state, mode=Mode.IDLE, at_rest=True, axes=HOME, queue_depth=1, path=0, flags=flags, **more)


def moves(state: RobotState, axes: SetPoints, path: int) -> RobotState:
    """A move under way."""
    sequence = state.ack_sequence
    return replace(
        state, mode=Mode.MOVING, at_rest=False, axes=axes, queue_depth=1, path=path, flags=int(Flag.MOVING),
        done_sequence=sequence - 1, done_result=0,
    )  # fmt: skip


def arrived(state: RobotState, axes: SetPoints) -> RobotState:
    """A move that is said to be done."""
    flags = int(Flag.AT_REST | Flag.IN_POSITION)
    return replace(
        state, mode=Mode.IN_POSITION, at_rest=True, axes=axes, queue_depth=0, path=FULL, flags=flags,
        done_sequence=state.ack_sequence, done_result=0,
    )  # fmt: skip


def idle(state: RobotState) -> RobotState:
    """Stands, and not in position."""
    return replace(state, mode=Mode.IDLE, flags=int(Flag.AT_REST))


def off(axes: SetPoints, by: float) -> SetPoints:
    """Axes with A1 further by so many degrees."""
    return (axes + np.int32([round(by * 1e4), 0, 0, 0, 0, 0])).astype(np.int32)


ARMS: dict[str, tuple[Callable[[Any], Callable[[RobotState, float], RobotState]], type[DriverError], str, float]] = {
    "never begins": (
        lambda wire: lambda state, t: waits(state),
        OverdueError, r"5\.\d s without progress while waiting for the end of a move", 7.5,
    ),
    "sticks half-way": (
        lambda wire: lambda state, t: moves(state, off(HOME, min(20 * t, 10.0)), min(round(5000 * t), 5000)),
        OverdueError, "(without progress|of motion).*50 % of the path", 8.5,
    ),
    "trembles on the spot": (
        lambda wire: lambda state, t: moves(state, off(HOME, 1e-4 * (round(100 * t) % 5)), 3000),
        OverdueError, "without progress", 7.5,
    ),
    "swings to and fro": (
        lambda wire: lambda state, t: moves(state, off(HOME, 5 * np.sin(t)), 3000),
        OverdueError, "s of motion instead of", 8.5,
    ),
    "creeps": (
        lambda wire: lambda state, t: moves(state, off(HOME, 0.1 * t), min(round(50 * t), 9000)),
        OverdueError, "s of motion instead of", 8.5,
    ),
    "stands at override 0": (
        lambda wire: lambda state, t: replace(moves(state, HOME, 0), override=0),
        OverdueError, "override 0 %", 7.5,
    ),
    "is there at once": (
        lambda wire: lambda state, t: arrived(state, goal_of(wire)),
        ArrivalError, "did not drive it, or is faster than real time", 2.0,
    ),
    "is there in half the time": (
        lambda wire: lambda state, t: arrived(state, goal_of(wire)) if t > 0.35 else state,
        ArrivalError, "did not drive it, or is faster than real time", 2.0,
    ),
    "says done half-way": (
        lambda wire: lambda state, t: arrived(state, off(HOME, 15.0)) if t > 1.0 else moves(state, HOME, 0),
        ArrivalError, "reports the end of the move, but the arm is at", 3.0,
    ),
    "says done and idle": (
        lambda wire: lambda state, t: idle(arrived(state, goal_of(wire))) if t > 1 else moves(state, HOME, 0),
        ArrivalError, "not in position", 3.0,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", ARMS)
def test_an_arm_that_does_something_else(name: str, wire: Any) -> None:
    """It ends within its limit, by its name, and the arm has been told to stop."""
    behave, kind, words, limit = ARMS[name]
    began = wire.clock.now()
    says(wire, behave(wire))
    with pytest.raises(kind, match=words) as ended:
        wire.driver.move(turned(30.0), 1.0)
    assert wire.clock.now() - began < limit
    assert "\n" not in str(ended.value)
    assert wire.journal.of("stop")
    began = wire.clock.now()
    wire.driver.close()
    assert wire.clock.now() - began < 1.5


def test_a_hold_suspends_the_limits_and_is_told(wire: Any) -> None:
    """Held for 8 s before it begins, longer than without progress, then the move is driven; the wait is told."""
    said: list[str] = []
    wire.driver._notify = said.append
    controller = wire.endpoint.controller
    now, held = controller._clock.now, [0.0]
    report = wire.endpoint.report

    def told() -> RobotState:
        state = report()
        if not wire.journal.of("move") or wire.clock.now() > 8.0:
            return state
        return replace(waits(state), flags=int(Flag.AT_REST | Flag.HELD))

    def clock() -> float:
        if wire.journal.of("move") and wire.clock.now() <= 8.0:
            held[0] = wire.clock.now() - began
        return float(now() - held[0])

    began = wire.clock.now()
    controller._clock = type("Held", (), {"now": staticmethod(clock)})()
    wire.endpoint.report = told
    assert wire.driver.move(turned(30.0), 1.0).mode is Mode.IN_POSITION
    assert wire.clock.now() > 8.0
    assert any("held" in sentence and "waiting for the end of a move" in sentence for sentence in said)


def test_a_slow_override_is_waited_for(bench: Callable[..., Any], backend: str) -> None:
    """Ten times as slow as its profile, and it says so; the same arm without saying so is overdue."""
    for told in (1000, FULL):
        made = bench(backend, time_scale=0.1)
        type_of = type(made.endpoint)
        made.endpoint.__class__ = type("RealTime", (type_of,), {
            "capabilities": property(lambda self, of=type_of: replace(of.capabilities.fget(self), time_scale=1.0))
        })  # fmt: skip
        report = made.endpoint.report
        made.endpoint.report = lambda report=report, told=told: replace(report(), override=told)
        made.driver.connect()
        if told == FULL:
            with pytest.raises(OverdueError, match="of motion"):
                made.driver.move(turned(15.0), 0.5)
        else:
            assert made.driver.move(turned(15.0), 0.5).mode is Mode.IN_POSITION
        made.driver.close()


@pytest.mark.parametrize("factor", [0.5, 20.0, 1000.0])
def test_an_emulator_that_tells_its_factor_is_judged_by_its_clock(
    bench: Callable[..., Any], backend: str, factor: float
) -> None:
    """Faster or slower than real time is no fault where it is told, and one where it is not."""
    made = bench(backend, time_scale=factor)
    made.driver.connect()
    assert made.driver.capabilities.time_scale == factor
    assert made.driver.move(turned(30.0), 1.0).mode is Mode.IN_POSITION
    made.driver.close()
    if factor <= 1.0:
        return
    silent = bench(backend, time_scale=factor)
    silent.endpoint._time_scale = 1.0
    silent.driver.connect()
    with pytest.raises(ArrivalError, match="faster than real time"):
        silent.driver.move(turned(30.0), 1.0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"lower": KR16.upper + np.int32(1)}, "lower limit of an axis is above"),
        ({"max_step": KR16.max_step * 0}, "largest step"),
        ({"max_speed": 0.0}, "largest speed fraction"),
        ({"time_scale": 0.0}, "as fast as real time"),
    ],
)
def test_capabilities_that_cannot_be_are_refused_at_connecting(
    bench: Callable[..., Any], backend: str, change: dict[str, Any], words: str
) -> None:
    """With what is wrong, before anything else."""
    made = bench(backend)
    type_of = type(made.endpoint)

    def able(self: Any) -> Capabilities:
        return replace(type_of.capabilities.fget(self), **change)

    made.endpoint.__class__ = type("Odd", (type_of,), {"capabilities": property(able)})
    with pytest.raises(DriverError, match=words):
        made.driver.connect()


def test_an_arm_that_never_stands_after_a_stop_is_given_up(wire: Any) -> None:
    """Within 5 s and a little, with the advice that is left; and closing does not wait again."""
    says(wire, lambda state, t: moves(state, off(HOME, 5 + np.sin(t)), 5000))
    began = wire.clock.now()
    with pytest.raises(OverdueError):
        wire.driver.move(turned(30.0), 1.0)
    began = wire.clock.now()
    with pytest.raises(OverdueError, match="emergency stop"):
        wire.driver.stop()
    assert wire.clock.now() - began < 6.0


MOMENTS = [*range(3), *(pytest.param(k, marks=pytest.mark.slow) for k in range(3, 100))]


@pytest.mark.parametrize("moment", MOMENTS)
def test_an_interrupt_at_any_moment_leaves_a_standing_arm(bench: Callable[..., Any], backend: str, moment: int) -> None:
    """It stands within its own braking time and 0.2 s, and the client is gone within 2 s; so too on a mute line."""
    rng = np.random.default_rng([moment, len(backend)])
    at, mute, speed = float(rng.uniform(0.0, 2.5)), bool(moment % 3 == 2), float(rng.uniform(0.3, 1.0))
    made = bench(backend)
    made.driver.connect()
    made.driver.take()
    base, wait, came = made.clock.now(), made.clock.wait, [0.0]

    def interrupted(seconds: float) -> None:
        wait(seconds)
        if not came[0] and made.clock.now() - base >= at:
            came[0] = made.clock.now()
            if mute:
                made.server._mute_until = came[0] + 60.0
            raise KeyboardInterrupt

    made.clock.wait = interrupted
    braking: list[float] = []

    def to_and_fro() -> None:
        with made.driver:
            for degrees in 40.0 * (-1.0) ** np.arange(20):
                made.driver.move(turned(degrees), speed)

    with pytest.raises(KeyboardInterrupt):
        to_and_fro()
    gone = made.clock.now()
    made.clock.wait = wait
    assert gone - came[0] < 2.0
    limits = KR16
    there = interpolate(to_rad(HOME), to_rad(turned(170.0)), limits.velocity * speed, limits.acceleration, limits.jerk)
    braking.append(there.braking_from(there.duration / 2).duration)  # from full speed: no brake takes longer
    until = came[0] + braking[0] + 0.2 + (0.5 + 0.1 if mute else 0.0)  # a mute line is the watchdog's
    if until > gone:
        made.clock.wait(until - gone)
    assert made.endpoint.controller.state().at_rest
    assert mute or made.endpoint.controller.state().done_result in (Result.OK, Result.STOPPED)
