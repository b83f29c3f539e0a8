"""Conditions of a motion of hardware: confirmation, reduced speed, no latched fault."""

import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cell.errors import DriverFailureError, UsageError
from cell.robot.model import load
from cell.scan import safety
from cell.scan.execution import ExecutionPlan, Segment
from cell.scan.options import ScanOptions
from cell.scan.safety import ApprovedMotion
from cell.scene.options import flag, parse_options
from cell.world.travel import TravelBound
from drivers.contract import Capabilities, Mode, RobotState
from drivers.setpoints import from_rad
from tests.support.arms import KR16

_PLAN = ApprovedMotion("the plan", "0123456789abcdef" * 4)
_PATH = ApprovedMotion("the new path", "fedcba9876543210" * 4, is_own_path=True)


class _Controller:
    """A controller of hardware in a given state, which records the requests to stop and to reset."""

    def __init__(self, mode: Mode = Mode.IDLE, *, at_rest: bool = True, hardware: bool = True) -> None:
        limits = KR16
        self.capabilities = Capabilities(
            "KR C4", limits.lower, limits.upper, limits.max_step, 1.0, None, hardware, False
        )  # fmt: skip
        self.mode, self.at_rest, self.asked, self.queue = mode, at_rest, "", 0

    def state(self) -> RobotState:
        latched = "heartbeat lost" if self.mode is Mode.FAULT else ""
        return RobotState(self.mode, from_rad(np.zeros(6)), self.at_rest, queue_depth=self.queue, fault_message=latched)

    require_ready = state

    def take(self) -> None:
        """Accept the client, because no other one is active."""

    def stop(self) -> RobotState:
        self.asked += "stop "
        self.at_rest, self.queue = True, 0
        return self.state()

    def reset(self) -> RobotState:
        self.asked += "reset "
        self.mode = Mode.IDLE
        return self.state()


def test_hardware_moves_at_ten_percent_by_default() -> None:
    """Hardware moves at no more than 10 % by default. --speed is a fraction of the plan's speed."""
    assert safety.speed_fraction(None, 1.0, hardware=True) == 0.1
    assert safety.speed_fraction(None, 0.05, hardware=True) == 0.05
    assert safety.speed_fraction(None, 0.7, hardware=False) == 0.7
    assert safety.speed_fraction(0.5, 0.5, hardware=True) == 0.25


@pytest.mark.parametrize("percent", [0.0, -1.0, 100.1, float("nan")])
def test_a_speed_that_is_no_percentage_is_refused(percent: float) -> None:
    """A speed of 0 or less, above 100 or NaN is refused."""
    with pytest.raises(UsageError, match="--speed"):
        parse_options(ScanOptions, {"speed": percent}, flag)


def test_steel_does_not_move_without_somebody_s_word() -> None:
    """Without a terminal the message names the option. Any answer but yes prevents the motion."""
    with pytest.raises(UsageError, match="--confirm-motion"):
        safety.require_confirmation(_Controller(), 0.1, _PLAN, confirmation=None, confirm=None)
    for answer in ("", "y", "no", "yes please"):
        with pytest.raises(UsageError, match="nothing was moved"):
            safety.require_confirmation(
                _Controller(), 0.1, _PLAN, confirmation=None, confirm=lambda question, output=answer: output
            )


def test_a_word_is_an_option_or_a_typed_yes_and_simulation_needs_none() -> None:
    """The question names the plan, the controller and the speed. A simulation asks no question."""
    questions: list[str] = []

    def yes(question: str) -> str:
        questions.append(question)
        return " Yes\n"

    safety.require_confirmation(_Controller(), 0.1, _PLAN, confirmation=None, confirm=yes)
    safety.require_confirmation(_Controller(), 0.1, _PLAN, confirmation=_PLAN.short_digest, confirm=None)
    safety.require_confirmation(_Controller(), 0.1, _PLAN, confirmation=_PLAN.digest, confirm=None)
    safety.require_confirmation(_Controller(hardware=False), 1.0, _PLAN, confirmation=None, confirm=None)
    for released in (_PLAN, _PATH):  # a batch, and the new path of a resumed batch
        safety.require_confirmation(_Controller(), 0.1, released, confirmation=safety.ANY_MOTION, confirm=None)
    assert len(questions) == 1
    assert f"along the plan {_PLAN.short_digest}" in questions[0]
    assert "KR C4" in questions[0]
    assert "10 %" in questions[0]


def test_the_question_states_what_a_wire_does_not_report() -> None:
    """A person who answers knows what the connection leaves out."""
    controller, questions = _Controller(), list[str]()
    controller.capabilities = replace(controller.capabilities, not_reported="who else writes its variables")

    def yes(question: str) -> str:
        questions.append(question)
        return "yes"

    safety.require_confirmation(controller, 0.1, _PLAN, confirmation=None, confirm=yes)
    assert "; it does not report who else writes its variables. Check that no person" in questions[0]
    with pytest.raises(UsageError, match="does not report who else writes its variables; check"):
        safety.require_confirmation(controller, 0.1, _PLAN, confirmation=None, confirm=None)


def test_the_digest_of_something_else_is_no_word() -> None:
    """A digest confirms its own motion only. With the digest of the plan, a new path is confirmed at the terminal."""
    other = "c" * 64
    with pytest.raises(UsageError, match=f"which is {_PLAN.short_digest}; nothing was moved"):
        safety.require_confirmation(_Controller(), 0.1, _PLAN, confirmation=other, confirm=lambda question: "yes")
    with pytest.raises(UsageError, match=f"which is {_PATH.short_digest}; nothing was moved"):
        safety.require_confirmation(_Controller(), 0.1, _PATH, confirmation=_PLAN.digest, confirm=None)
    with pytest.raises(UsageError, match="not confirmed"):
        safety.require_confirmation(_Controller(), 0.1, _PATH, confirmation=_PLAN.digest, confirm=lambda question: "no")
    safety.require_confirmation(_Controller(), 0.1, _PATH, confirmation=_PATH.short_digest, confirm=None)


@pytest.mark.parametrize("word", ["yes", "0" * 7, "0" * 65, "0123456z"])
def test_a_word_that_is_no_digest_is_refused(word: str) -> None:
    """A digest has 8 to 64 hexadecimal digits, in capitals or not."""
    with pytest.raises(UsageError, match="must be a digest as cell plan prints it"):
        parse_options(ScanOptions, {"confirm_motion": word}, flag)
    assert parse_options(ScanOptions, {"confirm_motion": "ABCDEF01"}, flag).confirm_motion == "abcdef01"


@pytest.mark.parametrize("mode", [Mode.FAULT, Mode.EMERGENCY_STOP])
def test_a_latched_fault_is_cleared_only_on_demand(mode: Mode) -> None:
    """Without --reset the message names the option, and no reset is sent."""
    latched = _Controller(mode)
    with pytest.raises(DriverFailureError, match="--reset"):
        safety.prepare_controller(latched, ScanOptions(reset=False), stop_first=True)
    assert latched.asked == ""
    assert safety.prepare_controller(latched, ScanOptions(reset=True), stop_first=False).mode is Mode.IDLE
    assert latched.asked == "reset "


def test_an_arm_that_moves_is_stopped_only_where_an_execution_is_resumed() -> None:
    """A new execution refuses an arm that moves or has queued moves; a resumed execution stops it."""
    with pytest.raises(DriverFailureError, match="another client"):
        safety.prepare_controller(_Controller(Mode.MOVING, at_rest=False), ScanOptions(reset=False), stop_first=False)
    waiting = _Controller()
    waiting.queue = 1
    with pytest.raises(DriverFailureError, match="another client"):
        safety.prepare_controller(waiting, ScanOptions(reset=False), stop_first=False)
    moving = _Controller(Mode.MOVING, at_rest=False)
    moving.mode = Mode.IDLE
    assert safety.prepare_controller(moving, ScanOptions(reset=False), stop_first=True).at_rest
    assert moving.asked == "stop "


def test_a_clock_that_is_not_real_time_wants_a_word() -> None:
    """Only the exact time scale of an emulator is accepted. A simulation needs no option."""
    emulator = _Controller()
    emulator.capabilities = replace(emulator.capabilities, time_scale=20.0)
    for accepted in (None, 1.0, 19.9):
        with pytest.raises(UsageError, match=r"20 times as fast.*--accept-time-scale 20"):
            safety.require_time_scale(emulator, accepted)
    safety.require_time_scale(emulator, 20.0)
    safety.require_time_scale(_Controller(), None)
    with pytest.raises(UsageError, match="in real time, not 20 times"):
        safety.require_time_scale(_Controller(), 20.0)
    emulator.capabilities = replace(emulator.capabilities, hardware=False)
    safety.require_time_scale(emulator, None)


def test_a_motion_that_is_faster_than_the_path_watch_covers_is_named() -> None:
    """5 mm are left for a poll and the age of a report; the named speed needs no warning."""
    travel, home, end = TravelBound(load()), np.radians([0.0, -90, 90, 0, 90, 0]), np.radians([40.0, -90, 90, 0, 90, 0])
    scene = SimpleNamespace(speed_scaling=0.5)
    cell: Any = SimpleNamespace(travel=travel, scene=scene)
    motion: Any = SimpleNamespace(limits=SimpleNamespace(velocity=KR16.velocity / 2))
    plan = ExecutionPlan(home, (Segment(end[None], 1, 0),), 1.0)

    def warning(speed: float, url: str = "ur://arm") -> str:
        return safety.watch_warning(plan, motion, cell, ScanOptions(driver=url), speed, 0.005)

    text = warning(0.1)
    assert "up to 83 mm/s" in text
    assert "up to 50 mm/s" in warning(0.1, "ur://arm?poll_ms=60")
    found = re.search(r"reaches (\d+) mm/s \(--speed (\S+) keeps", text)
    assert found is not None
    turn = np.radians([0.01, 0, 0, 0, 0, 0])  # of one axis: the bound is the way of the farthest point
    radius = float(travel(home[None], (home + turn)[None])[0] / turn[0])
    assert float(found[1]) == pytest.approx(100 * KR16.velocity[0] * radius, rel=0.02)
    assert warning(0.5 * float(found[2])) == ""
    assert warning(0.6 * float(found[2])) != ""


def test_every_motion_is_released_by_no_option() -> None:
    """The confirmation of all batches of `cell explore` is refused as an option of an execution."""
    with pytest.raises(UsageError, match="--confirm-motion"):
        parse_options(ScanOptions, {"confirm_motion": safety.ANY_MOTION}, flag)
