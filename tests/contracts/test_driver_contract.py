"""What every driver keeps, whatever its wire. To test your own driver, copy this file or set CELL_DRIVER_URLS.

    CELL_DRIVER_URLS="sim:// acme://localhost" pytest tests/contracts/test_driver_contract.py

The moves are small (a few degrees about where the arm stands) and slow; with hardware, clear the cell first. What is no
URL is a protocol of `cell emulate`, whose controller is started in a process of its own.
"""

import os
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from cell.robot import model as robot
from drivers.contract import Driver, Mode, Result
from drivers.errors import DriverUrlError, NotConnectedError, RefusedError, SetPointError
from drivers.limits import Limits
from drivers.registry import Context, open_driver
from drivers.setpoints import PER_DEGREE, SetPoints, from_rad

KR16 = Limits.from_rad(robot.limits(robot.load()))

URLS = os.environ.get("CELL_DRIVER_URLS", "sim:// sim://?realtime&time_scale=10000 serial modbus modbus-rtu").split()
SPEED = 0.1


@pytest.fixture(scope="module")
def started(request: pytest.FixtureRequest) -> Callable[[str], str]:
    """Gives the URL of an entry of URLS; for those that are protocols, emulated controllers are started."""
    protocols = [entry for entry in URLS if "://" not in entry]
    emulate: Callable[..., Any] | None = request.getfixturevalue("emulate_for_all") if protocols else None
    running = {entry: emulate(entry, "--time-scale", "1000") for entry in protocols if emulate}
    return lambda entry: str(running[entry].url) if entry in running else entry


@pytest.fixture(params=URLS)
def driver(request: pytest.FixtureRequest, started: Callable[[str], str]) -> Iterator[Driver]:
    """A connected driver without a fault."""
    with open_driver(started(request.param), Context(KR16)) as driver:
        driver.reset()
        yield driver


def near(driver: Driver, *degrees: float) -> SetPoints:
    """(N, 6) set-points that turn every axis by so many degrees from where it stands, away from the nearer limit."""
    state, able = driver.state(), driver.capabilities
    middle = (able.lower.astype(np.int64) + able.upper) // 2
    away = np.where(state.axes > middle, -1, 1)
    return np.array([state.axes + away * round(d * PER_DEGREE) for d in degrees], dtype=np.int32)


def test_a_move_ends_exactly_at_its_last_set_point(driver: Driver) -> None:
    """After move() the arm stands in position at the last via point, to the count, and the next state says the same."""
    points = near(driver, 1.0, 0.5, 2.0001)
    for state in (driver.move(points, SPEED), driver.state()):
        assert state.mode is Mode.IN_POSITION
        assert state.at_rest
        assert state.axes.tolist() == points[-1].tolist()
        assert (from_rad(state.q) == points[-1]).all()
        assert state.fault_code == 0
        assert state.fault_message == ""


def test_a_move_to_where_the_arm_stands_is_done_at_once(driver: Driver) -> None:
    """A zero-length move is a move: accepted, counted, in position, at the same axes."""
    before = driver.state()
    after = driver.move(before.axes[None].copy(), SPEED)
    assert after.mode is Mode.IN_POSITION
    assert after.axes.tolist() == before.axes.tolist()
    assert after.done_sequence == after.ack_sequence != before.done_sequence


def test_moves_are_counted_and_acknowledged(driver: Driver) -> None:
    """Each move has a number of its own, which is acknowledged and then done."""
    numbers = []
    for degrees in (0.1, 0.2, 0.3):
        state = driver.move(near(driver, degrees), SPEED)
        assert state.ack_result == state.done_result == Result.OK
        assert state.ack_sequence == state.done_sequence
        numbers.append(state.done_sequence)
    assert len(set(numbers)) == 3


@pytest.mark.parametrize(
    "broken",
    [
        np.zeros((1, 6)),
        np.zeros((1, 6), dtype=np.int64),
        np.full((1, 6), np.nan),
        np.zeros(6, dtype=np.int32),
        np.zeros((1, 5), dtype=np.int32),
        np.zeros((0, 6), dtype=np.int32),
        [[0, 0, 0, 0, 0, 0]],
    ],
    ids=["float", "int64", "nan", "one row flat", "five axes", "no via point", "a list"],
)
def test_broken_set_points_are_refused_and_nothing_moves(driver: Driver, broken: object) -> None:
    """Only (N, 6) int32 travels; anything else is a SetPointError and the state is untouched."""
    before = driver.state()
    with pytest.raises(SetPointError, match="must be"):
        driver.move(broken, SPEED)  # type: ignore[arg-type]
    after = driver.state()
    assert after.axes.tolist() == before.axes.tolist()
    assert after.ack_sequence == before.ack_sequence


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("side", ["lower", "upper"])
def test_one_count_beyond_a_limit_is_refused(driver: Driver, axis: int, side: str) -> None:
    """A set-point one count outside is refused with LIMIT and its axis' name, wherever it stands in the move."""
    before = driver.state()
    points = np.tile(before.axes, (3, 1))
    points[1, axis] = getattr(driver.capabilities, side)[axis] + (1 if side == "upper" else -1)
    with pytest.raises(RefusedError, match=rf"via point 1 has A{axis + 1} at") as refused:
        driver.move(points, SPEED)
    assert refused.value.result == Result.LIMIT
    assert driver.state().axes.tolist() == before.axes.tolist()


@pytest.mark.parametrize("speed", [0.0, -0.1, 1.0001, float("nan"), float("inf")])
def test_a_speed_outside_its_range_is_refused(driver: Driver, speed: float) -> None:
    """The speed fraction lies in (0, max_speed]; NaN is no fraction."""
    before = driver.state()
    with pytest.raises(RefusedError, match="speed fraction") as refused:
        driver.move(near(driver, 0.1), speed)
    assert refused.value.result == Result.SPEED
    assert driver.state().axes.tolist() == before.axes.tolist()


def test_stop_and_reset_of_an_arm_that_stands_change_nothing(driver: Driver) -> None:
    """Both are always allowed, and leave the arm where it is, ready for the next move."""
    driver.move(near(driver, 0.5), SPEED)
    before = driver.state()
    assert driver.stop().axes.tolist() == before.axes.tolist()
    assert driver.reset().axes.tolist() == before.axes.tolist()
    points = near(driver, 0.25)
    assert driver.move(points, SPEED).axes.tolist() == points[-1].tolist()


def test_a_closed_driver_says_so_and_opens_again_where_the_arm_stands(driver: Driver) -> None:
    """close() may be called twice; after it every use is NotConnectedError; a new connection goes on counting."""
    last = driver.move(near(driver, 0.5), SPEED)
    driver.close()
    driver.close()
    for use in (driver.state, driver.stop, driver.reset, lambda: driver.capabilities):
        with pytest.raises(NotConnectedError, match="connect"):
            use()
    with pytest.raises(NotConnectedError):
        driver.move(last.axes[None].copy(), SPEED)
    driver.connect()
    driver.connect()
    again = driver.state()
    assert again.axes.tolist() == last.axes.tolist()
    assert driver.move(again.axes[None].copy(), SPEED).done_sequence > last.done_sequence


def test_capabilities_describe_a_range_around_the_arm(driver: Driver) -> None:
    """Limits are int32 counts that hold the axes, read-only; the speed fraction is one."""
    able, axes = driver.capabilities, driver.state().axes
    assert ((able.lower <= axes) & (axes <= able.upper)).all()
    assert (able.max_step > 0).all()
    assert 0 < able.max_speed <= 1
    assert able.controller
    for array in (able.lower, able.upper, able.max_step, axes):
        assert array.dtype == np.int32
        assert not array.flags.writeable


@pytest.mark.parametrize("entry", URLS)
def test_an_unknown_option_is_refused_by_name(entry: str, started: Callable[[str], str]) -> None:
    """No driver swallows an option that it does not have."""
    url = started(entry)
    with pytest.raises(DriverUrlError, match="no option 'no_such_option'"):
        open_driver(url + ("&" if "?" in url else "?") + "no_such_option=1", Context(KR16))
