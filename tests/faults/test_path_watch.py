"""The path of a moving arm is watched on every wire: deviations are stopped, arms on their path are not."""

import os
import re
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.path_watch import (
    DEVIATIONS,
    VIA_DEG,
    DeviantPlant,
    JitteringClock,
    NoisyPlant,
    count_false_alarms,
    drive_deviation,
    drive_noisy_arm,
    kr16_limits,
)
from drivers.client import ControllerClient
from drivers.contract import Capabilities, Mode, Move, RobotState
from drivers.errors import ArrivalError, PathError
from drivers.limits import Limits
from drivers.path_watch import PathWatch
from drivers.setpoints import SetPoints, from_rad
from tests.support.driver_bench import HOME, KR16, WIRES, Bench, make_bench, on_one_wire, turned

LIMITS = kr16_limits()
VIA = from_rad(np.radians(VIA_DEG))


def deviant(wire: str, name: str, limits: Limits = LIMITS) -> Bench:
    """Return a connected bench whose arm drives a law of its own."""
    bench = make_bench(wire, limits=limits)
    bench.endpoint.controller.plant = DeviantPlant(
        np.asarray(bench.endpoint.controller.plant.reported_axes), DEVIATIONS[name]
    )
    bench.driver.connect()
    return bench


@pytest.mark.parametrize(("name", "wire"), on_one_wire(DEVIATIONS))
def test_an_arm_off_its_path_is_stopped(name: str, wire: str) -> None:
    """A stop is sent, the arm comes to rest, one sentence names axis, deviation and limit. Nothing follows."""
    bench = deviant(wire, name)
    with pytest.raises((PathError, ArrivalError)) as error:
        bench.driver.move(VIA, 0.5)
    message = str(error.value)
    assert "\n" not in message
    assert bench.journal.of("stop")
    assert bench.endpoint.controller.state().at_rest
    if name == "stuck half-way":
        assert isinstance(error.value, ArrivalError)
        return
    found = re.search(r"(A\d) is at (\S+) deg.*?, (\S+) deg off, and the limit is (\S+) deg", message)
    assert found, message
    assert float(found[3]) > float(found[4])
    with pytest.raises(Exception, match=r"only state\(\) and stop\(\) are allowed"):
        bench.driver.move(VIA, 0.5)


@pytest.mark.parametrize("name", ["via points skipped", "A2 30 deg off and back", "A2 at 50 deg, limit 35"])
@pytest.mark.parametrize("speed", [1.0, 0.1])
def test_a_deviation_is_seen_on_a_wire_as_soon_as_it_is_reported(name: str, speed: float) -> None:
    """At the stop no axis was reported farther off than the tolerance and the motion between two readings."""
    bench = deviant("serial", name)
    with pytest.raises(PathError) as error:
        bench.driver.move(VIA, speed)
    found = re.search(r"(\S+) deg off, and the limit is (\S+) deg", str(error.value))
    assert found
    between = 0.03 * speed * np.degrees(LIMITS.velocity.max())  # a poll and two steps of the bench
    assert float(found[1]) <= np.max(LIMITS.path_tolerance) / 1e4 + between


@pytest.mark.parametrize("name", DEVIATIONS)
def test_the_simulated_controller_is_watched_too(name: str) -> None:
    """sim:// ends each deviation as a wire does."""
    row = drive_deviation(name, 0.1)
    assert re.match("PathError" if name != "stuck half-way" else "ArrivalError", row["end"]), row["end"]
    assert row["at rest"]


def test_an_external_axis_is_watched() -> None:
    """A rotary table that runs ahead of the arm is named."""
    wide = replace(
        KR16,
        **{name: np.append(getattr(KR16, name), getattr(KR16, name)[0])
           for name in ("lower", "upper", "velocity", "acceleration", "max_step", "jerk", "path_tolerance")},
    )  # fmt: skip
    bench = make_bench("modbus", limits=wide)
    report = bench.endpoint.report

    def ahead() -> RobotState:
        state = report()
        return replace(state, axes=state.axes + np.int32([0, 0, 0, 0, 0, 0, 3000]) * (state.mode is Mode.MOVING))

    bench.endpoint.report = ahead  # type: ignore[method-assign]
    bench.driver.connect()
    with pytest.raises(PathError, match=r"E1 is at .* deg off, and the limit is 0\.\d+ deg"):
        bench.driver.move(np.append(turned(20.0), [[0]], axis=1).astype(np.int32), 0.5)
    assert bench.journal.of("stop")


def test_no_false_alarm() -> None:
    """No move fails with noise of 0.01 deg, a lag of 40 ms and polls that jitter by 50 ms.

    `python -m benchmarks path_watch` counts over 2,000 moves.
    """
    assert count_false_alarms(15) == (0, "")


@pytest.mark.parametrize("wire", WIRES)
@pytest.mark.parametrize(
    "moves", [3, pytest.param(int(os.environ.get("PATH_WATCH_MOVES", "100")), marks=pytest.mark.slow)]
)
def test_no_false_alarm_on_a_wire(wire: str, moves: int) -> None:
    """The same holds on every wire."""
    rng = np.random.default_rng(moves)
    bench = make_bench(wire, limits=LIMITS)
    bench.endpoint.controller.plant = NoisyPlant(np.asarray(bench.endpoint.controller.plant.reported_axes), rng)
    client = ControllerClient(bench.link, JitteringClock(bench.clock, rng), LIMITS)
    client.connect()
    assert drive_noisy_arm(client, moves, rng) == (0, "")
    assert len(bench.journal.of("move")) == moves


@pytest.mark.parametrize("wire", WIRES)
def test_a_path_that_returns_is_driven_and_not_skipped(wire: str) -> None:
    """Out and back through the same points is no deviation; an arm that stays where it is has skipped the way."""
    bench = make_bench(wire)
    bench.driver.connect()
    there_and_back = turned(20.0, 0.0, 20.0, 0.0)
    assert bench.driver.move(there_and_back, 0.5).axes.tolist() == HOME.tolist()
    report = bench.endpoint.report
    bench.endpoint.report = lambda: replace(report(), axes=HOME)  # type: ignore[method-assign]
    with pytest.raises(PathError, match=r"did not pass via point 1 of 4: A1 is 20\.0000 deg away from it"):
        bench.driver.move(there_and_back, 0.5)


def watch(via: SetPoints, limits: Limits = KR16) -> PathWatch:
    """Return the watch of a move from home at full speed that begins at time 0."""
    able: Capabilities = limits.capabilities("scripted", hardware=False, simulated_time=True)
    return PathWatch(Move(via, 1.0), RobotState(Mode.IDLE, HOME, True), limits, able, 0.0)


def test_an_axis_beyond_its_limits_is_named() -> None:
    """The reported axes are compared with the limits before anything else."""
    outside = HOME.copy()
    outside[1] = 500_000
    with pytest.raises(PathError, match=r"A2 is at 50\.0000 deg during a move, 15\.0000 deg outside its limits -155"):
        watch(turned(20.0)).update(outside, 0.1)


def test_deviations_add_up() -> None:
    """Half the tolerance on one axis is allowed, and so on two, but not on three."""
    for count, allowed in ((1, True), (2, True), (3, False)):
        axes = HOME + np.int32([0, *[990] * count, *[0] * (5 - count)])
        if allowed:
            watch(turned(20.0)).update(axes, 0.1)
        else:
            with pytest.raises(PathError, match="beside the deviations of the other axes"):
                watch(turned(20.0)).update(axes, 0.1)
