"""The contract of every driver on every wire. To test another driver, set CELL_DRIVER_URLS.

    CELL_DRIVER_URLS="sim:// acme://localhost" pytest tests/contracts/test_driver_contract.py

The moves are small (a few degrees around the present position) and slow; with hardware, clear the cell first. An entry
that is no URL is a protocol of `cell emulate`; its controller runs in a separate process.
"""

import os
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from drivers.contract import Driver, Mode, Result
from drivers.errors import DriverUrlError, NotConnectedError, RefusedError, SetPointError
from drivers.registry import Context, open_driver
from drivers.setpoints import PER_DEGREE, SetPoints, from_rad
from tests.support.arms import KR16
from tests.support.fixture_types import Emulate

pytestmark = pytest.mark.real_time

URLS = os.environ.get("CELL_DRIVER_URLS", "sim:// sim://?realtime&time_scale=10000 serial modbus modbus-rtu").split()
SPEED = 0.1


@pytest.fixture(scope="module")
def url_of(request: pytest.FixtureRequest) -> Callable[[str], str]:
    """Return a function from an entry of URLS to its URL; each protocol starts an emulated controller."""
    protocols = [entry for entry in URLS if "://" not in entry]
    emulate: Emulate | None = request.getfixturevalue("emulate_for_all") if protocols else None
    running = {entry: emulate(entry, "--time-scale", "1000") for entry in protocols if emulate}
    return lambda entry: str(running[entry].url) if entry in running else entry


@pytest.fixture(params=URLS)
def driver(request: pytest.FixtureRequest, url_of: Callable[[str], str]) -> Iterator[Driver]:
    """Yield a connected driver without a fault."""
    with open_driver(url_of(request.param), Context(KR16)) as driver:
        driver.reset()
        yield driver


def near(driver: Driver, *degrees: float) -> SetPoints:
    """Return via points (N, 6) with every axis this far [deg] from its present angle, away from the nearer limit."""
    axes, capabilities = driver.state().axes, driver.capabilities
    middle = (capabilities.lower.astype(np.int64) + capabilities.upper) // 2
    sign = np.where(axes > middle, -1, 1)
    return np.array([axes + sign * round(d * PER_DEGREE) for d in degrees], dtype=np.int32)


def test_a_move_ends_exactly_at_its_last_set_point(driver: Driver) -> None:
    """The driver is in position, at rest and exactly at the last set-point. Each move has a separate number."""
    numbers = set()
    for points in (near(driver, 1.0, 0.5, 2.0001), near(driver, 0.1), driver.state().axes[None].copy()):
        for state in (driver.move(points, SPEED), driver.state()):
            assert state.mode is Mode.IN_POSITION
            assert state.at_rest
            assert state.axes.tolist() == points[-1].tolist()
            assert (from_rad(state.q) == points[-1]).all()
            assert (state.fault_code, state.fault_message) == (0, "")
            assert state.ack_result == state.done_result == Result.OK
            assert state.ack_sequence == state.done_sequence
        numbers.add(state.done_sequence)
    assert len(numbers) == 3


def test_invalid_moves_are_refused_and_nothing_moves(driver: Driver) -> None:
    """Other types and shapes than (N, 6) int32, one count beyond a limit, and speeds outside (0, 1]."""
    before = driver.state()
    for broken in (
        np.zeros((1, 6)),
        np.zeros((1, 6), dtype=np.int64),
        np.full((1, 6), np.nan),
        np.zeros(6, dtype=np.int32),
        np.zeros((1, 5), dtype=np.int32),
        np.zeros((0, 6), dtype=np.int32),
        [[0, 0, 0, 0, 0, 0]],
    ):
        with pytest.raises(SetPointError, match="must be"):
            driver.move(broken, SPEED)  # type: ignore[arg-type]
    for speed in (0.0, -0.1, 1.0001, float("nan"), float("inf")):
        with pytest.raises(RefusedError, match="speed fraction") as refused:
            driver.move(near(driver, 0.1), speed)
        assert refused.value.result == Result.SPEED
    for axis in range(6):
        for limit in (driver.capabilities.lower[axis] - 1, driver.capabilities.upper[axis] + 1):
            points = np.tile(before.axes, (3, 1))
            points[1, axis] = limit
            with pytest.raises(RefusedError, match=rf"via point 1 has A{axis + 1} at") as refused:
                driver.move(points, SPEED)
            assert refused.value.result == Result.LIMIT
    after = driver.state()
    assert after.axes.tolist() == before.axes.tolist()
    assert after.ack_sequence == before.ack_sequence


def test_stop_and_reset_at_rest_change_nothing(driver: Driver) -> None:
    """Stop and reset are always allowed, and the next move works."""
    driver.move(near(driver, 0.5), SPEED)
    before = driver.state()
    assert driver.stop().axes.tolist() == before.axes.tolist()
    assert driver.reset().axes.tolist() == before.axes.tolist()
    points = near(driver, 0.25)
    assert driver.move(points, SPEED).axes.tolist() == points[-1].tolist()


def test_a_closed_driver_can_be_connected_again(driver: Driver) -> None:
    """close() is allowed twice; then every use is an error; a new connection continues position and numbers."""
    last = driver.move(near(driver, 0.5), SPEED)
    driver.close()
    driver.close()
    goal = last.axes[None].copy()
    for use in (driver.state, driver.stop, driver.reset, lambda: driver.capabilities, lambda: driver.move(goal, SPEED)):
        with pytest.raises(NotConnectedError, match="connect"):
            use()
    driver.connect()
    driver.connect()
    assert driver.state().axes.tolist() == last.axes.tolist()
    assert driver.move(goal, SPEED).done_sequence > last.done_sequence


def test_capabilities(driver: Driver) -> None:
    """The capabilities have read-only int32 limits around the axes, positive steps and a speed fraction."""
    capabilities, axes = driver.capabilities, driver.state().axes
    assert ((capabilities.lower <= axes) & (axes <= capabilities.upper)).all()
    assert (capabilities.max_step > 0).all()
    assert 0 < capabilities.max_speed <= 1
    assert capabilities.controller
    for array in (capabilities.lower, capabilities.upper, capabilities.max_step, axes):
        assert array.dtype == np.int32
        assert not array.flags.writeable


@pytest.mark.parametrize("entry", URLS)
def test_an_unknown_option_is_refused(entry: str, url_of: Callable[[str], str]) -> None:
    """The message names the unknown option."""
    url = url_of(entry)
    with pytest.raises(DriverUrlError, match="no option 'no_such_option'"):
        open_driver(url + ("&" if "?" in url else "?") + "no_such_option=1", Context(KR16))
