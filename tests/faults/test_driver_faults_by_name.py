"""Each fault by name on each wire, in simulated time: nothing twice, lost, out of order or off the path."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from benchmarks.soak import EVERY_FAULT, drive, judge
from drivers.emulated.faults import MOVE_FAULTS, NAMES

MOVES = 8


@pytest.mark.parametrize("name", NAMES)
def test_a_fault_is_recovered_or_reported(name: str, backend: str, bench: Callable[..., Any]) -> None:
    """One telegram in sixteen, or one move in three, goes wrong: the journal agrees with what the client was told."""
    duration = {"delay": ":0.12", "half-open": ":0.3", "reboot": ":0.2"}.get(name, "")
    made = bench(backend, f"{name}={0.34 if name in MOVE_FAULTS else 0.06}{duration}", seed=5, time_scale=20.0)
    soak = drive(made.driver, MOVES, np.random.default_rng(3), made.clock.wait)
    verdict = judge(soak, made.journal.entries)
    assert verdict.clean, (verdict, soak.outcomes)
    assert soak.outcomes["done"] >= MOVES // 3
    assert len(soak.commanded) == MOVES
    if name in ("reboot", "estop"):
        assert soak.outcomes["fault"] + soak.outcomes["unknown"] > 0
        assert soak.reported


def test_every_fault_at_once(backend: str, bench: Callable[..., Any]) -> None:
    """The soak's own list, at twice its rates."""
    made = bench(backend, EVERY_FAULT.replace("=0.01", "=0.02"), seed=11, time_scale=20.0)
    soak = drive(made.driver, 3 * MOVES, np.random.default_rng(12), made.clock.wait)
    verdict = judge(soak, made.journal.entries)
    assert verdict.clean, (verdict, soak.outcomes)
    assert soak.outcomes["done"] >= 2 * MOVES


def test_the_judge_finds_what_is_wrong(backend: str, bench: Callable[..., Any]) -> None:
    """A journal with a doubled, a missing, a swapped or a foreign move, a stop off the path, an untold fault."""
    made = bench(backend, time_scale=20.0)
    soak = drive(made.driver, 5, np.random.default_rng(1), made.clock.wait)
    good = made.journal.entries
    assert judge(soak, good).clean
    moves = [k for k, entry in enumerate(good) if entry["event"] == "move"]
    assert judge(soak, [*good, good[moves[-1]]]).twice == 1
    without = [entry for k, entry in enumerate(good) if k != moves[2]]
    assert judge(soak, without).lost == 1
    swapped = list(good)
    swapped[moves[1]], swapped[moves[2]] = good[moves[2]], good[moves[1]]
    assert judge(soak, swapped).out_of_order == 1
    foreign = [*good, {**good[moves[-1]], "set_points": [[1, 2, 3, 4, 5, 6]]}]
    assert judge(soak, foreign).foreign == 1
    elsewhere = [*good, {**good[moves[-1]], "from": [0] * 6}]
    assert judge(soak, elsewhere).off_path > 1000
    fault = [*good, {"event": "fault", "boot": 1, "code": 4001}, {"event": "reset", "boot": 1, "sequence": 99}]
    assert judge(soak, fault).unreported == 1
    soak.commanded[3] = (soak.commanded[3][0], "refused")
    assert judge(soak, good).foreign == 1
