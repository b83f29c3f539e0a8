"""Faults of wire, controller and cell in simulated time: no move is repeated, lost, reordered or off the path.

The full forms of the soak and the fuzz are `python -m benchmarks soak` and `python -m benchmarks fuzz`.
"""

import numpy as np
import pytest

from benchmarks import fuzz
from benchmarks.soak import EVERY_FAULT, drive, judge
from drivers.contract import Fault, Mode
from drivers.emulated.faults import MOVE_FAULTS, NAMES
from drivers.errors import EmergencyStopError, RefusedError, StateUnknownError
from tests.support.driver_bench import HOME, make_bench, turned

MOVES = 8


@pytest.mark.parametrize("name", NAMES)
def test_a_fault_is_recovered_or_reported(name: str, backend: str) -> None:
    """One telegram in sixteen, or one move in three, is disturbed: the journal agrees with the client's reports."""
    duration = {"delay": ":0.12", "half-open": ":0.3", "reboot": ":0.2"}.get(name, "")
    faults = f"{name}={0.34 if name in MOVE_FAULTS else 0.06}{duration}"
    bench = make_bench(backend, faults, seed=5, time_scale=20.0)
    soak = drive(bench.driver, MOVES, np.random.default_rng(3), bench.clock.wait)
    verdict = judge(soak, bench.journal.entries)
    assert verdict.clean, (verdict, soak.outcomes)
    assert soak.outcomes["done"] >= MOVES // 3
    assert len(soak.commanded) == MOVES
    if name in ("reboot", "estop"):
        assert soak.outcomes["fault"] + soak.outcomes["unknown"] > 0
        assert soak.reported


def test_every_fault_at_once(backend: str) -> None:
    """The faults of the soak at twice their rates are recovered or reported."""
    bench = make_bench(backend, EVERY_FAULT.replace("=0.01", "=0.02"), seed=11, time_scale=20.0)
    soak = drive(bench.driver, 3 * MOVES, np.random.default_rng(12), bench.clock.wait)
    verdict = judge(soak, bench.journal.entries)
    assert verdict.clean, (verdict, soak.outcomes)
    assert soak.outcomes["done"] >= 2 * MOVES


def test_the_judge_detects_errors() -> None:
    """The judge detects a doubled, missing, swapped or foreign move, a start off the path and an unreported fault."""
    bench = make_bench("serial", time_scale=20.0)
    soak = drive(bench.driver, 5, np.random.default_rng(1), bench.clock.wait)
    good = bench.journal.entries
    assert judge(soak, good).clean
    moves = [k for k, entry in enumerate(good) if entry["event"] == "move"]
    last = good[moves[-1]]
    assert judge(soak, [*good, last]).twice == 1
    assert judge(soak, [entry for k, entry in enumerate(good) if k != moves[2]]).lost == 1
    swapped = list(good)
    swapped[moves[1]], swapped[moves[2]] = good[moves[2]], good[moves[1]]
    assert judge(soak, swapped).out_of_order == 1
    assert judge(soak, [*good, {**last, "set_points": [[1, 2, 3, 4, 5, 6]]}]).foreign == 1
    assert judge(soak, [*good, {**last, "from": [0] * 6}]).off_path > 1000
    fault = [{"event": "fault", "boot": 1, "code": 4001}, {"event": "reset", "boot": 1, "sequence": 99}]
    assert judge(soak, [*good, *fault]).unreported == 1
    soak.commanded[3] = (soak.commanded[3][0], "refused")
    assert judge(soak, good).foreign == 1


def test_a_scheduled_emergency_stop(backend: str) -> None:
    """Pressed at 1 s for 2 s: the move ends on its path, and a reset is refused until the release."""
    bench = make_bench(backend, "estop@1:2")
    bench.driver.connect()
    with pytest.raises(EmergencyStopError) as pressed:
        bench.driver.move(turned(120.0), 0.2)
    assert pressed.value.code == Fault.EMERGENCY_STOP
    assert 1.0 <= bench.clock.now() < 2.0
    with pytest.raises(RefusedError, match="still pressed"):
        bench.driver.reset()
    bench.clock.wait(3.0)
    assert bench.driver.state().mode is Mode.EMERGENCY_STOP
    assert bench.driver.reset().mode is Mode.IDLE
    assert bench.driver.move(turned(0.0), 1.0).mode is Mode.IN_POSITION


def test_a_scheduled_restart(backend: str) -> None:
    """The arm brakes on its path and keeps its position; the new controller counts from 0 and latches RESTARTED."""
    bench = make_bench(backend, "reboot@1:0.3")
    bench.driver.connect()
    with pytest.raises(StateUnknownError):
        bench.driver.move(turned(120.0), 0.2)
    bench.clock.wait(1.0)
    state = bench.driver.stop()
    assert (state.fault_code, state.boot, state.done_sequence) == (Fault.RESTARTED, 2, 0)
    assert 0 < state.axes[0] < 1_200_000
    assert (state.axes[1:] == HOME[1:]).all()
    first, second = bench.journal.of("start")
    assert second["axes"] == state.axes.tolist()
    assert first["boot"] == 1
    bench.driver.reset()
    assert bench.driver.move(turned(0.0), 1.0).mode is Mode.IN_POSITION


def test_a_line_that_is_mute_for_a_while(backend: str) -> None:
    """Below the watchdog's time the move continues; above it the arm stops with the fault."""
    short = make_bench(backend, "half-open@1:0.2")
    short.driver.connect()
    assert short.driver.move(turned(60.0), 0.2).mode is Mode.IN_POSITION
    long = make_bench(backend, "half-open@1:3")
    long.driver.connect()
    with pytest.raises(StateUnknownError):
        long.driver.move(turned(120.0), 0.2)
    long.clock.wait(3.0)
    state = long.driver.stop()
    assert state.fault_code == Fault.WATCHDOG
    assert 0 < state.axes[0] < 1_200_000


@pytest.mark.parametrize("frames", [12_000, pytest.param(120_000, marks=pytest.mark.slow)])
def test_corrupted_frames_neither_crash_a_codec_nor_are_accepted(frames: int) -> None:
    """Flipped bits, replaced bytes, bursts, cuts and joins are refused without an exception."""
    for row in fuzz.run(frames, seed=4):
        assert row["crashes"] == 0, row
        assert row["false accepts"] == 0, row
        assert row["still whole"] < row["mangled"] / 4, row


def test_the_fuzz_detects_faulty_codecs() -> None:
    """A receiver that ignores the CRC and one that relies on the length are detected."""
    rng = np.random.default_rng(0)
    frames = fuzz.serial_frames(rng)

    def without_crc(data: bytes) -> set[bytes]:
        return {line[:-9] for line in data.splitlines() if len(line) > 10}

    def by_length(data: bytes) -> set[bytes]:
        return {data[: int(data[7:11])]}

    assert fuzz.fuzz(frames, without_crc, 500, rng)["false accepts"] > 100
    assert fuzz.fuzz(fuzz.serial_frames(rng), by_length, 500, rng)["crashes"] > 10
