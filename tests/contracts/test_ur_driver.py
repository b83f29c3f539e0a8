"""`ur://` on the emulated controller of Universal Robots: moves, stops, faults, owners, lost connections."""

import socket
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest

from drivers.clock import RealTimeClock
from drivers.contract import Mode, Result
from drivers.emulated.ur import UrController, UrServer
from drivers.errors import (
    AnswerTimeoutError,
    DriverError,
    DriverUrlError,
    EmergencyStopError,
    FaultError,
    LinkLostError,
    NotOwnerError,
    PathError,
    ProtocolError,
    RefusedError,
    StateUnknownError,
    StoppedError,
)
from drivers.registry import Context, open_driver
from drivers.setpoints import PER_DEGREE, from_rad, to_rad
from drivers.wires import ur_link
from tests.support.driver_bench import HOME_Q, KR16

pytestmark = pytest.mark.real_time

HOME = from_rad(HOME_Q)
NEAR = (np.stack([HOME, HOME]) + PER_DEGREE * np.array([[2, 0, 0, 0, 0, 3], [4, 1, -1, 2, 0, 3]])).astype(np.int32)
FAR = (HOME + PER_DEGREE * np.array([60, 0, 0, 0, 0, 0]))[None].astype(np.int32)


@dataclass
class Bench:
    """A served controller."""

    controller: UrController
    server: UrServer

    @property
    def url(self) -> str:
        """URL with a long answer time: the machine may be busy."""
        return f"{self.server.url}&timeout_ms=1000&watchdog_ms=3000"

    def when_moving(self, act: Callable[[], None]) -> threading.Thread:
        """Start a thread that acts once the arm is under way."""

        def wait_and_act() -> None:
            while abs(self.controller.values()["actual_q"][0] - HOME_Q[0]) < 0.01:
                threading.Event().wait(0.005)
            act()

        thread = threading.Thread(target=wait_and_act, daemon=True)
        thread.start()
        return thread


@pytest.fixture
def bench() -> Iterator[Bench]:
    """Serve a controller in a thread."""
    controller = UrController(HOME_Q.copy(), RealTimeClock())
    server, ended = UrServer(controller), threading.Event()
    thread = threading.Thread(target=server.serve, args=(ended.is_set,), daemon=True)
    thread.start()
    yield Bench(controller, server)
    ended.set()
    thread.join(10.0)
    server.close()


def test_moves_are_executed_point_by_point(bench: Bench) -> None:
    """The arm ends at the last via point; a first point at the present position takes no motion."""
    with open_driver(bench.url, Context(KR16)) as driver:
        assert driver.capabilities.hardware
        assert driver.state().axes.tolist() == HOME.tolist()
        state = driver.move(NEAR, 0.5)
        assert state.mode is Mode.IN_POSITION
        assert state.axes.tolist() == NEAR[-1].tolist()
        assert bench.controller.moves == 2
        state = driver.move(np.concatenate([NEAR[-1:], HOME[None]]), 1.0)
        assert state.axes.tolist() == HOME.tolist()
        assert bench.controller.moves == 3
        assert driver.state().owner != 0
    with open_driver(bench.url, Context(KR16)) as driver:
        assert driver.state().owner == 0


def test_a_stop_ends_the_move_on_its_path(bench: Bench) -> None:
    """The stop of another client stops the arm; the move names it."""
    with open_driver(bench.url, Context(KR16)) as driver, open_driver(bench.url, Context(KR16)) as other:
        thread = bench.when_moving(lambda: other.stop())
        with pytest.raises((StoppedError, DriverError), match=r"stopped|another client"):
            driver.move(FAR, 0.3)
        thread.join(5.0)
        state = other.state()
        assert state.at_rest
        assert 0 < state.axes[0] < FAR[0, 0]
        assert state.axes[1:].tolist() == HOME[1:].tolist()


@pytest.mark.parametrize(
    ("press", "error", "message"),
    [
        ("emergency_stop", EmergencyStopError, "emergency stop of the robot is pressed"),
        ("protective_stop", FaultError, "a protective stop is active"),
    ],
)
def test_a_safety_stop_ends_the_move_and_needs_a_reset(
    bench: Bench, press: str, error: type[FaultError], message: str
) -> None:
    """A reset is refused while the cause is active; after it the arm moves again."""
    with open_driver(bench.url, Context(KR16)) as driver:
        act = getattr(bench.controller, press)
        thread = bench.when_moving(act)
        with pytest.raises(error, match=message):
            driver.move(FAR, 0.3)
        thread.join(5.0)
        with pytest.raises(DriverError):
            driver.move(NEAR, 0.3)
        with pytest.raises(RefusedError, match=rf"{message}; clear it at the pendant"):
            driver.reset()
        act(False)
        with pytest.raises(RefusedError, match="was not reset"):
            driver.move(NEAR, 0.3)
        driver.stop()
        driver.reset()
        assert driver.move(HOME[None], 1.0).axes.tolist() == HOME.tolist()


@pytest.mark.parametrize(
    ("mode", "expected", "message"),
    [
        (2, Mode.IDLE, ""),
        (11, Mode.FAULT, "undefined"),
        (13, Mode.FAULT, "three-position enabling device"),
        (15, Mode.EMERGENCY_STOP, "emergency stop of the moulding machine"),
        (20, Mode.EMERGENCY_STOP, "PROFIsafe"),
        (22, Mode.FAULT, "safety mode is 22"),
    ],
)
def test_every_safety_mode_without_motion_is_a_fault(bench: Bench, mode: int, expected: Mode, message: str) -> None:
    """Only the modes normal and reduced run programs; modes that the driver does not know are faults too."""
    bench.controller.safety_mode = mode
    with open_driver(bench.url, Context(KR16)) as driver:
        state = driver.state()
        assert state.mode is expected
        assert message in state.fault_message
        assert bool(message) == bool(state.fault_message)


def test_angles_that_are_no_numbers_are_a_failure_of_the_wire(bench: Bench) -> None:
    """The client treats them as unreadable, as every answer that does not follow the protocol."""
    with open_driver(f"{bench.server.url}&timeout_ms=50&watchdog_ms=150", Context(KR16)) as driver:
        values = bench.controller.values
        bench.controller.values = lambda: values() | {"actual_q": (float("nan"),) * 6}  # type: ignore[method-assign]
        with pytest.raises(ProtocolError, match="sends impossible data"):
            driver.state()


def test_a_clock_that_stands_still_is_a_lost_line(bench: Bench) -> None:
    """Data of a controller whose time does not pass are no state of the arm; the wait for another one has an end."""
    with open_driver(f"{bench.server.url}&timeout_ms=50&watchdog_ms=150", Context(KR16)) as driver:
        values = bench.controller.values
        bench.controller.values = lambda: values() | {"timestamp": 1.0}  # type: ignore[method-assign]
        while driver.state().heartbeat != 1000:
            pass
        with pytest.raises(LinkLostError, match="heartbeat has not changed"):
            driver.require_ready()


def test_a_program_that_somebody_ends_is_a_stopped_move(bench: Bench) -> None:
    """The stop button of the pendant ends the program without a fault."""
    with open_driver(bench.url, Context(KR16)) as driver:
        thread = bench.when_moving(lambda: bench.controller._end_program())
        with pytest.raises(StoppedError, match="another client stopped the move"):
            driver.move(FAR, 0.3)
        thread.join(5.0)
        assert 0 < driver.state().axes[0] < FAR[0, 0]


def test_a_paused_program_is_held_and_goes_on(bench: Bench) -> None:
    """A person pauses and continues the program."""
    seen = []
    with open_driver(bench.url, Context(KR16)) as driver:

        def pause() -> None:
            bench.controller.is_paused = True
            with open_driver(bench.url, Context(KR16)) as watcher:
                threading.Event().wait(0.2)
                seen.append(watcher.state())
            bench.controller.is_paused = False

        thread = bench.when_moving(pause)
        assert driver.move(FAR, 1.0).axes.tolist() == FAR[0].tolist()
        thread.join(5.0)
    assert (seen[0].is_held, seen[0].at_rest, seen[0].mode, seen[0].queue_depth) == (True, True, Mode.IDLE, 1)


def test_a_silent_client_is_stopped_by_the_watchdog(bench: Bench) -> None:
    """The heartbeat ends with the client's process; the arm stops on its path."""
    url = bench.url.replace("timeout_ms=1000&watchdog_ms=3000", "timeout_ms=100&watchdog_ms=400")
    driver = open_driver(url, Context(KR16))
    driver.connect()
    driver.take()
    link = driver._link  # type: ignore[attr-defined]
    link.state()
    assert link.send(driver.state().ack_sequence + 1, _move(FAR, 0.2)).result == Result.OK
    with open_driver(bench.url, Context(KR16)) as other:
        until = time.monotonic() + 10.0
        while not (state := other.state()).at_rest and time.monotonic() < until:
            threading.Event().wait(0.02)
        assert state.at_rest
        assert 0 < state.axes[0] < FAR[0, 0]
        assert state.done_result == Result.STOPPED_BY_OTHER
    link.close()


def test_the_session_is_exclusive(bench: Bench) -> None:
    """Another client cannot write the input registers of the owner."""
    with open_driver(bench.url, Context(KR16)) as driver:
        driver.take()
        url = f"{bench.server.url}&timeout_ms=1600&watchdog_ms=5000"
        fast = Context(KR16, clock=RealTimeClock(5.0))  # the time that a client waits for another one passes sooner
        with open_driver(url, fast) as other, pytest.raises(NotOwnerError, match="owns the arm"):
            other.move(NEAR, 0.3)
        driver.move(NEAR, 0.5)
    with open_driver(bench.url, Context(KR16)) as other:
        assert other.move(HOME[None], 0.5).at_rest


def test_a_lost_connection_is_opened_again_during_a_move(bench: Bench) -> None:
    """The move ends as if nothing had happened."""
    with open_driver(bench.url, Context(KR16)) as driver:
        thread = bench.when_moving(bench.server.drop_connections)
        assert driver.move(FAR, 1.0).axes.tolist() == FAR[0].tolist()
        thread.join(5.0)


@pytest.mark.parametrize("cause", ["local control", "brakes"])
def test_a_controller_that_runs_no_program(bench: Bench, cause: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing moves; the message names what to check."""
    monkeypatch.setattr(ur_link, "_PROGRAM_START", 0.1)
    with open_driver(bench.url.replace("timeout_ms=1000", "timeout_ms=200"), Context(KR16)) as driver:
        if cause == "local control":
            bench.controller.is_remote = False
            with pytest.raises(StateUnknownError, match="remote control"):
                driver.move(NEAR, 0.3)
        else:
            bench.controller.robot_mode = 5
            with pytest.raises(DriverError, match="has its brakes on"):
                driver.move(NEAR, 0.3)
    assert bench.controller.moves == 0


def test_an_arm_that_skips_a_via_point_is_stopped(bench: Bench) -> None:
    """The path is watched over this wire too."""
    detour = np.stack([FAR[0], HOME, FAR[0]])
    run = bench.controller.run

    def skip(source: str) -> bool:
        lines = source.splitlines(keepends=True)
        legs = [k for k, line in enumerate(lines) if line.startswith("movej")]
        return run("".join(line for k, line in enumerate(lines) if len(legs) < 3 or k not in legs[1:]))

    bench.controller.run = skip  # type: ignore[method-assign]
    with open_driver(bench.url, Context(KR16)) as driver, pytest.raises((PathError, DriverError)):
        driver.move(detour, 1.0)


def test_urls_and_missing_controllers(bench: Bench) -> None:
    """One sentence each."""
    for url in ("ur://", "ur://127.0.0.1:30004", "ur://127.0.0.1/x"):
        with pytest.raises(DriverUrlError, match="must name a host without port or path"):
            open_driver(url, Context(KR16))
    table = replace(
        KR16,
        **{name: np.append(getattr(KR16, name), getattr(KR16, name)[-1]) for name in
           ("lower", "upper", "velocity", "acceleration", "max_step", "jerk", "path_tolerance")},
    )  # fmt: skip
    with pytest.raises(DriverUrlError, match="turns no rotary table"):
        open_driver("ur://127.0.0.1", Context(table))
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        url = f"ur://127.0.0.1?rtde_port={unused.getsockname()[1]}"
        with pytest.raises(LinkLostError, match="cannot be opened: connection refused; check address"):
            open_driver(url, Context(KR16)).connect()


def test_something_else_that_answers(bench: Bench) -> None:
    """The script port answers no RTDE request."""
    port = bench.url.split("script_port=")[1].split("&")[0]
    url = f"ur://127.0.0.1?rtde_port={port}&timeout_ms=100"
    with pytest.raises((AnswerTimeoutError, LinkLostError)):
        open_driver(url, Context(KR16)).connect()


def _move(set_points: np.ndarray, speed: float) -> object:
    from drivers.contract import Move

    assert to_rad(set_points).shape[1] == 6
    return Move(set_points, speed)
