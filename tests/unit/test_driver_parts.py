"""Set-points, limits, commands, clocks and the ideal plant."""

from types import SimpleNamespace

import numpy as np
import pytest

from drivers import clock as clocks
from drivers.clock import RealTimeClock, SimulatedClock
from drivers.contract import (
    LAST_SEQUENCE,
    Fault,
    Move,
    Reset,
    Result,
    Stop,
    describe_result,
    is_newer,
    is_same_command,
    next_sequence,
)
from drivers.errors import DriverError, SetPointError
from drivers.limits import Limits
from drivers.profile import interpolate
from drivers.setpoints import from_rad, require_set_points, to_deg, to_rad
from drivers.simulated_controller import IdealPlant
from planner.ports import JointLimits
from tests.support.driver_bench import HOME_Q as HOME
from tests.support.driver_bench import KR16


def test_counts_survive_the_conversion_to_radians_and_back() -> None:
    """Counts are equal after conversion to radians and back, at both ends of int32, around zero and at random."""
    ends = np.iinfo(np.int32)
    counts = np.concatenate(
        [[ends.max, ends.max - 1, -ends.max, 0, 1, -1], np.random.default_rng(0).integers(-ends.max, ends.max, 999_996)]
    ).astype(np.int32)
    counts = counts[: len(counts) // 6 * 6].reshape(-1, 6)
    assert (from_rad(to_rad(counts)) == counts).all()
    assert (np.rint(to_deg(counts) * 1e4) == counts).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e9])
def test_angles_outside_int32_are_refused(bad: float) -> None:
    """NaN, infinities and angles beyond int32 are refused with the name of the axis."""
    q = np.tile(HOME, (3, 1))
    q[2, 4] = bad
    with pytest.raises(SetPointError, match="A5"):
        from_rad(q)


@pytest.mark.parametrize("bad", [np.zeros((2, 5)), np.float64(0), np.zeros((1, 6), dtype=complex), np.array(["x"] * 6)])
def test_invalid_joint_angles_are_refused(bad: np.ndarray) -> None:
    """Joint angles of a wrong shape or type are refused."""
    with pytest.raises(SetPointError, match="must be"):
        from_rad(bad)


def test_set_points_are_copied_and_read_only() -> None:
    """Validated set-points are a read-only copy, independent of the caller's array."""
    mine = np.zeros((2, 6), dtype=np.int32)
    validated = require_set_points(mine)
    mine[0, 0] = 7
    assert validated[0, 0] == 0
    with pytest.raises(ValueError, match="read-only"):
        validated[0, 0] = 1
    assert require_set_points(np.asfortranarray(mine)).flags.c_contiguous


def test_limits_between_counts_are_rounded_inwards() -> None:
    """A limit between two counts is rounded to the inner count."""
    low, high = np.radians(np.full(6, -10.00004)), np.radians(np.full(6, 10.00006))
    limits = Limits.from_rad(JointLimits(low, high, KR16.velocity, KR16.acceleration))
    assert limits.lower.tolist() == [-100_000] * 6
    assert limits.upper.tolist() == [100_000] * 6
    assert limits.max_step.tolist() == [200_000] * 6


@pytest.mark.parametrize("range_rad", [2000.0, 1e16])
def test_limits_of_a_joint_without_an_end_fit_a_set_point(range_rad: float) -> None:
    """A range beyond 32 bits, as of an endless joint in a URDF, becomes the largest one; so does its largest step."""
    ends = np.append(KR16.velocity[:5], range_rad)
    limits = Limits.from_rad(JointLimits(-ends, ends, KR16.velocity, KR16.acceleration))
    most = np.iinfo(np.int32).max
    assert limits.upper[5] == min(most, round(np.degrees(range_rad) * 1e4))
    assert limits.lower[5] == -limits.upper[5]
    assert limits.max_step[5] == most
    assert limits.max_step[0] == limits.upper[0] - limits.lower[0]


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("lower", np.full(6, 4_000_000), "range of A1 is empty"),
        ("velocity", np.zeros(6), "velocity"),
        ("acceleration", np.full(6, np.inf), "acceleration"),
        ("acceleration", np.full(6, np.nan), "acceleration"),
        ("upper", np.zeros(5), "shape"),
        ("max_step", np.zeros(6), "max_step"),
        ("max_speed", 1.5, "speed fraction"),
        ("max_via", 0, "via points"),
    ],
)
def test_impossible_limits_are_refused(name: str, value: object, words: str) -> None:
    """Each invalid limit is refused by its name."""
    fields = {k: getattr(KR16, k) for k in ("lower", "upper", "velocity", "acceleration", "max_step", "max_speed")}
    with pytest.raises(DriverError, match=words):
        Limits(**{**fields, name: value})


def test_numbers_go_round_without_zero_and_half_the_circle_is_newer() -> None:
    """`next_sequence` wraps from 65535 to 1, and `is_newer` is antisymmetric on random pairs."""
    assert next_sequence(0) == 1
    assert next_sequence(LAST_SEQUENCE) == 1
    assert is_newer(1, LAST_SEQUENCE)
    assert not is_newer(LAST_SEQUENCE, 1)
    rng = np.random.default_rng(0)
    for a, b in rng.integers(1, LAST_SEQUENCE + 1, (2000, 2)).tolist():
        assert is_newer(a, 0)
        assert is_newer(next_sequence(a), a)
        assert not is_newer(a, a)
        assert is_newer(a, b) + is_newer(b, a) == (a != b)


def test_commands_are_equal_only_with_equal_content() -> None:
    """Commands are equal only with equal content. A NaN speed equals itself, so that a repetition is recognised."""
    points = np.zeros((2, 6), dtype=np.int32)
    assert is_same_command(Move(points, 0.5), Move(points.copy(), 0.5))
    assert is_same_command(Move(points, np.nan), Move(points, np.nan))
    assert not is_same_command(Move(points, 0.5), Move(points, 0.50001))
    assert not is_same_command(Move(points, 0.5), Move(points[:1], 0.5))
    assert not is_same_command(Move(points, 0.5), Move(points + np.int32(1), 0.5))
    assert is_same_command(Stop(), Stop())
    assert not is_same_command(Stop(), Reset())


def test_every_code_has_a_message() -> None:
    """Every known code has a message, and an unknown code is stated as a number."""
    for result in Result:
        assert describe_result(result) == result.message != ""
    assert "4711" in describe_result(4711)
    assert all(fault.message for fault in Fault if fault)


def test_a_simulated_clock_advances_by_the_wait() -> None:
    """A wait advances the simulated clock by its duration. Invalid durations are refused."""
    clock = SimulatedClock(5.0)
    clock.wait(0.25)
    assert clock.now() == 5.25
    for bad in (-1.0, np.nan, np.inf):
        with pytest.raises(DriverError, match="wait"):
            clock.wait(bad)


def test_a_real_time_clock_scales_and_blocks_briefly(monkeypatch: pytest.MonkeyPatch) -> None:
    """`now()` is scaled real time, and one wait blocks for at most `MAX_WAIT`."""
    real = [100.0]
    slept: list[float] = []

    def sleep(seconds: float) -> None:
        slept.append(seconds)
        real[0] += seconds

    monkeypatch.setattr(clocks, "time", SimpleNamespace(monotonic=lambda: real[0], sleep=sleep))
    clock = RealTimeClock(4.0)
    assert clock.now() == 0.0
    clock.wait(0.1)
    assert clock.now() == pytest.approx(0.1)
    clock.wait(1000.0)
    assert slept == pytest.approx([0.025, clocks.MAX_WAIT])
    with pytest.raises(DriverError, match="speed"):
        RealTimeClock(0.0)
    with pytest.raises(DriverError, match="wait"):
        clock.wait(np.nan)


def start_move(plant: IdealPlant, degrees: float = 40.0) -> None:
    """Start a move of all axes."""
    plant.follow(
        interpolate(plant.reported_axes, plant.reported_axes[None] + np.radians(degrees), np.ones(6), np.ones(6))
    )


def test_an_ideal_plant_follows_its_reference_with_any_steps() -> None:
    """One step and a thousand steps give the same axes, and the end is reached exactly."""
    coarse, fine = IdealPlant(HOME), IdealPlant(HOME)
    start_move(coarse)
    start_move(fine)
    coarse.advance(0.7)
    for _ in range(1000):
        fine.advance(0.0007)
    assert np.abs(coarse.reported_axes - fine.reported_axes).max() < 1e-12
    assert not coarse.settled
    coarse.advance(1e9)
    assert coarse.settled
    assert (coarse.reported_axes == HOME + np.radians(40.0)).all()


def test_a_plant_refuses_invalid_axes_and_times() -> None:
    """Axes with NaN or a wrong shape and negative times are refused."""
    for bad in (np.full(6, np.nan), np.zeros(5)):
        with pytest.raises(DriverError, match="finite joint angles"):
            IdealPlant(bad)
    plant = IdealPlant(HOME)
    for seconds in (-1e-9, np.nan):
        with pytest.raises(DriverError, match="at least 0"):
            plant.advance(seconds)
