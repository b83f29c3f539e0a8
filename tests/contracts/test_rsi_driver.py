"""`rsi://` on an emulated KUKA controller: corrections of every cycle, holds, late telegrams, ends."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from drivers.clock import RealTimeClock
from drivers.contract import Fault, Mode, Move
from drivers.emulated.faults import Injector, parse_faults
from drivers.emulated.rsi import RsiController
from drivers.errors import DriverError, DriverUrlError, FaultError, LinkError, LinkLostError, StoppedError
from drivers.registry import Context, DriverUrl
from drivers.setpoints import PER_DEGREE, from_rad
from drivers.wires import rsi
from drivers.wires.rsi_link import RsiDriver
from drivers.wires.rsi_stream import RAMP, Stream
from tests.support.driver_bench import HOME_Q, KR16

pytestmark = pytest.mark.real_time

HOME = from_rad(HOME_Q)
NEAR = (np.stack([HOME, HOME]) + PER_DEGREE * np.array([[2, 0, 0, 0, 0, 3], [4, 1, -1, 2, 0, 3]])).astype(np.int32)
FAR = (HOME + PER_DEGREE * np.array([40, 0, 0, 0, 0, 0]))[None].astype(np.int32)

KILLED = """
import sys
import numpy as np
from drivers.registry import Context, DriverUrl
from drivers.wires.rsi_link import RsiDriver
from tests.support.driver_bench import KR16
with RsiDriver.from_url(DriverUrl(sys.argv[1]), Context(KR16)) as driver:
    driver.move(np.array([[int(value) for value in sys.argv[2].split(",")]], dtype=np.int32), 0.2)
"""


@dataclass
class Bench:
    """A served controller."""

    controller: RsiController
    notes: list[str] = field(default_factory=list)
    start: np.ndarray = field(default_factory=lambda: HOME[None])

    def driver(self) -> RsiDriver:
        """Return a driver with a long answer time: the machine may be busy."""
        url = f"{self.controller.url}?timeout_ms=1000&watchdog_ms=3000&wait_s=5"
        return RsiDriver.from_url(DriverUrl(url), Context(KR16, notify=self.notes.append))

    def when_moving(self, act: Callable[[], object]) -> threading.Thread:
        """Start a thread that acts once the arm is under way."""

        def wait_and_act() -> None:
            while abs(self.controller.axes[0]) < 0.5:
                threading.Event().wait(0.002)
            act()

        thread = threading.Thread(target=wait_and_act, daemon=True)
        thread.start()
        return thread

    def deviation_deg(self, points: np.ndarray) -> float:
        """Return the largest sum of axis distances of an executed position from a path of counts."""
        path = np.concatenate([self.start, points]) / PER_DEGREE
        a, along = path[:-1], np.diff(path, axis=0)
        ahead = np.array(self.controller.driven)[:, None] - a
        s = np.clip((ahead * along).sum(axis=2) / np.maximum((along**2).sum(axis=1), 1e-12), 0.0, 1.0)
        return float(np.abs(ahead - s[..., None] * along).sum(axis=2).min(axis=1).max())


@pytest.fixture(params=[4, 12])
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    """Serve a controller in a thread."""
    with serve(HOME_Q.copy(), request.param) as served:
        yield served


@contextlib.contextmanager
def serve(q: np.ndarray, cycle_ms: int = 12, injector: Injector | None = None, lag: int = 0) -> Iterator[Bench]:
    """Serve a controller at (6,) axes [rad] in a thread."""
    controller = RsiController(q, RealTimeClock(), cycle_ms=cycle_ms, injector=injector, lag=lag)
    ended = threading.Event()
    thread = threading.Thread(target=controller.serve, args=(ended.is_set,), daemon=True)
    thread.start()
    yield Bench(controller)
    ended.set()
    thread.join(10.0)
    controller.close()


def test_moves_follow_their_path(bench: Bench) -> None:
    """Every position of a cycle is on the straight joint segments; the end is exact."""
    with bench.driver() as driver:
        assert "late answers" in driver.capabilities.not_reported
        state = driver.move(NEAR, 0.5)
        assert (state.mode, state.axes.tolist()) == (Mode.IN_POSITION, NEAR[-1].tolist())
        assert bench.deviation_deg(NEAR) < 1e-5
        assert driver.move(HOME[None], 1.0).axes.tolist() == HOME.tolist()
    np.testing.assert_allclose(bench.controller.axes, np.degrees(HOME_Q), atol=1e-6)
    assert bench.controller.ended == {"client": 1, "timeout": 0, "emergency stop": 0}


def test_a_second_client_begins_where_the_first_one_ended(bench: Bench) -> None:
    """Corrections count from the axes at the beginning of RSI."""
    with bench.driver() as driver:
        driver.move(NEAR, 1.0)
    with bench.driver() as driver:
        assert driver.state().axes.tolist() == NEAR[-1].tolist()
        assert driver.move(HOME[None], 1.0).axes.tolist() == HOME.tolist()


def test_a_client_ends_with_its_session(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody starts the program again: the process of the telegrams does not wait for the silence of 3 s."""
    monkeypatch.setattr("drivers.emulated.rsi._RESTART", 60.0)
    with serve(HOME_Q.copy()) as bench:
        driver = bench.driver()
        driver.connect()
        began = time.monotonic()
        driver.close()
        assert time.monotonic() - began < 2.0
        assert bench.controller.ended == {"client": 1, "timeout": 0, "emergency stop": 0}


def test_a_stop_ends_the_move_on_its_path(bench: Bench) -> None:
    """The stop of another thread."""
    with bench.driver() as driver:
        thread = bench.when_moving(driver.stop)
        with pytest.raises(StoppedError):
            driver.move(FAR, 0.3)
        thread.join(5.0)
        state = driver.state()
        assert state.at_rest
        assert 0 < state.axes[0] < FAR[0, 0]
        assert bench.deviation_deg(FAR) < 1e-5


def test_a_pause_of_the_process_delays_the_move(bench: Bench) -> None:
    """Late telegrams are left out: the arm pauses on its path, goes on, and the client is notified."""
    with bench.driver() as driver:
        process = driver._link._process  # type: ignore[attr-defined]

        def freeze() -> None:
            os.kill(process.pid, signal.SIGSTOP)
            threading.Event().wait(0.2)
            os.kill(process.pid, signal.SIGCONT)

        thread = bench.when_moving(freeze)
        assert driver.move(FAR, 0.5).axes.tolist() == FAR[0].tolist()
        thread.join(5.0)
        late, counted = driver._link.late_telegrams()  # type: ignore[attr-defined]
        assert late >= 10
        assert counted >= 10
    assert bench.deviation_deg(FAR) < 1e-5
    assert "late; the arm paused" in bench.notes[0]
    steps = np.abs(np.diff([axes[0] for axes in bench.controller.driven]))
    full_deg = np.degrees(KR16.velocity[0]) * 0.5 * bench.controller.cycle_ms / 1000.0
    assert steps.max() <= full_deg * 1.001


def test_a_controller_that_ends_rsi_is_named(bench: Bench) -> None:
    """After an emergency stop no telegram comes; the move ends by name, and the next connection drives on."""
    url = f"{bench.controller.url}?timeout_ms=100&watchdog_ms=400&wait_s=5"
    with RsiDriver.from_url(DriverUrl(url), Context(KR16)) as driver:
        thread = bench.when_moving(bench.controller.emergency_stop)
        with pytest.raises(FaultError, match=r"no telegram for 0.4 s: start sc_rsi"):
            driver.move(FAR, 0.3)
        thread.join(5.0)
        with pytest.raises(DriverError, match="start sc_rsi"):
            driver.reset()
    assert 0.0 < bench.controller.axes[0] < 40.0
    bench.controller.emergency_stop(False)
    with bench.driver() as driver:
        assert driver.move(HOME[None], 1.0).axes.tolist() == HOME.tolist()


def test_a_killed_client_leaves_an_arm_that_stops_on_its_path(bench: Bench) -> None:
    """The process of the telegrams brakes, ends RSI and ends."""
    goal = ",".join(map(str, FAR[0].tolist()))
    client = subprocess.Popen([sys.executable, "-c", KILLED, bench.controller.url, goal])
    while bench.controller.axes[0] < 1.0 and client.poll() is None:
        threading.Event().wait(0.005)
    client.kill()
    client.wait()
    until = time.monotonic() + 10.0
    while not bench.controller.ended["client"] and time.monotonic() < until:
        threading.Event().wait(0.01)
    stopped = bench.controller.axes.copy()
    assert 1.0 <= stopped[0] < 40.0
    assert bench.controller.ended["client"] == 1
    assert bench.deviation_deg(FAR) < 1e-5
    with bench.driver() as driver:
        assert driver.move(HOME[None], 1.0).at_rest


def test_a_new_client_waits_for_the_end_of_an_old_session(bench: Bench) -> None:
    """If the process of the telegrams is killed, its session goes on until the controller ends it: no jump."""
    with bench.driver() as driver:
        driver.move(NEAR, 1.0)
        process = driver._link._process  # type: ignore[attr-defined]
        process.kill()
        process.wait()
        threading.Event().wait(0.05)
        with bench.driver() as other:
            assert bench.controller.ended["timeout"] == 1
            assert other.state().axes.tolist() == NEAR[-1].tolist()
            bench.controller.driven.clear()
            assert other.move(HOME[None], 1.0).axes.tolist() == HOME.tolist()
    steps = np.abs(np.diff(np.concatenate([NEAR[-1:] / PER_DEGREE, bench.controller.driven]), axis=0))
    assert steps.max() < 2.0


def test_a_session_that_a_pause_has_kept_alive_is_continued(bench: Bench) -> None:
    """A new client reads the applied corrections, so the arm does not jump back to the beginning of RSI."""
    with bench.driver() as driver:
        driver.move(NEAR, 1.0)
        bench.controller.pause(1.5)
        driver._link._process.kill()  # type: ignore[attr-defined]
        with bench.driver() as other:
            assert other.state().axes.tolist() == NEAR[-1].tolist()
            bench.controller.driven.clear()
            assert other.move(HOME[None], 1.0).axes.tolist() == HOME.tolist()
    steps = np.abs(np.diff(np.concatenate([NEAR[-1:] / PER_DEGREE, bench.controller.driven]), axis=0))
    assert steps.max() < 2.0


def test_an_arm_outside_its_limits_is_not_driven() -> None:
    """Its axis is named, no correction is sent, and RSI is ended; a rounding error is allowed."""
    outside = np.degrees(HOME_Q)
    outside[0] = KR16.upper[0] / PER_DEGREE + 3.0
    with serve(np.radians(outside)) as bench:
        with pytest.raises(LinkError, match=r"axis A1 is at .* deg, outside its limits of .*; drive it inside"):
            bench.driver().connect()
        assert bench.controller.driven == []
        assert bench.controller.ended == {"client": 1, "timeout": 0, "emergency stop": 0}
    outside[0] -= 2.9999
    with serve(np.radians(outside)) as bench, bench.driver() as driver:
        assert driver.state().axes[0] == KR16.upper[0]
        assert np.abs(np.diff([outside, *bench.controller.driven], axis=0)).max(initial=0.0) < 2e-4


def with_cycles(values: list[int]) -> list[object]:
    """Return parameters (cycle [ms], value): in the default suite each value with one cycle, slow with the other."""
    return [
        pytest.param(cycle_ms, value, marks=() if k % 2 == (cycle_ms == 12) else pytest.mark.slow)
        for k, value in enumerate(values)
        for cycle_ms in (4, 12)
    ]


@pytest.mark.parametrize(("bench", "count"), with_cycles([1, 2, 20, 60]), indirect=["bench"])
def test_rejected_answers_are_repeated(bench: Bench, count: int) -> None:
    """The step between two accepted corrections never exceeds the speed limit; the path goes on from rest."""
    seen = []
    goal = (HOME + PER_DEGREE * np.array([110, 0, 0, 0, 0, 0]))[None].astype(np.int32)
    cycle = bench.controller.cycle_ms / 1000.0
    full_deg = np.degrees(KR16.velocity[0]) * cycle
    with bench.driver() as driver:

        def is_at_full_speed() -> bool:  # not on a machine under load, which has lost answers of its own just before
            driven_deg = np.reshape(bench.controller.driven[-3:], (-1, 6))[:, 0]
            if len(driven_deg) < 3 or driven_deg[-1] < 55.0 or np.diff(driven_deg).min() <= 0.95 * full_deg:
                return False
            seen.append(len(bench.controller.driven))
            return True

        bench.controller.lose_answers(count, when=is_at_full_speed)
        assert driver.move(goal, 1.0).axes.tolist() == goal[0].tolist()
        assert driver._link.late_telegrams()[1] >= count  # type: ignore[attr-defined]
    assert bench.deviation_deg(goal) < 1e-5
    steps = np.abs(np.diff(np.array([np.degrees(HOME_Q), *bench.controller.driven])[:, 0]))
    assert steps.max() <= full_deg * (1.0 + 1e-6)
    assert steps[seen[0] - 2] > 0.9 * full_deg  # lost at full speed
    assert steps[seen[0] - 1 : seen[0] + 3].min() <= full_deg * cycle / RAMP * (1.0 + 1e-6)


def test_a_silent_client_is_a_fault() -> None:
    """The process of the telegrams brakes the arm of a client that hangs during a move; a reset clears it."""
    with serve(HOME_Q.copy(), 4) as bench:
        goal = ",".join(map(str, FAR[0].tolist()))
        url = f"{bench.controller.url}?timeout_ms=100&watchdog_ms=300"
        client = subprocess.Popen([sys.executable, "-c", KILLED, url, goal], stderr=subprocess.PIPE, text=True)
        while bench.controller.axes[0] < 1.0 and client.poll() is None:
            threading.Event().wait(0.005)
        os.kill(client.pid, signal.SIGSTOP)
        threading.Event().wait(1.2)
        stopped = bench.controller.axes.copy()
        threading.Event().wait(0.3)
        assert bench.controller.axes.tolist() == stopped.tolist()
        assert 1.0 <= stopped[0] < 30.0
        os.kill(client.pid, signal.SIGCONT)
        _, message = client.communicate(timeout=20.0)
        assert "FaultError" in message
        assert "the heartbeat of the client was lost" in message
        assert bench.deviation_deg(FAR) < 1e-5


@pytest.mark.parametrize(("bench", "cycles"), with_cycles([10, 60]), indirect=["bench"])
def test_a_restart_without_late_answers_is_found(bench: Bench, cycles: int) -> None:
    """The clock has jumped, and the controller has not counted the missed answers: it is another session."""
    cycle_s = bench.controller.cycle_ms / 1000.0
    with bench.driver() as driver:

        def restart() -> None:
            bench.controller.emergency_stop()
            threading.Event().wait(cycles * cycle_s)
            bench.controller.driven.clear()
            bench.controller.emergency_stop(False)

        thread = bench.when_moving(restart)
        with pytest.raises(FaultError, match=r"the controller has started RSI again: start sc_rsi"):
            driver.move(FAR, 0.3)
        thread.join(5.0)
        stopped = bench.controller.axes.copy()
        assert bench.controller.driven == []
        with pytest.raises(DriverError, match="start sc_rsi"):
            driver.reset()
    assert bench.controller.axes.tolist() == stopped.tolist()
    with bench.driver() as driver:
        assert driver.move(HOME[None], 1.0).axes.tolist() == HOME.tolist()


def test_a_restart_after_the_arm_was_moved_by_hand_is_found(bench: Bench) -> None:
    """The corrections are zero before and after: the axes tell that the session is another one."""
    with bench.driver() as driver:
        assert driver.state().at_rest
        bench.controller.emergency_stop()
        threading.Event().wait(20 * bench.controller.cycle_ms / 1000.0)
        bench.controller.axes = bench.controller.axes + 0.5
        bench.controller.emergency_stop(False)
        threading.Event().wait(0.1)
        with pytest.raises(DriverError, match="the controller has started RSI again"):
            driver.move(NEAR, 0.3)
    assert bench.controller.driven == []


@pytest.mark.parametrize(("cycle_ms", "lag", "seconds"), [(4, 0, 0.1), (12, 0, 0.1), (4, 15, 0.03), (12, 10, 0.07)])
def test_missed_answers_that_are_counted_later_are_no_restart(cycle_ms: int, lag: int, seconds: float) -> None:
    """A controller may count them when it is answered again: its corrections are still the same.

    The axes that it reports may be behind.
    """
    with serve(HOME_Q.copy(), cycle_ms, lag=lag) as bench, bench.driver() as driver:
        process = driver._link._process  # type: ignore[attr-defined]

        def freeze() -> None:
            late, count = bench.controller.late, bench.controller.count_late
            bench.controller.count_late = lambda: None
            os.kill(process.pid, signal.SIGSTOP)
            threading.Event().wait(seconds)
            os.kill(process.pid, signal.SIGCONT)
            threading.Event().wait(0.05)
            bench.controller.count_late = count
            bench.controller.late = late + 8

        thread = bench.when_moving(freeze)
        assert driver.move(FAR, 0.3).axes.tolist() == FAR[0].tolist()
        thread.join(5.0)
    assert bench.deviation_deg(FAR) < 1e-5


class Wire:
    """A stream between a socket of lists and a client that says nothing, without time or processes."""

    def __init__(self) -> None:
        self.inbox: list[bytes] = []
        self.answers: list[np.ndarray] = []
        self.ipoc = 0
        self.stream = Stream(self, SimpleNamespace(poll=lambda: False), KR16, 3.0)  # type: ignore[arg-type]

    def recvfrom(self, size: int) -> tuple[bytes, str]:
        """Return the waiting telegram."""
        if not self.inbox:
            raise BlockingIOError
        return self.inbox.pop(), "controller"

    def sendto(self, data: bytes, sender: str) -> None:
        """Keep the corrections of an answer [deg]."""
        self.answers.append(rsi.parse_answer(data)[1])

    def exchange(self, axes: np.ndarray, late: int, applied: np.ndarray, cycles: int = 1) -> np.ndarray | None:
        """Send the telegram after some cycles of 4 ms, and return the corrections of its answer [deg]."""
        self.ipoc += 4 * cycles
        self.inbox.append(rsi.telegram(rsi.Telegram(self.ipoc, axes, late, applied)))
        self.answers.clear()
        self.stream._answer_newest()
        return self.answers[0] if self.answers else None

    def drive(self, cycles: int) -> np.ndarray:
        """Follow a move from rest for some cycles; return the corrections of each (cycles + 1, 6) [deg]."""
        home, applied = HOME / PER_DEGREE, [np.zeros(6)]
        for cycle in range(20 + cycles):
            if cycle == 20:
                assert self.stream._controller is not None
                self.stream._controller.command(1, Move(FAR, 1.0))
            answer = self.exchange(home + applied[-1], 0, applied[-1])
            assert answer is not None
            applied.append(answer)
        return np.array(applied[20:])


@pytest.mark.parametrize("cycles", [30, 60, 75])
def test_a_clock_that_begins_again_in_a_short_session_is_a_restart(cycles: int) -> None:
    """Its telegrams look delayed until its clock has passed the last one; then its late answers tell."""
    wire = Wire()
    applied = wire.drive(cycles)[-1]
    assert applied[0] > 0.5
    wire.ipoc = 0
    for late in range(3 * cycles):
        assert wire.exchange(HOME / PER_DEGREE + applied, late, np.zeros(6)) is None
    assert wire.stream._arm is not None
    assert "started RSI again" in wire.stream._arm.failure


@pytest.mark.parametrize("missed", [3, 5, 40])
def test_axes_that_are_behind_are_no_restart(missed: int) -> None:
    """Reported axes are 60 ms behind; the missed answers are counted one telegram later."""
    wire = Wire()
    applied = wire.drive(100)
    behind, last = HOME / PER_DEGREE + applied[-15], applied[-1]
    assert last[0] - applied[-15, 0] > 1.0
    answer = wire.exchange(behind, 0, last, 1 + missed)
    assert answer is not None
    again = wire.exchange(HOME / PER_DEGREE + last, missed, last)
    assert again is not None
    assert again.tolist() == last.tolist()


def test_a_clock_that_begins_again_is_a_restart() -> None:
    """A session whose clock begins below the last one is not taken for delayed telegrams."""
    with serve(HOME_Q.copy(), 4) as bench:
        bench.controller._ipoc = 100_000

        def restart() -> None:
            bench.controller.emergency_stop()
            bench.controller._ipoc = 0
            bench.controller.emergency_stop(False)

        with bench.driver() as driver:
            thread = bench.when_moving(restart)
            began = time.monotonic()
            with pytest.raises(FaultError, match="the controller has started RSI again"):
                driver.move(FAR, 0.3)
            thread.join(5.0)
            assert time.monotonic() - began < 2.0  # before the silence of 3 s


@pytest.mark.parametrize("bench", [4, pytest.param(12, marks=pytest.mark.slow)], indirect=True)
def test_an_arm_that_does_not_follow_makes_no_step(bench: Bench) -> None:
    """After the fault a reset would begin at the arm, away from its corrections: the session has to end."""
    with bench.driver() as driver:
        thread = bench.when_moving(lambda: setattr(bench.controller, "is_blocked", True))
        with pytest.raises(DriverError):  # the fault, or on a busy machine the time that the client waits
            driver.move(FAR, 1.0)
        thread.join(5.0)
        until = time.monotonic() + 20.0
        while driver.state().fault_code != Fault.NOT_SETTLED and time.monotonic() < until:
            threading.Event().wait(0.05)
        assert driver.state().fault_code == Fault.NOT_SETTLED
        with contextlib.suppress(DriverError):  # a client whose time is over stops first
            driver.stop()
        with pytest.raises(DriverError, match=r"up to 3\d\.\d+ deg off its set-point: start sc_rsi .*did not clear it"):
            driver.reset()
        corrected = np.array([np.degrees(HOME_Q), *bench.controller.driven])
        full_deg = np.degrees(KR16.velocity[0]) * bench.controller.cycle_ms / 1000.0
        assert np.abs(np.diff(corrected, axis=0)).max() <= full_deg * (1.0 + 1e-6)
        assert corrected[-1, 0] == pytest.approx(40.0, abs=1e-6)
    bench.controller.is_blocked = False
    bench.controller.driven.clear()
    with bench.driver() as driver:
        at = driver.state().axes / PER_DEGREE
        assert driver.move(HOME[None], 1.0).axes.tolist() == HOME.tolist()
    assert np.abs(np.diff([at, *bench.controller.driven], axis=0)).max() <= full_deg * (1.0 + 1e-6)


@pytest.mark.parametrize("text", ["drop=0.05", "delay=0.03:0.03", "duplicate=0.2", "reorder=0.05", "all"])
def test_faults_of_the_wire(text: str) -> None:
    """Telegrams of both directions are lost, late, doubled or exchanged: the arm stays on its path and arrives."""
    faults = "drop=0.01,delay=0.01:0.03,duplicate=0.05,reorder=0.01" if text == "all" else text
    injector = Injector(parse_faults(faults), np.random.default_rng(3))
    with serve(HOME_Q.copy(), 12, injector) as bench, bench.driver() as driver:  # 4 ms is short on a busy machine
        for goal in (NEAR, HOME[None], NEAR[::-1], HOME[None]):
            assert driver.move(goal, 0.5).axes.tolist() == goal[-1].tolist()
            assert bench.deviation_deg(goal) < 1e-5
            bench.start = goal[-1:]
            bench.controller.driven.clear()
        _, counted = driver._link.late_telegrams()  # type: ignore[attr-defined]
        assert counted > 0 or text.startswith("duplicate")  # a copy is not late
    assert bench.controller.ended["timeout"] == 0


def test_telegrams_of_other_senders_are_ignored(bench: Bench) -> None:
    """The arm belongs to the sender of the first telegram."""
    with bench.driver() as driver, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as foreign:
        telegram = rsi.telegram(rsi.Telegram(10**9, np.degrees(HOME_Q) + 5.0, 0, np.zeros(6)))
        port = int(bench.controller.url.rpartition(":")[2])
        thread = bench.when_moving(lambda: foreign.sendto(telegram, ("127.0.0.1", port)))
        assert driver.move(FAR, 0.5).axes.tolist() == FAR[0].tolist()
        thread.join(5.0)
        foreign.settimeout(0.1)
        with pytest.raises(TimeoutError):
            foreign.recv(1000)
    assert bench.deviation_deg(FAR) < 1e-5


def test_a_late_reply_of_the_process_is_dropped() -> None:
    """After a time-out every reply still belongs to its request."""
    with serve(HOME_Q.copy(), 12) as bench:
        url = f"{bench.controller.url}?timeout_ms=30&watchdog_ms=3000&wait_s=5"
        with RsiDriver.from_url(DriverUrl(url), Context(KR16)) as driver:
            process = driver._link._process  # type: ignore[attr-defined]
            os.kill(process.pid, signal.SIGSTOP)
            with pytest.raises(LinkLostError, match="does not answer its client"):
                driver.state()
            os.kill(process.pid, signal.SIGCONT)
            driver._link.late_telegrams()  # type: ignore[attr-defined]
            threading.Event().wait(0.2)
            late, counted = driver._link.late_telegrams()  # type: ignore[attr-defined]
            assert late >= 50
            assert counted >= 50
            assert driver.state().axes.tolist() == HOME.tolist()


def test_a_process_that_dies_at_its_start_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Before and after it has connected."""
    connected = "Client(('127.0.0.1', int(sys.argv[3].split(':')[1])), authkey=bytes.fromhex(input())).recv()\n"
    for name, line in (("first", ""), ("second", connected)):
        program = tmp_path / name
        program.write_text(f"#!{sys.executable}\nimport sys\nfrom multiprocessing.connection import Client\n{line}")
        program.chmod(0o755)
        driver = RsiDriver.from_url(DriverUrl("rsi://127.0.0.1:49878"), Context(KR16))
        with monkeypatch.context() as patch:
            patch.setattr(sys, "executable", str(program))
            began = time.monotonic()
            with pytest.raises(LinkLostError, match="the process that answers the controller did not start"):
                driver.connect()
            assert time.monotonic() - began < 15.0


def test_urls_and_missing_controllers() -> None:
    """One sentence each."""
    for url in ("rsi://", "rsi://127.0.0.1/x"):
        with pytest.raises(DriverUrlError, match="must name the address of this computer"):
            RsiDriver.from_url(DriverUrl(url), Context(KR16))
    for url in ("rsi://0.0.0.0", "rsi://0:49152", "rsi://[::]:49152"):
        with pytest.raises(DriverUrlError, match="names every network of this computer; name its address"):
            RsiDriver.from_url(DriverUrl(url), Context(KR16))
    driver = RsiDriver.from_url(DriverUrl("rsi://127.0.0.1:49877?wait_s=0.2"), Context(KR16))
    with pytest.raises(LinkLostError, match=r"no telegram has arrived at 127.0.0.1:49877 for 0.2 s; start the program"):
        driver.connect()
    with pytest.raises(LinkLostError, match="cannot be opened"):
        RsiDriver.from_url(DriverUrl("rsi://203.0.113.7:49877"), Context(KR16)).connect()


def test_telegram_of_a_real_controller() -> None:
    """A telegram with more elements, as controllers send them."""
    data = (
        b'<Rob Type="KUKA"><RIst X="93.9531" Y="-347.9674" Z="1844.9703" A="-126.9460" B="24.9226" C="-28.2871"/>'
        b'<AIPos A1="74.8478" A2="-128.7977" A3="75.8236" A4="102.2260" A5="0.0987" A6="-56.5347"/>'
        b'<Delay D="3" /><Tech C11="0.0"/><IPOC>4208163634</IPOC></Rob>'
    )
    found = rsi.parse_telegram(data)
    assert found.axes_deg.tolist() == [74.8478, -128.7977, 75.8236, 102.2260, 0.0987, -56.5347]
    assert (found.ipoc, found.late, found.applied_deg.tolist()) == (4208163634, 3, [0.0] * 6)
    for wrong in (b"", b"<Rob><IPOC>1</IPOC></Rob>", data.replace(b' A6="-56.5347"', b""), data.replace(b"IPOC", b"X")):
        with pytest.raises(ValueError, match="telegram without"):
            rsi.parse_telegram(wrong)
