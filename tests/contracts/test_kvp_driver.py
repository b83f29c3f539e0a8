"""`kvp://` on an emulated KUKA controller that runs the generated KRL program: moves, stops, faults, owners, cuts."""

import contextlib
import re
import socket
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from drivers.clock import RealTimeClock
from drivers.contract import Fault, Mode, Result
from drivers.emulated import krl
from drivers.emulated.kvp import KukaController, KvpStation
from drivers.emulated.serve import Server, TcpLine
from drivers.errors import (
    AnswerTimeoutError,
    DriverError,
    DriverUrlError,
    EmergencyStopError,
    LinkLostError,
    NotOwnerError,
    ProtocolError,
    RefusedError,
    StateUnknownError,
    StoppedError,
)
from drivers.registry import Context, DriverUrl
from drivers.setpoints import PER_DEGREE, from_rad
from drivers.wires import kvp, kvp_link
from drivers.wires.kvp_link import KvpDriver, KvpLine
from tests.support.driver_bench import HOME_Q, KR16, Journal

pytestmark = pytest.mark.real_time

HOME = from_rad(HOME_Q)
NEAR = (np.stack([HOME, HOME]) + PER_DEGREE * np.array([[2, 0, 0, 0, 0, 3], [4, 1, -1, 2, 0, 3]])).astype(np.int32)
FAR = (HOME + PER_DEGREE * np.array([60, 0, 0, 0, 0, 0]))[None].astype(np.int32)


def driver_of(url: str) -> KvpDriver:
    """Return the driver of a URL."""
    return KvpDriver.from_url(DriverUrl(url), Context(KR16))


@dataclass
class Bench:
    """A served controller."""

    controller: KukaController
    line: TcpLine
    journal: Journal

    @property
    def url(self) -> str:
        """URL with a long answer time: the machine may be busy."""
        return f"kvp://{self.line.name}?timeout_ms=1000&watchdog_ms=3000"

    def when_moving(self, act: Callable[[], object]) -> threading.Thread:
        """Start a thread that acts once the arm is under way."""

        def wait_and_act() -> None:
            while abs(self.controller.variables["$AXIS_ACT"].A1) < 0.5:
                threading.Event().wait(0.005)
            act()

        thread = threading.Thread(target=wait_and_act, daemon=True)
        thread.start()
        return thread

    def wait_for_rest(self) -> None:
        """Wait until a braking arm is at rest."""
        deadline = time.monotonic() + 60
        while not self.controller.variables["$ROB_STOPPED"]:
            assert time.monotonic() < deadline
            time.sleep(0.005)


class SlowStation(KvpStation):
    """A proxy that needs some time for each answer."""

    def answer(self, packet: bytes) -> bytes:
        """Return the answer to a request."""
        threading.Event().wait(0.005)
        return super().answer(packet)


@pytest.fixture
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    """Serve a controller in a thread."""
    clock, journal = RealTimeClock(), Journal()
    controller, line = KukaController(HOME_Q.copy(), KR16, clock, journal), TcpLine()
    server, ended = Server(getattr(request, "param", KvpStation)(controller), line, clock), threading.Event()
    thread = threading.Thread(target=server.serve, args=(ended.is_set,), daemon=True)
    thread.start()
    yield Bench(controller, line, journal)
    ended.set()
    thread.join(10.0)
    line.close()


def test_moves_are_executed_point_by_point(bench: Bench) -> None:
    """The program drives to every via point of the plan to the last digit; the limits are the controller's."""
    with driver_of(bench.url) as driver:
        assert driver.capabilities.lower.tolist() == KR16.lower.tolist()
        assert "other clients" in driver.capabilities.not_reported
        assert "cancel or reset the program" in driver.capabilities.not_reported
        state = driver.move(NEAR, 0.5)
        assert (state.mode, state.axes.tolist()) == (Mode.IN_POSITION, NEAR[-1].tolist())
        many = np.linspace(NEAR[-1], HOME, 25).astype(np.int32)
        assert driver.move(many, 1.0).axes.tolist() == HOME.tolist()
        assert [move["set_points"] for move in bench.journal.of("move")] == [NEAR.tolist(), many.tolist()]
        assert driver.state().owner != 0
    with driver_of(bench.url) as driver:
        assert driver.state().owner == 0


def test_narrower_limits_of_the_controller_refuse_a_move(bench: Bench) -> None:
    """Nothing is sent."""
    bench.controller.variables["$SOFTP_END"][1] = 30.0
    with driver_of(bench.url) as driver, pytest.raises(RefusedError, match=r"A1 at 60.0000 deg"):
        driver.move(FAR, 0.3)
    assert bench.journal.of("move") == []


def test_a_speed_below_a_percent_is_refused(bench: Bench) -> None:
    """The controller's speeds are whole percents, never rounded up."""
    with driver_of(bench.url) as driver, pytest.raises(RefusedError, match="speed fraction"):
        driver.move(NEAR, 0.009)
    assert bench.journal.of("move") == []


def test_a_stop_of_another_client_ends_move_and_session(bench: Bench) -> None:
    """The arm stops on its path, and the motion does not continue."""
    with driver_of(bench.url) as driver, driver_of(bench.url) as other:
        thread = bench.when_moving(other.stop)
        with pytest.raises((StoppedError, DriverError), match=r"stopped|another client"):
            driver.move(FAR, 0.3)
        thread.join(5.0)
        state = other.state()
        assert state.at_rest
        assert 0 < state.axes[0] < FAR[0, 0]
        assert state.axes[1:].tolist() == HOME[1:].tolist()
        threading.Event().wait(0.2)
        assert other.state().axes.tolist() == state.axes.tolist()
        assert state.done_result == Result.STOPPED_BY_OTHER


def test_an_emergency_stop_ends_the_move_and_needs_a_reset(bench: Bench) -> None:
    """The program, started again after it, does not continue the motion."""
    with driver_of(bench.url) as driver:
        thread = bench.when_moving(bench.controller.emergency_stop)
        with pytest.raises(EmergencyStopError, match="emergency stop is pressed"):
            driver.move(FAR, 0.3)
        thread.join(5.0)
        with pytest.raises(DriverError):
            driver.move(NEAR, 0.3)
        bench.controller.emergency_stop(False)
        with pytest.raises(RefusedError, match="emergency stop"):
            driver.move(NEAR, 0.3)
        stopped = driver.stop()
        assert 0 < stopped.axes[0] < FAR[0, 0]
        driver.reset()
        assert driver.move(HOME[None], 1.0).axes.tolist() == HOME.tolist()


def test_a_stopped_program_is_held_and_goes_on(bench: Bench) -> None:
    """A person presses the stop key, then starts the program."""
    seen = []
    with driver_of(bench.url) as driver:

        def pause() -> None:
            bench.controller.stop_program()
            with driver_of(bench.url) as watcher:
                bench.wait_for_rest()
                seen.append(watcher.state())
            bench.controller.stop_program(False)

        thread = bench.when_moving(pause)
        assert driver.move(FAR, 1.0).axes.tolist() == FAR[0].tolist()
        thread.join(5.0)
    assert (seen[0].is_held, seen[0].at_rest, seen[0].mode, seen[0].queue_depth) == (True, True, Mode.IDLE, 1)


def test_a_program_that_does_not_run_is_named(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """The message names the program and its state."""
    monkeypatch.setattr(kvp_link, "_PROGRAM_ANSWER", 0.1)
    bench.controller.stop_program()
    url = bench.url.replace("timeout_ms=1000&watchdog_ms=3000", "timeout_ms=200&watchdog_ms=1000")
    with driver_of(url) as driver, pytest.raises(DriverError, match=r"sc_kvp does not .*#P_STOP"):
        driver.move(NEAR, 0.3)
    assert bench.journal.of("move") == []


def test_a_silent_client_is_stopped_by_the_timer(bench: Bench) -> None:
    """The interrupt of the timer brakes; only a reset clears the fault."""
    driver = driver_of(bench.url.replace("timeout_ms=1000&watchdog_ms=3000", "timeout_ms=100&watchdog_ms=400"))
    driver.connect()
    driver.take()
    thread = threading.Thread(target=_ignore, args=(lambda: driver.move(FAR, 0.2),), daemon=True)
    driver._link._proxy.write("$TIMER[10]", "-400")  # type: ignore[attr-defined]
    silence = threading.Event()

    def never() -> None:
        silence.wait(10.0)
        raise LinkLostError("the test has cut the link")

    cut = bench.when_moving(lambda: setattr(driver._link, "_read_state", never))  # type: ignore[attr-defined]
    thread.start()
    cut.join(5.0)
    with driver_of(bench.url) as other:
        until = time.monotonic() + 10.0
        while not ((state := other.state()).fault_code and state.at_rest) and time.monotonic() < until:
            threading.Event().wait(0.02)
        assert (state.at_rest, state.fault_code) == (True, Fault.WATCHDOG)
        assert 0 < state.axes[0] < FAR[0, 0]
        other.take()
        other.reset()
        assert other.move(HOME[None], 1.0).at_rest
    driver._link.close()  # a client that is silent leaves no connection behind
    silence.set()
    thread.join(5.0)


@pytest.mark.parametrize("bench", [SlowStation], indirect=True)
def test_the_heartbeat_goes_on_while_points_are_written(bench: Bench) -> None:
    """Writing the via points takes longer than the watchdog."""
    url = bench.url.replace("timeout_ms=1000&watchdog_ms=3000", "timeout_ms=130&watchdog_ms=400")
    many = (HOME + np.arange(1, 121)[:, None] * np.array([20, 0, 0, 0, 0, 0])).astype(np.int32)
    with driver_of(url) as driver:
        assert driver.move(many, 1.0).axes.tolist() == many[-1].tolist()
        assert bench.journal.of("fault") == []


def test_an_answer_has_one_deadline_and_the_second_late_one_closes_the_connection() -> None:
    """A proxy that sends single bytes is given up; a new connection begins at a whole message."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        line = KvpLine("127.0.0.1", server.getsockname()[1], 0.3)
        line.open()
        proxy, _ = server.accept()
        is_over = threading.Event()

        def drip() -> None:
            for value in kvp.answer(1, kvp.READ, "100", success=True) * 2:
                if is_over.wait(0.1):
                    return
                with contextlib.suppress(OSError):
                    proxy.send(bytes([value]))

        thread = threading.Thread(target=drip, daemon=True)
        thread.start()
        for is_open in (True, False):
            began = time.monotonic()
            with pytest.raises(AnswerTimeoutError, match=r"gave no answer about \$OV_PRO"):
                line.read("$OV_PRO")
            assert time.monotonic() - began < 0.6
            assert line.is_open == is_open
        with pytest.raises(LinkLostError, match="is not open"):
            line.read("$OV_PRO")
        is_over.set()
        thread.join(10.0)
        proxy.close()
        line.open()
        proxy, _ = server.accept()
        proxy.sendall(kvp.answer(3, kvp.READ, "100", success=True))
        assert line.read("$OV_PRO") == "100"

        def fill() -> None:
            for number in range(4, 500):  # a proxy that reads nothing: at some time only a part of a request is sent
                proxy.sendall(kvp.answer(number, kvp.WRITE, "", success=True))
                line.write("A", "1" * 60_000)

        with pytest.raises(AnswerTimeoutError):
            fill()
        assert not line.is_open
        proxy.close()
        line.close()


def test_the_session_is_exclusive(bench: Bench) -> None:
    """The program refuses the arm to a second client, and orders of other sessions move nothing."""
    with driver_of(bench.url) as driver:
        driver.take()
        url = bench.url.replace("timeout_ms=1000&watchdog_ms=3000", "timeout_ms=1600&watchdog_ms=5000")
        fast = Context(KR16, clock=RealTimeClock(5.0))  # the time that a client waits for another one passes sooner
        with KvpDriver.from_url(DriverUrl(url), fast) as other:
            bench.controller.variables["$TIMER_STOP"][10] = True  # the owner stays active
            with pytest.raises(NotOwnerError, match="owns the arm"):
                other.move(NEAR, 0.3)
            other._link._proxy.write(  # type: ignore[attr-defined]
                "SC_ORDER", "{SC_ORDER_T: SESSION 1,NUMBER 9,KIND 1,COUNT 1,SPEED 10}"
            )
        driver.move(NEAR, 0.5)
        assert len(bench.journal.of("move")) == 1


def test_a_lost_connection_is_opened_again_during_a_move(bench: Bench) -> None:
    """The move ends as if nothing had happened."""
    with driver_of(bench.url) as driver:
        thread = bench.when_moving(bench.line.drop_connections)
        assert driver.move(FAR, 1.0).axes.tolist() == FAR[0].tolist()
        thread.join(5.0)


def test_a_restarted_program_is_a_fault(bench: Bench) -> None:
    """A program that is started again forgets its order and names it."""
    with driver_of(bench.url) as driver:

        def restart() -> None:
            bench.controller.brake_for_restart()
            bench.wait_for_rest()
            bench.controller.restart()

        thread = bench.when_moving(restart)
        with pytest.raises((DriverError, StateUnknownError), match="restarted"):
            driver.move(FAR, 0.3)
        thread.join(5.0)
        assert 0 < driver.stop().axes[0] < FAR[0, 0]
        driver.reset()
        assert driver.move(NEAR, 0.5).at_rest


def test_order_without_its_points_is_refused(bench: Bench) -> None:
    """The program compares session and number of each via point."""
    with driver_of(bench.url) as driver:
        driver.take()
        link = driver._link
        link._proxy.write(  # type: ignore[attr-defined]
            "SC_ORDER",
            f"{{SC_ORDER_T: SESSION {driver._ledger.session},NUMBER 1,KIND 1,COUNT 2,SPEED 10}}",
        )
        threading.Event().wait(0.2)
        assert (driver.state().ack_sequence, driver.state().ack_result) == (1, Result.INCOMPLETE)
    assert bench.journal.of("move") == []


def test_urls_and_missing_controllers() -> None:
    """One sentence each."""
    for url in ("kvp://", "kvp://127.0.0.1:7000/x"):
        with pytest.raises(DriverUrlError, match="must name a host, and may name a port"):
            driver_of(url)
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        with pytest.raises(LinkLostError, match="cannot be opened: connection refused; check address"):
            driver_of(f"kvp://127.0.0.1:{unused.getsockname()[1]}").connect()


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [("$AXIS_ACT", "A1 1E9", "reports impossible values"), ("SC_STATE", "PASSED 1E400", "put the program there again")],
)
def test_numbers_that_no_field_holds_are_a_failure_of_the_wire(bench: Bench, name: str, text: str, words: str) -> None:
    """The client treats them as unreadable; nothing is converted to another number."""
    with driver_of(f"kvp://{bench.line.name}?timeout_ms=50&watchdog_ms=150") as driver:
        read = bench.controller.read

        def falsified(variable: str) -> str | None:
            value = read(variable)
            return value and re.sub(rf"{text.split()[0]} [^,}}]+", text, value) if variable == name else value

        bench.controller.read = falsified  # type: ignore[method-assign]
        with pytest.raises(ProtocolError, match=words):
            driver.state()


def test_messages_are_those_of_the_public_format() -> None:
    """A reading and a writing, byte by byte, and a stream that is cut."""
    read = bytes.fromhex("0007 0009 00 0006") + b"$OV_PR"
    assert kvp.request(7, "$OV_PR") == read
    written = kvp.request(8, "A", "12")
    assert written == bytes.fromhex("0008 0008 01 0001") + b"A" + bytes.fromhex("0002") + b"12"
    assert kvp.answer(7, 0, "100", success=True) == bytes.fromhex("0007 0009 00 0003") + b"100" + b"\0\1\1"
    messages, rest = kvp.split(read + written[:5])
    assert (len(messages), rest) == (1, written[:5])
    assert kvp.parse_answer(messages[0][1]) == ("$OV_PR", False)


def test_values_of_krl() -> None:
    """Aggregates, also nested ones, and values that are none."""
    point = krl.parse("{SC_POINT_T: SESSION 3,NUMBER 4,AXES {E6AXIS: A1 -1.5,A2 2}}")
    assert (point.SESSION, point.AXES.A1, krl.render(point.AXES)) == (3, -1.5, "{A1 -1.5,A2 2}")
    for text in ("", "{A1 1", "1 2", "{A1: }}"):
        with pytest.raises(ValueError, match=r"value|aggregate|end"):
            krl.parse(text)


def _ignore(act: Callable[[], object]) -> None:
    with contextlib.suppress(DriverError):
        act()
