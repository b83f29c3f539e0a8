"""The timeline of a replay and its player, on a synthetic motion."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cell.runs import timeline
from cell.runs.run import ExecutedScan, RecordedExecution
from cell.view.replay_pictures import frame_times
from cell.view.viewer import SPEEDS, Player
from planner.ports import JointLimits
from planner.timing.motion import Motion, retime

_LIMITS = JointLimits(np.full(6, -3.0), np.full(6, 3.0), np.ones(6), np.ones(6))
_VIEWS = (7, 3, 9)
_REST = 0.5


def _motion() -> Motion:
    """Home, view 7, a via point, view 3, view 9, home."""
    via = np.random.default_rng(5).uniform(-1, 1, (6, 6))
    via[-1] = via[0]
    return retime(via, np.array([0, 0, 1, 1, 2, 3]), np.array([-1, 7, -1, 3, 9, -1]), _LIMITS)


def _scan(stop: int, view: int, commanded: Any, reported: Any) -> ExecutedScan:
    T, nothing = np.eye(4), np.zeros((0, 3))
    return ExecutedScan(stop, view, commanded, reported, T, T[None], None, None, nothing, None, "files", "object")


def _execution(views: tuple[int, ...], off: float, motion: Motion | None = None) -> RecordedExecution:
    planned = _motion()
    rng = np.random.default_rng(1)
    scans = []
    for view in views:
        q = planned.via_q[planned.view == view][0]
        scans.append(_scan(len(scans) + 1, view, q, q + off * rng.normal(size=6)))
    return RecordedExecution(Path("e"), {}, tuple(scans), motion, ())


def test_the_plan_rests_at_each_view() -> None:
    """Duration = motion + rests; a rest has the planned angles; without rests the timeline is the motion."""
    motion = _motion()
    found = timeline.plan_timeline(motion, _REST)
    assert found.duration == pytest.approx(motion.duration + _REST * len(_VIEWS))
    assert [stop.candidate for stop in found.stops] == list(_VIEWS)
    for stop in found.stops:
        q = motion.via_q[motion.view == stop.candidate][0]
        for t in (stop.begin, (stop.begin + stop.end) / 2, stop.end):
            np.testing.assert_allclose(found.at(t), q, atol=1e-12)
            assert found.stop_at(t) == stop
            assert found.moved(t) == pytest.approx(motion.via_t[motion.view == stop.candidate][0])
    np.testing.assert_array_equal(timeline.plan_timeline(motion, 0.0).q[[0, -1]], motion.q[[0, -1]])
    for t in np.linspace(0, motion.duration, 50):
        expected = [np.interp(t, motion.t, motion.q[:, axis]) for axis in range(6)]
        np.testing.assert_allclose(timeline.plan_timeline(motion, 0.0).at(t), expected, atol=1e-12)


def test_an_exact_execution_is_the_plan() -> None:
    """With reported = commanded = planned angles, both timelines agree sample by sample."""
    motion = _motion()
    plan = timeline.plan_timeline(motion, _REST)
    found = timeline.execution_timeline(_execution(_VIEWS, 0.0), motion, motion.q[0], _REST)
    np.testing.assert_allclose(found.t, plan.t, atol=1e-12)
    np.testing.assert_allclose(found.q, plan.q, atol=1e-12)
    assert found.notes == ()


def test_an_execution_uses_its_reported_angles() -> None:
    """Stops have exactly the reported angles; the motion between them is continuous."""
    motion = _motion()
    execution = _execution(_VIEWS, 0.02)
    found = timeline.execution_timeline(execution, motion, motion.q[0], _REST)
    for stop, scan in zip(found.stops, execution.scans, strict=True):
        np.testing.assert_allclose(found.at(stop.begin), scan.q_reported, atol=1e-12)
    np.testing.assert_allclose(found.q[[0, -1]], motion.q[[0, -1]], atol=1e-12)
    assert (np.diff(found.t) > 0).all()
    assert (np.abs(np.diff(found.q, axis=0)) / np.diff(found.t)[:, None]).max() < 1.3


def test_a_recorded_motion_replaces_the_planned_one() -> None:
    """The timeline has the duration of the recorded motion."""
    motion = _motion()
    slow = JointLimits(_LIMITS.lower, _LIMITS.upper, _LIMITS.velocity / 4, _LIMITS.acceleration / 4)
    own = retime(motion.via_q, motion.segment, motion.view, slow)
    found = timeline.execution_timeline(_execution(_VIEWS, 0.0, own), motion, motion.q[0], 0.0)
    assert found.duration == pytest.approx(own.duration)


@pytest.mark.parametrize("views", [(9,), (3, 7), (7, 9)])
def test_an_unplanned_motion_is_straight_and_noted(views: tuple[int, ...]) -> None:
    """A single view or another order gives straight moves and a note."""
    motion = _motion()
    found = timeline.execution_timeline(_execution(views, 0.01), motion, motion.q[0], _REST)
    assert [stop.candidate for stop in found.stops] == list(views)
    assert "without a collision check" in found.notes[0]
    assert (np.diff(found.t) > 0).all()
    assert (np.abs(np.diff(found.q, axis=0)) / np.diff(found.t)[:, None]).max() < 1.3


def test_stops_have_the_numbers_of_the_plan() -> None:
    """If view 1 is missing, the others keep their planned numbers, and `n_views` is that of the plan."""
    motion = _motion()
    found = _execution((3, 9), 0.0)
    scans = tuple(dataclasses.replace(scan, stop=number) for number, scan in zip((2, 3), found.scans, strict=True))
    renumbered = timeline.execution_timeline(dataclasses.replace(found, scans=scans), motion, motion.q[0], _REST)
    assert [(stop.number, stop.candidate) for stop in renumbered.stops] == [(2, 3), (3, 9)]
    assert renumbered.n_views == 3
    assert "the motion to view 2 is neither" in renumbered.notes[0]
    assert timeline.plan_timeline(motion).n_views == 3


def test_a_run_without_motion_is_at_home() -> None:
    """The angles are those of home at every time."""
    found = timeline.home_timeline(np.arange(6.0))
    assert found.duration == 0
    np.testing.assert_array_equal(found.at(3.0), np.arange(6.0))
    empty = timeline.execution_timeline(_execution((), 0.0), None, np.arange(6.0))
    np.testing.assert_array_equal(empty.at(0.0), np.arange(6.0))


@given(st.floats(0, 20), st.floats(0, 20), st.floats(1, 60), st.floats(0.1, 10))
def test_frames_cover_the_playback(duration: float, start: float, fps: float, speed: float) -> None:
    """The first frame is at the start, the last at the end; the step is speed / fps."""
    times = frame_times(duration, min(start, duration), fps, speed)
    assert times[0] == min(start, duration)
    assert times[-1] == pytest.approx(duration, abs=1e-6)  # nothing moves visibly in a microsecond
    np.testing.assert_allclose(times[:-1], times[0] + np.arange(len(times) - 1) * speed / fps)


def test_keys() -> None:
    """Space pauses and restarts at the end; arrows step to a view and pause; up and down are inverse."""
    found = timeline.plan_timeline(_motion(), _REST)
    player = Player(found, speed=2.0)
    player.advance(0.1)
    assert player.t == pytest.approx(0.2)
    player.press(32)
    player.advance(5.0)
    assert player.t == pytest.approx(0.2)
    for stop in found.stops:
        player.press(262)
        assert player.t == stop.begin
        assert not player.playing
    player.press(262)
    assert player.ended
    for stop in reversed(found.stops):
        player.press(263)
        assert player.t == stop.begin
    player.press(263)
    player.press(263)
    assert player.t == 0
    player.press(32)
    player.advance(1e6)
    assert player.t == found.duration
    player.press(32)
    assert player.t == 0
    assert player.playing
    player.press(265)
    player.press(264)
    assert player.speed == pytest.approx(2.0)
    for _ in range(50):
        player.press(264)
    assert player.speed == SPEEDS[0]
    player.advance(1.0)
    player.press(268)
    assert player.t == 0
